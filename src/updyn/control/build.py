"""`plant`: a state-space model of a structure, of the smallest order that holds a tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.control.antiresonances import ZeroShift, shifts
from updyn.control.causal import GAIN, differences, least_error
from updyn.control.complex_modes import (
    ComplexModes,
    Fitted,
    complex_modes,
    fitted,
    slow_motion,
)
from updyn.control.lines import sweep
from updyn.control.measured import measured
from updyn.control.passivity import collocated
from updyn.control.plant import Plant
from updyn.control.ports import Port, as_ports
from updyn.control.rational import Rational, SlowMotion
from updyn.control.rational_fit import Approximation
from updyn.control.rational_states import fewest_states, with_poles_of
from updyn.control.real_modes import Biot, biot, diagonal, full, single_frequency
from updyn.control.servo.state_space import StateSpace, channel_zeros
from updyn.control.space import (
    Conversion,
    ModalSpace,
    Projection,
    imaginary,
    projection,
    rates,
    shared_projection,
)
from updyn.control.spectrum import Spectrum
from updyn.control.target import Kept, Target, answered, fewest, judged, target_lines
from updyn.dofs import Dof
from updyn.dynamics.affine import AffineSystem, State
from updyn.errors import ModelError, OptionError, SolverError, ToleranceError, suggest
from updyn.frf import FRF, QUANTITIES, check_quantity
from updyn.group import is_number
from updyn.model import Model
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["ERRORS", "ROUTES", "ConversionError", "Shared", "conversions", "plant"]

#: How structural damping becomes poles.
ROUTES = ("auto", "modal", "complex", "rational", "biot")
#: For which errors a tolerance holds.
ERRORS = ("relative", "peak")
#: Those of the structure's own modes.
_CONVERSIONS = ("modal", "complex", "biot")
_REFUSED = {
    "diagonal": "modal damping ratios lose the coupling of the modes by the damping",
    "single-frequency": (
        "structural damping converted at one frequency is right at that frequency only"
    ),
}
_TERMS = (2, 3, 4, 6, 8)
_EXTRA = (0, 2, 4)
#: Standard deviations of a measured value within which a plant may lie.
_DEVIATIONS = 3.0

Ports = Iterable[str | Dof | Port] | str | Dof | Port


@dataclass(frozen=True, slots=True)
class ConversionError:
    """How well a conversion of the damping answers, all modes kept.

    Attributes
    ----------
    name : str
        ``"modal"`` (full modal damping matrix), ``"complex"``, ``"biot"``, ``"diagonal"``,
        ``"single-frequency"``.
    error, peak_error : float
        As those of a `Plant`; nan where it is not possible.
    note : str
        Why not, or where it was made.
    relative_error : float
        As that of a `Plant`.
    """

    name: str
    error: float
    peak_error: float
    note: str = ""
    relative_error: float = float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What is to be realised, and against what it is checked."""

    space: ModalSpace
    target: Target
    powers: NDArray[np.intp]
    band: tuple[float, float]
    ports: tuple[tuple[Port, ...], tuple[Port, ...]]
    spectrum: Callable[[], Spectrum]

    def least(self, found: Kept) -> float:
        """Return a lower bound on the error of any stable plant, see `updyn.control.causal`.

        Parameters
        ----------
        found : Kept
            What the structure's response is compared with; the bound hardly depends on it.
        """
        if not self.space.lossy:  # dampers are causal
            return 0.0
        target = self.target
        level = np.broadcast_to(target.level, target.reference.shape)
        if target.measure == "relative":
            level = target.reference

        spectrum = self.spectrum()

        def structure(lines: NDArray[np.float64]) -> NDArray[np.complex128]:
            return np.asarray(spectrum.receptance(lines) * rates(self.powers, imaginary(lines)))

        growth = (2 - self.powers) * (self.space.rigid > 0)
        channels = differences(
            target.freq, structure, level, found, full(self.space, self.powers), growth
        )
        least = 0.0
        for channel in channels:
            least = least_error(channel, self.band, least)
        return least

    def approximation(self) -> Approximation:
        """Return what a rational approximation begins with: the poles that count most first."""
        inputs, outputs = self.ports
        modes = complex_modes(self.space, self.powers, self.band[1])
        costs = modes.costs(self.target.freq, self.target.reference)
        order = np.argsort(-costs, kind="stable")
        # A servo closes its loop through what is slow: it is kept as it is.
        below = modes.frequency < self.band[0]
        slow = SlowMotion(*slow_motion(self.space))
        if below.any():
            slow = _with_modes(slow, modes, below)
        poles = modes.poles[order[~below[order]]]
        return Approximation(self.target, slow, self.powers, poles, collocated(outputs, inputs))

    def conversion(self, route: str, terms: int = 4) -> Conversion:
        if route == "modal":
            return full(self.space, self.powers)
        if route == "complex":
            return complex_modes(self.space, self.powers, self.band[1])
        if route == "biot":
            return biot(self.space, full(self.space, self.powers), self.band, terms)
        if route == "diagonal":
            return diagonal(self.space, self.powers)
        return single_frequency(self.space, self.powers, float(np.sqrt(self._low * self.band[1])))

    @property
    def _low(self) -> float:
        return max(self.band[0], 1e-3 * self.band[1])

    def tried(self, route: str) -> Iterator[Conversion]:
        """Yield conversions of a route, the cheapest first."""
        for terms in _TERMS if route == "biot" else (0,):
            yield self.conversion(route, terms)

    def mended(self, route: str) -> Iterator[Conversion]:
        """Yield conversions of a route as `tried`, and then fitted ones."""
        for conversion in self.tried(route):
            yield conversion
            if isinstance(conversion, ComplexModes):
                yield from (fitted(conversion, self.target, n) for n in _EXTRA)


