"""`Planted`: what ``[plant]`` of a job gives, and how it is made: of an updated model, or of a model as it stands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from updyn.control.build import ConversionError, conversions, plant
from updyn.control.family import PlantFamily, plant_family
from updyn.control.job.checks import band_of_plant, beyond_the_data, part_of_plant
from updyn.control.job.servo import Nonlinear, drive_of, nonlinear_of, servo_of
from updyn.control.job.tables import PlantTable, ServoTable
from updyn.control.plant import Plant
from updyn.control.ports import port_matrix
from updyn.control.sampled import sampled
from updyn.control.servo.drive import DriveFigures
from updyn.control.servo.record import Servo
from updyn.control.weight import UncertaintyWeight, uncertainty_weight
from updyn.errors import ToleranceError, UpdynError, key_path
from updyn.job.prepare import Prepared
from updyn.job.schema import Job
from updyn.model import Model

if TYPE_CHECKING:
    from updyn.uncertainty.draws import Draws
    from updyn.updating.result import JointResult, UpdateResult

__all__ = ["Planted", "planted_of"]

_Real = NDArray[np.float64]
_Complex = NDArray[np.complex128]

#: Lines of the comparison with the model: so many spread over the band, and these about each mode,
#: in its half widths.
_SPREAD = 300
_AROUND = np.array([-6.0, -3.0, -1.5, -1.0, -0.5, -0.2, 0.0, 0.2, 0.5, 1.0, 1.5, 3.0, 6.0])
#: Above this size a reduced model, proved to this accuracy, answers for the model.
_LARGE, _ACCURACY = 20_000, 1e-6
#: Channels whose weights are sought at most, where no servo says which.
_WEIGHTS = 9
#: Modes that get lines of their own at most.
_MODES = 80


@dataclass(frozen=True, slots=True, eq=False)
class Planted:
    """A plant with what it was made of and how far it can be trusted.

    Attributes
    ----------
    title : str
        Of the job.
    model : Model
        The structure that it is of.
    updated : bool
        Whether that is the updated model.
    source : str
        Where the model is from, in a sentence.
    band : (float, float)
        In Hz.
    tolerance : float
        What was asked for.
    plant : Plant or None
        None where no order holds the tolerance.
    message : str
        Why there is none.
    conversions : tuple of ConversionError
        Ways to convert the damping, side by side.
    freq : ndarray of float, shape (n_f,)
        Lines at which plant and model are compared, in Hz.
    exact : ndarray of complex, shape (n_f, n_y, n_u)
        The model with its structural damping there.
    answer : ndarray of complex, shape (n_f, n_y, n_u)
        The plant.
    sampled : Plant or None
        The plant behind a hold.
    family : PlantFamily or None
        Plants drawn from the uncertainty of the update.
    weights : mapping of (int, int) to UncertaintyWeight
        What covers the family, by position of output and input: the channels of the servo's loops,
        or all.
    servo : Servo or None
        The controller of ``[servo]`` on the plant, or on the family.
    drive : DriveFigures or None
        The figures of the drive.
    nonlinear : tuple of Nonlinear
        The loop with backlash or friction.
    notes : tuple of str
        What a reader should know, in sentences.
    """

    title: str
    model: Model
    updated: bool
    source: str
    band: tuple[float, float]
    tolerance: float
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

    def channel_errors(self) -> _Real:
        """Return the largest error of each channel as a share of its peak, shape (n_y, n_u), at the lines `freq`."""
        assert self.exact is not None
        assert self.answer is not None
        level = np.abs(self.exact).max(axis=0)
        return np.asarray(
            np.abs(self.answer - self.exact).max(axis=0) / np.where(level > 0, level, 1.0)
        )


def planted_of(
    ready: Prepared,
    result: UpdateResult | JointResult | None,
    source: str,
    *,
    draws: Draws | None = None,
    engine: Any = None,
    say: Callable[[str], object] | None = None,
    strict: bool = True,
) -> Planted:
    """Make what ``[plant]`` and ``[servo]`` of a job ask for.

    Parameters
    ----------
    ready : Prepared
        The job, with such a table.
    result : UpdateResult or JointResult or None
        The update; None: of the model as it stands.
    source : str
        Where the model is from, in a sentence.
    draws : Draws, optional
        Of the unknowns, from bootstrap or sampling, for the family.
    engine : object
        Where the family is made, as for `updyn.update`.
    say : callable, optional
        Called with what is being done.
    strict : bool
        Whether a servo that cannot be had is an error; else a note says why, and the plant is there
        all the same.

    Returns
    -------
    Planted
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
    band = band_of_plant(job, test.frf)
    told = say if say is not None else lambda _: None
    notes = [] if one is None else _of_the_update(one)
    notes += [beyond_the_data(band, test.frf), _of_the_test(ready, number)]
    given: dict[str, Any] = {
        "inputs": table.input_ports,
        "outputs": table.output_ports,
        "band": band,
        "quantity": table.quantities,
        "backend": job.method.backend,
    }
    told("plant: conversions of the damping")
    side_by_side = _side_by_side(job, model, given)
    base = Planted(
        job.title or job.path.stem, model, one is not None, source, band, table.tolerance
    )
    told("plant: order")
    made, message = _made(job, model, given)
    extra: dict[str, Any] = {"conversions": side_by_side, "message": message}
    if made is not None:
        told("plant: against the model")
        extra |= {"plant": made, **_compared(made, model, job)}
        if table.sampling is not None:
            extra["sampled"] = _sampled(job, made)
        if table.family:
            told("plant: family")
            extra["family"], said = _family(job, one, given, draws, engine)
            notes.append(said)
            if extra["family"] is not None:
                told("plant: weights of the family")
                extra["weights"], missing = _weights(job, extra["family"])
                notes += missing
    if job.table(ServoTable) is not None:
        told("plant: servo")
        found, said = _servo(job, model, band, extra.get("family") or made, strict)
        extra |= found
        notes.append(said)
    return replace(base, notes=tuple(n for n in notes if n), **extra)


