"""What the figures are drawn from, by value."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
from types import SimpleNamespace

import numpy as np
import pytest

import updyn
from overriding import override
from pages_read import Page
from pages_read import values as plotted
from report_case import all_figures, chain, measured, realistic, smallest
from updyn.correlation import csf, fdac
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.report import data as report_data
from updyn.report.agreement import AGREEMENT, csac_lines, csf_lines, fdac_maps, level_difference
from updyn.report.data import gather, keep_lines
from updyn.report.formats import (
    change,
    decibels,
    estimate,
    extent,
    figure_of_agreement,
    format_padded,
    interval,
    number,
    percentage,
    unit,
)
from updyn.report.head import head
from updyn.report.identifiability import correlations
from updyn.report.overlay import overlay
from updyn.report.page import render
from updyn.report.plots import encode_numbers, log_bars, log_range
from updyn.report.provenance import data_checksum, model_checksum
from updyn.report.section import PageContent
from updyn.report.settings import REPORT_COMPUTATION, REPORT_SIZE
from updyn.updating.problem.parameters import Parameter


@pytest.fixture(scope="module")
def result():
    return realistic()


@pytest.fixture(scope="module")
def data(result):
    return gather(result)


def dense(model, freq, responses, references):
    """Accelerance by a dense solve at each line: K (1 + i gamma) - omega^2 M for one loss factor a group."""
    Z0 = (model.stiffness + 1j * model.structural).toarray()
    M = model.mass.toarray()
    rows, columns = model.dofs.match(responses), model.dofs.match(references)
    out = []
    for omega in 2 * np.pi * freq:
        H = np.linalg.solve(Z0 - omega**2 * M, np.eye(len(M)))
        out.append(
            -(omega**2) * H[np.ix_(rows.index, columns.index)] * np.outer(rows.sign, columns.sign)
        )
    return np.array(out)


def test_both_models_at_the_lines_of_the_data(result, data):
    assert np.array_equal(data.freq, result.frf.freq)
    for model, values in ((result.start, data.before), (result.model, data.after)):
        expected = dense(model, data.freq, result.frf.responses, result.frf.references)
        np.testing.assert_allclose(values, expected, rtol=1e-9)


def test_agreement_is_over_the_lines_not_held_out(result, data):
    low, high = result.validation_band
    outside = (data.freq < low) | (data.freq > high)
    assert np.array_equal(data.compared, outside)
    X, A = result.frf.values[outside], data.before[outside]
    frac = np.array(
        [[abs(np.vdot(X[:, i, j], A[:, i, j])) ** 2 / (np.vdot(X[:, i, j], X[:, i, j]).real
          * np.vdot(A[:, i, j], A[:, i, j]).real) for j in range(2)] for i in range(5)]
    )  # fmt: skip
    np.testing.assert_allclose(data.frac_before, frac, rtol=1e-10)
    for when, values in (("before", data.before), ("after", data.after)):
        H, X = values[outside], result.frf.values[outside]
        size = np.linalg.norm(X, axis=0)
        residual = np.linalg.norm(H - X, axis=0) / size
        aligned = np.sum(X.conj() * H, axis=0).real / size / np.linalg.norm(H, axis=0)
        np.testing.assert_allclose(getattr(data, f"residual_{when}"), residual, rtol=1e-10)
        np.testing.assert_allclose(getattr(data, f"correlation_{when}"), aligned, rtol=1e-10)
    assert data.csac_after.shape == data.freq.shape
    assert data.held_out == (False, False, False, True, False)
    assert np.array_equal(data.freq[data.used], result.lines)


def test_curves_are_on_a_grid_with_the_lines_of_the_data_and_resolve_the_resonances(result, data):
    assert set(data.freq) <= set(data.grid)
    for model, curve in (
        (result.start, data.before_curve),
        (result.model, data.after_curve),
    ):
        expected = dense(model, data.grid, result.frf.responses, result.frf.references)
        np.testing.assert_allclose(curve, expected, rtol=1e-8, atol=1e-12)


def test_few_lines_have_curves_with_their_peaks():
    """Twelve lines 35 Hz apart: the curve's peaks are those of a grid a thousand times finer."""
    result = smallest()
    data = gather(result)
    fine = np.linspace(data.freq[0], data.freq[-1], 20_001)
    H = dense(result.model, fine, result.frf.responses, result.frf.references)
    assert len(data.grid) < 1500
    assert np.abs(data.after_curve).max() == pytest.approx(np.abs(H).max(), rel=0.01)
    assert np.abs(data.after).max() < 0.9 * np.abs(H).max()


