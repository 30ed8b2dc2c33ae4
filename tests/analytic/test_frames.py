"""Beams, trusses and frames in space against closed forms."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

import updyn
from bodies import deflection
from updyn.elements.beam import beam
from updyn.elements.structure import (
    Beam,
    PointMass,
    Section,
    Spring,
    Truss,
    rectangle,
    structure,
    tube,
)

E, RHO, NU = 2.1e11, 7850.0, 0.3
G = E / (2 * (1 + NU))
L = 2.0
#: Slender, so that rotary inertia does not show; twice as wide as high. J is not Ip.
FLAT = rectangle(0.005, 0.01)
NO_SHEAR = Section(FLAT.A, FLAT.Iyy, FLAT.Izz, FLAT.J)


def line(
    section: Section, n: int = 20, direction=(1.0, 0.0, 0.0), orientation=(0.0, 1.0, 0.0), **kw
) -> updyn.Model:
    nodes = np.outer(np.linspace(0.0, L, n + 1), direction)
    elements = np.column_stack([np.arange(1, n + 1), np.arange(2, n + 2)])
    parts = [
        Beam("beam", elements, E, RHO, section, NU, orientation=orientation),
        *kw.pop("more", []),
    ]
    return structure(nodes, parts, **kw)


def frequencies_about(model: updyn.Model, direction: str, n: int = 30) -> np.ndarray:
    """Natural frequencies of the modes that move mostly in one direction."""
    modes = updyn.modes(model, n)
    axis = ["X", "Y", "Z", "RX", "RY", "RZ"].index(direction)
    own = model.dofs.axes == axis
    others = (model.dofs.axes < 3) != own if axis < 3 else model.dofs.axes < 3
    part = np.abs(modes.shapes[own]).max(axis=0)
    rest = np.abs(modes.shapes[others & ~own]).max(axis=0)
    return modes.frequency[part > rest]


def bending(roots: list[float], inertia: float, section: Section) -> np.ndarray:
    return np.array(roots) ** 2 / (2 * pi * L**2) * sqrt(E * inertia / (RHO * section.A))


#: Roots of cos x cosh x = -1 and 1: Blevins, Formulas for Natural Frequency and Mode Shape, 1979,
#: table 8-1.
CANTILEVER = [1.87510407, 4.69409113, 7.85475744, 10.99554073]
FREE = [4.73004074, 7.85320462, 10.9956078]


def test_a_cantilever_bends_in_both_planes_as_in_blevins():
    model = line(NO_SHEAR, grounded=[1])
    # The orientation, Y, lies in the local xy plane: Izz bends along Y, Iyy along Z.
    np.testing.assert_allclose(
        frequencies_about(model, "Y")[:4], bending(CANTILEVER, FLAT.Izz, FLAT), rtol=2e-4
    )
    np.testing.assert_allclose(
        frequencies_about(model, "Z")[:4], bending(CANTILEVER, FLAT.Iyy, FLAT), rtol=3e-4
    )


def test_the_orientation_says_which_way_a_section_stands():
    model = line(NO_SHEAR, grounded=[1], orientation=(0.0, 0.0, 1.0))
    np.testing.assert_allclose(
        frequencies_about(model, "Z")[:4], bending(CANTILEVER, FLAT.Izz, FLAT), rtol=2e-4
    )


def test_a_free_beam_has_six_rigid_modes_and_then_those_of_blevins():
    modes = updyn.modes(line(NO_SHEAR), 9).frequency
    assert modes[:6].max() < 1e-3 * modes[6]
    assert modes[6] == pytest.approx(bending(FREE, FLAT.Izz, FLAT)[0], rel=1e-4)


@pytest.mark.parametrize(
    "section", [NO_SHEAR, FLAT, tube(0.02, 0.016)], ids=["no shear", "shear", "tube"]
)
def test_torsion_has_the_stiffness_of_J_and_the_inertia_of_Ip(section):
    """f_n = (2 n - 1) / (4 L) sqrt(G J / (rho Ip)); Rao, Mechanical Vibrations, 5th ed. 2011, section 8.4."""
    n = 40
    model = line(section, n, grounded=[1])
    only = [d for d in model.dofs.labels if not d.endswith(":RX")]
    held = line(section, n, grounded=[1, *only])
    exact = (
        np.array([1, 3, 5]) / (4 * L) * sqrt(G * section.J / (RHO * (section.Iyy + section.Izz)))
    )
    found = updyn.modes(held, 3).frequency
    np.testing.assert_allclose(found, exact, rtol=2e-3)
    # Linear shape functions with consistent mass: the error is (k h)^2 / 24 from above, Petyt 2010,
    # section 3.3.
    error = (np.array([1, 3, 5]) * pi / 2 / n) ** 2 / 24
    np.testing.assert_allclose(found / exact - 1, error, rtol=0.01)
    twist = deflection(model, {f"{n + 1}:RX": 3.0})[f"{n + 1}:RX"]
    assert twist == pytest.approx(3.0 * L / (G * section.J), rel=1e-9)


def test_a_rod_stretches_as_in_rao():
    """f_n = (2 n - 1) / (4 L) sqrt(E / rho); Rao, Mechanical Vibrations, 5th ed. 2011, section 8.3, fixed-free."""
    n = 40
    nodes = np.outer(np.linspace(0.0, L, n + 1), [1.0, 0, 0])
    elements = np.column_stack([np.arange(1, n + 1), np.arange(2, n + 2)])
    exact = np.array([1, 3, 5]) / (4 * L) * sqrt(E / RHO)
    across = [f"{k}:{d}" for k in range(2, n + 2) for d in "YZ"]
    rod = structure(nodes, [Truss("rod", elements, E, RHO, 1e-4)], grounded=[1, *across])
    np.testing.assert_allclose(updyn.modes(rod, 3).frequency, exact, rtol=2e-3)


def test_shear_bends_a_stocky_cantilever_further():
    """P L^3 / (3 E I) + P L / (kappa G A): Timoshenko & Gere, Mechanics of Materials; Bathe 2014, eq. 1.2."""
    section = rectangle(0.8, 0.5, NU)
    kappa = 10 * (1 + NU) / (12 + 11 * NU)
    model = line(section, 3, grounded=[1])
    for axis, inertia in (("Y", 0.5 * 0.8**3 / 12), ("Z", 0.8 * 0.5**3 / 12)):
        found = deflection(model, {f"4:{axis}": 1e3})[f"4:{axis}"]
        assert found == pytest.approx(
            1e3 * (L**3 / (3 * E * inertia) + L / (kappa * G * 0.4)), rel=1e-9
        )
    rigid = line(Section(section.A, section.Iyy, section.Izz, section.J), 3, grounded=[1])
    unlike = line(
        Section(section.A, section.Iyy, section.Izz, section.J, 0.9, 0.4), 3, grounded=[1]
    )
    for axis, inertia, kappa in (("Y", section.Izz, 0.9), ("Z", section.Iyy, 0.4)):
        bent = 1e3 * L**3 / (3 * E * inertia)
        assert deflection(rigid, {f"4:{axis}": 1e3})[f"4:{axis}"] == pytest.approx(bent, rel=1e-7)
        sheared = bent + 1e3 * L / (kappa * G * 0.4)
        assert deflection(unlike, {f"4:{axis}": 1e3})[f"4:{axis}"] == pytest.approx(
            sheared, rel=1e-9
        )


def test_sections_are_those_of_the_tables():
    """J of a rectangle 2 : 1 is 0.229 a b^3, of a square 0.141: Timoshenko & Goodier 1970, table in section 109."""
    tall, flat, square, bar = (
        rectangle(0.2, 0.1),
        rectangle(0.1, 0.2),
        rectangle(0.1, 0.1),
        tube(0.1),
    )
    assert pytest.approx(0.229 * 0.2 * 0.1**3, rel=2e-3) == tall.J
    assert flat.J == tall.J
    assert pytest.approx(0.1406 * 0.1**4, rel=2e-4) == square.J
    assert pytest.approx(pi * 0.1**4 / 32) == bar.J
    assert bar.shear_y == pytest.approx(6 * 1.3 / (7 + 6 * 0.3))  # Cowper 1966, circle
    assert tube(0.1, 0.0999).shear_y == pytest.approx(
        2 * 1.3 / (4 + 3 * 0.3), rel=1e-5
    )  # thin tube


def test_a_portal_frame_sways_as_in_chopra():
    """k = 24 E Ic / h^3 (12 r + 1) / (12 r + 4), r = Ib / (4 Ic), beam 2 h long: Chopra, 4th ed. 2012, section 1.3."""
    h, column, girder = 3.0, 2e-5, 5e-5
    nodes = [[0, 0, 0], [0, 0, h], [2 * h, 0, h], [2 * h, 0, 0]]

    def section(inertia: float) -> Section:
        return Section(1e3, inertia, inertia, inertia)  # so much area that nothing stretches

    parts = [
        Beam("columns", [[1, 2], [4, 3]], E, RHO, section(column)),
        Beam("girder", [[2, 3]], E, RHO, section(girder)),
    ]
    model = structure(nodes, parts, grounded=[1, 4])
    out = deflection(model, {"2:X": 500.0, "3:X": 500.0})
    r = girder / (4 * column)
    k = 24 * E * column / h**3 * (12 * r + 1) / (12 * r + 4)
    assert out["2:X"] == pytest.approx(1000.0 / k, rel=1e-5)


def test_a_two_bar_truss_as_by_hand():
    """Bars of stiffness EA/L at +-30 degrees to the vertical: k = 2 EA/L cos^2, and sin^2 across."""
    A, length = 4e-4, 1.5
    c, s = np.cos(pi / 6), np.sin(pi / 6)
    nodes = [[0, 0, 0], [length * s, 0, length * c], [-length * s, 0, length * c]]
    bars = Truss("bars", [[1, 2], [1, 3]], E, 1e-6, A)
    model = structure(nodes, [bars, PointMass("load", 1, 25.0)], grounded=[2, 3, "1:Y"])
    assert model.dofs.labels == ["1:X", "1:Z"]
    k = E * A / length
    np.testing.assert_allclose(
        model.stiffness.toarray(), np.diag([2 * k * s**2, 2 * k * c**2]), atol=1e-9 * k
    )
    exact = np.sqrt(2 * k / 25.0) / (2 * pi)
    np.testing.assert_allclose(updyn.modes(model, 2).frequency, [exact * s, exact * c], rtol=1e-8)


def test_a_cantilever_on_a_spring_is_stiffer_by_it():
    model = line(
        NO_SHEAR, 4, grounded=[1], more=[Spring("prop", 5, stiffness=(0, 700.0, 0, 0, 0, 0))]
    )
    k = 3 * E * FLAT.Izz / L**3 + 700.0
    assert deflection(model, {"5:Y": 1.0})["5:Y"] == pytest.approx(1 / k, rel=1e-8)


def test_a_mass_on_a_cantilever_as_in_blevins():
    """f = sqrt(3 E I / (L^3 (M + 0.24 m))) / 2 pi: Blevins 1979, table 8-8, case 2, within half a per cent."""
    own = RHO * FLAT.A * L
    model = line(NO_SHEAR, 10, grounded=[1], more=[PointMass("tip", 11, 5 * own)])
    exact = sqrt(3 * E * FLAT.Izz / (L**3 * (5 * own + 0.24 * own))) / (2 * pi)
    assert updyn.modes(model, 1).frequency[0] == pytest.approx(exact, rel=5e-3)


def test_a_beam_in_space_is_the_planar_one():
    """Two builds of the same element: the planar beam of its own formulas, and this one in a plane of bending."""
    width, height, n = 0.04, 0.06, 7
    kappa = 10 * (1 + NU) / (12 + 11 * NU)
    flat = beam(
        L, E=E, rho=RHO, width=width, height=height, nu=NU, shear_coefficient=kappa, n_elements=n
    )
    across = [f"{k}:{d}" for k in range(1, n + 2) for d in ("X", "Y", "RX", "RZ")]
    space = line(rectangle(height, width, NU), n, orientation=(0.0, 0.0, 1.0), grounded=across)
    assert space.dofs == flat.dofs
    for found, own in ((space.stiffness, flat.stiffness), (space.mass, flat.mass)):
        assert abs(found - own).max() < 1e-9 * abs(own).max()
