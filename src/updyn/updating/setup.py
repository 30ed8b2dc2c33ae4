"""Checked input of a run: options, tests with their data split, and noise models."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.dynamics.settings import REDUCTION
from updyn.engines import Engine
from updyn.errors import OptionError
from updyn.frf import FRF
from updyn.group import is_number
from updyn.modal import ModeSet
from updyn.positions import warn_of_labels
from updyn.updating.before_search import ModeComparison
from updyn.updating.fit.method import Method
from updyn.updating.fit.methods import (
    check_channels,
    check_linear,
    check_modes,
    check_quantity,
    make_method,
)
from updyn.updating.fit.monitor import Progress
from updyn.updating.fit.reducing import are_modes_reduced
from updyn.updating.fit.regularisation import add_regularisation
from updyn.updating.problem.data import (
    ModalSplit,
    Split,
    Test,
    check_measured,
    check_tests,
    leave_out_undefined_line,
    list_validation,
    split_data,
    split_modes,
)
from updyn.updating.problem.noise import NoiseModel, choose_noise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.selection import Selection

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["RunOptions", "Setup", "prepare_setup"]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of the run of an update; most are the arguments of `updyn.update` of the same name.

    `tier` is the solution ("dense", "sparse" or "reduced"), `backend` the sparse factorisation, and
    `accuracy` that of the reduced tier; the file `checkpoint` receives every evaluation, and
    `resume` continues its run. `callback` gets a `Progress` after every step and between blocks of
    lines.
    """

    method: str = "maximum-likelihood"
    method_options: Mapping[str, Any] = field(default_factory=dict)
    engine: int | Client | Engine | None = None
    callback: Callable[[Progress], bool | None] | None = None
    title: str = ""
    tier: str | None = None
    backend: str | None = None
    accuracy: float = REDUCTION.accuracy
    checkpoint: str | Path | None = None
    resume: bool = False
    regularise: str | float | None = None
    seek_causes: bool = True

    def check(self) -> None:
        """Check the types of options that are first used during the run; raise `OptionError`."""
        if self.callback is not None and not callable(self.callback):
            raise OptionError(f"callback = {self.callback!r}: expected a function, or None")
        if not isinstance(self.title, str):
            raise OptionError(f"title = {self.title!r}: expected a text", key=("title",))
        if self.checkpoint is not None and not isinstance(self.checkpoint, str | Path):
            raise OptionError(
                f"checkpoint = {self.checkpoint!r}: expected the path of a file",
                key=("checkpoint",),
            )
        if not is_number(self.accuracy):
            raise OptionError(
                f"accuracy = {self.accuracy!r}: expected a number, such as {REDUCTION.accuracy:g}",
                key=("accuracy",),
            )

    def check_without_lines(self, largest: int) -> None:
        """Raise `OptionError` for options of the line-by-line solution in an update to modes.

        `largest` is the number of DOFs of the largest model.
        """
        reduced = are_modes_reduced(self.tier, largest)
        if self.tier == "dense":
            raise OptionError(
                "tier 'dense': modes are computed with 'sparse' or 'reduced'", key=("tier",)
            )
        if self.backend is not None and not reduced:
            raise OptionError(
                f"backend: modes of a full model ({largest} DOFs) are computed by one way; leave it"
                " out, or use tier 'reduced'",
                key=("backend",),
            )


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Checked input of a run.

    `tests` have the models at the start of the unknowns; `driver` is the method with its
    regularisation. Splits and noises are those of each test with FRFs or modes.
    """

    tests: tuple[Test, ...]
    selection: Selection
    options: RunOptions
    method: Method
    driver: Method
    splits: tuple[Split, ...]
    modal_splits: tuple[ModalSplit, ...]
    noises: tuple[NoiseModel, ...]
    before: ModeComparison

    @property
    def unknowns(self) -> ParameterSet:
        """The unknowns."""
        return self.selection.parameters

    @property
    def frf_tests(self) -> list[Test]:
        """Tests with FRFs."""
        return [test for test in self.tests if isinstance(test.data, FRF)]

    @property
    def modal_tests(self) -> list[Test]:
        """Tests with modes."""
        return [test for test in self.tests if isinstance(test.data, ModeSet)]

    @property
    def all_splits(self) -> tuple[Split | ModalSplit, ...]:
        """Data of the parts of the problem; those of modes last."""
        return (*self.splits, *self.modal_splits)

    @property
    def positions(self) -> list[int]:
        """Position of each test among the parts of the problem."""
        is_modal = [isinstance(test.data, ModeSet) for test in self.tests]
        order = sorted(range(len(is_modal)), key=is_modal.__getitem__)
        return [order.index(i) for i in range(len(self.tests))]


def prepare_setup(
    tests: Sequence[Test], parameters: ParameterSet | Selection, options: RunOptions
) -> Setup:
    """Check tests, unknowns and options, and split the data of each test."""
    options.check()
    if isinstance(options.regularise, np.generic):  # plain type, for the record and the fingerprint
        options = replace(options, regularise=options.regularise.item())
    method = make_method(options.method, options.method_options)
    driver = add_regularisation(method, options.method, options.regularise)
    selection = Selection.of(parameters)
    tests = [replace(test, model=selection.start_of(test.model)) for test in tests]
    check_tests(tests, selection.parameters)
    for test in tests:
        if isinstance(test.data, FRF):
            warn_of_labels(test.model, test.data)
    check_channels(selection.parameters, method)
    tests = [_with_listed_validation(leave_out_undefined_line(test)) for test in tests]
    frf_tests = [test for test in tests if isinstance(test.data, FRF)]
    splits = [split_data(test.frf, test.validation) for test in frf_tests]
    for test, split in zip(frf_tests, splits, strict=True):
        check_measured(split.fitted, test.name)
    pairs = zip(frf_tests, splits, strict=True)
    noises = [choose_noise(test.noise, split.fitted) for test, split in pairs]
    check_modes(tests, method)
    check_linear(tests, method)
    for test in tests:
        check_quantity(test.data, method)
    if not frf_tests:
        options.check_without_lines(max(test.model.n_dofs for test in tests))
    before = ModeComparison.of(tests, selection.parameters, options.method_options)
    modal_splits = [
        split_modes(test.data, test.validation) for test in tests if isinstance(test.data, ModeSet)
    ]
    return Setup(
        tuple(tests),
        selection,
        options,
        method,
        driver,
        tuple(splits),
        tuple(modal_splits),
        tuple(noises),
        before,
    )


def _with_listed_validation(test: Test) -> Test:
    """Return a test whose held-out data are listed once, for the fit and for the fingerprint."""
    if test.validation is None:
        return test
    return replace(test, validation=list_validation(test.validation))
