"""Objects in notebooks: well-formed HTML with the objects' numbers; nothing is loaded, run or left unescaped."""

from __future__ import annotations

import dataclasses
import json
import re
from xml.etree import ElementTree

import numpy as np
import pytest

import updyn
from overriding import override
from plants_by_hand import oscillator
from report_case import chain, measured, realistic
from servo_cases import two_masses
from updyn import notebook
from updyn.geometry import Geometry
from updyn.remedy import Remedy
from updyn.settings import NOTEBOOK
from updyn.style import PAPER
from updyn.updating.judge.causes.finding import Finding, Findings
from updyn.updating.judge.claim import PARTS, Claim
from updyn.updating.judge.trust import Trust

#: Objects that are shown as tables alone.
PLAIN = {"correlation", "mode correlation", "modes", "findings"}
HOSTILE = '<script>alert("1")</script> & <img src=x onerror=y>'


def placed(model, n):
    at = np.c_[0.3 * np.arange(n), np.zeros(n), np.zeros(n)]
    return dataclasses.replace(
        model, geometry=Geometry(range(1, n + 1), at, [(i, i + 1) for i in range(1, n)])
    )


@pytest.fixture(scope="module")
def data():
    return measured(chain(), n_lines=120)


def objects(data):
    result = realistic()
    modes = updyn.ModeSet([10.0, 20.0], np.eye(2), ["1:X", "2:X"], [0.02, 0.04])
    return {
        "FRF": data,
        "channel": data["4:Z", "12:Z"],
        "ModeSet": modes,
        "result": result,
        "joint": updyn.JointResult({"a": result, "b": result}, "Both"),
        "Plant": oscillator(band=(0.5, 20.0)),
        "correlation": updyn.correlate(chain(), data),
        "mode correlation": updyn.correlate(chain(), updyn.modes(chain(), 4)),
        "modes": updyn.modes(chain(), 4),
        "findings": Findings(
            [Finding("sign", ("1:Z",), 0.0, 1e9, 1.0, "Wrong.", Remedy("Turn it."))]
        ),
    }


def tree(shown):
    return ElementTree.fromstring(shown._repr_html_())


def text(shown):
    return " ".join("".join(tree(shown).itertext()).split())


def cells(shown):
    rows = [[("".join(c.itertext())) for c in row] for row in tree(shown).iter("tr")]
    return rows[0], rows[1:]


