"""`correlate`: compare FRFs with FRFs, modes with modes, or a model with either."""

from __future__ import annotations

from typing import Any, overload

from updyn.correlation.frfs import Correlation, correlate_frfs
from updyn.correlation.modes import ModeCorrelation, ModesLike, correlate_modes
from updyn.errors import DataError, suggest
from updyn.frf import FRF
from updyn.model import Model

__all__ = ["correlate"]

_OPTIONS = ("band", "gate", "least_mac", "close", "dofs")


@overload
def correlate(computed: Model | FRF, measured: FRF) -> Correlation: ...
@overload
def correlate(
    computed: Model | ModesLike, measured: ModesLike, **options: object
) -> ModeCorrelation: ...
def correlate(computed: Any, measured: Any, **options: Any) -> Correlation | ModeCorrelation:
    """Compare a model, computed FRFs or computed modes with measured FRFs or modes.

    Parameters
    ----------
    computed : Model, FRF, Modes or ModeSet
        For a model, the response at the lines and DOFs of a measured FRF, or the modes, are
        computed. An FRF must have the same lines and DOFs as the measured one; their order and
        signs may differ, and the quantity is converted.
    measured : FRF, ModeSet or Modes
        The measured data.
    **options
        For modes: ``band``, ``gate``, ``least_mac``, ``close`` and ``dofs``, see
        `updyn.correlation.modes.correlate_modes`.

    Returns
    -------
    Correlation or ModeCorrelation
        A `ModeCorrelation` for modes.

    Raises
    ------
    DataError
        If the two cannot be compared, such as FRFs with different lines or DOFs; the message gives
        the difference. Nothing is interpolated.
    DofError
        If a DOF of `measured` is not in the model or the computed modes.
    ModelError, SolverError
        If the model cannot be solved.

    Warns
    -----
    UpdynWarning
        If model and FRF have positions, and nodes with equal numbers are far apart; or if the model
        is free, so that a line at 0 Hz is left out.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> found = updyn.correlate(chain.build(), chain.measure())
    >>> found.frac.shape  # responses, references
    (5, 2)
    """
    if isinstance(measured, ModesLike):
        for name in options:
            if name not in _OPTIONS:
                raise DataError(f"correlate: option {name!r}; {suggest(name, _OPTIONS)}")
        return correlate_modes(computed, measured, **options)
    if options:
        raise DataError(f"correlate: {next(iter(options))} is an option for modes, not for FRFs")
    return correlate_frfs(computed, measured)
