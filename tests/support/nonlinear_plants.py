"""Plants by hand for the nonlinear loops: two inertias with an open mesh, and one inertia with friction."""

from __future__ import annotations

import numpy as np

from updyn.control.plant import Plant
from updyn.control.ports import Port

BAND = (0.0, 100.0)


def two_inertias(motor: float = 1.0, load: float = 4.0, drag: float = 0.0) -> Plant:
    """States motor angle and speed, load angle and speed; the mesh between both is open, its port is "gap"."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[1, 1], A[3, 3] = -drag / motor, -drag / load
    B = np.array([[0, 0, 0], [1 / motor, 1 / motor, 0], [0, 0, 0], [0, -1 / load, 1 / load]])
    C = np.array([[0, 1, 0, 0], [0, 0, 1, 0], [1, 0, 0, 0], [1, 0, -1, 0]], dtype=float)
    gap = Port("gap", {"1:RZ": 1, "2:RZ": -1})
    outputs = (Port.at("1:RZ", "speed"), Port.at("2:RZ", "load"), Port.at("1:RZ", "encoder"), gap)
    kinds = ("mobility", "receptance", "receptance", "receptance")
    inputs = (Port.at("1:RZ", "torque"), gap, Port.at("2:RZ", "wind"))
    return Plant(A, B, C, np.zeros((4, 3)), inputs, outputs, kinds, BAND, 0.02, 0.0, 0.0, "by hand")


def one_inertia(J: float = 1.0) -> Plant:
    """States angle and speed; friction acts at "drag"."""
    A, B = np.array([[0, 1.0], [0, 0]]), np.array([[0, 0], [1 / J, 1 / J]])
    ports = (Port.at("1:RZ", "torque"), Port.at("1:RZ", "drag"))
    outputs = (Port.at("1:RZ", "angle"), Port.at("1:RZ", "drag"))
    return Plant(
        A,
        B,
        np.eye(2),
        np.zeros((2, 2)),
        ports,
        outputs,
        ("receptance", "mobility"),
        BAND,
        0.02,
        0,
        0,
        "by hand",
    )
