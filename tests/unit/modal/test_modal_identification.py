"""Modes from FRFs: exact on exact data of either damping, close and repeated modes, noise, the measured beam."""

from __future__ import annotations

import contextlib
import copy
from importlib import resources
from typing import Any

import numpy as np
import pytest

import updyn
from updyn.correlation import mac
from updyn.errors import DataError, OptionError
from updyn.modal import ModeSet, identify_modes


def chain(n: int, **damping: Any) -> updyn.Model:
    """Equal springs, masses from 1 to 2 kg; ``loss_factor``, or ``viscous`` as a share of the stiffness."""
    K = 1e6 * (2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = 1e6
    share = damping.pop("viscous", None)
    group = updyn.Group(
        K,
        np.diag(np.linspace(1.0, 2.0, n)),
        viscous=None if share is None else share * K,
        **damping,
    )
    return updyn.Model.from_groups({"all": group}, [f"{i + 1}:X" for i in range(n)])


def plane(difference: float) -> updyn.Model:
    """A chain in X and the same in Y, stiffer by a share: pairs of close, or equal, modes."""
    K, M = np.zeros((6, 6)), np.diag([1.0, 2.0, 1.0] * 2)
    for start, k in ((0, 1e6), (3, 1e6 * (1.0 + difference))):
        at = slice(start, start + 3)
        K[at, at] = k * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    group = updyn.Group(K, M, loss_factor=0.01)
    return updyn.Model.from_groups({"all": group}, [f"{i}:{d}" for d in "XY" for i in (1, 2, 3)])


def agrees(found: ModeSet, model: updyn.Model, rel: float) -> None:
    true = updyn.modes(model, len(found))
    assert found.frequency == pytest.approx(true.frequency, rel=rel)
    assert found.loss_factor == pytest.approx(true.loss_factor, rel=1e3 * rel)
    shapes = true.at(found.dofs)
    turned = shapes * np.sign(np.sum(shapes * found.real_shapes, axis=0))
    assert found.scaled.all()
    assert found.real_shapes == pytest.approx(
        turned, rel=1e3 * rel, abs=1e3 * rel * np.abs(shapes).max()
    )


LINES = np.linspace(5.0, 300.0, 300)


@pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
@pytest.mark.parametrize(
    ("damping", "model"),
    [("structural", chain(6, loss_factor=0.01)), ("viscous", chain(6, viscous=2e-5))],
    ids=["structural", "viscous"],
)
def test_exact_data_give_exact_modes(damping: str, model: updyn.Model, quantity: str) -> None:
    """Frequencies, loss factors, shapes of unit modal mass; signs of sensors; a reference that is no response."""
    frf = updyn.response(model, LINES, ["1:X", "3:-X", "6:X"], ["3:X", "4:X"], quantity)
    found = identify_modes(frf, damping=damping)
    assert found.dofs.labels == ["1:X", "3:-X", "6:X", "4:X"]
    assert len(found) == 6
    agrees(found, model, 1e-9)
    assert found.phase_collinearity == pytest.approx(np.ones(6), abs=1e-9)
    assert found.quality == pytest.approx(np.ones(6), abs=1e-9)


@pytest.mark.kernels
@pytest.mark.parametrize("damping", ["structural", "viscous"])
@pytest.mark.parametrize("loss", [0.0, 0.02])
def test_one_mode_alone(damping: str, loss: float) -> None:
    """Fewer poles than the fit begins with; a 0 Hz line; no damping at all."""
    group = updyn.Group(np.array([[1e4]]), np.array([[2.0]]), loss_factor=loss)
    model = updyn.Model.from_groups({"all": group}, ["1:X"])
    found = identify_modes(
        updyn.response(model, np.linspace(0.0, 50.0, 60), ["1:X"], ["1:X"]), damping=damping
    )
    assert len(found) == 1
    # One form of damping taken for the other: as near as its square.
    assert found.frequency == pytest.approx(updyn.modes(model, 1).frequency, rel=1e-9 + loss**2)
    assert found.loss_factor == pytest.approx([loss], abs=1e-9 + 0.05 * loss)
    assert np.abs(found.shapes[0, 0]) == pytest.approx(np.sqrt(0.5), rel=1e-9 + loss)


@pytest.mark.parametrize("n", [4, 5, 7, 10, 14])
def test_few_lines_are_an_error_or_modes_but_no_accident(n: int) -> None:
    for band in (np.linspace(1.0, 300.0, n), np.geomspace(1.0, 300.0, n)):
        frf = updyn.response(
            chain(6, loss_factor=0.01), band, ["1:X", "3:X", "6:X"], ["1:X"], "accelerance"
        )
        for damping in ("structural", "viscous"):
            with contextlib.suppress(DataError):
                assert len(identify_modes(frf, damping=damping)) <= 6


def test_modes_outside_the_band_do_not_disturb() -> None:
    model = chain(6, loss_factor=0.01)
    frf = updyn.response(model, LINES, ["1:X", "3:X", "6:X"], ["1:X"], "accelerance")
    agrees(identify_modes(frf, band=(5.0, 215.0)), model, 1e-6)


@pytest.mark.parametrize("difference", [0.01, 1e-3, 1e-4])
def test_close_modes(difference: float) -> None:
    """Pairs 0.5, 0.05 and 0.005 % apart, of 1 % loss factor."""
    model = plane(difference)
    frf = updyn.response(model, LINES, model.dofs, ["1:X", "1:Y"], "accelerance")
    found = identify_modes(frf)
    assert len(found) == 6
    agrees(found, model, 1e-7)


def test_repeated_modes() -> None:
    """Pairs of equal frequency: shapes span the right space, orthonormal by the mass."""
    model = plane(0.0)
    found = identify_modes(updyn.response(model, LINES, model.dofs, ["1:X", "1:Y"], "accelerance"))
    assert found.frequency == pytest.approx(updyn.modes(model, 6).frequency, rel=1e-9)
    gram = found.shapes.T @ model.mass.toarray() @ found.shapes
    assert gram == pytest.approx(np.eye(6), abs=1e-8)


@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_noise_is_no_mode(noise: float, add_noise: Any) -> None:
    model = chain(6, loss_factor=0.02)
    exact = updyn.response(model, LINES, ["1:X", "3:X", "6:X"], ["1:X", "6:X"], "accelerance")
    for seed in range(3):
        found = identify_modes(add_noise(exact, np.random.default_rng(seed), noise))
        true = updyn.modes(model, 6)
        assert len(found) == 6
        assert found.frequency == pytest.approx(true.frequency, rel=0.03 * noise)
        assert found.loss_factor == pytest.approx(true.loss_factor, rel=4.0 * noise)
        assert (found.quality > 1.0 - 10.0 * noise**2).all()
        assert (found.quality < 1.0).all()


def test_without_a_drive_point_shapes_are_unscaled() -> None:
    model = chain(4, loss_factor=0.01)
    true = updyn.modes(model, 4)
    roving_sensor = updyn.response(model, LINES, ["1:X", "2:X", "3:X"], ["4:X"], "receptance")
    roving_hammer = updyn.response(model, LINES, ["4:X"], ["1:X", "2:X", "3:X"], "receptance")
    for frf in (roving_sensor, roving_hammer):
        found = identify_modes(frf)
        assert not found.scaled.any()
        assert found.dofs.labels == ["1:X", "2:X", "3:X"]
        assert found.frequency == pytest.approx(true.frequency, rel=1e-9)
        assert np.diag(mac(found.shapes, true.at(found.dofs))) == pytest.approx(
            np.ones(4), abs=1e-9
        )


def test_the_measured_beam() -> None:
    """Seven bending modes, known from another identification (of the source, with its lines one lower: 1 Hz at 0).

    The highest line of the first peak is at 177.03 Hz; that identification says 176.07, the others
    lie within 0.3 %."""
    path = resources.files("updyn.demos") / "data" / "ladisk_beam.uff"
    frf = updyn.read_frf(str(path))
    found = identify_modes(frf, band=(60.0, 5000.0))
    bending = [
        int(np.abs(found.frequency - f).argmin()) for f in (176, 476, 932, 1535, 2286, 3162, 4182)
    ]
    expected = np.array([176.07, 476.46, 932.29, 1534.79, 2286.32, 3162.16, 4181.72])
    assert found.frequency[bending[1:]] == pytest.approx(expected[1:], rel=0.003)
    assert found.frequency[bending[0]] == pytest.approx(expected[0], rel=0.006)
    peak = frf.select(band=(150.0, 200.0))
    highest = peak.freq[np.argmax(np.sum(np.abs(peak.values) ** 2, axis=(1, 2)))]
    assert found.frequency[bending[0]] == pytest.approx(highest, rel=1e-3)
    # Loss factors of 0.3 to 0.6 %, 1.75 % in mode 1 (supports).
    assert found.loss_factor[bending[0]] == pytest.approx(0.0175, rel=0.02)
    assert (found.loss_factor[bending[1:]] > 0.0028).all()
    assert (found.loss_factor[bending[1:]] < 0.006).all()
    assert (found.phase_collinearity[bending] > 0.95).all()
    assert (found.quality[bending] > 0.98).all()
    others = np.delete(found.frequency, bending)
    # Peaks of the second singular value, and three bumps of single channels; splits of one mode, hit
    # by hit, are no modes.
    assert others == pytest.approx([569.9, 1019.1, 1142.7, 1376.7, 2783.5], rel=1e-3)


def test_is_deterministic() -> None:
    frf = updyn.response(chain(4, loss_factor=0.01), LINES, ["1:X", "3:X"], ["1:X"], "receptance")
    assert identify_modes(frf).digest == identify_modes(frf).digest


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"damping": "structral"}, OptionError, "damping 'structral': did you mean 'structural'"),
        ({"band": (5.0, 7.0)}, DataError, "3 lines are too few to identify a mode"),
        ({"band": (LINES[9], LINES[9] + 0.1)}, DataError, "1 line is too few to identify a mode"),
    ],
)
def test_bad_input_is_refused(
    options: dict[str, Any], error: type[Exception], message: str
) -> None:
    frf = updyn.response(chain(4, loss_factor=0.01), LINES, ["1:X"], ["1:X"], "receptance")
    with pytest.raises(error, match=message):
        identify_modes(frf, **options)


