"""`Start`: a model and a test before any fit, as shown on a page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from updyn.arrays import RealArray
from updyn.correlation.model_modes import ModelModes
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.counterparts import Counterparts
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.judge.modal_table import ModalTable
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["Start"]


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """A model at the start of an update, with the measurement of a test.

    Attributes
    ----------
    model : Model
        The model.
    data : FRF or ModeSet
        All data of the test, labelled with the DOFs of the model.
    parameters : ParameterSet
        The unknowns that would be fitted.
    identifiability : Identifiability
        Identifiability of the unknowns from the data of all tests.
    covariance : ndarray of float, shape (n, n)
        Expected covariance of the unknowns at the start, from the noise of the data: of the
        logarithm of factors, and of the loss factors themselves. Rows of undetermined unknowns are
        inf.
    findings : tuple of Finding
        Suspected faults of data or model before any fit, most likely first.
    matching : str
        Matching of sensors and DOFs as text; empty if not shown.
    title : str
        Title of the job.
    lines : ndarray of float
        Lines that the fit would use, in Hz; empty for modes, and if the fit chooses the lines.
    validation_responses : tuple of str
        Responses that would be held out.
    validation_band : (float, float) or None
        Band that would be held out, in Hz.
    modes : ModeSet or None
        Modes of the test that are known in addition to its FRFs.
    options : mapping
        Options of the method, which determine how a large model is solved.
    figures : mapping of str to float
        Figures of agreement of the model with the data of the fit (`Correlation.figures`). If
        empty, the page shows those of the FRFs computed for it.
    counterparts : Counterparts or None
        Number of test modes with a counterpart in the model; None if not examined.
    job : str
        Name of the job file, for commands.
    computed : FRF or None
        FRFs of the model if they are known, on lines of the data; the page computes others.
    table : ModalTable or None
        Modes of test and model if they are known; else the page computes them.
    model_modes : ModelModes or None
        Modes of `model` that are known, so that the page does not compute them again.
    """

    model: Model
    data: FRF | ModeSet
    parameters: ParameterSet
    identifiability: Identifiability
    covariance: RealArray
    findings: tuple[Finding, ...] = ()
    matching: str = ""
    title: str = ""
    lines: RealArray = field(default_factory=lambda: np.empty(0))
    validation_responses: tuple[str, ...] = ()
    validation_band: tuple[float, float] | None = None
    modes: ModeSet | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)
    counterparts: Counterparts | None = None
    job: str = "job.toml"
    computed: FRF | None = None
    table: ModalTable | None = None
    model_modes: ModelModes | None = None
