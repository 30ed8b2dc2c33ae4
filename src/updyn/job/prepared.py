"""`Prepared`: a job with the model, the data and the unknowns that it names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.job.schema import Job
from updyn.matching import Matching
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["Prepared", "PreparedTest"]


@dataclass(frozen=True, slots=True, eq=False)
class PreparedTest:
    """One test of a job, with its configuration of the model.

    Attributes
    ----------
    job : Job
        The job, with this test.
    model : Model
        Where the update starts; DOFs of nodes with oblique sensors are turned along them.
    data : FRF or ModeSet
        The data in the job's band, named as the model names its DOFs.
    fitted : FRF or ModeSet
        Of these, what is fitted: all but what is held out for validation.
    matching : Matching
        Who sits where.
    modes : ModeSet or None
        The modes that the job names beside FRFs, named as the model names its DOFs.
    """

    job: Job
    model: Model
    data: FRF | ModeSet
    fitted: FRF | ModeSet
    matching: Matching
    modes: ModeSet | None = None

    @property
    def frf(self) -> FRF:
        """The measured FRFs in the job's band.

        Raises
        ------
        OptionError
            If modes were measured.
        """
        if isinstance(self.data, FRF):
            return self.data
        raise OptionError("the test measured modes; this takes FRFs", key=("test", "modes"))

    @property
    def freq(self) -> NDArray[np.float64]:
        """Frequencies of the data in Hz, ascending: the lines, or those of the modes."""
        return self.data.freq if isinstance(self.data, FRF) else self.data.frequency

    @property
    def name(self) -> str:
        """What the test is called; empty where it is the only one."""
        return self.job.test.name


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A job with all that it names, ready to run.

    Attributes
    ----------
    job : Job
        The job.
    tests : tuple of PreparedTest
        Its tests.
    parameters : ParameterSet
        The unknowns.
    """

    job: Job
    tests: tuple[PreparedTest, ...]
    parameters: ParameterSet

    @property
    def modes(self) -> dict[str, ModeSet]:
        """The modes that the job names, by the names of their tests."""
        return {test.name: test.modes for test in self.tests if test.modes is not None}

    @property
    def modes_option(self) -> ModeSet | dict[str, ModeSet]:
        """The modes as an option of a method: of a single test, or by the names of several."""
        if len(self.tests) > 1:
            return self.modes
        return self.modes[self.tests[0].name]

    @property
    def model(self) -> Model:
        """The model of the first test."""
        return self.tests[0].model

    @property
    def frf(self) -> FRF:
        """The data of the first test."""
        return self.tests[0].frf

    @property
    def fitted(self) -> FRF | ModeSet:
        """What is fitted of the first test."""
        return self.tests[0].fitted

    @property
    def matching(self) -> Matching:
        """Who sits where in the first test."""
        return self.tests[0].matching
