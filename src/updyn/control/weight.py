"""Deviation of the members of a family from its nominal plant, on lines that resolve resonances."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.control.family import PlantFamily
from updyn.control.lines import channel_zeros, dense_lines, sweep
from updyn.control.plant import Plant
from updyn.control.ports import find_index
from updyn.control.settings import POLES, UNCERTAINTY_WEIGHT
from updyn.control.weight_fit import Bound, Weight, bound_roots, fit_above
from updyn.errors import ModelError, OptionError, suggest
from updyn.frf import check_lines

__all__ = [
    "KINDS",
    "UncertaintyWeight",
    "Weight",
    "channel_floors",
    "channel_indices",
    "family_lines",
    "family_radius",
    "find_closest_lines",
    "refuse_unbounded",
    "refuse_undamped",
    "uncertainty_weight",
]


_NO_ROOTS = np.zeros(0, dtype=np.complex128)


def _name(number: int) -> str:
    return "the nominal plant" if number == 0 else f"member {number - 1}"


def refuse_undamped(roots: list[ComplexArray]) -> None:
    """Raise ModelError if a plant has undamped poles (rad/s), except at 0, or unstable ones."""
    for number, poles in enumerate(roots):
        size = np.abs(poles)
        moving = size > POLES.zero_share * max(float(size.max(initial=0.0)), np.finfo(float).tiny)
        if (poles.real[moving] > POLES.undamped_ratio * size[moving]).any():
            raise ModelError(
                f"{_name(number)} has a pole in the right half plane: a bound on the deviation"
                " then does not determine stability"
            )
        bad = np.flatnonzero(moving & (np.abs(poles.real) <= POLES.undamped_ratio * size))
        if bad.size:
            raise ModelError(
                f"{_name(number)} has an undamped resonance at {size[bad[0]] / (2 * np.pi):.6g} Hz,"
                " where the deviation is unbounded; give the model damping"
            )


def family_lines(family: PlantFamily, poles: list[ComplexArray]) -> RealArray:
    """Return lines in Hz, shape (n_f,), dense around the poles and zeros of all plants."""
    plants = (family.nominal, *family.members)
    fastest = max(float(np.abs(p).max(initial=0.0)) for p in poles)
    high = max(2 * np.pi * family.nominal.band[1], fastest)
    still = POLES.zero_share * high
    zeros = [[_finite(p, i, j, still, high) for i, j in channel_indices(family)] for p in plants]
    every = np.concatenate(poles)
    moving = every[np.abs(every) > still]
    slowest = float(np.abs(moving).min(initial=high))
    first = 2 * np.pi * family.nominal.band[0]
    if first > 0:
        slowest = min(slowest, first)
    sharp = [moving, *zeros[0]]
    others = list(chain.from_iterable(zeros[1:]))
    factor = UNCERTAINTY_WEIGHT.band_factor
    return dense_lines(sharp, others, slowest / (2 * np.pi * factor), high * factor / (2 * np.pi))


def channel_indices(family: PlantFamily) -> list[tuple[int, int]]:
    """Return the indices of output and input of every channel."""
    return list(np.ndindex(len(family.outputs), len(family.inputs)))


def _finite(plant: Plant, i: int, j: int, low: float, high: float) -> ComplexArray:
    zeros = channel_zeros(plant, i, j)
    size = np.abs(zeros)
    return np.asarray(zeros[(size > low) & (size < UNCERTAINTY_WEIGHT.band_factor * high)])


def family_radius(family: PlantFamily, lines: RealArray, kind: str) -> RealArray:
    """Return the largest deviation l over the members, shape (n_f, n_y, n_u)."""
    G = sweep(family.nominal, lines)
    largest = np.zeros(G.shape)
    for member in family.members:
        np.maximum(largest, np.abs(sweep(member, lines) - G), out=largest)
    if kind == "additive":
        return largest
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(largest > 0.0, largest / np.abs(G), 0.0)


def refuse_unbounded(family: PlantFamily, lines: RealArray, radius: RealArray, kind: str) -> None:
    """Raise ModelError for imaginary zeros of the nominal plant that members lack."""
    if np.isfinite(radius).all() and kind == "additive":
        return
    for i, j in channel_indices(family):
        zeros = channel_zeros(family.nominal, i, j)
        size = np.abs(zeros)
        inside = (size > 2 * np.pi * lines[0]) & (size < 2 * np.pi * lines[-1])
        bad = size[inside & (np.abs(zeros.real) <= POLES.undamped_ratio * size)] / (2 * np.pi)
        for f in bad:
            if family_radius(family, np.array([f * (1 + 1e-9)]), kind)[0, i, j] > 1e3:
                raise ModelError(
                    f"{family.outputs[i]} / {family.inputs[j]}: the nominal plant has an undamped"
                    f" antiresonance at {f:.6g} Hz, where the multiplicative radius is unbounded;"
                    " use kind='additive'"
                )
        if not np.isfinite(radius[:, i, j]).all():
            at = lines[np.flatnonzero(~np.isfinite(radius[:, i, j]))[0]]
            raise ModelError(
                f"{family.outputs[i]} / {family.inputs[j]}: the nominal plant has no response at"
                f" {at:.6g} Hz while members do: the multiplicative radius is unbounded; use"
                " kind='additive'"
            )


def channel_floors(
    family: PlantFamily, radius: RealArray, kind: str, floor: float | None
) -> RealArray:
    """Return the floor of each channel; 0 if the members equal the nominal plant."""
    peak = radius.max(axis=0)
    if floor is not None:
        lowest = np.full(peak.shape, floor)
    elif kind == "multiplicative":
        lowest = np.full(peak.shape, family.nominal.tolerance)
    else:
        lowest = 1e-3 * peak
    return np.where(peak > 0.0, lowest, 0.0)


def find_closest_lines(
    lines: RealArray,
    radius: RealArray,
    floors: RealArray,
    bounds: dict[tuple[int, int], Bound],
    within: float,
) -> RealArray:
    """Return additional lines in Hz where weights are closest to their radius, `within` log |W|."""
    more: list[RealArray] = []
    for (i, j), bound in bounds.items():
        level = np.maximum(radius[:, i, j], floors[i, j])
        close = np.log(level) - bound.log_magnitude(2 * np.pi * lines)
        inner = np.flatnonzero((close[1:-1] >= close[:-2]) & (close[1:-1] >= close[2:])) + 1
        inner = inner[close[inner] > close.max() - within]
        closest = np.argsort(-close[inner], kind="stable")[: UNCERTAINTY_WEIGHT.most_places]
        n = UNCERTAINTY_WEIGHT.gap_parts + 1
        for k in inner[closest]:
            more.append(np.linspace(lines[k - 1], lines[k], n)[1:-1])
            more.append(np.linspace(lines[k], lines[k + 1], n)[1:-1])
    return np.setdiff1d(np.concatenate(more), lines) if more else np.zeros(0)


KINDS = ("multiplicative", "additive")


@dataclass(frozen=True, slots=True, eq=False)
class UncertaintyWeight:
    """Deviation of the members from the nominal plant, and weights above it, one per channel.

    `radius`, shape (n_f, n_outputs, n_inputs), is the largest deviation over the members at `freq`
    in Hz: |G_k - G_0| / |G_0| if `kind` is ``"multiplicative"``, |G_k - G_0| in the unit of the
    channel if ``"additive"``. `floor`, shape (n_outputs, n_inputs), is its lower limit. `weights`
    are by output and input.
    """

    kind: str
    freq: RealArray
    radius: RealArray
    floor: RealArray
    weights: tuple[tuple[Weight, ...], ...]
    outputs: tuple[str, ...]
    inputs: tuple[str, ...]

    def __repr__(self) -> str:
        orders = sorted({w.order for row in self.weights for w in row})
        return (
            f"UncertaintyWeight({self.kind}, {len(self.outputs)} x {len(self.inputs)} channels,"
            f" orders {orders})"
        )

    def at(self, freq: ArrayLike) -> ComplexArray:
        """Return the weights at lines in Hz, shape (n_f, n_outputs, n_inputs)."""
        rows = [np.stack([w.at(freq) for w in row], axis=1) for row in self.weights]
        return np.stack(rows, axis=1)

    def channel(self, output: str, input: str) -> Weight:
        """Return the weight between two named ports; raises OptionError for an unknown name."""
        i = find_index(output, self.outputs, "output", "weight")
        return self.weights[i][find_index(input, self.inputs, "input", "weight")]

    def summary(self) -> str:
        """Return order, closeness and notes of each channel's weight as text."""
        lines = [
            f"Uncertainty, {self.kind}: {len(self.freq)} lines from {self.freq[0]:.3g} to"
            f" {self.freq[-1]:.3g} Hz"
        ]
        for output, row in zip(self.outputs, self.weights, strict=True):
            for input_, w in zip(self.inputs, row, strict=True):
                close = (
                    f"order {w.order}, at most {w.largest:.3g} times the radius, {w.mean:.3g} in"
                    " the mean"
                )
                most = f"largest radius {w.peak:.3g} at {w.peak_at:.4g} Hz"
                lines.append(f"{output} / {input_}: {close}; {most}. {w.note}".rstrip())
        return "\n".join(lines)


