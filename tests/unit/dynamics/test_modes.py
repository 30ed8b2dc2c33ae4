"""Natural frequencies, loss factors and shapes against closed forms and textbook values."""

import json

import numpy as np
import pytest
import scipy.sparse as sp

import updyn
from overriding import override
from places import DATA
from updyn.dynamics.modes import modes_up_to
from updyn.dynamics.settings import EIGEN
from updyn.elements.beam import BeamSupport, beam
from updyn.errors import DataError, ModelError, SolverError, UpdynWarning


@pytest.fixture(scope="module")
def torsional():
    path = DATA / "cases" / "torsional.json"
    return json.loads(path.read_text(encoding="utf-8"))


def chain(n, k=1000.0, m=2.0, fixed=True, **kwargs):
    """n equal masses in line, each tied to the next; fixed: both ends tied to ground."""
    main = np.full(n, 2.0 * k)
    if not fixed:
        main[[0, -1]] = k
    K = sp.diags_array([np.full(n - 1, -k), main, np.full(n - 1, -k)], offsets=[-1, 0, 1])
    group = updyn.Group(K, sp.diags_array(np.full(n, m)), **kwargs)
    return updyn.Model.from_groups({"chain": group}, [f"{i}:X" for i in range(1, n + 1)])


def chain_frequencies(n, k=1000.0, m=2.0):
    """Fixed-fixed chain: omega_r = 2 sqrt(k/m) sin(r pi / (2 (n + 1))) (Blevins 1979, table 6-2)."""
    return np.sqrt(k / m) / np.pi * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))


def torsion(inertias, shafts):
    """Discs on massless shafts; shafts: (i, j, stiffness, ratio), twist = angle_i - ratio angle_j."""
    K = np.zeros((len(inertias),) * 2)
    for i, j, k, ratio in shafts:
        e = np.zeros(len(inertias))
        e[i], e[j] = 1.0, -ratio
        K += k * np.outer(e, e)
    labels = [f"{i + 1}:RX" for i in range(len(inertias))]
    return updyn.Model.from_groups({"train": updyn.Group(K, np.diag(inertias))}, labels)


# -- closed forms ----------------------------------------------------------------------------------------------
def test_chain_frequencies_shapes_and_normalisation():
    n = 12
    found = updyn.modes(chain(n, loss_factor=0.03), n)
    assert found.frequency == pytest.approx(chain_frequencies(n), rel=1e-12)
    assert found.loss_factor == pytest.approx(np.full(n, 0.03), rel=1e-12)
    assert found.shapes.T @ (2.0 * found.shapes) == pytest.approx(np.eye(n), abs=1e-12)
    r = np.arange(1, n + 1)
    exact = np.sin(np.outer(r, r) * np.pi / (n + 1))
    exact /= np.linalg.norm(exact, axis=0) * np.sqrt(2.0)
    assert np.abs(found.shapes) == pytest.approx(np.abs(exact), abs=1e-10)
    largest = found.shapes[np.abs(found.shapes).argmax(axis=0), np.arange(n)]
    assert (largest > 0).all()
    assert found.at(["3:-X"])[0] == pytest.approx(-found.shapes[2])


def test_two_free_masses():
    k, m1, m2 = 5000.0, 3.0, 0.5
    model = updyn.Model.from_groups(
        {
            "spring": updyn.Group([[k, -k], [-k, k]], loss_factor=0.1),
            "masses": updyn.Group(mass=np.diag([m1, m2])),
        },
        ["1:X", "2:X"],
    )
    found = updyn.modes(model, 2)
    assert found.frequency[0] == 0.0
    assert found.loss_factor[0] == 0.0
    assert found.frequency[1] == pytest.approx(
        np.sqrt(k * (1 / m1 + 1 / m2)) / (2 * np.pi), rel=1e-12
    )
    assert found.loss_factor[1] == pytest.approx(0.1, rel=1e-12)
    assert found.shapes[:, 0] == pytest.approx(np.full(2, 1 / np.sqrt(m1 + m2)), rel=1e-10)


