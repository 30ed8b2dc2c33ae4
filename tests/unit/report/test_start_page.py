"""The page before any fit: what it shows is what the library gives, and it is drawn in a browser."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest

import updyn
from pages_read import Page, attributes, dump, unfolded
from report_case import realistic
from updyn.correlation.figures import FIGURE_NAMES
from updyn.correlation.model_modes import ModelModes
from updyn.correlation.modes import correlate_modes
from updyn.model import Group, Model
from updyn.remedy import Remedy
from updyn.report import Start, write_start
from updyn.report.before import choose_first_step
from updyn.report.identifiability import combinations_map, singular_values
from updyn.report.mode_axes import mode_axes
from updyn.report.verdict import count_all_modes
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.counterparts import Counterparts
from updyn.updating.modes import compare_start_modes, frequency_sensitivities
from updyn.updating.problem.data import Test
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.update import start_analysis
from viewer_case import block

SENSORS = ["5:Z", "20:-Y", "10:Z"]
NOISE = {"relative": 0.02}


@pytest.fixture(scope="module")
def start():
    """A block of solids that is off by a fifth in one half, measured without noise."""
    model = block((4, 1, 1))
    model = model.scaled({name: {"loss_factor": 0.03} for name in model.groups})
    freq = np.linspace(200.0, 3000.0, 113)
    true = model.scaled({"right": {"stiffness": 0.8}})
    frf = updyn.response(true, freq, SENSORS, ["5:Z"], "accelerance")
    unknowns = updyn.parameters(model, stiffness="all", loss_factor=["left"])
    found = start_analysis([Test(model, frf, "", None, NOISE)], unknowns)
    return Start(
        model, frf, unknowns, found.report, found.covariance, title="Block <b>", lines=freq
    )


@pytest.fixture(scope="module")
def html(start, tmp_path_factory):
    path = write_start(start, tmp_path_factory.mktemp("start") / "check.html")
    return path.read_text(encoding="utf-8")


def embedded(html, name):
    found = re.search(
        rf'<script type="application/json" id="{name}">(.*?)</script>', html, re.DOTALL
    )
    return json.loads(found[1])


def test_sections_of_the_start_and_no_others(html):
    page = Page(html)
    assert page.open == []
    anchors = [a["id"] for a in page.of("section")]
    assert anchors == [
        *("verdict", "next-step", "evidence"),
        *("viewer", "structure", "modes", "channels", "all-channels", "unknowns"),
        *("frfs", "agreement", "identifiability"),
    ]
    assert "updated" not in page.words.replace("not updated", "")
    assert "<b>" not in html.split("<body>")[1].split("<script")[0].split("</h1>")[0]


def test_key_figures_are_those_of_correlate(start, html):
    found = updyn.correlate(start.model, start.data).figures()
    tiles = dict(re.findall(r"<dt>([^<]*)</dt><dd>([^<]*)<small>", html))
    assert float(tiles["FRAC, median"]) == pytest.approx(found["frac_median"], abs=0.005)
    assert float(tiles["FRF correlation, worst"].replace("\u2212", "-")) == pytest.approx(
        found["correlation_min"], abs=0.005
    )
    share = float(tiles["Relative residual, median"].removesuffix(" %"))
    assert share == pytest.approx(100 * found["residual_median"], rel=0.05)
    level = float(tiles["Level difference, median"].removesuffix(" dB"))
    assert level == pytest.approx(found["db_error_median"], rel=0.05)
    assert set(FIGURE_NAMES) >= set(found)


def test_every_channel_is_embedded_measured_and_of_the_start(start, html):
    data = embedded(html, "updyn-frf")
    assert data["after"] is None
    values = np.frombuffer(base64.b64decode(data["measured"]), "<c8").reshape(3, 1, -1)
    np.testing.assert_allclose(values, start.data.values.transpose(1, 2, 0), rtol=1e-6)
    grid = np.frombuffer(base64.b64decode(data["grid"]), "<f8")
    curve = np.frombuffer(base64.b64decode(data["before"]), "<c8").reshape(3, 1, -1)
    expected = updyn.response(start.model, grid, SENSORS, ["5:Z"], "accelerance").values
    np.testing.assert_allclose(curve, expected.transpose(1, 2, 0), rtol=1e-5, atol=1e-9)


def test_expected_deviations_are_those_of_differences(start, html):
    """Cramer-Rao bound with a Jacobian by central differences of whole responses."""

    def responses(left, right, loss):
        model = start.model.scaled(
            {"left": {"stiffness": left, "loss_factor": loss}, "right": {"stiffness": right}}
        )
        return updyn.response(model, start.data.freq, SENSORS, ["5:Z"], "accelerance").values

    at = np.array([1.0, 1.0, 0.03])
    H = responses(*at)
    std = NOISE["relative"] * np.abs(H) / np.sqrt(2.0)  # of the real and of the imaginary part
    columns = []
    for k in range(3):
        step = np.zeros(3)
        step[k] = 1e-5
        slope = (responses(*(at + step)) - responses(*(at - step))) / 2e-5 / std
        columns.append(np.concatenate([slope.real.ravel(), slope.imag.ravel()]))
    J = np.array(columns).T
    names = ["left.stiffness", "right.stiffness", "left.loss_factor"]
    order = [names.index(name) for name in start.parameters.names]
    expected = np.sqrt(np.diag(np.linalg.solve(J.T @ J, np.eye(3))))[order]
    np.testing.assert_allclose(np.sqrt(np.diag(start.covariance)), expected, rtol=1e-4)
    section = html[html.index('<section id="unknowns"') :]
    cells = re.findall(r"<td>\u00b1([\d.]+)( %)?</td>", section[: section.index("</section>")])
    shown = [float(value) / (100 if percent else 1) for value, percent in cells]
    np.testing.assert_allclose(shown, expected, rtol=0.06)  # two digits are shown


def test_the_viewer_shows_start_and_test(html):
    scene = embedded(html, "updyn-scene")
    layers = [(layer["name"], layer["style"]) for layer in scene["modes"]["layers"]]
    assert layers == [("start", "surface"), ("test", "dots")]
    assert [layer["name"] for layer in scene["operating"]["references"][0]["layers"]] == [
        "measured",
        "start",
    ]
    assert [one["name"] for one in scene["colourings"]] == ["Strain energy of the mode"]


def test_undetermined_combinations_are_a_matrix():
    ident = realistic().identifiability
    figure = combinations_map(ident)
    (trace,) = figure["data"]
    assert trace["x"] == [f"combination {i + 1}" for i in range(len(ident.null_directions))]
    z = np.array(trace["z"], dtype=float)
    for column, weights in zip(z.T, ident.null_directions, strict=True):
        assert sorted(column[np.isfinite(column)]) == sorted(weights.values())
    assert combinations_map(replace(ident, null_directions=[])) is None


def test_a_combination_is_blank_where_it_has_no_weight_and_small_weights_are_no_zeros():
    directions = [{"a.mass": 1.0, "b.mass": -0.0031}, {"c.mass": 1.0}]
    (trace,) = combinations_map(replace(realistic().identifiability, null_directions=directions))[
        "data"
    ]
    assert trace["z"] == [[1.0, None], [-0.0031, None], [None, 1.0]]
    assert trace["text"] == [["1", ""], ["−0.0031", ""], ["", "1"]]


def test_singular_values_are_marked_at_their_numbers_only():
    ident = replace(realistic().identifiability, singular_values=tuple(np.geomspace(2, 0.1, 20)))
    axis = singular_values(ident)["layout"]["xaxis"]
    assert axis["range"] == [0.4, 20.6]
    assert axis["dtick"] == 1


def test_one_combination_of_one_unknown_is_said_so(start, tmp_path):
    said = write_start(
        replace(start, identifiability=replace(start.identifiability, rank=1, n_parameters=2)),
        tmp_path / "check.html",
    ).read_text(encoding="utf-8")
    assert "The data can determine 1 independent combination of 2 unknowns." in said


@pytest.mark.needs("browser")
def test_the_page_is_drawn(start, tmp_path):
    path = write_start(start, tmp_path / "check.html")
    found = attributes(dump(unfolded(path), tmp_path / "profile"))
    assert "errors" not in found, found["errors"]
    assert int(found["drawn"]) > 10


def finding(kind: str, statement: str) -> Finding:
    return Finding(kind, ("20:Y",), 0.0, 1e9, 0.9, statement, Remedy("What to do."))


@pytest.mark.parametrize(
    ("found", "badge", "parts"),
    [
        (["sign"], "Look at the data first", {"Data sound": "no"}),
        (
            ["missing-mode"],
            "Look at the model first",
            {"Model sound": "no", "Data sound": "yes"},
        ),
        (
            ["wrong-axes", "sign"],
            "Look at the model first",
            {"Model sound": "no", "Data sound": "no"},
        ),
    ],
)
def test_an_error_of_the_model_is_not_one_of_the_data(start, tmp_path, found, badge, parts):
    findings = tuple(finding(kind, f"It is {kind}.") for kind in found)
    path = write_start(replace(start, findings=findings), tmp_path / "check.html")
    text = Page(path.read_text(encoding="utf-8")).words
    assert badge in text
    for part in ("Model sound", "Data sound"):
        assert (f"{part} {parts[part]}" in text) if part in parts else part not in text
    for kind in found:
        assert f"It is {kind}." in text


def test_sensitivities_are_those_of_differences(start):
    """Natural frequencies of the whole model with one unknown changed, by central differences."""
    frequency = updyn.modes(start.model, 12).frequency[6:]  # without rigid-body modes
    found = frequency_sensitivities(
        ModelModes(start.model), start.parameters, start.data, frequency
    )
    step = 1e-4
    for k, name in enumerate(start.parameters.names):
        group, _, quantity = name.rpartition(".")
        if quantity == "loss_factor":
            assert not found[:, k].any()
            continue
        ends = []
        for factor in (1.0 + step, 1.0 - step):
            model = start.model.scaled({group: {quantity: factor}})
            ends.append(np.log(updyn.modes(model, 12).frequency[6:]))
        expected = (ends[0] - ends[1]) / (2.0 * step)
        np.testing.assert_allclose(found[:, k], expected, rtol=1e-4, atol=1e-6)


def test_sensitivities_count_from_the_start_of_the_unknowns():
    """A mass on a spring: the frequency rises by half of the stiffness, whatever its start."""
    K, M = np.array([[400.0]]), np.array([[1.0]])
    model = Model.from_groups(
        {"spring": Group(stiffness=K, loss_factor=0.1), "mass": Group(mass=M)}, ["1:X"]
    )
    unknowns = updyn.parameters(model, stiffness=["spring"], mass=["mass"])
    unknowns = ParameterSet(tuple(replace(p, start=1.5) for p in unknowns))
    data = updyn.response(model, [1.0, 2.0, 3.0], ["1:X"], ["1:X"])
    found = frequency_sensitivities(
        ModelModes(unknowns.at_start(model)), unknowns, data, np.array([3.0])
    )
    expected = [0.5 if p.quantity == "stiffness" else -0.5 for p in unknowns]
    np.testing.assert_allclose(found, [expected], rtol=1e-12)


def test_the_map_has_the_most_sensitive_unknowns(start, html):
    figure = embedded(html, "updyn-figures")["overview-sensitivities"]
    (trace,) = figure["data"]
    assert figure["layout"]["yaxis"]["ticktext"] == ["left: stiffness", "right: stiffness"]
    np.testing.assert_allclose(np.sum(trace["z"], axis=0), 0.5, rtol=1e-9)  # energies of all parts


def test_axes_of_modes_join_the_pairs(start, html):
    figure = embedded(html, "updyn-figures")["overview-modes-start"]
    found = compare_start_modes(ModelModes(start.model), start.data).correlations["start"]
    drawn = [trace for trace in figure["data"] if trace["name"].startswith("MAC ")]
    pairs = sorted(pair for trace in drawn for pair in zip(trace["x"][::3], trace["x"][1::3], strict=True))  # fmt: skip
    first, second, mac = found.pairs
    expected = zip(found.measured.frequency[second], found.computed.frequency[first], strict=True)
    np.testing.assert_allclose(pairs, sorted(expected))
    high = [trace for trace in drawn if trace["name"] == "MAC 0.9 or more"]
    assert sum(len(trace["x"]) for trace in high) == 3 * np.count_nonzero(mac >= 0.9)
    ticks = [trace for trace in figure["data"] if trace["name"].startswith("test")]
    at = sorted({x for trace in ticks for x in trace["x"]})
    assert at == pytest.approx(sorted(found.measured.frequency))


def test_the_next_step_before_a_fit(start):
    step = choose_first_step(start)
    assert step.lines == ("updyn run job.toml",)
    named = replace(start, job="block.toml")
    assert choose_first_step(named).lines == ("updyn run block.toml",)
    swapped = replace(finding("swapped", "They are exchanged."), step=read_fault("swapped:5:Z,10:Z").remedy)  # fmt: skip
    assert choose_first_step(replace(start, findings=(swapped,))).lines == ('repair = ["swapped:5:Z,10:Z"]',)  # fmt: skip
    other = replace(finding("no-support", "It is held."), step=Remedy("Check the supports."))
    step = choose_first_step(replace(start, findings=(other,)))
    assert (step.advice, step.lines) == ("Check the supports.", ("updyn check job.toml",))
    few = replace(start.identifiability, rank=1, n_parameters=2)
    assert choose_first_step(replace(start, identifiability=few)).lines[0] == "[plan]"


def test_pairs_are_drawn_by_their_mac():
    """Shapes at angles whose squared cosines are 0.91, 0.89 and 0.69."""
    angles = np.arccos(np.sqrt([0.91, 0.89, 0.69]))
    shapes = np.zeros((6, 3))
    for k, angle in enumerate(angles):
        shapes[2 * k : 2 * k + 2, k] = np.cos(angle), np.sin(angle)
    dofs = [f"{i}:Z" for i in range(1, 7)]
    computed = updyn.ModeSet([10.0, 20.0, 30.0], np.eye(6)[:, ::2], dofs)
    test = updyn.ModeSet([10.1, 20.1, 30.1], shapes, dofs)
    found = correlate_modes(computed, test)
    np.testing.assert_allclose(found.pairs.mac, [0.91, 0.89, 0.69])
    drawn = {trace["name"]: trace["x"][:2] for trace in mode_axes(found, "start")["data"]}
    assert drawn["MAC 0.9 or more"] == [10.1, 10.0]
    assert drawn["MAC 0.7 or more"] == [20.1, 20.0]
    assert drawn["MAC below 0.7"] == [30.1, 30.0]


def test_modes_that_are_no_peaks_are_counted():
    """Of two measured modes, the model lacks the second; peaks showed the first alone."""
    dofs = ["1:Z", "2:Z", "3:Z"]
    found = correlate_modes(
        updyn.ModeSet([10.0], np.eye(3)[:, :1], dofs),
        updyn.ModeSet([10.1, 25.0], np.eye(3)[:, :2], dofs),
    )
    peaks = Counterparts(1, 1, (), "1 of 1 peaks.", known=True, n_sensors=3, source="peaks")
    said = " Of all 2 modes identified from the test, 1 have one in the model."
    assert count_all_modes(peaks, found, "model") == said
    assert count_all_modes(replace(peaks, source="identified"), found, "model") == ""
    assert count_all_modes(None, found, "model") == count_all_modes(peaks, None, "model") == ""
