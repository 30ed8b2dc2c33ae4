"""A drive of two inertias, its stiffness and damping drawn: responses, poles and zeros known in closed form."""

from __future__ import annotations

import numpy as np

from updyn.control.family import PlantFamily
from updyn.control.plant import Plant
from updyn.control.ports import Port

MOTOR, LOAD = 0.5, 2.0
STIFFNESS, DAMPING = 1e4, 2.0


def drive(
    k: float = STIFFNESS, c: float = DAMPING, motor: float = MOTOR, load: float = LOAD
) -> Plant:
    """Torque on the motor to the speeds of motor and load."""
    K, M = np.array([[1.0, -1.0], [-1.0, 1.0]]), np.array([[motor], [load]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-k * K / M, -c * K / M]])
    B = np.array([[0.0], [0.0], [1 / motor], [0.0]])
    C = np.array([[0.0, 0, 1, 0], [0, 0, 0, 1]])
    ends = (Port.at("1:RZ", "motor"), Port.at("2:RZ", "load"))
    return Plant(
        A, B, C, np.zeros((2, 1)), (Port.at("1:RZ", "torque"),), ends, ("mobility",) * 2, (1.0, 100.0), 0.02, 0.0, 0.0,
        "by hand", 1,
    )  # fmt: skip


def exact(s: np.ndarray, k: float = STIFFNESS, c: float = DAMPING) -> np.ndarray:
    """The same in closed form, shape (n_f, 2, 1)."""
    below = s * (MOTOR * LOAD * s**2 + (MOTOR + LOAD) * (c * s + k))
    return np.stack([(LOAD * s**2 + c * s + k) / below, (c * s + k) / below], axis=1)[:, :, None]


def drawn(n: int = 12, seed: int = 0, stiffness: float = 0.1, damping: float = 0.3) -> PlantFamily:
    """Stiffness and damping log-normal."""
    z = np.random.default_rng(seed).standard_normal((n, 2))
    k, c = STIFFNESS * np.exp(stiffness * z[:, 0]), DAMPING * np.exp(damping * z[:, 1])
    members = tuple(drive(a, b) for a, b in zip(k, c, strict=True))
    return PlantFamily(
        drive(), members, ("shaft.stiffness", "shaft.viscous"), np.column_stack([k, c])
    )
