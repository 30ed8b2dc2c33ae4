"""The sections on plant and servo: what they draw is what model, plant and loop answer; escapes; in a real browser."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import control
import numpy as np
import pytest

import updyn
from pages_read import attributes, dump, values
from updyn.cli.layout import fit_text
from updyn.control.antiresonances import ZeroShift
from updyn.control.job.messages import (
    brief_plant_result,
    describe_plant_result,
    name_plant_outcome,
)
from updyn.control.job.plant_result import make_plant, resolving_lines
from updyn.control.job.record import control_record, servo_record
from updyn.control.report.page import render, write_plant_page
from updyn.control.report.plant import judge_plant, share
from updyn.control.servo.controller import Controller, Notch
from updyn.job import load_job, prepare
from updyn.report.page import render as render_update
from updyn.report.plots import log_frequency, phases, thin_indices
from updyn.report.section import PageContent, select_sections

JOB = """title = "Azimuth <b>'\\"& 1</b>"
[model]
file = "m.h5"
[test]
file = "t.npz"
[[parameter]]
groups = ["shaft", "rim"]
quantity = "stiffness"
[method]
starts = 0
noise = { relative = 0.1 }
[plant]
inputs = [{ name = "M<i>", dof = "1:RZ" }, { name = "wind", dof = "3:RZ" }]
outputs = [{ name = "speed", dof = "1:RZ" }, { name = "dish", dof = "3:RZ" }]
quantity = ["mobility", "receptance"]
band = [1.0, 90.0]
family = 4
seed = 3
sampling = { dt = 0.0005, delay = 0.001 }
[servo]
torque = "M<i>"
velocity = "speed"
position = "dish"
disturbance = "wind"
motor = "1:RZ"
load = "3:RZ"
wind = { mean_speed = 12, coefficient = 0.05, turbulence = 0.15, duration = 20 }
[servo.controller]
kp = 5
ti = 0.3
kv = 1.5
dead_time = 0.001
low_pass = 60
notch = [{ frequency = 24, width = 10 }]
[[servo.nonlinear]]
kind = "backlash"
mesh = "rim"
at = "2:RZ"
gap = 0.004
frequency = 20
duration = 0.5
"""


def model() -> updyn.Model:
    groups = {}
    for i, (name, J, k) in enumerate(
        (("shaft", 0.03, 4e3), ("rim", 0.05, 2.5e3), ("dish", 1.2, 0.0))
    ):
        M, K = np.zeros((3, 3)), np.zeros((3, 3))
        M[i, i] = J
        if k:
            K[i : i + 2, i : i + 2] = k * np.array([[1.0, -1.0], [-1.0, 1.0]])
        groups[name] = updyn.Group(K if k else None, M, loss_factor=0.03 if k else 0.0)
    return updyn.Model.from_groups(groups, ["1:RZ", "2:RZ", "3:RZ"])


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("servo")
    updyn.write_model(model(), folder / "m.h5")
    true = model().scaled({"shaft": {"stiffness": 1.1}, "rim": {"stiffness": 0.9}})
    lines = np.linspace(2.0, 80.0, 60)
    updyn.write_frf(updyn.response(true, lines, ["1:RZ", "3:RZ"], ["1:RZ"]), folder / "t.npz")
    (folder / "job.toml").write_text(JOB)
    ready = prepare(load_job(folder / "job.toml"))
    unknowns = ready.parameters
    result = updyn.update(ready.model, ready.frf, unknowns, noise={"relative": 0.1}, starts=0)
    return result, make_plant(ready, result, "The updated model.")


def drawn(plant_result):
    """Sections by anchor, and their figures."""
    content, texts, figures = PageContent(further={"plant": plant_result}), {}, {}
    for section in select_sections(content):
        own = section.figures(content)
        texts[section.anchor] = section.render(content, own)
        figures |= own
    return texts, figures


@pytest.fixture(scope="module")
def parts(made):
    return drawn(made[1])


def trace(figure, name, number=0):
    found = [t for t in figure["data"] if t.get("name") == name]
    return values(found[number]["x"]), values(found[number]["y"])


def exact(found, freq):
    """The updated model by the library's own response: speed and dish over M and wind."""
    H = updyn.response(found.model, freq, ["1:RZ", "3:RZ"], ["1:RZ", "3:RZ"]).values
    return np.stack([2j * np.pi * freq[:, None] * H[:, 0], H[:, 1]], axis=1)


