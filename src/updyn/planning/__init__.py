"""Test planning: sensors, forces and band, selected before a test by the information they give.

The room imports parts of an update (`updyn.updating.problem`, `updyn.updating.judge`), but no file,
job or page.
"""

from __future__ import annotations

from updyn.planning.criteria import CRITERIA, Criterion
from updyn.planning.plan import plan
from updyn.planning.result import Plan

__all__ = ["CRITERIA", "Criterion", "Plan", "plan"]
