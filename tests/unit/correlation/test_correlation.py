"""Correlation metrics: known values, invariances, refusals."""

from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn import correlation as co
from updyn.errors import DataError, DofError

RNG = np.random.default_rng(3)
A = RNG.standard_normal((7, 4)) + 1j * RNG.standard_normal((7, 4))
H = RNG.standard_normal((9, 3, 2)) + 1j * RNG.standard_normal((9, 3, 2))


# -- shapes -----------------------------------------------------------------------------------------------------
def test_mac_known_values():
    a = np.array([[1.0, 1.0], [0.0, 1.0]])
    b = np.array([[0.0, 3.0, 1.0], [2.0, 0.0, 1j]])
    assert co.mac(a, b) == pytest.approx(np.array([[0.0, 1.0, 0.5], [0.5, 0.5, 0.5]]), abs=1e-15)
    assert co.mac([1.0, 2.0], [2.0, 1.0]) == pytest.approx(np.array([[16 / 25]]))


def test_mac_is_blind_to_scale_and_phase_only():
    factors = np.array([2.0, -3e200, 1e-200j, 0.5 + 0.5j])
    assert np.diag(co.mac(A, A * factors)) == pytest.approx(np.ones(4), abs=1e-14)
    assert co.mac(A, A * factors) == pytest.approx(co.auto_mac(A), abs=1e-13)
    assert co.auto_mac(A) == pytest.approx(co.auto_mac(A).T)
    assert np.diag(co.mac(A, A.conj())).max() < 0.99


def test_cross_orthogonality_of_modes_of_one_structure():
    M = np.diag([1.0, 2.0, 3.0])
    K = np.array([[3.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.5]])
    root = np.sqrt(np.diag(M))
    shapes = np.linalg.eigh(K / np.outer(root, root))[1] / root[:, None]
    found = co.cross_orthogonality(shapes, M, shapes * [2.0, -5.0, 0.1])
    assert found == pytest.approx(np.diag([1.0, -1.0, 1.0]), abs=1e-14)
    from scipy.sparse import csr_array

    assert co.cross_orthogonality(shapes, csr_array(M), shapes) == pytest.approx(
        np.eye(3), abs=1e-14
    )


def test_pairing_of_swapped_modes_is_the_best_in_sum():
    order = np.array([2, 0, 3, 1])
    noisy = A[:, order] * (2 - 1j) + 0.01 * RNG.standard_normal((7, 4))
    pairs = co.pair_modes(A, noisy)
    assert (pairs.first == np.arange(4)).all()
    assert (order[pairs.second] == pairs.first).all()
    assert pairs.mac.min() > 0.99
    # Taking the best partner row by row gives 0.90 + 0.36; the assignment finds 0.80 + 0.98.
    s, c = np.sqrt([0.1, 0.9])
    a = np.array([[1.0, np.sqrt(0.8)], [0.0, np.sqrt(0.2)]])
    b = np.array([[c, np.sqrt(0.8)], [s, -np.sqrt(0.2)]])
    values = co.mac(a, b)
    assert values[0, 0] == pytest.approx(0.9)
    found = co.pair_modes(a, b)
    assert found.mac == pytest.approx([0.8, (np.sqrt(0.72) + np.sqrt(0.02)) ** 2])
    assert (found.second == [1, 0]).all()


def test_pairing_leaves_out_what_has_no_partner():
    a = np.eye(5)[:, :3]
    b = np.eye(5)[:, [1, 4]]
    assert len(co.pair_modes(a, b).mac) == 2
    pairs = co.pair_modes(a, b, minimum=0.5)
    assert (pairs.first.tolist(), pairs.second.tolist(), pairs.mac.tolist()) == ([1], [0], [1.0])


def test_comac_points_at_the_wrong_sensor():
    B = A * np.array([1.0, -2.0, 1j, 0.3])
    assert co.comac(A, B) == pytest.approx(np.ones(7), abs=1e-14)
    assert co.ecomac(A, B) == pytest.approx(np.zeros(7), abs=1e-14)
    flipped = B.copy()
    flipped[4] *= -1
    # A wrong sign is invisible to COMAC (moduli only) and the strongest error to ECOMAC.
    assert co.comac(A, flipped) == pytest.approx(np.ones(7), abs=1e-14)
    assert co.ecomac(A, flipped).argmax() == 4
    swapped = B.copy()
    swapped[[1, 2]] = swapped[[2, 1]]
    assert set(np.argsort(co.comac(A, swapped))[:2]) == {1, 2}


