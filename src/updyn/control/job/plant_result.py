"""`PlantResult`: plant, comparison with the model, family and servo of a job; `make_plant`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from updyn.control.antiresonances import raised, resolved
from updyn.control.build import plant
from updyn.control.conversions import ConversionError, conversions
from updyn.control.family import PlantFamily, plant_family
from updyn.control.job.checks import band_of_plant, beyond_the_data, part_of_plant
from updyn.control.job.servo import Nonlinear, drive_of, nonlinear_of, servo_of
from updyn.control.job.tables import PlantTable, SamplingTable, ServoTable
from updyn.control.plant import Plant
from updyn.control.ports import port_matrix
from updyn.control.sampled import sampled
from updyn.control.servo.drive import DriveFigures
from updyn.control.servo.record import Servo
from updyn.control.weight import UncertaintyWeight, uncertainty_weight
from updyn.errors import ToleranceError, UpdynError, key_path
from updyn.job.prepared import Prepared
from updyn.job.schema import Job
from updyn.model import Model

if TYPE_CHECKING:
    from updyn.uncertainty.draws import Draws
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["PlantResult", "make_plant"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Lines of the comparison with the model that are spread over the band.
_SPREAD = 300
#: Lines about each mode, in its half widths.
_AROUND = np.array([-6.0, -3.0, -1.5, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0, 1.5, 3.0, 6.0])
#: DOFs above which the response of the model is computed by a reduced model.
_LARGE = 20_000
#: Certified relative error of that reduced model.
_ACCURACY = 1e-6
#: Largest number of channels that get a weight, where no servo says which.
_WEIGHTS = 9
#: A channel below this share of its peak is rounding.
_UNCOUPLED = 1e-10
#: Largest number of modes that get lines about them.
_MODES = 80


@dataclass(frozen=True, slots=True, eq=False)
class PlantResult:
    """The plant of a job with its model and its errors.

    Attributes
    ----------
    title : str
        Of the job.
    model : Model
        The model of which the plant is made.
    updated : bool
        Whether it is the updated model.
    source : str
        Where the model is from, in a sentence.
    band : (float, float)
        In Hz.
    tolerance : float
        Requested largest error.
    measure : {"relative", "peak"}
        Of which error.
    plant : Plant or None
        None where no order holds the tolerance.
    message : str
        Why there is none.
    conversions : tuple of ConversionError
        Ways to convert the damping, side by side.
    freq : ndarray of float, shape (n_f,)
        Lines at which plant and model are compared, in Hz.
    exact : ndarray of complex, shape (n_f, n_y, n_u)
        Response of the model with its structural damping at these lines.
    answer : ndarray of complex, shape (n_f, n_y, n_u)
        Response of the plant at these lines.
    sampled : Plant or None
        The plant discretised by ``sampling``.
    family : PlantFamily or None
        Plants drawn from the uncertainty of the update.
    weights : mapping of (int, int) to UncertaintyWeight
        Weights that cover the family, by position of output and input: of the channels of the
        servo's loops, or of all.
    servo : Servo or None
        The controller of ``[servo]`` on the plant, or on the family.
    drive : DriveFigures or None
        The figures of the drive.
    nonlinear : tuple of Nonlinear
        The loop with backlash or friction.
    notes : tuple of str
        Remarks in sentences.
    """

    title: str
    model: Model
    updated: bool
    source: str
    band: tuple[float, float]
    tolerance: float
    measure: str = "relative"
    plant: Plant | None = None
    message: str = ""
    conversions: tuple[ConversionError, ...] = ()
    freq: _Real | None = None
    exact: _Complex | None = None
    answer: _Complex | None = None
    sampled: Plant | None = None
    family: PlantFamily | None = None
    weights: Mapping[tuple[int, int], UncertaintyWeight] = field(default_factory=dict)
    servo: Servo | None = None
    drive: DriveFigures | None = None
    nonlinear: tuple[Nonlinear, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def met(self) -> bool:
        """Whether there is a plant within the tolerance."""
        return self.plant is not None

    def channel_errors(self, measure: str = "peak") -> _Real:
        """Return the largest error of each channel at `freq`, (n_y, n_u).

        Parameters
        ----------
        measure : {"peak", "relative"}
            As a share of the channel's peak, or of its size at each line; at an antiresonance of
            the level one half-power width beside it.
        """
        return np.asarray(self.errors(measure).max(axis=0))

    def errors(self, measure: str) -> _Real:
        """Return the errors of each channel at `freq`, shape (n_f, n_y, n_u), as above."""
        assert self.freq is not None
        assert self.exact is not None
        assert self.answer is not None
        level = np.abs(self.exact).max(axis=0, keepdims=True)
        if measure == "relative":
            level = np.maximum(raised(self.freq, self.exact), _UNCOUPLED * level)
        return np.asarray(np.abs(self.answer - self.exact) / np.where(level > 0, level, 1.0))


def make_plant(
    ready: Prepared,
    result: UpdateResult | JointResult | None,
    source: str,
    *,
    draws: Draws | None = None,
    engine: Any = None,
    say: Callable[[str], object] | None = None,
    strict: bool = True,
) -> PlantResult:
    """Make the plant, family and servo of a job.

    Parameters
    ----------
    ready : Prepared
        The job, with such a table.
    result : UpdateResult or JointResult or None
        The update; None: the plant is made of the model as it stands.
    source : str
        Where the model is from, in a sentence.
    draws : Draws, optional
        Of the unknowns, from bootstrap or sampling, for the family.
    engine : object
        Where the family is made, as for `updyn.update`.
    say : callable, optional
        Called with the name of each stage.
    strict : bool
        Whether a servo that cannot be had is an error; else a note says why, and the plant is there
        all the same.

    Returns
    -------
    PlantResult
        Without a plant where no order holds the tolerance.

    Raises
    ------
    JobError
        If the plant cannot be made for another reason, with the line.
    SolverError
        If the model has no answer at a line.
    """
    job, number = ready.job, part_of_plant(ready.job)
    table = job.table(PlantTable)
    assert table is not None
    test = ready.tests[number]
    one = None if result is None else list(result.results.values())[number]
    model = test.model if one is None else one.model
    band = band_of_plant(job, test.freq)
    stage = say if say is not None else lambda name: None
    notes = [_unconverged_note(one), beyond_the_data(band, test.freq), _test_note(ready, number)]
    given: dict[str, Any] = {
        "inputs": table.input_ports,
        "outputs": table.output_ports,
        "band": band,
        "quantity": table.quantities,
        "backend": job.method.backend,
    }
    stage("plant: conversions of the damping")
    side_by_side = _side_by_side(model, given)
    base = PlantResult(
        job.title or job.path.stem,
        model,
        one is not None,
        source,
        band,
        table.tolerance,
        table.error,
    )
    stage("plant: order")
    made, message = _plant(table, model, given)
    extra: dict[str, Any] = {"conversions": side_by_side, "message": message}
    if made is not None:
        stage("plant: against the model")
        extra |= {"plant": made, **_compared(made, model, job)}
        if table.sampling is not None:
            extra["sampled"] = _sampled(table.sampling, made)
        if table.family:
            stage("plant: family")
            extra["family"], said = _family(table, one, given, draws, engine)
            notes.append(said)
            if extra["family"] is not None:
                stage("plant: weights of the family")
                extra["weights"], missing = _weights(job, extra["family"])
                notes += missing
    if job.table(ServoTable) is not None:
        stage("plant: servo")
        plants = extra.get("family") or made, extra.get("sampled")
        found, said = _servo(job, model, band, plants, strict)
        extra |= found
        notes.append(said)
    return replace(base, notes=tuple(filter(None, notes)), **extra)


def _servo(
    job: Job,
    model: Model,
    band: tuple[float, float],
    plants: tuple[Plant | PlantFamily | None, Plant | None],
    strict: bool,
) -> tuple[dict[str, Any], str]:
    """Return drive and servo, and a note where one of them cannot be computed."""
    out: dict[str, Any] = {}
    plant, sampled_plant = plants
    try:
        with job.located():
            out["drive"] = drive_of(job, model, band)
            if plant is not None:
                out["servo"] = found = servo_of(job, plant, sampled_plant)
                if found is not None:
                    nominal = plant if isinstance(plant, Plant) else plant.nominal
                    out["nonlinear"] = nonlinear_of(job, model, nominal, found)
    except UpdynError as error:
        if strict:
            raise
        return out, f"[servo] is left out: {error}"
    return out, ""


# -- notes ----------------------------------------------------------------------------------------
def _unconverged_note(result: UpdateResult | None) -> str:
    if result is None or result.status == "converged":
        return ""
    return (
        f"The update has ended as {result.status!r}: {result.message} The plant is of the model"
        " that it left."
    )


def _test_note(ready: Prepared, number: int) -> str:
    """Return a note on what was added to the structure or held for the test."""
    table = ready.tests[number].job.test
    changes = {
        "held DOFs": table.grounded,
        "added masses": table.masses,
        "masses of sensors": table.sensor_masses,
    }
    made = [name for name, value in changes.items() if value]
    if not made:
        return ""
    which = f"test {table.name!r}" if len(ready.tests) > 1 else "the test"
    return f"The plant is of the structure as it stood in {which}, with its {' and '.join(made)}."


# -- parts ----------------------------------------------------------------------------------------
def _side_by_side(model: Model, given: dict[str, Any]) -> tuple[ConversionError, ...]:
    with key_path("plant"):
        return conversions(model, **given)


def _plant(table: PlantTable, model: Model, given: dict[str, Any]) -> tuple[Plant | None, str]:
    """Return the plant, or None and the reason where no order holds the tolerance."""
    try:
        with key_path("plant"):
            how: dict[str, Any] = {"route": table.route, "error": table.error}
            return plant(model, tolerance=table.tolerance, **how, **given), ""
    except ToleranceError as error:
        return None, str(error)


def _compared(made: Plant, model: Model, job: Job) -> dict[str, Any]:
    """Return lines, response of the model and response of the plant."""
    from updyn.dynamics.response import response
    from updyn.frf import QUANTITIES

    freq = lines_of(made)
    columns, into = port_matrix(made.input_ports, model, "input")
    rows, out = port_matrix(made.output_ports, model, "output")
    tier = "reduced" if model.n_dofs > _LARGE else None
    how: dict[str, Any] = {"tier": tier, "backend": job.method.backend, "accuracy": _ACCURACY}
    power = np.array([QUANTITIES[q] for q in made.quantities])

    def answer(lines: _Real) -> _Complex:
        H = response(model, lines, model.dofs[rows], model.dofs[columns], **how).values
        return np.asarray((out @ H @ into.T) * ((2j * np.pi * lines)[:, None] ** power)[:, :, None])

    freq, exact = resolved(answer, freq, answer(freq))
    return {"freq": freq, "exact": exact, "answer": made.response(freq).values}


def lines_of(plant: Plant) -> _Real:
    """Return lines that resolve each mode of a plant.

    Parameters
    ----------
    plant : Plant
        A continuous one.

    Returns
    -------
    ndarray of float, shape (n_f,)
        In Hz, ascending, both ends of the band included.
    """
    low, high = plant.band
    low = max(low, 1e-4 * high)
    poles = plant.poles[plant.poles.imag > 0]
    own = np.abs(poles) / (2.0 * np.pi)
    inside = np.flatnonzero((own > low) & (own < high))[:_MODES]
    damping = np.maximum(-poles.real[inside] / np.abs(poles[inside]), 1e-6)
    around = own[inside, None] * (1.0 + damping[:, None] * _AROUND)
    spread = np.geomspace(low, high, _SPREAD)
    every = np.concatenate([spread, np.linspace(low, high, _SPREAD), around.ravel()])
    lines = np.unique(np.clip(every, low, high))
    apart = np.diff(lines, prepend=-np.inf) > 1e-10 * high
    return np.asarray(lines[apart])


def _sampled(table: SamplingTable, made: Plant) -> Plant:
    with key_path("plant", "sampling"):
        return sampled(made, table.dt, method=table.method, delay=table.delay)


def _family(
    table: PlantTable,
    result: UpdateResult | None,
    given: dict[str, Any],
    draws: Draws | None,
    engine: Any,
) -> tuple[PlantFamily | None, str]:
    """Return the family, or None and a note with the reason."""
    if result is None:
        return (
            None,
            "There is no family: the model is not updated, so its uncertainty is unknown.",
        )
    how: dict[str, Any] = {
        "n": table.family,
        "seed": table.seed,
        "draws": draws,
        "engine": engine,
        "route": table.route,
        "error": table.error,
    }
    try:
        return plant_family(result, tolerance=table.tolerance, **how, **given), ""
    except UpdynError as error:
        return None, f"There is no family: {error}"


def _weights(
    job: Job, family: PlantFamily
) -> tuple[dict[tuple[int, int], UncertaintyWeight], list[str]]:
    """Return a weight of each channel of the servo's loops, else of each channel; and notes."""
    servo = job.table(ServoTable)
    everything = list(np.ndindex(len(family.outputs), len(family.inputs)))
    has_loops = servo is not None and servo.controller is not None
    if servo is not None and has_loops:
        column = family.inputs.index(servo.torque or family.inputs[0])
        read = (servo.velocity, servo.position)
        chosen = [(i, column) for i, name in enumerate(family.outputs) if name in read]
    else:
        chosen = everything[:_WEIGHTS]
    out = {}
    notes = []
    for i, j in chosen:
        try:
            out[i, j] = uncertainty_weight(family.channel(family.outputs[i], family.inputs[j]))
        except UpdynError as error:
            notes.append(f"No weight covers {family.outputs[i]} over {family.inputs[j]}: {error}")
    if len(chosen) < len(everything) and not has_loops:
        notes.append(
            f"Weights of the first {len(chosen)} of {len(everything)} channels were sought."
        )
    return out, notes
