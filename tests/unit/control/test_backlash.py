"""Backlash: its describing function against the law in time, limit cycles predicted and simulated, the opened mesh."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import updyn
from nonlinear_plants import two_inertias
from servo_cases import SETS_SHAPES
from updyn.control.nonlinear.around import linear_loop
from updyn.control.nonlinear.balance import limit_cycles
from updyn.control.nonlinear.opened import opened
from updyn.control.nonlinear.simulate import simulate
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.servo.controller import Controller
from updyn.elements.drivetrain import GearPair, Inertia, Motor, Shaft, drivetrain
from updyn.errors import ModelError, OptionError
from updyn.nonlinear.backlash import Backlash

TWO_PI = 2 * np.pi
LOCKED = TWO_PI * 10.0
K = 4.0 * LOCKED**2  # locked-rotor frequency of the two inertias: 10 Hz
MESH = Backlash(K, gap=1e-3, damping=2 * 0.02 * K / LOCKED)


def cascade(kv, **more):
    """P-PI: speed of the motor inside, angle of the load outside."""
    return Controller(60.0, ti=0.05, kv=kv, **more)


LOAD = {"velocity": "speed", "position": "load", "torque": "torque"}
ENCODER = {"velocity": "speed", "position": "encoder", "torque": "torque"}


# -- the describing function -------------------------------------------------------------------------------
def test_dead_zone_of_the_textbook():
    b = Backlash(3.0, gap=0.2)
    A = np.array([0.05, 0.1, 0.11, 0.3, 5.0])
    d = np.minimum(0.1 / A, 1)
    book = 3.0 * (
        1 - 2 / np.pi * (np.arcsin(d) + d * np.sqrt(1 - d**2))
    )  # Slotine & Li 1991, section 5.2.2
    assert_allclose(b.describing(A, 7.0), book, atol=1e-14)
    light = Backlash(3.0, gap=0.2, damping=1e-6)
    assert_allclose(light.describing(A, 7.0), book * (1 + 7e-6j / 3), rtol=1e-5, atol=1e-14)


@pytest.mark.parametrize(("ratio", "amplitude"), [(0.02, 0.3), (0.5, 0.15), (3.0, 0.5)])
def test_damped_backlash_is_the_first_harmonic_of_the_law_in_time(ratio, amplitude):
    """Nordin & Gutman's law, stepped along a sine in their own form: the free play moves by its limits."""
    k, half, omega = 2.0, 0.1, 5.0
    c = ratio * k / omega
    n, turns = 20000, 3
    dt = TWO_PI / omega / n
    play, torque = 0.0, np.empty(turns * n)
    for i in range(turns * n):
        t = i * dt
        z, rate = amplitude * np.sin(omega * t), amplitude * omega * np.cos(omega * t)
        moved = rate + k / c * (z - play)
        if play >= half:
            moved = min(moved, 0.0)
        elif play <= -half:
            moved = max(moved, 0.0)
        torque[i] = k * (z - play) + c * (rate - moved)
        play = min(max(play + dt * moved, -half), half)
    last = torque[-n:]
    psi = omega * dt * np.arange((turns - 1) * n, turns * n)
    N = 2 / n * np.sum(last * (np.sin(psi) + 1j * np.cos(psi))) / amplitude
    law = Backlash(k, 2 * half, c)
    assert_allclose(law.describing(amplitude, omega), N, rtol=2e-3)
    third = 2 / n * abs(np.sum(last * np.exp(-3j * psi)))
    assert_allclose(law.third(amplitude, omega), third, rtol=0.02, atol=1e-3 * abs(N) * amplitude)


def test_amplitude_from_modulus():
    for damping in (0.0, 0.3):
        b = Backlash(2.0, 0.2, damping)
        A = np.array([0.1001, 0.12, 0.5, 40.0])
        assert_allclose(b.amplitude(np.abs(b.describing(A, 5.0)), 5.0), A, rtol=1e-7)
        assert np.isnan(b.amplitude(abs(2.0 + 1.5j), 5.0))