def test_no_mode_in_noise() -> None:
    rng = np.random.default_rng(0)
    values = rng.standard_normal((200, 2, 1)) + 1j * rng.standard_normal((200, 2, 1))
    frf = updyn.FRF(np.linspace(1, 100, 200), values, ["1:X", "2:X"], ["1:X"], "accelerance")
    with pytest.raises(DataError, match="found none between 1 and 100 Hz"):
        identify_modes(frf)


@pytest.mark.parametrize("pole", [np.nan, np.inf, 0.0, -3.0, True, "6.4"])
def test_a_pole_that_is_picked_is_a_frequency(pole: Any) -> None:
    data = updyn.response(chain(3, loss_factor=0.01), [1.0, 2.0, 3.0, 4.0], ["1:X"], ["1:X"])
    with pytest.raises(
        DataError, match=f"poles: expected frequencies in Hz above 0, found {pole!r}"
    ):
        identify_modes(data, poles=[pole])


# -- ModeSet ---------------------------------------------------------------------------------------------------------
def test_mode_set_is_sorted_and_selected() -> None:
    modes = ModeSet(
        [20.0, 10.0], [[1.0, 2.0], [3.0, 4.0j]], ["1:X", "2:X"], [0.02, 0.01], scaled=[True, False]
    )
    assert modes.frequency.tolist() == [10.0, 20.0]
    assert modes.shapes[:, 0].tolist() == [2.0, 4.0j]
    assert modes.damping.tolist() == [0.005, 0.01]
    assert modes.scaled.tolist() == [False, True]
    assert np.isnan(modes.quality).all()
    assert modes.select(band=(15.0, 30.0)).frequency.tolist() == [20.0]
    assert modes.select([0]).shapes[:, 0].tolist() == [2.0, 4.0j]
    assert modes.select([0, 1]).digest == modes.digest
    assert modes.phase_collinearity == pytest.approx([0.36, 1.0])  # ((16 - 4) / (16 + 4))^2
    with pytest.raises(ValueError, match="read-only"):
        modes.frequency[0] = 3.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (([], np.zeros((1, 0)), ["1:X"]), "expected at least one frequency"),
        (([np.nan], [[1.0]], ["1:X"]), "frequency nan Hz"),
        (([-1.0], [[1.0]], ["1:X"]), "frequency -1 Hz"),
        (
            ([1.0], [[1.0], [2.0]], ["1:X"]),
            r"expected shapes of \(DOFs, modes\) = \(1, 1\), found \(2, 1\)",
        ),
        (([1.0], [[0.0]], ["1:X"]), "the shape at 1 Hz is zero"),
        (([1.0], [["a"]], ["1:X"]), "shapes: expected numbers"),
        (([1.0], [[1.0]], ["1:X"], [0.1, 0.2]), "loss_factor: expected 1, one for each mode"),
    ],
)
def test_mode_set_refuses(given: tuple[Any, ...], message: str) -> None:
    with pytest.raises(DataError, match=message):
        ModeSet(*given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"frequency": [True, 2.0]}, None),  # an array of numbers, as numpy has it
        ({"frequency": [True, False]}, "frequency: expected numbers, found bool"),
        ({"frequency": np.ma.array([10.0, 20.0], mask=[0, 1])}, "frequency: holds masked values"),
        ({"shapes": np.ma.array(np.eye(2), mask=np.eye(2))}, "shapes: holds masked values"),
        ({"scaled": np.ma.array([1, 1], mask=[0, 1])}, "scaled: holds masked values"),
        ({"scaled": np.ma.array([True, True], mask=[0, 1])}, "scaled: holds masked values"),
        ({"scaled": 0.3}, "scaled: expected True or False, found 0.3"),
        ({"scaled": "yes"}, "scaled: expected numbers"),
        ({"loss_factor": [0.1, np.inf]}, "loss_factor: mode 2 has inf; expected a finite number,"),
        ({"quality": -np.inf}, "quality: mode 1 has -inf; expected a finite number,"),
        ({"std_frequency": [0.1, -0.1]}, "std_frequency: mode 2 has -0.1; expected a finite num"),
        ({"std_loss_factor": -1.0}, "std_loss_factor: mode 1 has -1; .* of at least 0, or nan"),
    ],
)
def test_mode_set_coerces_nothing(given: dict[str, Any], message: str | None) -> None:
    whole = {"frequency": [10.0, 20.0], "shapes": np.eye(2), "dofs": ["1:X", "2:X"]} | given
    if message is None:
        assert ModeSet(**whole).frequency.tolist() == [1.0, 2.0]
        return
    with pytest.raises(DataError, match=message):
        ModeSet(**whole)