# -- the plant -------------------------------------------------------------------------------------------------
def test_the_bode_diagram_is_that_of_model_and_plant(made, parts):
    result, plant_result = made
    _, figures = parts
    for i, j in np.ndindex(2, 2):
        figure = figures[f"plant-{i}-{j}"]
        freq, size = trace(figure, "updated model")
        H = exact(result, plant_result.freq)[:, i, j]
        np.testing.assert_allclose(freq, plant_result.freq, rtol=1e-6)
        np.testing.assert_allclose(size, np.abs(H), rtol=1e-6)
        G = plant_result.plant.response(plant_result.freq).values[:, i, j]
        np.testing.assert_allclose(trace(figure, "plant")[1], np.abs(G), rtol=1e-6)
        turn = trace(figure, "plant", 1)[1]
        np.testing.assert_allclose(np.exp(1j * np.radians(turn)), G / np.abs(G), atol=1e-5)
        off = trace(figure, "error")[1]
        np.testing.assert_allclose(
            off, np.maximum(plant_result.errors("relative")[:, i, j], 1e-7), rtol=1e-3, atol=2e-8
        )
        assert (off <= np.abs(G - H) / np.abs(H) + 1e-6).all()
        assert off.max() <= 1.05 * plant_result.plant.relative_error
        np.testing.assert_allclose(trace(figure, "tolerance")[1], 0.02)
        low, high = (values(t["y"]) for t in figure["data"][:2])
        assert figure["data"][1]["name"] == "family of 4"
        members = np.abs(plant_result.family.response(plant_result.freq))[:, :, i, j]
        # Made in the basis of the family, so that it is the plant's but for their errors.
        nominal = plant_result.family.nominal.response(plant_result.freq).values[:, i, j]
        assert (np.abs(nominal - G) / np.abs(H)).max() <= 2 * plant_result.plant.relative_error
        np.testing.assert_allclose(
            high, np.maximum(members.max(axis=0), np.abs(nominal)), rtol=1e-6
        )
        np.testing.assert_allclose(low, np.minimum(members.min(axis=0), np.abs(nominal)), rtol=1e-6)


def test_lines_show_every_resonance(made):
    plant_result = made[1]
    freq = resolving_lines(plant_result.plant)
    assert (freq[0], freq[-1]) == (1.0, 90.0)
    assert (np.diff(freq) > 0).all()
    for pole in plant_result.plant.poles[plant_result.plant.poles.imag > 1.0]:
        f, half = abs(pole) / (2 * np.pi), -pole.real / (2 * np.pi)
        assert ((freq > f - half) & (freq < f + half)).sum() >= 5


def test_phases_run_through_and_stay_together():
    s = 2j * np.pi * np.geomspace(0.1, 100.0, 400)
    L = 100.0 * np.exp(-0.01 * s) / (s * (s + 10.0))
    first, other = phases(L, L * np.exp(0.3j))
    expected = -90.0 - np.degrees(np.arctan(s.imag / 10.0)) - np.degrees(0.01 * s.imag)
    np.testing.assert_allclose(first, expected, atol=1e-9)
    np.testing.assert_allclose(other - first, np.degrees(0.3), atol=1e-9)


@pytest.mark.parametrize(
    ("ends", "ticks"),
    [
        ((0.5, 40.0), ["0.5", "1", "2", "5", "10", "20"]),
        ((1e-3, 1e4), ["0.001", "0.01", "0.1", "1", "10", "100", "1000", "10000"]),
    ],
)
def test_ticks_are_written_out(ends, ticks):
    assert log_frequency(ends)["ticktext"] == ticks


