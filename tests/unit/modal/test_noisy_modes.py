"""Modes from data as tests give them: noise, close pairs, a band beyond the modes, sensors that rove."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

import updyn
from updyn.errors import DataError
from updyn.modal import search
from updyn.modal.axis import Axis
from updyn.modal.fits import Mode
from updyn.modal.lscf import fit_orders
from updyn.modal.measured import Measured
from updyn.modal.picks import _check_added
from updyn.modal.refine import Errors, LineWindow, Weights, fit_poles, fit_residues
from updyn.modal.runs import is_split_off
from updyn.modal.stabilisation import find_stable_poles
from updyn.modal.vector_fitting import RationalBasis

FREQ = np.linspace(0.5, 100.0, 400)


@dataclass(frozen=True)
class Structure:
    """Modes in closed form: H = -omega^2 sum phi phi^T / (omega_r^2 (1 + i eta_r) - omega^2)."""

    frequency: np.ndarray
    loss: np.ndarray
    shapes: np.ndarray  # rows: responses, then references
    responses: int

    def frf(self, freq: np.ndarray, noise: float, seed: int, shift: np.ndarray | None = None):
        """Accelerances with proportional noise and a floor; shift: share by response and mode."""
        at, driven = self.shapes[: self.responses], self.shapes[self.responses :]
        shift = np.zeros(at.shape) if shift is None else shift
        omega = 2 * np.pi * freq[:, None, None]
        natural = 2 * np.pi * self.frequency * (1.0 + shift)
        H = -(omega**2) * np.einsum(
            "ir,jr,fir->fij", at, driven, 1 / (natural**2 * (1 + 1j * self.loss) - omega**2)
        )
        rng = np.random.default_rng(seed)
        level = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
        share, floor = rng.standard_normal((2, *H.shape, 2)) @ (1, 1j) / np.sqrt(2.0)
        H = H * (1 + noise * share) + 0.1 * noise * level * floor
        labels = [f"{k}:Z" for k in range(1, len(self.shapes) + 1)]
        return updyn.FRF(freq, H, labels[: self.responses], labels[self.responses :], "accelerance")


def structure(
    frequency: list[float], loss: list[float], responses: int, references: int, seed: int = 0
) -> Structure:
    rng = np.random.default_rng(seed)
    shapes = rng.standard_normal((responses + references, len(frequency)))
    return Structure(np.array(frequency), np.array(loss), shapes, responses)


#: Lines up to just beyond the highest of three modes.
BELOW = FREQ[FREQ < 65.0]


FEW = structure([12.0, 31.0, 31.062, 58.0, 83.0], [0.01, 0.012, 0.008, 0.02, 0.005], 8, 1)


def test_a_close_pair_is_found_under_noise_with_one_reference() -> None:
    """Two modes 0.2 % apart, a fifth of their bandwidths; 5 % noise."""
    for seed in range(3):
        found = updyn.identify_modes(FEW.frf(FREQ, 0.05, seed))
        assert found.frequency == pytest.approx(FEW.frequency, rel=1e-3)
        assert found.loss_factor == pytest.approx(FEW.loss, rel=0.1)
        assert found.damping == pytest.approx(0.5 * found.loss_factor)


@pytest.mark.parametrize("damping", ["structural", "viscous"])
def test_standard_deviations_are_those_of_repeats(damping: str) -> None:
    alone = structure([12.0, 31.0, 58.0], [0.01, 0.012, 0.02], 4, 1, seed=2)
    sets = [
        updyn.identify_modes(alone.frf(BELOW, 0.03, seed), damping=damping) for seed in range(40)
    ]
    assert all(len(found) == 3 for found in sets)
    for name in ("frequency", "damping"):
        values = np.array([getattr(found, name) for found in sets])
        stated = np.median([getattr(found, f"std_{name}") for found in sets], axis=0)
        assert np.std(values, axis=0, ddof=1) == pytest.approx(stated, rel=0.35)


@pytest.mark.parametrize(
    ("responses", "references", "driven", "damping"),
    [(4, 1, 0, "structural"), (2, 5, 0, "structural"), (5, 2, 1, "viscous")],
)
def test_standard_deviations_of_shapes_are_those_of_repeats(
    responses: int, references: int, driven: int, damping: str
) -> None:
    """At responses, at the places of a hammer, and at both with the scale from a drive point."""
    alone = structure([20.0, 31.0, 58.0], [0.01, 0.012, 0.02], responses, references, seed=2)
    shapes = alone.shapes.copy()
    shapes[responses : responses + driven] = shapes[:driven]
    alone = Structure(alone.frequency, alone.loss, shapes, responses)
    found, within = [], []
    for seed in range(40):
        frf = alone.frf(BELOW, 0.03, seed)
        labels = [f"{k + 1}:Z" for k in range(driven)] + list(frf.references.labels[driven:])
        frf = updyn.FRF(BELOW, frf.values, frf.responses, labels, "accelerance")
        modes = updyn.identify_modes(frf, damping=damping)
        true = shapes[[int(str(dof).split(":")[0]) - 1 for dof in modes.dofs]]
        true = true / np.linalg.norm(true, axis=0)
        length = np.linalg.norm(modes.real_shapes, axis=0)
        unit, std = modes.real_shapes / length, modes.std_shapes / length
        unit = unit * np.sign(np.sum(unit * true, axis=0))
        found.append((unit, std))
        within.append(np.abs(unit - true) <= 1.96 * std)
    spread = np.std([unit for unit, _ in found], axis=0, ddof=1)
    stated = np.median([std for _, std in found], axis=0)
    ratio = spread / stated
    assert np.median(ratio) == pytest.approx(1.0, abs=0.15)
    assert ratio.max() < 1.5
    assert ratio.min() > 0.65
    assert 0.90 <= np.mean(within) <= 0.98


def test_two_modes_of_one_frequency_have_shapes_of_no_stated_deviation() -> None:
    """Any two shapes of their plane are as good."""
    twin = structure([20.0, 31.0, 31.0], [0.01, 0.012, 0.012], 6, 2, seed=2)
    found = updyn.identify_modes(twin.frf(FREQ, 0.02, 0))
    assert found.frequency == pytest.approx([20.0, 31.0, 31.0], rel=1e-3)
    assert np.isnan(found.std_shapes).all(axis=0).tolist() == [False, True, True]


def test_a_band_far_beyond_the_modes_and_a_line_at_zero() -> None:
    """As on a bridge: eleven modes in the lower quarter of the band, an offset in the line at 0 Hz."""
    rng = np.random.default_rng(4)
    natural = 2.0 + np.cumsum(rng.uniform(1.2, 3.0, 11))
    bridge = structure(natural.tolist(), rng.uniform(0.01, 0.03, 11).tolist(), 30, 1, seed=4)
    freq = np.linspace(0.0, 100.0, 1601)
    frf = bridge.frf(freq[1:], 0.03, 1)
    values = np.concatenate([np.full((1, 30, 1), 50.0), frf.values])
    frf = updyn.FRF(freq, values, frf.responses, frf.references, "accelerance")
    found = updyn.identify_modes(frf)
    assert found.frequency == pytest.approx(natural, rel=3e-3)
    assert found.loss_factor == pytest.approx(bridge.loss, rel=0.1)


def test_a_mode_that_a_roving_sensor_shifts_is_one_mode() -> None:
    """The mass of a sensor lowers each frequency by its share of the modal mass where it is."""
    alone = structure([12.0, 31.0, 58.0, 83.0], [0.01, 0.012, 0.008, 0.005], 20, 2, seed=3)
    shift = -0.0008 * alone.shapes[:20] ** 2
    for noise in (0.01, 0.05):
        found = updyn.identify_modes(alone.frf(FREQ, noise, 5, shift))
        assert found.frequency == pytest.approx(
            alone.frequency * (1 + shift.mean(axis=0)), rel=2e-3
        )
        assert found.loss_factor == pytest.approx(alone.loss, rel=0.1)
        # The deviation stated is that of the positions.
        assert (found.std_frequency > 0.3 * shift.std(axis=0) * alone.frequency).all()


def test_two_close_modes_that_a_roving_hammer_shifts_are_two() -> None:
    """Each hit with its own frequencies; three sensors stay. Poles in common would be five or more."""
    rng = np.random.default_rng(1)
    freq = np.linspace(20.0, 60.0, 641)
    pair = structure([31.0, 31.15, 48.0], [0.008, 0.008, 0.006], 40, 3, seed=1)
    shift = 0.002 * rng.standard_normal((40, 1)) * np.ones(3)
    made = pair.frf(freq, 0.003, 0, shift)
    turned = made.values.swapaxes(1, 2)
    hammer = updyn.FRF(freq, turned, made.references, made.responses, "accelerance")
    found = updyn.identify_modes(hammer)
    assert found.frequency == pytest.approx(pair.frequency * (1 + shift.mean()), rel=1e-3)
    assert found.loss_factor == pytest.approx(pair.loss, rel=0.1)


def test_two_modes_of_one_shape_at_the_sensors_are_two() -> None:
    """As of bending in two planes, of which the sensors see one."""
    shapes = np.outer([1.0, 0.8, -0.6, 0.3, -0.9, 0.5], [1.0, 0.7])
    both = Structure(
        np.array([30.0, 30.5]), np.array([0.02, 0.02]), np.vstack([shapes, [1.0, 1.0]]), 6
    )
    found = updyn.identify_modes(both.frf(FREQ, 0.003, 0))
    assert found.frequency == pytest.approx([30.0, 30.5], rel=1e-3)


def test_the_shape_of_a_mode_that_a_roving_sensor_shifts_is_that_of_its_residues() -> None:
    """A residue is of the pole of its run: by the mean pole, shapes would be off by twice the shift."""
    alone = structure([12.0, 31.0, 58.0, 83.0], [0.01, 0.012, 0.008, 0.005], 20, 2, seed=3)
    shift = -0.002 * alone.shapes[:20] ** 2
    found = updyn.identify_modes(alone.frf(FREQ, 1e-3, 5, shift))
    true = alone.shapes[:20] / np.linalg.norm(alone.shapes[:20], axis=0)
    length = np.linalg.norm(found.real_shapes, axis=0)
    unit, std = found.real_shapes / length, found.std_shapes / length
    unit = unit * np.sign(np.sum(unit * true, axis=0))
    z = np.abs(unit - true) / std
    assert np.mean(z < 1.96) > 0.85
    assert np.sqrt(np.mean(z**2)) < 1.5


def test_sensors_of_two_directions_see_two_modes() -> None:
    """One pole for each sensor would fit as well; it is not simpler."""
    shapes = np.array([[1.0, 0], [0.7, 0], [-0.5, 0], [0, 1.0], [0, 0.6], [0, -0.4], [1.0, 1.0]])
    cross = Structure(np.array([31.0, 31.1]), np.array([0.01, 0.01]), shapes, 6)
    found = updyn.identify_modes(cross.frf(FREQ, 0.01, 0))
    assert found.frequency == pytest.approx([31.0, 31.1], rel=3e-4)


def test_quality_tells_the_sure_from_the_unsure() -> None:
    sure = updyn.identify_modes(FEW.frf(FREQ, 0.001, 0)).quality
    assert (sure > 0.999).all()
    unsure = updyn.identify_modes(FEW.frf(FREQ, 0.05, 0)).quality
    assert ((unsure < sure) & (unsure > 0.5)).all()


def test_a_mode_counts_by_its_worth_where_a_neighbour_explains_most_of_it() -> None:
    """A quarter of the half-power bandwidth apart, 25 % noise."""
    freq = np.linspace(20.0, 45.0, 500)
    for seed in (0, 2):
        pair = structure([31.0, 31.15], [0.02, 0.02], 30, 1, seed=seed)
        found = updyn.identify_modes(pair.frf(freq, 0.25, seed))
        assert found.frequency == pytest.approx(pair.frequency, rel=2e-3)
        assert found.quality.min() < 0.5


def test_a_mode_that_explains_little_may_be_a_part_of_another() -> None:
    """It has its shape on the side that stays; one channel there tells nothing."""
    at, other = np.array([1.0, 2.0, -1.0, 0.5]), np.array([1.0, -1.0, 2.0, 1.0])
    stays, turned = np.array([1.0, 0.4]), np.array([-0.4, 1.0])

    def mode(imag: float, rows: np.ndarray, columns: np.ndarray, quality: float) -> Mode:
        residues = np.outer(rows, columns).reshape(-1).astype(complex)
        pole = complex(imag, 0.01)
        return Mode(pole, np.zeros(2), residues, Errors.none(8), quality, 1.0)

    sure, part = mode(1.0, at, stays, 0.9), mode(1.004, other, stays, 0.4)
    assert is_split_off(part, [sure, part], (4, 2), False)
    for kept in (
        mode(1.004, other, turned, 0.4),  # another shape on both sides
        mode(1.03, other, stays, 0.4),  # further away than both half-widths
        mode(1.004, other, stays, 0.6),  # explains enough by itself
    ):
        assert not is_split_off(kept, [sure, kept], (4, 2), False)
    single = [mode(f, rows, np.ones(1), 0.4) for f, rows in ((1.0, at), (1.004, other))]
    assert not is_split_off(single[1], single, (4, 1), False)


def weak() -> tuple[Structure, updyn.FRF]:
    """Three modes; the one at 31 Hz moves the sensors by a hundredth of the others."""
    whole = structure([20.0, 31.0, 58.0], [0.01, 0.012, 0.02], 6, 1, seed=2)
    shapes = whole.shapes.copy()
    shapes[:, 1] *= 0.01
    made = Structure(whole.frequency, whole.loss, shapes, 6)
    return made, made.frf(FREQ, 0.0005, 0)


def near(modes: updyn.ModeSet, frequency: float) -> np.ndarray:
    stable = modes.diagram.frequency[modes.diagram.stable]
    return stable[np.abs(stable / frequency - 1.0) < 5e-3]


@pytest.mark.parametrize("damping", ["structural", "viscous"])
def test_a_pole_that_is_no_mode_becomes_one_where_it_is_picked(damping: str) -> None:
    truth, frf = weak()
    found = updyn.identify_modes(frf, damping=damping)
    assert found.frequency == pytest.approx([20.0, 58.0], rel=3e-4)
    more = updyn.identify_modes(frf, damping=damping, poles=[near(found, 31.0)[-1]])
    assert more.frequency == pytest.approx(truth.frequency, rel=3e-4)
    assert abs(more.loss_factor[1] - 0.012) < 4 * more.std_loss_factor[1] + 1e-5
    # Of 25 draws of the noise the standard deviation is 2.65e-3 Hz.
    assert more.std_frequency[1] == pytest.approx(2.65e-3, rel=0.4)
    true = truth.shapes[:6, 1] / np.linalg.norm(truth.shapes[:6, 1])
    shape = more.real_shapes[:, 1] / np.linalg.norm(more.real_shapes[:, 1])
    assert abs(true @ shape) == pytest.approx(1.0, abs=2e-4)


def test_poles_that_do_not_stay_are_refused_by_name() -> None:
    _, frf = weak()
    found = updyn.identify_modes(frf)
    of_a_mode, hidden = near(found, 20.0)[-1], near(found, 31.0)
    with pytest.raises(updyn.UpdynError, match=r"pole at 20.* Hz is that of the mode at 20.* Hz"):
        updyn.identify_modes(frf, poles=[of_a_mode])
    with pytest.raises(updyn.UpdynError, match=r"the pole at 44 Hz, refined, leaves its place"):
        updyn.identify_modes(frf, poles=[44.0])
    with pytest.raises(updyn.UpdynError, match=r"200 Hz is not within the band, 0\.5 to 100 Hz"):
        updyn.identify_modes(frf, poles=[200.0])
    with pytest.raises(updyn.UpdynError, match=r"pole at 31\.0\d* Hz is that of another pick"):
        updyn.identify_modes(frf, poles=[hidden[-1], hidden[-2]])


@pytest.mark.parametrize(
    ("last", "others", "message"),
    [
        (31.003, [31.0, 58.0], "at 31.2 Hz, refined, merges with the mode at 31 Hz"),
        (31.003, [58.0], "at 31.2 Hz, refined, takes the place of the mode at 31 Hz"),
        (32.5, [31.0, 58.0], "at 31.2 Hz, refined, leaves its place and moves to 32.5 Hz"),
        (120.0, [31.0, 58.0], "at 31.2 Hz, refined, leaves the band"),
        (31.3, [31.0, 58.0], ""),
    ],
)
def test_where_a_pole_that_was_picked_has_gone(
    last: float, others: list[float], message: str
) -> None:
    measured = Measured.of(FEW.frf(FREQ, 0.0, 0), mirrored=False)

    def pole(frequency: list[float]) -> np.ndarray:
        return measured.axis.pole(np.array(frequency), 0.01)

    given = (complex(pole([31.2])[0]), complex(pole([last])[0]), pole([31.0, 58.0]), pole(others))
    if not message:
        _check_added(measured, *given)
        return
    with pytest.raises(updyn.UpdynError, match=message):
        _check_added(measured, *given)


def test_poles_of_exact_data_stay_from_order_to_order() -> None:
    H = FEW.frf(FREQ, 0.0, 0).values
    poles, diagram = find_stable_poles(FREQ, H / np.sqrt(np.mean(np.abs(H) ** 2)))
    for f in FEW.frequency:
        assert np.abs(np.abs(poles) / (2 * np.pi) / f - 1).min() < 1e-4
    columns = (diagram.order, diagram.frequency, diagram.damping, diagram.stable)
    assert len({len(column) for column in columns}) == 1
    last = diagram.stable & (diagram.order == diagram.order.max())
    for f in FEW.frequency:
        assert np.abs(diagram.frequency[last] / f - 1).min() < 1e-3


def test_matrix_fractions_with_two_references_find_a_repeated_pole_twice() -> None:
    pair = structure([40.0, 40.0], [0.01, 0.01], 4, 2, seed=1)
    H = pair.frf(np.linspace(20.0, 60.0, 200), 0.0, 0).values
    (*_, last) = fit_orders(2 * np.pi * np.linspace(20.0, 60.0, 200), H, [4, 8])
    near = np.abs(np.abs(last) / (2 * np.pi) - 40.0) < 0.02
    assert near.sum() == 2


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_gradient_is_that_of_central_differences(mirrored: bool) -> None:
    rng = np.random.default_rng(0)
    axis = Axis(mirrored, 2 * np.pi * 100.0)
    x = axis.at(FREQ)
    Y = rng.standard_normal((3, len(x))) + 1j * rng.standard_normal((3, len(x)))
    window = LineWindow(RationalBasis(2, mirrored), x, Y, axis.pole(np.array([70.0]), 0.02))
    poles = axis.pole(np.array([30.0, 50.0]), np.array([0.05, 0.08]))
    weights = Weights(np.ones((1, 1)), 0.5 + rng.random((3, len(x))))
    fitted = fit_residues(window, poles, weights)
    gradient = fitted.gradient
    if not mirrored:  # of an analytic function: by the real, then by the imaginary part
        gradient = np.concatenate([gradient.real, gradient.imag])
    step = 1e-6
    for k, turn in enumerate((1.0, 1.0, 1j, 1j)):
        change = np.zeros(2, dtype=complex)
        change[k % 2] = step * turn
        up, down = (fit_residues(window, poles + s * change, weights).cost for s in (1, -1))
        assert -2.0 * gradient[k] == pytest.approx((up - down) / (2 * step), rel=1e-4)


def test_noise_is_a_share_of_all_that_was_measured() -> None:
    """Also of modes outside the window, which are taken out of what is fitted there."""
    whole = FEW.frf(FREQ, 0.0, 0).values[:, :, 0].T
    near = Structure(FEW.frequency[:1], FEW.loss[:1], FEW.shapes[:, :1], 8)
    own = near.frf(FREQ, 0.0, 0).values[:, :, 0].T
    axis = Axis(False, 2 * np.pi * FREQ[-1])
    none = np.zeros(0, dtype=complex)
    window = LineWindow(axis.basis, axis.at(FREQ), own, none, whole - own)
    poles = axis.pole(FEW.frequency[:1], FEW.loss[:1])
    assert fit_residues(window, poles, Weights.of(np.abs(own) ** 2)).size == pytest.approx(
        np.abs(whole) ** 2, rel=1e-6
    )


def test_worth_is_what_the_cost_grows_by() -> None:
    frf = FEW.frf(FREQ, 0.02, 0)
    axis = Axis(False, 2 * np.pi * FREQ[-1])
    window = LineWindow(
        axis.basis, axis.at(FREQ), frf.values[:, :, 0].T, np.zeros(0, dtype=complex)
    )
    weights = Weights.of(np.abs(window.Y) ** 2)
    poles = axis.pole(FEW.frequency, FEW.loss)
    fitted = fit_poles(window, poles, weights)
    for r in range(len(poles)):
        fewer = fit_residues(window, np.delete(fitted.poles, r), weights)
        assert fitted.cost_increase[r] == pytest.approx(fewer.cost - fitted.cost, rel=1e-6)


def test_channels_and_lines_without_signal_and_any_unit_do_no_harm() -> None:
    frf = FEW.frf(FREQ, 0.01, 0)
    sound = updyn.identify_modes(frf).frequency
    dead, faint, gap = (frf.values.copy() for _ in range(3))
    dead[:, 3], gap[100] = 0.0, 0.0
    faint[:, 3] *= 1e-14
    for values in (dead, faint, gap, 1e-120 * frf.values, 1e120 * frf.values):
        given = updyn.FRF(FREQ, values, frf.responses, frf.references, "accelerance")
        assert updyn.identify_modes(given).frequency == pytest.approx(sound, rel=3e-4)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_line_without_values_beside_a_high_peak_is_no_mode(seed: int) -> None:
    frf = FEW.frf(FREQ, 0.01, seed)
    values = frf.values.copy()
    values[100] = 0.0
    gap = updyn.FRF(FREQ, values, frf.responses, frf.references, "accelerance")
    assert updyn.identify_modes(gap).frequency == pytest.approx(FEW.frequency, rel=1e-3)


def test_lines_need_not_be_even() -> None:
    found = updyn.identify_modes(FEW.frf(np.geomspace(5.0, 100.0, 300), 0.01, 0))
    assert found.frequency == pytest.approx(FEW.frequency, rel=1e-3)


@pytest.mark.parametrize("kind", ["constant", "mass line", "noise"])
def test_what_has_no_mode_is_refused(kind: str) -> None:
    rng = np.random.default_rng(0)
    made = {
        "constant": np.ones(FREQ.shape),
        "mass line": -1.0 / (2 * np.pi * FREQ) ** 2,
        "noise": rng.standard_normal(FREQ.shape),
    }[kind]
    values = np.broadcast_to(made[:, None, None], (len(FREQ), 4, 1))
    quantity = "receptance" if kind == "mass line" else "accelerance"
    frf = updyn.FRF(FREQ, values, [f"{k}:Z" for k in range(4)], ["0:Z"], quantity)
    with pytest.raises(updyn.UpdynError, match=r"found none between 0\.5 and 100 Hz"):
        updyn.identify_modes(frf)


def test_heavy_damping() -> None:
    heavy = structure([12.0, 31.0, 58.0], [0.3, 0.2, 0.4], 6, 2)
    found = updyn.identify_modes(heavy.frf(FREQ, 0.02, 0))
    assert found.frequency == pytest.approx(heavy.frequency, rel=3e-3)
    assert found.loss_factor == pytest.approx(heavy.loss, rel=0.03)


def test_few_lines_far_apart_without_noise_determine_all_modes() -> None:
    """Fewer lines than poles would show as peaks; heavy and light damping."""
    gears = structure([4.1, 6.6, 34.0, 62.0], [1e-6, 0.33, 0.07, 0.45], 4, 2)
    found = updyn.identify_modes(gears.frf(np.linspace(0.8, 90.0, 30), 0.0, 0))
    assert found.frequency == pytest.approx(gears.frequency, rel=1e-7)
    assert found.loss_factor == pytest.approx(gears.loss, abs=1e-7)


# -- many channels -------------------------------------------------------------------------------
MANY = structure([20.0, 40.0, 40.4, 70.0], [0.01, 0.012, 0.01, 0.02], 150, 1)


@pytest.fixture
def tested(monkeypatch):
    """Numbers of channels of the windows in which poles are tested."""
    numbers, gains = [], search._gains

    def count(window, *given):
        numbers.append(len(window.Y))
        return gains(window, *given)

    monkeypatch.setattr(search, "_gains", count)
    return numbers


def test_clear_modes_are_tested_in_the_channels_of_largest_response(tested, monkeypatch):
    freq = np.linspace(10.0, 90.0, 240)
    frf = MANY.frf(freq, 0.02, seed=3)
    found = updyn.identify_modes(frf)
    assert set(tested) == {64}
    monkeypatch.setattr(search, "MODE_SEARCH", replace(search.MODE_SEARCH, strong_channels=75))
    tested.clear()
    whole = updyn.identify_modes(frf)
    assert set(tested) == {150}
    assert found.frequency == pytest.approx(MANY.frequency, rel=1e-3)
    assert whole.frequency == pytest.approx(found.frequency, rel=1e-12)


def test_a_disturbance_of_one_line_is_no_mode_of_many_channels():
    freq = np.linspace(10.0, 90.0, 240)
    frf = MANY.frf(freq, 0.02, seed=3)
    H = frf.values.copy()
    H[150] += 3.0 * np.abs(H).max(axis=0)
    disturbed = updyn.FRF(freq, H, frf.responses, frf.references, "accelerance")
    found = updyn.identify_modes(disturbed)
    assert found.frequency == pytest.approx(MANY.frequency, rel=2e-3)


def test_poles_that_few_channels_do_not_show_are_tested_in_all(tested):
    weak = structure([50.0], [0.01], 150, 1)
    with pytest.raises(DataError, match="found none"):
        updyn.identify_modes(weak.frf(np.linspace(40.0, 60.0, 80), 4.0, seed=1))
    assert {64, 150} <= set(tested)