def plant(
    model: Model | UpdateResult | FRF,
    inputs: Ports,
    outputs: Ports,
    band: Sequence[float],
    tolerance: float = 0.02,
    *,
    quantity: str | Sequence[str] = "receptance",
    route: str = "auto",
    error: str = "relative",
    tier: str | None = None,
    backend: str | None = None,
) -> Plant:
    """Make a real, causal, stable state-space model of a structure.

    Rigid-body motion is kept as it is. What lies above the band is there as residual flexibility:
    as feed-through of displacements, as modes above the band of velocities and accelerations.

    Parameters
    ----------
    model : Model or UpdateResult or FRF
        The structure, or the update that found it: its updated model; or measured FRFs of all DOFs
        of the ports, with variance or coherence where the measurement has them.
    inputs, outputs : iterable of str, Dof or Port
        Forces and motions: signed DOFs, or ports (several DOFs, gear ratio, names).
    band : (float, float)
        Lowest and highest line in Hz between which it has to answer as the structure does.
    tolerance : float
        On the errors that `error` names.
    quantity : str or sequence of str
        What the outputs are, one for all or one each: ``"receptance"`` (displacements),
        ``"mobility"`` (velocities), ``"accelerance"`` (accelerations).
    route : {"auto", "modal", "complex", "rational", "biot"}
        How structural damping becomes poles. ``"modal"``: real modes with the full modal damping
        matrix, passive. ``"complex"``: the poles and residues of the damped structure, closest
        where damping is strong and local; the outputs fitted to the structure's answer where that
        alone does not hold the tolerance. ``"rational"``: a rational approximation of the response,
        fewest states; rigid-body motion exact, collocated channels passive. ``"biot"``: internal
        variables, passive, static stiffness differs slightly. ``"auto"``: modal, or complex where
        that does not hold the tolerance; of a relative error rational where it needs fewer
        states.
    error : {"relative", "peak"}
        For what the tolerance holds. ``"relative"``: the error of a channel as a share of its own
        size at each line, which is what a loop sees; at an antiresonance as a share of the level
        one half-power width beside it. ``"peak"``: its largest error as a share of its peak in the
        band, and the height of its resonances.
    tier, backend : str, optional
        How the structure's own answer is computed, as for `updyn.response`; by default exactly up
        to 300 DOFs, by a reduced model proved to 1e-8 above.

    Returns
    -------
    Plant
        With `relative_error` (or `error` and `peak_error`) within the tolerance, computed from its
        own matrices. Of a model, ``facts["causal error"]`` is a lower bound on that error for any
        stable plant whose gain outside the band is at most ten times the largest of the structure
        there; 0 without structural damping.

    Raises
    ------
    OptionError
        If an option is not valid; a route that converts the damping at one frequency or by modal
        damping ratios is refused, with the error that it would have.
    ModelError
        If the structure is not statically stable.
    ToleranceError
        If no order holds the tolerance; the message says what was reached, and whether causality
        keeps any stable plant from it.
    DofError
        If the model has not the DOFs of a port.
    SolverError
        If the structure has no answer at a line: undamped, at a resonance.

    Notes
    -----
    Of measured FRFs the plant is a rational approximation of the data, poles from those of the
    modes identified in the band. What lies within three standard deviations of a value counts as
    within the tolerance, and errors are of that measure. Rigid-body motion is as the data have it.

    Full modal damping matrix: C_rs = phi_r^T D phi_s / sqrt(omega_r omega_s); see
    `updyn.control.real_modes`, `complex_modes` and `biot` for the routes.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> made = updyn.plant(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0), quantity="mobility")
    >>> made.inputs, made.output_units
    (('12:X',), ('m/s',))
    >>> made.relative_error <= made.tolerance
    True
    """
    ports = as_ports(inputs, "input"), as_ports(outputs, "output")
    if isinstance(model, FRF):
        if route not in ("auto", "rational") or error != "relative":
            raise OptionError(
                f"plant: route {route!r}, error {error!r}; of a measurement there is route"
                " 'rational' with error 'relative' only"
            )
        return _measured(model, ports, band, tolerance, quantity)
    own = _model(model)
    _check_error(error)
    task, quantities = _task(own, *ports, band, quantity, tier, backend, error)
    _check_tolerance(tolerance)
    found = _chosen(task, _check_route(route, task, error), tolerance)
    made = _realised(task, found, own.title, quantities, tolerance)
    return replace(made, facts={**made.facts, "causal error": task.least(found)})


