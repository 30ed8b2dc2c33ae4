"""`accept`: acceptance of a model by the limits of a standard."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from updyn.acceptance.checks import Checks
from updyn.acceptance.comparison import ModesCompared
from updyn.acceptance.computed import ComputedModes
from updyn.acceptance.effective_mass import DIRECTION_NAMES
from updyn.acceptance.limits import AcceptanceLimits
from updyn.acceptance.result import Acceptance
from updyn.acceptance.settings import MODEL_ACCEPTANCE
from updyn.acceptance.standards import find_limits
from updyn.correlation.settings import MODE_PAIRING
from updyn.errors import DataError, OptionError
from updyn.frf import FRF, check_band
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.uncertainty.counts import check_level
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.posterior import find_update
from updyn.updating.modes import find_measured_modes
from updyn.updating.result import JointResult, UpdateResult, find_result

__all__ = ["accept", "check_directions"]


def accept(
    source: UpdateResult | JointResult | Draws | Model,
    modes: ModeSet | None = None,
    standard: str | AcceptanceLimits = "NASA-STD-5002",
    *,
    band: tuple[float, float] | None = None,
    leave_out: Sequence[float] = (),
    fundamental: Sequence[int] | None = None,
    directions: str = DIRECTION_NAMES,
    std_frequency: float | None = None,
    std_shapes: float | None = None,
    least_probability: float | None = None,
    test: str | None = None,
    tier: str | None = None,
) -> Acceptance:
    """Compare a model with measured modes by the limits of a standard.

    Parameters
    ----------
    source : UpdateResult, JointResult, Draws or Model
        An update, with the uncertainty of its unknowns; draws of a bootstrap or a sampling; or a
        model as it is, such as `result.model`.
    modes : ModeSet, optional
        The measured modes; required for a model. By default those that were given to the update, or
        those that are identified from its FRFs (`updyn.identify_modes`).
    standard : {"NASA-STD-5002", "ECSS-E-ST-32-11C"} or AcceptanceLimits
        The limits.
    band : (float, float), optional
        Band in Hz in which modes are compared. By default that of the FRFs if the modes are
        identified from them, else from 0 to the highest measured frequency and 0.6 % above it.
    leave_out : sequence of float
        Frequencies in Hz, to 0.6 %, of measured modes that are not compared, such as those in a
        direction that the model does not have. The notes list them.
    fundamental : sequence of int, optional
        Numbers, from 1 by ascending frequency, of the measured modes in the band that are
        fundamental modes. By default the first.
    directions : str
        Those of X, Y and Z along which the structure can be accelerated by its base and for which
        the DOFs of the model have these directions in space. ``""``: effective masses are not
        computed.
    std_frequency, std_shapes : float, optional
        Standard deviations to assume for measured modes without known ones: of the frequency as a
        share, of each component of a shape as a share of its rms.
    least_probability : float, optional
        Decide by the probability of passing: a requirement passes if it is at least this, fails if
        that of failing is, and is not decidable otherwise. By default the values as measured are
        compared with the limits, as standards do.
    test, tier
        As in `updyn.predict_modes`.

    Returns
    -------
    Acceptance

    Raises
    ------
    DataError
        If there are no measured modes, in the band or at all, the model has none there, or a
        measured mode is at 0 Hz.
    OptionError
        If the standard is unknown, or an option is not understood.
    DofError
        If a DOF of the measured modes is not in the model.
    SolverError
        If the modes cannot be computed.

    Notes
    -----
    Undamped modes of the model are compared with the real parts of the measured shapes. The modes
    are paired as in `updyn.correlate`; close ones are compared by the subspaces of their shapes.
    The mass for cross-orthogonality is condensed statically to the sensors (R. J. Guyan, AIAA J. 3
    (1965) 380), and its error is that of the modes of the model with each other.

    Probabilities: of frequencies and similarities with other modes by normal distributions (delta
    method), the latter shrunk towards zero by their variance over all modes (C. N. Morris, J. Am.
    Stat. Assoc. 78 (1983) 47-55). Errors of shapes lower MAC and the cross-orthogonality of a pair
    on average, which the confidence distribution of a noncentral chi-square variable takes into
    account (M. Xie & K. Singh, Int. Stat. Rev. 81 (2013) 3-39). If the measured modes are data of
    the update, errors that both have in common are counted twice in `Requirement.probability`,
    which is then closer to one half than necessary; `Requirement.probability_as_delivered` is free
    of this. Errors of the model that the measured modes do not show are not covered.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> limits = updyn.AcceptanceLimits(frequency=0.05, mac=0.9)
    >>> found = updyn.accept(result, updyn.identify_modes(frf), limits)
    >>> found.outcome, found.requirements[1].text()[:9]
    ('pass', 'frequency')
    """
    limits = find_limits(standard)
    _check_shares(std_frequency=std_frequency, std_shapes=std_shapes)
    if least_probability is not None:
        check_level(least_probability, "least_probability")
    result = None if isinstance(source, Model) else find_result(find_update(source), test)
    measured = modes
    if measured is None and result is not None:
        measured = find_measured_modes(result)
        if band is None and isinstance(result.data, FRF):
            band = float(result.data.freq[0]), float(result.data.freq[-1])
    if not isinstance(measured, ModeSet):
        raise DataError(f"accept: expected measured modes, found {type(measured).__name__}")
    low, high = _choose_band(band, measured)
    measured = measured.select(band=(low, high))
    if (measured.frequency == 0.0).any():
        raise DataError("accept: a measured mode at 0 Hz is a rigid-body motion; state a band")
    measured, omitted = _leave_out(measured, leave_out)
    numbers = _check_numbers(fundamental, len(measured))
    check_directions(directions)
    reach = max(high, float(measured.frequency[-1]) * (1.0 + MODE_PAIRING.frequency_gate))
    if isinstance(source, Model):
        computed = ComputedModes.of_model(source, reach)
    else:
        assert result is not None
        computed = ComputedModes.of_update(source, result, reach, tier)
    compared = ModesCompared.of(
        computed, measured, (std_frequency, std_shapes), (low, high), directions
    )
    checks = Checks(compared, limits, numbers, least_probability)
    title = computed.model.title if result is None else result.title
    notes = (*_list_notes(computed, compared, limits), *omitted)
    return Acceptance(limits, tuple(checks.list_requirements()), title, notes, least_probability)


def _choose_band(band: tuple[float, float] | None, measured: ModeSet) -> tuple[float, float]:
    """Return the band in Hz; by default up to the highest measured frequency or close above it."""
    if band is not None:
        return check_band(band)
    return 0.0, float(measured.frequency[-1]) * (1.0 + MODE_PAIRING.close_frequencies)


def _check_shares(**given: float | None) -> None:
    """Raise OptionError if an assumed standard deviation is not a share."""
    for name, value in given.items():
        if value is not None and not 0.0 < value < 1.0:
            raise OptionError(
                f"{name} = {value!r}: expected a share between 0 and 1, such as 0.01", key=(name,)
            )


def _leave_out(measured: ModeSet, frequencies: Sequence[float]) -> tuple[ModeSet, list[str]]:
    """Return the modes without those at some frequencies in Hz, and a note on these."""
    omitted = set()
    for given in frequencies:
        nearest = int(np.argmin(np.abs(measured.frequency - given)))
        found = float(measured.frequency[nearest])
        if abs(found - given) > MODE_PAIRING.close_frequencies * found:
            raise OptionError(
                f"leave_out: no measured mode at {given:g} Hz; the nearest is at {found:.6g} Hz",
                key=("leave_out",),
            )
        omitted.add(nearest)
    if not omitted:
        return measured, []
    listed = ", ".join(f"{measured.frequency[k]:#.5g}" for k in sorted(omitted))
    kept = [k for k in range(len(measured)) if k not in omitted]
    return measured.select(kept), [f"Measured modes left out by the user: {listed} Hz."]


def _check_numbers(fundamental: Sequence[int] | None, n: int) -> tuple[int, ...]:
    """Return numbers of measured modes from 1; OptionError if one does not exist."""
    if fundamental is None:
        return tuple(range(1, MODEL_ACCEPTANCE.fundamental_modes + 1))
    for number in fundamental:
        if (
            isinstance(number, bool)
            or not isinstance(number, int | np.integer)
            or not 1 <= number <= n
        ):
            raise OptionError(
                f"fundamental: mode {number!r}; expected numbers from 1 to {n}, that of the"
                " measured modes in the band",
                key=("fundamental",),
            )
    return tuple(int(number) for number in fundamental)


def check_directions(directions: str) -> None:
    """Raise OptionError unless a text has only X, Y and Z."""
    if not isinstance(directions, str) or not set(directions) <= set(DIRECTION_NAMES):
        raise OptionError(
            f"directions {directions!r}: expected some of X, Y and Z in one text, such as 'XY'",
            key=("directions",),
        )


def _list_notes(
    computed: ComputedModes, compared: ModesCompared, limits: AcceptanceLimits
) -> list[str]:
    """Return remarks on the comparison."""
    notes = list(compared.correlation.notes())
    if limits.effective_mass is None and limits.mass_met is None:
        return notes
    if computed.is_free:
        notes.append("The structure is free: effective masses need a base, and are not known.")
    elif compared.masses is None:
        notes.append("The model has no mass along the directions: effective masses are not known.")
    return notes