def test_a_model_that_is_singular_between_the_lines_has_curves_through_them(result, monkeypatch):
    at_resonance = float(np.sqrt(2e6 / 1.5) / 2 / np.pi)  # of one mass, without damping
    start = chain(1)
    start = start.with_damping({"bay 1": {"loss_factor": 0.0}})
    frf = measured(start, n_lines=10, responses=["1:Z"], references=["1:Z"], coherence=False)
    monkeypatch.setattr(
        report_data, "fine_grid", lambda *_, **__: np.union1d(frf.freq, at_resonance)
    )
    found = gather(
        dataclasses.replace(smallest(), start=start, model=start, data=frf, lines=frf.freq)
    )
    assert np.array_equal(found.grid, frf.freq)
    assert found.notes == ()
    assert np.isfinite(found.after_curve).all()


def test_one_channel_has_no_csac():
    assert gather(smallest()).csac_after is None


def test_zero_hertz_is_left_out_and_said(result):
    from updyn.frf import FRF

    old = result.frf
    frf = FRF(
        np.r_[0.0, old.freq],
        np.r_[np.ones((1, 5, 2)), old.values],
        old.responses,
        old.references,
        "accelerance",
    )
    found = gather(dataclasses.replace(result, data=frf))
    assert found.freq[0] == old.freq[0]
    assert "The line at 0 Hz is not drawn." in found.notes


def test_models_are_computed_at_fewer_lines_above_the_budget(result, monkeypatch):
    override(monkeypatch, REPORT_COMPUTATION, evaluation_budget=12 * 200)
    found = gather(result)
    assert len(found.freq) <= 200
    assert set(found.freq) <= set(result.frf.freq)
    assert f"{len(found.freq)} of the 800 measured lines" in found.notes[0]


def test_lines_with_known_frfs_are_not_computed_again(monkeypatch):
    model = chain(3)
    frf = measured(model, n_lines=20, responses=["1:Z", "2:Z"], references=["1:Z"], coherence=False)
    known = updyn.response(model, frf.freq[3:], ["1:Z", "2:Z"], ["1:Z"], "accelerance")
    known = dataclasses.replace(known, values=7.0 * known.values)
    freq = np.union1d(frf.freq, [frf.freq[5] + 0.01, frf.freq[-1] + 1.0])
    solved = []
    solve = report_data.respond_as_measured
    monkeypatch.setattr(
        report_data,
        "respond_as_measured",
        lambda model, frf, freq, **how: (solved.append(freq), solve(model, frf, freq, **how))[1],
    )
    values = report_data.compute_frfs(model, frf, freq, "model", [], {}, known)
    expected = dense(model, freq, frf.responses, frf.references)
    expected[np.isin(freq, known.freq)] *= 7.0
    np.testing.assert_allclose(values, expected, rtol=1e-8)
    assert np.array_equal(solved, [freq[~np.isin(freq, known.freq)]])
    report_data.compute_frfs(model, frf, known.freq, "model", [], {}, known)
    assert len(solved) == 1


@pytest.mark.parametrize("n_lines", [1599, 1600])
def test_a_reduced_model_is_not_drawn_on_more_lines_than_an_even_grid_would_have(n_lines):
    freq = np.linspace(1.0, 20.0, n_lines)
    grid = report_data.fine_grid([chain(1)], freq, reduced=True)
    assert (len(grid) > n_lines) == (n_lines < 1600)


def test_of_a_stopped_run_no_reduced_model_is_built(result, monkeypatch):
    """Its error would have to be certified while the user waits."""
    stopped = dataclasses.replace(result, status="stopped")
    assert gather(stopped).after_curve is not None
    reduced = dataclasses.replace(stopped, options={**result.options, "tier": "reduced"})
    monkeypatch.setattr(report_data, "compute_frfs", None)  # would fail if it were called
    found = gather(reduced)
    assert found.before is found.after_curve is found.frac_after is None
    assert found.notes[-1].startswith("The models are not drawn: the run was stopped")


