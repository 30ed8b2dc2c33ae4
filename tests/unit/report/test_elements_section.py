"""Nonlinear elements in the report, by closed forms, other solutions of the model, and updates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.dynamics.periodic.settings import LINE_BALANCE
from updyn.report.data import fine_grid
from updyn.report.element_motion import describe_element, find_units, follow_loop
from updyn.report.elements import ELEMENTS
from updyn.report.section import PageContent
from updyn.report.settings import REPORT_COMPUTATION
from updyn.updating.level_model import LevelModel

ENDS = ["1:X", "2:X"]
FREQ = np.linspace(7.0, 14.0, 22)
NOISE = {"relative": 0.01, "floor": 0.001}
LEVELS = (0.5, 2.0, 5.0)
STIFFNESS, SLIP = 4e3, 2.0


def make_model(*elements: object) -> updyn.Model:
    """Two masses on springs, with elements between them."""
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.0]])
    groups = {"springs": updyn.Group(K, loss_factor=0.03), "masses": updyn.Group(mass=np.eye(2))}
    model = updyn.Model.from_groups(groups, ENDS)
    return model.with_elements({f"joint {i}": (one, ENDS) for i, one in enumerate(elements)})


def measure(model: updyn.Model, level: float, seed: int) -> updyn.FRF:
    frf = updyn.response(model, FREQ, ENDS, ["2:X"], level=level).frf
    draw = np.random.default_rng(seed).standard_normal((2, *frf.values.shape))
    size = np.sqrt((0.01 * np.abs(frf.values)) ** 2 + 1e-6 * np.mean(np.abs(frf.values) ** 2))
    return replace(frf, values=frf.values + size * (draw[0] + 1j * draw[1]) / np.sqrt(2.0))


@pytest.fixture(scope="module")
def result() -> updyn.JointResult:
    model = make_model(updyn.JenkinsElement(STIFFNESS, SLIP))
    data = [measure(model, F, seed) for seed, F in enumerate(LEVELS)]
    start = make_model(updyn.JenkinsElement(6e3, 1.0))
    unknowns = updyn.parameters(start, stiffness=["springs"], nonlinear="all")
    return updyn.update(start, data, unknowns, noise=NOISE, starts=0)


@pytest.fixture(scope="module")
def content(result: updyn.JointResult) -> PageContent:
    return PageContent(result)


@pytest.fixture(scope="module")
def figures(content: PageContent) -> dict:
    return ELEMENTS.figures(content)


def describe_jenkins(k: float, F: float, A: np.ndarray) -> np.ndarray:
    """Return the closed form of Griffin (1980)."""
    share = np.minimum(F / (k * A), 1.0)
    b = np.arccos(1.0 - 2.0 * share)
    return k / np.pi * (b - 0.5 * np.sin(2.0 * b)) + 4j * F / (np.pi * A) * (1.0 - share)


def test_a_residual_of_noise_is_not_said_to_be_none(result) -> None:
    assert "not noise" not in str(result.trust.plausible.why)
    assert {one.adequacy.outcome for one in result.results.values()} == {"noise"}


def test_amplitudes_are_those_of_the_response(content, result) -> None:
    motions, notes = content.motions
    assert notes == ()
    assert [one.test for one in motions] == [f"level {F:g} N up" for F in LEVELS]
    for one, level in zip(motions, LEVELS, strict=True):
        found = updyn.response(result.first.model, FREQ, ENDS, ["2:X"], level=level)
        across = np.abs(found.harmonics[:, 1, 0, 0] - found.harmonics[:, 1, 1, 0])
        assert one.amplitude == pytest.approx(across.max(), rel=1e-3)
        assert one.freq == FREQ[across.argmax()]


def test_stiffness_and_loss_are_those_of_the_closed_form(figures, result, content) -> None:
    traces = figures["element-0-stiffness"]["data"]
    k, F = (result.values[f"joint 0.{name}"] for name in ("stiffness", "slip_force"))
    curves = [one for one in traces if one.get("name") == "updated element"]
    A = np.array(curves[0]["x"])
    wanted = describe_jenkins(k, F, A)
    np.testing.assert_allclose(curves[0]["y"], wanted.real, rtol=1e-4, atol=1e-4 * k)
    np.testing.assert_allclose(curves[1]["y"], wanted.imag, rtol=1e-4, atol=2e-4 * k)
    reached = [one.amplitude for one in content.motions[0]]
    assert A[0] == pytest.approx(min(reached) / 3.0)
    assert A[-1] == pytest.approx(max(reached) * 3.0)
    for axis, part in (("y", "real"), ("y2", "imag")):
        marks = [one for one in traces if one["mode"] == "markers" and one["yaxis"] == axis]
        assert [one["x"] for one in marks] == [[a] for a in reached]
        values = [one["y"][0] for one in marks]
        closed = getattr(describe_jenkins(k, F, np.array(reached)), part)
        np.testing.assert_allclose(values, closed, atol=0.01 * k)


def test_bands_are_those_of_draws_of_the_parameters(result) -> None:
    A = np.array([1e-4, 8e-4, 3e-3])
    found = describe_element(result.first, "joint 0", A, 10.0)
    names = list(result.values)
    at = [names.index(f"joint 0.{name}") for name in ("stiffness", "slip_force")]
    mean = [result.values[names[i]] for i in at]
    covariance = result.first.covariance[np.ix_(at, at)]
    draws = np.random.default_rng(1).multivariate_normal(mean, covariance, 4000)
    drawn = np.array([describe_jenkins(k, F, A) for k, F in draws])
    for half, part in ((found.real_half, drawn.real), (found.imaginary_half, drawn.imag)):
        np.testing.assert_allclose(half, 1.96 * part.std(axis=0), rtol=0.05, atol=1e-6 * STIFFNESS)


def test_an_undetermined_parameter_leaves_no_band() -> None:
    model = make_model(updyn.JenkinsElement(STIFFNESS, SLIP))
    unknowns = updyn.parameters(model, stiffness=["springs"], nonlinear="all")
    low = updyn.update(model, measure(model, 0.02, 0), unknowns, noise=NOISE, starts=0)
    assert np.isinf(low.std["joint 0.slip_force"])
    sticks = describe_element(low, "joint 0", np.array([1e-5]), 10.0)
    assert sticks.real_half[0] == pytest.approx(1.96 * low.std["joint 0.stiffness"], rel=1e-3)
    slips = describe_element(low, "joint 0", np.array([1e-2]), 10.0)
    assert slips.real_half is None
    assert slips.undetermined == ("joint 0.slip_force",)
    context = ELEMENTS.context(PageContent(low))
    assert len(context["rows"]) == 1
    known = updyn.parameters(model, stiffness=["springs"])
    known = updyn.update(model, measure(model, 0.5, 0), known, noise=NOISE, starts=0)
    assert describe_element(known, "joint 0", np.array([1e-3]), 10.0).real_half is None
    (shown,) = ELEMENTS.context(PageContent(known))["elements"]
    assert "no parameter of the element is unknown" in shown[2]


def test_a_random_test_has_the_sine_of_its_standard_deviations() -> None:
    model = make_model(updyn.CubicSpring(3e9))
    options = {"level": 2.0, "excitation": "random"}
    found = updyn.response(model, FREQ, ENDS, ["2:X"], **options)
    unknowns = updyn.parameters(model, stiffness=["springs"])
    result = updyn.update(model, found.frf, unknowns, noise=NOISE, starts=0)
    (motion,), notes = PageContent(result).motions
    assert notes == ()
    sigma, sigma_v = found.deformation[0, 0], found.velocity[0, 0]
    assert motion.amplitude == pytest.approx(np.sqrt(2.0) * sigma, rel=1e-3)
    assert motion.freq == pytest.approx(sigma_v / sigma / (2.0 * np.pi), rel=1e-3)
    context = ELEMENTS.context(PageContent(result))
    assert "under a random force that of the sine" in context["elements"][0][2]
    assert context["rows"][0][-1] == "0"  # without a loss


def test_the_loop_dissipates_the_work_of_the_slider(result, figures, content) -> None:
    k, F = (result.values[f"joint 0.{name}"] for name in ("stiffness", "slip_force"))
    A = max(one.amplitude for one in content.motions[0])
    largest = figures["element-0-loop"]["data"][0]
    assert largest["name"] == "level 5 N up"
    u, force = follow_loop(result.first.model.nonlinear["joint 0"], A, 10.0)
    assert u.max() == pytest.approx(A)
    work = float(np.abs(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(u))))
    assert work == pytest.approx(4.0 * F * (A - F / k), rel=1e-3)


def test_the_worst_channel_is_drawn_at_all_levels(figures, content, result) -> None:
    residuals = {}
    for name, one in content.single_tests.items():
        for i, label in enumerate(ENDS):
            residuals[name, label] = one.data.residual_after[i, 0]
    _, label = max(residuals, key=residuals.get)
    assert ELEMENTS.context(content)["channel"].startswith(f"{label} / 2:X")
    traces = figures["levels-frfs"]["data"]
    fitted = [one for one in traces if one["mode"] == "lines"]
    assert [one["name"] for one in fitted] == list(result.results)
    assert len({one["line"]["color"] for one in fitted}) == 3
    points = [one for one in traces if one["mode"] == "markers"]
    data = result.results["level 2 N up"].data
    at = np.isin(FREQ, points[1]["x"])
    assert points[1]["y"] == np.abs(data.values[at, ENDS.index(label), 0]).tolist()


def test_computed_frfs_are_those_of_the_response(result) -> None:
    one = result.results["level 2 N up"]
    found = updyn.response(one.model, FREQ, ENDS, ["2:X"], level=2.0)
    for options in ({}, {"tier": "reduced", "accuracy": 1e-8}):
        model = LevelModel.of(one.model, one.data, FREQ, options)
        np.testing.assert_allclose(model.responses(), found.values, rtol=3e-3)
    between = LevelModel.of(one.model, one.data, FREQ[:-1] + 0.05, {}).responses()
    fine = updyn.response(one.model, FREQ[:-1] + 0.05, ENDS, ["2:X"], level=2.0)
    np.testing.assert_allclose(between, fine.values, rtol=3e-3)
    at_rest = LevelModel.of(one.model, one.data.with_level(None), FREQ, {})
    assert at_rest.motions() == []
    linear = updyn.response(one.model.linearised(), FREQ, ENDS, ["2:X"])
    np.testing.assert_allclose(at_rest.responses(), linear.values, rtol=1e-9)


def test_harmonics_count_as_lines_of_a_page() -> None:
    n = 400
    K = 1e4 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    groups = {"chain": updyn.Group(K), "masses": updyn.Group(mass=np.eye(n))}
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])
    freq = np.linspace(0.01, 0.02, 5)  # below the first mode
    cubic = model.with_elements({"stop": (updyn.CubicSpring(1.0), "1:X")})
    wanted = REPORT_COMPUTATION.grid_budget // n // 4
    harmonics = LINE_BALANCE.harmonics + 1
    assert len(fine_grid([model], freq, reduced=False)) == pytest.approx(wanted, abs=len(freq))
    few = fine_grid([cubic], freq, reduced=False)
    assert len(few) == pytest.approx(wanted // harmonics, abs=len(freq))


def test_units_follow_from_the_degrees_of_freedom() -> None:
    def unit(weights: object) -> str:
        groups = {"all": updyn.Group(np.eye(3), mass=np.eye(3))}
        model = updyn.Model.from_groups(groups, ["1:X", "1:RZ", "2:RZ"])
        model = model.with_elements({"e": (updyn.CubicSpring(1.0), weights)})
        return find_units(model.nonlinear["e"]).stiffness

    assert unit("1:X") == "N/m"
    assert unit(["1:RZ", "2:RZ"]) == "N m/rad"
    assert unit({"1:RZ": 0.05, "2:RZ": -0.02}) == "N/m or N m/rad"


def test_pages_show_elements_and_unknowns_that_start_at_zero(tmp_path) -> None:
    model = make_model(updyn.Backlash(STIFFNESS, 4e-4), updyn.CubicSpring(1e8))
    unknowns = updyn.parameters(
        model,
        stiffness=["springs"],
        nonlinear=["joint 0.offset", "joint 1.coefficient"],
        bounds={"joint 0.offset": (-3e-4, 3e-4)},
    )
    result = updyn.update(model, measure(model, 2.0, 0), unknowns, noise=NOISE, starts=0)
    page = updyn.write_report(result, tmp_path / "report.html").read_text(encoding="utf-8")
    for name in ("levels-frfs", "element-0-stiffness", "element-1-loop", "offsets", "offset-paths"):
        assert f'data-figure="{name}"' in page
    assert "could not be computed" not in page.split('id="modes"')[0]
    # Elastic elements have no loss.
    figures = ELEMENTS.figures(PageContent(result))
    assert "yaxis2" not in figures["element-1-stiffness"]["layout"]


def test_linear_updates_have_no_such_section() -> None:
    model = replace(make_model(updyn.CubicSpring(1.0)), nonlinear={})
    frf = updyn.response(model, FREQ, ENDS, ["2:X"])
    unknowns = updyn.parameters(model, stiffness=["springs"])
    result = updyn.update(model, frf, unknowns, noise=NOISE, starts=0)
    assert not ELEMENTS.applies(PageContent(result))