def test_tables_of_the_plant(made, parts):
    plant_result = made[1]
    text = parts[0]["plant"]
    assert "single-frequency" in text
    found = {c.name: c for c in plant_result.conversions}
    row = re.search(r'<tr[^>]*><th scope="row">single-frequency</th>(.*?)</tr>', text)
    assert row is not None
    assert f"<td>{share(found['single-frequency'].error)}</td>" in row[1]
    assert found["single-frequency"].error > 0.1
    assert 'class="open"' in row[0]  # far from the tolerance
    poles = plant_result.plant.poles[plant_result.plant.poles.imag > 1.0]
    for pole in poles:
        assert f"{abs(pole) / (2 * np.pi):.5g}" in text
        assert f"{-pole.real / abs(pole):.3g}" in text
    assert "1 rigid-body mode with a pole at 0" in text
    assert "extends beyond the data, 2 to 80 Hz" in text
    # a number of the key figures keeps its percent sign where the line is broken
    assert re.search(r"tolerance [\d.]+\N{NO-BREAK SPACE}%</small>", text)


def fitted_result(plant_result):
    """The same with a conversion beyond the tolerance whose outputs were fitted, one zero lost."""
    plant = plant_result.plant
    zero = ZeroShift("speed", "M<i>", 20.0, 0.5, 30.0, 28.0)
    facts = {**plant.facts, "fitted": "outputs, with 2 real poles"}
    changed = {"route": "complex", "relative_error": 0.016, "facts": facts}
    shifts = zero, replace(zero, frequency=40.0, shift=np.nan)
    away = [
        replace(c, relative_error=0.15) if c.name == "complex" else c
        for c in plant_result.conversions
    ]
    plant = replace(plant, **changed, zero_shift=shifts)
    return replace(plant_result, plant=plant, conversions=tuple(away))


def table_row(text, name):
    found = re.search(rf'<tr[^>]*><th scope="row">{name}</th>.*?</tr>', text)
    assert found is not None
    return found[0]


def test_a_plant_with_fitted_outputs_is_not_judged_by_its_conversion(made):
    result = fitted_result(made[1])
    text = drawn(result)[0]["plant"]
    used = table_row(text, "complex")
    assert "used, then outputs fitted" in used
    assert 'class="open"' in used
    own = table_row(text, "the plant")
    assert 'class="open"' not in own
    assert f"<td>{share(0.016)}</td>" in own
    assert "complex, fitted outputs, with 2 real poles" in own
    said = describe_plant_result(result).splitlines()
    assert any(
        line.startswith("complex") and "15 %" in line and "then outputs fitted" in line
        for line in said
    )
    assert any(line.startswith("the plant itself") and "1.6 %" in line for line in said)
    assert "route: complex, fitted outputs, with 2 real poles" in said


def test_a_zero_that_the_plant_lacks_is_not_among_those_that_moved(made):
    text = drawn(fitted_result(made[1]))[0]["plant"]
    assert "at most, of 1 antiresonance; 1 antiresonance not in the plant" in text
    result = fitted_result(made[1])
    lacks = replace(result, plant=replace(result.plant, zero_shift=result.plant.zero_shift[1:]))
    text = drawn(lacks)[0]["plant"]
    assert re.search(r"Zeros moved by</dt><dd>–<small>1 antiresonance not in the plant", text)


# -- the servo -------------------------------------------------------------------------------------------------
def controller():
    return Controller(5.0, 0.3, 1.5, (Notch.of_width(24.0, 10.0),), low_pass=60.0, dead_time=0.001)


