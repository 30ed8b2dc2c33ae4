"""Counterparts of the measured modes in the model, found before any update.

A model that shares no mode with the test does not describe the tested structure. Shapes at few
sensors are similar by chance: the MAC of two independent shapes at n sensors has the distribution
Beta(1/2, (n - 1)/2), which gives the expected number of chance pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy.special

from updyn.arrays import IndexArray, RealArray
from updyn.correlation.clusters import PairingRule, pair_clusters, pair_frequencies
from updyn.correlation.model_modes import ModelModes
from updyn.correlation.settings import MODE_PAIRING
from updyn.correlation.shapes import find_moving
from updyn.dofs import Dof, DofSet
from updyn.dynamics.modes import Modes
from updyn.errors import DataError, InputError, SolverError
from updyn.frf import FRF
from updyn.modal import ModeSet, identify_modes
from updyn.modal.peaks import find_resonance_peaks
from updyn.model import Model
from updyn.settings import VARIANTS
from updyn.text_table import format_count
from updyn.updating.judge.claim import Claim
from updyn.updating.judge.settings import COUNTERPARTS, EFFORT
from updyn.variants import build_variants

__all__ = ["Counterparts", "Pair", "find_counterparts", "identify_modes_for", "limit_size"]


@dataclass(frozen=True, slots=True)
class Pair:
    """A measured mode and its counterpart; frequencies in Hz, MAC of subspaces for close modes."""

    measured: float
    computed: float
    mac: float


@dataclass(frozen=True, slots=True)
class Counterparts:
    """Measured modes with a counterpart in the model.

    A counterpart has a MAC of at least one half at the sensors (more if the frequencies differ),
    and a frequency within a factor of 1.5. Numbers are 0 if unknown; `by_chance` is the expected
    number of pairs for a test of another structure. `known` is False if nothing was compared, if
    shapes at so few sensors would pair as often by chance, or if one or two sensors (`doubtful`)
    hide the counterparts. `source` is ``"given"``, ``"identified"`` or ``"peaks"``. `factor` is the
    frequencies of the model over those of the test if most modes agree by shape but none in
    frequency, otherwise 1. `mistake` is one of the model without which most modes have a
    counterpart, `remedy` its correction.
    """

    n_measured: int
    n_paired: int
    pairs: tuple[Pair, ...]
    statement: str
    known: bool
    n_sensors: int = 0
    by_chance: float = 0.0
    source: str = ""
    doubtful: tuple[str, ...] = ()
    factor: float = 1.0
    mistake: str = ""
    remedy: str = ""

    @property
    def none(self) -> bool:
        """Whether model and test are known to have no mode in common."""
        return self.known and self.n_paired == 0 and self.n_sensors > 0 and self.factor == 1.0

    @property
    def few(self) -> bool:
        """Whether the counterparts are known to be no more than expected for another structure."""
        return self.known and not _exceeds_chance(self)

    @property
    def claim(self) -> Claim:
        """Whether the model resembles the test; not asked if the data cannot answer it."""
        return Claim(not self.few if self.known else None, self.statement, asked=self.known)


def find_counterparts(
    model: Model | ModelModes,
    data: FRF | ModeSet,
    modes: ModeSet | None = None,
    *,
    largest: int | None = None,
) -> Counterparts:
    """Find the measured modes that have a counterpart in a model of at most `largest` DOFs."""
    # By default, `largest` is `EFFORT.most_dofs`. Peaks of the mode indicator are compared first,
    # which takes milliseconds; modes are identified only if few peaks have a counterpart. If few
    # modes have one, exchanged section axes, omitted sensors and a common factor on frequencies
    # are tried, because these mistakes do not mean another structure. Modes that cannot be
    # compared raise no error: the statement gives the reason.
    computed = ModelModes(model) if isinstance(model, Model) else model
    model = computed.model
    if model.nonlinear:
        return _unknown_counterparts(
            "Whether model and test have modes in common was not checked: the model has nonlinear"
            " elements, so that its modes depend on the level."
        )
    largest = EFFORT.most_dofs if largest is None else largest
    if model.n_dofs > largest:
        return _unknown_counterparts(
            f"Whether model and test have modes in common was not checked: the model has"
            f" {model.n_dofs:,} DOFs, more than {largest:,}."
        )
    given = modes if modes is not None else data
    try:
        if isinstance(data, FRF):
            computed, measured = computed.hold_base(data)
            given = measured if modes is None else modes
        if isinstance(given, ModeSet):
            return _pair_modes(computed, given, "given")
        if len(given.freq) < COUNTERPARTS.least_lines:
            return _unknown_counterparts(
                f"Whether model and test have modes in common is not known: {len(given.freq)} lines"
                f" do not show resonances (at least {COUNTERPARTS.least_lines} are needed)."
            )
        return _find_in_frfs(computed, given)
    except (InputError, SolverError, np.linalg.LinAlgError) as error:
        return _unknown_counterparts(
            f"Whether model and test have modes in common is not known: {error}."
        )


def _unknown_counterparts(why: str) -> Counterparts:
    return Counterparts(0, 0, (), why, known=False)


def _find_in_frfs(computed: ModelModes, frf: FRF) -> Counterparts:
    """Return the counterparts of the peaks of FRFs, or else of their identified modes."""
    peaks = find_resonance_peaks(frf)
    found = None if peaks is None else _pair_modes(computed, peaks, "peaks")
    if found is not None and not _needs_identification(found):
        return found
    longer = max(len(frf.responses), len(frf.references))
    if longer < COUNTERPARTS.least_sensors:  # shapes cannot be compared, whatever the modes are
        return found or _unknown_counterparts(
            "Whether model and test have modes in common is not known: the FRFs show no resonance"
            " peaks, and shapes at one or two sensors cannot be compared."
        )
    if len(frf.freq) * longer > COUNTERPARTS.most_values_per_reference:
        return _without_identification(found)
    try:
        identified = identify_modes_for(computed.model, limit_size(frf))
    except (InputError, np.linalg.LinAlgError):
        identified = None
    if identified is not None:
        of_modes = _pair_modes(computed, identified, "identified")
        if found is None or of_modes.n_measured >= found.n_measured or of_modes.n_paired:
            return of_modes
    if found is None:
        return _unknown_counterparts(
            "Whether model and test have modes in common is not known: no modes could be identified"
            " from the FRFs."
        )
    return found


def _without_identification(found: Counterparts | None) -> Counterparts:
    """Return the result of peaks alone, which cannot show that the model has few of the modes."""
    if found is not None:
        return _add_statement(replace(found, known=False)) if found.few else found
    most = COUNTERPARTS.most_values_per_reference
    return _unknown_counterparts(
        "Whether model and test have modes in common is not known: the FRFs show no resonance"
        f" peaks, and more than {most:,} values of one force are not searched for modes."
    )


def _needs_identification(found: Counterparts) -> bool:
    """Return whether few peaks have a counterpart and modes must be identified."""
    return found.n_sensors > 0 and found.n_paired < COUNTERPARTS.common_share * found.n_measured


def identify_modes_for(model: Model, frf: FRF) -> ModeSet:
    """Identify the modes of FRFs with the form of damping of a model, viscous or structural."""
    damping = "viscous" if model.viscous.nnz else "structural"
    return identify_modes(frf, damping=damping)


def limit_size(frf: FRF) -> FRF:
    """Return FRFs of a size identified in seconds, with all channels of the longer side."""
    # By reciprocity, both sides excite the modes.
    n_lines, n_responses, n_references = frf.values.shape
    most = max(1, COUNTERPARTS.most_values // (n_lines * max(n_responses, n_references)))
    power = np.abs(frf.values) ** 2
    if n_responses >= n_references:
        return frf.select(references=_choose_strongest(power.sum(axis=1), frf.references, most))
    return frf.select(responses=_choose_strongest(power.sum(axis=2), frf.responses, most))


def _choose_strongest(power: RealArray, dofs: DofSet, most: int) -> list[Dof]:
    """Return at most `most` DOFs that together are strong at every line, for powers (n_f, n)."""
    n = len(dofs)
    level = np.log(np.maximum(power, np.finfo(np.float64).tiny))
    level -= level.max(axis=1, keepdims=True)
    chosen: list[int] = []
    reached = np.full((len(level), 1), level.min())
    while len(chosen) < min(most, n):
        gains = np.maximum(level, reached).mean(axis=0)
        gains[chosen] = -np.inf
        chosen.append(int(np.argmax(gains)))
        reached = np.maximum(reached, level[:, chosen[-1:]])
    return [dofs[i] for i in sorted(chosen)]


# -- comparing ------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class _ModeSets:
    """Computed and measured modes at the same DOFs, with rotations multiplied by one length."""

    computed: Modes
    measured: Modes

    @property
    def n_sensors(self) -> int:
        """Number of sensors at which shapes are compared."""
        n = len(self.measured.dofs)
        return n if n >= COUNTERPARTS.least_sensors else 0

    def without(self, sensors: Sequence[int]) -> _ModeSets:
        """Return the sets without some sensors and without modes that do not move at the others."""
        at = np.setdiff1d(np.arange(len(self.measured.dofs)), sensors)
        return _ModeSets(*(_select_dofs(of, at) for of in (self.computed, self.measured)))

    def scale_frequencies(self, factor: float) -> _ModeSets:
        one = self.computed
        return replace(
            self, computed=Modes(one.frequency / factor, one.loss_factor, one.shapes, one.dofs)
        )

    def count_pairs(self, n_measured: int) -> Counterparts:
        """Return the pairs, without a statement."""
        frequency = self.computed.frequency, self.measured.frequency
        if not (len(frequency[0]) and len(frequency[1])):
            return Counterparts(n_measured, 0, (), "", known=True, n_sensors=self.n_sensors)
        if not self.n_sensors:
            pairs = pair_frequencies(frequency, COUNTERPARTS.frequency_factor - 1.0)
        else:
            rule = PairingRule(COUNTERPARTS.frequency_factor - 1.0)
            shapes = self.computed.shapes, self.measured.shapes
            pairs = pair_clusters(*shapes, frequency, rule).pairs
        found = tuple(
            Pair(float(frequency[1][j]), float(frequency[0][i]), float(value))
            for i, j, value in zip(*pairs, strict=True)
        )
        chance = self._expected_by_chance()
        return Counterparts(
            n_measured,
            len(found),
            found,
            "",
            known=True,
            n_sensors=self.n_sensors,
            by_chance=chance,
        )

    def _expected_by_chance(self) -> float:
        """Return the expected number of chance counterparts for independent shapes."""
        if not self.n_sensors:
            return 0.0
        once = 1.0 - scipy.special.betainc(0.5, 0.5 * (self.n_sensors - 1), MODE_PAIRING.least_mac)
        ratio = self.computed.frequency[:, None] / self.measured.frequency
        most = COUNTERPARTS.frequency_factor
        within = np.sum((ratio <= most) & (ratio >= 1.0 / most), axis=0)
        return float(np.sum(1.0 - (1.0 - once) ** within))


def _select_dofs(of: Modes, at: IndexArray) -> Modes:
    """Return the modes at some of their DOFs, without modes that do not move there."""
    shapes = of.shapes[at]
    move = find_moving(shapes, of.shapes)
    return Modes(of.frequency[move], of.loss_factor[move], shapes[:, move], of.dofs[at])


def _pair_modes(computed: ModelModes, test: ModeSet, source: str) -> Counterparts:
    n = int(np.count_nonzero(test.frequency > 0.0))
    sets = _modes_at_sensors(computed, test)
    found = replace(sets.count_pairs(n), source=source)
    if not sets.n_sensors:
        return _add_statement(replace(found, known=False))
    if _exceeds_chance(found):
        return _add_statement(found)
    variant = _try_variants(computed.model, test, n)
    if variant is not None:
        known = replace(found, mistake=variant.mistake, remedy=variant.remedy)
        return _add_statement(known, variant.counterparts)
    hidden = _try_without_sensors(sets, n)
    if hidden is not None:
        known = replace(
            found, known=False, doubtful=hidden.sensors if hidden.is_significant else ()
        )
        return _add_statement(known, hidden.counterparts)
    scaled = _try_common_factor(sets, n) if found.n_paired == 0 else None
    if scaled is not None:
        known = replace(
            found,
            known=scaled.is_significant,
            factor=scaled.factor if scaled.is_significant else 1.0,
        )
        return _add_statement(known, scaled.counterparts)
    return _add_statement(replace(found, known=_is_too_few(found)))


def _modes_at_sensors(of_model: ModelModes, test: ModeSet) -> _ModeSets:
    elastic = test.frequency > 0.0
    measured = Modes(
        test.frequency[elastic], test.loss_factor[elastic], test.shapes[:, elastic], test.dofs
    )
    highest = float(test.frequency[-1]) * COUNTERPARTS.frequency_factor
    try:
        modes = of_model.undamped(highest)
    except DataError:  # no mode below that limit: use the lowest modes
        modes = of_model.undamped(np.inf)
    match = modes.dofs.match(test.dofs, "DOF of the measured modes")
    shapes = np.asarray(modes.shapes[match.index] * match.sign[:, None])
    move = find_moving(shapes, modes.shapes) if len(test.dofs) else np.ones(len(modes), np.bool_)
    computed = Modes(modes.frequency, modes.loss_factor, shapes, test.dofs).select(move)
    length = _rotation_length(measured)
    weight = np.where(test.dofs.axes >= 3, length, 1.0)[:, None]
    return _ModeSets(
        replace(computed, shapes=computed.shapes * weight),
        replace(measured, shapes=measured.shapes * weight),
    )


def _rotation_length(measured: Modes) -> float:
    """Return the length in m that scales rotations to the rms of translations over all modes."""
    rotates = measured.dofs.axes >= 3
    if rotates.all() or not rotates.any():
        return 1.0
    size = np.abs(measured.shapes) ** 2
    power = [np.mean(size[kind], axis=0) for kind in (~rotates, rotates)]
    is_seen = (power[0] > 0.0) & (power[1] > 0.0)
    if not is_seen.any():
        return 1.0
    return float(np.exp(0.5 * np.mean(np.log(power[0][is_seen] / power[1][is_seen]))))


def _is_too_few(found: Counterparts) -> bool:
    """Return whether the number of pairs is improbably small for the modelled structure."""
    n, k, share = found.n_measured, found.n_paired, COUNTERPARTS.common_share
    return float(scipy.special.bdtr(k, n, share)) < COUNTERPARTS.few_level


def _exceeds_chance(found: Counterparts, n_trials: int = 1) -> bool:
    """Return whether the number of pairs, of several trials, is improbable by chance."""
    n, k = found.n_measured, found.n_paired
    if not k or not n:
        return False
    by_chance = float(scipy.special.bdtrc(k - 1, n, min(found.by_chance / n, 1.0)))
    return by_chance < COUNTERPARTS.chance_level / n_trials


def _pairs_most(found: Counterparts) -> bool:
    return found.n_paired >= COUNTERPARTS.explained_share * found.n_measured


@dataclass(frozen=True, slots=True)
class _Hypothesis:
    """Counterparts of most modes under an assumed fault: sensors left out, a factor, or a mistake.

    `is_significant` takes the number of trials into account; `factor` is on all frequencies of the
    model.
    """

    counterparts: Counterparts
    is_significant: bool
    sensors: tuple[str, ...] = ()
    factor: float = 1.0
    mistake: str = ""
    remedy: str = ""


def _try_variants(model: Model, test: ModeSet, n_measured: int) -> _Hypothesis | None:
    """Return the counterparts in the best variant of a model; None if these are few."""
    if model.n_dofs > VARIANTS.largest_model:
        return None
    variants = build_variants(model)
    best: _Hypothesis | None = None
    for variant in variants:
        try:
            found = _modes_at_sensors(ModelModes(variant.model()), test).count_pairs(n_measured)
        except (InputError, SolverError):
            continue
        if best is None or found.n_paired > best.counterparts.n_paired:
            is_significant = _exceeds_chance(found, len(variants))
            best = _Hypothesis(
                found, is_significant, mistake=variant.mistake, remedy=variant.remedy
            )
    if best is None or not best.is_significant:
        return None
    return best if _pairs_most(best.counterparts) else None


def _try_without_sensors(sets: _ModeSets, n_measured: int) -> _Hypothesis | None:
    """Return the counterparts with the fewest sensors left out; None if sensors hide none."""
    n, n_tried = len(sets.measured.dofs), 0
    best: tuple[tuple[int, ...], Counterparts] | None = None
    for number in range(1, COUNTERPARTS.most_faulty + 1):
        if n - number < COUNTERPARTS.least_remaining:
            break
        for choice in _sensor_subsets(n, number, best):
            found = sets.without(choice).count_pairs(n_measured)
            n_tried += 1
            if best is None or found.n_paired > best[1].n_paired:
                best = choice, found
        if best is not None and _pairs_most(best[1]):
            names = tuple(str(abs(sets.measured.dofs[k])) for k in best[0])
            return _Hypothesis(best[1], _exceeds_chance(best[1], n_tried), names)
    return None


def _sensor_subsets(
    n: int, number: int, best: tuple[tuple[int, ...], Counterparts] | None
) -> list[tuple[int, ...]]:
    """Return the sensors to leave out: each one, or all pairs, or pairs with the best one."""
    if number == 1 or n <= COUNTERPARTS.all_pairs_sensors or best is None:
        return list(combinations(range(n), number))
    (first,) = best[0]
    return [(first, k) for k in range(n) if k != first]


def _try_common_factor(sets: _ModeSets, n_measured: int) -> _Hypothesis | None:
    """Return the counterparts by shape with a common factor on all frequencies, if there is one."""
    # A factor near 1 may be explained by the unknowns, and is accepted even if the number of pairs
    # does not exceed chance.
    step, most = COUNTERPARTS.frequency_factor, COUNTERPARTS.most_power
    powers = [k for k in range(-most, most + 1) if k]
    trials = [(k, sets.scale_frequencies(step**k).count_pairs(n_measured)) for k in powers]
    power, best = max(trials, key=lambda one: (one[1].n_paired, -abs(one[0])))
    if not _pairs_most(best):
        return None
    is_significant = _exceeds_chance(best, len(powers))
    if not is_significant and abs(power) > COUNTERPARTS.near_power:
        return None
    ratios = [step**power * pair.computed / pair.measured for pair in best.pairs]
    return _Hypothesis(best, is_significant, factor=float(np.median(ratios)))


# -- stating --------------------------------------------------------------------------------------
_NOUNS = {
    "given": ("measured mode", "measured modes"),
    "identified": ("measured mode", "measured modes"),
    "peaks": ("resonance peak of the test", "resonance peaks of the test"),
}


def _add_statement(found: Counterparts, other: Counterparts | None = None) -> Counterparts:
    return replace(found, statement=_compose_statement(found, other))


def _compose_statement(found: Counterparts, other: Counterparts | None) -> str:
    n, k = found.n_measured, found.n_paired
    one, more = _NOUNS[found.source]
    count = f"{k} of {n} {one if n == 1 else more} {'has' if k == 1 else 'have'}"
    within = f"within a factor of {COUNTERPARTS.frequency_factor:g} in frequency"
    if not found.n_sensors:
        least = format_count(COUNTERPARTS.least_sensors, "sensor")
        return (
            f"{count} a mode of the model {within}; whether shapes agree is not known, as that"
            f" takes at least {least}."
        )
    head = f"{count} a counterpart in the model"
    if other is not None and found.mistake:
        return f"{head}, but {other.n_paired} of {n} have one in a variant: {found.mistake}."
    if other is not None and found.doubtful:
        whose = "this sensor" if len(found.doubtful) == 1 else "these sensors"
        return (
            f"{head}, but {other.n_paired} of {n} without {' and '.join(found.doubtful)}: the sign,"
            f" scale or place of {whose} may be wrong."
        )
    if other is not None and found.factor != 1.0:
        return (
            f"{head} {within}, but {other.n_paired} of {n} have one by shape, at about"
            f" {found.factor:.2g} times the measured frequency: the units of the model, or all its"
            " stiffnesses or masses, may be wrong."
        )
    sensors = format_count(found.n_sensors, "sensor")
    if not found.known:
        return (
            f"{head}; {n} {one if n == 1 else more} at {sensors} are too few to decide whether that"
            " is more than for another structure."
        )
    if found.n_paired and found.few:
        return (
            f"{head}: as few as shapes of another structure would have at {sensors}"
            f" ({found.by_chance:.1f} on average)."
        )
    return f"{head}."
