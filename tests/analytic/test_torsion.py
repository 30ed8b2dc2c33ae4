"""Torsional trains against textbook frequencies and closed forms."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

import updyn
from places import DATA
from updyn.elements.drivetrain import GearPair, Inertia, Motor, Planetary, Shaft, Worm, drivetrain

CASES = json.loads((DATA / "cases" / "torsional.json").read_text(encoding="utf-8"))


def frequencies(model, count):
    return updyn.modes(model, count).frequency


def row_of_discs(case):
    inertias = [Inertia(f"disc {i}", i, J) for i, J in enumerate(case["inertias"], 1)]
    return inertias + [Shaft(f"shaft {i}", i, i + 1, k) for i, k in enumerate(case["stiffness"], 1)]


def assert_four_digits(found, printed):
    """To half a unit of the last digit printed; the rigid-body mode to 1e-4 of the first."""
    assert_allclose(found[0], 0.0, atol=1e-4 * printed[1])
    for value, text in zip(found[1:], map(str, printed[1:]), strict=True):
        assert abs(value - float(text)) <= 0.5000001 * 10.0 ** -len(text.split(".")[1])


# -- Friswell, Penny, Garvey & Lees, Dynamics of Rotating Machines, 2010, and openTorsion's tests ---------------
@pytest.mark.parametrize("name", ["two_disks", "five_disks_ex_9_7_1"])
def test_row_of_discs(name):
    case = CASES[name]
    expected = case["frequencies_hz"]
    assert_four_digits(frequencies(drivetrain(row_of_discs(case)), len(expected)), expected)


@pytest.mark.parametrize("kind", ["external", "internal"])
@pytest.mark.parametrize("mesh", [{"rigid": True}, {"mesh_stiffness": 1e13}])
def test_branched_gears(kind, mesh):
    c = CASES["branched_gears"]
    parts = [
        Inertia("motor", 1, c["Im"]),
        Shaft("motor shaft", 1, 2, c["k_m"]),
        GearPair(
            "gears",
            2,
            3,
            radii=(0.05, 0.05),
            kind=kind,
            inertia_a=c["Ig"],
            inertia_b=c["Ig"],
            **mesh,
        ),
        Shaft("first", 2, 4, c["k_R"]),
        Shaft("second", 3, 5, c["k_R"]),
        Inertia("rotor 1", 4, c["Ir"]),
        Inertia("rotor 2", 5, c["Ir"]),
    ]
    model = drivetrain(parts)
    assert model.n_dofs == (4 if "rigid" in mesh else 5)
    assert_four_digits(frequencies(model, 4), c["frequencies_hz"])


def test_example_9_6_3_two_trains():
    G = 68e9
    parts = [
        Inertia("disc 0", 1, 3200),
        Shaft("input", 1, 2, G=G, outer_diameter=0.2, length=2.5),
        GearPair("first mesh", 2, 3, radii=(0.5, 0.5), rigid=True, inertia_a=200, inertia_b=200),
        GearPair("second mesh", 2, 4, radii=(0.5, 0.8), rigid=True, inertia_b=800),
        GearPair("third mesh", 3, 5, radii=(0.5, 0.8), rigid=True, inertia_b=800),
        Shaft("output 1", 4, 6, G=G, outer_diameter=0.25, length=3.5),
        Shaft("output 2", 5, 7, G=G, outer_diameter=0.25, length=3.5),
        Inertia("disc 1", 6, 450),
        Inertia("disc 2", 7, 450),
    ]
    model = drivetrain(parts)
    assert model.dofs.labels == ["1:RZ", "2:RZ", "6:RZ", "7:RZ"]
    assert_four_digits(frequencies(model, 4), CASES["two_trains_ex_9_6_3"]["frequencies_hz"])


@pytest.mark.parametrize("elements", [5, 8, 50])
def test_example_9_9_hollow_shaft(elements):
    c = CASES["hollow_shaft_ex_9_9"]
    shaft = Shaft(
        "string",
        1,
        2,
        G=c["G"],
        rho=c["rho"],
        outer_diameter=c["outer_diameter_m"],
        inner_diameter=c["inner_diameter_m"],
        length=c["length_m"],
        n_elements=elements,
    )
    model = drivetrain(
        [shaft, Inertia("start", 1, c["inertia_start"]), Inertia("end", 2, c["inertia_end"])]
    )
    assert model.n_dofs == elements + 1
    assert_four_digits(frequencies(model, 5), c["first_frequencies_hz_by_elements"][str(elements)])


# -- two masses: the servo figures ------------------------------------------------------------------------------
J_M, J_L, K, N = 3.1e-4, 57.0, 2.3e5, 240.0


def two_masses(rotor="free"):
    return [
        Motor("motor", 1, J_M, rotor=rotor),
        GearPair("gear", 2, 1, ratio=1 / N, rigid=True),  # 1 follows, so that the load side stays
        Shaft("shaft", 2, 3, K),
        Inertia("load", 3, J_L),
    ]


def test_locked_rotor_frequency():
    (found,) = frequencies(drivetrain(two_masses("locked")), 1)
    assert_allclose(found, np.sqrt(K / J_L) / (2 * np.pi), rtol=1e-12)


def test_free_rotor_frequency():
    found = frequencies(drivetrain(two_masses()), 2)
    assert_allclose(found[1], np.sqrt(K * (1 / (N**2 * J_M) + 1 / J_L)) / (2 * np.pi), rtol=1e-12)
    assert found[0] < 1e-6 * found[1]


def test_antiresonance_of_the_motor_is_the_locked_rotor_frequency():
    """The motor's own receptance vanishes at sqrt(k / J_L) of the load."""
    model = drivetrain(two_masses(), keep=[1])
    at = np.sqrt(K / J_L) / (2 * np.pi)
    H = updyn.response(model, np.array([0.7 * at, at]), ["1:RZ"], ["1:RZ"]).values[:, 0, 0]
    assert abs(H[1]) < 1e-12 * abs(H[0])