def test_the_loop_is_controller_times_plant(made, parts):
    plant_result = made[1]
    assert plant_result.servo.controller == controller()
    freq, db = trace(parts[1]["bode-velocity"], "L, nominal")
    s = 2j * np.pi * freq
    L = controller().torque(s) * plant_result.plant.at(s)[:, 0, 0]
    np.testing.assert_allclose(10 ** (db / 20), np.abs(L), rtol=2e-4, atol=1e-6)
    seen = np.abs(L) > 1e-3  # frequencies are drawn in single precision, and the notch is a zero
    turn = trace(parts[1]["bode-velocity"], "phase")[1]
    np.testing.assert_allclose(
        np.exp(1j * np.radians(turn))[seen], L[seen] / np.abs(L[seen]), atol=2e-3
    )
    # The Nichols plot is of the same numbers, and its circle is the one of a sensitivity of 6 dB.
    figure = parts[1]["nichols-velocity"]
    x, y = trace(figure, "L, nominal")
    np.testing.assert_allclose(x, turn, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(y, db, rtol=1e-6, atol=1e-6)
    x, y = trace(figure, "|1 + L| = 0.5")
    np.testing.assert_allclose(
        np.abs(1 + 10 ** (y / 20) * np.exp(1j * np.radians(x))), 0.5, rtol=1e-5
    )


def test_margins_are_lines_from_the_curves(made, parts):
    margins = made[1].servo.velocity_loop.margins
    figure = parts[1]["bode-velocity"]
    x, y = trace(figure, f"gain margin {margins.gain_margin_db:.3g} dB")
    np.testing.assert_allclose(x, margins.gain_margin_at)
    np.testing.assert_allclose(y, [-margins.gain_margin_db, 0.0])
    x, y = trace(figure, f"phase margin {margins.phase_margin:.3g}°")
    np.testing.assert_allclose(x, margins.phase_margin_at)
    assert y[0] - y[1] == pytest.approx(margins.phase_margin)
    assert abs(y[1] % 360.0 - 180.0) < 0.5  # an odd half turn


def test_margins_of_the_family_are_in_the_table(made, parts):
    servo = made[1].servo
    text = parts[0]["servo"]
    assert "also on all 4 plants of the family" in text
    found = cells_of(text, "phase margin")
    for loop, cells in zip(servo.all_loops, found, strict=False):  # then those of sampled loops
        members = [m.phase_margin for m in loop.members]
        assert cells[0] == f"{loop.margins.phase_margin:.3g}°"
        assert cells[2:] == [f"{min(members):.3g}°", str(int(np.argmin(members)))]


def python_control_margins(plant):
    """Gain margin in dB, phase margin and modulus margin of the velocity loop by python-control."""
    w = 2 * np.pi * np.unique(np.concatenate([np.geomspace(0.05, 400, 1_000), np.linspace(1, 60, 1_500)]))  # fmt: skip
    L = controller().torque(1j * w) * plant.at(1j * w)[:, 0, 0]
    gain, phase, modulus, *_ = control.stability_margins(control.frd(L, w), returnall=True)
    phase = phase[np.argmin(np.abs(phase))]
    return f"{phase:.3g}°", f"{20 * np.log10(gain[gain > 1].min()):.3g} dB", f"{modulus.min():.3g}"


def test_the_first_screen_of_a_servo(made):
    """Verdict, margins next to those of the worst plant, and the Bode diagram of the worst loop."""
    _, plant_result = made
    servo = plant_result.servo
    top = render(plant_result).split("<nav")[0]
    found = re.search(r'<p class="verdict (\w+)">(.*?)</p>', top)
    assert found.groups() == ("warn", "Servo stable, also on all 4 plants of the family, with a small margin")  # fmt: skip
    assert '<th scope="col">nominal</th><th scope="col">worst of 4 plants</th>' in top
    titles = ("phase margin", "gain margin", "modulus margin")
    nominal = python_control_margins(plant_result.family.nominal)
    members = [python_control_margins(member) for member in plant_result.family.members]
    for k, title in enumerate(titles):
        cells = cells_of(top, title)[0]
        assert cells[0] == nominal[k]
        assert cells[1] == min((m[k] for m in members), key=lambda text: float(re.match(r"[\d.]+", text)[0]))  # fmt: skip
    assert 'data-figure="bode-velocity"' in top
    assert "NOT updated" not in top
    assert servo.velocity_loop.margins.modulus_margin < 0.5


def test_the_first_screen_of_a_plant_without_a_servo(made):
    plant_result = replace(made[1], servo=None, updated=False, source="The original model.")
    top = render(plant_result).split("<nav")[0]
    assert '<p class="verdict warn">Plant within its tolerance</p>' in top
    assert '<p class="reservation">The original model.</p>' in top
    i, j = np.unravel_index(np.argmax(plant_result.channel_errors("relative")), (2, 2))
    assert f'data-figure="plant-{i}-{j}"' in top
    lost = render(replace(plant_result, plant=None, message="no order holds")).split("<nav")[0]
    assert '<p class="verdict bad">Tolerance not met: no plant is written</p>' in lost
    assert "no order holds" in lost


def test_the_terminal_states_the_outcome_first(made):
    plant_result = made[1]
    notes = tuple(f"{'A note of many words that needs two lines of a terminal. ' * 2}{i}" for i in range(9))  # fmt: skip
    said = brief_plant_result(replace(plant_result, notes=notes), ["Plant in job"], 80)
    lines = fit_text(said, 80).splitlines()
    assert len(lines) <= 20
    assert lines[0].startswith("Azimuth <b>'\"& 1</b>: the servo is stable, also on all 4 plants")
    assert lines[-1] == "Plant in job"
    row = next(line for line in lines if line.startswith("velocity"))
    margins = plant_result.servo.velocity_loop.margins
    worst = min(m.phase_margin for m in plant_result.servo.velocity_loop.members)
    assert f"{margins.phase_margin:.4g} ({worst:.4g})" in row
    bare = brief_plant_result(replace(plant_result, servo=None), [], 80).splitlines()
    assert bare[0].endswith(": plant from 1 to 90 Hz, within its tolerance.")
    lost = brief_plant_result(replace(plant_result, servo=None, plant=None, message="no order"), [], 80)  # fmt: skip
    assert lost.splitlines()[:2] == [f"{plant_result.title}: no plant from 1 to 90 Hz.", "no order"]


def test_the_outcome_in_a_few_words(made):
    bare = replace(made[1], servo=None)
    expected = "servo stable, also on all 4 plants of the family, with a small margin"
    assert name_plant_outcome(made[1]) == expected
    assert name_plant_outcome(bare) == "plant made"
    assert name_plant_outcome(replace(bare, plant=None)) == "tolerance not met"


def test_a_relative_error_is_stated_with_its_place(made):
    """|H| is small where the relative error of a plant by its peak is largest."""
    plant_result = made[1]
    freq, exact = plant_result.freq, plant_result.exact.copy()
    at = len(freq) // 3
    answer = exact.copy()
    answer[at, 0, 0] *= 2.5
    zero = ZeroShift("speed", "M<i>", 1.01 * freq[at], 0.5, 30.0, 28.0)
    far = replace(zero, frequency=1.04 * freq[at])
    share_there = np.abs(exact[at, 0, 0]) / np.abs(exact[:, 0, 0]).max()
    for zeros, place in (((zero,), f", at the antiresonance of {zero.frequency:.4g} Hz"), ((far,), "")):  # fmt: skip
        plant = replace(plant_result.plant, zero_shift=zeros)
        changed = replace(plant_result, answer=answer, plant=plant, measure="peak")
        text = drawn(changed)[0]["plant"]
        row = table_row(text, "speed over M&lt;i&gt;")
        assert (
            f"{freq[at]:.4g} Hz, where |H| is {share(share_there)} of the peak{place}</td>" in row
        )
        assert "<td>150 %</td>" in row
        assert "Relative error" not in text  # no headline


def cells_of(text, title):
    """The cells of each row of a title."""
    rows = re.findall(rf'<tr><th scope="row">{title}</th>(.*?)</tr>', text)
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in rows]


