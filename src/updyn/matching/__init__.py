"""Matching of sensors and forces of a test to DOFs of a model, by label or by position.

- `sensors`: `match`, and the user's input about the test.
- `placement`: positions, units and alignment.
- `directions`: sensors that are not along a DOF.
- `result`: the matching, its table and its error.
"""

from updyn.matching.result import Alignment, MatchError, Matching, SensorMatch
from updyn.matching.sensors import match

__all__ = ["Alignment", "MatchError", "Matching", "SensorMatch", "match"]
