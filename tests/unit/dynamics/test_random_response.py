"""`updyn.response` under a random force: statistical linearisation."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from periodic_cases import oscillator, simulate_random, two_masses
from updyn.dynamics import linearisation
from updyn.errors import DataError, ModelError, OptionError, SolverError
from updyn.updating.judge.levels import of_run

FREQ = np.linspace(0.5, 5.0, 60)
ELEMENTS = {
    "joint": (updyn.CubicSpring(2e6), ["1:X", "2:X"]),
    "stop": (updyn.Backlash(100.0, 0.01, offset=0.002), "1:X"),
    "friction": (updyn.CoulombFriction(0.3), "2:X"),
    "slider": (updyn.JenkinsElement(50.0, 0.2), "1:X"),
}
MODEL = two_masses(loss_factor=0.03).with_elements(ELEMENTS)


def respond(model, freq=FREQ, forces=("1:X", "2:X"), quantity="receptance", level=1.0, **options):
    return updyn.response(
        model, freq, ["1:X", "2:X"], forces, quantity, level=level, excitation="random", **options
    )


def replaced(model: updyn.Model, found, j: int) -> updyn.Model:
    """Return the linear model with the springs and dampers of force j."""
    groups = dict(model.groups)
    for e, (name, local) in enumerate(model.nonlinear.items()):
        w = local.column(model.dofs)
        outer = np.outer(w, w)
        groups[name] = updyn.Group(
            found.stiffness[e, j] * outer, viscous=found.damping[e, j] * outer
        )
    return updyn.Model.from_groups(groups, ["1:X", "2:X"])


@pytest.mark.parametrize("quantity", ["receptance", "accelerance"])
def test_the_result_is_the_linear_model_with_equivalent_springs_and_dampers(quantity):
    found = respond(MODEL, forces=["1:X", "2:-X"], quantity=quantity)
    for j, force in enumerate(["1:X", "2:-X"]):
        linear = updyn.response(
            replaced(MODEL, found, j), FREQ, ["1:X", "2:X"], [force], quantity
        ).values
        np.testing.assert_allclose(found.values[:, :, [j]], linear, rtol=1e-8)


def test_the_standard_deviations_are_those_of_the_linearised_model():
    """The force has the constant one-sided density level^2 / (band) between the lines alone."""
    level = 0.7
    found = respond(MODEL, level=level)
    fine = np.linspace(FREQ[0], FREQ[-1], 40_001)
    for j, force in enumerate(["1:X", "2:X"]):
        H = updyn.response(replaced(MODEL, found, j), fine, ["1:X", "2:X"], [force]).values[:, :, 0]
        for e, local in enumerate(MODEL.nonlinear.values()):
            q = np.abs(H @ local.column(MODEL.dofs)) ** 2
            density = level**2 / (FREQ[-1] - FREQ[0])
            sigma = np.sqrt(density * np.trapezoid(q, fine))
            sigma_v = np.sqrt(density * np.trapezoid((2 * np.pi * fine) ** 2 * q, fine))
            assert found.deformation[e, j] == pytest.approx(sigma, rel=1e-5)
            assert found.velocity[e, j] == pytest.approx(sigma_v, rel=1e-5)
    np.testing.assert_allclose(found.stiffness[0], 6e6 * found.deformation[0] ** 2, rtol=1e-7)
    friction = 0.3 * np.sqrt(2 / np.pi) / found.velocity[2]
    np.testing.assert_allclose(found.damping[2], friction, rtol=1e-7)


def test_duffing_under_wide_band_noise_is_the_closed_result():
    """sigma^2 (1 + 3 c sigma^2) = S / (4 d): Roberts & Spanos (1990), section 5.3."""
    band, c, d, level = np.array([1e-4, 40.0]), 0.8, 0.2, 2.0
    model = oscillator(viscous=d).with_elements({"spring 3": (updyn.CubicSpring(c), "1:X")})
    found = updyn.response(model, band, ["1:X"], ["1:X"], level=level, excitation="random")
    variance = level**2 / (band[1] - band[0]) / (4 * d)
    expected = (np.sqrt(1 + 12 * c * variance) - 1) / (6 * c)
    assert found.deformation[0, 0] ** 2 == pytest.approx(expected, rel=1e-3)
    assert found.velocity[0, 0] ** 2 == pytest.approx(variance, rel=5e-3)  # of the band's end


def test_the_mean_is_in_static_equilibrium():
    """A weight c_2 E[u^2] moves the mean of one mass with an even spring."""
    spring = updyn.PolynomialSpring({2: 0.2, 3: 0.1})
    model = oscillator(viscous=0.3).with_elements({"even": (spring, "1:X")})
    found = updyn.response(model, [0.05, 0.5], ["1:X"], ["1:X"], level=0.5, excitation="random")
    m, s = found.mean[0, 0], found.deformation[0, 0]
    assert m < -0.01
    force = 0.2 * (m**2 + s**2) + 0.1 * (m**3 + 3 * m * s**2)
    assert m == pytest.approx(-force, rel=1e-6)
    assert found.stiffness[0, 0] == pytest.approx(0.4 * m + 0.3 * (m**2 + s**2), rel=1e-6)


def test_a_small_level_is_the_model_at_rest():
    elements = {name: ELEMENTS[name] for name in ("joint", "slider")}
    model = two_masses(loss_factor=0.03).with_elements(elements)
    found = respond(model, level=1e-5)
    rest = updyn.response(model.linearised(), FREQ, ["1:X", "2:X"], ["1:X", "2:X"]).values
    np.testing.assert_allclose(found.values, rest, rtol=1e-6)


def test_friction_that_a_force_does_not_move_sticks():
    model = two_masses(loss_factor=0.03).with_elements(
        {"lock": (updyn.CoulombFriction(50.0), "2:X")}
    )
    found = respond(model, forces=["1:X"])
    held = {
        "springs": updyn.Group([[300.0]], loss_factor=0.03),
        "masses": updyn.Group(mass=[[1.0]]),
    }
    alone = updyn.Model.from_groups(held, ["1:X"])
    expected = updyn.response(alone, FREQ, ["1:X"], ["1:X"]).values
    np.testing.assert_allclose(found.values[:, :1], expected, rtol=1e-6)


def test_a_free_model_has_random_responses():
    groups = {"mass": updyn.Group(mass=np.eye(2))}
    free = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    gap = free.with_elements({"gap": (updyn.Backlash(400.0, 1e-3), ["1:X", "2:X"])})
    damped = gap.with_elements({"damper": (updyn.QuadraticDamper(5.0), ["1:X", "2:X"])})
    found = respond(damped, forces=["1:X"])
    assert 0.0 < found.stiffness[0, 0] < 400.0
    offset = damped.with_elements({"stop": (updyn.Backlash(4.0, 1e-3, offset=1e-4), "1:X")})
    with pytest.raises(SolverError, match="the model is free at 0 Hz"):
        respond(offset)


def test_a_reduced_model_agrees():
    exact, reduced = respond(MODEL, tier="dense"), respond(MODEL, tier="reduced")
    np.testing.assert_allclose(reduced.values, exact.values, rtol=1e-5)
    assert "reduced" in reduced.source


CHAIN = np.diag([2.0, 2.0, 2.0]) - np.eye(3, k=1) - np.eye(3, k=-1)
SIMULATED = {
    "duffing": ([[1.0]], {"e": (updyn.CubicSpring(0.01), "1:X")}),
    "dead zone": ([[1.0]], {"e": (updyn.Backlash(0.12, 1.0), "1:X")}),
    "friction": ([[1.0]], {"e": (updyn.CoulombFriction(0.03, transition=0.05), "1:X")}),
    "chain": (
        CHAIN,
        {
            "a": (updyn.CubicSpring(0.02), "1:X"),
            "b": (updyn.CoulombFriction(0.03, transition=0.05), ["2:X", "3:X"]),
        },
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SIMULATED)
def test_h1_of_a_simulated_random_test_agrees_within_its_statistical_error(name):
    K, elements = SIMULATED[name]
    n = len(K)
    labels, C = [f"{i + 1}:X" for i in range(n)], 0.1 * np.eye(n)
    groups = {"springs": updyn.Group(K, viscous=C), "masses": updyn.Group(mass=np.eye(n))}
    linear = updyn.Model.from_groups(groups, labels)
    model = linear.with_elements(elements)
    freq = np.arange(4, 160) / 314.0
    H, error = simulate_random(model, np.asarray(K), C, freq, 0.4, realisations=40, steps=4000)
    found = updyn.response(model, freq, labels, labels[:1], level=0.4, excitation="random")

    def chi_square(values):
        return float(np.mean(np.abs((H - values[:, :, 0]) / error) ** 2))

    # The mean over a few hundred correlated numbers of mean 1.
    assert chi_square(found.values) < 1.4
    assert chi_square(updyn.response(linear, freq, labels, labels[:1]).values) > 4.0


def test_the_frf_states_the_random_level():
    frf = respond(MODEL, level=3.0).frf
    assert (frf.level[0], frf.excitation, frf.is_random) == (3.0, "random", True)
    assert frf.level_text == "level 3 N random"
    assert not frf.with_level(3.0).is_random


def test_a_linearisation_that_does_not_settle_is_an_error(monkeypatch):
    settings = linearisation.RANDOM
    monkeypatch.setattr(linearisation, "RANDOM", type(settings)(most_iterations=3))
    with pytest.raises(SolverError, match="did not settle"):
        respond(MODEL)


def oscillate(element, *, viscous=0.1, level=0.4):
    model = oscillator(viscous=viscous).with_elements({"e": (element, "1:X")})
    freq = np.linspace(0.01, 0.48, 40)
    return updyn.response(model, freq, ["1:X"], ["1:X"], level=level, excitation="random")


def test_a_negative_stiffness_is_an_error():
    """The iteration ends at a stiffness of -1.2 beside the spring of 1."""
    with pytest.raises(SolverError, match="unstable, as an element softens"):
        oscillate(updyn.CubicSpring(-1.0))


def test_a_model_whose_elements_have_the_only_damping():
    """sigma_v^2 = S / (4 c) with c = sqrt(8 / pi) d sigma_v, in a wide band."""
    found = oscillate(updyn.QuadraticDamper(0.1), viscous=0.0)
    np.testing.assert_allclose(found.damping, np.sqrt(8 / np.pi) * 0.1 * found.velocity, rtol=1e-7)
    wide = (0.4**2 / 0.47 / 4 / (0.1 * np.sqrt(8 / np.pi))) ** (1 / 3)
    assert found.velocity[0, 0] == pytest.approx(wide, rel=0.1)


def test_a_model_without_damping_is_an_error():
    # By rounding, the resonance is met exactly or nearly.
    with pytest.raises(SolverError, match=r"resonance without damping|did not settle"):
        oscillate(updyn.CubicSpring(0.1), viscous=0.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"level": -1.0}, "RMS of a random force above 0"),
        ({"level": None}, "expected level="),
        ({"spectrum": [[1.0, 2.0], [3.0, 2.0]]}, "expected one of the two"),
        ({"freq": [1.0]}, "two lines or more"),
        ({"freq": [0.0, 1.0]}, "above 0 Hz"),
        ({"amplitude": 1.0}, "no amplitude"),
        ({"control": "1:X"}, "no amplitude, control"),
        ({"decay": 1.0}, "decay"),
        ({"sweep": "down"}, "no harmonics, samples or sweep"),
    ],
)
def test_options_that_cannot_be_used_are_refused(options, message):
    with pytest.raises(OptionError, match=message):
        respond(MODEL, **options)


def test_a_spectrum_is_a_level_of_any_lines():
    """The lines do not state the band, and a density of two bands is the sum of both."""
    spectrum = np.array([[FREQ[0], 2.0], [FREQ[-1], 2.0]])
    level = np.sqrt(2.0 * (FREQ[-1] - FREQ[0]))
    flat, few = respond(MODEL, level=level), [1.0]
    found = respond(MODEL, few, level=None, spectrum=spectrum)
    np.testing.assert_allclose(found.deformation, flat.deformation, rtol=1e-9)
    assert found.level == pytest.approx(level)
    np.testing.assert_array_equal(found.frf.spectrum, spectrum)
    shaped = [[0.5, 2.0], [1.8, 2.0], [2.0, 0.1], [2.4, 0.1], [2.6, 2.0], [5.0, 2.0]]
    fine = np.linspace(0.5, 5.0, 40_001)
    found = respond(MODEL, few, ["1:X"], level=None, spectrum=shaped)
    linear = updyn.response(replaced(MODEL, found, 0), fine, ["1:X", "2:X"], ["1:X"]).values[..., 0]
    density = np.interp(fine, *np.array(shaped).T)
    for e, local in enumerate(MODEL.nonlinear.values()):
        q = np.abs(linear @ local.column(MODEL.dofs)) ** 2
        sigma = np.sqrt(np.trapezoid(density * q, fine))
        assert found.deformation[e, 0] == pytest.approx(sigma, rel=1e-5)


def test_a_spectrum_of_a_sine_is_refused():
    with pytest.raises(OptionError, match="spectrum: of a random force"):
        updyn.response(MODEL, FREQ, ["1:X"], ["1:X"], spectrum=[[1.0, 2.0], [3.0, 2.0]])


def test_an_unknown_excitation_and_a_linear_model_are_refused():
    with pytest.raises(OptionError, match="excitation 'noise'"):
        updyn.response(MODEL, FREQ, ["1:X"], ["1:X"], level=1.0, excitation="noise")
    with pytest.raises(ModelError, match="no nonlinear elements"):
        respond(two_masses())


def test_levels_of_a_sine_and_of_a_random_force_are_not_compared():
    """Amplitude and RMS are different numbers; random levels alone are compared."""
    low, high = (respond(MODEL, level=level).frf for level in (0.3, 3.0))
    noise = {"relative": 0.01, "floor": 0.001}
    assert updyn.detect_nonlinearity([low, high], noise=noise).is_nonlinear
    sine = low.with_level(0.3)
    with pytest.raises(DataError, match="test 2: level 3 N random, test 1: level"):
        updyn.detect_nonlinearity([sine, high], noise=noise)
    groups = of_run._group_alike([sine, low, high])
    assert [[frf.is_random for frf in group] for group in groups] == [[True, True]]


def test_a_stiff_joint_holds_the_resonance_outside_of_the_band():
    """From the motion without it, the iteration meets the resonance at the end of the band."""
    joint = updyn.IwanJoint(3.0, 20_000.0, chi=-0.4, beta=0.3)
    found = oscillate(joint, viscous=0.02, level=1.0)
    assert found.stiffness[0, 0] > 1e4
    # Far below its resonance, it moves as a spring.
    static = 1.0 / abs(found.stiffness[0, 0] + 1.0 + 1j * 1.5 * found.damping[0, 0])
    assert found.deformation[0, 0] == pytest.approx(static, rel=0.01)