def uncertainty_weight(
    family: PlantFamily,
    freq: ArrayLike | None = None,
    *,
    order: int | None = None,
    kind: str = "multiplicative",
    tolerance: float = 0.25,
    largest_order: int = 8,
    floor: float | None = None,
) -> UncertaintyWeight:
    """Return weights that bound the deviation of a family's members from its nominal plant.

    Parameters
    ----------
    family : PlantFamily
        Continuous plants without poles in the right half plane.
    freq : array_like of float, shape (n_f,), optional
        Lines in Hz, above 0; the weight bounds the radius at these, but not between them. By
        default lines dense around the poles and zeros of all plants, over all their frequencies and
        beyond their band; lines are added until the weight also bounds the radius between them.
    order : int, optional
        Order of each weight; by default the lowest of 0, 1, 2, 4, 6 ... that meets `tolerance`.
    kind : {"multiplicative", "additive"}
        G_k = G_0 (1 + W Delta), or G_k = G_0 + W Delta, |Delta| <= 1, by channel.
    tolerance : float
        Largest mean of |W| / l over log frequency, less 1.
    largest_order : int
        Highest order of the search; if it does not meet `tolerance`, the best weight is returned
        with a note.
    floor : float, optional
        Lower limit of the radius: by default the tolerance of the plant for the multiplicative one
        (usually 2 %), and a thousandth of its largest value in the channel for the additive one.

    Returns
    -------
    UncertaintyWeight

    Raises
    ------
    OptionError
        If an option is invalid.
    DataError
        If the lines are not increasing and above 0.
    ModelError
        If the plants are sampled, one has an undamped pole or one in the right half plane, or the
        radius is unbounded because of an undamped antiresonance of the nominal plant.

    Notes
    -----
    Radius and weight: Skogestad & Postlethwaite, Multivariable Feedback Control, 2nd ed. 2005,
    section 7.4. All plants have the same number of poles in the right half plane (none). So a
    controller K that is stable with G_0 is stable with each member if |W T| < 1 at all lines, T =
    G_0 K / (1 + G_0 K); for the additive kind, |W K / (1 + G_0 K)| < 1 (Doyle, Francis &
    Tannenbaum, Feedback Control Theory, 1992, section 4.2). This holds for one controlled channel,
    or for each of several while the others remain unchanged. The members are draws: the bound holds
    for them, and for their distribution as far as they represent it.

    A small shift of a sharp antiresonance of G_0, or of a resonance by more than its width, makes
    the multiplicative radius large at this frequency, even if the plant is otherwise well known,
    because the deviation is bounded regardless of phase. The note of the channel names the
    frequency. A loop, such as one from a motor to its own speed, may be stable with every member
    without |W T| < 1; `updyn.servo` evaluates each member.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> family = updyn.plant_family(result, ["12:X"], ["12:X"], (0.5, 6.0), n=3)
    >>> weight = updyn.uncertainty_weight(family, order=1)
    >>> len(weight.weights)
    1
    """
    _check(family, order, kind, tolerance, largest_order, floor)
    roots = [p.poles for p in (family.nominal, *family.members)]
    refuse_undamped(roots)
    given = None
    if freq is not None:
        given = _positive_lines(freq)
    lines = given
    if lines is None:
        lines = family_lines(family, roots)
    channels = channel_indices(family)
    radius = family_radius(family, lines, kind)
    refuse_unbounded(family, lines, radius, kind)
    floors = channel_floors(family, radius, kind, floor)
    bounds = {}
    for at in channels:
        if floors[at] > 0:
            bounds[at] = _fit(lines, radius, floors, at, order, tolerance, largest_order)
    for left in range(UNCERTAINTY_WEIGHT.refinements - 1 if given is None else -1, -1, -1):
        within = UNCERTAINTY_WEIGHT.close_distance * 5.0**left
        more = find_closest_lines(lines, radius, floors, bounds, within)
        if not more.size:
            break
        merged = np.concatenate([lines, more])
        radius = np.concatenate([radius, family_radius(family, more, kind)])
        ascending = np.argsort(merged, kind="stable")
        lines, radius = merged[ascending], radius[ascending]
        # The last refinements do not fit the weight again.
        for at, bound in bounds.items() if left >= 2 else ():
            if _needs_refit(bound, lines, np.maximum(radius[:, *at], floors[at])):
                bounds[at] = _fit(lines, radius, floors, at, order, tolerance, largest_order)
    channel_weights = {}
    for i, j in channels:
        channel_radius, floor = radius[:, i, j], float(floors[i, j])
        if (i, j) not in bounds:
            channel_weights[i, j] = Weight(
                _NO_ROOTS, _NO_ROOTS, 0.0, note="All members equal the nominal plant here."
            )
            continue
        bound = bounds[i, j]
        notes = []
        if kind == "multiplicative":
            notes.append(_peak_note(family, lines, channel_radius, (i, j)))
        if given is None:
            notes.append(_end_notes(lines, channel_radius, floor))
        if order is None and bound.mean > 1.0 + tolerance:
            notes.append(f"The mean excess at order {bound.order} is above {1.0 + tolerance:g}.")
        channel_weights[i, j] = _weight(
            lines, channel_radius, floor, bound, " ".join(filter(None, notes))
        )
    rows = []
    for i in range(len(family.outputs)):
        rows.append(tuple(channel_weights[i, j] for j in range(len(family.inputs))))
    weights = tuple(rows)
    for array in (lines, radius, floors):
        array.flags.writeable = False
    return UncertaintyWeight(kind, lines, radius, floors, weights, family.outputs, family.inputs)