def test_modes_are_selected_by_number_or_by_flag() -> None:
    modes = ModeSet([10.0, 20.0, 30.0], np.eye(3), ["1:X", "2:X", "3:X"], scaled=[0, 1, 0])
    assert modes.scaled.tolist() == [False, True, False]
    assert modes.select(modes.frequency > 15.0).frequency.tolist() == [20.0, 30.0]
    assert modes.select(np.array([2.0])).frequency.tolist() == [30.0]
    for given, message in (
        ([1.7], "modes: expected whole numbers .* found 1.7"),
        ([True, False], "modes: expected whole numbers, found bool"),
        (["a"], "modes: expected whole numbers"),
        ([1, 1], r"modes: expected each number once, found \[1, 1\]"),
        ([False, False, False], "the selection contains no mode"),
    ):
        with pytest.raises(DataError, match=message):
            modes.select(given)


def test_deviations_of_shapes_go_with_their_modes() -> None:
    shapes = [[1.0, 2.0], [3.0, 4.0]]
    modes = ModeSet([20.0, 10.0], shapes, ["1:X", "2:X"], std_shapes=[[0.1, np.nan], [0.3, np.nan]])
    assert modes.std_shapes[:, 1].tolist() == [0.1, 0.3]
    assert np.isnan(modes.std_shapes[:, 0]).all()
    assert modes.select(band=(15.0, 30.0)).std_shapes.tolist() == [[0.1], [0.3]]
    assert modes.select([0]).std_shapes is None  # nan throughout
    assert modes.renamed(["3:X", "4:X"]).std_shapes[:, 1].tolist() == [0.1, 0.3]
    bare = ModeSet([20.0, 10.0], shapes, ["1:X", "2:X"])
    assert bare.std_shapes is None
    assert bare.digest != modes.digest
    assert copy.copy(modes).digest == modes.digest
    with pytest.raises(ValueError, match="read-only"):
        modes.std_shapes[0] = 3.0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([[0.1]], r"expected std_shapes as shapes, \(2, 1\), found \(1, 1\)"),
        ([[0.1], [-0.1]], "std_shapes at 1 Hz: expected finite numbers of at least 0"),
        ([[np.inf], [0.1]], "std_shapes at 1 Hz: expected finite numbers of at least 0"),
        ([[np.nan], [0.1]], "or nan in the whole column"),
        ([["a"], ["b"]], "std_shapes: expected numbers"),
    ],
)
def test_deviations_of_shapes_are_checked(given: Any, message: str) -> None:
    with pytest.raises(DataError, match=message):
        ModeSet([1.0], [[1.0], [2.0]], ["1:X", "2:X"], std_shapes=given)


