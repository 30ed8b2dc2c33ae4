"""Inertias on a shaft, with torques on both ends and every kind of output; the same for python-control."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import control
import numpy as np
import pytest

import updyn
from updyn.control.plant import Plant
from updyn.control.ports import Port

#: python-control 0.10.2 sets the shape of arrays, which numpy 2.5 deprecates. Where warnings are
#: errors, its ``feedback`` catches that one and returns an ``InterconnectedSystem`` without poles.
SETS_SHAPES = pytest.mark.filterwarnings(
    "ignore:Setting the shape on a NumPy array:DeprecationWarning:control.statesp"
)
MOTOR, LOAD, STIFFNESS, DAMPING = 2.0, 5.0, 3e3, 2.0
#: What can be asked of an output: which mass, and how often differentiated.
OUTPUTS = {"angle": (0, 0), "speed": (0, 1), "load": (1, 0), "load speed": (1, 1)}


def masses(
    J: Sequence[float],
    k: Sequence[float],
    c: Sequence[float],
    *,
    ground: float = 0.0,
    outputs: Sequence[str] = ("angle", "speed", "load", "load speed"),
    **more: Any,
) -> Plant:
    """Return a chain of inertias; torques ``"motor"`` on the first and ``"wind"`` on the last."""
    n = len(J)
    K, C = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n - 1):
        link = np.zeros(n)
        link[i], link[i + 1] = 1.0, -1.0
        K += k[i] * np.outer(link, link)
        C += c[i] * np.outer(link, link)
    K[0, 0] += ground
    M = np.asarray(J, dtype=float)[:, None]
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-K / M, -C / M]])
    B = np.zeros((2 * n, 2))
    B[n, 0], B[-1, 1] = 1.0 / J[0], 1.0 / J[-1]
    rows = np.zeros((len(outputs), 2 * n))
    for row, name in zip(rows, outputs, strict=True):
        mass, power = OUTPUTS[name]
        row[power * n + (0 if mass == 0 else n - 1)] = 1.0
    ports = tuple(Port(name, {f"{1 + (n - 1) * OUTPUTS[name][0]}:RZ": 1.0}) for name in outputs)
    given = {
        "quantities": tuple(("receptance", "mobility")[OUTPUTS[name][1]] for name in outputs),
        "band": (0.0, 1e4), "tolerance": 0.02, "error": 0.0, "peak_error": 0.0, "route": "by hand",
        "rigid": 0 if ground else 1,
    }  # fmt: skip
    torques = (Port("motor", {"1:RZ": 1.0}), Port("wind", {f"{n}:RZ": 1.0}))
    return Plant(A, B, rows, np.zeros((len(outputs), 2)), torques, ports, **{**given, **more})


def two_masses(stiffness: float = STIFFNESS, damping: float = DAMPING, **more: Any) -> Plant:
    return masses((MOTOR, LOAD), (stiffness,), (damping,), **more)


def rigid(inertia: float = 3.0, **more: Any) -> Plant:
    return masses((inertia,), (), (), **more)


def speed_over_torque() -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of the two masses from motor torque to motor speed, in powers of s."""
    below = [MOTOR * LOAD, (MOTOR + LOAD) * DAMPING, (MOTOR + LOAD) * STIFFNESS, 0.0]
    return np.array([LOAD, DAMPING, STIFFNESS]), np.array(below)


NAMES = {"torque": "motor", "velocity": "speed"}
BOTH = {**NAMES, "position": "angle"}
PI_ = updyn.Controller(kp=170.0, ti=0.2)
NOTCHED = updyn.Controller(
    170.0,
    ti=0.2,
    kv=6.0,
    notches=(updyn.Notch(9.0, 0.1, 0.5),),
    low_pass=60.0,
    low_pass_damping=0.7,
)


def quick(plant, controller, **names):
    return updyn.servo(plant, controller, step=None, disturbance_step=None, **names)


def as_control(controller):
    """The controller as python-control has it, without dead time."""
    s = control.tf("s")
    out = (
        controller.kp * (1 + 1 / (controller.ti * s))
        if controller.ti
        else control.tf([controller.kp], [1])
    )
    for n in controller.notches:
        w = 2 * np.pi * n.frequency
        out *= (s**2 + 2 * n.zero_damping * w * s + w**2) / (
            s**2 + 2 * n.pole_damping * w * s + w**2
        )
    if controller.low_pass:
        w = 2 * np.pi * controller.low_pass
        d = controller.low_pass_damping
        out *= w / (s + w) if d is None else w**2 / (s**2 + 2 * d * w * s + w**2)
    return out


def compare(margins, L, rtol=1e-7):
    gm, pm, sm, wpc, wgc, _ = control.stability_margins(L, returnall=True)
    real = np.flatnonzero(wpc > 0)
    order = real[np.argsort(wpc[real])]
    np.testing.assert_allclose(margins.phase_crossings, wpc[order] / (2 * np.pi), rtol=rtol)
    np.testing.assert_allclose(margins.gain_margins, gm[order], rtol=100 * rtol)
    order = np.argsort(wgc)
    np.testing.assert_allclose(margins.gain_crossings, wgc[order] / (2 * np.pi), rtol=rtol)
    np.testing.assert_allclose(margins.phase_margins, pm[order], rtol=1e-5, atol=1e-5)
    assert margins.stable == bool(
        (control.feedback(control.minreal(L, 1e-9, verbose=False), 1).poles().real < 1e-9).all()
    )
    if margins.stable:
        assert margins.modulus_margin == pytest.approx(
            min(sm.min(), 1.0), rel=1e-6
        )  # 1 where L has vanished
