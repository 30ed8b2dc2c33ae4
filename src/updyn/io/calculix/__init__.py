"""CalculiX: decks of solids, run by ``ccx``, which writes K and M; each material is a group.

The program writes only sums, so the deck is run once unchanged and once for each material with
doubled modulus and density (`updyn.io.differences`). Springs and point masses form separate groups
by element set. ``ccx`` is not part of updyn and has to be installed.
"""

from updyn.io.calculix.model import read_model, write_properties

__all__ = ["read_model", "write_properties"]