def _servo(
    job: Job,
    model: Model,
    band: tuple[float, float],
    plant: Plant | PlantFamily | None,
    strict: bool,
) -> tuple[dict[str, Any], str]:
    """Return drive and servo, and why one of them is not there."""
    out: dict[str, Any] = {}
    try:
        with job.located():
            out["drive"] = drive_of(job, model, band)
            if plant is not None:
                out["servo"] = found = servo_of(job, plant)
                if found is not None:
                    nominal = plant if isinstance(plant, Plant) else plant.nominal
                    out["nonlinear"] = nonlinear_of(job, model, nominal, found)
    except UpdynError as error:
        if strict:
            raise
        return out, f"[servo] is left out: {error}"
    return out, ""


# -- what a reader should know -------------------------------------------------------------------------------
def _of_the_update(result: UpdateResult) -> list[str]:
    if result.status == "converged":
        return []
    return [
        f"The update has ended as {result.status!r}: {result.message} The plant is of the model"
        " that it left."
    ]


def _of_the_test(ready: Prepared, number: int) -> str:
    """Say what of the test's configuration is in the plant: what was added or held for the test alone."""
    table = ready.tests[number].job.test
    held = [*(["held DOFs"] if table.grounded else []), *(["added masses"] if table.masses else [])]
    held += ["masses of sensors"] if table.sensor_masses else []
    if not held:
        return ""
    which = f"test {table.name!r}" if len(ready.tests) > 1 else "the test"
    return f"The plant is of the structure as it stood in {which}, with its {' and '.join(held)}."


# -- parts -----------------------------------------------------------------------------------------------------
def _side_by_side(job: Job, model: Model, given: dict[str, Any]) -> tuple[ConversionError, ...]:

    with key_path("plant"):
        return conversions(model, **given)


def _made(job: Job, model: Model, given: dict[str, Any]) -> tuple[Plant | None, str]:
    """Return the plant; where no order holds the tolerance, why there is none."""
    table = job.table(PlantTable)
    assert table is not None
    try:
        with key_path("plant"):
            return plant(model, tolerance=table.tolerance, route=table.route, **given), ""
    except ToleranceError as error:
        return None, str(error)