# -- prediction against simulation -------------------------------------------------------------------------
@pytest.mark.parametrize("kv", [12.0, 14.0, 16.0, 18.0])
def test_limit_cycle_of_two_inertias_under_p_pi(kv):
    (cycle,) = limit_cycles(two_inertias(), cascade(kv), MESH, "gap", **LOAD)
    assert cycle.stable
    assert (cycle.doubt == "") == (cycle.amplitude > MESH.gap)  # two half gaps
    for scale in (0.7, 1.3):  # stable: it is reached from inside and from outside
        found = simulate(
            two_inertias(), cascade(kv), MESH, 30.0, "gap", start=cycle, scale=scale, **LOAD
        )
        assert found.verdict == "limit cycle"
        assert_allclose(found.amplitude, cycle.amplitude, rtol=0.1)
        assert_allclose(found.frequency, cycle.frequency, rtol=0.1)
        assert f"{found.frequency:.5g} Hz" in found.summary()
    assert {"gap", "contact +", "contact -"} == set(found.phase)
    assert_allclose(found["gap"], found.reading, atol=1e-15)


def test_amplitude_grows_with_the_gain_until_the_loop_is_unstable_without_a_gap():
    found = [
        limit_cycles(two_inertias(), cascade(kv), MESH, "gap", **LOAD)
        for kv in (10.0, 15.0, 20.0, 25.0)
    ]
    sizes = [c[0].amplitude for c in found[:3]]
    assert sizes == sorted(sizes)
    assert sizes[2] > 4 * sizes[1]
    assert [c.linear_stable for c in found] == [True, True, True, False]
    assert len(found[3]) == 0
    assert "predicts no limit cycle" in found[3].summary()
    assert "unstable" in found[3].summary()


def test_no_limit_cycle_where_the_loop_at_the_motor_is_passive():
    """Spring and damper at the motor, no integral: backlash can only lose energy, and what swings dies out."""
    passive = Controller(60.0, kv=6.0)
    found = limit_cycles(two_inertias(), passive, MESH, "gap", **ENCODER)
    assert len(found) == 0
    assert found.linear_stable
    assert "predicts no limit cycle" in found.summary()
    start = np.array([0.0, 0.0, 4e-3, 0.0])  # the load 8 half gaps away
    end = simulate(two_inertias(), passive, MESH, 40.0, "gap", start=start, **ENCODER)
    assert end.verdict in ("decays", "at rest")
    assert (end.amplitude, end.frequency) == (None, None)
    assert "no limit cycle" in end.summary()


def test_a_twist_barely_beyond_the_gap_is_called_doubtful():
    """An integral at the motor makes balance predict bounces; in time they die out."""
    found = limit_cycles(two_inertias(), cascade(6.0), MESH, "gap", **ENCODER)
    assert [c.stable for c in found] == [False, True]
    assert all("half gaps" in c.doubt for c in found)
    assert "doubtful" in found.summary()
    end = simulate(
        two_inertias(), cascade(6.0), MESH, 60.0, "gap", start=found[1], scale=1.5, **ENCODER
    )
    assert end.verdict in ("decays", "not settled")
    assert (
        len(end.switches) < 0.1 * 4 * 60.0 * found[1].frequency
    )  # four a period, if it were there


def test_a_bias_that_keeps_one_flank_in_contact_ends_the_limit_cycle():
    (cycle,) = limit_cycles(two_inertias(), cascade(12.0), MESH, "gap", **LOAD)
    wind = {"wind": 0.5 * K * MESH.gap}
    end = simulate(
        two_inertias(), cascade(12.0), MESH, 30.0, "gap", start=cycle, constant=wind, **LOAD
    )
    assert end.verdict in ("decays", "at rest")
    assert end.phase[-1] == "contact -"
    assert_allclose(end.torque[-1], -wind["wind"], rtol=1e-3)
    assert_allclose(end["torque (controller)"][-1], -wind["wind"], rtol=1e-3)


