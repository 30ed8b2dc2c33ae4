"""The relative error of plants, the rational route and its passivity, against independent values."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.control.antiresonances import find_antiresonances
from updyn.control.demo import CONTROLLER
from updyn.control.passivity import (
    collocated_channels,
    constrained_least_squares,
    passive_channels,
    violations,
)
from updyn.control.ports import as_ports
from updyn.control.rational_fit import Approximation
from updyn.control.rational_states import find_fewest_states, refit_poles
from updyn.control.structure import CompiledStructure
from updyn.control.task import build_task
from updyn.errors import OptionError, ToleranceError
from updyn.frf import QUANTITIES

BAND = (0.5, 500.0)
INERTIAS, SHAFTS, LOSS = (0.02, 1.5, 40.0), (3e4, 9e5), (0.03, 0.01)


def three_inertias(shafts: tuple[float, float] = SHAFTS) -> updyn.Model:
    """A motor, a gear and a load, free to turn."""
    groups = {"inertias": updyn.Group(mass=np.diag(INERTIAS))}
    for i, (stiffness, loss) in enumerate(zip(shafts, LOSS, strict=True)):
        twist = np.zeros(3)
        twist[i : i + 2] = 1.0, -1.0
        groups[f"shaft {i + 1}"] = updyn.Group(stiffness * np.outer(twist, twist), loss_factor=loss)
    return updyn.Model.from_groups(groups, ["1:RZ", "2:RZ", "3:RZ"])


def receptance(freq: np.ndarray, response: int, reference: int) -> np.ndarray:
    """Receptance of the three inertias by Cramer's rule, without the package."""
    k1, k2 = (k * (1 + 1j * loss) for k, loss in zip(SHAFTS, LOSS, strict=True))
    out = np.empty(len(freq), dtype=complex)
    for n, w in enumerate(2 * np.pi * freq):
        Z = np.array([[k1, -k1, 0], [-k1, k1 + k2, -k2], [0, -k2, k2]])
        Z = Z - w**2 * np.diag(INERTIAS)
        out[n] = np.linalg.solve(Z, np.eye(3)[reference])[response]
    return out


def evaluated(plant: updyn.Plant, freq: np.ndarray) -> np.ndarray:
    """C (s I - A)^-1 B + D by eigenvalues, without `Plant.at`."""
    values, V = np.linalg.eig(plant.A + 0j)
    if np.linalg.cond(V) > 1e12:  # double integrators have no eigenvectors
        eye = np.eye(len(plant.A))
        return np.array(
            [
                plant.C @ np.linalg.solve(s * eye - plant.A, plant.B) + plant.D
                for s in 2j * np.pi * freq
            ]
        )
    left, right = plant.C @ V, np.linalg.solve(V, plant.B)
    return (left / (2j * np.pi * freq[:, None, None] - values)) @ right + plant.D


@pytest.fixture(scope="module")
def plant() -> updyn.Plant:
    return updyn.plant(three_inertias(), ["1:RZ"], ["1:RZ", "3:RZ"], BAND, 0.03)