def test_massless_dofs_equal_their_static_condensation():
    n = 9
    full = chain(n, fixed=False)
    heavy = np.array([0, 3, 4, 8])
    light = np.setdiff1d(np.arange(n), heavy)
    K = full.stiffness.toarray()
    M = np.zeros((n, n))
    M[heavy, heavy] = [1.0, 2.0, 3.0, 4.0]
    model = updyn.Model.from_groups({"all": updyn.Group(K, M)}, full.dofs)
    condensed = K[np.ix_(heavy, heavy)] - K[np.ix_(heavy, light)] @ np.linalg.solve(
        K[np.ix_(light, light)], K[np.ix_(light, heavy)]
    )
    root = np.sqrt(np.diag(M)[heavy])
    exact = np.linalg.eigvalsh(condensed / np.outer(root, root))
    found = updyn.modes(model, 4)
    assert found.frequency[0] == 0.0
    assert found.frequency[1:] == pytest.approx(np.sqrt(exact[1:]) / (2 * np.pi), rel=1e-11)
    # The massless DOFs follow statically.
    forces = K[light] @ found.shapes
    assert np.abs(forces).max() < 1e-9 * np.abs(K).max()
    complex_found = updyn.modes(model, 4, complex=True)
    assert complex_found.frequency == pytest.approx(found.frequency, rel=1e-9)


def test_rank_deficient_mass_without_zero_rows():
    """A mass that sits on the mean of two DOFs only: one finite mode."""
    k, m = 100.0, 2.0
    model = updyn.Model.from_groups(
        {"g": updyn.Group(np.diag([k, k]), m * np.full((2, 2), 0.25))}, ["1:X", "2:X"]
    )
    assert updyn.modes(model, 1).frequency[0] == pytest.approx(
        np.sqrt(2 * k / m) / (2 * np.pi), rel=1e-12
    )
    with pytest.raises(ModelError, match=r"2 modes asked for; the model has 1"):
        updyn.modes(model, 2)


# -- textbook ---------------------------------------------------------------------------------------------------
def test_two_disks(torsional):
    case = torsional["two_disks"]
    model = torsion(case["inertias"], [(0, 1, case["stiffness"][0], 1.0)])
    assert updyn.modes(model, 2).frequency == pytest.approx(case["frequencies_hz"], abs=0.05)


def test_five_disks(torsional):
    case = torsional["five_disks_ex_9_7_1"]
    model = torsion(case["inertias"], [(i, i + 1, k, 1.0) for i, k in enumerate(case["stiffness"])])
    assert updyn.modes(model, 5).frequency == pytest.approx(case["frequencies_hz"], abs=0.006)


def test_branched_gears(torsional):
    """The rigid mesh is taken in by coordinates: gear 2 turns against gear 1."""
    c = torsional["branched_gears"]
    inertias = [c["Im"], 2 * c["Ig"], c["Ir"], c["Ir"]]  # motor, both gears, two rotors
    model = torsion(
        inertias, [(0, 1, c["k_m"], 1.0), (1, 2, c["k_R"], 1.0), (3, 1, c["k_R"], -c["gear_ratio"])]
    )
    assert updyn.modes(model, 4).frequency == pytest.approx(c["frequencies_hz"], abs=0.06)


def test_two_trains_with_reduction_gears(torsional):
    """Gear 1 drives gears 2 and 3; gear 2 drives gear 4; gears 3 and 4 carry a shaft and a disc each."""
    G = 68e9

    def shaft(length, diameter):
        return G * np.pi * diameter**4 / 32 / length

    r3 = -0.5 / 0.8  # gear 3 by gear 1
    r4 = 0.5 / 0.8  # gear 4 by gear 2, which turns as fast as gear 1, backwards
    gears = 200 + 200 + 800 * r3**2 + 800 * r4**2
    model = torsion(
        [3200.0, gears, 450.0, 450.0],
        [(0, 1, shaft(2.5, 0.2), 1.0), (2, 1, shaft(3.5, 0.25), r3), (3, 1, shaft(3.5, 0.25), r4)],
    )
    expected = torsional["two_trains_ex_9_6_3"]["frequencies_hz"]
    assert updyn.modes(model, 4).frequency == pytest.approx(expected, abs=6e-4)


@pytest.mark.parametrize("n", [5, 8, 50])
def test_hollow_shaft_by_number_of_elements(n, torsional):
    c = torsional["hollow_shaft_ex_9_9"]
    J = np.pi * (c["outer_diameter_m"] ** 4 - c["inner_diameter_m"] ** 4) / 32
    length = c["length_m"] / n
    K, M = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    for e in range(n):
        at = np.ix_([e, e + 1], [e, e + 1])
        K[at] += c["G"] * J / length * np.array([[1, -1], [-1, 1]])
        M[at] += c["rho"] * J * length / 6 * np.array([[2, 1], [1, 2]])
    M[0, 0] += c["inertia_start"]
    M[n, n] += c["inertia_end"]
    model = updyn.Model.from_groups(
        {"shaft": updyn.Group(K, M)}, [f"{i + 1}:RX" for i in range(n + 1)]
    )
    expected = c["first_frequencies_hz_by_elements"][str(n)]
    assert updyn.modes(model, 5).frequency == pytest.approx(expected, abs=6e-5)