def test_comac_and_ecomac_known_values():
    a = np.array([[0.6, 0.8], [0.8, 0.6]])
    b = np.array([[1.0, 0.0], [0.0, 1.0]])
    # DOF 1: (0.6 + 0)^2 / ((0.36 + 0.64) * 1); DOF 2: (0 + 0.6)^2 / 1.
    assert co.comac(a, b) == pytest.approx([0.36, 0.36])
    # |a - b| / 4: DOF 1: (0.4 + 0.8) / 4, DOF 2: (0.8 + 0.4) / 4.
    assert co.ecomac(a, b) == pytest.approx([0.3, 0.3])
    still = np.array([[0.0, 0.0], [1.0, 1.0]])
    assert co.comac(still, still) == pytest.approx([0.0, 1.0])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: co.mac(np.ones((3, 1)), np.ones((4, 1))), "shapes at 3 and at 4 DOFs"),
        (lambda: co.mac(np.ones((3, 2)) * [1, 0], np.ones((3, 1))), "A: shape 2 is zero"),
        (
            lambda: co.mac(np.full((3, 1), np.nan), np.ones((3, 1))),
            "shape 1 holds a number not finite",
        ),
        (lambda: co.mac(np.ones((2, 2, 2)), np.ones((3, 1))), "expected shapes as columns"),
        (lambda: co.mac(["a"], [1.0]), "expected numbers"),
        (lambda: co.comac(np.ones((3, 1)), np.ones((3, 2))), "expected paired modes"),
        (lambda: co.cross_orthogonality(np.ones(3), np.eye(2), np.ones(3)), "mass of shape"),
        (
            lambda: co.cross_orthogonality(np.ones(2), np.zeros((2, 2)), np.ones(2)),
            "shape 1 of A moves no mass",
        ),
        (lambda: co.frac(H, H[:, :2]), "expected the same lines, responses and references"),
        (lambda: co.frf_correlation(H, H[:5]), "expected the same lines, responses and references"),
        (lambda: co.relative_residual(H * np.nan, H), "HX: line 1, .* is not finite"),
        (lambda: co.csac(H, H * np.inf), "HA: line 1, response 1, reference 1 is not finite"),
        (lambda: co.fdac(H, H[:, :, :1]), "expected the same lines, responses and references"),
        (lambda: co.csf(H[0], H[0]), "expected \\(lines, responses, references\\)"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_bad_arrays_are_refused(call, message):
    with pytest.raises(DataError, match=message):
        call()


# -- frequency response functions --------------------------------------------------------------------------------
def test_identical_functions_agree_fully():
    assert co.frac(H, H) == pytest.approx(np.ones((3, 2)))
    assert co.csac(H, H) == pytest.approx(np.ones(9))
    assert co.csf(H, H) == pytest.approx(np.ones(9))
    assert (co.db_error(H, H) == 0.0).all()
    assert np.diag(co.fdac(H, H)) == pytest.approx(np.ones(9))


def test_what_each_metric_is_blind_to():
    channel = np.array([[2.0, -1.0], [0.5, 1j], [3.0, 1 + 1j]])
    assert co.frac(H, H * channel) == pytest.approx(np.ones((3, 2)))  # a gain error of a channel
    line = np.exp(1j * np.arange(9)) * np.arange(1, 10)
    assert co.csac(H, H * line[:, None, None]) == pytest.approx(
        np.ones(9)
    )  # a factor common to a line
    assert co.csf(H, H * np.exp(1j * np.arange(9))[:, None, None]) == pytest.approx(np.ones(9))
    assert co.csf(H, 3 * H) == pytest.approx(np.full(9, 2 * 3 / (1 + 9)))
    assert co.db_error(H, -10j * H) == pytest.approx(np.full(H.shape, 20.0))
    assert co.db_error(H, H / 2) == pytest.approx(np.full(H.shape, 20 * np.log10(2)))


def test_sign_and_phase_are_seen():
    """What FRAC, CSAC and CSF score as 1: one channel of one reference with a factor of modulus 1."""
    hx = H[:, :1, :1]
    for factor, correlation, residual in (
        (-1.0, -1.0, 2.0),
        (1j, 0.0, np.sqrt(2.0)),
        (-1j, 0.0, np.sqrt(2.0)),
        (np.exp(1j * np.pi / 3), 0.5, 1.0),
    ):
        for blind in (co.frac, co.csac, co.csf):
            assert blind(hx, factor * hx) == pytest.approx(1.0)
        assert co.frf_correlation(hx, factor * hx) == pytest.approx(correlation, abs=1e-12)
        assert co.relative_residual(hx, factor * hx) == pytest.approx(residual)


def test_a_wrong_level_is_a_residual_but_no_lack_of_correlation():
    for factor, residual in ((1.1, 0.1), (0.25, 0.75), (3.0, 2.0)):
        assert co.frf_correlation(H, factor * H) == pytest.approx(np.ones((3, 2)))
        assert co.relative_residual(H, factor * H) == pytest.approx(np.full((3, 2), residual))


def test_residual_follows_from_correlation_and_level():
    ha = H + 0.3 * RNG.standard_normal(H.shape)
    r, e = co.frf_correlation(H, ha), co.relative_residual(H, ha)
    g = np.sqrt(np.sum(np.abs(ha) ** 2, axis=0) / np.sum(np.abs(H) ** 2, axis=0))
    assert e**2 == pytest.approx(1.0 - 2.0 * r * g + g**2)
    assert (r**2 <= co.frac(H, ha)).all()


def test_known_values():
    hx = np.array([[[1.0, 0.0]], [[1.0, 2.0]]])
    ha = np.array([[[1.0, 1.0]], [[1j, 2.0]]])
    # Column 1: |1 + i|^2 / (2 * 2); column 2: |0 + 4|^2 / (4 * 5).
    assert co.frac(hx, ha) == pytest.approx(np.array([[0.5, 0.8]]))
    # Column 1: Re(1 + i) / 2; column 2: 4 / sqrt(4 * 5).
    assert co.frf_correlation(hx, ha) == pytest.approx(np.array([[0.5, 2 / np.sqrt(5)]]))
    # Column 1: sqrt((0 + |i - 1|^2) / 2); column 2: sqrt((1 + 0) / 4).
    assert co.relative_residual(hx, ha) == pytest.approx(np.array([[1.0, 0.5]]))
    # Line 1: 1 / (1 * 2), line 2: |i + 4|^2 / (5 * 5).
    assert co.csac(hx, ha) == pytest.approx([0.5, 17 / 25])
    assert co.csf(hx, ha) == pytest.approx([2 / 3, 2 * np.sqrt(17) / 10])
    # Row computed, column measured; here computed line 2 with measured line 1: |1j|^2 / (5 * 1).
    assert co.fdac(hx, ha) == pytest.approx(np.array([[0.5, 9 / 10], [1 / 5, 17 / 25]]))
    assert co.fdac(hx[:1], ha).shape == (2, 1)


def test_fdac_ridge_follows_a_frequency_shift():
    f = np.linspace(1, 20, 96)

    def base(x):
        modes = [1 / (25 - x**2 + 0.5j), 1 / (64 - x**2 + 0.8j), 1 / (196 - x**2 + 1j)]
        return np.stack(modes, -1)[:, :, None]

    shifted = co.fdac(base(f), base(f / 1.1))  # the computed one comes 10 % higher
    lines = f[np.argmax(shifted[20:80], axis=1)]
    assert lines == pytest.approx(f[20:80] / 1.1, abs=0.11)


def test_silent_channels_give_documented_values_never_nan():
    quiet = H.copy()
    quiet[:, 1] = 0.0
    assert (co.frac(quiet, H)[1] == 0.0).all()
    assert (co.frac(quiet, quiet)[1] == 0.0).all()
    assert (co.frf_correlation(quiet, H)[1] == 0.0).all()
    assert (co.frf_correlation(quiet, quiet)[1] == 0.0).all()
    assert (co.relative_residual(quiet, quiet) == 0.0).all()
    assert (co.relative_residual(H, quiet)[1] == 1.0).all()
    residual = co.relative_residual(quiet, H)
    assert np.isinf(residual[1]).all()
    assert (residual[[0, 2]] == 0.0).all()
    nothing = np.zeros_like(H)
    assert (co.csac(nothing, H) == 0.0).all()
    assert (co.csf(nothing, nothing) == 0.0).all()
    assert (co.fdac(nothing, H) == 0.0).all()
    error = co.db_error(quiet, H)
    assert np.isinf(error[:, 1]).all()
    assert np.isfinite(error[:, [0, 2]]).all()
    assert (co.db_error(quiet, quiet)[:, 1] == 0.0).all()


# -- correlate ------------------------------------------------------------------------------------------------------
def two_masses(k=1000.0):
    group = updyn.Group([[2 * k, -k], [-k, k]], np.diag([1.0, 2.0]), loss_factor=0.05)
    return updyn.Model.from_groups({"g": group}, ["1:Z", "2:Z"])


FREQ = np.linspace(1.0, 12.0, 40)


def test_a_model_against_its_own_response():
    frf = updyn.response(two_masses(), FREQ, ["2:Z", "1:-Z"], ["2:-Z"], "mobility")
    found = updyn.correlate(two_masses(), frf)
    assert found.figures() == pytest.approx(
        {
            "frac_median": 1,
            "frac_min": 1,
            "correlation_median": 1,
            "correlation_min": 1,
            "residual_median": 0,
            "residual_max": 0,
            "csac_mean": 1,
            "csf_mean": 1,
            "db_error_median": 0,
            "db_error_p95": 0,
        },
        abs=1e-9,
    )
    assert all(type(v) is float for v in found.figures().values())
    assert found.computed.quantity == "mobility"
    assert found.frac.shape == (2, 1)
    assert found.frf_correlation.shape == found.relative_residual.shape == (2, 1)
    assert not found.relative_residual.flags.writeable
    assert found.csac.shape == found.csf.shape == found.freq.shape == (40,)
    assert found.db_error.shape == (40, 2, 1)
    assert found.responses.labels == ["2:Z", "1:-Z"]
    assert found.references.labels == ["2:-Z"]


def test_figures_of_a_changed_model_are_those_of_the_arrays():
    measured = updyn.response(two_masses(), FREQ, ["1:Z", "2:Z"], ["1:Z", "2:Z"])
    computed = updyn.response(two_masses(1200.0), FREQ, ["1:Z", "2:Z"], ["1:Z", "2:Z"])
    found = updyn.correlate(two_masses(1200.0), measured)
    x, a = measured.values, computed.values
    level = np.abs(20 * np.log10(np.abs(a) / np.abs(x)))
    assert found.db_error == pytest.approx(level, rel=1e-9)
    figures = found.figures()
    assert figures["db_error_median"] == pytest.approx(np.median(level))
    assert (
        figures["db_error_p95"]
        == np.sort(found.db_error.ravel())[int(np.ceil(0.95 * level.size)) - 1]
    )
    for i in range(2):
        for j in range(2):
            one = np.abs(np.vdot(x[:, i, j], a[:, i, j])) ** 2
            one /= np.vdot(x[:, i, j], x[:, i, j]).real * np.vdot(a[:, i, j], a[:, i, j]).real
            assert found.frac[i, j] == pytest.approx(one)
    assert figures["frac_min"] < figures["frac_median"] < 0.9
    by = found.by_response()
    assert list(by) == ["1:Z", "2:Z"]
    assert by["2:Z"]["db_error_median"] == pytest.approx(np.median(level[:, 1]))
    assert found.fdac().shape == (40, 40)
    assert found.fdac(FREQ[[3, 7]]) == pytest.approx(found.fdac()[np.ix_([3, 7], [3, 7])])
    with pytest.raises(DataError, match=r"3\.3 Hz is not in the data"):
        found.fdac([3.3])


def test_a_sensor_of_the_wrong_sign_is_found_in_the_figures():
    measured = updyn.response(two_masses(), FREQ, ["1:Z", "2:Z"], ["1:Z"])
    flipped = updyn.FRF(
        measured.freq,
        measured.values * np.array([1.0, -1.0])[:, None],
        ["1:Z", "2:Z"],
        ["1:Z"],
        "receptance",
    )
    found = updyn.correlate(two_masses(), flipped)
    figures = found.figures()
    assert figures["frac_min"] == pytest.approx(1.0)
    assert (figures["correlation_median"], figures["correlation_min"]) == pytest.approx(
        (0.0, -1.0), abs=1e-9
    )
    assert (figures["residual_median"], figures["residual_max"]) == pytest.approx((1.0, 2.0))
    by = found.by_response()
    assert by["1:Z"]["residual_max"] == pytest.approx(0.0, abs=1e-9)
    assert by["2:Z"]["correlation_median"] == by["2:Z"]["correlation_min"] == pytest.approx(-1.0)
    assert by["2:Z"]["residual_median"] == pytest.approx(2.0)


def test_what_symmetry_forbids_does_not_count_in_the_figures():
    """Rounding against rounding agrees in nothing; a channel that one side alone hears does count."""
    frf = updyn.response(two_masses(), [0.5, 1.5, 3.0, 4.5], ["1:Z", "2:Z"], ["1:Z", "2:Z"])
    measured, computed, silent = (frf.values.copy() for _ in range(3))
    measured[:, 1, 0] = 1e-13 * RNG.standard_normal(4) * np.abs(frf.values).max()
    computed[:, 1, 0] = 1e-13 * RNG.standard_normal(4) * np.abs(frf.values).max()
    silent[:, 1, 0] = 0.0
    other = updyn.correlate(replace(frf, values=computed), replace(frf, values=measured))
    assert other.heard.tolist() == [[True, True], [False, True]]
    assert other.figures()["frac_min"] == pytest.approx(1.0)
    assert other.figures()["residual_max"] == other.figures()["db_error_p95"] == 0.0
    assert other.by_response()["2:Z"]["frac_min"] == pytest.approx(1.0)
    for a, b in ((silent, frf.values), (frf.values, silent)):
        one_sided = updyn.correlate(replace(frf, values=a), replace(frf, values=b))
        assert one_sided.heard.all()
        assert one_sided.figures()["frac_min"] == 0.0


def test_two_frfs_with_other_order_signs_and_quantity():
    measured = updyn.response(two_masses(), FREQ, ["1:Z", "2:Z"], ["2:Z"], "accelerance")
    computed = updyn.response(two_masses(), FREQ, ["2:-Z", "1:Z"], ["2:-Z"])
    found = updyn.correlate(computed, measured)
    assert found.computed.values == pytest.approx(measured.values, rel=1e-9)
    assert found.figures()["csf_mean"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda f: f.select(band=(1, 6)),
            "differ in lines: 18 lines, 1-5.79487 Hz and 40 lines, 1-12 Hz",
        ),
        (
            lambda f: updyn.FRF(f.freq * 1.001, f.values, f.responses, f.references, f.quantity),
            r"line 1 is 1\.001 Hz and 1 Hz",
        ),
        (lambda f: f.select(responses=["1:Z"]), r"response 2:Z is not in the first \(1 such\)"),
    ],
)
def test_two_frfs_that_differ_say_where(change, message):
    frf = updyn.response(two_masses(), FREQ, ["1:Z", "2:Z"], ["2:Z"])
    with pytest.raises(DataError, match=message):
        updyn.correlate(change(frf), frf)
    more = frf.select(responses=["1:Z"])
    with pytest.raises(DataError, match="response 2:Z is not in the second"):
        updyn.correlate(frf, more)


