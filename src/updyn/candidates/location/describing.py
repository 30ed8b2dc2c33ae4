"""Kinds of elements fitted by their describing functions to the force at a place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from updyn.arrays import RealArray
from updyn.candidates.location.descent import make_descent
from updyn.candidates.location.kinds import Kind, Scale
from updyn.candidates.location.levels import LevelData
from updyn.candidates.location.motion import Motion
from updyn.candidates.location.place import MeasuredElement, PlaceFit
from updyn.candidates.location.settings import LOCATION
from updyn.errors import OptionError
from updyn.model import Model
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.local import Place
from updyn.nonlinear.parameters import change_parameters, list_parameters
from updyn.updating.problem.coordinates import Coordinates
from updyn.updating.problem.local import Local, reduce_blocks
from updyn.updating.problem.parameters import ParameterSet, parameters

__all__ = ["ELEMENT", "KindFit", "choose_parameters", "find_scale", "fit_element", "fit_kind"]

#: Name of the first element that is found.
ELEMENT = "nonlinearity"


@dataclass(frozen=True, slots=True, eq=False)
class KindFit:
    """An element of a kind at a place.

    `misfit` is half the weighted sum of squares of its describing function, and `cost` about that
    of the data.

    `start` is the element from which it was fitted, `x` are the linear unknowns, and `others` the
    values of the unknowns of other elements.
    """

    place: PlaceFit
    kind: Kind
    start: NonlinearElement
    element: NonlinearElement
    x: RealArray
    others: RealArray
    misfit: float
    cost: float


def find_scale(place: MeasuredElement, motion: Motion) -> Scale:
    """Return the scale of elements at a place.

    The stiffness is a share of that of the structure, or that of the force if it is smaller.
    """
    tiny = float(np.finfo(np.float64).tiny)
    whole = LOCATION.start_stiffness / max(float(np.median(place.drive)), tiny)
    weight = 1.0 / np.maximum(place.std, tiny)
    own = float(np.linalg.norm(weight * np.abs(place.stiffness)) / np.linalg.norm(weight))
    stiffness = min(whole, max(own, LOCATION.least_stiffness * whole))
    amplitude, omega = motion.typical
    return Scale(stiffness, max(amplitude, tiny), omega)


def choose_parameters(
    model: Model, name: str, kind: Kind, start: NonlinearElement, place: Place
) -> ParameterSet:
    """Return the unknowns of a new element within the bounds of its kind about a start."""
    bounds = {f"{name}.{key}": pair for key, pair in kind.bounds(start).items()}
    names = [
        f"{name}.{key}"
        for key, value in list_parameters(start).items()
        if value or f"{name}.{key}" in bounds
    ]
    with_element = model.with_elements({name: (start, place)})
    return parameters(with_element, nonlinear=names, bounds=bounds)


def fit_kind(
    model: Model,
    name: str,
    place: PlaceFit,
    dofs: Place,
    kind: Kind,
    data: LevelData,
    *,
    in_parallel: bool = False,
) -> KindFit | None:
    """Return the best fit of a kind from its starts; None if none can be evaluated.

    `name` is that of the new element; `in_parallel` as for `fit_element`.
    """
    fits, motion = [], data.motion(place.element.amplitude)
    for start in kind.starts(find_scale(place.element, motion)):
        unknowns = choose_parameters(model, name, kind, start, dofs)
        found = fit_element(place.element, start, unknowns, motion, in_parallel=in_parallel)
        if found is not None:
            element, misfit = found
            about = place.x, np.zeros(0), misfit, place.cost + misfit
            fits.append(KindFit(place, kind, start, element, *about))
    return min(fits, key=lambda fit: fit.misfit, default=None)


def fit_element(
    place: MeasuredElement,
    start: NonlinearElement,
    unknowns: ParameterSet,
    motion: Motion,
    *,
    in_parallel: bool = False,
) -> tuple[NonlinearElement, float] | None:
    """Return the element that fits the force by its describing function, and its misfit.

    With `in_parallel`, a constant complex stiffness is fitted, too: the error of a linear unknown
    at the place.
    """
    coordinates, names = Coordinates(unknowns), [p.quantity for p in unknowns]
    measured = place.stiffness
    error = LOCATION.describing_error * np.abs(measured)
    weight = np.sqrt(2.0 / (place.std**2 + error**2))

    def element_at(x: RealArray) -> NonlinearElement:
        values: Mapping[str, float] = dict(
            zip(names, coordinates.to_values(x).tolist(), strict=True)
        )
        return change_parameters(start, values)

    def residual(x: RealArray) -> RealArray:
        r = weight * (motion.describe(element_at(x)) - measured)
        if in_parallel:
            r -= weight * (np.sum(weight * r) / np.sum(weight**2))
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
