"""`Prepared`: a job with its model, data and unknowns."""

from __future__ import annotations

from dataclasses import dataclass

from updyn.arrays import RealArray
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.job.schema import Job
from updyn.matching import Matching
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.parameters import ParameterSet

__all__ = ["Prepared", "PreparedTest"]


@dataclass(frozen=True, slots=True, eq=False)
class PreparedTest:
    """One test of a job, with its configuration of the model at the start.

    DOFs of nodes with oblique sensors are rotated along them. `data` is in the job's band, `fitted`
    is `data` without the validation set; they and `modes` (named in addition to FRFs) have the DOF
    labels of the model. `noise` is the noise model of the data if it was chosen in advance.
    """

    job: Job
    model: Model
    data: FRF | ModeSet
    fitted: FRF | ModeSet
    matching: Matching
    modes: ModeSet | None = None
    noise: NoiseModel | None = None

    @property
    def frf(self) -> FRF:
        """The measured FRFs in the job's band; `OptionError` if modes were measured."""
        if isinstance(self.data, FRF):
            return self.data
        raise OptionError("the test measured modes; this takes FRFs", key=("test", "modes"))

    @property
    def freq(self) -> RealArray:
        """Frequencies of the data in Hz, ascending: frequency lines or natural frequencies."""
        return self.data.freq if isinstance(self.data, FRF) else self.data.frequency

    @property
    def name(self) -> str:
        """Name of the test; empty if it is the only one."""
        return self.job.test.name


@dataclass(frozen=True, slots=True, eq=False)
class Prepared:
    """A job with its model, data and unknowns, ready to run.

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
        """Measured modes that the job names, by test name."""
        return {test.name: test.modes for test in self.tests if test.modes is not None}

    @property
    def modes_option(self) -> ModeSet | dict[str, ModeSet]:
        """The modes as an option of a method: of a single test, or by test name."""
        if len(self.tests) > 1:
            return self.modes
        return self.modes[self.tests[0].name]

    @property
    def model(self) -> Model:
        """The model of the first test."""
        return self.tests[0].model

    @property
    def title(self) -> str:
        """The title of the job, else that of the model of the first test, else the file's name."""
        return self.job.find_title(self.model.title)

    @property
    def frf(self) -> FRF:
        """The data of the first test."""
        return self.tests[0].frf

    @property
    def fitted(self) -> FRF | ModeSet:
        """The fitted data of the first test."""
        return self.tests[0].fitted

    @property
    def matching(self) -> Matching:
        """Sensors and forces of the first test matched to DOFs."""
        return self.tests[0].matching
