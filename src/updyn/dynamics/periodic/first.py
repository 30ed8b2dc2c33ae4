"""`solve_first`: the solution at one frequency that a growing force reaches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from updyn.arrays import RealArray
from updyn.dynamics.periodic.balance import Balance, Evaluation, GrowingBalance, Residual
from updyn.dynamics.periodic.continuation import follow_branch
from updyn.dynamics.periodic.newton import solve_at
from updyn.dynamics.periodic.settings import BALANCE
from updyn.errors import SolverError

__all__ = ["follow_force", "solve_first"]


def solve_first(balance: Balance, omega: float) -> Evaluation | None:
    """Return a solution at a frequency that a growing force reaches, or None.

    A force beyond which the motion jumps, as in the gap of a free drive, has no solution nearby;
    the branch is then followed over the force, through its turning points.
    """
    level, step = 0.0, 1.0
    x = balance.linear(omega)
    while True:
        tried = min(level + step, 1.0)
        part = replace(balance, level=tried * balance.level)
        # The response is proportional to a small level.
        start = x * (tried / level if level else 1.0)
        found = solve_at(part, start, omega)
        if found is None:
            step *= 0.5
            if step < BALANCE.least_level_step:
                break
            if not level:
                x = 0.5 * x
        elif tried == 1.0:
            return found
        else:
            level, x = tried, found.x
    turned = follow_force(GrowingBalance(balance, omega), x, level) if level else None
    return None if turned is None else balance.evaluate(turned.x, omega)


def follow_force(balance: Residual, x: RealArray, share: float) -> Evaluation | None:
    """Return the solution at the whole force on the branch of that at a share of it, or None."""
    start, ends = balance.evaluate(x, share), np.array([share, 1.0])
    reversed_force = -1.0  # beyond it, the branch repeats with the opposite sign
    try:
        for point in follow_branch(balance, start, ends, limit=reversed_force):
            if point.line == 1:
                return point.found
    except SolverError:
        pass
    return None
