"""Branched geared trains, all free to turn."""

from __future__ import annotations

import updyn
from updyn.elements.drivetrain import (
    Belt,
    Coupling,
    GearPair,
    Inertia,
    Motor,
    Planetary,
    Shaft,
    drivetrain,
)


def three_outputs() -> updyn.Model:
    """A motor on three outputs through four gear pairs: 12 inertias, 11 springs.

    Nodes: motor 1, pinion 2 on wheel 3; from its shaft pinion 4 on wheel 5 and output 6, and pinion
    7 on wheel 8 and output 9; from the shaft of wheel 8 pinion 10 on wheel 11 and output 12.
    """
    return drivetrain(
        [
            Motor("motor", 1, inertia=4e-3),
            Shaft("motor shaft", 1, 2, stiffness=2.0e3, loss_factor=0.04),
            GearPair("input", 2, 3, ratio=2.5, torsional_stiffness=6.0e4, loss_factor=0.02,
                     inertia_a=1.5e-3, inertia_b=2.5e-2),
            Shaft("lay shaft", 3, 4, stiffness=1.5e4, loss_factor=0.02),
            GearPair("first", 4, 5, ratio=2.0, torsional_stiffness=9.0e4, loss_factor=0.02,
                     inertia_a=8e-3, inertia_b=6e-2),
            Shaft("first shaft", 5, 6, stiffness=3.0e4, loss_factor=0.04),
            Inertia("first output", 6, value=0.25),
            Shaft("cross shaft", 3, 7, stiffness=1.1e4, loss_factor=0.02),
            GearPair("second", 7, 8, ratio=1.6, torsional_stiffness=7.0e4, loss_factor=0.02,
                     inertia_a=7e-3, inertia_b=4e-2),
            Shaft("second shaft", 8, 9, stiffness=1.6e4, loss_factor=0.04),
            Inertia("second output", 9, value=0.15),
            Shaft("rear shaft", 8, 10, stiffness=2.2e4, loss_factor=0.02),
            GearPair("third", 10, 11, ratio=1.8, torsional_stiffness=8.0e4, loss_factor=0.02,
                     inertia_a=1e-2, inertia_b=7e-2),
            Shaft("third shaft", 11, 12, stiffness=2.5e4, loss_factor=0.04),
            Inertia("third output", 12, value=0.3),
        ],
        title="Motor on three outputs",
    )  # fmt: skip


def two_motors() -> updyn.Model:
    """An azimuth drive: two motors, each with coupling and two gear pairs, on one turntable.

    Nodes: motors 1 and 11, pinions 2 and 12 on wheels 3 and 13, final pinions 4 and 14 on the rim
    of the bull gear 5, turntable 6 and the payload on it 7.
    """
    parts = [
        Shaft("pedestal", 5, 6, stiffness=8.0e6, loss_factor=0.02),
        Inertia("rim", 5, value=60.0),
        Inertia("table", 6, value=250.0),
        Shaft("yoke", 6, 7, stiffness=3.0e6, loss_factor=0.03),
        Inertia("payload", 7, value=120.0),
    ]
    for side, first in (("east", 1), ("west", 11)):
        # The two drives are of one drawing, and not quite alike.
        unlike = 1.0 if side == "east" else 1.15
        parts += [
            Motor(f"{side} motor", first, inertia=2e-3 * unlike),
            Coupling(f"{side} coupling", first, first + 1, stiffness=4.0e3 / unlike,
                     inertia_b=6e-4 * unlike, loss_factor=0.02),
            GearPair(f"{side} reducer", first + 1, first + 2, ratio=12.0,
                     torsional_stiffness=6.0e5 * unlike, inertia_b=0.08, loss_factor=0.01),
            Shaft(f"{side} shaft", first + 2, first + 3, stiffness=2.5e5, loss_factor=0.01),
            GearPair(f"{side} final", first + 3, 5, ratio=15.0, torsional_stiffness=4.0e7 / unlike,
                     inertia_a=0.02 * unlike, loss_factor=0.01),
        ]  # fmt: skip
    return drivetrain(parts, title="Two motors on a turntable")


def planetary_and_belt() -> updyn.Model:
    """A motor whose planetary stage drives a drum, with a fan on a belt and an encoder.

    Nodes: motor 1, encoder 2 on its rear end, sun 3, carrier 5, drum 6, brake disc 10 behind it,
    fan pulleys 7 and 8, impeller 9; the ring is held. The meshes are stiff beside the shafts: the
    stage is a rigid ratio.
    """
    return drivetrain(
        [
            Motor("motor", 1, inertia=8e-3),
            Shaft("rear shaft", 1, 2, stiffness=1.2e3, loss_factor=0.02),
            Inertia("encoder disc", 2, value=4e-4),
            Shaft("sun shaft", 1, 3, stiffness=9.0e3, loss_factor=0.01),
            Planetary("stage", 3, 4, 5, teeth=(24, 72), rigid=True),
            Inertia("carrier", 5, value=4e-2),
            Shaft("drum shaft", 5, 6, stiffness=3.0e4, loss_factor=0.02),
            Inertia("drum", 6, value=0.3),
            Shaft("disc shaft", 6, 10, stiffness=2.0e4, loss_factor=0.02),
            Inertia("brake disc", 10, value=5e-2),
            Shaft("fan shaft", 1, 7, stiffness=2.5e3, loss_factor=0.01),
            Belt("belt", 7, 8, radii=(0.05, 0.08), stiffness=6.0e5, inertia_a=1.5e-3,
                 inertia_b=6e-3, loss_factor=0.06),
            Shaft("impeller shaft", 8, 9, stiffness=4.0e3, loss_factor=0.01),
            Inertia("impeller", 9, value=3e-2),
        ],
        held=[4],
        keep=[3],
        title="Planetary stage with a fan on a belt",
    )  # fmt: skip