def test_thinning_keeps_ends_and_sharp_peaks():
    n = 4001
    level = np.ones(n)
    level[[1003, 2777]] = 50.0, 1e-3  # a resonance and an antiresonance of one line each
    kept = keep_lines(level[:, None, None].astype(complex), np.zeros(n, dtype=bool), 100)
    assert len(kept) <= 100
    assert {0, 1003, 2777, n - 1} <= set(kept.tolist())
    assert np.all(np.diff(kept) > 0)
    assert np.array_equal(
        keep_lines(level[:50, None, None].astype(complex), np.ones(50, dtype=bool), 100),
        np.arange(50),
    )


def test_overlay_arrays_hold_the_data_channel_by_channel(result, data):
    drawn, note = overlay(data)
    assert note == ""
    assert np.array_equal(np.frombuffer(base64.b64decode(drawn["freq"]), "<f8"), data.freq)
    assert np.array_equal(np.frombuffer(base64.b64decode(drawn["grid"]), "<f8"), data.grid)
    for name, values in (
        ("measured", data.measured),
        ("before", data.before_curve),
        ("after", data.after_curve),
    ):
        found = np.frombuffer(base64.b64decode(drawn[name]), "<f4").reshape(5, 2, -1, 2)
        np.testing.assert_allclose(
            found[3, 1, :, 0] + 1j * found[3, 1, :, 1], values[:, 3, 1], rtol=1e-6, atol=1e-9
        )
    assert drawn["everyLineUsed"] is False
    np.testing.assert_array_equal(data.freq[drawn["used"]], result.lines)
    thin, note = overlay(data, budget=int(200 * 10 * 12 / REPORT_SIZE.measured_share))
    kept = np.frombuffer(base64.b64decode(thin["freq"]), "<f8")
    assert len(kept) <= 200
    assert len(np.frombuffer(base64.b64decode(thin["grid"]), "<f8")) <= 200
    assert f"{len(kept)} of 800 lines are drawn" in note


def test_correlations_are_blank_where_nothing_is_determined():
    covariance = np.array([[4.0, 1.0, np.inf], [1.0, 1.0, np.inf], [np.inf, np.inf, np.inf]])
    found = correlations(covariance)
    np.testing.assert_allclose(found[:2, :2], [[1.0, 0.5], [0.5, 1.0]])
    assert np.isnan(found[2]).all()
    assert np.isnan(found[:, 2]).all()


def test_level_differences_by_value():
    X = np.array([3.0, 4.0]).reshape(2, 1, 1).astype(complex)
    A = 1j * X
    np.testing.assert_allclose(level_difference(X, 10 * A), [20.0, 20.0])
    assert level_difference(X, 0 * A).size == 0


def test_every_figure_is_there_and_finite(result, data):
    figures = all_figures(result)
    assert set(figures) == {
        "changes", "worst-channel", "median-channel", "frf-correlation-before", "frf-correlation-after", "csac", "csf",
        "singular-values", "combinations", "correlation", "cost", "factor-paths", "loss-factor-paths", "level-differences",
        "residual-by-channel", "misfit-map",
        "fdac-before", "fdac-after", "mac-start", "mac-updated", "auto-mac", "cross-orthogonality", "comac",
    }  # fmt: skip
    np.testing.assert_allclose(
        figures["frf-correlation-after"]["data"][0]["z"], data.correlation_after
    )
    assert figures["correlation"]["data"][0]["z"][2][2] is None  # mass of bay 5 is open
    shares = [
        np.sum(encode_numbers(t["y"], packed=False)) for t in figures["level-differences"]["data"]
    ]
    np.testing.assert_allclose(shares, 100.0)


def test_csf_by_line_sees_the_level(data):
    start, updated = csf_lines(data)["data"]
    for trace, values in ((start, data.before), (updated, data.after)):
        np.testing.assert_allclose(plotted(trace["y"]), csf(data.measured, values), atol=6e-4)
    twice = dataclasses.replace(data, after=2.0 * data.measured)
    # 2 * 2 / (1 + 4), where CSAC is 1.
    np.testing.assert_allclose(plotted(csf_lines(twice)["data"][1]["y"]), 0.8, atol=6e-4)