@dataclass(frozen=True, slots=True, eq=False)
class Shared:
    """What the plants of a family have in common: one basis, and the choice of the nominal plant.

    Attributes
    ----------
    projection : Projection
        The model on the basis.
    title : str
        Of the model.
    ports : tuple of (tuple of Port, tuple of Port)
        Inputs and outputs.
    quantities : tuple of str
        Of each output.
    tolerance : float
        On the errors that `error` names.
    error : {"relative", "peak"}
        For what the tolerance holds.
    """

    projection: Projection
    title: str
    ports: tuple[tuple[Port, ...], tuple[Port, ...]]
    quantities: tuple[str, ...]
    tolerance: float
    error: str

    @classmethod
    def of(
        cls,
        model: Model,
        states: tuple[AffineSystem, Sequence[State], Sequence[State]],
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        band: Sequence[float],
        tolerance: float,
        quantity: str | Sequence[str],
        error: str,
        backend: str | None,
    ) -> tuple[Shared, NDArray[np.bool_]]:
        """Return it, and for which states the basis holds.

        Parameters
        ----------
        model : Model
            The structure at the estimate.
        states : tuple of (AffineSystem, sequence of State, sequence of State)
            The same, compiled; the states by which its basis is enriched; those of the members.
        inputs, outputs, band, tolerance, quantity, error, backend
            As for `plant`.
        """
        _check_error(error)
        _check_tolerance(tolerance)
        limits, quantities = _check_band(band), _quantities(quantity, len(outputs))
        system, training, members = states
        projection, holds = shared_projection(
            model, system, inputs, outputs, limits, training, members, backend=backend
        )
        ports = inputs, outputs
        return cls(projection, model.title, ports, quantities, tolerance, error), holds

    def member(self, state: State, route: str, like: Kept | None = None) -> tuple[Plant, Kept]:
        """Return the plant of a state.

        Parameters
        ----------
        state : State
            Of the model.
        route : str
            As for `plant`.
        like : Kept, optional
            The choice that is tried first; where it does not hold the tolerance, another one is
            sought.

        Returns
        -------
        plant : Plant
        kept : Kept
            What it is of.
        """
        task = self._task(state)
        found = None if like is None else _like(task, like, self.tolerance)
        if found is None or not found.holds:
            found = _chosen(task, _check_route(route, task, self.error), self.tolerance)
        return _realised(task, found, self.title, self.quantities, self.tolerance), found

    def _task(self, state: State) -> _Task:
        space = self.projection.space(state)
        _check_begin(space, self.projection.band[0])
        spectrum = Spectrum.of(self.projection, state)
        return _aimed(
            self.ports,
            self.quantities,
            space,
            (spectrum.poles, lambda: spectrum),
            self.projection.band,
            self.error,
            spectrum.receptance,
        )