def _fit(
    lines: RealArray,
    radius: RealArray,
    floors: RealArray,
    at: tuple[int, int],
    order: int | None,
    tolerance: float,
    largest_order: int,
) -> Bound:
    return fit_above(
        2 * np.pi * lines, np.maximum(radius[:, *at], floors[at]), order, tolerance, largest_order
    )


def _needs_refit(bound: Bound, lines: RealArray, level: RealArray) -> bool:
    """Return whether a bound is too far below a level at lines in Hz to change the gain only."""
    violation = np.log(level) - bound.log_magnitude(2 * np.pi * lines)
    return bool(violation.max() > UNCERTAINTY_WEIGHT.refitted_violation)


# -- options --------------------------------------------------------------------------------------
def _check(
    family: PlantFamily,
    order: int | None,
    kind: str,
    tolerance: float,
    largest_order: int,
    floor: float | None,
) -> None:
    if not isinstance(family, PlantFamily):
        raise OptionError(f"expected a PlantFamily, found {type(family).__name__}")
    if kind not in KINDS:
        raise OptionError(f"kind {kind!r}: {suggest(str(kind), KINDS)}")
    for what, number in (("order", order), ("largest_order", largest_order)):
        if number is not None and (
            isinstance(number, bool) or not isinstance(number, int | np.integer) or number < 0
        ):
            raise OptionError(f"{what} = {number!r}: expected a whole number from 0 up")
    if not tolerance > 0.0:
        raise OptionError(f"tolerance = {tolerance!r}: expected a share above 0, such as 0.25")
    if floor is not None and not 0.0 < floor < np.inf:
        raise OptionError(f"floor = {floor!r}: expected a radius above 0")
    if family.nominal.dt is not None:
        raise ModelError(
            "the plants are sampled; make the weight of the continuous family, and sample it"
            " afterwards"
        )


