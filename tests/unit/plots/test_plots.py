"""Figures of matplotlib: what is drawn are the numbers of the objects, axes have names and units, nothing is global."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

import updyn
from plants_by_hand import oscillator
from report_case import chain, measured, realistic
from servo_cases import BOTH, NAMES, NOTCHED, quick, two_masses
from updyn import plots
from updyn.control.plant import Plant
from updyn.errors import DataError, OptionError
from updyn.modal import synthesise
from updyn.modal.synthesis import band_of_modes
from updyn.plots import canvas
from updyn.style import PAPER


@pytest.fixture(scope="module")
def data():
    return measured(chain(), n_lines=120)


@pytest.fixture(scope="module")
def correlation(data):
    return updyn.correlate(chain().scaled({"bay 2": {"stiffness": 0.7}}), data)


@pytest.fixture(scope="module")
def modes(data):
    return updyn.identify_modes(measured(chain()))


def labelled(axes):
    return {line.get_label(): line for line in axes.lines if not line.get_label().startswith("_")}


def printed(axes):
    return [text.get_text() for text in axes.texts]


# -- FRFs ------------------------------------------------------------------------------------------
def test_magnitude_phase_and_coherence_are_those_of_the_frf(data):
    one = data.select(responses=["4:Z"], references=["12:Z"])
    figure = plots.frf(one)
    assert isinstance(figure, Figure)
    size, phase, coherence = figure.axes
    np.testing.assert_array_equal(size.lines[0].get_xdata(), one.freq)
    np.testing.assert_allclose(size.lines[0].get_ydata(), np.abs(one.values[:, 0, 0]))
    degrees = phase.lines[0].get_ydata()
    there = np.isfinite(degrees)
    np.testing.assert_allclose(degrees[there], np.degrees(np.angle(one.values[:, 0, 0])))
    np.testing.assert_array_equal(coherence.lines[0].get_ydata(), one.coherence[:, 0, 0])
    assert size.get_ylabel() == "accelerance ((m/s²)/N)"
    assert size.get_yscale() == "log"
    assert phase.get_ylabel() == "phase (°)"
    assert coherence.get_ylabel() == "coherence (–)"
    assert coherence.get_xlabel() == "frequency (Hz)"
    assert list(labelled(size)) == ["4:Z / 12:Z"]


def test_levels_in_db_and_linear(data):
    one = data.select(responses=["4:Z"], references=["12:Z"])
    (axes,) = Figure().subplots(1, squeeze=False).ravel()
    figure = plots.frf(one, level="dB", ax=axes)
    assert figure is axes.figure
    np.testing.assert_allclose(
        axes.lines[0].get_ydata(), 20 * np.log10(np.abs(one.values[:, 0, 0]))
    )
    assert axes.get_ylabel() == "accelerance (dB re 1 (m/s²)/N)"
    size = plots.frf(one, level="linear", log_frequency=True).axes[0]
    assert (size.get_xscale(), size.get_yscale()) == ("log", "linear")
    with pytest.raises(OptionError, match=r"level 'db': .*'dB'"):
        plots.frf(one, level="db")


def test_zeros_are_gaps_of_a_level():
    freq = [1.0, 2.0, 3.0]
    one = updyn.FRF(freq, np.array([1.0, 0.0, 2.0]).reshape(3, 1, 1), ["1:X"], ["1:X"], "mobility")
    drawn = plots.frf(one, level="dB").axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(drawn, [0.0, np.nan, 20 * np.log10(2.0)])


def test_a_zero_has_no_phase():
    values = np.array([1j, 0.0, 0.0, -1j]).reshape(4, 1, 1)
    one = updyn.FRF([1.0, 2.0, 3.0, 4.0], values, ["1:X"], ["1:X"], "mobility")
    phase = plots.frf(one).axes[1].lines[0]
    np.testing.assert_allclose(phase.get_ydata(), [90.0, np.nan, np.nan, -90.0])
    np.testing.assert_array_equal(phase.get_xdata(), one.freq)


def test_a_single_line_is_a_point(data, correlation):
    """Nothing is drawn of a curve through one point."""
    one = data.select(lines=data.freq[40:41])
    for panel in plots.frf(one["4:Z", "12:Z"]).axes:
        assert [line.get_marker() for line in panel.lines] == ["o"]
    computed = correlation.computed.select(lines=data.freq[40:41])
    for panel in plots.overlay(one["4:Z", "12:Z"], computed).axes:
        assert [line.get_marker() for line in panel.lines] == ["o", "o"]
    two = plots.overlay(one["4:Z"], computed, computed).axes[0]
    assert [line.get_marker() for line in two.lines] == ["o", "o", "o"]
    many = plots.frf(data["4:Z", "12:Z"]).axes[0]
    assert [line.get_marker() for line in many.lines] == ["None"]


def test_several_frfs_are_told_apart_and_have_one_quantity(data):
    one = data.select(responses=["4:Z"], references=["12:Z"])
    shown = plots.frf(one, one, labels=["Monday", "Tuesday"], coherence=False)
    assert list(labelled(shown.axes[0])) == ["Monday: 4:Z / 12:Z", "Tuesday: 4:Z / 12:Z"]
    assert len(shown.axes) == 2
    named = dataclasses.replace(one, source="b.uff"), dataclasses.replace(one, source="a.uff")
    assert next(iter(labelled(plots.frf(*named).axes[0]))) == "b.uff: 4:Z / 12:Z"
    with pytest.raises(
        DataError, match=r"found receptance and accelerance; convert.*'accelerance'"
    ):
        plots.frf(one, one.converted("receptance"))
    with pytest.raises(OptionError, match="labels: expected 2"):
        plots.frf(one, one, labels=["Monday"])
    with pytest.raises(DataError, match="at least one FRF"):
        plots.frf()


def test_units_of_translations_and_rotations_stand_both():
    one = updyn.FRF([1.0, 2.0], np.ones((2, 2, 1)), ["1:X", "1:RZ"], ["1:X"], "receptance")
    assert plots.frf(one).axes[0].get_ylabel() == "receptance (m/N, rad/N)"


def test_of_many_curves_the_number_is_told(data):
    many = plots.frf(data, data, labels=["a", "b"]).axes[0]
    assert many.get_legend() is None
    assert many.get_title(loc="left") == "20 curves: response / force"


def test_an_overlay_has_both_in_the_sign_and_quantity_of_the_measured(data):
    one = data.select(responses=["6:-Z"], references=["12:Z"])
    fine = np.linspace(5.0, 400.0, 50)
    model = updyn.response(chain(), fine, ["6:Z", "1:Z"], ["12:Z"], "receptance")
    size, phase = plots.overlay(one, model).axes
    curves = labelled(size)
    assert list(curves) == ["measured", "computed"]
    np.testing.assert_allclose(curves["measured"].get_ydata(), np.abs(one.values[:, 0, 0]))
    expected = -model.converted("accelerance").values[:, 0, 0]
    np.testing.assert_allclose(curves["computed"].get_ydata(), np.abs(expected))
    np.testing.assert_array_equal(curves["computed"].get_xdata(), fine)
    degrees = phase.lines[1].get_ydata()
    np.testing.assert_allclose(degrees[np.isfinite(degrees)], np.degrees(np.angle(expected)))
    assert curves["computed"].get_color() == PAPER["third"]  # neither start nor updated


def test_an_overlay_of_several_channels_has_a_panel_for_each(data, correlation):
    figure = plots.overlay(correlation)
    assert len(figure.axes) == 10
    last = figure.axes[-1]
    assert last.get_title(loc="left") == "response 12:Z, force 12:Z"
    np.testing.assert_allclose(
        labelled(last)["computed"].get_ydata(), np.abs(correlation.computed.values[:, -1, -1])
    )
    two = plots.overlay(data, correlation.computed, data).axes[0]
    assert list(labelled(two)) == ["measured", "start", "updated"]
    with pytest.raises(OptionError, match="3 axes for 10 panels"):
        plots.overlay(correlation, ax=Figure().subplots(3))
    with pytest.raises(DataError, match="at least one computed"):
        plots.overlay(data)


def test_an_overlay_of_too_many_channels_says_how_to_choose():
    labels = [f"{i}:X" for i in range(1, 18)]
    many = updyn.FRF([1.0, 2.0], np.ones((2, 17, 1)), labels, ["1:X"], "receptance")
    with pytest.raises(DataError, match=r'17 channels, expected at most 16.*frf\["1:X", "1:X"\]'):
        plots.overlay(many, many)


# -- maps ------------------------------------------------------------------------------------------
def test_frac_is_the_map_of_the_correlation(correlation):
    axes, bar = plots.frac(correlation).axes
    np.testing.assert_array_equal(axes.collections[0].get_array(), correlation.frac)
    assert axes.collections[0].get_clim() == (0.0, 1.0)
    assert [t.get_text() for t in axes.get_yticklabels()] == ["1:Z", "4:Z", "6:-Z", "9:Z", "12:Z"]
    assert bar.get_ylabel() == "FRAC (–)"
    assert printed(axes)[0] == f"{correlation.frac[0, 0]:.2f}"
    signed = plots.frac(correlation, criterion="frf_correlation").axes[0].collections[0]
    np.testing.assert_array_equal(signed.get_array(), correlation.frf_correlation)
    assert signed.get_clim() == (-1.0, 1.0)
    with pytest.raises(OptionError, match="criterion 'fac'"):
        plots.frac(correlation, criterion="fac")
    with pytest.raises(OptionError, match="expected a Correlation, found str"):
        plots.frac("a")


def test_mac_has_its_values_and_frames_the_pairs(modes):
    found = updyn.correlate(chain(), modes)
    axes, bar = plots.mac(found).axes
    np.testing.assert_array_equal(axes.collections[0].get_array(), found.mac)
    assert len(axes.lines) == len(found.pairs.mac)
    row, column = found.pairs.first[2], found.pairs.second[2]
    frame = axes.lines[2]
    assert (frame.get_xdata().mean() // 1, frame.get_ydata().mean() // 1) == (column, row)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("measured mode (Hz)", "computed mode (Hz)")
    assert bar.get_ylabel() == "MAC (–)"
    own = plots.mac(modes).axes[0].collections[0].get_array()
    np.testing.assert_allclose(np.diag(own), 1.0)
    with pytest.raises(OptionError, match="expected a ModeCorrelation or a ModeSet"):
        plots.mac(chain())


def test_mac_frames_close_modes_together_with_the_mac_of_their_subspace():
    turned = np.eye(4)
    turned[1:3, 1:3] = [[0.6, -0.8], [0.8, 0.6]]
    dofs = ["1:Z", "2:Z", "3:Z", "4:Z"]
    a = updyn.ModeSet([9.0, 20.0, 20.0, 30.0], np.eye(4), dofs)
    found = updyn.correlate(a, updyn.ModeSet([9.0, 20.0, 20.0, 30.0], turned, dofs))
    axes = plots.mac(found).axes[0]
    frames = [(*np.ptp(line.get_xdata(), keepdims=True).round(1), line) for line in axes.lines]
    assert sorted(width for width, _ in frames) == [0.9, 0.9, 1.9]
    (wide,) = (line for width, line in frames if width > 1)
    assert (wide.get_xdata().min(), wide.get_ydata().max()) == pytest.approx((1.03, 2.97))
    (label,) = (text for text in axes.texts if text.get_position() == (2.0, 2.0))
    assert label.get_text() == "1.00"
    assert found.mac[1, 1] == pytest.approx(0.36)  # of single shapes


# -- unknowns --------------------------------------------------------------------------------------
def test_changes_and_intervals_are_those_of_the_result():
    result = realistic()
    (axes,) = plots.parameters(result, level=0.9).axes
    assert axes.get_xlabel() == "change from the start (%)"
    curves = labelled(axes)
    names = [t.get_text() for t in axes.get_yticklabels()]
    expected = {}
    for name, p in zip(names, result.parameters, strict=True):
        assert name.startswith(p.group)
        expected[name] = 100.0 * (result.values[p.name] / p.start - 1.0)
    drawn = {}
    for label in (
        "estimate with its interval",
        "estimate at a bound",
        "not determined by the data",
    ):
        for x, y in zip(*curves[label].get_data(), strict=True):
            drawn[names[int(y)]] = x
    assert drawn == pytest.approx(expected)
    intervals = result.intervals(0.9)
    ends = np.concatenate([np.array(c.get_segments())[:, :, 0] for c in axes.collections])
    wanted = [
        [100.0 * (end / p.start - 1.0) for end in intervals[p.name]]
        for p in result.parameters
        if p.name in intervals
    ]
    np.testing.assert_allclose(np.sort(ends, axis=0), np.sort(wanted, axis=0))
    title = axes.get_legend().get_title().get_text()
    assert title == "90 % intervals"


def test_what_starts_at_zero_is_drawn_in_its_unit():
    result = realistic()
    changed = [
        dataclasses.replace(p, start=0.0, lower=0.0) if p.quantity == "loss_factor" else p
        for p in result.parameters
    ]
    result = dataclasses.replace(result, parameters=type(result.parameters)(tuple(changed)))
    first, second = plots.parameters(result).axes
    assert second.get_xlabel() == "loss factor (–)"
    drawn = labelled(second)["estimate with its interval"].get_xdata()
    wanted = [result.values[p.name] for p in changed if p.quantity == "loss_factor"]
    np.testing.assert_allclose(drawn, wanted)
    assert first.get_xlabel() == "change from the start (%)"
    with pytest.raises(OptionError, match="1 axes for 2 panels"):
        plots.parameters(result, ax=first)
    with pytest.raises(OptionError, match="level 95"):
        plots.parameters(result, level=95)


def test_identifiability_shows_values_combinations_and_correlations():
    result = realistic()
    ident = result.identifiability
    values, null, correlation = plots.identifiability(result).axes[:3]
    drawn = np.concatenate([labelled(values)[k].get_ydata() for k in list(labelled(values))[:2]])
    np.testing.assert_allclose(drawn[: ident.rank], ident.singular_values[: ident.rank])
    assert len(drawn) == ident.n_parameters
    weights = null.collections[0].get_array()
    np.testing.assert_allclose(weights.ravel(), list(ident.null_directions[0].values()))
    assert null.get_xticklabels()[0].get_text() == "bay 5: stiffness"
    matrix = correlation.collections[0].get_array()
    assert matrix.mask.any()  # no number for what is not determined
    known = ~matrix.mask[0]
    covariance = result.covariance
    std = np.sqrt(np.diag(covariance)[known])
    np.testing.assert_allclose(matrix[0][known], covariance[0][known] / std[0] / std)
    alone = plots.identifiability(ident)
    assert alone.axes[0].get_legend().get_title().get_text() == (
        "the data determine 6 of 7 unknowns"
    )
    with pytest.raises(OptionError, match="expected the result of an update, found int"):
        plots.identifiability(3)


# -- modes -----------------------------------------------------------------------------------------
def test_the_diagram_has_every_pole_mode_and_peak(modes, data):
    peaks = dataclasses.replace(modes, unexplained=[3.0, 17.0])
    axes, behind = plots.stabilisation(peaks, data).axes
    curves = labelled(axes)
    diagram = modes.diagram
    for name, chosen in (
        ("pole stable", diagram.stable),
        ("pole new in this order", ~diagram.stable),
    ):
        np.testing.assert_array_equal(curves[name].get_xdata(), diagram.frequency[chosen])
        np.testing.assert_array_equal(curves[name].get_ydata(), diagram.order[chosen])
    np.testing.assert_array_equal(curves["mode"].get_xdata(), modes.frequency)
    np.testing.assert_array_equal(curves["peak without a mode"].get_xdata(), [3.0, 17.0])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("frequency (Hz)", "order (–)")

    # behind it the singular values, on an axis of their own
    accelerance = data.converted("accelerance").values
    expected = np.array([np.linalg.svd(H, compute_uv=False) for H in accelerance])
    for line, values in zip(behind.lines, expected.T, strict=True):
        np.testing.assert_allclose(line.get_ydata(), values)
    assert behind.get_yscale() == "log"
    assert behind.get_ylabel() == "CMIF ((m/s²)/N)"
    assert axes.get_zorder() > behind.get_zorder()
    assert not axes.patch.get_visible()

    given = Figure().subplots()
    plots.stabilisation(modes, ax=given)
    assert given.get_ylabel() == "order (–)"
    assert len(given.figure.axes) == 1
    assert "peak without a mode" not in labelled(given)
    with pytest.raises(OptionError, match=r"no diagram; updyn\.identify_modes"):
        plots.stabilisation(updyn.ModeSet([1.0], [[1.0]], ["1:X"]))


def test_the_synthesised_frf_is_that_of_the_channel_that_agrees_least(modes, data):
    some = modes.select(np.arange(len(modes) - 4))
    computed = synthesise(some, data).values
    inside = band_of_modes(some, data)
    scores = updyn.correlation.frac(data.values[inside], computed[inside])
    i, j = np.unravel_index(np.argmin(scores), scores.shape)
    size, phase = plots.synthesis(some, data).axes
    curves = labelled(size)
    np.testing.assert_allclose(curves["measured"].get_ydata(), np.abs(data.values[:, i, j]))
    np.testing.assert_allclose(curves["synthesised"].get_ydata(), np.abs(computed[:, i, j]))
    assert curves["synthesised"].get_color() == PAPER["after"]
    degrees = phase.lines[1].get_ydata()
    there = np.isfinite(degrees)
    np.testing.assert_allclose(degrees[there], np.degrees(np.angle(computed[:, i, j])))
    title = size.get_legend().get_title().get_text()
    response, force = data.responses.labels[i], data.references.labels[j]
    assert title.startswith(f"response {response}, force {force} (FRAC {scores.min():.3f} from")
    one = plots.synthesis(some, data["4:Z", "12:Z"]).axes[0]
    assert "response 4:Z, force 12:Z (FRAC" in one.get_legend().get_title().get_text()
    with pytest.raises(OptionError, match="expected a ModeSet, found FRF"):
        plots.synthesis(data, data)


# -- plants ----------------------------------------------------------------------------------------
def test_a_bode_diagram_is_the_response_of_the_plant():
    plant = oscillator(error=0.01, band=(0.5, 20.0))
    freq = np.geomspace(0.6, 18.0, 80)
    size, phase = plots.plant(plant, freq).axes
    values = plant.response(freq).values[:, 0, 0]
    curves = labelled(size)
    np.testing.assert_allclose(curves["plant"].get_ydata(), np.abs(values))
    bound = curves["its largest error, 1 % of the peak"].get_ydata()
    np.testing.assert_allclose(bound, 0.01 * np.abs(values).max())
    np.testing.assert_allclose(phase.lines[0].get_ydata(), np.degrees(np.unwrap(np.angle(values))))
    relative = oscillator(relative_error=0.02, band=(0.5, 20.0), facts={"error": "relative"})
    curves = labelled(plots.plant(relative, freq).axes[0])
    bound = curves["its largest error, 2 % of |H|"].get_ydata()
    np.testing.assert_allclose(bound, 0.02 * np.abs(values))
    assert size.get_ylabel().endswith(")")
    assert size.get_xscale() == "log"
    dense = labelled(plots.plant(plant).axes[0])["plant"].get_xdata()
    assert (dense[0], dense[-1]) == pytest.approx((0.5, 20.0))
    assert np.abs(dense - 3.0).min() < 0.02  # the resonance is met


def test_several_channels_have_a_panel_each_and_too_many_are_refused():
    plant = two_masses(band=(0.1, 100.0))
    figure = plots.plant(plant, np.geomspace(0.1, 100.0, 30))
    assert len(figure.axes) == 8
    assert figure.axes[1].get_title(loc="left") == "angle over wind"
    assert figure.axes[2].get_ylabel() == "velocity ((rad/s)/(N m))"
    wide = Plant(
        plant.A, plant.B, np.tile(plant.C, (3, 1)), np.zeros((12, 2)), plant.input_ports,
        plant.output_ports * 3, plant.quantities * 3, (0.1, 10.0), 0.1, 0.0, 0.0, "by hand",
    )  # fmt: skip
    with pytest.raises(DataError, match=r"24 channels.*plant\.channel\('angle', 'motor'\)"):
        plots.plant(wide)


def test_a_loop_has_its_margins_where_they_are_read_off():
    servo = quick(two_masses(), NOTCHED, **BOTH)
    loop = servo.position_loop
    found = loop.margins
    size, phase = plots.plant(servo).axes
    curves = labelled(size)
    np.testing.assert_allclose(curves["position loop"].get_ydata(), loop.magnitude_db)
    margin = next(line for name, line in curves.items() if name.startswith("gain margin"))
    np.testing.assert_allclose(margin.get_xdata(), found.gain_margin_at)
    np.testing.assert_allclose(margin.get_ydata(), [-found.gain_margin_db, 0.0], atol=1e-9)
    bar = phase.lines[-1]
    np.testing.assert_allclose(bar.get_xdata(), found.phase_margin_at)
    np.testing.assert_allclose(np.diff(bar.get_ydata()), found.phase_margin)
    assert bar.get_ydata()[0] == -180.0
    inner = plots.plant(quick(two_masses(), NOTCHED, **NAMES).velocity_loop)
    assert "velocity loop" in labelled(inner.axes[0])
    with pytest.raises(OptionError, match="a loop has its lines already"):
        plots.plant(servo, [1.0])
    with pytest.raises(OptionError, match="found Model"):
        plots.plant(chain())


# -- figures ---------------------------------------------------------------------------------------
def test_axes_of_the_caller_are_used_and_checked(data):
    one = data.select(responses=["4:Z"], references=["12:Z"])
    given = Figure().subplots(2, 3)
    with pytest.raises(OptionError, match=r"6 axes; the figure has 3 panels \(magnitude, phase"):
        plots.frf(one, ax=given)
    with pytest.raises(OptionError, match="expected the axes of a matplotlib figure, found str"):
        plots.frf(one, ax="left")
    plots.frf(one, ax=given[0])
    assert [len(a.lines) for a in given.ravel()] == [1, 1, 1, 0, 0, 0]


def test_a_figure_shows_itself_and_nothing_is_global(data):
    import matplotlib

    before = dict(matplotlib.rcParams)
    figure = plots.frf(data)
    assert figure._repr_png_()[:8] == b"\x89PNG\r\n\x1a\n"
    assert dict(matplotlib.rcParams) == before


def test_pyplot_is_not_loaded_and_matplotlib_only_with_a_figure():
    code = (
        "import sys, updyn; from updyn import plots; assert 'matplotlib' not in sys.modules;"
        "x = updyn.FRF([1.0, 2.0], [[[1]], [[2]]], ['1:X'], ['1:X'], 'receptance');"
        "plots.frf(x); assert 'matplotlib' in sys.modules; print('matplotlib.pyplot' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip() == "False"


def test_without_matplotlib_it_says_how_to_install_it(monkeypatch, data, correlation):
    canvas._figure_class.cache_clear()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    try:
        for draw in (lambda: plots.frf(data), lambda: plots.frac(correlation)):
            with pytest.raises(updyn.UpdynError, match=r'pip install "updyn\[plots\]"'):
                draw()
    finally:
        canvas._figure_class.cache_clear()
