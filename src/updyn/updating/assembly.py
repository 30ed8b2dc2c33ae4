"""The problem of a run: model and data of each test, and the reduced models."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from updyn.arrays import RealArray
from updyn.updating.fit.checkpoint import checkpoint_session, fingerprint
from updyn.updating.fit.methods import options_of
from updyn.updating.fit.reducing import (
    Reducing,
    are_modes_reduced,
    is_reduced,
    record_fallback,
)
from updyn.updating.fit.regularisation import check_regularise
from updyn.updating.problem.data import Split
from updyn.updating.problem.lines import Lines
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.noise.modes import choose_modal_noise
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.session import Session
from updyn.updating.setup import Setup

__all__ = ["Assembly"]


@dataclass(frozen=True, slots=True, eq=False)
class UsedData:
    """Fitted lines in Hz and channels of a test, and its held-out channels and band (Hz)."""

    lines: RealArray
    fitted: tuple[str, ...]
    held_out: tuple[str, ...]
    band: tuple[float, float] | None


@dataclass(frozen=True, slots=True, eq=False)
class Assembly:
    """The problem of a run: whole models and fitted data, parts of FRFs first.

    `reduced` is None if the whole models are solved.
    """

    setup: Setup
    problem: Problem
    reduced: Reducing | None
    session: Session

    @classmethod
    def build(cls, setup: Setup, session: Session) -> Self:
        """Assemble the model of each test, and prepare its reduction if it is to be reduced."""
        options, tests = setup.options, setup.frf_tests
        largest = max((test.model.n_dofs for test in tests), default=0)
        n_lines = sum(len(test.frf.freq) for test in tests)
        reducing = bool(tests) and is_reduced(
            options.tier, largest, n_lines, options.method, options.regularise
        )
        check_regularise(options.regularise, options.method, reducing=reducing)
        parts = [
            FRFPart.build(
                test.model,
                split.fitted,
                setup.unknowns,
                tier="sparse" if reducing else options.tier,
                backend=options.backend,
                session=session,
                name=test.name,
            )
            for test, split in zip(tests, setup.splits, strict=True)
        ]
        reduced = None
        if reducing:
            whole = [part.with_data(test.frf) for part, test in zip(parts, tests, strict=True)]
            reduced = Reducing(Problem.of(whole), options.accuracy)
        return cls(setup, Problem.of(parts, _modal_parts(setup, session)), reduced, session)

    @property
    def used_options(self) -> list[dict[str, object]]:
        """Options used for each part, for the record."""
        setup = self.setup
        common = {key: getattr(setup.method, key) for key in options_of(setup.options.method)}
        used = []
        for test, part in zip(setup.frf_tests, self.problem.parts, strict=True):
            tier = part.solver.tier
            own = {
                "lines": test.lines if isinstance(test.lines, str | None) else "list",
                "tier": tier if self.reduced is None else "reduced",
                "backend": part.solver.backend if tier == "sparse" else "lapack",
            }
            used.append(common | own)
        return used + [dict(common) for _ in setup.modal_splits]

    def keep_evaluations(self) -> AbstractContextManager[object]:
        """Return the context in which evaluations are kept in the checkpoint, if there is one."""

        def head() -> dict[str, Any]:
            data = [test.data for test in self.setup.tests]
            return fingerprint(self.problem, data, self._decisive_options())

        options = self.setup.options
        return checkpoint_session(self.session, options.checkpoint, head, resume=options.resume)

    def _decisive_options(self) -> dict[str, object]:
        """Return the options that change the answer, which a resumed run has to share."""
        tests, options = self.setup.tests, self.setup.options
        decisive: dict[str, object] = dict(self.used_options[0])
        decisive.pop("max_iterations", None)
        decisive |= {"method": options.method, "accuracy": options.accuracy}
        if options.regularise is not None:
            decisive["regularise"] = options.regularise
        decisive["lines"] = [_as_list(test.lines) for test in tests]
        decisive["noise"] = [test.noise for test in tests]
        decisive["validation"] = [test.validation for test in tests]
        return decisive

    def record(self, i: int, fitted: Problem) -> dict[str, Any]:
        """Return the used options of part `i`, and how it was solved, for the record."""
        used = {**self.used_options[i], "engine": self.session.engine.name}
        if i >= len(self.problem.parts):
            reduction = self.problem.modal[i - len(self.problem.parts)].reduction
            return used if reduction is None else {**used, **reduction.record}
        solver = self.problem.parts[i].solver
        if self.reduced is None:
            solved: Mapping[str, object] = record_fallback(solver.solve_counts, solver.backend)
        else:
            solved = self.reduced.record
        return {**used, **solved, **_rounding_channels(fitted.parts[i])}

    def used_data(self, i: int, fitted: Problem) -> UsedData:
        """Return the fitted and the held-out data of part `i`."""
        split = self.setup.all_splits[i]
        if isinstance(split, Split):
            labels = tuple(split.fitted.responses.labels)
            return UsedData(fitted.parts[i].frf.freq, labels, split.responses, split.band)
        return UsedData(np.zeros(0), tuple(split.fitted.dofs.labels), (), split.band)


def _modal_parts(setup: Setup, session: Session) -> list[ModalPart]:
    return [
        ModalPart.build(
            test.model,
            split.fitted,
            setup.unknowns,
            choose_modal_noise(test.noise),
            session=session,
            name=test.name,
            backend=setup.options.backend,
            reduced=are_modes_reduced(setup.options.tier, test.model.n_dofs),
        )
        for test, split in zip(setup.modal_tests, setup.modal_splits, strict=True)
    ]


def _as_list(lines: Lines) -> object:
    if isinstance(lines, str) or lines is None:
        return lines
    return np.asarray(lines).tolist()


def _rounding_channels(part: FRFPart) -> dict[str, list[str]]:
    at = np.argwhere(part.sign == 0.0)
    names = [f"{part.frf.responses[i]} / {part.frf.references[j]}" for i, j in at]
    return {"rounding": names} if names else {}
