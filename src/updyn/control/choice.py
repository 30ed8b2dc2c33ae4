"""The choice of a plant: the route, and its fewest states that hold the tolerance."""

from __future__ import annotations

from updyn.control.complex_modes import ComplexModes, FittedModes, fit_outputs
from updyn.control.conversions import REFUSED, conversion_error
from updyn.control.rational import Rational
from updyn.control.rational_states import find_fewest_states, refit_poles
from updyn.control.real_modes import Biot
from updyn.control.settings import CAUSAL_BOUND
from updyn.control.target import CandidateSelection, judge_selection, select_fewest
from updyn.control.task import PlantTask
from updyn.errors import ModelError, OptionError, ToleranceError, suggest

__all__ = ["ROUTES", "check_route", "choose_route", "reuse_selection"]

#: Conversions of structural damping to poles.
ROUTES = ("auto", "modal", "complex", "rational", "biot")


def check_route(route: str, task: PlantTask, error: str) -> tuple[str, ...]:
    """Return the routes to try; raises OptionError for an unknown or refused route."""
    if route in REFUSED:
        found = conversion_error(task, route)
        raise OptionError(
            f"plant: route {route!r} is refused: {REFUSED[route]}. From {task.band[0]:g} to"
            f" {task.band[1]:g} Hz its error is {100 * found.error:.3g} % of a peak, and"
            f" {100 * found.peak_error:.3g} % of the height of a resonance; use route='modal' or"
            " 'complex'"
        )
    if route not in ROUTES:
        raise OptionError(f"plant: no route {route!r}; {suggest(str(route), ROUTES)}")
    if route != "auto":
        return (route,)
    return ("modal", "complex", "rational") if error == "relative" else ("modal", "complex")


def choose_route(task: PlantTask, routes: tuple[str, ...], tolerance: float) -> CandidateSelection:
    """Return the selection of the first route that meets the tolerance, at least as stated."""
    # A rational approximation among several routes is preferred if it needs fewer states.
    reached: dict[str, CandidateSelection] = {}
    refused: dict[str, ModelError] = {}
    mode_routes = tuple(route for route in routes if route != "rational")
    best = _first_conversion(task, mode_routes, tolerance, reached, refused)
    if "rational" in routes:
        largest = None if best is None else _count_states(best) - 1
        try:
            found = find_fewest_states(task.approximation(), tolerance, largest)
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
    errors = ", ".join(f"{kept.error:.3g} by route {route!r}" for route, kept in reached.items())
    advice = "Allow a larger tolerance, narrow the band"
    if others:
        advice += f", or try route {others}"
    raise ToleranceError(
        f"plant: no order holds a tolerance of {tolerance:g} from {task.band[0]:g} to"
        f" {task.band[1]:g} Hz; reached:"
        f" {errors}.{_explain_causal_limit(task, reached, tolerance)} {advice}"
    )


def _explain_causal_limit(
    task: PlantTask, reached: dict[str, CandidateSelection], tolerance: float
) -> str:
    """Return a sentence if causality prevents the tolerance; else an empty text."""
    if not task.space.lossy:
        return ""
    least = task.least(min(reached.values(), key=lambda kept: kept.error))
    gain = CAUSAL_BOUND.outside_gain
    limit = (
        f"stable plant whose gain outside the band is at most {gain:g} times the largest of the"
        " structure there"
    )
    if least > tolerance:
        return (
            " Structural damping is not causal (Kramers-Kronig): no system in time has its phase"
            f" over the band, and the error of a {limit} is at least {least:.2g}."
        )
    return (
        f" Causality does not prevent it: the error of a {limit} is at least {least:.2g}, which is"
        " below the tolerance."
    )


def _first_conversion(
    task: PlantTask,
    routes: tuple[str, ...],
    tolerance: float,
    reached: dict[str, CandidateSelection],
    refused: dict[str, ModelError],
) -> CandidateSelection | None:
    """Return the first conversion of the structure's modes that holds the tolerance; else None."""
    for lenient in (False, True):
        for route in (r for r in routes if r not in refused):
            try:
                for conversion in task.fitted_conversions(route):
                    found = select_fewest(conversion, task.target, tolerance, lenient=lenient)
                    if found.holds:
                        return found
                    if route not in reached or found.error < reached[route].error:
                        reached[route] = found
            except ModelError as error:
                refused[route] = error
        if task.target.measure == "relative":
            break
    return None


def _count_states(found: CandidateSelection) -> int:
    if isinstance(found.conversion, Rational):
        return found.conversion.n_states
    return len(found.conversion.matrices(found.mask)[0])


def reuse_selection(
    task: PlantTask, like: CandidateSelection, tolerance: float
) -> CandidateSelection | None:
    """Return the selection of another state of the model for a task; None if it does not apply."""
    other, target = like.conversion, task.target
    if isinstance(other, Rational):
        return refit_poles(task.approximation(), other, tolerance)
    terms = len(other.terms[0].b) if isinstance(other, Biot) and other.terms else 4
    try:
        conversion = task.conversion(other.name, terms)
    except ModelError:
        return None
    if isinstance(other, FittedModes) and isinstance(conversion, ComplexModes):
        conversion = fit_outputs(conversion, target, len(other.extra), at_rest=other.at_rest)
    if len(conversion.frequency) != len(like.mask):
        return None
    return judge_selection(conversion, target, like.mask, target.limits(tolerance))
