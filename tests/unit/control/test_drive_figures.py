"""Drive figures: against two and three inertias by hand, the reflected stiffness of the train, and the computed FRF."""

import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose

import updyn
from updyn.control.servo.drive import drive_figures
from updyn.elements.drivetrain import GearPair, Inertia, Motor, Shaft, drivetrain, reflected
from updyn.errors import DofError, ModelError, OptionError

TWO_PI = 2 * np.pi
J_M, J_L, N = 2e-3, 40.0, 50.0
K_SHAFT, K_MESH = 800.0, 4e6


def two_mass(**mesh):
    return [
        Motor("motor", 1, J_M),
        Shaft("shaft", 1, 2, K_SHAFT),
        GearPair("gear", 2, 3, ratio=N, torsional_stiffness=K_MESH, loss_factor=0.02, **mesh),
        Inertia("load", 3, J_L),
    ]


def three_mass(mid=6e-3, loss=0.04):
    """Motor 1 - shaft - pinion 2 - mesh - gear 3 with an inertia of its own - shaft - load 4, internal gear."""
    return [
        Motor("motor", 1, J_M),
        Shaft("input", 1, 2, K_SHAFT, loss_factor=loss / 4),
        GearPair("gear", 2, 3, ratio=10.0, torsional_stiffness=2e5, kind="internal", inertia_b=mid),
        Shaft("output", 3, 4, 3e4, loss_factor=loss),
        Inertia("load", 4, 3.0),
    ]


def test_two_inertias_by_the_textbook_formulas():
    d = drive_figures(drivetrain(two_mass()), "1:RZ", "3:RZ", ratio=-N)
    k = 1 / (1 / (K_SHAFT * N**2) + 1 / K_MESH)  # at the load: 1/k = sum 1/(k_i n_i^2)
    motor = N**2 * J_M
    (pair,) = d.pairs
    assert_allclose(pair.antiresonance, np.sqrt(k / J_L) / TWO_PI, rtol=1e-9)
    assert_allclose(pair.resonance, np.sqrt(k * (1 / motor + 1 / J_L)) / TWO_PI, rtol=1e-9)
    assert_allclose(d.locked, [pair.antiresonance])
    assert_allclose(d.free, [pair.resonance])
    assert_allclose([d.stiffness_at_load, d.stiffness_at_motor], [k, k / N**2], rtol=1e-9)
    assert_allclose(reflected(two_mass(), 3, held=[1]).stiffness, d.stiffness_at_load, rtol=1e-9)
    assert_allclose(d.ratio, -N, rtol=1e-12)
    assert d.ratio_from == "rigid-body mode"
    assert_allclose([d.inertia, d.motor_inertia], [J_M + J_L / N**2, J_M], rtol=1e-9)
    assert_allclose([d.rest_inertia, d.load_inertia], [J_L / N**2, J_L], rtol=1e-9)
    assert_allclose(d.inertia_ratio, J_L / motor, rtol=1e-9)
    # The mesh holds a share k / K_MESH of the energy of the only elastic mode: eta / 2 of it.
    assert_allclose(
        [pair.antiresonance_damping, pair.resonance_damping], 0.01 * k / K_MESH, rtol=1e-9
    )
    assert d.antiresonance_error < 1e-9
    assert (d.notes, d.hidden, d.first_resonance, d.rigid) == ((), (), None, 1)