def _like(task: _Task, like: Kept, tolerance: float) -> Kept | None:
    """Return the choice of another state of the model for a task; None where it has no such one."""
    own, target = like.conversion, task.target
    if isinstance(own, Rational):
        return with_poles_of(task.approximation(), own, tolerance)
    terms = len(own.terms[0].b) if isinstance(own, Biot) and own.terms else 4
    try:
        conversion = task.conversion(own.name, terms)
    except ModelError:
        return None
    if isinstance(own, Fitted) and isinstance(conversion, ComplexModes):
        conversion = fitted(conversion, target, len(own.extra))
    if len(conversion.frequency) != len(like.mask):
        return None
    return judged(conversion, target, like.mask, target.limits(tolerance))


def _realised(
    task: _Task, found: Kept, title: str, quantities: tuple[str, ...], tolerance: float
) -> Plant:
    """Return the plant of a choice."""
    A, B, C, D = found.conversion.matrices(found.mask)
    facts: dict[str, Any] = {
        "title": title,
        "basis": task.space.source,
        "lines": len(task.target.freq),
        "candidates": len(found.mask),
        "error": task.target.measure,
    }
    if isinstance(found.conversion, Fitted):
        facts["fitted"] = f"outputs, with {len(found.conversion.extra)} real poles"
    made = Plant(
        A,
        B,
        C,
        D,
        *task.ports,
        quantities,
        task.band,
        float(tolerance),
        float(found.errors[1]),
        float(found.errors[2]),
        found.conversion.name,
        task.space.rigid,
        np.concatenate(
            [
                np.zeros(task.space.rigid),
                np.sort(found.conversion.frequency[found.mask & _flexible(found)]),
            ]
        ),
        facts=facts,
    )
    return _checked(made, task.target)


def _check_error(error: str) -> None:
    if error not in ERRORS:
        raise OptionError(f"plant: no error {error!r}; {suggest(str(error), ERRORS)}")


def _with_modes(slow: SlowMotion, modes: ComplexModes, kept: NDArray[np.bool_]) -> SlowMotion:
    """Return slow motion with some complex modes, as they are."""
    A, B = modes.blocks(kept, modes.at_inputs[:, kept])
    left = 2.0 * modes.at_outputs[:, kept]
    pairs = np.stack([left.real, left.imag], axis=2).reshape(len(left), -1)
    displacements = np.hstack([slow.displacements, pairs])
    return SlowMotion(A, B, displacements, slow.velocities, modes.frequency[kept])