# -- a rod with mass: fixed and free --------------------------------------------------------------------------
ROD = {"G": 80e9, "outer_diameter": 0.05, "inner_diameter": 0.02, "length": 1.7, "rho": 7850.0}


def rod_frequency(n):
    """n = 1, 2, ...: (2 n - 1) c / (4 L) with c = sqrt(G / rho)."""
    return (2 * n - 1) * np.sqrt(ROD["G"] / ROD["rho"]) / (4 * ROD["length"])


def rod(elements, count):
    return frequencies(
        drivetrain([Shaft("rod", 1, 2, **ROD, n_elements=elements)], held=[1]), count
    )


def test_fixed_free_rod_converges_with_the_square_of_the_elements():
    exact = rod_frequency(np.arange(1, 4))
    errors = np.array([rod(n, 3) / exact - 1 for n in (10, 20, 40)])
    assert (errors > 0).all()  # consistent mass: from above
    assert_allclose(np.log2(errors[:-1] / errors[1:]), 2.0, atol=0.06)
    assert_allclose(errors[2], (np.pi * (2 * np.arange(1, 4) - 1) / 2 / 40) ** 2 / 24, rtol=0.02)


def test_rod_of_linear_elements_has_its_exact_discrete_frequencies():
    """omega^2 = 6 (c / h)^2 (1 - cos kh) / (2 + cos kh) with k L = (2 n - 1) pi / 2, from the difference equation."""
    elements = 12
    kh = (2 * np.arange(1, 5) - 1) * np.pi / 2 / elements
    c, h = np.sqrt(ROD["G"] / ROD["rho"]), ROD["length"] / elements
    exact = np.sqrt(6 * (1 - np.cos(kh)) / (2 + np.cos(kh))) * c / h / (2 * np.pi)
    assert_allclose(rod(elements, 4), exact, rtol=1e-10)


