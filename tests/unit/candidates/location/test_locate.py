"""Place and kind of a nonlinear element, against simulated truths."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import updyn
from updyn.candidates.location.describing import ELEMENT
from updyn.candidates.location.levels import LevelData
from updyn.candidates.location.motion import RandomMotion
from updyn.candidates.location.place import PlaceProblem
from updyn.candidates.location.places import list_places
from updyn.candidates.location.result import LocationRow, NonlinearityLocation
from updyn.candidates.location.settings import LOCATION
from updyn.errors import DataError, OptionError
from updyn.nonlinear.gaussian import linearise
from updyn.updating.problem.local_elements import LocalElements
from updyn.updating.problem.parameters import no_unknowns

N = 6
FREQ = np.linspace(1.0, 9.0, 40)
SENSORS = ["2:X", "4:X", "6:X"]
NOISE = {"relative": 0.01, "floor": 0.001}
LEVELS = (0.5, 5.0)


def chain() -> updyn.Model:
    """Six masses of 1 kg on springs of 1 kN/m, held at one end; two groups of springs."""
    parts = {}
    for name, first, last in (("left", 0, 3), ("right", 3, N)):
        K = np.zeros((N, N))
        for i in range(first, last):
            b = np.zeros(N)
            b[i] = 1.0
            if i:
                b[i - 1] = -1.0
            K += 1000.0 * np.outer(b, b)
        parts[name] = updyn.Group(K, loss_factor=0.03)
    parts["masses"] = updyn.Group(mass=np.eye(N))
    return updyn.Model.from_groups(parts, [f"{i + 1}:X" for i in range(N)])


MODEL = chain()


@cache
def simulate(element, place, level, sensors, excitation):
    """FRFs of the chain with an element at a level."""
    if element is None:
        return updyn.response(MODEL, FREQ, sensors, ["6:X"]).with_level(level)
    true = MODEL.with_elements({"x": (element, place)})
    return updyn.response(true, FREQ, sensors, ["6:X"], level=level, excitation=excitation).frf


def measure(
    element,
    place,
    noise=NOISE,
    levels=LEVELS,
    seed=0,
    sensors=SENSORS,
    excitation="sine",
):
    """Noisy FRFs of the chain with an element at several levels."""
    rng, tests = np.random.default_rng(seed), []
    for level in levels:
        frf = simulate(element, tuple(place), level, tuple(sensors), excitation)
        H = frf.values
        rms = np.sqrt(np.mean(np.abs(H) ** 2))
        size = np.hypot(noise.get("relative", 0.0) * np.abs(H), noise.get("floor", 0.0) * rms)
        draw = rng.standard_normal((2, *H.shape)) / np.sqrt(2.0)
        tests.append(replace(frf, values=H + size * (draw[0] + 1j * draw[1])))
    return tests


CASES = {
    "cubic-spring": (updyn.CubicSpring(2e4), ["4:X", "5:X"], "4:X - 5:X"),
    "jenkins": (updyn.JenkinsElement(400.0, 3.0), ["1:X"], "1:X - ground"),
    "quadratic-damper": (updyn.QuadraticDamper(20.0), ["2:X", "3:X"], "2:X - 3:X"),
}


@pytest.mark.parametrize("kind", list(CASES))
def test_place_and_kind_are_right_and_the_parameters_within_their_errors(kind):
    element, dofs, place = CASES[kind]
    found = updyn.locate_nonlinearity(MODEL, measure(element, dofs), noise=NOISE)
    assert (found.best.place, found.best.kind) == (place, kind)
    assert found.distinguishable
    assert found.is_likely
    assert found.is_adequate
    assert found.places[place] == pytest.approx(next(iter(found.places.values())), rel=1e-6)
    assert 0.9 < found.places[place] < 1.1
    for name, std in found.best.std.items():
        error = getattr(found.best.element, name) - getattr(element, name)
        assert abs(error) < 4.0 * std, name
        assert std < 0.2 * abs(getattr(element, name)), name
    assert set(found.best.model.nonlinear) == {ELEMENT}


RANDOM = {
    "cubic-spring": updyn.CubicSpring(4e5),
    "jenkins": updyn.JenkinsElement(400.0, 3.0),
}


@pytest.mark.parametrize("kind", list(RANDOM))
def test_random_tests_have_place_and_kind_as_well(kind):
    element, place = RANDOM[kind], ["2:X", "3:X"]
    places = {"1": ["1:X"], "2 - 3": place, "4 - 5": ["4:X", "5:X"], "6": ["6:X"]}
    tests = measure(element, place, levels=(2.0, 12.0), excitation="random")
    found = updyn.locate_nonlinearity(
        MODEL, tests, places, ["quadratic-damper", *RANDOM], noise=NOISE
    )
    assert (found.best.place, found.best.kind) == ("2 - 3", kind)
    assert found.is_likely
    assert found.is_adequate
    for name, std in found.best.std.items():
        error = getattr(found.best.element, name) - getattr(element, name)
        assert abs(error) < 4.0 * std, name


def test_random_tests_and_sines_are_not_compared():
    element, place = RANDOM["cubic-spring"], ["2:X", "3:X"]
    (frf,) = measure(element, place, levels=(2.0,), excitation="random")
    tests = [frf, frf.with_level(12.0)]
    with pytest.raises(DataError, match="random"):
        updyn.locate_nonlinearity(MODEL, tests, {"joint": place}, noise=NOISE)


@pytest.mark.parametrize("element", [*RANDOM.values(), updyn.QuadraticDamper(20.0)])
def test_the_equivalent_stiffness_of_a_random_motion_is_that_of_its_linearisation(element):
    omega, spread = np.array([3.0, 20.0]), np.array([[[0.01], [0.03]], [[0.2], [0.5]]])
    found = RandomMotion(spread, omega).describe(element)
    for level in range(2):
        one = linearise(element, *spread[:, level, 0])
        np.testing.assert_allclose(found[level, :, 0], one.stiffness + 1j * omega * one.damping)


def test_linear_unknowns_are_fitted_with_the_element():
    """Springs off by 20 %, and a slider that stiffens the structure at all levels."""
    element, dofs, place = CASES["jenkins"]
    wrong = MODEL.scaled({"left": {"stiffness": 1.2}, "right": {"stiffness": 0.85}})
    unknowns = updyn.parameters(wrong, stiffness="all", loss_factor="all")
    kinds = ["cubic-spring", "jenkins", "backlash"]
    found = updyn.locate_nonlinearity(
        wrong, measure(element, dofs), kinds=kinds, unknowns=unknowns, noise=NOISE
    )
    assert (found.best.place, found.best.kind) == (place, "jenkins")
    assert found.best.element.slip_force == pytest.approx(3.0, rel=0.02)
    assert found.best.values["left.stiffness"] == pytest.approx(1.0 / 1.2, rel=0.01)
    assert found.best.values["right.stiffness"] == pytest.approx(1.0 / 0.85, rel=0.01)
    assert found.best.model.groups["left"].stiffness[0, 0] == pytest.approx(2000.0, rel=0.01)


def locate_behind_a_sensor(element, levels, places, kinds):
    """An element on "left", which the sensors bound; springs off by up to 20 %."""
    wrong = MODEL.scaled({"left": {"stiffness": 1.2}, "right": {"stiffness": 0.85}})
    unknowns = updyn.parameters(wrong, stiffness="all", loss_factor="all")
    tests = measure(element, ["2:X"], levels=levels, sensors=["3:X", "5:X", "6:X"])
    named = {place: [place] for place in places}
    return updyn.locate_nonlinearity(wrong, tests, named, kinds, unknowns=unknowns, noise=NOISE)


def test_forces_of_any_kind_do_not_replace_the_linear_unknowns():
    """A force behind the sensor at 3:X explains the data with any stiffness of "left"."""
    element = updyn.CubicSpring(-3000.0)
    places = ["1:X", "2:X", "3:X"]
    found = locate_behind_a_sensor(element, (0.2, 5.0), places, ["cubic-spring"])
    assert max(found.places.values()) < 1.1
    assert found.best.place == "2:X"
    assert found.best.element.coefficient == pytest.approx(-3000.0, rel=0.05)
    assert found.is_adequate


def test_an_exact_fit_begins_at_the_better_of_two_starts():
    """Describing functions weighted by the noise alone lead away from a start near the minimum."""
    element, kinds = updyn.CubicSpring(3e4), ["polynomial-spring"]
    found = locate_behind_a_sensor(element, (0.2, 1.0, 5.0), ["2:X"], kinds)
    assert found.is_adequate
    assert found.best.element.coefficients[3] == pytest.approx(3e4, rel=0.05)


def test_equal_kinds_and_equal_places_are_not_distinguishable():
    element, dofs, _ = CASES["cubic-spring"]
    found = updyn.locate_nonlinearity(
        MODEL,
        measure(element, dofs),
        {"joint": dofs, "again": dofs, "other": ["1:X"]},
        {"cubic": updyn.CubicSpring(1e5), "power": updyn.PolynomialSpring({3: 1e5})},
        noise=NOISE,
    )
    assert not found.distinguishable
    assert not found.place_is_distinguishable
    assert {row.place for row in found if row.log_evidence > -1.0} == {"joint", "again"}
    assert {row.kind for row in found if row.log_evidence > -1.0} == {"cubic", "power"}
    assert "not distinguishable from" in found.statement


def test_a_linear_structure_needs_no_element():
    found = updyn.locate_nonlinearity(
        MODEL, measure(None, []), kinds=["cubic-spring", "jenkins"], noise=NOISE
    )
    assert not found.is_likely
    assert found.statement.startswith("No nonlinear element is needed")
    assert found.linear_residual == pytest.approx(1.0, abs=0.1)


def test_noise_is_estimated_if_it_is_not_stated():
    """Peaks are narrower than the spacing of lines, whose scatter is up to 340 times the noise."""
    element, dofs, place = CASES["cubic-spring"]
    found = updyn.locate_nonlinearity(MODEL, measure(element, dofs), kinds=["cubic-spring"])
    assert (found.best.place, found.best.kind) == (place, "cubic-spring")
    assert found.is_likely
    assert found.best.residual == pytest.approx(1.0, abs=0.15)
    error = found.best.element.coefficient - element.coefficient
    assert abs(error) < 4.0 * found.best.std["coefficient"] < 0.2 * element.coefficient
    assert found.best.element.coefficient == pytest.approx(element.coefficient, rel=0.05)


def test_stated_noise_is_kept_next_to_noise_that_is_estimated():
    element, dofs, _ = CASES["cubic-spring"]
    low, high = measure(element, dofs)
    stated = (0.02 * np.abs(low.values)) ** 2
    data = LevelData.of(MODEL, [replace(low, variance=stated), high], no_unknowns(), None)
    assert not data.is_noise_stated
    squares = (0.01 * np.abs(data.receptances)) ** 2
    found = data.estimate_noise(squares)
    np.testing.assert_allclose(2.0 / found.errors[0].weight ** 2, stated)
    ratio = 2.0 / found.errors[1].weight ** 2 / (0.01 * np.abs(high.values)) ** 2
    assert 0.8 < np.median(ratio) < 1.3


def test_the_error_of_periodic_responses_is_the_least_noise():
    element, dofs, place = CASES["jenkins"]
    tests = measure(element, dofs, noise={})
    found = updyn.locate_nonlinearity(MODEL, tests, {place: dofs}, ["jenkins"])
    assert found.is_adequate
    assert found.best.residual == pytest.approx(0.4, rel=0.4)
    assert found.best.element.slip_force == pytest.approx(3.0, rel=1e-4)


def test_the_force_of_a_linear_spring_is_its_stiffness():
    true = MODEL.with_elements({"x": (updyn.PolynomialSpring({1: 300.0}), ["4:X", "5:X"])})
    tests = [updyn.response(true, FREQ, SENSORS, ["6:X"], level=level).frf for level in (1.0, 2.0)]
    data = LevelData.of(MODEL, tests, no_unknowns(), NOISE)
    placed = MODEL.with_elements({ELEMENT: (updyn.CubicSpring(1.0), ["4:X", "5:X"])})
    fit = PlaceProblem("x", LocalElements.find(placed, no_unknowns()), data).fit(np.zeros(0))
    assert fit is not None
    assert np.allclose(fit.element.stiffness, 300.0, rtol=1e-5)
    assert np.allclose(fit.element.amplitude[1], 2.0 * fit.element.amplitude[0], rtol=1e-5)
    assert fit.cost < 1e-6


def test_default_places_are_the_connections():
    found = list_places(MODEL)
    assert list(found) == [*(f"{i}:X - {i + 1}:X" for i in range(1, N)), "1:X - ground"]
    assert found["1:X - 2:X"] == ["1:X", "2:X"]


def test_results_are_tables():
    rows = [
        LocationRow("a", "cubic-spring", updyn.CubicSpring(2.0), {"coefficient": 0.1}, {}, 1, *x)
        for x in ((0.0, 1.0, MODEL), (-2.0, 1.1, MODEL), (-9.0, 2.0, MODEL))
    ]
    found = NonlinearityLocation(tuple(rows), {"a": 1.0}, -4.0, 3.0, False)
    table = found.to_pandas()
    assert list(table["place"]) == ["a", "a", "a"]
    assert sum(table["probability"]) == pytest.approx(1.0)
    assert table["probability"][1] == pytest.approx(np.exp(-2.0) * table["probability"][0])
    assert len(found.indistinguishable) == 1
    assert not found.is_likely
    assert "coefficient 2 +- 0.1 N/m^3" in found.summary()
    assert "linear" in found.summary()
    likely = replace(found, linear=-5.0)
    assert likely.is_likely
    assert "times the noise" in likely.statement


@pytest.mark.parametrize(("share", "is_adequate"), [(1.04, True), (1.3, False)])
def test_a_residual_above_the_noise_is_stated(share, is_adequate):
    """The stated noise is smaller than the true one by a factor."""
    element, dofs, _ = CASES["cubic-spring"]
    noise = {name: value / share for name, value in NOISE.items()}
    found = updyn.locate_nonlinearity(
        MODEL, measure(element, dofs), {"joint": dofs}, ["cubic-spring"], noise=noise
    )
    assert found.is_adequate is is_adequate
    assert found.best.residual == pytest.approx(share, rel=0.03)


def test_bounds_of_a_joint_exclude_sliders():
    """An Iwan joint with a large beta is a Jenkins element; chi of joints is not above 0."""
    element, dofs, _ = CASES["jenkins"]
    found = updyn.locate_nonlinearity(
        MODEL, measure(element, dofs), {"joint": dofs}, ["iwan"], noise=NOISE
    )
    joint = found.best.element
    assert joint.beta == pytest.approx(LOCATION.beta_bounds[1]) == 10.0
    assert LOCATION.chi_bounds[0] <= joint.chi <= 0.0
    assert not found.is_adequate


def test_a_large_model_is_reduced(monkeypatch):
    element, dofs, place = CASES["cubic-spring"]
    monkeypatch.setattr("updyn.candidates.location.locate.is_reduced", lambda *_: True)
    tests = measure(element, dofs)
    found = updyn.locate_nonlinearity(MODEL, tests, kinds=["cubic-spring"], noise=NOISE)
    assert found.best.place == place
    assert found.is_adequate
    unknowns = updyn.parameters(MODEL, stiffness="all")
    with pytest.raises(OptionError, match="update it to the lowest level first"):
        updyn.locate_nonlinearity(MODEL, tests, unknowns=unknowns, noise=NOISE)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"tests": 1}, DataError, "two levels or more"),
        ({"kinds": ["cubic"]}, OptionError, "no kind 'cubic'; valid: 'cubic-spring'"),
        ({"kinds": []}, OptionError, "expected at least one"),
        ({"kinds": {"x": 3.0}}, OptionError, "expected a nonlinear element"),
        ({"places": {}}, OptionError, "expected degrees of freedom by name"),
        ({"unknowns": ["left"]}, OptionError, "expected updyn.parameters"),
        ({"places": {"x": ["1:X", "9:X"]}}, updyn.UpdynError, "9:X"),
    ],
)
def test_invalid_input_is_refused(change, error, message):
    tests = [updyn.response(MODEL, FREQ, SENSORS, ["6:X"]).with_level(F) for F in (1.0, 2.0)]
    options = {"places": None, "kinds": None, "unknowns": None, **change}
    tests = tests[: options.pop("tests", 2)]
    with pytest.raises(error, match=message):
        updyn.locate_nonlinearity(MODEL, tests, noise=NOISE, **options)


def test_a_model_with_many_connections_is_refused(monkeypatch):
    few = replace(LOCATION, most_default_places=5)
    monkeypatch.setattr("updyn.candidates.location.places.LOCATION", few)
    with pytest.raises(OptionError, match="has 6 connections; state the places of at most 5"):
        list_places(MODEL)


def test_a_wrong_linear_model_is_no_nonlinearity() -> None:
    """A sticking slider makes up for its stiffness, but the FRFs do not depend on the level."""
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 2.0]])
    labels = ["1:X", "2:X"]
    groups = {"springs": updyn.Group(K, loss_factor=0.03), "masses": updyn.Group(mass=np.eye(2))}
    model = updyn.Model.from_groups(groups, labels)
    stiff = 1e4 * np.array([[2.4, -1.4], [-1.4, 2.4]])
    true = updyn.Model.from_groups(
        groups | {"springs": updyn.Group(stiff, loss_factor=0.03)}, labels
    )
    clean = updyn.response(true, np.linspace(8.0, 40.0, 30), labels, ["2:X"])
    rng = np.random.default_rng(0)

    def repeat(level: float) -> updyn.FRF:
        draw = rng.standard_normal((2, *clean.values.shape)) / np.sqrt(2.0)
        noisy = clean.values * (1.0 + 0.01 * (draw[0] + 1j * draw[1]))
        return replace(clean, values=noisy).with_level(level)

    tests = [repeat(level) for level in (0.5, 2.0)]
    options = {"kinds": ["jenkins", "cubic-spring"], "noise": {"relative": 0.01}}
    found = updyn.locate_nonlinearity(model, tests, **options)
    assert found.linear < -100.0
    assert not found.is_likely
    assert found.statement.endswith("the FRFs do not depend on the level.")
    assert len(updyn.locate_nonlinearities(model, tests, **options)) == 0