def test_poles_of_a_pi_velocity_loop_of_equal_radius():
    """The stated rule, from the loop itself: gains that give four poles of radius omega_a have damping sqrt(R) / 2."""
    parts = [Motor("motor", 1, 1.0), Shaft("shaft", 1, 2, 9.0), Inertia("load", 2, 1.8)]
    d = drive_figures(drivetrain(parts), "1:RZ", "2:RZ")
    wa, R = TWO_PI * d.bandwidth.velocity, d.inertia_ratio
    zeta = np.sqrt(R) / 2
    kp, ki = 4 * zeta * wa, wa**2  # per unit of the motor's inertia
    A = np.array(
        [[0, 0, 1, 0, 0], [0, 0, 0, 1, 0], [-9, 9, -kp, 0, -ki], [5, -5, 0, 0, 0], [0, 0, 1, 0, 0]],
        float,
    )
    poles = np.linalg.eigvals(A)
    poles = poles[np.argsort(np.abs(poles))][
        1:
    ]  # the first is the angle of the whole, which no velocity loop holds
    # A double pair: rounding of 1e-16 moves it by its root.
    assert_allclose(np.abs(poles), wa, rtol=1e-6)
    assert_allclose(-poles.real / wa, d.bandwidth.damping, rtol=1e-6)
    assert_allclose(d.bandwidth.position, [wa / TWO_PI / 3, wa / TWO_PI / 2])
    for said in ("Zhang & Furusho", f"{d.bandwidth.velocity:.5g} Hz", f"{d.bandwidth.damping:.3g}"):
        assert said in d.summary()


def test_three_inertias_and_a_gear_against_the_matrices_by_hand():
    d = drive_figures(drivetrain(three_mass()), "1:RZ", "4:RZ", ratio=10)
    # In angles at the motor: J and k of the gear's shaft over n^2; motor - (shaft and mesh in a
    # row) - gear - load.
    k1, k2 = 1 / (1 / K_SHAFT + 1 / 2e3), 300.0
    J = np.diag([J_M, 6e-5, 0.03])
    K = np.array([[k1, -k1, 0], [-k1, k1 + k2, -k2], [0, -k2, k2]])
    free = np.sqrt(np.maximum(scipy.linalg.eigh(K, J, eigvals_only=True), 0))[1:] / TWO_PI
    locked = np.sqrt(scipy.linalg.eigh(K[1:, 1:], J[1:, 1:], eigvals_only=True)) / TWO_PI
    assert_allclose(d.free, free, rtol=1e-9)
    assert_allclose(d.locked, locked, rtol=1e-9)
    assert_allclose(
        [(p.antiresonance, p.resonance) for p in d.pairs], np.c_[locked, free], rtol=1e-9
    )
    assert_allclose(d.stiffness_at_motor, 1 / (1 / k1 + 1 / k2), rtol=1e-9)
    assert_allclose(d.stiffness_at_load, reflected(three_mass(), 4, held=[1]).stiffness, rtol=1e-9)
    assert_allclose(d.inertia, reflected(three_mass(), 1).inertia, rtol=1e-9)
    assert_allclose(d.ratio, 10, rtol=1e-12)


def test_antiresonances_of_the_damped_response_lie_at_the_locked_rotor_frequencies():
    model = drivetrain(three_mass(loss=0.01))
    d = drive_figures(model, "1:RZ", "4:RZ")
    for pair in d.pairs:
        for f, sign in ((pair.antiresonance, 1), (pair.resonance, -1)):
            lines = np.linspace(0.98 * f, 1.02 * f, 801)
            speed = np.abs(
                updyn.response(model, lines, ["1:RZ"], ["1:RZ"], "mobility").values[:, 0, 0]
            )
            assert abs(lines[np.argmin(sign * speed)] / f - 1) < 2e-3
    # Damping ratio by the half-power width of the first resonance.
    f = d.pairs[0].resonance
    lines = np.linspace(0.9 * f, 1.1 * f, 20001)
    power = (
        np.abs(updyn.response(model, lines, ["1:RZ"], ["1:RZ"], "mobility").values[:, 0, 0]) ** 2
    )
    wide = lines[power > power.max() / 2]
    assert_allclose(d.pairs[0].resonance_damping, (wide[-1] - wide[0]) / (2 * f), rtol=0.03)


def test_a_mode_that_the_motor_does_not_see_is_no_pair():
    side = [
        Shaft("side", 3, 5, 5e5),
        Inertia("wheel", 5, 20.0),
        Shaft("other", 3, 6, 5e5),
        Inertia("twin", 6, 20.0),
    ]
    d = drive_figures(drivetrain([*two_mass(), *side]), "1:RZ", "3:RZ")
    still = np.sqrt(5e5 / 20) / TWO_PI  # the two wheels against each other
    assert_allclose(d.hidden, [still], rtol=1e-9)
    assert all(abs(p.antiresonance / still - 1) > 1e-3 for p in d.pairs)
    assert len(d.pairs) == len(d.locked) - 1
    assert "not observable at the motor" in d.summary()
    seen = drive_figures(drivetrain([*two_mass(), *side]), "1:RZ", "3:RZ", band=(0, 0.99 * still))
    assert seen.hidden == ()
    assert seen.locked.max() < still


