"""Matching: which DOF of the model each sensor and each force of a test is, by label or by where it sits.

- `sensors`: `match`, the way through.
- `told`: what is said about the test.
- `nearest`, `rigid`: positions, units and alignment.
- `turning`: sensors that point along no DOF.
- `table`: what comes out.
"""

from updyn.matching.sensors import match
from updyn.matching.table import Alignment, MatchError, Matching, SensorMatch

__all__ = ["Alignment", "MatchError", "Matching", "SensorMatch", "match"]
