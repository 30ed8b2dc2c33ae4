"""The Timoshenko beam against closed forms."""

import re

import numpy as np
import pytest
import scipy.optimize

import updyn
from updyn.elements.beam import (
    BeamMass,
    BeamSupport,
    Segment,
    beam,
    beam_from_table,
    element_matrices,
)
from updyn.errors import ModelError

STEEL = {"E": 210e9, "rho": 7850.0, "width": 0.04, "height": 0.02, "nu": 0.3}
LENGTH = 0.6
A = 0.04 * 0.02
INERTIA = 0.04 * 0.02**3 / 12
KAPPA = 13 / 15.3  # 10 (1 + nu) / (12 + 11 nu) at nu = 0.3
G = 210e9 / 2.6


def rigid(model, x0=0.0):
    """Heave and pitch about x0 as vectors of Z, RY."""
    x = model.geometry.xyz[:, 0]
    heave, pitch = np.zeros(2 * len(x)), np.zeros(2 * len(x))
    heave[0::2] = 1.0
    pitch[0::2], pitch[1::2] = x - x0, -1.0  # RY = -dw/dx
    return heave, pitch


def timoshenko_free(count):
    """Natural frequencies of the free-free Timoshenko beam from its characteristic equation, in Hz.

    The general solution of EI psi'' + kGA (w' - psi) + rho I omega^2 psi = 0, kGA (w'' - psi') +
    rho A omega^2 w = 0 is put together from exponentials exp(lambda x); moment EI psi' and shear
    kGA (w' - psi) vanish at both ends."""
    EI, S, m, j = 210e9 * INERTIA, KAPPA * G * A, 7850 * A, 7850 * INERTIA

    def determinant(f):
        w2 = (2 * np.pi * f) ** 2
        p = np.polynomial.Polynomial(
            [m * w2 * (j * w2 - S) / (EI * S), j * w2 / EI + m * w2 / S, 1.0]
        )
        columns = []
        for square in p.roots():  # one positive, one negative below the cut-on frequency
            k = np.sqrt(abs(square))
            growing = square > 0
            for even in (True, False):
                # w = c(kx) or s(kx) about the middle, psi from the second equation
                x = LENGTH / 2
                c, s = (
                    (np.cosh(k * x), np.sinh(k * x)) if growing else (np.cos(k * x), np.sin(k * x))
                )
                slope = m * w2 / (S * k) + (k if growing else -k)  # psi' = w'' + m w2 w / S
                value = c if even else s
                if growing:
                    moment = EI * (k**2 + m * w2 / S) * value
                    dw, psi = (k * s, slope * s) if even else (k * c, slope * c)
                else:
                    moment = EI * (-(k**2) + m * w2 / S) * value
                    gain = -k + m * w2 / (S * k)
                    dw, psi = (-k * s, gain * s) if even else (k * c, -gain * c)
                columns.append((even, moment / EI, (dw - psi)))
        out = []
        for even in (True, False):
            (_, m1, q1), (_, m2, q2) = [c for c in columns if c[0] is even]
            out.append(m1 * q2 - m2 * q1)
        return out

    # Symmetric and antisymmetric modes apart: their roots are simple.
    grid = np.linspace(50.0, 9000.0, 4000)
    values = np.array([determinant(f) for f in grid])
    roots = []
    for family in (0, 1):
        for i in np.flatnonzero(np.sign(values[:-1, family]) != np.sign(values[1:, family])):
            roots.append(
                scipy.optimize.brentq(
                    lambda f, k=family: determinant(f)[k], grid[i], grid[i + 1], xtol=1e-10
                )
            )
    return np.sort(roots)[:count]