class TestThreeInertias:
    def test_three_percent_of_the_level_everywhere_with_few_states(self, plant) -> None:
        assert plant.n_states <= 8
        assert plant.relative_error <= 0.03
        freq = np.geomspace(*BAND, 20001)
        G = evaluated(plant, freq)[:, :, 0]
        for j, response in enumerate((0, 2)):
            H = receptance(freq, response, 0)
            # |H| itself, at antiresonances too, is a stricter measure.
            assert (np.abs(G[:, j] - H) / np.abs(H)).max() <= 0.03

    def test_a_peak_tolerance_does_not_hold_where_loops_cross(self) -> None:
        peak = updyn.plant(three_inertias(), ["1:RZ"], ["1:RZ", "3:RZ"], BAND, 0.001, error="peak")
        assert peak.error <= 0.001
        assert peak.relative_error > 0.5
        assert peak.facts["error"] == "peak"

    def test_zeros_are_stated(self, plant) -> None:
        """The zeros of the first inertia are the modes of the others with it held."""
        k1, k2 = SHAFTS
        held = np.array([[k1 + k2, -k2], [-k2, k2]]) / np.array(INERTIAS[1:])[:, None]
        own = np.sqrt(np.sort(np.linalg.eigvals(held).real)) / (2 * np.pi)
        found = [zero for zero in plant.zero_shift if zero.output == "1:RZ"]
        assert [zero.frequency for zero in found] == pytest.approx(own, rel=1e-3)
        assert all(abs(zero.shift) < 1.0 for zero in plant.zero_shift)
        assert found[0].depth == pytest.approx(found[0].plant_depth, abs=0.5)
        freq = np.linspace(3.5, 5.0, 20001)
        for G in (evaluated(plant, freq)[:, 0, 0], receptance(freq, 0, 0)):
            assert freq[np.abs(G).argmin()] == pytest.approx(own[0], rel=2e-3)

    @pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
    def test_rigid_body_motion_is_exact(self, quantity: str) -> None:
        made = updyn.plant(
            three_inertias(), ["1:RZ"], ["3:RZ"], BAND, 0.03, quantity=quantity, route="rational"
        )
        s = 2j * np.pi * np.array([1e-5, 1e-4])
        rigid = s ** (QUANTITIES[quantity] - 2) / sum(INERTIAS)
        assert made.at(s)[:, 0, 0] == pytest.approx(rigid, rel=1e-6)

    @pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
    @pytest.mark.parametrize("tolerance", [0.03, 0.0165])
    def test_collocated_channels_take_up_power(self, quantity: str, tolerance: float) -> None:
        made = updyn.plant(
            three_inertias(),
            ["1:RZ"],
            ["1:RZ", "3:RZ"],
            BAND,
            tolerance,
            quantity=quantity,
            route="rational",
        )
        power = QUANTITIES[quantity]
        assert made.D[0, 0] >= -1e-18
        assert passive_channels(made, np.full(2, power)) == {(0, 0): True}
        freq = np.geomspace(1e-3, 1e6, 4000)
        s = 2j * np.pi * freq
        Y = evaluated(made, freq)[:, 0, 0] * s ** (1 - power)
        assert (Y.real >= -1e-7 * np.abs(Y)).all()

    def test_what_cannot_be_reached_says_why(self) -> None:
        with pytest.raises(ToleranceError, match=r"by route 'rational'.*not causal \(Kramers"):
            updyn.plant(three_inertias(), ["1:RZ"], ["1:RZ"], BAND, 1e-4)

    def test_an_error_that_is_not_there(self) -> None:
        with pytest.raises(OptionError, match=r"no error 'peek'; did you mean 'peak'"):
            updyn.plant(three_inertias(), ["1:RZ"], ["1:RZ"], BAND, error="peek")

    @pytest.mark.parametrize("suffix", [".json", ".mat", ".npz"])
    def test_files_hold_it(self, plant, suffix: str, tmp_path: Path) -> None:
        updyn.write_plant(plant, tmp_path / f"p{suffix}")
        found = updyn.read_plant(tmp_path / f"p{suffix}")
        assert found.relative_error == plant.relative_error
        assert found.zero_shift == plant.zero_shift

    def test_a_file_of_an_earlier_version_is_read(self, plant, tmp_path: Path) -> None:
        import json

        updyn.write_plant(plant, tmp_path / "p.json")
        items = json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))
        del items["relative_error"], items["zero_shift"], items["sha256"]
        items["schema"] = 1
        (tmp_path / "p.json").write_text(json.dumps(items), encoding="utf-8")
        found = updyn.read_plant(tmp_path / "p.json")
        assert np.isnan(found.relative_error)
        assert found.zero_shift == ()
        np.testing.assert_array_equal(found.A, plant.A)


