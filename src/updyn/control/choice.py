"""The choice of a plant: the route, and the fewest states by it that hold the tolerance."""

from __future__ import annotations

from updyn.control.causal import GAIN
from updyn.control.complex_modes import ComplexModes, Fitted, fitted
from updyn.control.conversions import REFUSED, error_of
from updyn.control.rational import Rational
from updyn.control.rational_states import fewest_states, with_poles_of
from updyn.control.real_modes import Biot
from updyn.control.target import Kept, fewest, judged
from updyn.control.task import Task
from updyn.errors import ModelError, OptionError, ToleranceError, suggest

__all__ = ["ROUTES", "check_route", "chosen", "like_another"]

#: How structural damping becomes poles.
ROUTES = ("auto", "modal", "complex", "rational", "biot")


def check_route(route: str, task: Task, error: str) -> tuple[str, ...]:
    """Return the routes that are tried.

    Parameters
    ----------
    route : str
        One of `ROUTES`.
    task : Task
        What is realised: a route that is refused is so with its error.
    error : {"relative", "peak"}
        For what the tolerance holds.

    Raises
    ------
    OptionError
        If it is none, or refused.
    """
    if route in REFUSED:
        found = error_of(task, route)
        raise OptionError(
            f"plant: route {route!r} is refused: {REFUSED[route]}. From {task.band[0]:g} to"
            f" {task.band[1]:g} Hz it is wrong by {100 * found.error:.3g} % of a peak, and by"
            f" {100 * found.peak_error:.3g} % in the height of a resonance; use route='modal' or"
            " 'complex'"
        )
    if route not in ROUTES:
        raise OptionError(f"plant: no route {route!r}; {suggest(str(route), ROUTES)}")
    if route != "auto":
        return (route,)
    return ("modal", "complex", "rational") if error == "relative" else ("modal", "complex")


def chosen(task: Task, routes: tuple[str, ...], tolerance: float) -> Kept:
    """Return the first route that holds the tolerance, in the plant's stated errors at least.

    Where a rational approximation is among several, it is taken if it needs fewer states.

    Parameters
    ----------
    task : Task
        What is realised.
    routes : tuple of str
        Those that are tried, in this order.
    tolerance : float
        On the errors that `Target.measure` names.

    Raises
    ------
    ModelError
        If no route is possible.
    ToleranceError
        If none holds the tolerance.
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


def _why(task: Task, reached: dict[str, Kept], tolerance: float) -> str:
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
    task: Task,
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


def like_another(task: Task, like: Kept, tolerance: float) -> Kept | None:
    """Return the choice of another state of the model for a task.

    Parameters
    ----------
    task : Task
        What is realised.
    like : Kept
        The choice of the other state.
    tolerance : float
        On the errors that `Target.measure` names.

    Returns
    -------
    Kept or None
        None where this state has no such one.
    """
    own, target = like.conversion, task.target
    if isinstance(own, Rational):
        return with_poles_of(task.approximation(), own, tolerance)
    terms = len(own.terms[0].b) if isinstance(own, Biot) and own.terms else 4
    try:
        conversion = task.conversion(own.name, terms)
    except ModelError:
        return None
    if isinstance(own, Fitted) and isinstance(conversion, ComplexModes):
        conversion = fitted(conversion, target, len(own.extra), at_rest=own.at_rest)
    if len(conversion.frequency) != len(like.mask):
        return None
    return judged(conversion, target, like.mask, target.limits(tolerance))