def test_element_mass_is_that_of_its_shape_functions():
    """Friedman & Kosmatka's printed polynomials against quadrature of the cubic that solves the static element."""
    length, shear = 0.3, 0.004
    phi = 12 * shear / length**2
    x, weight = np.polynomial.legendre.leggauss(8)
    x, weight = (x + 1) / 2, weight / 2 * length
    # w = a + b x + c x^2 + d x^3 with t = w' + (shear) w''' l-scaled: static equilibrium of the
    # Timoshenko element
    powers = np.stack([np.ones_like(x), x, x**2, x**3])
    slopes = np.stack([np.zeros_like(x), np.ones_like(x), 2 * x, 3 * x**2 + phi / 2]) / length
    ends = np.array(
        [[1, 0, 0, 0], [0, 1, 0, phi / 2], [1, 1, 1, 1], [0, 1, 2, 3 + phi / 2]], dtype=float
    )
    ends[1::2] /= length
    N = np.linalg.solve(ends.T, powers)
    Nt = np.linalg.solve(ends.T, slopes)
    K, M_w, M_t = (m[0] for m in element_matrices([length], 2.0, 3.0, 5.0, shear))
    assert np.allclose(M_w, 3.0 * (N * weight) @ N.T, rtol=1e-12, atol=1e-14)
    assert np.allclose(M_t, 5.0 * (Nt * weight) @ Nt.T, rtol=1e-12, atol=1e-12)
    bending = np.linalg.solve(ends.T, np.stack([0 * x, 0 * x, 2 + 0 * x, 6 * x]) / length**2)
    strain = np.linalg.solve(ends.T, np.stack([0 * x, 0 * x, 0 * x, -phi / 2 + 0 * x]) / length)
    energy = 2.0 * (bending * weight) @ bending.T + 2.0 / shear * (strain * weight) @ strain.T
    assert np.allclose(K, energy, rtol=1e-12)


@pytest.mark.parametrize("n_elements", [1, 7])
def test_cantilever_tip_with_shear_is_exact_on_any_mesh(n_elements):
    model = beam(LENGTH, **STEEL, n_elements=n_elements)
    K = model.stiffness.toarray()[2:, 2:]
    force = np.zeros(len(K))
    force[-2] = 100.0
    tip = np.linalg.solve(K, force)[-2:]
    EI = 210e9 * INERTIA
    assert tip[0] == pytest.approx(
        100 * LENGTH**3 / (3 * EI) + 100 * LENGTH / (KAPPA * G * A), rel=1e-9
    )
    assert tip[1] == pytest.approx(
        -100 * LENGTH**2 / (2 * EI), rel=1e-9
    )  # upward force turns X towards +Z: RY < 0


def test_free_free_frequencies_against_the_timoshenko_equation():
    exact = timoshenko_free(7)
    # Euler-Bernoulli bounds the first root from above, and is near it for so slender a beam.
    euler = 4.730040745**2 / (2 * np.pi * LENGTH**2) * np.sqrt(210e9 * INERTIA / (7850 * A))
    assert 0.98 * euler < exact[0] < euler
    found = updyn.modes(beam(LENGTH, **STEEL, n_elements=100), 9).frequency
    assert (found[:2] == 0.0).all()
    assert found[2:] == pytest.approx(exact, rel=4e-4)
    # The error is of second order (constant shear strain in an element): two meshes extrapolate to
    # the exact value.
    finer = updyn.modes(beam(LENGTH, **STEEL, n_elements=200), 9).frequency
    assert ((4 * finer - found) / 3)[2:] == pytest.approx(exact, rel=1e-6)


def test_frequencies_converge_from_above():
    exact = timoshenko_free(2)[1]
    error = [
        updyn.modes(beam(LENGTH, **STEEL, n_elements=n), 4).frequency[3] / exact - 1
        for n in (50, 100, 200)
    ]
    assert 0 < error[2] < 2e-6
    assert error[0] / error[1] == pytest.approx(4, rel=0.05)
    assert error[1] / error[2] == pytest.approx(4, rel=0.05)


def test_euler_bernoulli_cantilever():
    """A very slender beam: (1.8751, 4.6941, 7.8548)^2 (Blevins 1979, table 8-1)."""
    model = beam(
        1.0,
        E=210e9,
        rho=7850,
        width=0.01,
        height=0.001,
        n_elements=40,
        supports=[BeamSupport("clamp", 0.0, 1e9, 1e9)],
    )
    EI, m = 210e9 * 0.01 * 0.001**3 / 12, 7850 * 1e-5
    exact = np.array([1.87510407, 4.69409113, 7.85475744]) ** 2 / (2 * np.pi) * np.sqrt(EI / m)
    assert updyn.modes(model, 3).frequency == pytest.approx(exact, rel=2e-5)


def test_mass_inertia_and_rigid_body_modes_are_exact():
    model = beam(
        LENGTH,
        **STEEL,
        n_elements=13,
        stations=[0.11, 0.37],
        masses=[BeamMass("sensor", 0.37, 0.02, 3e-6)],
    )
    heave, pitch = rigid(model, LENGTH / 2)
    M, K = model.mass, model.stiffness
    m = 7850 * A * LENGTH
    about = m * LENGTH**2 / 12 + 7850 * INERTIA * LENGTH + 0.02 * 0.07**2 + 3e-6
    assert heave @ M @ heave == pytest.approx(m + 0.02, rel=1e-12)
    assert pitch @ M @ pitch == pytest.approx(about, rel=1e-12)
    assert heave @ M @ pitch == pytest.approx(0.02 * 0.07, rel=1e-9)
    scale = abs(K).max()
    assert np.abs(K @ heave).max() < 1e-12 * scale
    assert np.abs(K @ pitch).max() < 1e-12 * scale


