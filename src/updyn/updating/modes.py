"""`modal_table`: modes of the test compared with those of the model before and after its update."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from updyn.arrays import RealArray
from updyn.correlation.model_modes import ModelModes
from updyn.dynamics.affine import AffineSystem
from updyn.dynamics.excitation import hold_base
from updyn.errors import OptionError, UpdynError
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.modal.sensitivity import derivative_forces
from updyn.sensitivity import Unknowns
from updyn.updating.judge.counterparts import identify_modes_for, limit_size
from updyn.updating.judge.modal_table import ModalTable, compare_modes
from updyn.updating.judge.settings import EFFORT
from updyn.updating.judge.verdict import Verdict, explain_rejection
from updyn.updating.judge.worsened import judge_modes
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.result import UpdateResult, estimated_gains

__all__ = [
    "compare_start_modes",
    "find_measured_modes",
    "frequency_sensitivities",
    "identify_modes_for",
    "judge_by_modes",
    "modal_table",
]


def modal_table(
    result: UpdateResult, modes: ModeSet | None = None, *, largest: int | None = None
) -> ModalTable:
    """Compare the modes of the test with those of the start model and of the updated model.

    Parameters
    ----------
    result : UpdateResult
        Result of `updyn.update`.
    modes : ModeSet, optional
        The modes of the test; by default those given to the update, otherwise those identified from
        its FRFs (`updyn.identify_modes`).
    largest : int
        Largest number of DOFs for which the modes of a model are computed, by default 20,000.

    Returns
    -------
    ModalTable
        `ModalTable.known` is True if the table has modes; otherwise `ModalTable.notes` give the
        reason why modes cannot be identified or computed.

    Raises
    ------
    OptionError
        If `result` is not the result of one test.

    Notes
    -----
    If calibration factors of sensors are among the unknowns, the FRFs are divided by them.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> table = updyn.modal_table(result, updyn.identify_modes(frf))
    >>> len(table.rows)
    6
    """
    if not isinstance(result, UpdateResult):
        raise OptionError(
            f"modal_table: expected the result of one test, found {type(result).__name__}; of"
            " several tests, one of result.results"
        )
    given = modes or _find_given_modes(result)
    start = result.parameters.at_start(result.start)
    models = ModelModes(start), ModelModes(result.model)
    if given is not None:
        return _make_table(*models, given, (), largest)
    return _make_table(*models, *_select_frfs(result), largest)


def find_measured_modes(result: UpdateResult) -> ModeSet:
    """Return the measured modes of an update: those given to it, or identified from its FRFs.

    Raises DataError if no mode can be identified.
    """
    given = _find_given_modes(result)
    if given is not None:
        return given
    return identify_modes_for(*hold_base(result.model, _select_frfs(result)[0]))


def _find_given_modes(result: UpdateResult) -> ModeSet | None:
    """Return the measured modes that were given to an update."""
    given = result.data if isinstance(result.data, ModeSet) else result.options.get("modes")
    return given if isinstance(given, ModeSet) else None


def judge_by_modes(result: UpdateResult, tables: Sequence[ModalTable]) -> UpdateResult:
    """Return a result whose verdict takes account of the modes that the update made worse."""
    # `tables` are those of all tests fitted together whose residual is not noise: if the residual
    # of FRFs is noise, a contradiction by modes identified from them is an error of the
    # identification.
    if result.trust is None:
        return result
    trust = judge_modes(result.trust, tables)
    if trust.credible or result.status != "converged":
        return replace(result, trust=trust)
    plain = Verdict(result.status, result.message, result.steps)
    verdict = explain_rejection(plain, trust)
    return replace(
        result, trust=trust, status=verdict.status, message=verdict.message, steps=verdict.steps
    )


def compare_start_modes(
    computed: ModelModes,
    data: FRF | ModeSet,
    modes: ModeSet | None = None,
    *,
    largest: int | None = None,
) -> ModalTable:
    """Compare the modes of the test, or the given ones, with those of the model before any update.

    For models with more than `largest` DOFs (20,000) the table has only a note. Of many FRFs, some
    references (or responses, if these are fewer) are used, with a note.
    """
    test = modes or data
    if isinstance(test, ModeSet):
        return _make_table(computed, None, test, (), largest)
    return _make_table(computed, None, *_use_few(test), largest)


def _use_few(frf: FRF) -> tuple[FRF, tuple[str, ...]]:
    """Return FRFs whose modes are identified in seconds, and a note on those left out."""
    few = limit_size(frf)
    for name in ("references", "responses"):
        used, there = len(getattr(few, name)), len(getattr(frf, name))
        if used < there:
            note = f"The modes of the test are those of {used} of {there} {name}"
            return few, (f"{note}; updyn modes uses all.",)
    return frf, ()


def frequency_sensitivities(
    computed: ModelModes, parameters: ParameterSet, data: FRF | ModeSet, frequency: RealArray
) -> RealArray:
    """Return the sensitivities of natural frequencies, shape (n_modes, n_unknowns).

    They are d ln f / d ln p of the undamped modes nearest to `frequency`, in Hz, of a model at
    the start of the unknowns; 0 for unknowns on damping.
    """
    if isinstance(data, FRF):
        computed, _ = computed.hold_base(data)
    system = AffineSystem.compile(computed.model)
    unknowns, values = Unknowns.find(system, parameters), np.ones(len(parameters))
    found = computed.up_to(float(frequency.max()))
    modes = found.select(found.frequency > 0.0)
    nearest = np.argmin(np.abs(modes.frequency - frequency[:, None]), axis=1)
    shapes = np.asarray(modes.shapes[:, nearest], dtype=np.float64)
    eigenvalues = (2.0 * np.pi * modes.frequency[nearest]) ** 2
    out = np.zeros((len(frequency), len(parameters)))
    for owner, rows, forces, is_mass in derivative_forces(system, unknowns, values, shapes):
        energy = np.einsum("in,in->n", shapes[rows], forces)
        out[:, owner] += -0.5 * energy if is_mass else 0.5 * energy / eigenvalues
    return out


def _make_table(
    start: ModelModes,
    updated: ModelModes | None,
    test: FRF | ModeSet,
    notes: tuple[str, ...],
    largest: int | None,
) -> ModalTable:
    largest = EFFORT.most_dofs if largest is None else largest
    n_dofs = start.model.n_dofs
    if n_dofs > largest:
        note = (
            f"The modes of a model of {n_dofs} DOFs are computed when asked for:"
            f" updyn.modal_table(result, largest={n_dofs})."
        )
        return ModalTable(notes=(note,))
    if isinstance(test, ModeSet):
        return compare_modes(start, updated, test)
    try:
        if updated is not None:
            updated, _ = updated.hold_base(test)
        start, test = start.hold_base(test)
        found = identify_modes_for((updated or start).model, test)
    except (UpdynError, np.linalg.LinAlgError) as error:
        why = str(error).removeprefix("modes: ")
        return ModalTable(notes=(f"No modes could be identified from the FRFs: {why}.",))
    table = compare_modes(start, updated, found, (float(test.freq[0]), float(test.freq[-1])))
    return replace(table, notes=(*notes, *table.notes))


def _select_frfs(result: UpdateResult) -> tuple[FRF, tuple[str, ...]]:
    """Return the FRFs for the identification of modes, and notes on them."""
    frf, gains = result.frf, estimated_gains(result)
    if gains is None:
        return frf, ()
    note = "The modes of the test are those of its FRFs over the estimated calibration factors."
    return replace(frf, values=frf.values / gains), (note,)