@SETS_SHAPES
def test_prediction_against_python_control():
    """Another program's harmonic balance, without damping in the mesh: it knows real describing functions only."""
    control = pytest.importorskip("control")
    law = Backlash(
        K, 2.0
    )  # amplitudes scale with the gap; theirs needs numbers near 1, of torque over K, too
    # A damper between motor and load beside the mesh makes the loop stable.
    plant = two_inertias()
    c = MESH.damping
    A = plant.A - c * np.outer(plant.B[:, 1], [0, 1, 0, -1])
    plant = dataclasses.replace(plant, A=A)
    cycle = limit_cycles(plant, cascade(15.0), law, "gap", **LOAD)[-1]
    system = linear_loop(plant, cascade(15.0), law, "gap", LOAD, 0)

    class DeadZone(control.DescribingFunctionNonlinearity):
        def __call__(self, z):
            return np.sign(z) * max(abs(z) - law.half, 0.0)

        def describing_function(self, A):
            d = law.half / A
            return 1 - 2 / np.pi * (np.arcsin(d) + d * np.sqrt(1 - d**2))

    H = control.ss(system.A, K * system.B[:, None], system.C[None], K * system.D)
    sizes, omega = np.linspace(1.3, 4.0, 30), np.geomspace(0.1, 200.0, 2000)
    theirs = control.describing_function_response(
        H, DeadZone(), sizes, omega, warn_nyquist=False
    ).intersections
    assert_allclose(theirs, [(cycle.amplitude, TWO_PI * cycle.frequency)], rtol=1e-3)


# -- the simulation against another integrator -------------------------------------------------------------
@pytest.mark.parametrize("damping", [0.0, 40.0, 1200.0])
def test_simulation_against_runge_kutta(damping):
    """Another formulation: the free play as a state with its limits, by solve_ivp in short steps."""
    plant, law = two_inertias(), Backlash(K, 1e-3, damping)
    A, B = plant.A, plant.B[:, 1]
    read = plant.C[3]
    x0 = np.array([0.0, 0.4, 0.0, -0.3])
    mine = simulate(plant, None, law, 0.2, "gap", start=x0)
    assert len(mine.switches) > 1

    def rates(_, X):
        x, play = X[:4], X[4]
        z, rate = read @ x, read @ A @ x
        if damping == 0.0:
            torque, moved = K * np.sign(z) * max(abs(z) - law.half, 0.0), 0.0
        else:
            moved = rate + K / damping * (z - play)
            moved = (
                min(moved, 0.0)
                if play >= law.half
                else max(moved, 0.0)
                if play <= -law.half
                else moved
            )
            torque = K * (z - play) + damping * (rate - moved)
        return np.append(A @ x - B * torque, moved)

    ivp = solve_ivp(
        rates, (0, 0.2), np.append(x0, 0.0), rtol=1e-8, atol=1e-11, max_step=2e-4, method="RK23"
    )
    for i, name in enumerate(("speed", "load", "encoder")):
        theirs = np.interp(mine.time, ivp.t, plant.C[i] @ ivp.y[:4])
        assert_allclose(mine[name], theirs, atol=2e-3 * np.abs(theirs).max(), err_msg=name)


def test_undamped_contact_keeps_its_energy():
    plant = two_inertias()
    law = Backlash(K, 1e-3)
    mine = simulate(plant, None, law, 2.0, "gap", start=[0.0, 0.4, 0.0, -0.1])
    load_speed = 0.25 * (1.0 * 0.4 + 4.0 * -0.1 - mine["speed"])
    energy = 0.5 * mine["speed"] ** 2 + 2.0 * load_speed**2 + 0.5 * mine.torque**2 / K
    assert len(mine.switches) > 40
    assert_allclose(energy, energy[0], rtol=1e-9)


def test_residual_flexibility_across_the_gap_is_in_series_with_the_mesh():
    """A plant whose twist gives way by D torque, against one whose mesh is softer by it."""
    stiff, D = two_inertias(), 0.25 / K
    soft = Plant(
        stiff.A, stiff.B, stiff.C, D * np.outer([0, 0, 0, 1], [0, 1, 0]), stiff.input_ports, stiff.output_ports,
        stiff.quantities, stiff.band, 0.02, 0, 0, "by hand",
    )  # fmt: skip
    x0 = [0.0, 0.4, 0.0, -0.3]
    series = simulate(stiff, None, Backlash(1 / (1 / K + D), 1e-3), 0.3, "gap", start=x0)
    mine = simulate(soft, None, Backlash(K, 1e-3), 0.3, "gap", start=x0)
    assert_allclose(np.interp(series.time, mine.time, mine["speed"]), series["speed"], atol=1e-3)
    # With next to no damping the other branch, the twist of the shaft as a state, says the same.
    damped = simulate(soft, None, Backlash(K, 1e-3, 1e-6 * K), 0.3, "gap", start=x0)
    assert_allclose(
        np.interp(series.time, damped.time, damped["speed"]), series["speed"], atol=2e-3
    )


