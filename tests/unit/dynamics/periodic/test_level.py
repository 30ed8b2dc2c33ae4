"""`updyn.response` at a force amplitude, against closed results and time integration."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import updyn
from periodic_cases import K2, M2, integrate, oscillator, sample, two_masses
from updyn.errors import ModelError, OptionError, SolverError, UpdynWarning

FOLDING = np.linspace(0.3, 2.5, 60) / (2 * np.pi)


def duffing(**damping: float) -> updyn.Model:
    return oscillator(**damping).with_elements({"spring 3": (updyn.CubicSpring(0.5), "1:X")})


@pytest.fixture(scope="module")
def folded() -> updyn.dynamics.periodic.response.PeriodicResponse:
    """Duffing oscillator with one harmonic, swept through its turning points."""
    model, at = duffing(viscous=0.05), ["1:X"]
    with pytest.warns(UpdynWarning, match="harmonics 1: the next ones are estimated at"):
        return updyn.response(model, FOLDING, at, at, level=0.3, harmonics=1)


def amplitudes(omega: float) -> list[float]:
    """Amplitudes of one harmonic: A^2 ((1 - w^2 + 3/4 c A^2)^2 + (d w)^2) = F^2."""
    b = 0.75 * 0.5
    square = [b**2, 2 * b * (1 - omega**2), (1 - omega**2) ** 2 + (0.05 * omega) ** 2, -(0.3**2)]
    roots = np.roots(square)
    return sorted(np.sqrt(roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0)]))


def test_one_harmonic_is_the_closed_result(folded) -> None:
    """Nayfeh & Mook, Nonlinear Oscillations (1979), section 4.1, without small parameters."""
    (branch,) = folded.branches
    size = np.abs(branch.harmonics[:, 1, 0])
    for f, A in zip(branch.freq, size, strict=True):
        assert min(abs(A - root) for root in amplitudes(2 * np.pi * f)) < 1e-8
    several = [len(amplitudes(2 * np.pi * f)) == 3 for f in FOLDING]
    assert 5 < sum(several) < 55
    for number, f in enumerate(FOLDING):
        points = np.sum(branch.freq == f)
        assert points == len(amplitudes(2 * np.pi * f)), number


def test_a_sweep_keeps_its_branch_until_it_turns(folded) -> None:
    at = ["1:X"]
    with pytest.warns(UpdynWarning):
        down = updyn.response(
            duffing(viscous=0.05), FOLDING, at, at, level=0.3, harmonics=1, sweep="down"
        )
    for f, up, low in zip(FOLDING, folded.values[:, 0, 0], down.values[:, 0, 0], strict=True):
        roots = amplitudes(2 * np.pi * f)
        assert 0.3 * abs(up) == pytest.approx(roots[-1], rel=1e-8)
        assert 0.3 * abs(low) == pytest.approx(roots[0], rel=1e-8)
    assert folded.stable.all()
    assert down.stable.all()
    assert (np.abs(folded.values) > 1.5 * np.abs(down.values)).sum() > 5


def test_motion_between_the_turning_points_is_unstable(folded) -> None:
    (branch,) = folded.branches
    rising = np.gradient(branch.freq, np.arange(len(branch.freq))) > 0
    turns = np.flatnonzero(np.diff(rising.astype(int)))
    assert len(turns) == 2
    inner = np.arange(len(rising))
    far = np.min(np.abs(inner[:, None] - turns), axis=1) > 2
    assert (branch.stable == rising)[far].all()


def test_many_harmonics_are_the_time_response() -> None:
    """Two masses, a cubic spring between them and quadratic damping, against DOP853."""
    model = two_masses(stiffness_damping=0.002)
    bend = updyn.PolynomialSpring({2: -30.0, 3: 40.0})
    model = model.with_elements(
        {"cubic": (updyn.CubicSpring(80.0), ["1:X", "2:X"]), "bend": (bend, "1:X")}
    )
    freq, F = np.linspace(0.9, 1.9, 5), np.array([0.0, 20.0])
    found = updyn.response(model, freq, ["1:X", "2:X"], ["2:X"], level=20.0, harmonics=17)
    C = 0.002 * K2
    for line in (1, 3):
        omega = 2 * np.pi * freq[line]

        def rest(t: float, q: np.ndarray, v: np.ndarray, omega: float = omega) -> np.ndarray:
            cubic = 80.0 * (q[0] - q[1]) ** 3
            bend = -30.0 * q[0] ** 2 + 40.0 * q[0] ** 3
            return F * np.cos(omega * t) - K2 @ q - C @ v - np.array([cubic + bend, -cubic])

        A = found.harmonics[line, :, :, 0]
        start = np.append(sample(A, 1)[:, 0], sample(A, 1, rate=omega)[:, 0])
        expected = integrate(start, M2, rest, omega)
        error = np.abs(sample(A) - expected).max() / np.abs(expected).max()
        assert error < 1e-6
        assert error < 5.0 * found.truncation[line, 0] + 1e-9
    assert found.values[:, :, 0] == pytest.approx(found.harmonics[:, 1, :, 0] / 20.0)


@pytest.mark.parametrize(
    "element",
    [
        updyn.Backlash(3.0, gap=0.8),
        updyn.JenkinsElement(0.5, slip_force=0.2),
        updyn.IwanJoint(5.0, 0.5, -0.5, 0.1),
        updyn.QuadraticDamper(0.2),
        updyn.CubicSpring(-0.02),
    ],
    ids=lambda e: type(e).__name__,
)
def test_one_harmonic_is_the_describing_function(element) -> None:
    """F = |Z(omega) + N(A)| A for structural damping, the closed N of each element."""
    model = oscillator(loss=0.1).with_elements({"element": (element, "1:X")})
    freq, at = np.linspace(0.6, 1.6, 5) / (2 * np.pi), ["1:X"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UpdynWarning)
        found = updyn.response(model, freq, at, at, level=0.5, harmonics=1, samples=2048)
    for f, value in zip(freq, found.values[:, 0, 0], strict=True):
        omega = 2 * np.pi * f

        def force(A: float, omega: float = omega) -> complex:
            N = complex(element.describing(A, omega))
            if element.quantity == "mobility":
                N = complex(element.describing(A * omega, omega)) * 1j * omega
            return (1.0 + 0.1j - omega**2 + N) * A

        A = abs(value) * 0.5
        assert force(A) * value / abs(value) == pytest.approx(0.5, rel=1e-5)


def test_quantities_references_and_signs() -> None:
    model = two_masses(loss_factor=0.1).with_elements({"a": (updyn.CubicSpring(50.0), "1:X")})
    freq = [1.0, 1.5, 2.0]
    plain = updyn.response(model, freq, ["1:X", "2:X"], ["1:X", "2:X"], level=30.0)
    signed = updyn.response(
        model, freq, ["2:-X"], ["2:X", "1:-X"], "accelerance", level=30.0, harmonics=7
    )
    s = 2j * np.pi * np.array(freq)[:, None]
    assert signed.values[:, 0] == pytest.approx(
        -(s**2) * plain.values[:, 1, ::-1] * [1.0, -1.0], rel=1e-6
    )
    k = np.arange(8)[:, None]
    expected = (k * s[:, None]) ** 2 * plain.harmonics[:, :, 1, ::-1]
    # A force of the other sign moves the phase of harmonic k by k half turns.
    expected *= -np.stack([np.ones(8), (-1.0) ** np.arange(8)], axis=1)
    assert np.abs(signed.harmonics[:, :, 0] - expected).max() < 1e-6 * np.abs(expected).max()
    frf = signed.frf
    assert frf.quantity == "accelerance"
    assert frf.values == pytest.approx(signed.values)
    assert "level 30" in frf.source


def test_a_table_of_loss_factors_that_is_constant_is_the_loss_factor() -> None:
    table = updyn.LossTable([0.1, 10.0], [1.0, 1.0])
    at, found = ["1:X"], []
    for damping in ({"loss_factor": 0.1}, {"loss_factor": 0.1, "loss_table": table}):
        groups = {"spring": updyn.Group([[1.0]], **damping), "mass": updyn.Group(mass=[[1.0]])}
        model = updyn.Model.from_groups(groups, at)
        model = model.with_elements({"a": (updyn.CubicSpring(0.5), "1:X")})
        freq = np.linspace(0.12, 0.45, 6)
        found.append(updyn.response(model, freq, at, at, level=0.3))
    assert found[1].values == pytest.approx(found[0].values, rel=1e-8)
    ends = [np.flatnonzero(np.diff(one.branches[0].stable.astype(int))) for one in found]
    assert len(ends[0]) == len(ends[1]) == 2


def test_a_vanishing_level_is_the_linearised_model() -> None:
    model = two_masses(loss_factor=0.1)
    model = model.with_elements({"joint": (updyn.JenkinsElement(100.0, 5.0), ["1:X", "2:X"])})
    model = model.with_elements({"drag": (updyn.CoulombFriction(1.0, transition=2.0), "2:X")})
    freq = np.linspace(1.0, 2.0, 3)
    found = updyn.response(model, freq, ["1:X"], ["2:X"], level=1e-5, harmonics=1)
    linear = updyn.response(model.linearised(), freq, ["1:X"], ["2:X"])
    assert found.values == pytest.approx(linear.values, rel=1e-6)


def test_a_free_model_is_solved_with_odd_harmonics() -> None:
    groups = {
        "spring": updyn.Group([[200.0, -200.0], [-200.0, 200.0]], loss_factor=0.05),
        "masses": updyn.Group(mass=np.eye(2)),
    }
    model = updyn.Model.from_groups(groups, ["1:X", "2:X"])
    freq = np.linspace(2.0, 4.5, 10)
    odd = model.with_elements({"a": (updyn.CubicSpring(200.0), ["1:X", "2:X"])})
    found = updyn.response(odd, freq, ["1:X"], ["2:X"], level=40.0)
    assert not found.harmonics[:, ::2].any()
    assert np.abs(found.harmonics[:, 3]).max() > 1e-4
    # The springs carry the difference of both displacements, as in a held model.
    held = odd.with_element("weak", ["1:X"], stiffness=1e-6)
    expected = updyn.response(held, freq, ["1:X"], ["2:X"], level=40.0)
    assert found.values == pytest.approx(expected.values, rel=1e-5)
    uneven = model.with_elements({"a": (updyn.PolynomialSpring({2: 1.0}), ["1:X", "2:X"])})
    with pytest.raises(SolverError, match="free at 0 Hz and an element is not odd"):
        updyn.response(uneven, freq, ["1:X"], ["2:X"], level=1.0)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"level": -1.0}, OptionError, "level -1.0: expected a force amplitude above 0, in N"),
        ({"freq": [0.0, 1.0]}, OptionError, "a line at 0 Hz has no period"),
        ({"harmonics": 0}, OptionError, "harmonics 0: expected a whole number of at least 1"),
        ({"samples": 35}, OptionError, "samples 35: expected a whole number of at least 36"),
        ({"sweep": "upp"}, OptionError, "sweep 'upp'"),
        ({"decay": 1.0}, OptionError, "level: expected no decay, base or force"),
        ({"quantity": "transmissibility"}, updyn.UpdynError, "is no motion over a force"),
        ({"model": oscillator()}, ModelError, "the model has no nonlinear elements"),
    ],
)
def test_wrong_options_are_refused(change, error, message: str) -> None:
    given = {"model": duffing(), "freq": [1.0], "responses": ["1:X"], "references": ["1:X"]}
    with pytest.raises(error) as found:
        updyn.response(**{**given, "level": 1.0, **change})
    assert message in str(found.value)


def test_a_response_without_any_solution_is_an_error(monkeypatch) -> None:
    """Its branch is empty."""
    monkeypatch.setattr("updyn.dynamics.periodic.response.solve_first", lambda balance, omega: None)
    groups = {"spring": updyn.Group([[1e4]]), "mass": updyn.Group(mass=[[1.0]])}
    model = updyn.Model.from_groups(groups, ["1:X"])
    model = model.with_elements({"cube": (updyn.CubicSpring(1e8), "1:X")})
    with pytest.raises(SolverError, match="no periodic response was found at any line"):
        updyn.response(model, [5.0, 6.0], ["1:X"], ["1:X"], level=1.0)
