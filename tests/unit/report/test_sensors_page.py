"""The report of a run with unknowns of the sensors and with Rayleigh damping."""

import numpy as np
import pytest

import updyn
from report_case import all_figures
from updyn.demos import chain
from updyn.report.data import gather
from updyn.report.page import render


@pytest.fixture(scope="module")
def result():
    model = chain.build()
    true = {"part1": {"stiffness": 1.1, "mass_damping": 2.0}, "part3": {"stiffness_damping": 3e-3}}
    frf = updyn.response(
        model.scaled(true),
        np.linspace(0.5, 20.0, 60),
        ["2:X", "5:X", "10:X"],
        ["12:X"],
        "accelerance",
    )
    values = frf.values.copy()
    values[:, 1] *= 1.2
    frf = updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)
    unknowns = updyn.parameters(
        model, stiffness="part1", mass_damping="part1", stiffness_damping="part3"
    )
    unknowns = unknowns + updyn.calibration(frf, responses=["5:X"])
    return updyn.update(model, frf, unknowns, method="log")


def test_each_kind_of_unknown_has_its_own_figure(result):
    figures = all_figures(result)
    assert {"factors", "mass-dampings", "stiffness-dampings", "calibrations"} <= figures.keys()
    assert "loss-factors" not in figures
    title = {
        name: figures[name]["layout"]["xaxis"]["title"]["text"]
        for name in ("mass-dampings", "calibrations")
    }
    assert title == {
        "mass-dampings": "mass damping (1/s)",
        "calibrations": "value relative to the start (log scale)",
    }
    assert (
        figures["stiffness-damping-paths"]["layout"]["yaxis"]["title"]["text"]
        == "stiffness damping (s)"
    )


def test_the_model_is_shown_as_the_sensors_read_it(result):
    data = gather(result)
    assert result.values["5:X.calibration"] == pytest.approx(1.2, rel=1e-4)
    assert data.after == pytest.approx(data.measured, rel=2e-3)
    assert any("times their calibration factors" in note for note in data.notes)


def test_calibration_stands_under_its_own_head(result):
    html = render(result)
    unknowns = html[html.index("<h2>Unknowns</h2>") :]
    table, calibration = unknowns.split("<h3>Calibration of the sensors</h3>")[:2]
    assert "calibration factor" not in table[: table.index("</table>")]
    assert "5:X" in calibration[: calibration.index("</table>")]
    assert "mass damping (1/s)" in table
    summary = result.summary()
    assert "times their calibration factors" in summary
    assert "in 1/s" in summary