def test_result_of_an_update_is_as_good_as_its_model():
    true, start = (
        drivetrain([Shaft("s", 1, 2, k), Motor("m", 1, J_M), Inertia("l", 2, 0.03)])
        for k in (800.0, 700.0)
    )
    frf = updyn.response(true, np.linspace(5, 150, 30), ["1:RZ", "2:RZ"], ["1:RZ"])
    result = updyn.update(
        start, frf, updyn.parameters(start, stiffness=["s"]), noise={"relative": 0.01}
    )
    d = drive_figures(result, "1:RZ", "2:RZ")
    assert_allclose(d.stiffness_at_motor, 800.0, rtol=1e-5)
    assert d.pairs == drive_figures(result.model, "1:RZ", "2:RZ").pairs


def test_held_load_leaves_what_needs_rigid_motion_open():
    parts = [*two_mass(), Inertia("wheel", 2, 1e-4)]
    d = drive_figures(drivetrain(parts, held=[3]), "1:RZ", "2:RZ")
    assert (d.inertia, d.ratio, d.inertia_ratio, d.load_inertia, d.rigid) == (
        None,
        None,
        None,
        None,
        0,
    )
    assert "no rigid-body motion" in d.notes[0]
    K = np.array([[K_SHAFT, -K_SHAFT], [-K_SHAFT, K_SHAFT + K_MESH / N**2]])
    f = np.sqrt(scipy.linalg.eigh(K, np.diag([J_M, 1e-4]), eigvals_only=True)) / TWO_PI
    assert_allclose(d.first_resonance, f[0], rtol=1e-9)
    assert_allclose(d.pairs[0].resonance, f[1], rtol=1e-9)
    assert_allclose(d.pairs[0].antiresonance, np.sqrt(K[1, 1] / 1e-4) / TWO_PI, rtol=1e-9)
    assert_allclose([d.stiffness_at_motor, d.stiffness_at_load], np.diag(K), rtol=1e-9)
    stated = drive_figures(drivetrain(parts, held=[3]), "1:RZ", "2:RZ", ratio=4)
    assert (stated.ratio, stated.ratio_from) == (4.0, "stated")
    assert "the model cannot check it" in stated.notes[-1]


def test_a_table_of_loss_factors_need_not_reach_beyond_the_band():
    table = {"output": {"loss_table": ([0, 10, 30], [1.0, 1.0, 3.0])}}
    model = drivetrain(three_mass()).with_damping(table)
    d = drive_figures(model, "1:RZ", "4:RZ", band=(0, 30))
    held = updyn.modes(drivetrain(three_mass(), held=[1]).with_damping(table), 1)
    assert_allclose(d.locked, held.frequency)
    assert_allclose(d.locked_damping, held.loss_factor / 2)
    plain = drive_figures(drivetrain(three_mass()), "1:RZ", "4:RZ")
    assert d.locked_damping[0] > 1.2 * plain.locked_damping[0]
    assert_allclose(d.pairs[0].resonance, plain.pairs[0].resonance)
    assert np.isnan(d.pairs[0].resonance_damping)
    with pytest.raises(ModelError, match="'output'"):
        drive_figures(model, "1:RZ", "4:RZ")


def test_a_ratio_that_contradicts_the_model():
    model = drivetrain(two_mass())
    with pytest.raises(
        ModelError, match=r"ratio 50: .* turn in the other sense, ratio -50; state -50, .*3:-RZ"
    ):
        drive_figures(model, "1:RZ", "3:RZ", ratio=50)
    assert_allclose(drive_figures(model, "1:RZ", "3:-RZ", ratio=50).ratio, 50)
    with pytest.raises(ModelError, match=r"1:RZ turns -50 times as fast as 3:RZ"):
        drive_figures(model, "1:RZ", "3:RZ", ratio=-48)


