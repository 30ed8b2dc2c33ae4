"""`Start`: a model beside a test before any fit, as a page shows it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.counterparts import Counterparts
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["Start"]


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """A model where its update would start, beside the measurement of a test.

    Attributes
    ----------
    model : Model
        The model.
    data : FRF or ModeSet
        All data of the test, named as the model names its DOFs.
    parameters : ParameterSet
        The unknowns that would be fitted.
    identifiability : Identifiability
        What the data of all tests could determine of them.
    covariance : ndarray of float, shape (n, n)
        Expected of the unknowns from the noise of the data, at the start: of the logarithm of
        factors, of loss factors themselves; rows of unknowns that are not determined are inf.
    findings : tuple of Finding
        What seems to be wrong with data or model before any fit, the likeliest first.
    matching : str
        Who sits where, as text; empty where it is not shown.
    title : str
        Of the job.
    lines : ndarray of float
        Lines that the fit would use, in Hz; empty where they are chosen by the fit, and of modes.
    validation_responses : tuple of str
        Responses that would be held out.
    validation_band : (float, float) or None
        Band that would be held out, in Hz.
    modes : ModeSet or None
        Modes of the test that are known beside its FRFs.
    options : mapping
        Options of the method, which say how a large model is solved.
    figures : mapping of str to float
        Figures of agreement of the model with the data of the fit (`Correlation.figures`). If
        empty, the page shows those of the FRFs that are computed for it.
    counterparts : Counterparts or None
        How many modes of the test have a counterpart in the model; None where that was not asked.
    """

    model: Model
    data: FRF | ModeSet
    parameters: ParameterSet
    identifiability: Identifiability
    covariance: NDArray[np.float64]
    findings: tuple[Finding, ...] = ()
    matching: str = ""
    title: str = ""
    lines: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    validation_responses: tuple[str, ...] = ()
    validation_band: tuple[float, float] | None = None
    modes: ModeSet | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    figures: Mapping[str, float] = field(default_factory=dict)
    counterparts: Counterparts | None = None
