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


def test_kinds_that_start_at_zero_have_a_figure_in_their_unit(result):
    """The others are in that of the changes in percent."""
    figures = all_figures(result)
    assert {"mass-dampings", "stiffness-dampings"} <= figures.keys()
    assert not {"factors", "calibrations"} & figures.keys()
    title = figures["mass-dampings"]["layout"]["xaxis"]["title"]["text"]
    assert title == "mass damping (1/s)"
    ticks = figures["changes"]["layout"]["yaxis"]["ticktext"]
    assert {"<b>stiffness</b>", "part1", "<b>calibration factor</b>", "5:X"} == set(ticks)
    assert (
        figures["stiffness-damping-paths"]["layout"]["yaxis"]["title"]["text"]
        == "stiffness damping (s)"
    )


def test_the_model_is_shown_as_the_sensors_read_it(result):
    data = gather(result)
    assert result.values["5:X.calibration"] == pytest.approx(1.2, rel=1e-4)
    assert data.after == pytest.approx(data.measured, rel=2e-3)
    assert any("times the calibration factors of the sensors" in note for note in data.notes)


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
