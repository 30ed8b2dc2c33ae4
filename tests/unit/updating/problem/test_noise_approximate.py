"""A search weighs values that an approximate model does not resolve less; the noise stays as it is."""

import numpy as np

import updyn
from updyn.updating.problem.noise import Approximate, Estimated, Stated
from updyn.updating.problem.residuals import noise_weights

VALUES = np.array([[[4.0 + 3.0j], [1e-3]], [[10.0], [2e-2j]]])
SHARE = np.array([[1e-4], [2e-4]])


def frf() -> updyn.FRF:
    return updyn.FRF([1.0, 2.0], VALUES, ["1:X", "2:X"], ["1:X"], "receptance")


def test_the_error_of_the_model_counts_as_a_share_of_the_largest_of_a_line() -> None:
    base = Stated(0.01, 0.0)
    added = Approximate(base, SHARE).initial_variance(frf()) - base.initial_variance(frf())
    expected = [[[5e-4**2], [1e-3**2]], [[1e-3**2], [2e-3**2]]]
    np.testing.assert_allclose(added, expected, rtol=1e-9)


def test_a_channel_that_is_not_resolved_weighs_little() -> None:
    data = frf()
    plain = noise_weights(VALUES, Stated(0.001, 0.0).initial_variance(data), data)
    rough = noise_weights(
        VALUES, Approximate(Stated(0.001, 0.0), SHARE).initial_variance(data), data
    )
    np.testing.assert_allclose(rough[:, 0], plain[:, 0], rtol=1e-3)
    assert rough[0, 1, 0] == 0.0  # its error is as large as the value
    assert (plain[:, 1] > 0.99).all()


def test_the_noise_itself_is_that_of_the_base() -> None:
    data, base = frf(), Stated(0.02, 0.003)
    made, H = Approximate(base, SHARE), 1.1 * VALUES
    np.testing.assert_array_equal(made.variance(H, data), base.variance(H, data))
    assert made.negative_log_likelihood(H, data) == base.negative_log_likelihood(H, data)
    assert (made.kind, made.source, made.scale_known) == (base.kind, base.source, True)
    assert made.figures() == base.figures() == {"relative": 0.02, "floor": 0.003}


def test_refitting_keeps_the_error_of_the_model() -> None:
    lines = 1.0 + np.arange(50)
    rng = np.random.default_rng(0)
    H = 1.0 + rng.uniform(size=(50, 2, 1)) + 0j
    draw = rng.standard_normal((2, *H.shape))
    data = updyn.FRF(
        lines, H * (1 + 0.01 * (draw[0] + 1j * draw[1])), ["1:X", "2:X"], ["1:X"], "receptance"
    )
    base = Estimated.of_data(data)
    found = Approximate(base, SHARE).refit(H, data, 4)
    assert found.share is SHARE
    assert found.figures() == base.refit(H, data, 4).figures()
