"""Plants written by hand, whose sampled forms and responses are known in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from updyn.control.plant import Plant
from updyn.control.ports import Port

FACTS = {
    "order": 2,
    "lines": np.array([1.0, 2.5]),
    "band": (0.0, np.inf),
    "note": "µ, \"quoted\", 'so'",
    "none": None,
}


def plant(
    A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike | None = None, **more: Any
) -> Plant:
    """Return a plant with one port for each column of B and row of C."""
    A, B, C = np.atleast_2d(A), np.atleast_2d(B), np.atleast_2d(C)
    D = np.zeros((len(C), B.shape[1])) if D is None else D
    given = {
        "input_ports": tuple(Port.at(f"{k}:RZ", f"torque {k}") for k in range(1, B.shape[1] + 1)),
        "output_ports": tuple(Port.at(f"{k}:RZ", f"angle {k}") for k in range(1, len(C) + 1)),
        "quantities": ("receptance",) * len(C),
        "band": (0.1, 2.0),
        "tolerance": 0.02,
        "error": 0.013,
        "peak_error": 0.004,
        "route": "modal",
    }
    return Plant(A, B, C, D, **{**given, **more})


def double_integrator(inertia: float = 2.0) -> Plant:
    """Return 1 / (J s^2)."""
    return plant([[0, 1], [0, 0]], [[0], [1 / inertia]], [[1, 0]], rigid=1, modes=[0.0])


def oscillator(frequency: float = 3.0, damping: float = 0.05, **more: Any) -> Plant:
    """Return omega^2 / (s^2 + 2 zeta omega s + omega^2), displacement and velocity its states."""
    omega = 2 * np.pi * frequency
    A = [[0, 1], [-(omega**2), -2 * damping * omega]]
    return plant(A, [[0], [omega**2]], [[1, 0]], **{"modes": [frequency], **more})


def two_masses(**more: Any) -> Plant:
    """Return two inertias on a damped shaft, free to turn: two torques in, both angles and one acceleration out."""
    M, K = np.diag([2.0, 0.5]), np.array([[40.0, -40.0], [-40.0, 40.0]])
    A = np.block(
        [[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, 0.004 * K)]]
    )
    B = np.vstack([np.zeros((2, 2)), np.linalg.solve(M, np.eye(2))])
    C = np.vstack([np.hstack([np.eye(2), np.zeros((2, 2))]), A[2:3]])
    D = np.vstack([np.zeros((2, 2)), B[2:3]])
    geared = Port.geared("2:RZ", -92.5)
    ports = (Port.at("1:RZ"), Port.at("2:-RZ", 'second "angle" ??/ */ \\'), geared)
    given = {
        "input_ports": (
            Port.at("1:RZ"),
            Port("pair of forces", {"2:X": 0.25, "3:-X": 1 / 3}, rotation=True),
        ),
        "output_ports": ports,
        "quantities": ("receptance", "receptance", "accelerance"),
        "band": (0.05, 2.5),
        "rigid": 1,
        "modes": [0.0, np.sqrt(40 * 2.5) / (2 * np.pi)],
        "facts": FACTS,
    }
    return plant(A, B, C, D, **{**given, **more})


def simulate(found: Plant, inputs: NDArray[Any]) -> NDArray[np.float64]:
    """Return the outputs, shape (n, n_outputs), of inputs of shape (n, n_inputs), from rest."""
    x, out = np.zeros(found.n_states), np.empty((len(inputs), len(found.C)))
    for k, u in enumerate(inputs):
        out[k] = found.C @ x + found.D @ u
        x = found.A @ x + found.B @ u
    return out