def test_segments_sum_to_the_whole_and_carry_their_own_properties():
    whole = beam(LENGTH, **STEEL, nodes=np.linspace(0, LENGTH, 13))
    cut = [Segment("end", 0, 0.15), Segment("middle", 0.15, 0.4), Segment("end", 0.4, LENGTH)]
    parts = beam(LENGTH, **STEEL, nodes=np.linspace(0, LENGTH, 13), segments=cut)
    assert list(parts.groups) == ["end", "middle"]
    for what in ("stiffness", "mass"):
        assert (
            abs(getattr(whole, what) - getattr(parts, what)).max()
            <= 1e-15 * abs(getattr(whole, what)).max()
        )
    special = beam(
        LENGTH,
        **STEEL,
        n_elements=60,
        segments=[("left", 0, 0.3, 70e9, 2700.0), Segment("right", 0.3, LENGTH, viscous=8.0)],
    )
    heave, _ = rigid(special)
    assert heave @ special.group("left").mass @ heave == pytest.approx(2700 * A * 0.3, rel=1e-12)
    assert heave @ special.group("right").viscous @ heave == pytest.approx(8.0 * 0.3, rel=1e-12)
    assert special.group("left").viscous is None
    left = beam(0.3, **{**STEEL, "E": 70e9}, n_elements=30).stiffness
    assert abs(special.group("left").stiffness[:62, :62] - left).max() < 1e-9 * abs(left).max()


def test_supports_and_masses_stand_where_they_were_put():
    model = beam(
        LENGTH,
        **STEEL,
        supports=[
            BeamSupport("foam", 0.1, 2e4, 3.0, 0.3, 5.0),
            BeamSupport("foam", 0.5, 1e4, loss_factor=0.3),
        ],
        masses=[
            BeamMass("acc", 0.1, 0.004),
            BeamMass("acc", 0.1, 0.001),
            BeamMass("acc", 0.5, 0.002),
        ],
    )
    assert list(model.groups) == ["beam", "foam", "acc"]
    x = model.geometry.xyz[:, 0]
    a, b = (2 * int(np.flatnonzero(np.isclose(x, p))[0]) for p in (0.1, 0.5))
    foam = model.group("foam")
    assert foam.loss_factor == 0.3
    assert {
        (i, j): v
        for i, j, v in zip(*foam.stiffness.tocoo().coords, foam.stiffness.data, strict=True)
    } == {
        (a, a): 2e4,
        (a + 1, a + 1): 3.0,
        (b, b): 1e4,
    }
    assert foam.viscous[a, a] == 5.0
    assert foam.viscous.nnz == 1
    assert model.group("acc").mass.diagonal()[[a, b]] == pytest.approx([0.005, 0.002])


def test_stations_are_nodes_and_may_carry_their_own_numbers():
    plain = beam(LENGTH, **STEEL, n_elements=10, stations=[0.1234, 0.1236])
    x = plain.geometry.xyz[:, 0]
    assert np.array_equal(plain.geometry.nodes, np.arange(1, len(x) + 1))
    assert np.isin([0.1234, 0.1236], x).all()
    assert np.diff(x).max() <= 0.06 * (1 + 1e-9)
    named = beam(LENGTH, **STEEL, n_elements=10, stations={2: 0.5, 101: 0.1234})
    assert named.geometry.position([101, 2, 1, 3])[:, 0] == pytest.approx(
        [0.1234, 0.5, 0.0, 0.1234 / 3]
    )
    assert "2:Z" in named.dofs
    # Numbers do not change the physics.
    f = [1.0, 300.0]
    free = beam(LENGTH, **STEEL, n_elements=10, stations=[0.5, 0.1234])
    at = [f"{n}:Z" for n in free.geometry.nodes[np.isin(free.geometry.xyz[:, 0], [0.1234, 0.5])]]
    H = updyn.response(named, f, ["101:Z"], ["2:Z"]).values
    assert updyn.response(free, f, at[:1], at[1:]).values == pytest.approx(H, rel=1e-9)