def test_fdac_maps_have_the_ridge_where_the_lines_are_alike(data):
    for when, values in (("before", data.before), ("after", data.after)):
        heat, diagonal, ridge = fdac_maps(data)[f"fdac-{when}"]["data"]
        at = np.searchsorted(data.freq, heat["x"])
        np.testing.assert_allclose(data.freq[at], heat["x"])
        expected = fdac(data.measured[at], values[at])
        z = plotted(heat["z"])
        np.testing.assert_allclose(z.reshape(expected.shape), expected, atol=6e-4)
        assert diagonal["x"] == diagonal["y"]
        for x, y in zip(ridge["x"], ridge["y"], strict=True):
            column = expected[:, heat["x"].index(x)]
            assert column[heat["x"].index(y)] == column.max() >= 0.8
    # Updated, each line is most like itself or the one beside it.
    apart = np.abs(np.array(ridge["x"]) - ridge["y"])
    assert np.median(apart) <= np.median(np.diff(data.freq))


def test_intervals():
    stiffness = Parameter("a", "stiffness", 1.0, 0.1, 10.0)
    low, high = interval(stiffness, 2.0, 0.2)
    assert low * high == pytest.approx(4.0)  # symmetric in the logarithm
    assert np.log(high / 2.0) == pytest.approx(1.959964 * 0.1)
    assert interval(stiffness, 2.0, np.inf) is None
    loss = Parameter("a", "loss_factor", 0.01, 0.0, 1.0)
    assert interval(loss, 0.01, 0.01) == pytest.approx((0.0, 0.01 + 1.959964 * 0.01))


def test_numbers_in_words():
    assert [estimate(1.00001, 0.0019), estimate(12.3456, 0.51), estimate(0.72, np.inf)] == [
        "1.0000",
        "12.35",
        "0.72",
    ]
    assert number(-0.00001234) == "−1.234·10⁻⁵"
    assert number(np.inf) == "∞"
    assert number(np.nan) == "–"
    assert [figure_of_agreement(v) for v in (0.5, 0.9944, 0.9996, 1.0)] == [
        "0.50",
        "0.994",
        ">0.999",
        "1.00",
    ]
    assert [figure_of_agreement(v) for v in (-0.001, -0.98)] == ["0.00", "−0.98"]
    shares = [0.0, 1e-9, 0.0213, 1.67, np.inf]
    assert [percentage(v) for v in shares] == ["0 %", "<0.0001 %", "2.1 %", "167 %", "∞ %"]
    assert percentage(np.nan) == "–"
    assert [percentage(v) for v in (9.99, 10.0, 160.4, 46059.0)] == [
        "999 %",
        "10 times",
        "160 times",
        "46059 times",
    ]
    assert decibels(0.213) == "0.21 dB"
    assert change(Parameter("a", "mass", 1.0, 0.1, 9.0), 1.234) == "+23.4 %"
    viscous = Parameter("a", "viscous", 1.0, 0.01, 100.0)
    assert [change(viscous, v) for v in (0.04, 10.96, 34.5)] == ["−96 %", "×11", "×34.5"]
    assert change(Parameter("a", "loss_factor", 0.0, 0.0, 1.0), 0.02) == "from 0 to 0.02"
    assert change(viscous, np.nan) == "–"  # of a failed fit
    assert unit("receptance", "1:Z", "2:Z") == "m/N"


def test_the_extent_of_a_single_line_is_where_it_is(result):
    one = result.frf.select(lines=result.frf.freq[10:11])
    assert extent(one) == f"5 responses × 2 references, 1 line at {number(one.freq[0])} Hz"
    two = result.frf.select(lines=result.frf.freq[:2])
    assert extent(two).endswith(f", 2 lines from 4 to {number(two.freq[1])} Hz")
    shape = np.ones((1, 1))
    assert extent(ModeSet([12.5], shape, ["1:Z"])) == "1 mode at 1 DOF, 12.5 Hz"


def test_figures_of_agreement_in_the_table_are_numbers_or_a_dash(result):
    figures = {"frac_median": 0.99995, "residual_median": 7.77e-14, "residual_max": np.inf}
    worse = {"frac_median": np.nan, "residual_median": 0.5, "residual_max": 2.0}
    found = dataclasses.replace(result, correlation={"before": worse, "after": figures})
    shown = AGREEMENT.context(PageContent(found))["scores"]
    assert shown == [
        ("frac_median", "–", ">0.9999"),
        ("residual_median", "0.5", "7.77·10⁻¹⁴"),
        ("residual_max", "2", "∞"),
    ]


