"""Error of the unknowns by each choice of `regularise`, on ill- and well-determined chains.

A chain of masses fixed at one end, one unknown for the stiffness of each spring. The true
stiffnesses are drawn about the start, log-normal; the noise is proportional and estimated from the
residual. The root mean square is over unknowns and draws, of the logarithm of the stiffness over
the true one. The fits begin at the start: no search.

    python benchmarks/regularisation.py [--draws 50]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

import updyn
from updyn.frf import FRF
from updyn.model import Model

CHOICES = (None, "gcv", "l-curve", "discrepancy", "tsvd")


@dataclass(frozen=True)
class Setting:
    """A chain of `n` equal parts excited at its end; sensors, noise, spread of the stiffnesses."""

    name: str
    n: int
    sensors: tuple[str, ...]
    noise: float
    spread: float
    band: tuple[float, float, int]

    def model(self) -> Model:
        groups = {}
        for i in range(self.n):
            K, M = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
            K[i, i], M[i, i] = 1e5, 1.0
            if i:
                K[i - 1, i - 1], K[i, i - 1], K[i - 1, i] = 1e5, -1e5, -1e5
            groups[f"spring {i + 1}"] = updyn.Group(K, None, 0.02)
            groups[f"mass {i + 1}"] = updyn.Group(None, M)
        return Model.from_groups(groups, [f"{i + 1}:X" for i in range(self.n)])

    def draw(self, model: Model, seed: int) -> tuple[FRF, np.ndarray]:
        """Return data, and the logarithms of the true factors."""
        rng = np.random.default_rng(seed)
        truth = self.spread * rng.standard_normal(self.n)
        true = model.scaled(
            {f"spring {i + 1}": {"stiffness": float(np.exp(t))} for i, t in enumerate(truth)}
        )
        frf = updyn.response(true, np.linspace(*self.band), list(self.sensors), [f"{self.n}:X"])
        H = frf.values
        unit = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
        noisy = H * (1 + self.noise * unit)
        return FRF(frf.freq, noisy, frf.responses, frf.references, frf.quantity), truth


ILL = Setting("one sensor, 8 springs, the lowest modes", 8, ("8:X",), 0.02, 0.2, (4.0, 40.0, 60))
WELL = Setting("two sensors, 8 springs, all modes", 8, ("4:X", "8:X"), 0.05, 0.03, (4.0, 100.0, 60))


def errors(
    setting: Setting, choice: str | float | None, draws: int
) -> tuple[np.ndarray, list[float]]:
    """Return the errors of all draws, shape (draws, n), and the chosen priors or numbers kept."""
    model = setting.model()
    unknowns = updyn.parameters(model, stiffness="all")
    out, held = [], []
    for seed in range(draws):
        frf, truth = setting.draw(model, seed)
        result = updyn.update(model, frf, unknowns, regularise=choice, starts=0)
        out.append(np.log([result.values[name] for name in unknowns.names]) - truth)
        record = result.options.get("regularisation", {})
        held.append(float(record.get("prior_std", record.get("kept", np.nan))))
    return np.array(out), held


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=50)
    draws = parser.parse_args().draws
    for setting in (ILL, WELL):
        print(
            f"\n{setting.name}; {100 * setting.noise:g} % noise, {draws} draws, start off by"
            f" {setting.spread:g} rms"
        )
        print(
            f"{'':14}{'rms':>9}{'median':>9}{'over none':>11}{'better in':>11}"
            f"{'std or kept':>13}{'seconds':>9}"
        )
        plain = np.zeros(0)
        for choice in CHOICES:
            begun = time.perf_counter()
            error, held = errors(setting, choice, draws)
            each = np.sqrt(np.mean(error**2, axis=1))
            plain = each if choice is None else plain
            rms = np.sqrt(np.mean(each**2))
            over = rms / np.sqrt(np.mean(plain**2))
            print(
                f"{choice or 'none':14}{rms:9.4f}{np.median(each):9.4f}{over:11.3f}"
                f"{100 * np.mean(each < plain):9.0f} %{np.median(held):13.3g}"
                f"{time.perf_counter() - begun:9.1f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
