"""Kinds of nonlinear elements: the elements from which the search for their parameters begins."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from updyn.candidates.location.settings import LOCATION
from updyn.errors import OptionError, suggest
from updyn.nonlinear.backlash import Backlash
from updyn.nonlinear.cubic import CubicSpring
from updyn.nonlinear.damper import QuadraticDamper
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.friction import CoulombFriction
from updyn.nonlinear.iwan import IwanJoint
from updyn.nonlinear.jenkins import JenkinsElement
from updyn.nonlinear.parameters import list_parameters
from updyn.nonlinear.polynomial import PolynomialSpring

__all__ = ["Kind", "Scale", "choose_kinds"]

Bounds = Mapping[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class Scale:
    """Stiffness in N/m, amplitude of deformation in m, and circular frequency in rad/s."""

    stiffness: float
    amplitude: float
    omega: float


def _no_bounds(element: NonlinearElement) -> Bounds:
    return {}


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of element: its starts at a scale, and bounds of parameters that differ from usual."""

    name: str
    starts: Callable[[Scale], Sequence[NonlinearElement]]
    bounds: Callable[[NonlinearElement], Bounds] = field(default=_no_bounds)


def _cubic(s: Scale) -> Sequence[NonlinearElement]:
    c = s.stiffness / s.amplitude**2
    return CubicSpring(c), CubicSpring(-c)


def _polynomial(s: Scale) -> Sequence[NonlinearElement]:
    c3, c5 = s.stiffness / s.amplitude**2, s.stiffness / s.amplitude**4
    return (PolynomialSpring({3: c3, 5: c5}),)


def _bound_polynomial(element: NonlinearElement) -> Bounds:
    ratio = LOCATION.polynomial_bound
    return {n: (-ratio * abs(x), ratio * abs(x)) for n, x in list_parameters(element).items()}


def _backlash(s: Scale) -> Sequence[NonlinearElement]:
    return [Backlash(2.0 * s.stiffness, gap * s.amplitude) for gap in (0.1, 0.4, 1.2)]


def _jenkins(s: Scale) -> Sequence[NonlinearElement]:
    force = s.stiffness * s.amplitude
    return [JenkinsElement(2.0 * s.stiffness, share * force) for share in (0.05, 0.3, 1.0)]


def _iwan(s: Scale) -> Sequence[NonlinearElement]:
    force = s.stiffness * s.amplitude
    return [IwanJoint(f * force, 2.0 * s.stiffness, -0.5, 0.5) for f in (0.05, 0.3, 1.0, 3.0)]


def _bound_iwan(element: NonlinearElement) -> Bounds:
    return {"chi": LOCATION.chi_bounds, "beta": LOCATION.beta_bounds}


def _coulomb(s: Scale) -> Sequence[NonlinearElement]:
    force, speed = 0.3 * s.stiffness * s.amplitude, s.omega * s.amplitude
    return [CoulombFriction(force, transition=share * speed) for share in (0.01, 0.1)]


def _quadratic(s: Scale) -> Sequence[NonlinearElement]:
    return (QuadraticDamper(s.stiffness / (s.omega**2 * s.amplitude)),)


#: Kinds by the name of `updyn.nonlinear.ELEMENTS`.
KINDS = {
    kind.name: kind
    for kind in (
        Kind("cubic-spring", _cubic),
        Kind("polynomial-spring", _polynomial, _bound_polynomial),
        Kind("backlash", _backlash),
        Kind("jenkins", _jenkins),
        Kind("iwan", _iwan, _bound_iwan),
        Kind("coulomb-friction", _coulomb),
        Kind("quadratic-damper", _quadratic),
    )
}


def choose_kinds(
    kinds: Iterable[str] | Mapping[str, NonlinearElement] | None,
) -> Sequence[Kind]:
    """Return kinds by name or by the elements to start from; OptionError for an unknown name."""
    if kinds is None:
        return tuple(KINDS.values())
    if isinstance(kinds, Mapping):
        return tuple(_make_kind(name, element) for name, element in kinds.items())
    listed = [kinds] if isinstance(kinds, str) else list(kinds)
    for name in listed:
        if name not in KINDS:
            raise OptionError(f"kinds: no kind {name!r}; {suggest(str(name), KINDS)}")
    if not listed:
        raise OptionError("kinds: expected at least one, found none")
    return tuple(KINDS[name] for name in dict.fromkeys(listed))


def _make_kind(name: str, element: NonlinearElement) -> Kind:
    """Return a kind that starts from one element."""
    if not hasattr(element, "over_period"):
        raise OptionError(
            f"kinds: {name!r} is {element!r}; expected a nonlinear element such as CubicSpring(1e8)"
        )
    return Kind(name, lambda scale: (element,))