def _positive_lines(freq: ArrayLike) -> RealArray:
    lines = check_lines(np.atleast_1d(np.asarray(freq)))
    if lines[0] <= 0.0:
        raise OptionError("freq: expected lines above 0 Hz; remove 0")
    return np.array(lines)


# -- figures and notes of a channel ---------------------------------------------------------------
def _weight(lines: RealArray, radius: RealArray, floor: float, bound: Bound, note: str) -> Weight:
    excess = bound.log_magnitude(2 * np.pi * lines) - np.log(np.maximum(radius, floor))
    # The weight may lie below new lines; the gain corrects it.
    lift = max(-float(excess.min()), 0.0) + UNCERTAINTY_WEIGHT.margin
    spacing = np.gradient(np.log(lines)) if len(lines) > 1 else np.ones(1)
    mean = float(np.exp(spacing @ excess / spacing.sum() + lift))
    top = int(np.argmax(radius))
    largest = float(np.exp(excess.max() + lift))
    return Weight(
        *bound_roots(bound, lift), largest, mean, float(radius[top]), float(lines[top]), note
    )


def _end_notes(lines: RealArray, radius: RealArray, floor: float) -> str:
    """Return a note if the radius still grows beyond the lines."""
    notes = []
    for end, inside, what in ((0, 1, "below"), (-1, -2, "above")):
        if radius[end] > floor and len(lines) > 1:
            rise = np.log(radius[end] / radius[inside]) / abs(np.log(lines[end] / lines[inside]))
            if rise > 0.5:
                notes.append(
                    f"The radius still grows {what} {lines[end]:.3g} Hz, where the weight does not"
                    " bound it."
                )
    return " ".join(notes)


