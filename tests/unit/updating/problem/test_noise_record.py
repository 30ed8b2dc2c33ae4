"""A noise model made again from what a result tells of it."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.errors import OptionError
from updyn.updating.problem.noise import Robust, choose_noise, restore_noise


@pytest.fixture(scope="module")
def data(chain12_frf, add_noise):
    return add_noise(
        chain12_frf.select(references=["2:X", "12:X"]), np.random.default_rng(0), 0.02, 0.002
    )


def outlying(data):
    values = data.values.copy()
    values[17] *= 4.0
    return replace(data, values=values)


@pytest.mark.parametrize(
    "noise",
    [
        None,
        {"relative": 0.02, "floor": 0.001},
        "estimated-by-channel",
        {"robust": "student-t"},
        {"relative": 0.02, "robust": "student-t"},
        {"source": "estimated-by-channel", "robust": "student-t"},
        "coherence",
        "variance",
    ],
)
def test_the_variance_is_that_of_the_fit(chain12, chain12_true, data, noise):
    whole = replace(outlying(data), coherence=np.full(data.values.shape, 0.9), averages=20)
    if noise == "variance":
        whole = replace(whole, variance=(0.02 * np.abs(data.values)) ** 2)
    elif noise != "coherence":
        whole = replace(whole, coherence=None, averages=None)
    H = updyn.response(chain12_true, whole.freq, whole.responses, whole.references).values
    fitted = choose_noise(noise, whole).refit(H, whole, 12)
    record = {"kind": fitted.kind, **fitted.figures()}
    again = restore_noise(record, whole)
    assert isinstance(again, Robust) == isinstance(fitted, Robust)
    seen = again.refit(H, whole, 12)
    assert seen.variance(H, whole) == pytest.approx(fitted.variance(H, whole), rel=0.02)


def test_a_response_of_which_nothing_is_known(data):
    record = {
        "kind": "estimated",
        "relative_by_channel": {"2:+X": 0.1},
        "floor_by_channel": {"2:+X": 0.0},
    }
    with pytest.raises(OptionError, match="nothing is known of response"):
        restore_noise(record, data)


@pytest.mark.parametrize("method", ["log", "output-error"])
def test_fits_of_equal_weights_tell_the_spread_of_their_residual(chain12, data, method):
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    result = updyn.update(chain12, data, unknowns, method=method)
    H = updyn.response(result.model, data.freq, data.responses, data.references).values
    level = np.sqrt(np.mean(np.abs(data.values) ** 2))
    r = np.log(H / data.values) if method == "log" else (H - data.values) / level
    expected = np.sqrt(2.0 * np.sum(np.abs(r) ** 2) / (2 * r.size - 12))
    assert result.noise["spread"] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("noise", [{"robust": "student-t"}, "estimated-by-channel"])
def test_profiles_are_as_wide_as_the_fit_says(chain12, data, noise):
    """One outlier line would make the interval of a plain fit several times as wide."""
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    given = outlying(data) if isinstance(noise, dict) else data
    result = updyn.update(chain12, given, unknowns, noise=noise, starts=0)
    ((name, (low, high)),) = updyn.profile(result, [unknowns.names[0]]).intervals().items()
    assert (high - low) / (2 * 1.96 * result.std[name]) == pytest.approx(1.0, abs=0.05)