def test_figures_over_channels_of_several_units_are_said_to_be_so(result):
    said = "The channels have several units."
    assert said not in Page(render(result)).words
    model = result.start
    turned = Model.from_groups(model.groups, ["1:RX", *model.dofs.labels[1:]])
    frf = dataclasses.replace(result.frf, responses=["1:RX", *result.frf.responses.labels[1:]])
    odd = dataclasses.replace(result, start=turned, model=turned, data=frf)
    assert said in Page(render(odd)).words


def test_units_of_channels():
    assert unit("receptance", "1:Z", "2:Z") == "m/N"
    assert unit("mobility", "1:RX", "2:RZ") == "(rad/s)/(N m)"


def test_key_figures_say_when_they_got_worse(result):
    worse = {"before": {"frac_median": 0.9}, "after": {"frac_median": 0.4}, "validation": {}}
    content = PageContent(result)
    assert "0.90 → 0.40 worse than the start" in Page(head(content, worse)[0]).words
    better = {"before": {"frac_median": 0.4}, "after": {"frac_median": 0.9}, "validation": {}}
    assert "worse" not in Page(head(content, better)[0]).words
    assert "FRAC" not in Page(head(content, {})[0]).words
    rounding = {"before": {"frac_median": 1.0 - 1e-9}, "after": {"frac_median": 1.0 - 2e-9}}
    assert ">0.999 → >0.999 start → updated" in Page(head(content, rounding)[0]).words


def test_checksums_see_every_part(result):
    frf = result.frf
    text = "\n".join([frf.quantity, *frf.responses.labels, *frf.references.labels]).encode()
    assert (
        data_checksum(frf)
        == hashlib.sha256(text + frf.freq.tobytes() + frf.values.tobytes()).hexdigest()
    )
    start = chain(3)
    seen = {
        model_checksum(m)
        for m in (
            start,
            start.scaled({"bay 1": {"stiffness": 1.0 + 1e-12}}),
            start.scaled({"bay 1": {"mass": 1.1}}),
            start.scaled({"bay 2": {"mass": 1.1}}),
            start.scaled({"bay 1": {"loss_factor": 0.011}}),
        )
    }
    assert len(seen) == 5
    assert model_checksum(start) == model_checksum(chain(3, title="same numbers"))


def test_numbers_of_a_column_keep_their_zeros():
    assert [format_padded(v, 5) for v in (10.63, 172.6, 1376.7, None)] == [
        "10.630",
        "172.60",
        "1376.7",
        "–",
    ]
    assert [format_padded(v, 3) for v in (0.03, -0.002, 12.0, 1e-7)] == [
        "0.0300",
        "−0.00200",
        "12.0",
        "1·10⁻⁷",
    ]
    assert decibels(2e-13) == "<0.0001 dB"


def test_marks_of_a_logarithmic_axis_do_not_crowd():
    """Over more than half a decade 2 and 5 are enough, however wide the margins make it."""
    assert log_range([0.067, 2.3])["dtick"] == "D2"
    assert log_range([1.0, 2.0])["dtick"] == "D1"
    assert log_range([1e-9, 1.0], decades=18.0)["dtick"] == 2
    for lowest in (1e-14, 1e-7, 0.01, 0.2):
        axis = log_bars({"a": lowest, "b": 18.0}, "misfit (dB)")["layout"]["xaxis"]
        step = axis["dtick"] if isinstance(axis["dtick"], int) else 1
        assert 1.9 < np.ptp(axis["range"]) / step < 4.1


def test_criteria_have_a_gap_where_both_sides_are_zero():
    """Accelerances at 0 Hz agree on nothing."""
    values = np.ones((4, 2, 1), dtype=complex)
    values[0] = 0.0
    csac = np.array([0.0, 1.0, 1.0, 1.0])
    data = SimpleNamespace(
        measured=values,
        before=values,
        after=None,
        freq=np.arange(4.0),
        csac_before=csac,
        csac_after=None,
    )
    for made in (csac_lines(data), csf_lines(data)):
        (trace,) = made["data"]
        assert trace["y"] == [None, 1.0, 1.0, 1.0]
