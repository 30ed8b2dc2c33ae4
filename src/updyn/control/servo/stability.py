"""Whether a closed loop is stable: by its eigenvalues, or with dead time by counting how often L turns about -1."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from updyn.control.servo.grid import Loop, resolved
from updyn.errors import SolverError

__all__ = ["count_drifting", "count_growing", "nyquist_count"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Poles of the closed loop that lie nearer to 0 than this share of a frequency of the loop stand at
#: 0.
_AT_REST = 1e-5
#: A pole grows if its real part exceeds this share of its size: undamped modes that the loop does
#: not see are rounded.
_GROWS = 1e-9


def count_drifting(poles: _Complex, scale: float) -> int:
    """Return how many poles of a closed loop stand at 0.

    Parameters
    ----------
    poles : ndarray of complex
        In rad/s.
    scale : float
        A frequency of the loop in rad/s, its crossover.
    """
    return int((np.abs(poles) < _AT_REST * scale).sum())


def count_growing(poles: _Complex, scale: float) -> int:
    """Return how many poles of a closed loop grow; those at 0 do not count.  Parameters as of `count_drifting`."""
    moving = poles[np.abs(poles) >= _AT_REST * scale]
    return int((moving.real > _GROWS * np.abs(moving)).sum())


def nyquist_count(loop: Loop, w: _Real, open_poles: _Complex, drifting: int) -> int:
    """Return how many poles of a closed loop with dead time grow.

    With p the poles of the open loop, chi(s) = prod(s - p) (1 + L(s)) has no poles, so that the
    phase of chi(j w) grows by (n - m - 2 Z) pi / 2 from w = 0 to infinity, where Z of its zeros lie
    to the right and m at 0 (Mikhailov's criterion, which is Nyquist's with the poles of the open
    loop counted by their phase). The exponential of the dead time does not change the order n while
    |L| < 1 from the last line on.

    Parameters
    ----------
    loop : callable
        L(s), the dead time exact.
    w : ndarray of float, shape (n_w,)
        Lines in rad/s, from below every pole of the closed loop that is not at 0, to where |L|
        stays below 1.
    open_poles : ndarray of complex, shape (n,)
        Poles of L in rad/s, the dead time left out, those cancelled in it included.
    drifting : int
        Poles of the closed loop at 0, m.

    Raises
    ------
    SolverError
        If |L| is 1 or more at the last line, or the count is not a whole number.
    """
    lines, values = resolved(lambda s: 1.0 + loop(s), w)
    if abs(values[-1] - 1.0) >= 1.0:
        raise SolverError(
            f"the loop gain is still {abs(values[-1] - 1.0):.3g} at {lines[-1] / (2 * np.pi):.4g}"
            " Hz: with dead time its stability cannot be judged; give the controller a low_pass"
        )
    # Poles at 0 are so but for rounding: a double one appears as a pair about it, whose phases add
    # up all the same.
    own = np.angle(1j * lines[:, None] - open_poles).sum(axis=1)
    total = np.unwrap(own + np.angle(values))
    n = len(open_poles)
    start = total[0] - drifting * np.pi / 2.0
    before = start - np.pi * np.round(start / np.pi)  # what it turned below the first line
    after = n * np.pi / 2.0 - own[-1] - float(np.angle(values[-1]))
    turned = total[-1] - total[0] + before + after
    found = float(0.5 * (n - drifting) - turned / np.pi)
    if abs(found - round(found)) > 0.2:
        raise SolverError(
            f"stability with dead time: {found:.3f} poles grow by the turns of the loop function,"
            " which is no whole number; the lines do not reach low enough"
        )
    return round(found)
