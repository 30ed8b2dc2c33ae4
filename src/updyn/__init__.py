"""updyn: finite-element model updating from measured frequency response functions.

Read a model and measured FRFs, choose the unknowns, update, judge, hand over::

    model = updyn.read_model("model.h5")
    frf = updyn.read_frf("test.uff")
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    result = updyn.update(model, frf, unknowns)
    print(result.summary())

Importing updyn loads numpy and scipy only; every name below is loaded when it is first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from updyn.comparison import Comparison as Comparison
    from updyn.comparison import compare as compare
    from updyn.comparison import compare_jointly as compare_jointly
    from updyn.control.build import conversions as conversions
    from updyn.control.build import plant as plant
    from updyn.control.family import plant_family as plant_family
    from updyn.control.files.plant_file import read_plant as read_plant
    from updyn.control.files.plant_file import write_plant as write_plant
    from updyn.control.nonlinear.balance import limit_cycles as limit_cycles
    from updyn.control.nonlinear.elements import Backlash as Backlash
    from updyn.control.nonlinear.elements import CoulombFriction as CoulombFriction
    from updyn.control.nonlinear.opened import opened as opened
    from updyn.control.nonlinear.simulate import simulate as simulate
    from updyn.control.plant import Plant as Plant
    from updyn.control.ports import Port as Port
    from updyn.control.python_control import to_control as to_control
    from updyn.control.python_control import to_frd as to_frd
    from updyn.control.python_control import to_scipy as to_scipy
    from updyn.control.sampled import sampled as sampled
    from updyn.control.servo.controller import Controller as Controller
    from updyn.control.servo.controller import Notch as Notch
    from updyn.control.servo.drive import drive_figures as drive_figures
    from updyn.control.servo.servo import servo as servo
    from updyn.control.servo.wind import Wind as Wind
    from updyn.control.weight import uncertainty_weight as uncertainty_weight
    from updyn.correlation import correlate as correlate
    from updyn.dofs import Dof as Dof
    from updyn.dofs import DofSet as DofSet
    from updyn.dynamics.condensation import condense as condense
    from updyn.dynamics.modes import modes as modes
    from updyn.dynamics.response import response as response
    from updyn.errors import UpdynError as UpdynError
    from updyn.errors import UpdynWarning as UpdynWarning
    from updyn.frf import FRF as FRF
    from updyn.geometry import Geometry as Geometry
    from updyn.group import Group as Group
    from updyn.group import LossTable as LossTable
    from updyn.io import read_frf as read_frf
    from updyn.io import read_geometry as read_geometry
    from updyn.io import read_model as read_model
    from updyn.io import read_modes as read_modes
    from updyn.io import write_frf as write_frf
    from updyn.io import write_model as write_model
    from updyn.io import write_modes as write_modes
    from updyn.io import write_properties as write_properties
    from updyn.matching import match as match
    from updyn.modal import ModeSet as ModeSet
    from updyn.modal import identify_modes as identify_modes
    from updyn.model import Model as Model
    from updyn.report import write_report as write_report
    from updyn.store.result import read_result as read_result
    from updyn.store.result import write_result as write_result
    from updyn.store.uncertainty import read_uncertainty as read_uncertainty
    from updyn.store.uncertainty import write_uncertainty as write_uncertainty
    from updyn.uncertainty.bootstrap import bootstrap as bootstrap
    from updyn.uncertainty.prediction import predict as predict
    from updyn.uncertainty.profile import profile as profile
    from updyn.uncertainty.sampling import sample as sample
    from updyn.updating.judge.selection import cluster as cluster
    from updyn.updating.judge.selection import cluster_jointly as cluster_jointly
    from updyn.updating.judge.selection import select as select
    from updyn.updating.judge.selection import select_jointly as select_jointly
    from updyn.updating.problem.channels import calibration as calibration
    from updyn.updating.problem.data import Test as Test
    from updyn.updating.problem.data import complete_parts as complete_parts
    from updyn.updating.problem.noise.repeats import average as average
    from updyn.updating.problem.parameters import link as link
    from updyn.updating.problem.parameters import parameters as parameters
    from updyn.updating.problem.selection import Selection as Selection
    from updyn.updating.problem.sensor_masses import sensor_masses as sensor_masses
    from updyn.updating.result import JointResult as JointResult
    from updyn.updating.result import UpdateResult as UpdateResult
    from updyn.updating.update import update as update
    from updyn.updating.update import update_jointly as update_jointly

__version__ = "0.1.0"

_WHERE = {
    "Backlash": "updyn.control.nonlinear.elements",
    "Comparison": "updyn.comparison",
    "Controller": "updyn.control.servo.controller",
    "CoulombFriction": "updyn.control.nonlinear.elements",
    "Dof": "updyn.dofs",
    "DofSet": "updyn.dofs",
    "FRF": "updyn.frf",
    "Geometry": "updyn.geometry",
    "Group": "updyn.group",
    "JointResult": "updyn.updating.result",
    "LossTable": "updyn.group",
    "ModeSet": "updyn.modal",
    "Model": "updyn.model",
    "Plant": "updyn.control.plant",
    "Port": "updyn.control.ports",
    "Notch": "updyn.control.servo.controller",
    "Selection": "updyn.updating.problem.selection",
    "Test": "updyn.updating.problem.data",
    "UpdateResult": "updyn.updating.result",
    "UpdynError": "updyn.errors",
    "UpdynWarning": "updyn.errors",
    "Wind": "updyn.control.servo.wind",
    "calibration": "updyn.updating.problem.channels",
    "cluster": "updyn.updating.judge.selection",
    "cluster_jointly": "updyn.updating.judge.selection",
    "bootstrap": "updyn.uncertainty.bootstrap",
    "compare": "updyn.comparison",
    "compare_jointly": "updyn.comparison",
    "average": "updyn.updating.problem.noise.repeats",
    "complete_parts": "updyn.updating.problem.data",
    "condense": "updyn.dynamics.condensation",
    "conversions": "updyn.control.build",
    "correlate": "updyn.correlation",
    "drive_figures": "updyn.control.servo.drive",
    "identify_modes": "updyn.modal",
    "limit_cycles": "updyn.control.nonlinear.balance",
    "link": "updyn.updating.problem.parameters",
    "match": "updyn.matching",
    "modes": "updyn.dynamics.modes",
    "opened": "updyn.control.nonlinear.opened",
    "parameters": "updyn.updating.problem.parameters",
    "plant": "updyn.control.build",
    "plant_family": "updyn.control.family",
    "predict": "updyn.uncertainty.prediction",
    "profile": "updyn.uncertainty.profile",
    "sample": "updyn.uncertainty.sampling",
    "read_frf": "updyn.io",
    "read_geometry": "updyn.io",
    "read_model": "updyn.io",
    "read_modes": "updyn.io",
    "read_plant": "updyn.control.files.plant_file",
    "read_result": "updyn.store.result",
    "read_uncertainty": "updyn.store.uncertainty",
    "response": "updyn.dynamics.response",
    "sampled": "updyn.control.sampled",
    "select": "updyn.updating.judge.selection",
    "select_jointly": "updyn.updating.judge.selection",
    "sensor_masses": "updyn.updating.problem.sensor_masses",
    "to_control": "updyn.control.python_control",
    "to_frd": "updyn.control.python_control",
    "to_scipy": "updyn.control.python_control",
    "uncertainty_weight": "updyn.control.weight",
    "servo": "updyn.control.servo.servo",
    "simulate": "updyn.control.nonlinear.simulate",
    "update": "updyn.updating.update",
    "update_jointly": "updyn.updating.update",
    "write_frf": "updyn.io",
    "write_model": "updyn.io",
    "write_modes": "updyn.io",
    "write_plant": "updyn.control.files.plant_file",
    "write_properties": "updyn.io",
    "write_report": "updyn.report",
    "write_result": "updyn.store.result",
    "write_uncertainty": "updyn.store.uncertainty",
}

__all__ = ["__version__", *_WHERE]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'updyn' has no attribute {name!r}")
    value = getattr(importlib.import_module(_WHERE[name]), name)
    globals()[name] = value  # found once, then as fast as any attribute
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