def _compared(made: Plant, model: Model, job: Job) -> dict[str, Any]:
    from updyn.dynamics.response import response
    from updyn.frf import QUANTITIES

    freq = lines_of(made)
    columns, into = port_matrix(made.input_ports, model, "input")
    rows, out = port_matrix(made.output_ports, model, "output")
    tier = "reduced" if model.n_dofs > _LARGE else None
    how: dict[str, Any] = {"tier": tier, "backend": job.method.backend, "accuracy": _ACCURACY}
    H = response(model, freq, model.dofs[rows], model.dofs[columns], **how).values
    power = np.array([QUANTITIES[q] for q in made.quantities])
    exact = (out @ H @ into.T) * ((2j * np.pi * freq)[:, None] ** power)[:, :, None]
    return {"freq": freq, "exact": exact, "answer": made.response(freq).values}


def lines_of(plant: Plant) -> _Real:
    """Return lines in Hz that show each mode of a plant: spread over the band, and close about each pole.

    Parameters
    ----------
    plant : Plant
        A continuous one.

    Returns
    -------
    ndarray of float, shape (n_f,)
        Ascending, both ends of the band included.
    """
    low, high = plant.band
    low = max(low, 1e-4 * high)
    poles = plant.poles[plant.poles.imag > 0]
    own = np.abs(poles) / (2.0 * np.pi)
    inside = np.flatnonzero((own > low) & (own < high))[:_MODES]
    damping = np.maximum(-poles.real[inside] / np.abs(poles[inside]), 1e-6)
    around = own[inside, None] * (1.0 + damping[:, None] * _AROUND)
    spread = np.geomspace(low, high, _SPREAD)
    lines = np.unique(
        np.clip(
            np.concatenate([spread, np.linspace(low, high, _SPREAD), around.ravel()]), low, high
        )
    )
    return np.asarray(lines[np.concatenate([[True], np.diff(lines) > 1e-10 * high])])


def _sampled(job: Job, made: Plant) -> Plant:

    table = job.table(PlantTable)
    assert table is not None
    wish = table.sampling
    assert wish is not None
    with key_path("plant", "sampling"):
        return sampled(made, wish.dt, method=wish.method, delay=wish.delay)


def _family(
    job: Job, result: UpdateResult | None, given: dict[str, Any], draws: Draws | None, engine: Any
) -> tuple[PlantFamily | None, str]:
    """Return the family, or why there is none; the plant is not lost for that."""
    wish = job.table(PlantTable)
    assert wish is not None
    if result is None:
        return (
            None,
            "There is no family: the model is not updated, so nothing is known of how sure it is.",
        )

    how: dict[str, Any] = {
        "n": wish.family,
        "seed": wish.seed,
        "draws": draws,
        "engine": engine,
        "route": wish.route,
    }
    try:
        return plant_family(result, tolerance=wish.tolerance, **how, **given), ""
    except UpdynError as error:
        return None, f"There is no family: {error}"


def _weights(
    job: Job, family: PlantFamily
) -> tuple[dict[tuple[int, int], UncertaintyWeight], list[str]]:
    """Return a weight for each channel of the servo's loops, or for each channel of the plant; and what is missing."""
    servo, everything = (
        job.table(ServoTable),
        list(np.ndindex(len(family.outputs), len(family.inputs))),
    )
    if servo is not None and servo.controller is not None:
        torque = family.inputs[0] if servo.torque is None else servo.torque
        read = {servo.velocity, servo.position}
        chosen = [
            (i, j)
            for i, j in everything
            if family.outputs[i] in read and family.inputs[j] == torque
        ]
    else:
        chosen = everything[:_WEIGHTS]
    out, notes = {}, []
    for i, j in chosen:
        try:
            out[i, j] = uncertainty_weight(family.channel(family.outputs[i], family.inputs[j]))
        except UpdynError as error:
            notes.append(f"No weight covers {family.outputs[i]} over {family.inputs[j]}: {error}")
    if len(chosen) < len(everything) and (servo is None or servo.controller is None):
        notes.append(
            f"Weights of the first {len(chosen)} of {len(everything)} channels were sought."
        )
    return out, notes
