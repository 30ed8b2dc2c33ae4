"""`diagnose`: faults of measured data, found with a model that is nearly right."""

from __future__ import annotations

from collections.abc import Mapping

from updyn.errors import OptionError, ParameterError
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.judge.causes.data_alone import find_data_faults
from updyn.updating.judge.causes.diagnosis import find_causes
from updyn.updating.judge.causes.finding import Finding, Findings
from updyn.updating.problem.data import Test, check_tests, leave_out_undefined_line
from updyn.updating.problem.noise import NoiseModel, choose_noise
from updyn.updating.problem.parameters import ParameterSet, parameters
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.selection import Selection
from updyn.updating.problem.session import RecentCache, Session

__all__ = ["diagnose"]


def diagnose(
    model: Model,
    frf: FRF,
    unknowns: ParameterSet | Selection | None = None,
    *,
    noise: Mapping[str, float | str] | str | NoiseModel | None = None,
    tier: str | None = None,
    backend: str | None = None,
) -> tuple[Finding, ...]:
    """Search for faults of the data that explain them better than the unknowns of the model can.

    Faults are a wrong quantity or unit, a wrong sign, exchanged or misplaced sensors, calibration,
    delay, and others (docs/verdict.md). Each is tested against the model while all unknowns adapt,
    and the likeliest are confirmed by a short fit. The data are not changed: `Finding.repair`
    returns them without the fault. With nonlinear elements, only those faults are found that the
    data show without a model.

    Parameters
    ----------
    model : Model
        The model before any update, with errors up to some tens of per cent.
    frf : FRF
        The measurement. Every response and reference has to be a DOF of the model.
    unknowns : ParameterSet or Selection, optional
        Quantities of the model that may be wrong; by default stiffness, mass and loss factor of all
        groups.
    noise : None, str, mapping or NoiseModel
        As for `update`, or the noise model of these FRFs.
    tier, backend : str, optional
        As for `update`. Models with more than some hundred degrees of freedom are always reduced.

    Returns
    -------
    tuple of Finding
        The likeliest first; a notebook shows it as a table. Empty if no fault is
        found at odds of 100 to 1.

    Raises
    ------
    InputError
        If model, data, unknowns or options do not fit together.
    SolverError
        If the model has to be reduced and cannot be solved at its start.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> updyn.diagnose(model, frf, unknowns)
    ()
    """
    if not isinstance(frf, FRF):
        raise OptionError(f"diagnose: expected FRFs, found {type(frf).__name__}")
    if unknowns is None:
        unknowns = _all_unknowns(model)
    selection = Selection.of(unknowns)
    test = Test(selection.start_of(model), frf)
    check_tests([test], selection.parameters)
    test = leave_out_undefined_line(test)
    exact = None if tier == "reduced" else tier
    session = Session(cache=RecentCache())
    part = FRFPart.build(
        test.model, test.frf, selection.parameters, tier=exact, backend=backend, session=session
    )
    noise_of_data = choose_noise(noise, test.frf)
    if not part.forward.is_linear:
        return Findings(find_data_faults(part, noise_of_data))
    return Findings(find_causes(part, noise_of_data))


def _all_unknowns(model: Model) -> ParameterSet:
    """Return stiffness, mass and loss factor of all groups that have them."""
    stiff = [name for name, group in model.groups.items() if group.stiffness is not None]
    heavy = [name for name, group in model.groups.items() if group.mass is not None]
    if not stiff and not heavy:
        raise ParameterError("diagnose: no group has a stiffness or a mass; name the unknowns")
    return parameters(model, stiffness=stiff, mass=heavy, loss_factor=stiff)