def _peak_note(
    family: PlantFamily, lines: RealArray, radius: RealArray, at: tuple[int, int]
) -> str:
    """Return a note if the radius exceeds 1, with its cause: a zero, or a pole that moves."""
    over = np.flatnonzero(radius >= 1.0)
    if not over.size:
        return ""
    note = f"The radius reaches 1 at {lines[over[0]]:.4g} Hz: |T| must be below 1 / radius there."
    top = 2j * np.pi * lines[int(np.argmax(radius))]
    zero = _nearest(channel_zeros(family.nominal, *at), top)
    pole = _nearest(np.concatenate([p.poles for p in (family.nominal, *family.members)]), top)
    roots = [x for x in (zero, pole) if x is not None]
    root = min(roots, key=lambda x: abs(x - top) / abs(x), default=None)
    if root is None or abs(root - top) > max(3.0 * abs(root.real), 0.02 * abs(root)):
        return note
    where = f"{abs(root) / (2 * np.pi):.4g} Hz (damping {-root.real / abs(root):.2g})"
    if root is zero:
        what = (
            f"the antiresonance of the nominal plant at {where}, where its response is small and"
            " that of members is not"
        )
        return (
            f"{note} It reaches {radius.max():.3g} because of {what}; kind='additive' is not"
            " affected."
        )
    what = f"the resonance at {where}, which moves by more than its width"
    return f"{note} It reaches {radius.max():.3g} because of {what}."


def _nearest(roots: ComplexArray, s: complex) -> complex | None:
    """Return the lightly damped root nearest to a point."""
    some = roots[(roots.imag > 0) & (np.abs(roots.real) < 0.3 * np.abs(roots))]
    return complex(some[np.argmin(np.abs(some - s))]) if some.size else None
