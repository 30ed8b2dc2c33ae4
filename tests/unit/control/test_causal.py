"""Lower bound on the error of stable plants: against Nehari's norm, linear programmes and what is reached."""

from __future__ import annotations

import re

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import linprog

import updyn
from updyn.control.causal import ChannelDifference, Circle, error_lower_bound, hankel_norm
from updyn.errors import ToleranceError


def spring(loss: float, limit: float) -> ChannelDifference:
    """1 + i loss against 1: a spring of constant loss, beside one without."""
    return ChannelDifference(
        lambda freq: np.full(len(freq), 1j * loss),
        lambda freq: np.ones(len(freq)),
        limit,
        limit,
    )


class TestHankelNorm:
    @pytest.mark.parametrize("a", [0.3, 2.0, 40.0])
    def test_one_unstable_pole(self, a: float) -> None:
        """The distance of 1 / (s - a) from the stable functions is 1 / (2 a)."""
        circle = Circle(2**13, 0.4)
        s = 2j * np.pi * circle.freq
        assert hankel_norm(circle, 1.0 / (s - a)) == pytest.approx(0.5 / a, rel=1e-6)
        assert hankel_norm(circle, 1.0 / (s + a)) < 1e-12 / a

    def test_several_unstable_poles(self) -> None:
        """By the Gramians of C (s - A)^-1 B, and whatever stable is added."""
        poles = np.array([0.7, 3.0, 11.0])
        B, C = np.array([[1.0], [-2.0], [5.0]]), np.array([[3.0, 1.0, -4.0]])
        P = scipy.linalg.solve_continuous_lyapunov(np.diag(poles), B @ B.T)
        Q = scipy.linalg.solve_continuous_lyapunov(np.diag(poles), C.T @ C)
        exact = np.sqrt(np.abs(np.linalg.eigvals(P @ Q)).max())
        circle = Circle(2**13, 0.4)
        s = 2j * np.pi * circle.freq
        values = (C.ravel() * B.ravel() / (s[:, None] - poles)).sum(axis=1)
        stable = 7.0 / (s**2 + 0.3 * s + 4.0) + 2.0
        assert hankel_norm(circle, values) == pytest.approx(exact, rel=1e-6)
        assert hankel_norm(circle, values + stable) == pytest.approx(exact, rel=1e-6)

    def test_outer_functions(self) -> None:
        circle = Circle(2**12, 0.4)
        s = 2j * np.pi * circle.freq
        W = (s + 1.0) / (s + 3.0)
        assert np.exp(circle.outer(np.log(np.abs(W)))) == pytest.approx(W, rel=1e-9)


def reached(loss: float, band: tuple[float, float], limit: float) -> float:
    """Smallest error of a sum of stable functions, by a linear programme.

    Real poles even on a logarithmic scale, and pairs that crowd at the ends of the band; the modulus by its
    parts in 16 directions.
    """
    edge = np.geomspace(1e-3, 0.5, 30)
    inside = np.concatenate(
        [np.geomspace(*band, 150), band[0] * np.exp(edge), band[1] * np.exp(-edge)]
    )
    far = np.geomspace(1e-3, 8.0, 50)
    outside = np.concatenate([band[0] * np.exp(-far), band[1] * np.exp(far)])
    s = 1j * np.concatenate([inside, outside])
    columns = [np.ones(len(s), dtype=complex)]
    columns += [a / (s + a) for a in np.geomspace(band[0] / 30, band[1] * 30, 24)]
    for end in band:
        for d in np.geomspace(0.01, 1.0, 8):
            for w in (end * np.exp(d), end * np.exp(-d)):
                below = s**2 + 1.8 * d / np.sqrt(1.0 + d**2) * w * s + w**2
                columns += [w**2 / below, w * s / below]
    parts = np.stack(columns, axis=1)
    U, sigma, _ = np.linalg.svd(np.vstack([parts.real, parts.imag]), full_matrices=False)
    U = U[:, sigma > 1e-9 * sigma[0]]
    Z = U[: len(s)] + 1j * U[len(s) :]
    share = (np.arange(len(s)) < len(inside)).astype(float)
    rows, bounds = [], []
    for turn in np.exp(-2j * np.pi * np.arange(16) / 16):
        rows.append(np.column_stack([(turn * Z).real, -share]))
        bounds.append(np.where(share, (turn * 1j * loss).real, limit))
    A = np.vstack(rows)
    n = A.shape[1] - 1
    found = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=A,
        b_ub=np.concatenate(bounds),
        bounds=[(None, None)] * n + [(0.0, None)],
    )
    assert found.status == 0
    return float(found.fun) / np.cos(np.pi / 16)


