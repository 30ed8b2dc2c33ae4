"""A spring chain updated from noisy FRFs: maximum likelihood against the paper's equation error.

The residual of the equation error, Z_red H_X - I, has the measured H_X as a factor, so that noise
does not average out but biases the estimate: with ten times the frequency lines its standard
deviations decrease and its error does not. Maximum likelihood compares H_X with the model's H_A,
weighted with the noise, and its error decreases as the inverse square root of the number of lines.

Run it with ``python examples/noise_bias.py``; it prints the largest error of any stiffness or mass
factor.
"""

from __future__ import annotations

import numpy as np

import updyn

N = 6
SENSORS = ("1:X", "3:X", "5:X", "6:X")
HAMMER = ("1:X", "6:X")
NOISE = 0.02
TRUTH = {
    "base": {"stiffness": 0.8, "mass": 1.1, "loss_factor": 0.02},
    "middle": {"stiffness": 1.2, "mass": 0.9, "loss_factor": 0.05},
    "tip": {"stiffness": 0.9, "mass": 1.15, "loss_factor": 0.03},
}


def chain() -> updyn.Model:
    """Return fixed - k - m - k - m - ... - m in three groups of two springs and masses."""
    groups = {}
    for number, name in enumerate(TRUTH):
        K = np.zeros((N, N))
        M = np.zeros((N, N))
        for i in (2 * number, 2 * number + 1):
            M[i, i] = 1.0
            K[i, i] += 1e4
            if i:
                K[i - 1, i - 1] += 1e4
                K[i - 1, i] -= 1e4
                K[i, i - 1] -= 1e4
        groups[name] = updyn.Group(K, M, loss_factor=0.03)
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(N)])


def measure(model: updyn.Model, n_lines: int, seed: int) -> updyn.FRF:
    """Return receptances of the true chain with relative complex Gaussian noise."""
    exact = updyn.response(model.scaled(TRUTH), np.linspace(1.0, 32.0, n_lines), SENSORS, HAMMER)
    rng = np.random.default_rng(seed)
    real, imaginary = rng.normal(size=(2, *exact.values.shape)) / np.sqrt(2.0)
    values = exact.values * (1.0 + NOISE * (real + 1j * imaginary))
    return updyn.FRF(exact.freq, values, SENSORS, HAMMER, "receptance")


def worst(result: updyn.UpdateResult, quantities: tuple[str, ...]) -> tuple[float, float]:
    """Return the largest error, relative to the true value and to its standard deviation."""
    relative = []
    in_std = []
    for p in result.parameters:
        if p.quantity in quantities:
            true = TRUTH[p.group][p.quantity]
            relative.append(abs(result.values[p.name] / true - 1.0))
            in_std.append(abs(result.values[p.name] - true) / result.std[p.name])
    return max(relative), max(in_std)


def main() -> None:
    """Compare both methods with few and with many lines."""
    model = chain()
    unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    print(
        f"{100 * NOISE:g} % noise, {len(unknowns)} unknowns; largest error of stiffness and mass\n"
    )
    print(f"{'lines':>6}  {'method':<20}{'error':>8}  {'error / std':>11}")
    found = {}
    for n_lines in (60, 600):
        frf = measure(model, n_lines, seed=n_lines)
        for method in ("maximum-likelihood", "equation-error"):
            result = updyn.update(model, frf, unknowns, method=method)
            error, in_std = worst(result, ("stiffness", "mass"))
            found[n_lines, method] = error, in_std
            print(f"{n_lines:>6}  {method:<20}{100 * error:>7.2f}%  {in_std:>11.1f}")
    # The claims of the docstring.
    assert found[600, "maximum-likelihood"][1] < 4.0
    assert found[600, "equation-error"][0] > 10 * found[600, "maximum-likelihood"][0]
    assert found[600, "equation-error"][1] > 4.0
    assert found[600, "equation-error"][0] > 0.5 * found[60, "equation-error"][0]


if __name__ == "__main__":
    main()
