"""Matching: the DOF of the model for each sensor and each force of a test, by label or by position.

- `sensors`: `match`, and the user's input on the test.
- `placement`: positions, units and alignment.
- `directions`: sensors that point along no DOF.
- `result`: the matching, its table and its error.
"""

from updyn.matching.result import Alignment, MatchError, Matching, SensorMatch
from updyn.matching.sensors import match

__all__ = ["Alignment", "MatchError", "Matching", "SensorMatch", "match"]