class TestSpringOfConstantLoss:
    @pytest.mark.parametrize(
        ("loss", "band", "limit", "near"),
        [
            (0.05, (1.0, 100.0), 11.0, 1.1),
            (0.3, (1.0, 100.0), 3.0, 1.1),
            (0.3, (1.0, 10.0), 11.0, 1.3),
        ],
    )
    def test_stable_functions_come_as_near_and_no_nearer(
        self, loss: float, band: tuple[float, float], limit: float, near: float
    ) -> None:
        least = error_lower_bound(spring(loss, limit), band)
        assert least <= reached(loss, band, limit) <= near * least

    def test_a_power_of_s_has_its_phase(self) -> None:
        """c s^a has the phase of the spring at every line, and is off in size only (Kramers-Kronig)."""
        loss, band = 0.02, (1.0, 100.0)
        power = 2.0 * np.arctan(loss) / np.pi
        off = (band[1] / band[0]) ** (0.5 * power) - 1.0
        assert 1e-4 < error_lower_bound(spring(loss, 11.0), band) <= off

    def test_more_loss_a_wider_band_less_gain_cost_more(self) -> None:
        least = error_lower_bound(spring(0.05, 11.0), (1.0, 100.0))
        assert error_lower_bound(spring(0.1, 11.0), (1.0, 100.0)) > 1.5 * least
        assert error_lower_bound(spring(0.05, 11.0), (1.0, 1000.0)) > 1.5 * least
        assert error_lower_bound(spring(0.05, 3.0), (1.0, 100.0)) > 1.2 * least
        assert error_lower_bound(spring(0.05, 11.0), (0.0, 100.0)) > 4.0 * least

    def test_it_depends_on_the_ratio_of_the_band_alone(self) -> None:
        least = error_lower_bound(spring(0.05, 11.0), (1.0, 100.0))
        assert error_lower_bound(spring(0.05, 11.0), (3.7, 370.0)) == pytest.approx(least, rel=5e-3)

    def test_what_is_stable_costs_nothing(self) -> None:
        def resonance(freq: np.ndarray) -> np.ndarray:
            s = 2j * np.pi * freq
            return 1e3 / (s**2 + 0.6 * s + 4e3)

        channel = ChannelDifference(resonance, lambda freq: np.ones(len(freq)), 11.0, 11.0)
        assert np.abs(resonance(np.geomspace(1, 100, 2000))).max() > 5.0
        assert error_lower_bound(channel, (1.0, 100.0)) == 0.0


def chain(loss: float, viscous: float = 0.0) -> updyn.Model:
    """Two masses on the ground."""
    K = np.array([[3e4, -1e4], [-1e4, 1e4]])
    groups = {
        "springs": updyn.Group(K, loss_factor=loss, viscous=viscous * K),
        "masses": updyn.Group(mass=np.diag([1.0, 1.0])),
    }
    return updyn.Model.from_groups(groups, ["1:X", "2:X"])


class TestPlant:
    BAND = (2.0, 60.0)

    @pytest.mark.parametrize("quantity", ["receptance", "mobility", "accelerance"])
    def test_no_plant_is_nearer_whatever_its_route(self, quantity: str) -> None:
        found = {}
        for route, tolerance in (("modal", 0.2), ("complex", 0.2), ("rational", 0.05)):
            made = updyn.plant(
                chain(0.1),
                ["1:X"],
                ["1:X", "2:X"],
                self.BAND,
                tolerance,
                quantity=quantity,
                route=route,
            )
            assert made.facts["causal error"] <= made.relative_error
            found[route] = made.facts["causal error"]
        assert min(found.values()) > 1e-4
        # The gain that is allowed outside the band is counted from the plant: it counts by its logarithm.
        assert max(found.values()) < 1.2 * min(found.values())

    def test_dampers_are_causal(self) -> None:
        made = updyn.plant(chain(0.0, 1e-3), ["1:X"], ["2:X"], self.BAND, 0.01)
        assert made.facts["causal error"] == 0.0

    def test_of_peaks(self) -> None:
        made = updyn.plant(chain(0.1), ["1:X"], ["1:X"], self.BAND, 0.05, error="peak")
        assert 0.0 <= made.facts["causal error"] <= made.error

    def test_a_file_holds_it(self, tmp_path) -> None:
        made = updyn.plant(chain(0.1), ["1:X"], ["1:X"], self.BAND, 0.05)
        updyn.write_plant(made, tmp_path / "p.json")
        kept = updyn.read_plant(tmp_path / "p.json").facts["causal error"]
        assert kept == made.facts["causal error"] > 0.0

    def test_what_no_stable_plant_can_is_said(self) -> None:
        with pytest.raises(ToleranceError, match=r"not causal \(Kramers-Kronig\)") as caught:
            updyn.plant(chain(0.3), ["1:X"], ["1:X"], self.BAND, 1e-6)
        least = float(re.search(r"at least ([\d.e-]+)\.", str(caught.value))[1])
        reached = [float(x) for x in re.findall(r"([\d.e-]+) by route", str(caught.value))]
        assert 1e-6 < least <= min(reached)

    def test_what_a_stable_plant_might_is_said_too(self) -> None:
        with pytest.raises(ToleranceError, match="Causality does not prevent it") as caught:
            updyn.plant(chain(0.3), ["1:X"], ["1:X"], self.BAND, 0.02, route="modal")
        assert "not causal" not in str(caught.value)