def test_robust_margins_are_in_the_report_and_the_record(made, parts):
    servo = made[1].servo
    text = parts[0]["servo"]
    assert [m.of for m in servo.robust] == ["family", "plant error"]
    record = servo_record(servo)["robust"]
    for margin, own in zip(servo.robust, record, strict=True):
        assert own["margin"] == margin.margin
        assert own["meaning"] == margin.meaning
        assert f"{margin.margin:.3g} times" in text
    assert record[1]["member_margin"] is None


def test_margins_of_the_sampled_loops_are_in_a_table_of_their_own(made, parts):
    servo = made[1].servo
    text = parts[0]["servo"]
    assert servo.sampled.dt == 0.0005
    assert servo.sampled.delay == 2
    own = text[
        text.index(
            "Margins of the sampled loops: every 0.5 ms, with the hold, torque delayed by 2"
        ) :
    ]
    margins = [loop.margins.phase_margin for loop in servo.sampled.loops]
    cells = [cells[0] for cells in cells_of(own, "phase margin")]
    assert cells == [f"{margin:.3g}°" for margin in margins]
    assert "dead time of 1 ms is omitted" in own
    record = servo_record(servo)["sampled"]
    assert record["velocity_loop"]["margins"]["phase_margin"] == pytest.approx(margins[0])
    assert len(record["poles"]) == len(servo.sampled.poles)