def paths(shown):
    found = tree(shown).iter("{http://www.w3.org/2000/svg}path")
    return [np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", p.get("d")), dtype=float) for p in found]


# -- all -------------------------------------------------------------------------------------------
def test_all_are_well_formed_small_and_load_nothing(data):
    for name, shown in objects(data).items():
        page = shown._repr_html_()
        tree(shown)
        assert len(page) < 60_000, name
        assert "<svg" in page or name in PLAIN, name
        assert not re.search(r"<script|<link|<iframe|<img|url\(|\bon\w+=", page), name
        assert set(re.findall(r'https?://[^"\s]+', page)) <= {"http://www.w3.org/2000/svg"}
        # The ground of a table is that of the notebook, light or dark.
        assert not re.search(r"<(table|tr|td|th|div)[^>]*(background|color)", page), name


def test_names_are_escaped(data):
    one = dataclasses.replace(data, source=HOSTILE)
    model = dataclasses.replace(chain(n=2), title=HOSTILE)
    renamed = updyn.Model({"<b>hub</b>": model.groups["bay 1"]}, model.dofs, title=HOSTILE)
    result = dataclasses.replace(realistic(), title=HOSTILE, message=HOSTILE)
    modes = updyn.ModeSet([10.0], [[1.0]], ["1:X"], source=HOSTILE)
    for shown in (one, model, renamed, result, updyn.JointResult({"": result}, HOSTILE), modes):
        page = shown._repr_html_()
        assert "<script" not in page
        assert "<img" not in page
        assert "&lt;script&gt;" in page
        tree(shown)
    assert "<b>hub</b>" not in renamed._repr_html_()
    assert cells(renamed)[1][0][0] == "<b>hub</b>"


# -- each ------------------------------------------------------------------------------------------
def test_the_curve_of_a_channel_is_that_of_the_frf(data):
    one = data["4:Z", "12:Z"]
    (drawn,) = paths(one)
    level = np.log10(np.abs(one.values[:, 0, 0]))
    assert len(drawn) == len(one.freq)
    for axis, values in ((0, one.freq), (1, level)):
        slope = np.polyfit(values, drawn[:, axis], 1)
        np.testing.assert_allclose(np.polyval(slope, values), drawn[:, axis], atol=0.06)
        assert (slope[0] > 0) == (axis == 0)
    assert "accelerance ((m/s²)/N): 4:Z / 12:Z" in text(one)
    assert "lines 120 from 4 to 420 Hz" in text(one)


def test_of_many_channels_the_rms_is_drawn(data):
    (drawn,) = paths(data)
    rms = np.log10(np.sqrt(np.mean(np.abs(data.values) ** 2, axis=(1, 2))))
    slope = np.polyfit(rms, drawn[:, 1], 1)
    np.testing.assert_allclose(np.polyval(slope, rms), drawn[:, 1], atol=0.06)
    assert "rms of 10 channels" in text(data)


def test_no_peak_of_a_long_curve_is_lost():
    y = np.ones(20_000)
    y[12_345] = 1e3
    page = notebook.curves(np.arange(20_000.0), [notebook.PlotCurve("a", y)], ("x (s)", "y (m)"))
    points = np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", re.search(r' d="([^"]+)"', page)[1]))
    heights = points.astype(float)[:, 1]
    assert len(heights) <= 1200
    assert (heights < heights.max() - 100).sum() == 1


def test_a_curve_has_gaps_and_an_empty_one_is_none():
    x, titles = np.arange(4.0), ("x (s)", "y (m)")
    page = notebook.curves(x, [notebook.PlotCurve("a", [1.0, 0.0, 2.0, 3.0])], titles)
    assert re.search(r' d="([^"]+)"', page)[1].count("M") == 2
    assert notebook.curves(x, [notebook.PlotCurve("a", np.zeros(4))], titles) == ""
    assert notebook.curves(x, [], titles) == ""


def test_a_model_shows_its_groups_and_its_lines(monkeypatch):
    monkeypatch.setattr(notebook.VIEWERS, "_entries", {})
    model = placed(chain(n=3), 3)
    header, rows = cells(model)
    assert header == ["group", "has", "damping"]
    assert rows[0] == ["bay 1", "stiffness, mass", "loss factor 0.01"]
    (drawn,) = paths(model)
    assert len(drawn) == 4  # two lines
    np.testing.assert_allclose(drawn[1], drawn[2])
    steps = drawn[1] - drawn[0], drawn[3] - drawn[2]
    np.testing.assert_allclose(*steps, atol=0.11)
    assert "<svg" not in chain(n=2)._repr_html_()


def test_a_large_structure_says_what_is_left_out():
    n = 7000
    xyz = np.c_[np.arange(n), np.zeros(n), np.zeros(n)]
    ends = np.c_[np.arange(n - 1), np.arange(1, n)]
    page = notebook.structure(xyz, ends)
    assert "every 3th line" not in page
    assert "one of 3 lines" in page
    assert page.count("M") == -(-(n - 1) // 3)
    assert "one of 3 nodes" in notebook.structure(xyz, np.empty((0, 2)))
    assert notebook.structure(np.empty((0, 3)), np.empty((0, 2))) == ""


def test_modes_show_what_is_known_of_them():
    modes = updyn.ModeSet([10.0, 20.0], np.eye(2), ["1:X", "2:X"], [0.02, 0.04])
    header, rows = cells(modes)
    assert header == ["mode", "frequency (Hz)", "damping (%)", "collinearity"]
    assert rows == [["1", "10", "1", "1.000"], ["2", "20", "2", "1.000"]]
    bare = updyn.ModeSet([10.0], [[1.0]], ["1:X"])
    assert "<svg" not in bare._repr_html_()
    assert cells(bare)[0] == ["mode", "frequency (Hz)", "collinearity"]


def test_a_result_shows_its_verdict_values_and_intervals():
    result = realistic()
    header, rows = cells(result)
    assert header[0] == "unknown"
    low, high = result.intervals()["bay 11.mass"]
    shown = {row[0]: row for row in rows}
    assert result.std["bay 11.mass"] == pytest.approx(0.029, abs=5e-4)  # two digits of that
    assert shown["bay 11.mass"][2] == f"{result.values['bay 11.mass']:.3f}"
    assert shown["bay 11.mass"][4] == f"{low:.3f} to {high:.3f}"
    assert shown["bay 5.mass"][2] == f"{result.values['bay 5.mass']:.5g}"
    assert shown["bay 5.mass"][5] == "not determined by the data"
    assert shown["bay 8.stiffness"][5] == "at its lower bound"
    page = result._repr_html_()
    assert f"background:{PAPER['warn-ground']}" in page
    assert ">Not all unknowns determined</span>" in page
    assert "determined 6 of 7 unknowns" in text(result)
    assert "tests 2" in text(updyn.JointResult({"a": result, "b": result}))


@pytest.mark.parametrize(
    ("change", "phrase", "ground"),
    [
        ({"status": "converged"}, "Usable", "good-ground"),
        ({"validated": Claim(False, "It is off.")}, "Does not predict", "bad-ground"),
        ({"plausible": Claim(False, "It is off.")}, "Not credible", "bad-ground"),
        ({"validated": Claim(None, "", asked=False)}, "Fits, not validated", "warn-ground"),
    ],
)
def test_the_mark_of_a_result_is_its_verdict(change, phrase, ground):
    """Of fits that all converged."""
    claims = {name: Claim(True, "It holds.") for name in PARTS}
    trust = Trust(**(claims | {k: v for k, v in change.items() if k != "status"}))
    result = dataclasses.replace(realistic(), status="converged", trust=trust)
    page = result._repr_html_()
    assert f">{phrase}</span>" in page
    assert f"background:{PAPER[ground]}" in page
    assert ">converged<" not in page
    joint = updyn.JointResult({"a": result, "b": result})._repr_html_()
    assert f">{phrase}</span>" in joint


def test_a_result_without_notes_has_no_column_of_them():
    result = realistic()
    (p,) = result.parameters[:1]
    alone = dataclasses.replace(result, parameters=type(result.parameters)((p,)))
    assert cells(alone)[0] == ["unknown", "start", "value", "std. dev.", "95 % interval"]


def tables(shown):
    """Header and rows of each table."""
    found = []
    for one in tree(shown).iter("table"):
        rows = [["".join(cell.itertext()) for cell in row] for row in one.iter("tr")]
        found.append((rows[0], rows[1:]))
    return found


def test_a_correlation_of_frfs_shows_its_figures_and_responses(data):
    found = updyn.correlate(chain(), data)
    (_, figures), (header, responses) = tables(found)
    shown = dict(figures)
    assert float(shown["level difference, median (dB)"]) == pytest.approx(
        np.median(np.abs(found.db_error)), rel=5e-3
    )
    assert float(shown["FRAC, worst channel"]) == pytest.approx(found.frac.min(), abs=1e-4)
    assert [row[0] for row in responses] == list(data.responses.labels)
    worst = header.index("residual") + 1
    assert float(responses[1][worst]) == pytest.approx(found.relative_residual[1].max(), rel=5e-3)
    assert "lines 120 from 4 to 420 Hz" in text(found)


def at_sensors(model):
    found = updyn.modes(model, 2)
    return 1.02 * found.frequency, found.at(["1:Z", "3:Z"]), ["1:Z", "3:Z"]


def test_a_correlation_of_modes_shows_its_table():
    model = chain(n=3)
    found = updyn.correlate(model, updyn.ModeSet(*at_sensors(model)))
    ((header, rows),) = tables(found)
    assert header[-1] == "MAC"
    lines = found.table().splitlines()
    assert [" ".join(row) for row in rows] == [" ".join(line.split()) for line in lines[1:]]
    assert f"pairs {len(found.pairs.mac)}" in text(found)
    alone = updyn.correlate(model, updyn.ModeSet(updyn.modes(model, 2).frequency))
    assert "The measured modes have no shapes" in text(alone)


def test_modes_of_a_model_show_frequencies_and_loss_factors():
    found = updyn.modes(chain(n=3), 3)
    ((header, rows),) = tables(found)
    assert header == ["mode", "frequency (Hz)", "loss factor"]
    assert [float(row[1]) for row in rows] == pytest.approx(list(found.frequency), rel=1e-5)
    assert [float(row[2]) for row in rows] == pytest.approx(list(found.loss_factor), rel=1e-3)


@pytest.mark.parametrize(
    ("odds", "words"), [(250.0, "2.5e+02 to 1"), (9e5, "9e+05 to 1"), (1e300, "> 1e+06 to 1")]
)
def test_findings_show_cause_and_remedy(odds, words):
    one = Finding("swapped", ("1:Z", "2:Z"), 0.0, odds, 0.97, HOSTILE, Remedy("Check this."))
    found = Findings([one, dataclasses.replace(one, channels=())])
    ((header, rows),) = tables(found)
    assert header == ["cause", "channels", "odds", "explains", "statement", "remedy"]
    assert rows[0] == ["swapped", "1:Z, 2:Z", words, "97 %", HOSTILE, "Check this."]
    assert rows[1][1] == "all"
    assert "<script" not in found._repr_html_()
    assert "<table" not in Findings()._repr_html_()
    assert "found 0" in text(Findings())


def test_a_diagnosis_is_a_tuple_that_a_notebook_shows():
    model = chain(n=3)
    clean = measured(model, n_lines=40, responses=["1:Z", "2:Z", "3:Z"], references=["3:Z"])
    turned = dataclasses.replace(clean, values=clean.values * np.array([1, -1, 1])[:, None])
    found = updyn.diagnose(model, turned)
    assert isinstance(found, tuple)
    assert found[0].kind == "sign"
    ((_, rows),) = tables(found)
    assert rows[0][:2] == ["sign", "2:Z"]


@pytest.mark.parametrize(
    ("x", "log", "marks"),
    [
        ([3.0, 40.0], True, ["5", "10", "20"]),
        ([0.01, 1e4], True, ["0.01", "1", "100", "1e4"]),
        ([30.0, 40.0], True, ["30", "35", "40"]),
        ([0.0, 400.0], False, ["0", "100", "200", "300", "400"]),
    ],
)
def test_marks_are_round(x, log, marks):
    page = notebook.curves(x, [notebook.PlotCurve("a", [1.0, 1.0])], ("x", "y"), log_x=log)
    assert re.findall(r'text-anchor="middle"[^>]*>([^<]+)<', page) == marks


def test_long_tables_say_what_is_left_out():
    page = notebook.table(("a", "b"), [[str(i), "x"] for i in range(25)])
    assert "... and 5 more" in page
    assert page.count("<tr>") == 22
    assert notebook.table(("a",), []) == ""


def test_a_plant_shows_ports_error_and_response():
    plant = two_masses(band=(0.5, 50.0), error=0.012)
    header, rows = cells(plant)
    assert header == ["", "name", "unit"]
    assert ["input", "motor", "N m"] in rows
    assert ["output", "speed", "rad/s"] in rows
    assert "largest error 1.2 % of the peak" in text(plant)
    relative = two_masses(band=(0.5, 50.0), error=0.012, relative_error=0.03)
    assert "largest error 3 % of |H| at each line, 1.2 % of the peak" in text(relative)
    assert len(paths(plant)) == 8
    sampled = updyn.sampled(oscillator(band=(0.5, 20.0)), 0.02)
    assert "sampled every 0.02 s" in text(sampled)


# -- viewer ----------------------------------------------------------------------------------------
def test_a_model_with_a_geometry_is_shown_in_the_viewer():
    """In a frame without rights, which is all there: the data of the page are those of the model."""
    model = placed(dataclasses.replace(chain(n=3), title=HOSTILE), 3)
    (frame,) = tree(model).iter("iframe")
    assert frame.get("sandbox") == "allow-scripts allow-downloads"
    page = frame.get("srcdoc")
    assert "default-src 'none'" in page
    assert "updynViewer.start()" in page
    assert HOSTILE not in page
    scene = json.loads(re.search(r'<script type="application/json"[^>]*>(.*?)</script>', page)[1])
    assert scene["bodies"][0]["groups"] == list(model.groups)
    assert cells(model)[1][0][0] == "bay 1"


def test_a_very_large_model_keeps_its_still_picture(monkeypatch):
    override(monkeypatch, NOTEBOOK, viewer_nodes=2)
    page = placed(chain(n=3), 3)._repr_html_()
    assert "<svg" in page
    assert "<iframe" not in page


def test_a_registered_viewer_takes_the_place_of_the_picture(monkeypatch):
    monkeypatch.setattr(notebook.VIEWERS, "_entries", {"Model": lambda m: f"<p>{m.n_dofs}</p>"})
    page = placed(chain(n=3), 3)._repr_html_()
    assert "<p>3</p>" in page
    assert "<svg" not in page
    assert "bay 1" in page


@pytest.mark.parametrize(
    ("n", "hidden"), [(20, ""), (21, "... and 1 more"), (40, "... and 20 more")]
)
def test_a_table_has_twenty_rows(n, hidden):
    found = notebook.table(["name"], [["row"]] * n)
    assert found.count(">row<") == min(n, 20)
    assert hidden in found
    assert ("more" in found) is bool(hidden)


@pytest.mark.parametrize(("n", "drawn"), [(1200, 1200), (1201, 1200), (3000, 1200)])
def test_a_long_curve_keeps_two_points_of_each_of_600_bins(n, drawn):
    x = np.arange(float(n))
    path = notebook._path(x, np.where(np.arange(n) % 2, 1.0, -1.0), 0.0)
    assert path.count("M") + path.count("L") == drawn


@pytest.mark.parametrize(("n", "named"), [(6, 6), (7, 6)])
def test_a_legend_names_six_curves(n, named):
    found = notebook._legend([f"curve {i}" for i in range(n)])
    assert found.count("curve") == named
    assert ("... 1 more" in found) is (n > 6)