def test_rounding_in_place_of_a_residual_flexibility_is_none():
    clean = two_inertias()
    for D in (1e-14 / K, -1e-14 / K):
        noisy = dataclasses.replace(clean, D=D * np.outer([0, 0, 0, 1], [0, 1, 0]))
        runs = [
            simulate(p, None, MESH, 0.3, "gap", start=[0.0, 0.4, 0.0, -0.3]) for p in (clean, noisy)
        ]
        assert_allclose(runs[1]["speed"], runs[0]["speed"], rtol=1e-9)
    wrong = dataclasses.replace(clean, D=-0.1 / K * np.outer([0, 0, 0, 1], [0, 1, 0]))
    with pytest.raises(
        ModelError, match=r"'gap' yields against input 'gap'.*the same Port for both"
    ):
        limit_cycles(wrong, None, MESH, "gap")


def test_dead_time_and_filters_of_the_controller_are_in_it():
    slow = cascade(12.0, low_pass=40.0, dead_time=1e-3)
    plain = limit_cycles(two_inertias(), cascade(12.0), MESH, "gap", **LOAD)
    late = limit_cycles(two_inertias(), slow, MESH, "gap", pade=2, **LOAD)
    assert late[0].amplitude > 1.05 * plain[0].amplitude
    found = simulate(two_inertias(), slow, MESH, 15.0, "gap", start=late[0], pade=2, **LOAD)
    assert_allclose(found.amplitude, late[0].amplitude, rtol=0.1)


# -- the opened mesh ---------------------------------------------------------------------------------------
PARTS = [
    Motor("motor", 1, 2e-3),
    Shaft("shaft", 1, 2, 800.0),
    GearPair(
        "gear",
        2,
        3,
        ratio=50.0,
        torsional_stiffness=4e6,
        viscous=300.0,
        inertia_a=1e-5,
        inertia_b=0.5,
    ),
    Inertia("load", 3, 40.0),
]


def test_an_opened_mesh_closed_again_is_the_model():
    model = drivetrain(PARTS)
    gap = opened(model, "gear", "3:RZ")
    assert_allclose([gap.stiffness, gap.damping], [4e6, 300.0])
    assert dict(gap.port.weights) == pytest.approx({"2:RZ": 1 / 50, "3:RZ": 1.0})
    assert gap.backlash(1e-4) == Backlash(gap.stiffness, 1e-4, gap.damping)
    freq = np.array([3.0, 20.0, 60.0, 150.0])
    ends = ["1:RZ", "3:RZ"]
    whole = updyn.response(model, freq, ends, ends).values
    r = np.array([0.0, 1 / 50, 1.0])
    free = updyn.response(
        gap.model, freq, ["1:RZ", "2:RZ", "3:RZ"], ["1:RZ", "2:RZ", "3:RZ"]
    ).values
    mesh = gap.stiffness + 2j * np.pi * freq * gap.damping
    closed = (
        free
        - mesh[:, None, None]
        * np.einsum("fij,j,k,fkl->fil", free, r, r, free)
        / (1 + mesh * np.einsum("i,fij,j->f", r, free, r))[:, None, None]
    )
    assert_allclose(closed[:, [0, 2]][:, :, [0, 2]], whole, rtol=1e-9)


def test_from_a_model_to_its_limit_cycle():
    gap = opened(drivetrain(PARTS), "gear", "3:RZ")
    inputs = [Port.at("1:RZ", "torque"), gap.port]
    outputs = [Port.at("1:RZ", "speed"), Port.at("3:-RZ", "dish"), gap.port]
    kinds = ["mobility", "receptance", "receptance"]
    made = updyn.plant(gap.model, inputs, outputs, (0.1, 200.0), quantity=kinds)
    controller = Controller(1.0, ti=0.1, kv=3.0 * 50)
    found = limit_cycles(made, controller, gap.backlash(2e-4), "gap")
    assert len(found) > 0
    best = max(found, key=lambda c: c.stable)
    assert best.unit == "rad"
    end = simulate(made, controller, gap.backlash(2e-4), 5.0, "gap", start=best)
    assert end.verdict in ("limit cycle", "not settled")


