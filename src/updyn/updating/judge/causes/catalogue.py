"""Registry of the kinds of faults, and the reader of faults in a job."""

from __future__ import annotations

from updyn.errors import OptionError, suggest
from updyn.registry import Registry
from updyn.updating.judge.causes.channel_factor import Calibration, Delay, LowPass, WrongSign
from updyn.updating.judge.causes.conjugate import ConjugatedData
from updyn.updating.judge.causes.dead_channel import DeadChannel
from updyn.updating.judge.causes.drive_point import DrivePoint
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.frequency_scale import FrequencyScale
from updyn.updating.judge.causes.leakage import Leakage
from updyn.updating.judge.causes.loss_over_frequency import LossOverFrequency
from updyn.updating.judge.causes.mains import MainsHum
from updyn.updating.judge.causes.mass_loading import MassLoading
from updyn.updating.judge.causes.missing_mass import MissingMass
from updyn.updating.judge.causes.missing_mode import MissingMode
from updyn.updating.judge.causes.missing_spring import MissingSpring
from updyn.updating.judge.causes.missing_viscous import MissingViscous
from updyn.updating.judge.causes.model_unit import ModelUnit
from updyn.updating.judge.causes.moved import MisplacedSensor
from updyn.updating.judge.causes.no_support import NoSupport
from updyn.updating.judge.causes.other_test import OtherTest
from updyn.updating.judge.causes.quantity import WrongQuantity
from updyn.updating.judge.causes.reciprocity import Reciprocity
from updyn.updating.judge.causes.rigid_body import RigidBody
from updyn.updating.judge.causes.scale import WrongUnit
from updyn.updating.judge.causes.support import Suspension
from updyn.updating.judge.causes.swapped import SwappedChannels
from updyn.updating.judge.causes.turned import TurnedSensor
from updyn.updating.judge.causes.window import WindowDamping
from updyn.updating.judge.causes.wrong_axes import WrongAxes

__all__ = ["CAUSES", "read_fault"]

_BUILT_IN: tuple[type[Fault], ...] = (
    WrongQuantity,
    WrongUnit,
    ConjugatedData,
    WrongSign,
    SwappedChannels,
    TurnedSensor,
    MisplacedSensor,
    Calibration,
    Delay,
    LowPass,
    FrequencyScale,
    WindowDamping,
    MassLoading,
    OtherTest,
    Suspension,
    NoSupport,
    MissingMode,
    MissingSpring,
    MissingMass,
    MissingViscous,
    LossOverFrequency,
    ModelUnit,
    WrongAxes,
    DeadChannel,
    MainsHum,
    Leakage,
    DrivePoint,
    Reciprocity,
    RigidBody,
)

#: Kinds of faults by name. A further kind derives from `Fault` and is registered here.
CAUSES: Registry[type[Fault]] = Registry(
    "cause", "updyn.causes", {cause.kind: cause for cause in _BUILT_IN}
)


def read_fault(text: str) -> Fault:
    """Return the fault of a text such as ``"sign:2:Z"`` or ``"calibration:5:Z=0.095"``."""
    head, _, value = text.partition("=")
    kind, _, channels = head.partition(":")
    kind = kind.strip()
    if kind not in CAUSES:
        raise OptionError(f"repair {text!r}: {suggest(kind, CAUSES)}")
    return CAUSES.find(kind).parse(channels, value.strip())