def _measured(
    frf: FRF,
    ports: tuple[tuple[Port, ...], tuple[Port, ...]],
    band: Sequence[float],
    tolerance: float,
    quantity: str | Sequence[str],
) -> Plant:
    """Return the plant of measured FRFs."""
    limits = _check_band(band)
    inputs, outputs = ports
    quantities = _quantities(quantity, len(outputs))
    _check_tolerance(tolerance)
    data = measured(frf, inputs, outputs, quantities, limits)
    reference = np.maximum(data.reference, _DEVIATIONS * data.deviation / tolerance)
    target = replace(data.target, reference=reference)
    powers = np.array([QUANTITIES[q] for q in quantities], dtype=np.intp)
    slow = SlowMotion.none(len(outputs), len(inputs))
    pairs = collocated(outputs, inputs)
    approximation = Approximation(target, slow, powers, data.poles, pairs)
    found = fewest_states(approximation, tolerance)
    if not found.holds:
        raise ToleranceError(
            f"plant: no order holds a tolerance of {tolerance:g} from {limits[0]:g} to"
            f" {limits[1]:g} Hz of the measurement; reached: {found.error:.3g}. Allow a larger"
            " tolerance, or narrow the band"
        )
    facts = {
        "title": frf.source,
        "source": "measurement",
        "lines": len(target.freq),
        "error": "relative",
        "noise": data.noise,
    }
    A, B, C, D = found.conversion.matrices(found.mask)
    errors = float(found.errors[1]), float(found.errors[2])
    modes = np.sort(found.conversion.frequency)
    made = Plant(
        A,
        B,
        C,
        D,
        inputs,
        outputs,
        quantities,
        limits,
        float(tolerance),
        *errors,
        found.conversion.name,
        0,
        modes,
        facts=facts,
    )
    return _checked(made, target)


def _check_tolerance(tolerance: float) -> None:
    if not is_number(tolerance) or not 1e-9 <= tolerance <= 0.5:
        raise OptionError(f"plant: tolerance {tolerance!r}; expected a share between 1e-9 and 0.5")


def _quantities(quantity: str | Sequence[str], count: int) -> tuple[str, ...]:
    """Return the quantity of each output."""
    named = [quantity] * count if isinstance(quantity, str) else list(quantity)
    quantities = tuple(check_quantity(q) for q in named)
    if len(quantities) != count:
        raise OptionError(
            f"plant: {len(quantities)} quantities for {count} outputs; expected one, or one each"
        )
    return quantities


def _flexible(found: Kept) -> NDArray[np.bool_]:
    return ~found.conversion.always


def _checked(made: Plant, target: Target) -> Plant:
    """Put the errors of the matrices themselves into a plant, and look at its poles."""
    G = sweep(made, target.freq)
    scale = max(float(np.abs(made.poles).max(initial=0.0)), 1e-300)
    if (made.poles.real > 1e-9 * scale).any():
        raise ModelError(
            f"plant: route {made.route!r} gave an unstable pole,"
            f" {made.poles[np.argmax(made.poles.real)]:.4g} rad/s; use another route"
        )
    facts = dict(made.facts)
    if target.slow:
        facts["peak error of accelerations"] = target.peak_error(G, strict=True)
    return replace(
        made,
        error=target.error(G),
        peak_error=target.peak_error(G),
        facts=facts,
        relative_error=target.relative_error(G),
        zero_shift=tuple(_shifts(made, target, G)),
    )


def _shifts(made: Plant, target: Target, G: NDArray[np.complex128]) -> Iterator[ZeroShift]:
    for i, j in np.ndindex(*target.level.shape):
        matrices = StateSpace(made.A, made.B[:, [j]], made.C[[i]], made.D[[i]][:, [j]])
        names = made.outputs[i], made.inputs[j]

        if target.level[i, j] > target.floor[i, j]:
            zeros = channel_zeros(matrices)
            for found in shifts(target.freq, target.values[:, i, j], G[:, i, j], zeros):
                yield ZeroShift(*names, *found)


def _chosen(task: _Task, routes: tuple[str, ...], tolerance: float) -> Kept:
    """Return the first route that holds the tolerance, in the plant's stated errors at least.

    Where a rational approximation is among several, it is taken if it needs fewer states.
    """
    reached: dict[str, Kept] = {}
    refused: dict[str, ModelError] = {}
    own = tuple(route for route in routes if route != "rational")
    best = _converted(task, own, tolerance, reached, refused)
    if "rational" in routes:
        largest = None if best is None else _states(best) - 1
        try:
            found = fewest_states(task.approximation(), tolerance, largest)
        except ModelError as error:
            refused["rational"] = error
        else:
            if found.holds:
                return found
            if best is None:
                reached["rational"] = found
    if best is not None:
        return best
    if not reached:
        raise next(iter(refused.values()))
    others = ", ".join(repr(r) for r in ROUTES[1:] if r not in routes)
    said = ", ".join(f"{kept.error:.3g} by route {route!r}" for route, kept in reached.items())
    advice = "Allow a larger tolerance, narrow the band"
    if others:
        advice += f", or try route {others}"
    raise ToleranceError(
        f"plant: no order holds a tolerance of {tolerance:g} from {task.band[0]:g} to"
        f" {task.band[1]:g} Hz; reached: {said}.{_why(task, reached, tolerance)} {advice}"
    )