def test_what_is_neither_model_nor_frf_is_refused():
    frf = updyn.response(two_masses(), FREQ, ["1:Z"], ["2:Z"])
    with pytest.raises(DataError, match="expected a Model or an FRF, found ndarray"):
        updyn.correlate(frf.values, frf)
    with pytest.raises(DataError, match="expected a measured FRF, found Model"):
        updyn.correlate(frf, two_masses())
    with pytest.raises(DofError, match="response 7:Z is not among"):
        updyn.correlate(
            two_masses(), updyn.FRF([1.0], np.ones((1, 1, 1)), ["7:Z"], ["1:Z"], "mobility")
        )


def test_a_line_on_which_both_are_zero_does_not_count_in_the_means(chain12, chain12_true):
    """Accelerances at 0 Hz."""
    at = (np.linspace(0.0, 20.0, 21), ["2:X", "7:X"], ["12:X"], "accelerance")
    model, measured = updyn.response(chain12, *at), updyn.response(chain12_true, *at)
    assert not measured.values[0].any()
    found = updyn.correlate(model, measured).figures()
    moving = measured.select(lines=measured.freq[1:])
    expected = updyn.correlate(model.select(lines=moving.freq), moving).figures()
    for name in ("csac_mean", "csf_mean"):
        assert found[name] == pytest.approx(expected[name], rel=1e-12)
    silent = updyn.correlate(model.select(lines=[0.0]), measured.select(lines=[0.0])).figures()
    assert silent["csac_mean"] == 0.0