def test_responses_over_time(made, parts):
    servo = made[1].servo
    time, dish = trace(parts[1]["step"], "dish")
    assert dish[0] == pytest.approx(0.0, abs=1e-6)
    assert dish[-1] == pytest.approx(1.0, abs=0.03)
    assert time[-1] == pytest.approx(servo.step.time[-1], rel=1e-6)
    assert parts[1]["step"]["layout"]["yaxis2"]["title"]["text"] == "command (N m)"
    time, error = trace(parts[1]["wind"], servo.wind.output)
    assert np.abs(error).max() == pytest.approx(servo.wind.peak, rel=1e-6)
    assert time[-1] == pytest.approx(servo.wind.time[-1], rel=1e-6)


def test_no_peak_is_lost_where_points_are_left_out():
    value = np.random.default_rng(0).standard_normal(50_001)
    value[31_234], value[7] = 9.0, -8.0
    at = thin_indices(value, 1000)
    assert len(at) <= 1002
    assert (at[0], at[-1]) == (0, 50_000)
    assert {31_234, 7} <= set(at.tolist())
    np.testing.assert_array_equal(thin_indices(value[:900], 1000), np.arange(900))


def test_neither_peaks_nor_gaps_are_lost_where_values_are_missing():
    value = np.full(100, np.nan)
    value[57], value[91] = 3.0, -3.0
    at = thin_indices(value, 10)
    assert {57, 91} <= set(at.tolist())
    assert np.all(np.diff(at) > 0)
    value = np.sin(np.arange(1000.0))
    value[501] = np.nan
    assert 501 in thin_indices(value, 100)


def test_the_report_of_the_update_starts_with_the_verdict_on_the_servo(made):
    result, plant_result = made
    text = "Servo stable, also on all 4 plants of the family, with a small margin"
    found = re.findall(r'<p class="headline (\w+)"><a href="#servo">(.*?)</a></p>',
                       render_update(result, plant=plant_result).split("<nav")[0])  # fmt: skip
    assert found == [("warn", text)]
    assert judge_plant(replace(plant_result, plant=None)).kind == "bad"
    assert judge_plant(replace(plant_result, servo=None)).text == "Plant within its tolerance"


def test_an_unstable_loop_says_so(made):
    from dataclasses import replace

    plant_result = made[1]
    wild = updyn.servo(
        plant_result.family,
        replace(controller(), kp=5000.0),
        torque="M<i>",
        velocity="speed",
        position="dish",
    )
    texts, figures = drawn(replace(plant_result, servo=wild))
    text = texts["servo"]
    assert '<p class="verdict bad">Not stable: velocity and position loop</p>' in text
    assert "Unstable: velocity loop: plants 0, 1, 2, 3" in text
    assert "step" not in figures
    assert control_record(replace(plant_result, servo=wild))["servo"]["stable"] is False


def test_backlash_is_that_of_the_library(made, parts):
    _, plant_result = made
    (found,) = plant_result.nonlinear
    gap = updyn.opened(plant_result.model, "rim", "2:RZ")
    assert found.law == gap.backlash(0.004, frequency=20.0)
    ports = plant_result.plant.input_ports[:1], plant_result.plant.output_ports
    plant = updyn.plant(
        gap.model,
        [*ports[0], gap.port],
        [*ports[1], gap.port],
        (1.0, 90.0),
        quantity=["mobility", "receptance", "receptance"],
        error="peak",
    )
    cycles = updyn.limit_cycles(
        plant, controller(), found.law, "gap", torque="M<i>", velocity="speed", position="dish"
    )
    assert [c.frequency for c in found.cycles] == pytest.approx(
        [c.frequency for c in cycles], rel=1e-6
    )
    assert found.simulation.time[-1] == pytest.approx(0.5, abs=1e-3)
    time, twist = trace(parts[1]["nonlinear-0"], "twist")
    assert time[-1] == pytest.approx(found.simulation.time[-1], rel=1e-6)
    inside = np.interp(time, found.simulation.time, found.simulation.reading)
    np.testing.assert_allclose(twist, inside, atol=2e-4 * np.abs(inside).max())
    text = parts[0]["servo"]
    assert "Backlash in &#39;rim&#39;, 0.004 rad at 2:RZ" in text
    record = control_record(plant_result)["nonlinear"][0]
    assert record["law"]["gap"] == 0.004
    assert len(record["cycles"]) == len(cycles)


