"""`respond_at_level`: the response of a model with nonlinear elements to a force amplitude."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.periodic.balance import Balance, ControlledBalance, Evaluation, make_fourier
from updyn.dynamics.periodic.continuation import BranchPoint, follow_branch
from updyn.dynamics.periodic.first import solve_first
from updyn.dynamics.periodic.settings import BALANCE
from updyn.dynamics.periodic.stability import count_unstable
from updyn.dynamics.periodic.transfer import Transfer
from updyn.errors import ModelError, OptionError, SolverError, UpdynWarning, suggest
from updyn.frf import FRF, QUANTITIES, SWEEPS, check_force_quantity, check_lines
from updyn.geometry import Geometry
from updyn.group import is_number
from updyn.model import Model

__all__ = ["Branch", "PeriodicResponse", "SineExcitation", "respond_at_level"]


@dataclass(frozen=True, slots=True, eq=False)
class Branch:
    """Solutions to one force, in the order of the branch, between and at the requested lines.

    Parameters
    ----------
    freq : ndarray of float, shape (n_p,)
        Frequency in Hz of each point; not monotonic if the branch has turning points.
    harmonics : ndarray of complex, shape (n_p, n_h, n_responses)
        Amplitudes of the harmonics of the responses, in the quantity of the response.
    """

    freq: RealArray
    harmonics: ComplexArray
    _stability: _Stability = field(repr=False)

    @property
    def stable(self) -> BoolArray:
        """Whether the periodic motion is stable, shape (n_p,); computed on first use."""
        return self._stability.at(range(len(self.freq)))


@dataclass(frozen=True, slots=True, eq=False)
class _Stability:
    """Stability of some solutions (x, omega) of a balance, each computed on first use."""

    balance: Balance
    solutions: list[tuple[RealArray, float]]
    _known: dict[int, bool] = field(default_factory=dict, init=False)

    def at(self, numbers: Iterable[int]) -> BoolArray:
        """Return whether the solutions of some numbers are stable."""
        return np.array([self._is_stable(number) for number in numbers], dtype=np.bool_)

    def _is_stable(self, number: int) -> bool:
        if number not in self._known:
            found = self.balance.evaluate(*self.solutions[number])
            self._known[number] = count_unstable(self.balance, found) == 0
        return self._known[number]


@dataclass(frozen=True, slots=True)
class SineExcitation:
    """Force of a constant amplitude `value`, or one that holds the response `control` at it."""

    value: float
    is_controlled: bool = False
    control: str | Dof | None = None

    @property
    def name(self) -> str:
        """The option that states it."""
        return "amplitude" if self.is_controlled else "level"

    def find_control(self, responses: DofSet, references: DofSet) -> int | None:
        """Return the position of the controlled response; None for a constant force."""
        if not self.is_controlled:
            return None
        if len(references) != 1:
            raise OptionError(
                f"amplitude: {len(references)} references; expected one, as the force that holds a"
                " response differs between them",
                key=("amplitude",),
            )
        if self.control is None:
            return 0
        (wanted,) = DofSet([self.control]).labels
        if wanted not in responses.labels:
            raise OptionError(
                f"control {wanted!r}: not among the responses; {suggest(wanted, responses.labels)}",
                key=("control",),
            )
        return responses.labels.index(wanted)


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicResponse:
    """Response of a model with nonlinear elements to one harmonic force after another.

    Parameters
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    values : ndarray of complex, shape (n_f, n_responses, n_references)
        First harmonic over the force amplitude, in m/N, m/s/N or m/s2/N.
    harmonics : ndarray of complex, shape (n_f, n_h, n_responses, n_references)
        Amplitudes A_k of the motion Re(sum of A_k exp(i k omega t)) with the force level cos(omega
        t), k from 0 (the mean), in m, m/s or m/s2.
    responses, references : DofSet
        Signed DOFs of sensors and forces.
    quantity : str
        ``"receptance"``, ``"mobility"`` or ``"accelerance"``.
    level : float or ndarray of float, shape (n_f,)
        Force amplitude in N (N m); of each line if a response is held at an amplitude.
    truncation : ndarray of float, shape (n_f, n_references)
        Estimated error by the harmonics that were left out: amplitude of the next ones over that of
        all, the largest of an element.
    branches : tuple of Branch
        All solutions, of one reference each, turning points included.
    source : str
        Kind of the linear model, and its error if it is reduced.
    geometry : Geometry, optional
        Positions of the nodes.
    sweep : {"up", "down"}
        Direction of the sweep that reaches `values`.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model = chain.build().with_elements({"stop": (updyn.CubicSpring(1e9), "12:X")})
    >>> found = updyn.response(model, [1.0, 1.5, 2.0], ["12:X"], ["12:X"], level=5.0)
    >>> found.harmonics.shape
    (3, 8, 1, 1)
    """

    freq: RealArray
    values: ComplexArray
    harmonics: ComplexArray
    responses: DofSet
    references: DofSet
    quantity: str
    level: float | RealArray
    truncation: RealArray
    branches: tuple[Branch, ...]
    source: str
    geometry: Geometry | None = None
    sweep: str = "up"
    _first: IndexArray = field(kw_only=True, repr=False)

    @property
    def stable(self) -> BoolArray:
        """Whether the periodic motion is stable at a constant force, shape (n_f, n_references).

        Unstable motion is not observed, unless a controller holds the response at an amplitude.
        Computed on first use.
        """
        columns = zip(self.branches, self._first.T.tolist(), strict=True)
        return np.stack([branch._stability.at(first) for branch, first in columns], axis=1)

    @property
    def frf(self) -> FRF:
        """The first harmonic over the force, as an FRF."""
        is_one = np.ndim(self.level) == 0
        about = f"level {self.level:g}" if is_one else "response at a constant amplitude"
        return FRF(
            self.freq,
            self.values,
            self.responses,
            self.references,
            self.quantity,
            geometry=self.geometry,
            source=f"{self.source}, {about}",
            level=self.level,
            sweep=self.sweep,
        )


def respond_at_level(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    excitation: SineExcitation,
    quantity: str,
    *,
    harmonics: int,
    samples: int,
    sweep: str,
    tier: str | None,
    backend: str | None,
    accuracy: float,
) -> PeriodicResponse:
    """Return the response to a force amplitude; parameters and errors as `updyn.response`."""
    lines = check_lines(np.atleast_1d(freq) if np.isscalar(freq) else freq)
    _check_options(lines, excitation, harmonics, samples, sweep)
    power = QUANTITIES[check_force_quantity(quantity)]
    if not model.nonlinear:
        raise ModelError(
            f"{excitation.name}: the model has no nonlinear elements; leave it out, as the"
            " response is proportional to the force, or add elements by model.with_elements"
        )
    rows, columns = DofSet(responses), DofSet(references)
    control = excitation.find_control(rows, columns)
    read = model.dofs.match(rows, "response")
    forced = model.dofs.match(columns, "reference")
    top = harmonics + BALANCE.next_harmonics
    transfer = Transfer.build(
        model,
        read.index,
        forced.index,
        (float(lines[0]), float(lines[-1])),
        _higher_lines(lines, top),
        tier=tier,
        backend=backend,
        accuracy=accuracy,
    )
    elements = [local.element for local in model.nonlinear.values()]
    is_free = transfer.static is None
    if is_free and not all(element.is_odd for element in elements):
        raise SolverError(
            f"{excitation.name}: the model is free at 0 Hz and an element is not odd, so that the"
            " mean of the motion is not determined; hold the model by a spring"
        )
    fourier = make_fourier(is_free=is_free, harmonics=harmonics, samples=samples)
    s = 2j * np.pi * fourier.harmonics
    n_f, n_j = len(lines), len(columns)
    shape = n_f, harmonics + 1, len(rows), n_j
    amplitudes = np.zeros(shape, dtype=np.complex128)
    first, truncation = np.zeros((n_f, n_j), dtype=np.intp), np.zeros((n_f, n_j))
    level: float | RealArray = excitation.value
    branches = []
    for j in range(n_j):
        column = transfer.select(j, len(elements))
        balance = Balance(elements, column, fourier, float(excitation.value * forced.sign[j]))
        if control is not None:
            at = len(elements) + control
            balance = ControlledBalance(elements, column, fourier, excitation.value, at, power)
        points = _solve(balance, lines, sweep)
        motion = np.array([balance.respond(point.found) for point in points]) * read.sign
        force = forced.sign[j] * np.array([balance.find_force(p.found) for p in points])
        turned = -np.angle(force)[:, None] * fourier.harmonics
        motion *= np.exp(1j * turned)[:, :, None]  # the phase of the force is 0
        hertz = np.array([point.found.omega for point in points]) / (2.0 * np.pi)
        motion *= (hertz[:, None] * s)[:, :, None] ** power
        spread = np.zeros((len(points), harmonics + 1, len(rows)), dtype=np.complex128)
        spread[:, fourier.harmonics] = motion
        solutions = [(point.found.x, point.found.omega) for point in points]
        branches.append(Branch(hertz, spread, _Stability(balance, solutions)))
        first[:, j] = _first_at_lines(points, lines, excitation)
        amplitudes[..., j] = spread[first[:, j]]
        truncation[:, j] = [balance.truncation(points[i].found) for i in first[:, j]]
        if control is not None:
            level = np.abs(force[first[:, j]])
    _warn_of_truncation(lines, truncation, harmonics)
    values = amplitudes[:, 1] / np.reshape(level, (-1, 1, 1))
    return PeriodicResponse(
        lines,
        values,
        amplitudes,
        rows,
        columns,
        quantity,
        level,
        truncation,
        tuple(branches),
        transfer.source,
        model.geometry,
        sweep,
        _first=first,
    )


def _check_options(
    lines: RealArray, excitation: SineExcitation, harmonics: int, samples: int, sweep: object
) -> None:
    name, value = excitation.name, excitation.value
    if not is_number(value) or not 0.0 < value < np.inf:
        what = "a force amplitude above 0, in N (N m)"
        if excitation.is_controlled:
            what = "an amplitude of the response above 0, in the unit of its quantity"
        raise OptionError(f"{name} {value!r}: expected {what}", key=(name,))
    if lines[0] <= 0.0:
        raise OptionError(
            f"{name}: a line at 0 Hz has no period; expected lines above 0 Hz", key=("freq",)
        )
    _check_whole("harmonics", harmonics, 1)
    _check_whole(
        "samples", samples, 4 * (harmonics + BALANCE.next_harmonics), f" for {harmonics} harmonics"
    )
    if sweep not in SWEEPS:
        raise OptionError(f"sweep {sweep!r}: {suggest(str(sweep), SWEEPS)}", key=("sweep",))


def _check_whole(name: str, value: object, least: int, why: str = "") -> None:
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise OptionError(
            f"{name} {value!r}: expected a whole number of at least {least}{why}", key=(name,)
        )


def _higher_lines(lines: RealArray, top: int) -> RealArray:
    """Return the lines, and as many up to the highest harmonic."""
    return np.union1d(lines, np.linspace(lines[0], top * lines[-1], len(lines) + 1))


def _solve(balance: Balance, lines: RealArray, sweep: str) -> list[BranchPoint]:
    """Return the points of the branch of a sweep over the lines in Hz."""
    omega = 2.0 * np.pi * lines
    if sweep == "down":
        omega = omega[::-1]
    points: list[BranchPoint] = []
    begin = 0
    while begin < len(omega):
        start = solve_first(balance, float(omega[begin]))
        rest = np.arange(begin, len(omega))
        found = [] if start is None else _follow(balance, start, omega, rest)
        points += found
        # A branch ends at a resonance without damping; a line beyond it begins another one.
        begin = 1 + max([begin, *(point.line for point in found)])
    points += _fill(balance, omega, points)
    if not points:
        raise SolverError(
            "no periodic response was found at any line; use a smaller level, or more lines"
        )
    if sweep == "down":
        last = len(lines) - 1
        points = [BranchPoint(p.found, last - p.line if p.line >= 0 else -1) for p in points]
    return points


def _follow(
    balance: Balance, start: Evaluation, omega: RealArray, lines: IndexArray
) -> list[BranchPoint]:
    """Return the points of a branch over some lines, as far as it can be followed."""
    points = []
    with contextlib.suppress(SolverError):
        for point in follow_branch(balance, start, omega[lines]):
            line = int(lines[point.line]) if point.line >= 0 else -1
            points.append(BranchPoint(point.found, line))
    return points


def _fill(balance: Balance, omega: RealArray, points: list[BranchPoint]) -> list[BranchPoint]:
    """Return points at lines that a growing force does not reach, from those of other lines."""
    found = {point.line: point.found for point in reversed(points) if point.line >= 0}
    missing = np.setdiff1d(np.arange(len(omega)), list(found))
    if not found:
        return []
    out = []
    for line in missing.tolist():
        known = np.array(list(found))
        source = int(known[np.abs(known - line).argmin()])
        step = 1 if line > source else -1
        reached = _follow(balance, found[source], omega, np.arange(source, line + step, step))
        out += [point for point in reached if point.line == line][:1]
    return out


def _first_at_lines(
    points: list[BranchPoint], lines: RealArray, excitation: SineExcitation
) -> IndexArray:
    """Return the position of the first solution at each line, which a sweep reaches."""
    first = np.full(len(lines), -1)
    for number, point in enumerate(points):
        if point.line >= 0 and first[point.line] < 0:
            first[point.line] = number
    if (first < 0).any():
        missing = float(lines[int(np.argmin(first))])
        raise SolverError(
            f"no periodic response was found at {missing:g} Hz for the {excitation.name}"
            f" {excitation.value:g}; use closer lines, or more harmonics="
        )
    return first


def _warn_of_truncation(lines: RealArray, truncation: RealArray, harmonics: int) -> None:
    worst = truncation.max(axis=1)
    if worst.max() > BALANCE.largest_truncation:
        at = int(np.argmax(worst))
        warnings.warn(
            f"harmonics {harmonics}: the next ones are estimated at {100.0 * worst[at]:.2g} % of"
            f" the motion of an element at {lines[at]:g} Hz; use more harmonics=",
            UpdynWarning,
            stacklevel=4,
        )
