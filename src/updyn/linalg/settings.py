"""Numbers that decide whether the solution of a sparse system is accepted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SparseSolverSettings:
    """Checks and refinement of solutions."""

    #: [1] Largest accepted backward error in double precision; above it, another backend is tried.
    #: Why: half the digits of double precision, far above the error of a stable factorisation.
    backward_error: float = 1e-8
    #: [1] Largest accepted backward error with factors in single precision. Why: a few digits above
    #: the rounding of single precision (6e-8); refinement reaches the error that the caller
    #: permits.
    single_backward_error: float = 1e-4
    #: [1] Growth of a solution relative to its right-hand side above which the matrix counts as
    #: singular. Rounding: 12 of 16 digits are lost.
    largest_growth: float = 1e12
    #: [1] The same for a load that excites every mode. Rounding: at a natural frequency it grows by
    #: 1e14 or more, depending on the BLAS kernel; the forces of a test may grow by less than 1e12
    #: if they hardly excite that mode.
    largest_probe_growth: float = 1e13
    #: [1] Share of the error that remains after a refinement step, up to which factors in single
    #: precision are used. Why: refinement converges, and no eigenvalue changes its sign.
    largest_remaining_share: float = 0.2
    #: [steps] Largest number of refinement steps. Effort: the largest remaining share to this power
    #: is 1e-14.
    most_refinements: int = 20
    #: [eps] Rounding errors of a residual, which refinement cannot reduce, times the growth.
    #: Rounding: a rule of thumb.
    residual_rounding: float = 4.0
    #: [1] Ratio of the diagonal entries from which the message on a singular matrix names
    #: stiffnesses that are too far apart. Why: rotations in N m/rad and translations in N/m reach a
    #: part of it.
    named_stiffness_ratio: float = 1e9
    #: [columns] Columns that one random combination checks (Freivalds, 1977). Effort: the check
    #: takes the time of one column; the bound of the error grows with their number.
    columns_per_check: int = 64
    #: [entries] Largest product of a matrix with a vector that is computed in one call. Effort:
    #: BLAS then uses one thread (OpenBLAS: up to 9216 entries).
    one_thread_entries: int = 8192
    #: [numbers] Numbers that are compared in one step. Effort: they fit into the processor's cache.
    cached_numbers: int = 2**15
    #: [entries] Rows or entries of a pattern that are processed in one step. Effort: index arrays
    #: of all entries would take as much memory as the matrix.
    entries_per_step: int = 2**18
    #: [1] Size below which cuDSS perturbs pivots of a matrix with unit diagonal; such a
    #: factorisation fails. Why: 13 of 16 digits are lost.
    smallest_pivot: float = 1e-13


SPARSE_SOLVER = SparseSolverSettings()