# -- record and page -------------------------------------------------------------------------------------------
def test_the_record_is_strict_and_holds_what_a_designer_needs(made):
    plant_result = made[1]
    found = json.loads(json.dumps(control_record(plant_result), allow_nan=False))
    assert found["plant"]["order"] == plant_result.plant.n_states
    assert found["plant"]["rigid"] == 1
    assert found["plant"]["inputs"][0] == {"name": "M<i>", "unit": "N m", "weights": {"1:RZ": 1.0}}
    assert found["plant"]["outputs"][0]["quantity"] == "mobility"
    weight = found["family"]["weights"][0]
    s = 2j * np.pi * 20.0
    zeros, poles = (
        np.array([complex(z["re"], z["im"]) for z in weight[k]]) for k in ("zeros", "poles")
    )
    W = weight["gain"] * np.prod(s - zeros) / np.prod(s - poles)
    G = plant_result.family.response([20.0])[:, 0, 0, 0]
    G0 = plant_result.plant.response([20.0]).values[0, 0, 0]
    assert abs(W) >= np.abs(G / G0 - 1).max()
    loop = found["servo"]["velocity_loop"]
    assert loop["margins"]["phase_margin"] == pytest.approx(
        plant_result.servo.velocity_loop.margins.phase_margin
    )
    assert loop["worst"]["phase_margin"]["smallest"] <= loop["margins"]["phase_margin"] + 1e-9
    # Three inertias in a row: all together, and with the first one held.
    assert found["drive"]["inertia"] == pytest.approx(0.03 + 0.05 + 1.2)
    k1, k2 = 4e3 * made[0].values["shaft.stiffness"], 2.5e3 * made[0].values["rim.stiffness"]
    squares = np.linalg.eigvals(np.array([[(k1 + k2) / 0.05, -k2 / 0.05], [-k2 / 1.2, k2 / 1.2]]))
    assert found["drive"]["locked"] == pytest.approx(
        np.sort(np.sqrt(squares)) / (2 * np.pi), rel=1e-9
    )


def test_names_are_escaped(made, tmp_path):
    text = write_plant_page(made[1], tmp_path / "plant.html").read_text(encoding="utf-8")
    body = text.split("<body>")[1].split("<script")[0]
    assert "<i>" not in body
    assert "<b>" not in body
    assert "M&lt;i&gt;" in body
    figures = json.loads(re.search(r'id="updyn-figures">(.*?)</script>', text)[1])
    assert set(re.findall(r'data-figure="([^"]*)"', text)) == set(figures)
    assert not re.findall(r'(?:src|href)="(?!#|data:)', body)


def test_the_report_has_the_sections(made, tmp_path):
    result, plant_result = made
    text = updyn.write_report(result, tmp_path / "report.html", plant=plant_result).read_text(
        encoding="utf-8"
    )
    order = [
        text.index(f'<section id="{name}">')
        for name in ("unknowns", "plant", "servo", "provenance")
    ]
    assert order == sorted(order)
    assert '<section id="plant">' not in updyn.write_report(
        result, tmp_path / "bare.html"
    ).read_text(encoding="utf-8")


@pytest.mark.needs("browser")
def test_the_page_is_drawn_in_a_browser(made, tmp_path):
    page = write_plant_page(made[1], tmp_path / "plant.html")
    dom = dump(page, tmp_path / "profile")
    found = attributes(dom)
    assert "errors" not in found, found["errors"]
    _, figures = drawn(made[1])
    assert len(re.findall(r'class="main-svg"', dom)) >= 2 * len(figures)
