"""Faults that the data show by themselves, each at the size that was put in, and none in sound data."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.errors import DataError, OptionError, SolverError
from updyn.updating.judge.causes import diagnosis
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.judge.causes.data_alone import (
    detect_data_faults,
    drop_expected,
    make_finding,
    with_variance,
)
from updyn.updating.judge.causes.settings import CAUSE_SEARCH
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.problem import FRFPart

SENSORS = ["2:X", "5:-X", "7:X", "12:X"]


@pytest.fixture(scope="module")
def model(chain12_true):
    """Resonances up to 200 Hz."""
    return chain12_true.scaled({name: {"stiffness": 100.0} for name in chain12_true.groups})


@pytest.fixture(scope="module")
def clean(model):
    freq = np.arange(5.0, 220.0, 0.5)
    return updyn.response(model, freq, SENSORS, ["5:X", "12:X"], "accelerance")


@pytest.fixture
def data(clean, add_noise):
    return add_noise(clean, np.random.default_rng(3), 0.01)


def shown(frf):
    return [
        make_finding(one, "")
        for one in detect_data_faults(with_variance(frf, choose_noise(None, frf)))
    ]


def one(frf, i, j, factor):
    values = frf.values.copy()
    values[:, i, j] *= factor
    return replace(frf, values=values)


def test_sound_data_show_nothing(clean, add_noise):
    for seed in range(4):
        for relative in (0.0, 0.01, 0.05):
            noisy = add_noise(clean, np.random.default_rng(seed), relative)
            assert shown(noisy) == []
            assert shown(noisy.converted("receptance")) == []


def with_hum(frf, lines, size=0.5):
    values = frf.values.copy()
    at = frf.find_lines(lines)
    phase = np.exp(2j * np.pi * np.random.default_rng(0).uniform(size=values[at].shape))
    values[at] += size * np.median(np.abs(values)) * phase
    return replace(frf, values=values)


def test_mains_are_found_and_left_out(data):
    (found,) = shown(with_hum(data, [50.0, 150.0]))
    assert (found.kind, found.value, found.channels) == ("mains", 50.0, ())
    assert "50, 150 Hz" in found.statement
    assert found.written == "mains=50"
    assert 'repair = ["mains=50"]' in found.remedy
    assert not found.grave
    kept = found.repair(with_hum(data, [50.0, 150.0]))
    assert not np.isin([50.0, 100.0, 150.0, 200.0], kept.freq).any()
    assert len(kept.freq) == len(data.freq) - 4
    assert kept.values == pytest.approx(data.select(lines=kept.freq).values)


def test_mains_of_60_hz_are_not_those_of_50(data):
    (found,) = shown(with_hum(data, [60.0], 3.0))
    assert (found.kind, found.value) == ("mains", 60.0)


@pytest.mark.parametrize("loss_factor", [0.005, 0.02, 0.1])
@pytest.mark.parametrize("frequency", [50.0, 50.2, 100.0])
def test_a_resonance_on_a_multiple_is_no_hum(add_noise, loss_factor, frequency):
    """At 0.5 Hz the half-power bandwidth of the sharpest one is half a line."""
    freq = np.arange(5.0, 220.0, 0.5)
    modes = np.array([[23.0, frequency, 130.0]])
    H = np.sum(1.0 / (modes**2 * (1.0 + 1j * loss_factor) - freq[:, None] ** 2), axis=1)
    frf = updyn.FRF(freq, H[:, None, None], ["1:X"], ["1:X"], "receptance")
    for seed in range(5):
        assert shown(add_noise(frf, np.random.default_rng(seed), 0.01)) == []


def test_of_coarse_lines_nothing_is_said_of_mains(data):
    coarse = data.select(lines=data.freq[::12])  # 6 Hz
    assert shown(with_hum(coarse, [59.0, 119.0], 3.0)) == []


@pytest.mark.parametrize(
    ("factor", "explains"),
    [
        (lambda f: -1.0, "; the sign explains it"),
        (lambda f: 1.6, "; a factor of"),
        (lambda f: np.exp(-2j * np.pi * f * 1e-3), "; a delay of"),
        (lambda f: np.exp(1.5j * np.sin(f / 5.0)), "neither sign nor a factor nor a delay"),
    ],
)
def test_broken_reciprocity_names_the_pair_and_what_explains_it(data, factor, explains):
    bad = one(data, 3, 0, factor(data.freq))
    (found,) = shown(bad)
    assert (found.kind, found.channels) == ("reciprocity", ("5:X", "12:X"))
    assert explains in found.statement
    assert found.written == ""
    with pytest.raises(DataError, match="measure 5:X, 12:X again"):
        found.repair(bad)


def test_a_few_per_cent_between_reciprocal_channels_are_usual(data):
    assert shown(one(data, 3, 0, 1.05)) == []


def test_a_drive_point_that_gives_energy_is_named_with_what_may_be_behind_it(data):
    (found,) = shown(one(data, 1, 0, -1.0))
    assert (found.kind, found.channels) == ("drive-point", ("5:X",))
    # Near resonances and antiresonances the phase says it, between them the noise hides it.
    assert found.value > 0.3
    assert "opposite sign" in found.statement
    (found,) = shown(one(data, 1, 0, np.exp(-2j * np.pi * data.freq * 1e-3)))
    assert "a delay of about 0.00" in found.statement
    found = shown(replace(data.converted("receptance"), quantity="mobility"))
    assert [f.kind for f in found] == ["drive-point"]
    assert found[0].grave
    assert "data that are receptance" in found[0].statement


def test_few_lines_at_which_the_real_part_has_a_sign_are_enough(chain12_true, add_noise):
    """Light damping: elsewhere the noise hides it."""
    at = ["2:X", "7:X", "12:X"]
    freq = np.linspace(0.63, 22.7, 60)
    clean = updyn.response(chain12_true, freq, at, at)
    for seed in range(5):
        sound = add_noise(clean, np.random.default_rng(seed), 0.01, 1e-3)
        assert shown(sound) == []
        kinds = {f.kind: f.channels for f in shown(one(sound, 1, 1, -1.0))}
        assert kinds["drive-point"] == ("7:X",)


def cut(model, clean, end):
    """Return data of impulse responses that end; they are those up to twice the highest line."""
    step = np.diff(clean.freq)[0] / 16
    grid = np.maximum(np.arange(int(2 * clean.freq[-1] / step)) * step, 1e-3 * step)
    fine = updyn.response(model, grid, clean.responses, clean.references, clean.quantity)
    t = np.arange(len(grid)) / (len(grid) * step)
    h = np.fft.ifft(fine.values, axis=0)[t < end]
    back = np.exp(-2j * np.pi * clean.freq[:, None] * t[t < end])
    return replace(clean, values=np.tensordot(back, h, axes=(1, 0)))


@pytest.mark.parametrize("end", [0.15, 0.4])
def test_records_that_were_cut_off_are_found_with_their_length(chain12_true, add_noise, end):
    light = {name: {"stiffness": 100.0, "loss_factor": 0.004} for name in chain12_true.groups}
    model = chain12_true.scaled(light)
    freq = np.arange(5.0, 220.0, 1.0)
    clean = updyn.response(model, freq, SENSORS, ["5:X", "12:X"], "accelerance")
    assert shown(add_noise(clean, np.random.default_rng(3), 0.01)) == []
    (found,) = shown(add_noise(cut(model, clean, end), np.random.default_rng(3), 0.01))
    assert found.kind == "leakage"
    assert found.value == pytest.approx(end, abs=0.02)
    assert "longer records" in found.remedy


def test_a_fault_behind_a_symptom_is_told_alone(chain12, chain12_true, add_noise):
    """A sensor the wrong way round breaks reciprocity and its drive point, too."""
    freq = np.linspace(0.6, 22.0, 100)
    clean = updyn.response(chain12_true, freq, ["2:X", "5:X", "12:X"], ["5:X", "12:X"])
    data = add_noise(clean, np.random.default_rng(3), 0.01)
    values = data.values.copy()
    values[:, 1] *= -1.0
    bad = replace(data, values=values)
    assert {f.kind for f in shown(bad)} == {"drive-point", "reciprocity"}
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    (found,) = updyn.diagnose(chain12, bad, unknowns)
    assert (found.kind, found.channels) == ("sign", ("5:X",))


def test_one_wrong_run_is_not_blamed_on_a_sensor(chain12, chain12_true, add_noise, monkeypatch):
    freq = np.linspace(0.6, 22.0, 100)
    sensors = ["2:X", "5:X", "7:X", "12:X"]
    clean = updyn.response(chain12_true, freq, sensors, ["5:X", "12:X"])
    data = add_noise(clean, np.random.default_rng(3), 0.01)
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    # Its values are not a part of the misfit beyond which units are tried in place of faults.
    override(monkeypatch, CAUSE_SEARCH, gross_rms=0.1)
    monkeypatch.setattr(
        diagnosis, "_try_other_units", lambda *about: pytest.fail("units are tried")
    )
    (found,) = updyn.diagnose(chain12, one(data, 3, 0, 2.0), unknowns)
    assert (found.kind, found.channels) == ("reciprocity", ("5:X", "12:X"))


@pytest.mark.parametrize("written", ["mains=0", "mains:2:X=50", "mains=high"])
def test_mains_are_read_by_their_frequency(written):
    with pytest.raises(OptionError, match="mains"):
        read_fault(written)


def silenced(frf, rows=slice(None), columns=slice(None)):
    values = frf.values.copy()
    values[:, rows, columns] = 0.0
    return replace(frf, values=values)


@pytest.mark.parametrize(
    ("rows", "columns", "channel"), [(2, slice(None), "7:X"), (slice(None), 1, "force 12:X")]
)
def test_a_dead_channel_is_named_and_left_out(data, rows, columns, channel):
    dead = silenced(data, rows, columns)
    (found,) = shown(dead)
    assert (found.kind, found.channels) == ("dead-channel", (channel,))
    assert found.written == f"dead-channel:{channel}"
    assert f"{channel[0].upper()}{channel[1:]} contains only zeros" in found.statement
    assert found.grave
    rest = found.repair(dead)
    assert rest.values.all()
    assert rest.values.size == data.values.size - data.values[:, rows, columns].size


def test_several_dead_sensors_are_named_each(data):
    found = shown(silenced(data, [0, 2]))
    assert {one.channels for one in found} == {("2:X",), ("7:X",)}


def test_data_that_are_all_zero_name_no_channel(data):
    assert shown(silenced(data)) == []


def test_a_channel_of_which_the_model_has_no_response_is_not_dead():
    """Two chains that nothing connects: a force on one is not heard on the other."""
    K = np.diag([3e4, 2e4, 0.0, 0.0]) + np.array(
        [[0, -1e4, 0, 0], [-1e4, 0, 0, 0], [0, 0, 2e4, -1e4], [0, 0, -1e4, 1e4]]
    )
    model = updyn.Model.from_groups(
        {"both": updyn.Group(K, np.eye(4), loss_factor=0.02)}, ["1:X", "2:X", "3:X", "4:X"]
    )
    data = updyn.response(model, np.linspace(1.0, 40.0, 60), ["1:X", "2:X", "4:X"], ["2:X"])
    assert not data.values[:, 2].any()
    assert updyn.diagnose(model, data) == ()
    (found,) = updyn.diagnose(model, silenced(data, 0))
    assert found.channels == ("1:X",)


def test_an_update_tells_of_a_dead_channel(chain12, chain12_true, add_noise):
    freq = np.linspace(0.4, 22.0, 80)
    clean = updyn.response(chain12_true, freq, SENSORS, ["2:X", "12:X"], "accelerance")
    dead = silenced(add_noise(clean, np.random.default_rng(1), 0.01), 1)
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all")
    result = updyn.update(chain12, dead, unknowns, starts=0)
    assert [(one.kind, one.channels) for one in result.findings] == [("dead-channel", ("5:X",))]
    assert "5:X contains only zeros" in result.summary()
    assert result.status == "not-credible"
    repaired = updyn.update(chain12, result.findings[0].repair(dead), unknowns, starts=0)
    assert repaired.status == "converged"
    assert repaired.findings == ()


def test_a_dead_channel_is_named_where_the_model_cannot_be_solved(model, data, monkeypatch):
    values = data.values.copy()
    values[:, 0] = 0.0
    unknowns = updyn.parameters(model, stiffness="all")
    part = FRFPart.build(model, replace(data, values=values), unknowns)

    def fail(*args, **options):
        raise SolverError("singular")

    monkeypatch.setattr(FRFPart, "responses", fail)
    detections = detect_data_faults(with_variance(part.frf, choose_noise(None, part.frf)))
    kept = drop_expected(detections, part)
    assert [one.fault.kind for one in kept] == ["dead-channel"]