class TestSeveralInputs:
    made = updyn.plant(
        three_inertias(), ["1:RZ", "3:RZ"], ["1:RZ", "3:RZ"], (0.5, 300.0), 0.03, route="rational"
    )

    def test_every_channel_is_within_the_tolerance(self) -> None:
        freq = np.geomspace(0.5, 300.0, 4001)
        G = evaluated(self.made, freq)
        for i, j in np.ndindex(2, 2):
            H = receptance(freq, (0, 2)[i], (0, 2)[j])
            floor = np.zeros(len(freq))
            for dip in find_antiresonances(freq, H):
                floor[np.abs(freq - dip.frequency) <= dip.width] = np.interp(
                    dip.frequency - dip.width, freq, np.abs(H)
                )
            level = np.maximum(np.abs(H), floor)
            assert (np.abs(G[:, i, j] - H) / level).max() <= 0.032

    def test_a_pole_pair_takes_two_states(self) -> None:
        assert self.made.n_states <= 10
        assert passive_channels(self.made, np.zeros(2, dtype=int)) == {(0, 0): True, (1, 1): True}


class TestALikeResponse:
    """The plant of a structure that is little different, from that of another."""

    shafts = 1.04 * SHAFTS[0], 0.97 * SHAFTS[1]

    @staticmethod
    def approximation(shafts: tuple[float, float], outputs: list[str]) -> Approximation:
        model = three_inertias(shafts)
        ports = as_ports(outputs[:1], "input"), as_ports(outputs, "output")
        return build_task(CompiledStructure.of(model), *ports, BAND, "receptance", None, None)[
            0
        ].approximation()

    @staticmethod
    def damped_poles(shafts: tuple[float, float]) -> np.ndarray:
        """Poles above the real axis in rad/s, by eigenvalues of M^-1 K (1 + i eta)."""
        K = np.zeros((3, 3), dtype=complex)
        for i, (k, loss) in enumerate(zip(shafts, LOSS, strict=True)):
            twist = np.zeros(3)
            twist[i : i + 2] = 1.0, -1.0
            K += k * (1 + 1j * loss) * np.outer(twist, twist)
        square = np.linalg.eigvals(K / np.array(INERTIAS)[:, None])
        return 1j * np.sqrt(square[np.argsort(np.abs(square))[1:]])  # s^2 = -lambda

    def test_its_poles_move_with_the_structure(self, monkeypatch) -> None:
        nominal = self.approximation(SHAFTS, ["1:RZ", "3:RZ"])
        like = find_fewest_states(nominal, 0.03).conversion
        other = self.approximation(self.shafts, ["1:RZ", "3:RZ"])
        monkeypatch.setattr(Approximation, "fit", None)  # no search from the beginning
        found = refit_poles(other, like, 0.03)
        assert found.holds
        moved = self.damped_poles(self.shafts) - self.damped_poles(SHAFTS)
        stands = np.isfinite(like.structure)
        assert stands.sum() == 2
        shift = (found.conversion.pairs - like.pairs)[stands]
        order = np.argsort(np.abs(like.pairs[stands]))
        np.testing.assert_allclose(shift[order], moved, rtol=1e-6)
        np.testing.assert_array_equal(found.conversion.pairs[~stands], like.pairs[~stands])

    def test_it_is_sought_anew_where_that_does_not_hold(self) -> None:
        like = find_fewest_states(self.approximation(SHAFTS, ["1:RZ"]), 0.03).conversion
        other = self.approximation((4.0 * SHAFTS[0], 0.3 * SHAFTS[1]), ["1:RZ"])
        wrong = replace(like, structure=np.full(len(like.pairs), np.nan))
        assert refit_poles(other, wrong, 0.03).holds