# -- damping ----------------------------------------------------------------------------------------------------
def test_strain_energy_of_two_materials_and_a_damper():
    k1, k2, c, m = 3000.0, 1000.0, 4.0, 2.0
    one = updyn.Model.from_groups(
        {
            "steel": updyn.Group([[k1]], [[m]], loss_factor=0.01),
            "rubber": updyn.Group([[k2]], loss_factor=0.3),
            "damper": updyn.Group(viscous=[[c]]),
        },
        ["1:X"],
    )
    omega = np.sqrt((k1 + k2) / m)
    found = updyn.modes(one, 1)
    assert found.loss_factor[0] == pytest.approx(
        (0.01 * k1 + 0.3 * k2 + omega * c) / (k1 + k2), rel=1e-12
    )


def test_complex_modes_of_non_proportional_structural_damping():
    """Against a direct, unshifted complex eigenvalue problem."""
    a, b = chain(6, loss_factor=0.02), np.zeros((6, 6))
    b[1, 1] = 900.0
    model = updyn.Model.from_groups({**a.groups, "pad": updyn.Group(b, loss_factor=0.5)}, a.dofs)
    found = updyn.modes(model, 6, complex=True)
    K = model.stiffness.toarray() + 1j * model.structural.toarray()
    exact = np.sort_complex(np.linalg.eigvals(K / 2.0))
    assert found.frequency == pytest.approx(np.sqrt(exact.real) / (2 * np.pi), rel=1e-10)
    assert found.loss_factor == pytest.approx(exact.imag / exact.real, rel=1e-9)
    assert found.shapes.T @ (2.0 * found.shapes) == pytest.approx(np.eye(6), abs=1e-9)
    # Strain energy is right to first order in the loss factors: ten times lighter, the error is a
    # hundredth.
    light = model.scaled({"chain": {"loss_factor": 0.002}, "pad": {"loss_factor": 0.05}})
    exact_light = updyn.modes(light, 6, complex=True).loss_factor
    heavy_error = np.abs(updyn.modes(model, 6).loss_factor / found.loss_factor - 1).max()
    light_error = np.abs(updyn.modes(light, 6).loss_factor / exact_light - 1).max()
    assert 0.01 < heavy_error < 0.1
    assert light_error == pytest.approx(heavy_error / 100, rel=0.2)


def test_complex_modes_of_a_damped_oscillator():
    k, m, zeta = 800.0, 2.0, 0.2
    omega = np.sqrt(k / m)
    model = updyn.Model.from_groups(
        {"g": updyn.Group([[k]], [[m]], viscous=[[2 * zeta * m * omega]])}, ["1:X"]
    )
    found = updyn.modes(model, 1, complex=True)
    s = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
    value = -(s**2)
    assert found.frequency[0] == pytest.approx(np.sqrt(value.real) / (2 * np.pi), rel=1e-10)
    assert found.loss_factor[0] == pytest.approx(value.imag / value.real, rel=1e-10)


