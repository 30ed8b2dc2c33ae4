"""CalculiX: decks of solids, run by ``ccx``, which writes K and M; each material is a group.

The program gives the sums only, so the deck is run once as it stands and once for each material
with its modulus and density doubled (`updyn.io.differences`). Springs and point masses are groups
of their own, by element set. ``ccx`` is not part of updyn; it has to be installed.
"""

from updyn.io.calculix.model import read_model, write_properties

__all__ = ["read_model", "write_properties"]
