"""`Section` of a beam, and the common shapes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from updyn.elements.checks import check_keys, number, positive
from updyn.errors import ModelError, suggest

__all__ = ["Section", "rectangle", "section_from_table", "tube"]


@dataclass(frozen=True, slots=True)
class Section:
    """Cross-section of a beam about its centroid, which is its shear centre too.

    Parameters
    ----------
    A : float
        Area in m2.
    Iyy, Izz : float
        Second moments of area about the local y and z axes, in m4: the integrals of z^2 and of y^2.
        Izz bends the beam in its local xy plane (the plane of the orientation vector), Iyy in its
        xz plane. The mass turns about x with rho (Iyy + Izz) per length.
    J : float
        Torsion constant in m4: the torsional stiffness is G J. Only for round sections it is Iyy +
        Izz.
    shear_y, shear_z : float, optional
        Effective over true shear area along local y and z. None: no shear deformation
        (Euler-Bernoulli).

    Raises
    ------
    ModelError
        If a number is not above 0.
    """

    A: float
    Iyy: float
    Izz: float
    J: float
    shear_y: float | None = None
    shear_z: float | None = None

    def __post_init__(self) -> None:
        for name in ("A", "Iyy", "Izz", "J"):
            object.__setattr__(self, name, positive("section", name, getattr(self, name)))
        for name in ("shear_y", "shear_z"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, positive("section", name, getattr(self, name)))

    @property
    def is_round(self) -> bool:
        """Whether both bending planes are alike, so that no orientation is needed."""
        return math.isclose(self.Iyy, self.Izz, rel_tol=1e-9) and self.shear_y == self.shear_z


def rectangle(height: float, width: float, nu: float = 0.3) -> Section:
    """Return a solid rectangle.

    Parameters
    ----------
    height : float
        Along local y, in m.
    width : float
        Along local z, in m.
    nu : float
        Poisson's ratio, for the shear coefficient.

    Returns
    -------
    Section
        J by the series of Timoshenko & Goodier (Theory of Elasticity, 3rd ed. 1970, section 109),
        shear coefficient 10 (1 + nu) / (12 + 11 nu) (Cowper, J. Applied Mechanics 33 (1966) 335).

    Raises
    ------
    ModelError
        If a length is not above 0, or nu is not above -1 and at most 0.5.
    """
    h, w = positive("rectangle", "height", height), positive("rectangle", "width", width)
    a, b = max(h, w), min(h, w)
    series = sum(math.tanh(n * math.pi * a / (2 * b)) / n**5 for n in range(1, 40, 2))
    J = a * b * b * b / 3 * (1 - 192 / math.pi**5 * b / a * series)
    kappa = 10 * (1 + _poisson("rectangle", nu)) / (12 + 11 * nu)
    return Section(h * w, h * w * w * w / 12, w * h * h * h / 12, J, kappa, kappa)


def tube(outer: float, inner: float = 0.0, nu: float = 0.3) -> Section:
    """Return a round tube, or a round bar.

    Parameters
    ----------
    outer, inner : float
        Diameters in m; inner 0: a solid bar.
    nu : float
        Poisson's ratio, for the shear coefficient.

    Returns
    -------
    Section
        Shear coefficient of Cowper, J. Applied Mechanics 33 (1966) 335, table 1, hollow circle.

    Raises
    ------
    ModelError
        If the outer diameter is not above the inner one, or nu is not above -1 and at most 0.5.
    """
    D, d = positive("tube", "outer", outer), number("tube", "inner", inner)
    if not 0 <= d < D:
        raise ModelError(
            f"tube: inner diameter {inner!r}; expected at least 0 and below the outer one,"
            f" {outer!r} m"
        )
    v, m = _poisson("tube", nu), (d / D) ** 2
    kappa = 6 * (1 + v) * (1 + m) ** 2 / ((7 + 6 * v) * (1 + m) ** 2 + (20 + 12 * v) * m)
    second = math.pi * (D * D + d * d) * (D * D - d * d) / 64
    return Section(math.pi * (D * D - d * d) / 4, second, second, 2 * second, kappa, kappa)


def _poisson(what: str, nu: float) -> float:
    if not -1.0 < number(what, "nu", nu) <= 0.5:
        raise ModelError(f"{what}: nu {nu!r}; expected above -1 and at most 0.5")
    return float(nu)


_SHAPES: dict[str, tuple[Any, tuple[str, ...], tuple[str, ...]]] = {
    "rectangle": (rectangle, ("height", "width"), ("nu",)),
    "tube": (tube, ("outer",), ("inner", "nu")),
}


def section_from_table(where: str, given: Any) -> Section:
    """Build the section of a beam from a table: the fields of `Section`, or a ``shape`` and its dimensions in m.

    Raises
    ------
    ModelError
        If a key is missing or unknown; the message begins with `where`.
    """
    if not isinstance(given, Mapping):
        raise ModelError(f"{where}: section {given!r}; expected a table")
    if "shape" not in given:
        own = [f.name for f in fields(Section)]
        check_keys(f"{where}: section", given, own[:4], own)
        return Section(**given)
    shape = given["shape"]
    if not isinstance(shape, str) or shape not in _SHAPES:
        raise ModelError(f"{where}: section.shape {shape!r}: {suggest(str(shape), _SHAPES)}")
    make, required, optional = _SHAPES[shape]
    sizes = {k: v for k, v in given.items() if k != "shape"}
    check_keys(f"{where}: section, a {shape}", sizes, required, optional)
    section = make(**sizes)
    assert isinstance(section, Section)
    return section