def test_a_loss_factor_needs_a_frequency():
    parts = [
        *PARTS[:2],
        GearPair("gear", 2, 3, ratio=50.0, torsional_stiffness=4e6, loss_factor=0.03),
        PARTS[3],
    ]
    gap = opened(drivetrain(parts), "gear", "3:RZ")
    with pytest.raises(OptionError, match=r"loss factor 0\.03; expected frequency="):
        gap.backlash(1e-4)
    assert_allclose(gap.backlash(1e-4, frequency=5.0).damping, 0.03 * 4e6 / (TWO_PI * 5))


def test_what_cannot_be_opened():
    model = drivetrain(PARTS)
    with pytest.raises(ModelError, match="did you mean 'gear'"):
        opened(model, "gaer", "3:RZ")
    with pytest.raises(ModelError, match="group 'motor' has no stiffness"):
        opened(model, "motor", "1:RZ")
    with pytest.raises(ModelError, match=r"does not act on 1:RZ; expected one of 2:RZ, 3:RZ"):
        opened(model, "gear", "1:RZ")
    chain = updyn.Model.from_groups(
        {"two": updyn.Group([[2.0, -1], [-1, 1]], np.eye(2))}, ["1:RZ", "2:RZ"]
    )
    with pytest.raises(ModelError, match="'two' is not one spring"):
        opened(chain, "two", "1:RZ")


# -- what is refused ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        (
            {"at": ("gap",)},
            OptionError,
            r"expected the name of an output and an input, or \(output, input\)",
        ),
        (
            {"controller": cascade(9.0, dead_time=1e-3), "pade": 0},
            OptionError,
            "pade=0: expected an order from 1 to 12",
        ),
        ({"at": "gpa"}, OptionError, "no output 'gpa'; did you mean 'gap'"),
        (
            {"at": ("speed", "gap")},
            OptionError,
            "Backlash acts on twists, but output 'speed' .* 'mobility'",
        ),
        ({"torque": None}, OptionError, "expected torque="),
        ({"position": None}, OptionError, "expected position="),
        ({"position": "laod"}, OptionError, "no output 'laod'; did you mean 'load'"),
        ({"measured": "speed"}, OptionError, "measured='speed' has no meaning of a Controller"),
        ({"band": (2, 1)}, OptionError, "expected 0 < low < high"),
        ({"nonlinearity": 3}, OptionError, "expected a Backlash or a CoulombFriction, found int"),
        ({"plant": "p"}, OptionError, "expected a Plant, found str"),
        ({"controller": 7}, OptionError, "expected a Controller"),
    ],
)
def test_bad_input(change, error, said):
    given = {
        "plant": two_inertias(),
        "controller": cascade(9.0),
        "nonlinearity": MESH,
        "at": "gap",
        **LOAD,
    } | change
    if given["controller"] == 7:
        given |= {"velocity": None, "position": None}
    with pytest.raises(error, match=said):
        limit_cycles(**given)


def test_bad_numbers():
    for arguments in ((0, 1), (1, -1), (1, np.nan), (1, 1, -2)):
        with pytest.raises(OptionError, match="backlash: "):
            Backlash(*arguments)
    run = {"plant": two_inertias(), "controller": None, "nonlinearity": MESH, "at": "gap"}
    with pytest.raises(OptionError, match=r"duration -1"):
        simulate(duration=-1, **run)
    with pytest.raises(OptionError, match="steps of"):
        simulate(duration=1e6, **run)
    with pytest.raises(OptionError, match="expected a LimitCycle or numbers"):
        simulate(duration=1, start="here", **run)
    with pytest.raises(OptionError, match="expected 4 finite states"):
        simulate(duration=1, start=[1.0], **run)
    with pytest.raises(OptionError, match="no constant input 'winds'; did you mean 'wind'"):
        simulate(duration=1, constant={"winds": 1.0}, **run)
