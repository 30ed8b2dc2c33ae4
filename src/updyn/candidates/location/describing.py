"""Kinds of elements fitted to the describing function that the force at a place shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.candidates.location.descent import make_descent
from updyn.candidates.location.kinds import Kind, Scale
from updyn.candidates.location.place import PlaceFit
from updyn.candidates.location.settings import LOCATION
from updyn.errors import OptionError
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.local import Place
from updyn.nonlinear.over_lines import describe_first_harmonic
from updyn.nonlinear.parameters import change_parameters, list_parameters
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.local import Local, reduce_blocks
from updyn.updating.problem.parameters import ParameterSet, parameters

__all__ = ["ELEMENT", "KindFit", "choose_parameters", "fit_kind", "scale_of"]

#: Name of the element in the models of candidates.
ELEMENT = "nonlinearity"


@dataclass(frozen=True, slots=True, eq=False)
class KindFit:
    """An element of a kind at a place, and half its weighted sum of squares.

    `start` is the element from which it was fitted, `x` are the linear unknowns.
    """

    place: PlaceFit
    kind: Kind
    start: NonlinearElement
    element: NonlinearElement
    x: RealArray
    misfit: float


def scale_of(place: PlaceFit, omega: RealArray) -> Scale:
    """Return the scale of elements at a place, at half the amplitude of a middle level."""
    middle = place.amplitude[len(place.amplitude) // 2].max(axis=1)
    peak, tiny = int(middle.argmax()), float(np.finfo(np.float64).tiny)
    stiffness = LOCATION.start_stiffness / max(float(np.median(place.drive)), tiny)
    return Scale(stiffness, max(0.5 * float(middle[peak]), tiny), float(omega[peak]))


def choose_parameters(
    model: Model, kind: Kind, start: NonlinearElement, place: Place
) -> ParameterSet:
    """Return the unknowns of an element within the bounds of its kind about a start."""
    bounds = {f"{ELEMENT}.{name}": pair for name, pair in kind.bounds(start).items()}
    names = [
        f"{ELEMENT}.{name}"
        for name, value in list_parameters(start).items()
        if value or f"{ELEMENT}.{name}" in bounds
    ]
    with_element = model.with_elements({ELEMENT: (start, place)})
    return parameters(with_element, nonlinear=names, bounds=bounds)


def fit_kind(
    model: Model, place: PlaceFit, dofs: Place, kind: Kind, omega: RealArray
) -> KindFit | None:
    """Return the best fit of a kind from its starts; None if none can be evaluated."""
    fits = []
    for start in kind.starts(scale_of(place, omega)):
        unknowns = choose_parameters(model, kind, start, dofs)
        found = _fit_start(place, start, unknowns, omega)
        if found is not None:
            fits.append(KindFit(place, kind, start, found[0], place.x, found[1]))
    return min(fits, key=lambda fit: fit.misfit, default=None)


def _fit_start(
    place: PlaceFit, start: NonlinearElement, unknowns: ParameterSet, omega: RealArray
) -> tuple[NonlinearElement, float] | None:
    """Return the element that fits the describing function, and its misfit."""
    coordinates, names = Coordinates(unknowns), [p.quantity for p in unknowns]
    measured, at = place.stiffness, place.amplitude
    error = LOCATION.describing_error * np.abs(measured)
    weight = np.sqrt(2.0 / (place.std**2 + error**2))

    def element_at(x: RealArray) -> NonlinearElement:
        values: Mapping[str, float] = dict(
            zip(names, coordinates.to_values(x).tolist(), strict=True)
        )
        return change_parameters(start, values)

    def residual(x: RealArray) -> RealArray:
        r = weight * (_tabulate(element_at(x), at, omega) - measured)
        return np.concatenate([r.real.ravel(), r.imag.ravel()])

    def evaluate(x: RealArray) -> Local | None:
        try:
            r, columns = residual(x), []
            for i in range(len(x)):
                step = -1.0 if x[i] + LOCATION.derivative_step > upper[i] else 1.0
                moved = x.copy()
                moved[i] += step * LOCATION.derivative_step
                columns.append((residual(moved) - r) / (step * LOCATION.derivative_step))
        except OptionError:
            return None
        if not np.isfinite(r).all():
            return None
        return reduce_blocks([np.column_stack([*columns, r])], len(x))

    lower, upper = coordinates.bounds
    x = np.clip(coordinates.start, lower, upper)
    if evaluate(x) is None:
        return None
    settings = make_descent(LOCATION.kind_steps, LOCATION.kind_tolerance)
    outcome = settings.minimise(evaluate, x, lower, upper)
    return element_at(outcome.x), outcome.local.cost


def _tabulate(element: NonlinearElement, amplitudes: RealArray, omega: RealArray) -> ComplexArray:
    """Return the describing function over the deformation at amplitudes (n_l, n_f, n_j)."""
    of_velocity = element.quantity == "mobility"
    at = amplitudes * omega[None, :, None] if of_velocity else amplitudes
    largest = at.max()
    least = max(float(at.min()), LOCATION.least_amplitude * largest)
    grid = np.geomspace(least, largest, LOCATION.table_points)
    N = _describe(element, grid)
    found = np.interp(at, grid, N.real) + 1j * np.interp(at, grid, N.imag)
    return np.asarray(found * omega[None, :, None] if of_velocity else found)


def _describe(element: NonlinearElement, grid: RealArray) -> ComplexArray:
    """Return the describing function at 1 rad/s over the deformation, shape (n,)."""
    one = np.ones(len(grid))
    if not element.has_memory:
        return describe_first_harmonic(element, grid, one, LOCATION.samples)[0]
    # A loop is slow to follow, and has a closed form below macroslip.
    N = np.array(element.describing(grid, one))
    rest = ~np.isfinite(N)
    if rest.any():
        N[rest] = describe_first_harmonic(element, grid[rest], one[rest], LOCATION.samples)[0]
    return N