def _why(task: _Task, reached: dict[str, Kept], tolerance: float) -> str:
    """Return whether it is causality that keeps a tolerance from being reached."""
    if not task.space.lossy:
        return ""
    least = task.least(min(reached.values(), key=lambda kept: kept.error))
    limit = (
        f"stable plant whose gain outside the band is at most {GAIN:g} times the largest of the"
        " structure there"
    )
    if least > tolerance:
        return (
            " Structural damping is not causal (Kramers-Kronig): the phase that it has over the"
            f" band is not that of a system in time, and no {limit} comes nearer than {least:.2g}."
        )
    return (
        f" Causality would allow it: a {limit} is off by {least:.2g} or more, which is below the"
        " tolerance."
    )


def _converted(
    task: _Task,
    routes: tuple[str, ...],
    tolerance: float,
    reached: dict[str, Kept],
    refused: dict[str, ModelError],
) -> Kept | None:
    """Return the first of the structure's own conversions that holds the tolerance."""
    for lenient in (False, True):
        for route in (r for r in routes if r not in refused):
            try:
                for conversion in task.mended(route):
                    found = fewest(conversion, task.target, tolerance, lenient=lenient)
                    if found.holds:
                        return found
                    if route not in reached or found.error < reached[route].error:
                        reached[route] = found
            except ModelError as error:
                refused[route] = error
        if task.target.measure == "relative":
            break
    return None


def _states(found: Kept) -> int:
    """Return the number of states of a choice."""
    if isinstance(found.conversion, Rational):
        return found.conversion.n_states
    return len(found.conversion.matrices(found.mask)[0])


def conversions(
    model: Model | UpdateResult,
    inputs: Ports,
    outputs: Ports,
    band: Sequence[float],
    *,
    quantity: str | Sequence[str] = "receptance",
    tier: str | None = None,
    backend: str | None = None,
) -> tuple[ConversionError, ...]:
    """Tell how well each conversion of structural damping answers, side by side, all modes kept.

    Parameters
    ----------
    model, inputs, outputs, band, quantity, tier, backend
        As for `plant`.

    Returns
    -------
    tuple of ConversionError
        Routes of `plant` first, then those that it refuses. The single frequency is the middle of
        the band on a logarithmic scale.

    Raises
    ------
    OptionError, ModelError, DofError, SolverError
        As `plant`.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> found = updyn.conversions(chain.build(), ["12:X"], ["12:X"], (0.5, 12.0))
    >>> next(c.error < 0.01 for c in found if c.name == "complex")
    True
    """
    own = _model(model)
    task, _ = _task(
        own, as_ports(inputs, "input"), as_ports(outputs, "output"), band, quantity, tier, backend
    )
    return tuple(_error_of(task, name) for name in (*_CONVERSIONS, *_REFUSED))


def _error_of(task: _Task, name: str) -> ConversionError:
    best = ConversionError(name, float("nan"), float("nan"))
    try:
        for conversion in task.tried(name):
            G = conversion.response(
                np.ones(len(conversion.frequency), dtype=np.bool_), task.target.freq
            )
            found = ConversionError(
                name,
                task.target.error(G),
                task.target.peak_error(G),
                relative_error=task.target.relative_error(G),
            )
            if not best.error <= found.error:
                best = found
    except ModelError as error:
        if not np.isfinite(best.error):
            return replace(best, note=str(error))
    return best