def test_shaft_by_stiffness_and_inertia_is_the_shaft_by_geometry():
    polar = np.pi * (ROD["outer_diameter"] ** 4 - ROD["inner_diameter"] ** 4) / 32
    k, J = ROD["G"] * polar / ROD["length"], ROD["rho"] * polar * ROD["length"]
    other = drivetrain([Shaft("rod", 1, 2, k, inertia=J, n_elements=7)], held=[1])
    assert_allclose(frequencies(other, 4), rod(7, 4), rtol=1e-12)


# -- planetary stages -------------------------------------------------------------------------------------------
Z_S, Z_R = 24, 96
STAGE = {"sun": 2, "ring": 3, "carrier": 4, "teeth": (Z_S, Z_R)}


def rigid_motion(model):
    """The null vector of K, first DOF 1."""
    _, _, V = np.linalg.svd(model.stiffness.toarray())
    return dict(zip(model.dofs.labels, V[-1] / V[-1][0], strict=True))


@pytest.mark.parametrize(
    ("fixed", "turns", "ratio"),
    [
        (3, (2, 4), (1 + Z_R / Z_S)),  # ring fixed: sun over carrier 5
        (4, (2, 3), (-Z_R / Z_S)),  # carrier fixed: sun over ring -4
        (2, (3, 4), (1 + Z_S / Z_R)),  # sun fixed: ring over carrier 1.25
    ],
)
def test_ratios_of_willis(fixed, turns, ratio):
    stage = Planetary(
        "stage",
        **STAGE,
        module=0.002,
        sun_mesh=3e8,
        ring_mesh=5e8,
        planets=(7, 8, 9),
        planet_inertia=1e-4,
    )
    ends = [Inertia(f"end {n}", n, 0.1) for n in turns]
    motion = rigid_motion(drivetrain([stage, *ends], held=[fixed]))
    assert_allclose(motion[f"{turns[0]}:RZ"] / motion[f"{turns[1]}:RZ"], ratio, rtol=1e-9)
    rigid = drivetrain(
        [Planetary("stage", **STAGE, rigid=True), *ends], held=[fixed], keep=[turns[1]]
    )
    assert rigid.dofs.labels == [f"{turns[1]}:RZ"]
    assert_allclose(rigid.mass.toarray(), [[0.1 * (1 + ratio**2)]], rtol=1e-12)


def test_planetary_frequency_with_rigid_meshes():
    """Motor - shaft - sun, ring held, load on the carrier, planets with inertia and mass: two masses."""
    i = 1 + Z_R / Z_S
    J_m, k, J_c, J_p, m_p = 0.02, 4e4, 1.3, 2e-3, 0.8
    z_p = (Z_R - Z_S) / 2
    arm = 0.002 * (Z_S + z_p) / 2
    planet = 1 - (i - 1) * Z_S / z_p  # theta_p / theta_c = 1 - (z_s / z_p) (theta_s / theta_c - 1)
    J_load = J_c + 3 * (J_p * planet**2 + m_p * arm**2)
    stage = Planetary(
        "stage", **STAGE, rigid=True, module=0.002, planet_inertia=J_p, planet_mass=m_p
    )
    parts = [Inertia("motor", 1, J_m), Shaft("shaft", 1, 2, k), stage, Inertia("carrier", 4, J_c)]
    found = frequencies(drivetrain(parts, held=[3]), 2)
    exact = np.sqrt(k * (1 / J_m + i**2 / J_load)) / (2 * np.pi)
    assert_allclose(found[1], exact, rtol=1e-11)
    stiff = Planetary(
        "stage",
        **STAGE,
        module=0.002,
        sun_mesh=1e14,
        ring_mesh=1e14,
        planet_inertia=J_p,
        planet_mass=m_p,
    )
    parts[2] = stiff
    assert_allclose(frequencies(drivetrain(parts, held=[3]), 2)[1], exact, rtol=1e-5)


