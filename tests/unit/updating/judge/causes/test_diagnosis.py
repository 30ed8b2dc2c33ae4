"""Faults that were put into data are found and named, before and after a fit."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn import sensitivity
from updyn.errors import DataError, OptionError
from updyn.updating.judge.causes import diagnosis
from updyn.updating.judge.causes.catalogue import read_fault
from updyn.updating.judge.causes.data_alone import with_variance
from updyn.updating.judge.causes.diagnosis import find_causes, weight_by_noise
from updyn.updating.judge.causes.misfit import count_values, find_weightless, remove_weight
from updyn.updating.judge.causes.ranking import RankedFault, is_worth_reporting
from updyn.updating.judge.causes.trial import Trial, run_trial
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.problem import FRFPart

SENSORS = ["2:X", "5:X", "7:X", "10:X", "12:X"]


@pytest.fixture(scope="module")
def clean(chain12_true):
    return updyn.response(chain12_true, np.linspace(0.6, 22.0, 100), SENSORS, ["5:X", "12:X"])


@pytest.fixture(scope="module")
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")


@pytest.fixture
def data(clean, add_noise):
    return add_noise(clean, np.random.default_rng(3), 0.01)


def row(frf, i, factor):
    values = frf.values.copy()
    values[:, i] *= np.reshape(factor, (-1, 1))
    return replace(frf, values=values)


def exchanged(frf, i, j):
    values = frf.values.copy()
    values[:, [i, j]] = values[:, [j, i]]
    return replace(frf, values=values)


@pytest.mark.parametrize(
    ("spoilt", "kind", "channels", "value"),
    [
        (lambda d: row(d, 1, -1.0), "sign", ("5:X",), 0.0),
        (lambda d: row(d, 2, np.exp(0.2)), "calibration", ("7:X",), 0.2),
        (lambda d: exchanged(d, 0, 3), "swapped", ("2:X", "10:X"), 0.0),
        (
            lambda d: replace(d.converted("mobility"), quantity="receptance"),
            "quantity",
            (),
            1.0,
        ),
        (lambda d: replace(d, values=9.80665 * d.values), "scale", (), 9.80665),
        (lambda d: replace(d, values=d.values.conj()), "non-causal", (), 0.0),
        (lambda d: row(d, 2, np.exp(-2j * np.pi * d.freq * 5e-3)), "delay", ("7:X",), 5e-3),
        (lambda d: row(d, 1, 1.0 / (1.0 + 2j * np.pi * d.freq * 0.01)), "low-pass", ("5:X",), 0.01),
    ],
)
def test_a_fault_is_found_before_any_fit(chain12, data, unknowns, spoilt, kind, channels, value):
    bad = spoilt(data)
    found = updyn.diagnose(chain12, bad, unknowns)
    assert [(f.kind, f.channels) for f in found] == [(kind, channels)]
    assert found[0].value == pytest.approx(value, rel=0.05, abs=1e-12)
    assert found[0].odds > 100.0
    assert found[0].written in found[0].remedy
    repaired = found[0].repair(bad)
    off = np.abs(repaired.converted(data.quantity).values - data.values) / np.abs(data.values)
    assert np.median(off) < 0.02


def test_a_misplaced_sensor_is_found(chain12, chain12_true, clean, unknowns, add_noise):
    where = [label if label != "5:X" else "6:X" for label in SENSORS]
    frf = updyn.response(chain12_true, clean.freq, where, ["5:X", "12:X"])
    noisy = add_noise(frf, np.random.default_rng(3), 0.01)
    (found,) = updyn.diagnose(chain12, replace(noisy, responses=clean.responses), unknowns)
    assert (found.kind, found.channels) == ("moved", ("5:X", "6:X"))
    assert found.repair(clean).responses.labels == where


def test_a_scaled_axis_is_found_where_masses_are_known(chain12, chain12_true, clean, add_noise):
    """And one stiffness: else the others imitate it."""
    data = add_noise(clean, np.random.default_rng(6), 0.01)
    groups = {name: {"mass": 1.0} for name in chain12.groups}
    model = chain12_true.scaled(groups)
    unknowns = updyn.parameters(model, stiffness=["part2", "part3", "part4"], loss_factor="all")
    stretched = replace(data, freq=data.freq / 1.03)
    (found,) = updyn.diagnose(model, stretched, unknowns)
    assert found.kind == "frequency-scale"
    # The data know it that well as long as the masses are what an update takes them for.
    assert np.exp(found.value) == pytest.approx(1.03, abs=1e-4)


def test_a_scaled_axis_is_found_although_all_masses_together_nearly_imitate_it(
    chain12_true, clean, add_noise
):
    """Exact data put the difference, which only the priors of the masses make, far below it."""
    data = add_noise(clean, np.random.default_rng(6), 1e-3)
    unknowns = updyn.parameters(
        chain12_true, stiffness=["part2", "part3", "part4"], loss_factor="all"
    )
    stretched = replace(data, freq=data.freq / 1.04)
    (found,) = updyn.diagnose(chain12_true, stretched, unknowns)
    assert found.kind == "frequency-scale"
    assert np.exp(found.value) == pytest.approx(1.04, abs=1e-3)


def test_the_size_of_a_fault_holds_where_what_is_held_is_off(chain12, chain12_true, data):
    rng = np.random.default_rng(1)
    off = {name: {"mass": 1.0 + rng.choice([-0.05, 0.05])} for name in chain12.groups}
    model = chain12_true.scaled(off)
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    (found,) = updyn.diagnose(model, row(data, 2, np.exp(0.2)), unknowns)
    assert (found.kind, found.channels) == ("calibration", ("7:X",))
    assert found.value == pytest.approx(0.2, abs=0.005)


def test_a_common_factor_is_found_where_masses_are_known(chain12, chain12_true, data):
    """Masses that are all off by that factor would do the same, and hardly ever are."""
    model = chain12_true.scaled({name: {"mass": 1.0} for name in chain12.groups})
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    (found,) = updyn.diagnose(model, replace(data, values=1.1 * data.values), unknowns)
    assert (found.kind, found.channels) == ("calibration", ())
    assert np.exp(found.value) == pytest.approx(1.1, abs=0.01)


def test_a_model_whose_known_values_are_off_is_no_fault_of_the_data(chain12, chain12_true, data):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        off = {name: {"mass": 1.0 + rng.choice([-0.05, 0.05])} for name in chain12.groups}
        model = chain12_true.scaled(off)
        unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
        assert updyn.diagnose(model, data, unknowns) == ()


def test_damping_that_the_model_lacks_is_no_fault_of_the_data(chain12, data):
    """Not that of an exponential window, though it widens resonances, too."""
    undamped = chain12.scaled({name: {"loss_factor": 0.0} for name in chain12.groups})
    assert not updyn.diagnose(undamped, data, updyn.parameters(undamped, stiffness="all"))


def test_in_sound_data_nothing_is_found(chain12, clean, unknowns, add_noise):
    for seed in range(5):
        noisy = add_noise(clean, np.random.default_rng(seed), 0.01)
        assert updyn.diagnose(chain12, noisy, unknowns) == ()


def test_data_without_a_fault_are_fitted_once_from_the_start(chain12, data, unknowns, monkeypatch):
    fits = []

    def counting(part, fault, points, **options):
        fits.append((fault, [tuple(x) for x in points]))
        return run_trial(part, fault, points, **options)

    monkeypatch.setattr(diagnosis, "run_trial", counting)
    assert updyn.diagnose(chain12, data, unknowns) == ()
    (first, *_) = fits
    assert first[0] is None
    assert fits.count(first) == 1


def test_what_was_evaluated_is_not_evaluated_again(chain12, data, unknowns, monkeypatch):
    bad = row(data, 1, -1.0)
    evaluate, lines = sensitivity.receptance, []

    def counting(*args, **options):
        lines.append(len(args[3]))
        return evaluate(*args, **options)

    monkeypatch.setattr(sensitivity, "receptance", counting)
    part = FRFPart.build(chain12, bad, unknowns)
    found = find_causes(part, choose_noise(None, bad))
    plain = sum(lines)
    lines.clear()
    assert list(updyn.diagnose(chain12, bad, unknowns)) == found
    assert sum(lines) < 0.9 * plain


def test_by_default_all_groups_are_unknown(chain12, data):
    (found,) = updyn.diagnose(chain12, row(data, 1, -1.0))
    assert (found.kind, found.channels) == ("sign", ("5:X",))


def test_an_update_of_repaired_data_is_that_of_sound_ones(chain12, data, unknowns):
    bad = exchanged(data, 0, 3)
    result = updyn.update(chain12, bad, unknowns, starts=0)  # no search explains such data
    assert not result.ok
    assert result.findings[0].kind == "swapped"
    assert result.findings[0].grave
    sound = updyn.update(chain12, data, unknowns)
    again = updyn.update(chain12, result.findings[0].repair(bad), unknowns)
    assert sound.ok
    assert again.ok
    assert sound.findings == ()
    for name, value in sound.values.items():
        assert again.values[name] == pytest.approx(value, abs=1e-6)


def test_a_roving_mass_is_found_and_not_said_to_be_repaired(chain12, chain12_true, data, unknowns):
    own = updyn.response(chain12_true, data.freq, SENSORS, SENSORS, "accelerance")
    at_itself = -np.diagonal(own.values, axis1=1, axis2=2)
    bad = replace(data, values=data.values / (1.0 - 0.1 * at_itself)[:, :, None])
    (found,) = updyn.diagnose(chain12, bad, unknowns)
    assert found.kind == "mass-loading"
    assert found.value == pytest.approx(0.1, rel=0.05)
    assert found.written == ""
    assert "repair" not in found.remedy
    with pytest.raises(updyn.UpdynError, match="sensor_masses"):
        found.repair(bad)


def test_a_fault_that_the_unknowns_imitate_is_found_where_it_leaves_but_noise(
    gear_train, add_noise
):
    """Damping does nearly what a late sensor of the gear train does: it explains a little only."""
    freq = np.geomspace(2.0, 1000.0, 60) / (2.0 * np.pi)
    sound = updyn.response(gear_train, freq, [f"{i}:RZ" for i in range(1, 5)], ["2:RZ"])
    rng = np.random.default_rng(0)
    late = row(add_noise(sound, rng, 0.01, 1e-3), 0, np.exp(-2j * np.pi * freq * 0.0013))
    off = {
        name: {
            "stiffness": 1.0 + rng.uniform(-0.3, 0.3),
            "mass": 1.0 + rng.uniform(-0.1, 0.1),
            "loss_factor": 0.0,
        }
        for name in gear_train.groups
    }
    (found, *_) = updyn.diagnose(gear_train.scaled(off), late)
    assert (found.kind, found.channels) in (("delay", ("1:RZ",)), ("low-pass", ("1:RZ",)))
    assert found.explains < 0.1


def test_conjugated_data_are_found_where_damping_hardly_shows(chain12_true, add_noise):
    """With a start without damping, all that is wrong is some small phases at a few lines."""
    light = {name: {"loss_factor": 0.002} for name in chain12_true.groups}
    freq = np.linspace(0.6, 22.0, 60)
    clean = updyn.response(chain12_true.scaled(light), freq, SENSORS, ["5:X"])
    data = add_noise(clean, np.random.default_rng(3), 0.01, 1e-3)
    none = {name: {"loss_factor": 0.0, "stiffness": 1.1} for name in chain12_true.groups}
    found = updyn.diagnose(chain12_true.scaled(none), replace(data, values=data.values.conj()))
    assert [one.kind for one in found] == ["non-causal"]


@pytest.mark.parametrize(
    ("explains", "left", "alike", "n_values", "worth"),
    [
        (0.2, 0.3, 0.5, 400, True),  # a good part
        (0.06, 0.02, 0.0, 400, True),  # all but noise
        (0.06, 0.02, 0.0, 300, False),  # which may have done it by chance
        (0.06, 0.02, 0.5, 400, False),  # one of many errors: what is left is no noise,
        (0.06, 0.2, 0.0, 4000, False),  # nor is it when lines are few, and it is large
    ],
)
def test_how_much_a_fault_has_to_explain(explains, left, alike, n_values, worth):
    fault = read_fault("delay:7:X=0.001")
    trial = Trial(fault, np.zeros(1), left**2, 0.0, alike, n_values)
    assert is_worth_reporting(RankedFault(trial, fault, 50.0, explains, explains)) == worth


def test_the_size_of_a_fault_is_as_exact_as_the_data_allow(chain12, add_noise):
    """A scaled axis beside a floor of noise in which antiresonances are lost: 4 draws."""
    freq = np.linspace(0.6, 22.0, 100)
    clean = updyn.response(chain12, freq, ["2:X", "5:X", "7:X", "12:X"], ["5:X"])
    unknowns = updyn.parameters(chain12, loss_factor="all")
    off = []
    for seed in range(4):
        noisy = add_noise(clean, np.random.default_rng(seed), 0.005, 3e-3)
        bad = replace(noisy, freq=freq / np.exp(0.02))
        (found,) = updyn.diagnose(chain12, bad, unknowns)
        assert found.kind == "frequency-scale"
        off.append(found.value - 0.02)
    # By the bound of Cramer and Rao 1.6e-5, with the loss factors unknown.
    assert np.sqrt(np.mean(np.square(off))) < 3e-5


@pytest.mark.parametrize("quantity", ["mobility", "accelerance"])
def test_a_sensor_of_another_quantity_is_found_and_repaired(
    chain12, clean, data, unknowns, add_noise, quantity
):
    other = add_noise(clean.converted(quantity), np.random.default_rng(5), 0.01)
    values = data.values.copy()
    values[:, 2] = other.values[:, 2]
    bad = replace(data, values=values)
    (found,) = updyn.diagnose(chain12, bad, unknowns)
    assert found.written == f"quantity:7:X={quantity}"
    assert found.statement == f"7:X is {quantity}, unlike the other channels."
    repaired = read_fault(found.written).repair(bad)
    assert repaired.quantity == "receptance"
    assert repaired.values[:, 2] == pytest.approx(other.converted("receptance").values[:, 2])
    assert np.array_equal(repaired.values[:, [0, 1, 3, 4]], data.values[:, [0, 1, 3, 4]])


def test_a_single_channel_is_not_converted_at_0_hz(clean):
    still = replace(clean, freq=np.append(0.0, clean.freq[1:]))
    with pytest.raises(DataError, match="no quantity is converted at 0 Hz"):
        read_fault("quantity:7:X=mobility").repair(still)


def test_modes_are_refused(chain12):
    found = updyn.modes(chain12, 3)
    with pytest.raises(OptionError, match="diagnose: expected FRFs, found ModeSet"):
        updyn.diagnose(chain12, updyn.ModeSet(found.frequency, found.shapes, found.dofs))


def test_values_without_weight_keep_none_and_do_not_count_as_noise(chain12_true, data, unknowns):
    noise = choose_noise(None, data)
    mask = np.zeros(data.values.shape[1:], dtype=bool)
    mask[1, 1] = True

    def weighted(frf):
        frf = remove_weight(with_variance(frf, noise), mask)
        part = FRFPart.build(chain12_true, frf, unknowns)
        trial = run_trial(part, None, [part.coordinates.start])
        return weight_by_noise(part, trial, noise).frf

    values = data.values.copy()
    values[:, mask] *= 5.0
    sound, wrong = weighted(data), weighted(replace(data, values=values))
    assert np.array_equal(find_weightless(wrong), np.broadcast_to(mask, data.values.shape))
    assert count_values(wrong) == 2 * 100 * 9
    found, expected = (one.variance[:, ~mask] for one in (wrong, sound))
    level = np.abs(wrong.values).max()
    np.testing.assert_allclose(found, expected, rtol=0.05, atol=(1e-5 * level) ** 2)