def test_a_stated_ratio_may_be_off_by_a_thousandth():
    model = drivetrain(two_mass())
    assert_allclose(drive_figures(model, "1:RZ", "3:RZ", ratio=-50 * 1.0009).ratio, -50)
    with pytest.raises(ModelError, match="times as fast"):
        drive_figures(model, "1:RZ", "3:RZ", ratio=-50 * 1.0011)


def test_a_second_drive_that_is_free_changes_no_stiffness():
    """Two trains on one structure: with one at rest the stiffness matrix stays singular."""
    both = updyn.Model.from_groups(
        {
            "a": updyn.Group(
                [[9.0, -9, 0, 0], [-9, 9, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
                np.diag([1.0, 2, 0, 0]),
            ),
            "b": updyn.Group(
                [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 5, -5], [0, 0, -5, 5]], np.diag([0, 0, 3.0, 4])
            ),
        },
        ["1:RZ", "2:RZ", "3:RZ", "4:RZ"],
    )
    d = drive_figures(both, "1:RZ", "2:RZ")
    assert_allclose([d.stiffness_at_motor, d.ratio, d.inertia, d.rigid], [9, 1, 3, 2], rtol=1e-9)
    assert_allclose(d.pairs[0].resonance, np.sqrt(9 * 1.5) / TWO_PI, rtol=1e-9)
    assert_allclose(d.hidden, [np.sqrt(5 * (1 / 3 + 1 / 4)) / TWO_PI], rtol=1e-9)
    with pytest.raises(ModelError, match=r"no stiffness joins 1:RZ and 3:RZ"):
        drive_figures(both, "1:RZ", "3:RZ")


def test_a_motor_on_a_free_body_has_no_single_ratio():
    K = np.outer(
        [1.0, -3.0, 2.0], [1.0, -3.0, 2.0]
    )  # twist of motor, load and the body that carries the gears
    model = updyn.Model.from_groups({"gear": updyn.Group(K, np.eye(3))}, ["1:RZ", "2:RZ", "3:RZ"])
    with pytest.raises(
        ModelError,
        match=r"no stiffness joins 1:RZ and 2:RZ.*2 rigid-body motions.*against its housing",
    ):
        drive_figures(model, "1:RZ", "2:RZ")


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"load": "1:-RZ"}, DofError, "motor and load are both"),
        ({"motor": "9:RZ"}, DofError, "motor 9:RZ is not among"),
        ({"ratio": 0}, OptionError, "ratio 0; expected"),
        ({"band": (5, 1)}, OptionError, "expected 0 <= low < high"),
        ({"band": 5}, OptionError, "expected two lines"),
        ({"separation": 2}, OptionError, "separation 2"),
        ({"model": "file"}, OptionError, "expected a Model or an UpdateResult, found str"),
    ],
)
def test_bad_input(change, error, said):
    given = {"model": drivetrain(two_mass()), "motor": "1:RZ", "load": "3:RZ"} | change
    with pytest.raises(error, match=said):
        drive_figures(**given)


def test_the_antenna_with_two_drives():
    antenna_model = pytest.importorskip("updyn.demos.antenna_model")
    pytest.importorskip("pyfe3d")
    model = antenna_model.antenna()
    d = drive_figures(model, "2001:RZ", "3:RZ", ratio=-800, band=(0, 10))
    parts = antenna_model.trains("azimuth")
    rotor, ring = (antenna_model.AZIMUTH[name] for name in ("rotor", "ring"))
    table = reflected(parts, ring, held=[rotor, antenna_model.AZIMUTH["housing"]])
    # The pedestal turns under the torque of the train and is in the stiffness, too.
    assert 0.5 * table.stiffness < d.stiffness_at_load < table.stiffness
    assert_allclose(d.stiffness_at_load, 800**2 * d.stiffness_at_motor, rtol=1e-6)
    assert d.rigid == 2
    assert d.antiresonance_error < 1e-6
    assert 7 < d.bandwidth.velocity < 9
