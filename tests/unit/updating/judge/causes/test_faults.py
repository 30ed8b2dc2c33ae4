"""Each fault is undone exactly, and read back from how it is written."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError, SolverError
from updyn.updating.judge.causes.catalogue import CAUSES, read_fault

FREQ = np.linspace(1.0, 20.0, 40)


@pytest.fixture
def frf(chain12):
    return updyn.response(chain12, FREQ, ["2:X", "5:-X", "12:X"], ["5:X", "12:X"], "accelerance")


def omega(frf):
    return 2.0 * np.pi * frf.freq[:, None]


@pytest.mark.parametrize(
    ("written", "spoilt"),
    [
        ("sign:5:X", lambda H, w: H * [[[1.0], [-1.0], [1.0]]]),
        ("sign:force 12:X", lambda H, w: H * [[[1.0, -1.0]]]),
        ("sign", lambda H, w: -H),
        ("scale=9.80665", lambda H, w: 9.80665 * H),
        ("scale:2:X=1000", lambda H, w: H * [[[1000.0], [1.0], [1.0]]]),
        ("calibration:12:X=0.5", lambda H, w: H * [[[1.0], [1.0], [np.exp(0.5)]]]),
        (
            "delay:2:X=0.003",
            lambda H, w: np.concatenate(
                [H[:, :1] * np.exp(-0.003j * w)[..., None], H[:, 1:]], axis=1
            ),
        ),
        ("low-pass=0.004", lambda H, w: H / (1.0 + 0.004j * w)[..., None]),
        ("non-causal", lambda H, w: H.conj()),
        ("swapped:2:X,12:X", lambda H, w: H[:, [2, 1, 0]]),
        ("swapped:force 5:X,force 12:X", lambda H, w: H[:, :, [1, 0]]),
    ],
)
def test_what_was_spoilt_is_undone(frf, written, spoilt):
    bad = replace(frf, values=spoilt(frf.values, omega(frf)))
    good = read_fault(written).repair(bad)
    assert good.values == pytest.approx(frf.values, rel=1e-9)
    assert read_fault(written).repair_text == written


def test_a_size_beyond_the_range_of_numbers_cannot_be_corrected(frf):
    """Fits drop such a fault; the values of the data would not be finite."""
    fault = read_fault("calibration:12:X=0.5")
    bad = replace(frf, variance=np.full(frf.values.shape, 1e-4))
    assert np.isfinite(replace(fault, value=-290.0).repair(bad).variance).all()
    for size in (310.0, -310.0, np.inf, np.nan):
        with pytest.raises(SolverError, match="cannot be corrected by a factor of exp"):
            replace(fault, value=size).repair(bad)


def test_data_of_another_quantity_keep_their_numbers(frf):
    mislabelled = replace(frf.converted("mobility"), quantity="accelerance")
    good = read_fault("quantity=mobility").repair(mislabelled)
    assert good.quantity == "mobility"
    assert good.converted("accelerance").values == pytest.approx(frf.values, rel=1e-12)


def test_a_scaled_axis_is_stretched_back(frf):
    assert read_fault("frequency-scale=0.02").repair(frf).freq == pytest.approx(FREQ * np.exp(0.02))


def test_a_misplaced_sensor_gets_its_label(frf):
    found = read_fault("moved:5:X,6:X").repair(frf)
    assert found.responses.labels == ["2:X", "6:-X", "12:X"]
    assert found.values == pytest.approx(frf.values)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("sing:2:X", "sign"),
        ("sign:3:X", "3:X"),
        ("sign:force 2:X", "no reference"),
        ("calibration=much", "no number"),
        ("quantity=velocity", "velocity"),
        ("moved:5:X,2:X", "already"),
        ("moved:5:X", "two places"),
        ("swapped:5:X", "two sensors"),
        ("scale=0", "above 0"),
        ("mass-loading=0.1", "sensor_masses"),
    ],
)
def test_what_cannot_be_undone_is_refused_by_name(frf, written, said):
    with pytest.raises(updyn.UpdynError, match=said):
        read_fault(written).repair(frf)


def test_the_variance_goes_along(frf):
    known = replace(frf, variance=np.abs(frf.values) ** 2)
    good = read_fault("scale=10").repair(known)
    assert good.variance == pytest.approx(np.abs(good.values) ** 2)
    swapped = read_fault("swapped:2:X,5:X").repair(known)
    assert swapped.variance == pytest.approx(np.abs(swapped.values) ** 2)


def test_an_unknown_kind_names_the_nearest():
    with pytest.raises(OptionError, match="swapped"):
        read_fault("swaped:1:X,2:X")


def test_every_kind_is_registered_by_its_name():
    assert all(CAUSES[kind].kind == kind for kind in CAUSES)


def test_data_through_a_window_are_compared_where_they_are(chain12, add_noise):
    """The repair states the decay and leaves the values; a model is then evaluated there."""
    slow = updyn.response(chain12, FREQ, ["2:X", "5:X", "12:X"], ["5:X"], decay=1.1)
    as_measured = updyn.FRF(FREQ, slow.values, slow.responses, slow.references, slow.quantity)
    repaired = read_fault("window-damping=1.1").repair(as_measured)
    assert repaired.decay == 1.1
    assert (repaired.values == slow.values).all()
    assert updyn.correlate(chain12, repaired).relative_residual.max() < 1e-10
    noisy = add_noise(slow, np.random.default_rng(2), 0.005)
    start = chain12.scaled({name: {"stiffness": 1.15} for name in chain12.groups})
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    (found,) = updyn.diagnose(start, noisy, unknowns)
    assert found.kind == "window-damping"
    assert found.value == pytest.approx(1.1, rel=0.05)
    assert not updyn.diagnose(start, found.repair(noisy), unknowns)