def test_modes_of_the_planets_alone():
    """N - 1 equal modes in which sun, ring and carrier rest: omega^2 = (k_s + k_r) (r_p cos alpha)^2 / J_p."""
    k_s, k_r, J_p, module = 3e8, 5e8, 1.1e-3, 0.003
    stage = Planetary(
        "stage",
        **STAGE,
        n_planets=4,
        module=module,
        sun_mesh=k_s,
        ring_mesh=k_r,
        planets=(5, 6, 7, 8),
        planet_inertia=J_p,
    )
    ends = [Inertia("sun", 2, 0.02), Inertia("ring", 3, 0.9), Inertia("carrier", 4, 0.6)]
    model = drivetrain([stage, *ends])
    found = updyn.modes(model, 7)
    base = module / 2 * (Z_R - Z_S) / 2 * np.cos(np.radians(20))
    alone = np.sqrt((k_s + k_r) * base**2 / J_p) / (2 * np.pi)
    assert (np.abs(found.frequency / alone - 1) < 1e-10).sum() == 3
    # free: two rigid-body motions (Willis), and two modes of the whole that the lumped planet has
    # as well
    lumped = Planetary(
        "stage",
        **STAGE,
        n_planets=4,
        module=module,
        sun_mesh=k_s,
        ring_mesh=k_r,
        planet_inertia=J_p,
    )
    whole = frequencies(drivetrain([lumped, *ends]), 4)
    others = found.frequency[np.abs(found.frequency / alone - 1) >= 1e-10]
    assert_allclose(others[2:], whole[2:], rtol=1e-9)
    assert (others[:2] < 1e-4 * others[2]).all()


def test_two_overall_modes_of_a_free_stage_in_closed_form():
    """In delta_s, delta_r the free stage has two DOFs: their flexibility is that of three masses by Willis' levers.

    M^-1 of the four wheels is seen by the two meshes as A = B M^-1 B^T, and omega^2 are the roots
    of lambda^2 - tr(A k) lambda + det(A k) = 0."""
    k_s, k_r, n = 3e8, 5e8, 4
    J_s, J_r, J_c, J_p = 0.02, 0.9, 0.6, 1.1e-3
    cosine = np.cos(np.radians(20))
    r_s, r_r = 0.0015 * Z_S * cosine, 0.0015 * Z_R * cosine
    r_p = (r_r - r_s) / 2
    a_ss = n * (r_s**2 / J_s + (r_s + r_p) ** 2 / J_c) + r_p**2 / J_p
    a_rr = n * (r_r**2 / J_r + (r_r - r_p) ** 2 / J_c) + r_p**2 / J_p
    a_sr = n * (r_s + r_p) * (r_r - r_p) / J_c - r_p**2 / J_p
    trace, det = a_ss * k_s + a_rr * k_r, (a_ss * a_rr - a_sr**2) * k_s * k_r
    lambdas = np.array(
        [(trace - np.sqrt(trace**2 - 4 * det)) / 2, (trace + np.sqrt(trace**2 - 4 * det)) / 2]
    )
    stage = Planetary(
        "stage", **STAGE, n_planets=n, module=0.003, sun_mesh=k_s, ring_mesh=k_r, planet_inertia=J_p
    )
    model = drivetrain(
        [stage, Inertia("sun", 2, J_s), Inertia("ring", 3, J_r), Inertia("carrier", 4, J_c)]
    )
    assert_allclose(frequencies(model, 4)[2:], np.sqrt(lambdas) / (2 * np.pi), rtol=1e-9)


# -- worm ---------------------------------------------------------------------------------------------------------
def test_worm_frequency():
    """Motor J_1 through a ratio of 60 against a wheel J_2, both ends free."""
    J_1, J_2, k = 2e-4, 1.9, 7e4
    parts = [Inertia("motor", 1, J_1), Worm("worm", 1, 2, 60, k), Inertia("table", 2, J_2)]
    exact = np.sqrt(k * (1 / (60**2 * J_1) + 1 / J_2)) / (2 * np.pi)
    assert_allclose(frequencies(drivetrain(parts), 2)[1], exact, rtol=1e-11)