def test_mode_set_without_what_is_asked_for() -> None:
    modes = ModeSet([10.0], [[1.0]], ["1:X"])
    with pytest.raises(DataError, match="the selection contains no mode"):
        modes.select(band=(1.0, 2.0))
    with pytest.raises(DataError, match="expected numbers from 0 to 0"):
        modes.select([1])


def test_large_rotations_do_not_outweigh_a_mode_that_forces_show():
    """In rad and N m the noise of a rotation may be larger than the whole of another mode."""
    rng = np.random.default_rng(6)
    dofs = ["1:X", "2:X", "3:X", "4:RZ"]
    freq = np.linspace(5.0, 40.0, 600)
    natural, loss = np.array([12.0, 20.0, 31.0]), 0.02
    shapes = np.array([[1.0, 0.6, 0.3], [0.4, -1.0, 0.7], [-0.8, 0.5, 1.0], [900.0, 2.0, -600.0]])
    lines = (2 * np.pi * freq)[:, None]
    below = (2 * np.pi * natural) ** 2 * (1 + 1j * loss) - lines**2
    H = -(lines**2)[:, :, None] * np.einsum("ir,jr,fr->fij", shapes, shapes, 1 / below)
    kept = [0, 3]  # struck at 1:X, driven by a torque at 4:RZ
    H = H[:, :, kept]
    level = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    noise = rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)
    frf = updyn.FRF(freq, H + 0.05 * level * noise, dofs, ["1:X", "4:RZ"], "accelerance")
    found = identify_modes(frf)
    assert found.frequency == pytest.approx(natural, rel=2e-3)
    for r in range(3):
        a, b = found.shapes[:3, r], shapes[:3, r]
        assert abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * (b @ b)) > 0.98
