"""Test planning: sensors, forces and band, chosen before a test by what they tell of the unknowns.

The room imports what an update is made of (`updyn.updating.problem`, `updyn.updating.judge`) and
knows no file, job or page. A criterion of another package is registered in
`updyn.planning.criteria.CRITERIA`, or by an entry point of the group ``updyn.plan_criteria``.
"""

from __future__ import annotations

from updyn.planning.criteria import CRITERIA, Criterion
from updyn.planning.plan import plan
from updyn.planning.result import Plan

__all__ = ["CRITERIA", "Criterion", "Plan", "plan"]