def _model(given: object) -> Model:
    if isinstance(given, Model):
        return given
    if isinstance(given, JointResult):
        names = ", ".join(repr(n) for n in given.results)
        raise OptionError(
            f"plant: the update has several tests ({names}), each with its own model; pass the"
            " result of the one whose boundary conditions are those of the plant, such as"
            f" result[{next(iter(given.results))!r}]"
        )
    if not isinstance(given, UpdateResult):
        raise OptionError(
            f"plant: expected a model or the result of an update, found {type(given).__name__}"
        )
    return given.model


def _task(
    model: Model,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    band: Sequence[float],
    quantity: str | Sequence[str],
    tier: str | None,
    backend: str | None,
    measure: str = "relative",
) -> tuple[_Task, tuple[str, ...]]:
    limits = _check_band(band)
    quantities = _quantities(quantity, len(outputs))
    system = AffineSystem.compile(model)
    found = projection(model, system, inputs, outputs, limits, backend=backend)
    space = found.space(system.start)
    _check_begin(space, limits[0])
    ports = inputs, outputs
    answer = answered(model, *ports, space.solver, tier, backend)
    task = _aimed(
        ports,
        quantities,
        space,
        (_poles(space), lambda: Spectrum.of(found, system.start)),
        limits,
        measure,
        answer,
    )
    return task, quantities


def _check_begin(space: ModalSpace, low: float) -> None:
    if space.rigid and low == 0.0:
        raise OptionError(
            f"plant: the band begins at 0 Hz, where the {space.rigid} rigid-body motions of the"
            " structure have no finite answer; begin it above"
        )


def _aimed(
    ports: tuple[tuple[Port, ...], tuple[Port, ...]],
    quantities: tuple[str, ...],
    space: ModalSpace,
    damped: tuple[NDArray[np.complex128], Callable[[], Spectrum]],
    band: tuple[float, float],
    measure: str,
    receptance: Callable[[NDArray[np.float64]], NDArray[np.complex128]],
) -> _Task:
    """Return what is to be realised, with the response at lines that resolve it."""
    powers = np.array([QUANTITIES[q] for q in quantities], dtype=np.intp)
    target = Target.of(
        receptance,
        quantities,
        target_lines(damped[0], band),
        slow=bool(space.omega[0] < 2.0 * np.pi * band[0]),
        potential=full(space, powers).potential,
        measure=measure,
        reduced=space.solver is not None,
    )
    if not np.isfinite(target.values).all():
        raise SolverError(
            "plant: the structure has no finite answer at a line of the band: it is not damped"
        )
    return _Task(space, target, powers, band, ports, damped[1])


def _poles(space: ModalSpace) -> NDArray[np.complex128]:
    """Return the poles of the damped structure; of a defective one those of its single modes."""
    try:
        return complex_modes(space, np.zeros(len(space.outputs), dtype=np.intp), 1.0).poles
    except ModelError:
        return np.asarray(space.omega * (1j - 0.5 * space.loss_factors()))


def _check_band(band: Sequence[float]) -> tuple[float, float]:
    try:
        low, high = (float(f) for f in band)
    except (TypeError, ValueError) as error:
        raise OptionError(f"plant: band {band!r}; expected two lines in Hz") from error
    if not (np.isfinite(high) and 0.0 <= low < high):
        raise OptionError(
            f"plant: band from {low:g} to {high:g} Hz; expected the lower line first, not negative"
        )
    return low, high


def _check_route(route: str, task: _Task, error: str) -> tuple[str, ...]:
    if route in _REFUSED:
        found = _error_of(task, route)
        raise OptionError(
            f"plant: route {route!r} is refused: {_REFUSED[route]}. From {task.band[0]:g} to"
            f" {task.band[1]:g} Hz it is wrong by {100 * found.error:.3g} % of a peak, and by"
            f" {100 * found.peak_error:.3g} % in the height of a resonance; use route='modal' or"
            " 'complex'"
        )
    if route not in ROUTES:
        raise OptionError(f"plant: no route {route!r}; {suggest(str(route), ROUTES)}")
    if route != "auto":
        return (route,)
    return ("modal", "complex", "rational") if error == "relative" else ("modal", "complex")