class TestPassivity:
    def test_a_pole_pair_with_a_residue_of_the_wrong_phase(self) -> None:
        """-Im G < 0 between the roots of a polynomial by hand: G = (1 - 0.5 s) / (s^2 + 0.2 s + 1)."""
        A = np.array([[0.0, 1.0], [-1.0, -0.2]])
        B, D = np.array([[0.0], [1.0]]), np.zeros((1, 1))
        assert len(violations((A, B, np.array([[1.0, 0.0]]), D), 0)) == 0
        found = violations((A, B, np.array([[1.0, 0.5]]), D), 0)
        # Im ((1 + 0.5 i w) (1 - w^2 - 0.2 i w)) = w (0.5 - 0.5 w^2 - 0.2) > 0 below sqrt(0.6)
        assert len(found) == 1
        assert found[0] < np.sqrt(0.6)

    def test_ports_of_one_sense(self) -> None:
        port, turned = updyn.Port.at("1:RZ", "a"), updyn.Port("b", {"1:-RZ": 1.0})
        geared = updyn.Port.geared("1:RZ", 5.0)
        assert collocated_channels((port, turned, geared), (port,)) == [(0, 0), (2, 0)]

    def test_constrained_least_squares(self) -> None:
        """Against the solution on the edge, by hand: nearest point of x + y >= 2 to (0, 0)."""
        x = constrained_least_squares(
            np.eye(2), np.zeros(2), np.array([[1.0, 1.0]]), np.array([2.0])
        )
        assert x == pytest.approx([1.0, 1.0])
        inside = constrained_least_squares(
            np.eye(2), np.array([3.0, 3.0]), np.ones((1, 2)), np.array([2.0])
        )
        assert inside == pytest.approx([3.0, 3.0])
        both = np.array([[1.0, 0.0], [-1.0, 0.0]])
        assert constrained_least_squares(np.eye(2), np.zeros(2), both, np.array([1.0, 1.0])) is None


def test_a_loop_is_as_on_the_model_itself(plant) -> None:
    """Gain and phase of an open loop at every line are off by no more than the relative error."""
    freq = np.geomspace(1.0, 400.0, 3000)
    s = 2j * np.pi * freq
    torque = CONTROLLER.torque(s)
    loop, own = (torque * s * x for x in (evaluated(plant, freq)[:, 0, 0], receptance(freq, 0, 0)))
    assert (np.abs(loop / own - 1.0)).max() <= 0.03


def held(loss: float = 0.02) -> updyn.Model:
    """Three masses in a row, held at one end."""
    groups = {"masses": updyn.Group(mass=np.diag([4.0, 2.0, 1.0]))}
    stretch = np.array([[1.0, 0.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, -1.0]])
    for i, (row, stiffness) in enumerate(zip(stretch, (4e5, 3e5, 1e5), strict=True)):
        groups[f"spring {i}"] = updyn.Group(stiffness * np.outer(row, row), loss_factor=loss)
    return updyn.Model.from_groups(groups, ["1:X", "2:X", "3:X"])


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("quantity", QUANTITIES)
@pytest.mark.parametrize("inputs", [["1:X"], ["1:X", "3:X"]])
def test_a_band_from_0_hz(quantity: str, inputs: list[str]) -> None:
    model, outputs = held(), ["3:X", "1:X"]
    # At 0 Hz the plant is real, and the structure's loss factor is its error there.
    plant = updyn.plant(
        model, inputs, outputs, (0.0, 150.0), quantity=quantity, route="rational", tolerance=0.04
    )
    assert np.isfinite([plant.error, plant.peak_error, plant.relative_error]).all()
    at_rest = evaluated(plant, np.zeros(1))[0]
    static = updyn.response(model, [0.0], outputs, inputs).values[0].real
    if quantity == "receptance":
        np.testing.assert_allclose(at_rest, static, rtol=0.04)
    else:
        size = np.abs(evaluated(plant, np.array([1.0, 150.0]))).max()
        assert np.abs(at_rest).max() <= 1e-9 * size
    # Between the lowest lines, at 0 and at 0.015 Hz, there is no slower pole that none of them sees.
    between = np.geomspace(1e-4, 0.1, 200)
    exact = updyn.response(model, between, outputs, inputs, quantity=quantity).values
    found = evaluated(plant, between)
    if quantity != "accelerance":  # whose size there is that of rounding
        assert (np.abs(found - exact) / np.abs(exact)).max() < 0.1
    assert np.abs(plant.poles).min() > 2 * np.pi * 0.0149


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_tolerance_out_of_reach_at_0_hz_is_told_with_what_was_reached() -> None:
    with pytest.raises(ToleranceError) as told:
        updyn.plant(held(0.05), ["1:X"], ["3:X"], (0.0, 150.0), tolerance=0.01)
    text = str(told.value)
    assert "nan" not in text
    reached = [float(part) for part in re.findall(r"([\d.]+) by route", text)]
    least = re.findall(r"is at least ([\d.]+\d)", text)
    assert len(reached) == 3
    assert float(least[0]) <= 1.01 * min(reached)