def test_complex_modes_solve_their_equation_with_dampers_massless_dofs_and_free_motion():
    """Two free masses with a massless DOF between them: spring on one side, spring and damper on the other."""
    k, c, m = 1000.0, 3.0, 2.0
    K = k * np.array([[1.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    C = c * np.array([[0.0, 0.0, 0.0], [0.0, 1.0, -1.0], [0.0, -1.0, 1.0]])
    group = updyn.Group(K, np.diag([m, 0.0, m]), loss_factor=0.01, viscous=C)
    model = updyn.Model.from_groups({"g": group}, ["1:X", "2:X", "3:X"])
    found = updyn.modes(model, 2, complex=True)
    assert found.frequency[0] == 0.0
    value = (2 * np.pi * found.frequency[1]) ** 2 * (1 + 1j * found.loss_factor[1])
    s = 1j * np.sqrt(value)
    Z = s**2 * np.diag([m, 0, m]) + s * C + (1 + 0.01j) * K
    assert np.abs(Z @ found.shapes[:, 1]).max() < 1e-9 * k * np.abs(found.shapes[:, 1]).max()
    assert found.loss_factor[1] > 0.01
    with pytest.raises(ModelError, match="the model has 2: 3 DOFs, of which 1"):
        updyn.modes(model, 3, complex=True)


def test_overdamped_modes_are_counted_out():
    model = updyn.Model.from_groups({"g": updyn.Group([[1.0]], [[1.0]], viscous=[[5.0]])}, ["1:X"])
    with pytest.raises(ModelError, match="damped beyond oscillation"):
        updyn.modes(model, 1, complex=True)


def test_rigid_body_modes_of_a_damped_free_beam():
    model = beam(0.6, E=210e9, rho=7850, width=0.04, height=0.02, loss_factor=0.01, n_elements=30)
    real, damped = updyn.modes(model, 6), updyn.modes(model, 6, complex=True)
    assert (real.frequency[:2] == 0).all()
    assert (damped.frequency[:2] == 0).all()
    assert damped.loss_factor == pytest.approx([0, 0, 0.01, 0.01, 0.01, 0.01], rel=1e-6)
    assert damped.frequency[2:] == pytest.approx(real.frequency[2:], rel=1e-7)


# -- large models -------------------------------------------------------------------------------------------------
def test_large_chain_against_its_closed_form_and_no_mode_missed():
    n = 3000
    found = updyn.modes(chain(n, loss_factor=0.02), 20)
    assert found.frequency == pytest.approx(chain_frequencies(n)[:20], rel=1e-9)
    assert found.shapes.T @ (2.0 * found.shapes) == pytest.approx(np.eye(20), abs=1e-8)
    damped = updyn.modes(chain(n, loss_factor=0.02), 5, complex=True)
    assert damped.frequency == pytest.approx(found.frequency[:5], rel=1e-8)
    assert damped.loss_factor == pytest.approx(np.full(5, 0.02), rel=1e-6)


def test_sparse_and_dense_agree(monkeypatch):
    supports = [
        BeamSupport("pads", 0.1, 2e4, loss_factor=0.2),
        BeamSupport("pads", 0.5, 2e4, loss_factor=0.2),
    ]
    for kept in ([], supports):
        model = beam(0.6, E=210e9, rho=7850, width=0.04, height=0.02, n_elements=100, supports=kept)
        dense = updyn.modes(model, 10)
        dense_complex = updyn.modes(model, 8, complex=True)
        with monkeypatch.context() as patch:
            override(patch, EIGEN, dense_dofs=50)
            sparse = updyn.modes(model, 10)
            sparse_complex = updyn.modes(model, 8, complex=True)
        assert sparse.frequency == pytest.approx(dense.frequency, rel=1e-8)
        assert sparse.loss_factor == pytest.approx(dense.loss_factor, rel=1e-6)
        assert sparse_complex.frequency == pytest.approx(dense_complex.frequency, rel=1e-8)
        M = model.mass
        still = int((dense.frequency == 0).sum())
        overlap = np.abs(sparse.shapes[:, still:].T @ M @ dense.shapes[:, still:])
        assert overlap == pytest.approx(np.eye(10 - still), abs=1e-6)
        rigid = sparse.shapes[:, :still].T @ M @ dense.shapes[:, :still]
        assert np.linalg.svd(rigid, compute_uv=False) == pytest.approx(np.ones(still), abs=1e-8)


def test_repeated_modes_are_all_found_on_a_large_model():
    """Three equal chains side by side: every frequency three times, two rigid chains more."""
    n = 400
    one = chain(n, fixed=False)
    K = sp.block_diag([one.stiffness] * 3, format="csr")
    M = sp.block_diag([one.mass] * 3, format="csr")
    model = updyn.Model.from_groups(
        {"g": updyn.Group(K, M)}, [f"{i}:X" for i in range(1, 3 * n + 1)]
    )
    found = updyn.modes(model, 9).frequency
    # Free chain: omega_r = 2 sqrt(k/m) sin(r pi / 2n), r = 0, 1, ...
    exact = np.sqrt(1000.0 / 2.0) / np.pi * np.sin(np.repeat(np.arange(3), 3) * np.pi / (2 * n))
    assert (found[:3] == 0).all()
    assert found[3:] == pytest.approx(exact[3:], rel=1e-8)


def test_large_model_with_mass_on_few_dofs():
    n = 1200
    K = chain(n).stiffness
    mass = np.zeros(n)
    mass[[399, 799]] = 5.0
    model = updyn.Model.from_groups(
        {"g": updyn.Group(K, sp.diags_array(mass))}, [f"{i}:X" for i in range(1, n + 1)]
    )
    # Springs in series: 400 to the first mass, 400 between, 401 to ground.
    a, b, c = 1000 / 400, 1000 / 400, 1000 / 401
    exact = np.linalg.eigvalsh(np.array([[a + b, -b], [-b, b + c]]) / 5.0)
    assert updyn.modes(model, 2).frequency == pytest.approx(np.sqrt(exact) / (2 * np.pi), rel=1e-9)
    with pytest.raises(ModelError, match="the model has 2: 1200 DOFs, of which 1198"):
        updyn.modes(model, 3)


def test_modes_up_to_a_frequency_are_all_found_and_one_more():
    """Three equal free chains: the value lies between triples, and above three rigid motions."""
    n = 400
    one = chain(n, fixed=False)
    model = updyn.Model.from_groups(
        {
            "g": updyn.Group(
                sp.block_diag([one.stiffness] * 3, format="csr"),
                sp.block_diag([one.mass] * 3, format="csr"),
            )
        },
        [f"{i}:X" for i in range(1, 3 * n + 1)],
    )
    exact = np.sqrt(1000.0 / 2.0) / np.pi * np.sin(np.repeat(np.arange(5), 3) * np.pi / (2 * n))
    found = modes_up_to(model, 0.5 * (exact[9] + exact[12]), 400).frequency
    assert (found[:3] == 0).all()
    assert found[3:] == pytest.approx(exact[3:13], rel=1e-8)
    assert len(modes_up_to(model, 1e6, 7)) == 7
    assert len(modes_up_to(model, np.inf, 5)) == 5


def test_modes_up_to_a_frequency_with_mass_on_few_dofs():
    K, mass = chain(1200).stiffness, np.zeros(1200)
    mass[[399, 799]] = 5.0
    group = updyn.Group(K, sp.diags_array(mass))
    model = updyn.Model.from_groups({"g": group}, [f"{i}:X" for i in range(1, 1201)])
    expected = updyn.modes(model, 2).frequency
    for highest, number in ((0.5 * expected[0], 1), (expected.mean(), 2), (1e6, 2)):
        found = modes_up_to(model, highest, 400).frequency
        assert found == pytest.approx(expected[:number], rel=1e-9)


# -- refusals -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("n", [0, -1, 1.5, True])
def test_count_must_be_a_number(n):
    with pytest.raises(ModelError, match="expected a whole number of at least 1"):
        updyn.modes(chain(3), n)


def test_asking_for_too_many_says_how_many_there_are():
    with pytest.raises(ModelError, match="5 modes asked for; the model has 3"):
        updyn.modes(chain(3), 5)


def test_motion_without_stiffness_or_mass_is_named():
    K = np.array([[10.0, 0.0, 0.0], [0.0, 5.0, -5.0], [0.0, -5.0, 5.0]])
    model = updyn.Model.from_groups(
        {"g": updyn.Group(K, np.diag([1.0, 0.0, 0.0]))}, ["1:X", "2:Y", "3:Y"]
    )
    with pytest.raises(SolverError, match=r"neither stiffness nor mass.*moves DOF [23]:Y most"):
        updyn.modes(model, 1)


def test_indefinite_stiffness_warns():
    with pytest.warns(UpdynWarning, match="indefinite"):
        model = updyn.Model.from_groups(
            {"g": updyn.Group(np.diag([-1e-3, 4.0]), np.eye(2))}, ["1:X", "2:X"]
        )
    with pytest.warns(UpdynWarning, match=r"1 mode\(s\) with negative omega\^2"):
        found = updyn.modes(model, 2)
    assert found.frequency == pytest.approx([0.0, 2.0 / (2 * np.pi)])


def test_large_viscous_complex_model_is_refused_by_name():
    n = 500
    model = chain(n, viscous=sp.diags_array(np.ones(n)))
    with pytest.raises(ModelError, match="in state space, for at most 400 DOFs; the model has 500"):
        updyn.modes(model, 3, complex=True)
    assert updyn.modes(model, 3).frequency == pytest.approx(chain_frequencies(n)[:3], rel=1e-9)


def test_modes_are_selected_by_number_or_by_flag():
    found = updyn.modes(chain(5), 4)
    np.testing.assert_array_equal(found.select([2, 0]).frequency, found.frequency[[2, 0]])
    np.testing.assert_array_equal(found.select([2, 0]).shapes, found.shapes[:, [2, 0]])
    np.testing.assert_array_equal(found.select(np.arange(4) > 1).frequency, found.frequency[2:])
    assert len(found.select([])) == 0


@pytest.mark.parametrize("given", [[0.5], [4], [-1], [0, 0], ["1"], [True, False], [[0], [1, 2]]])
def test_modes_that_are_not_there_are_refused(given):
    with pytest.raises(DataError, match="modes: expected"):
        updyn.modes(chain(5), 4).select(given)
