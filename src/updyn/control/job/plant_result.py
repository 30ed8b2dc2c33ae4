"""`PlantResult`: plant, comparison with the model, family and servo of a job."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.control.antiresonances import fill_antiresonances, resolve_antiresonances
from updyn.control.build import plant
from updyn.control.conversions import ConversionError, conversions
from updyn.control.family import PlantFamily, plant_family
from updyn.control.job.checks import band_of_plant, beyond_the_data, part_of_plant
from updyn.control.job.servo import Nonlinear, job_drive, job_nonlinear, job_servo
from updyn.control.job.settings import PLANT_COMPARISON
from updyn.control.job.tables import PlantTable, SamplingTable, ServoTable
from updyn.control.offsets import mirror_offsets
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
    from updyn.updating.result import UpdateResult

__all__ = ["PlantResult", "make_plant"]


@dataclass(frozen=True, slots=True, eq=False)
class PlantResult:
    """The plant of a job with its model and its errors; no plant if no order holds the tolerance.

    `source` is a sentence on the source of the model, `message` the reason for a missing plant.
    `exact` and `answer`, shape (n_f, n_y, n_u), are the responses of the model, with structural
    damping, and of the plant at `freq` in Hz. `measure`, ``"relative"`` or ``"peak"``, is that of
    `tolerance`. `weights` cover the family, by index of output and input.
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
    freq: RealArray | None = None
    exact: ComplexArray | None = None
    answer: ComplexArray | None = None
    sampled: Plant | None = None
    family: PlantFamily | None = None
    weights: Mapping[tuple[int, int], UncertaintyWeight] = field(default_factory=dict)
    servo: Servo | None = None
    drive: DriveFigures | None = None
    nonlinear: tuple[Nonlinear, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def holds_tolerance(self) -> bool:
        """Whether a plant within the tolerance exists."""
        return self.plant is not None

    def channel_errors(self, measure: str = "peak") -> RealArray:
        """Return the largest error of each channel over `freq`, shape (n_y, n_u), as `errors`."""
        return np.asarray(self.errors(measure).max(axis=0))

    def errors(self, measure: str) -> RealArray:
        """Return the errors of each channel at `freq`, shape (n_f, n_y, n_u), as in `Plant`."""
        assert self.freq is not None
        assert self.exact is not None
        assert self.answer is not None
        level = np.abs(self.exact).max(axis=0, keepdims=True)
        if measure == "relative":
            floor = PLANT_COMPARISON.uncoupled_share * level
            level = np.maximum(fill_antiresonances(self.freq, self.exact), floor)
        return np.asarray(np.abs(self.answer - self.exact) / np.where(level > 0, level, 1.0))


def make_plant(
    ready: Prepared,
    result: UpdateResult | None,
    source: str,
    *,
    draws: Draws | None = None,
    engine: object = None,
    say: Callable[[str], object] | None = None,
    strict: bool = True,
) -> PlantResult:
    """Make the plant, family and servo of a job; no plant if no order holds the tolerance.

    `result` is that of the test of the plant; without it the plant is that of the original model.
    `source` is a sentence on the model. With `strict`, a failing servo is an error, else a note.
    """
    job, number = ready.job, part_of_plant(ready.job)
    table = job.table(PlantTable)
    assert table is not None
    test = ready.tests[number]
    model = test.model if result is None else result.model
    band = band_of_plant(job, test.freq)
    stage = say if say is not None else lambda name: None
    notes = [_unconverged_note(result), beyond_the_data(band, test.freq), _test_note(ready, number)]
    given: dict[str, object] = {
        "inputs": table.input_ports,
        "outputs": table.output_ports,
        "band": band,
        "quantity": table.quantities,
        "backend": job.method.backend,
    }
    stage("plant: conversions of the damping")
    side_by_side = _side_by_side(model, given)
    base = PlantResult(
        ready.title,
        model,
        result is not None,
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
        extra |= {"plant": made, **_compare_plant(made, model, job)}
        if table.sampling is not None:
            extra["sampled"] = _sample_plant(table.sampling, made)
        if table.family:
            stage("plant: family")
            extra["family"], note = _family(table, result, given, draws, engine)
            notes.append(note)
            if extra["family"] is not None:
                stage("plant: weights of the family")
                extra["weights"], missing = _weights(job, extra["family"])
                notes += missing
    if job.table(ServoTable) is not None:
        stage("plant: servo")
        plants = extra.get("family") or made, extra.get("sampled")
        found, note = _servo(job, model, band, plants, strict)
        extra |= found
        notes.append(note)
    return replace(base, notes=tuple(filter(None, notes)), **extra)


def _servo(
    job: Job,
    model: Model,
    band: tuple[float, float],
    plants: tuple[Plant | PlantFamily | None, Plant | None],
    strict: bool,
) -> tuple[dict[str, object], str]:
    """Return drive and servo, and a note if one of them cannot be computed."""
    out: dict[str, object] = {}
    plant, sampled_plant = plants
    try:
        with job.located():
            out["drive"] = job_drive(job, model, band)
            if plant is not None:
                out["servo"] = found = job_servo(job, plant, sampled_plant)
                if found is not None:
                    nominal = plant if isinstance(plant, Plant) else plant.nominal
                    out["nonlinear"] = job_nonlinear(job, model, nominal, found)
    except UpdynError as error:
        if strict:
            raise
        return out, f"[servo] is omitted: {error}"
    return out, ""


# -- notes ----------------------------------------------------------------------------------------
def _unconverged_note(result: UpdateResult | None) -> str:
    if result is None or result.status == "converged":
        return ""
    return (
        f"The update ended as {result.status!r}: {result.message} The plant is of the model"
        " at this point."
    )


def _test_note(ready: Prepared, number: int) -> str:
    """Return a note on additions to the structure and supports in the test."""
    table = ready.tests[number].job.test
    changes = {
        "held DOFs": table.grounded,
        "added masses": table.masses,
        "masses of sensors": table.sensor_masses,
    }
    present = [name for name, value in changes.items() if value]
    if not present:
        return ""
    which = f"test {table.name!r}" if len(ready.tests) > 1 else "the test"
    return f"The plant is of the structure in {which}, with its {' and '.join(present)}."


# -- parts ----------------------------------------------------------------------------------------
def _side_by_side(model: Model, given: dict[str, Any]) -> tuple[ConversionError, ...]:
    with key_path("plant"):
        return conversions(model, **given)


def _plant(table: PlantTable, model: Model, given: dict[str, Any]) -> tuple[Plant | None, str]:
    """Return the plant, or None and the reason if no order holds the tolerance."""
    try:
        with key_path("plant"):
            how: dict[str, Any] = {"route": table.route, "error": table.error}
            return plant(model, tolerance=table.tolerance, **how, **given), ""
    except ToleranceError as error:
        return None, str(error)


def _compare_plant(made: Plant, model: Model, job: Job) -> dict[str, object]:
    """Return lines, response of the model and response of the plant."""
    from updyn.dynamics.response import response
    from updyn.frf import QUANTITIES

    freq = resolving_lines(made)
    columns, into = port_matrix(made.input_ports, model, "input")
    rows, out = port_matrix(made.output_ports, model, "output")
    tier = "reduced" if model.n_dofs > PLANT_COMPARISON.reduced_dofs else None
    how: dict[str, Any] = {
        "tier": tier,
        "backend": job.method.backend,
        "accuracy": PLANT_COMPARISON.reduced_accuracy,
    }
    power = np.array([QUANTITIES[q] for q in made.quantities])

    def answer(lines: RealArray) -> ComplexArray:
        H = response(model, lines, model.dofs[rows], model.dofs[columns], **how).values
        return np.asarray((out @ H @ into.T) * ((2j * np.pi * lines)[:, None] ** power)[:, :, None])

    freq, exact = resolve_antiresonances(answer, freq, answer(freq))
    return {"freq": freq, "exact": exact, "answer": made.response(freq).values}


def resolving_lines(plant: Plant) -> RealArray:
    """Return lines in Hz over the band of a continuous plant that resolve each mode."""
    low, high = plant.band
    low = max(low, 1e-4 * high)
    poles = plant.poles[plant.poles.imag > 0]
    pole_frequencies = np.abs(poles) / (2.0 * np.pi)
    inside = np.flatnonzero((pole_frequencies > low) & (pole_frequencies < high))
    inside = inside[: PLANT_COMPARISON.most_modes]
    damping = np.maximum(-poles.real[inside] / np.abs(poles[inside]), 1e-6)
    offsets = mirror_offsets(PLANT_COMPARISON.line_offsets)
    around = pole_frequencies[inside, None] * (1.0 + damping[:, None] * offsets)
    count = PLANT_COMPARISON.spread_lines
    spread = np.geomspace(low, high, count)
    every = np.concatenate([spread, np.linspace(low, high, count), around.ravel()])
    lines = np.unique(np.clip(every, low, high))
    apart = np.diff(lines, prepend=-np.inf) > 1e-10 * high
    return np.asarray(lines[apart])


def _sample_plant(table: SamplingTable, made: Plant) -> Plant:
    with key_path("plant", "sampling"):
        return sampled(made, table.dt, method=table.method, delay=table.delay)


def _family(
    table: PlantTable,
    result: UpdateResult | None,
    given: dict[str, Any],
    draws: Draws | None,
    engine: object,
) -> tuple[PlantFamily | None, str]:
    """Return the family, or None and a note with the reason."""
    if result is None:
        return (
            None,
            "No family: the model is not updated, so its uncertainty is unknown.",
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
        return None, f"No family: {error}"


def _weights(
    job: Job, family: PlantFamily
) -> tuple[dict[tuple[int, int], UncertaintyWeight], list[str]]:
    """Return a weight for each channel of the servo's loops, else for each channel; and notes."""
    servo = job.table(ServoTable)
    everything = list(np.ndindex(len(family.outputs), len(family.inputs)))
    has_loops = servo is not None and servo.controller is not None
    if servo is not None and has_loops:
        column = family.inputs.index(servo.torque or family.inputs[0])
        read = (servo.velocity, servo.position)
        chosen = [(i, column) for i, name in enumerate(family.outputs) if name in read]
    else:
        chosen = everything[: PLANT_COMPARISON.most_weights]
    out = {}
    notes = []
    for i, j in chosen:
        try:
            out[i, j] = uncertainty_weight(family.channel(family.outputs[i], family.inputs[j]))
        except UpdynError as error:
            notes.append(f"No weight covers {family.outputs[i]} over {family.inputs[j]}: {error}")
    if len(chosen) < len(everything) and not has_loops:
        notes.append(
            f"Weights were fitted for the first {len(chosen)} of {len(everything)} channels."
        )
    return out, notes