def test_table_builds_the_same_beam():
    table = {
        "kind": "beam",
        "length": LENGTH,
        **STEEL,
        "loss_factor": 0.01,
        "stations": {"101": 0.2, "102": 0.35},
        "segments": [
            {"name": "a", "start": 0.0, "end": 0.3},
            {"name": "b", "start": 0.3, "end": 0.6},
        ],
        "supports": [{"name": "foam", "x": 0.1, "stiffness": 1e4}],
        "masses": [{"name": "acc", "x": 0.2, "mass": 0.004}],
    }
    model = beam_from_table(table)
    same = beam(
        LENGTH,
        **STEEL,
        loss_factor=0.01,
        stations={101: 0.2, 102: 0.35},
        segments=[Segment("a", 0.0, 0.3), Segment("b", 0.3, 0.6)],
        supports=[BeamSupport("foam", 0.1, 1e4)],
        masses=[BeamMass("acc", 0.2, 0.004)],
    )
    assert model.dofs == same.dofs
    assert list(model.groups) == ["a", "b", "foam", "acc"]
    assert abs(model.stiffness - same.stiffness).max() == 0.0
    assert abs(model.mass - same.mass).max() == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length": -1.0}, "length -1.0; expected a number above 0"),
        ({"E": float("nan")}, "E nan; expected a finite number"),
        ({"nu": 0.7}, "nu 0.7"),
        ({"n_elements": 0}, "n_elements 0; expected a whole number"),
        ({"n_elements": 5, "nodes": [0, 0.6]}, "either n_elements or nodes"),
        ({"nodes": [0, 0.3, 0.5]}, "nodes run from 0 to 0.5 m; expected 0 to 0.6 m"),
        (
            {"nodes": [0, 0.3, 0.6], "stations": [0.31]},
            "station at 0.31 m is not a node; nearest: 0.3 m",
        ),
        ({"stations": [0.7]}, "station at 0.7 m lies off the beam, which runs from 0 to 0.6 m"),
        ({"stations": {7: 0.1, 8: 0.1}}, "stations 7 and 8 share the position 0.1 m"),
        ({"stations": {0: 0.1}}, "station 0: expected a node number of at least 1"),
        ({"segments": [("a", 0, 0.3)]}, "no segment covers 0.3 to 0.6 m, after segment 'a'"),
        ({"segments": [("a", 0, 0.3), ("b", 0.35, 0.6)]}, "no segment covers 0.3 to 0.35 m"),
        (
            {"segments": [("a", 0, 0.3), ("b", 0.25, 0.6)]},
            "'b' starts at 0.25 m, within segment 'a'",
        ),
        ({"segments": [("a", 0.6, 0.0)]}, "expected its end beyond its start"),
        ({"segments": ["abc"]}, "expected a Segment or (name, start, end"),
        (
            {"segments": [("a", 0, 0.6)], "supports": [("a", 0.1, 1e3)]},
            "'a' names a segment and a support",
        ),
        ({"supports": [("foam", 0.1)]}, "neither stiffness nor viscous damping"),
        (
            {"supports": [("foam", 0.1, -5.0)]},
            "support 'foam': stiffness -5.0; expected a number of at least 0",
        ),
        (
            {"supports": [("f", 0.1, 1.0, 0.0, 0.1), ("f", 0.2, 1.0)]},
            "loss factors [0.0, 0.1] in one group",
        ),
        ({"masses": [("acc", 0.1, 0.0)]}, "mass 'acc': mass 0.0; expected a number above 0"),
    ],
)
def test_nonsense_is_refused_with_advice(change, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        beam(**{"length": LENGTH, **STEEL, **change})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lenght": 1.0}, "model: no key 'lenght'; did you mean 'length'"),
        (
            {"supports": [{"name": "a", "x": 0.1, "stifness": 1.0}]},
            "model.supports, number 1: no key 'stifness'",
        ),
        ({"masses": [{"name": "a", "x": 0.1}]}, "model.masses, number 1: 'mass' is missing"),
        ({"masses": {"name": "a"}}, "expected an array of tables, [[model.masses]]"),
        ({"stations": {"left": 0.1}}, "model.stations: 'left'; expected a node number"),
        ({"kind": "shell"}, "kind 'shell'; expected 'beam'"),
    ],
)
def test_table_errors_name_the_key(change, message):
    with pytest.raises(ModelError, match=re.escape(message)):
        beam_from_table({"length": LENGTH, **STEEL, **change})
    with pytest.raises(ModelError, match="'rho' is missing"):
        beam_from_table({k: v for k, v in {"length": LENGTH, **STEEL}.items() if k != "rho"})
