"""Results of updates: `UpdateResult` for one test, `JointResult` for several."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import ndtri, stdtrit

from updyn.arrays import RealArray
from updyn.correlation.figures import agreement_table
from updyn.dynamics.kept_basis import KeptBasis
from updyn.errors import OptionError, suggest
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.notebook import badge, card, spans, table
from updyn.remedy import Remedy
from updyn.text_table import format_count
from updyn.updating.fit.monitor import Iteration
from updyn.updating.judge.adequacy import Adequacy
from updyn.updating.judge.alternatives import Alternative, find_differences
from updyn.updating.judge.badge import Badge, choose_badge
from updyn.updating.judge.causes.finding import Finding
from updyn.updating.judge.counterparts import Counterparts
from updyn.updating.judge.identifiability import Identifiability
from updyn.updating.judge.modal_table import ModalTable
from updyn.updating.judge.trust import Trust
from updyn.updating.problem.channels import Gains
from updyn.updating.problem.parameters import Parameter, ParameterSet

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "STATUSES",
    "JointResult",
    "UpdateResult",
    "describe_ending",
    "estimated_gains",
    "find_result",
    "interval",
    "interval_quantile",
]

STATUSES = (
    "converged",
    "not-credible",
    "stalled",
    "not-identifiable",
    "max-iterations",
    "stopped",
    "failed",
)


@dataclass(frozen=True, slots=True, eq=False)
class UpdateResult:
    """Result of an update.

    Attributes
    ----------
    status : str
        One of `STATUSES`.
    message : str
        Explanation of the status, in a sentence.
    steps : tuple of Remedy
        Advised steps, the most helpful first; empty if none is needed.
    method : str
        Name of the method.
    options : dict
        Options of the run.
    start : Model
        The model to which factors are relative. The fit begins at ``parameters.at_start(start)``;
        tables and figures of the start are computed there.
    model : Model
        The updated model.
    data : FRF or ModeSet
        All data of the test, neither converted nor selected.
    lines : ndarray of float
        Frequency lines of the fit, in Hz; empty for modes.
    fitted_responses, validation_responses : tuple of str
        Labels of the responses, or of the DOFs of the modes, that were fitted and held out.
    validation_band : tuple of (float, float) or None
        Band held out of the fit, in Hz.
    parameters : ParameterSet
        The unknowns with their start and bounds.
    values, std : dict of str to float
        Estimate and standard deviation of each unknown, in its unit; the standard deviation is inf
        for undetermined unknowns.
    covariance : ndarray of float, shape (n, n)
        Covariance of the values; rows of undetermined unknowns are inf.
    at_bound : dict of str to str
        ``"lower"`` or ``"upper"`` for each unknown that ended at a bound.
    identifiability : Identifiability
        Identifiability at the estimate.
    history : tuple of Iteration
        All steps.
    noise : dict
        Noise model: ``kind`` (its source), ``relative`` and ``floor`` if applicable,
        ``chi_square`` (reduced; 1 if the noise explains the residual), ``inflation`` (factor on
        the standard deviations), ``degrees_of_freedom`` (of the intervals, if the noise was
        estimated from few numbers).
    correlation : dict
        ``before``, ``after`` and, with held-out data, ``validation`` (itself with ``before``,
        ``after``): each a flat dict of figures (``frac_median``, ``db_error_median``,
        ``csac_mean``, ...).
    timing_s : dict of str to float
        Duration of each stage and ``total``, in seconds.
    versions : dict of str to str
        Versions of updyn, numpy, scipy and Python, and the platform.
    title : str
        Title of the update.
    adequacy : Adequacy or None
        Whether the residual is noise or a structural error of the model, and the errors that would
        explain it; None if it was not tested: the fit did not settle, rounding dominates, or the
        record is old.
    alternatives : tuple of Alternative
        Other answers that fit the data equally well. Only ``"maximum-likelihood"`` searches for
        them.
    trust : Trust or None
        Whether the answer is ``"converged"``, ``"determined"``, ``"validated"`` and
        ``"plausible"``, and whether the model ``"resembles"`` the test: each True, False or None
        (not known) with a sentence (``.why``); None in an old record.
    findings : tuple of Finding
        Causes of the residual of the fit, the likeliest first; empty if none was found. No causes
        are sought if the residual is noise or there are few lines.
    modes : ModalTable or None
        Modes of the test, of the start and of the updated model; None unless computed by
        `updyn.modal_table` or by the run of a job.
    counterparts : Counterparts or None
        Number of modes of the test with a counterpart in the model before the search; None in an
        old record.
    kept_basis : KeptBasis or None
        Final basis of a fit in the reduced tier, from which later computations in this process
        build their reduced models. It is neither saved nor pickled.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> result.identifiability.rank, result.std["part3.stiffness"] < 0.01
    (12, True)
    """

    status: str
    message: str
    steps: tuple[Remedy, ...]
    method: str
    options: Mapping[str, Any]
    start: Model
    model: Model
    data: FRF | ModeSet
    lines: RealArray
    fitted_responses: tuple[str, ...]
    validation_responses: tuple[str, ...]
    validation_band: tuple[float, float] | None
    parameters: ParameterSet
    values: Mapping[str, float]
    std: Mapping[str, float]
    covariance: RealArray
    at_bound: Mapping[str, str]
    identifiability: Identifiability
    history: tuple[Iteration, ...]
    noise: Mapping[str, Any]
    correlation: Mapping[str, Any]
    timing_s: Mapping[str, float]
    versions: Mapping[str, str]
    title: str = ""
    adequacy: Adequacy | None = None
    alternatives: tuple[Alternative, ...] = ()
    trust: Trust | None = None
    findings: tuple[Finding, ...] = ()
    modes: ModalTable | None = None
    counterparts: Counterparts | None = None
    kept_basis: KeptBasis | None = field(default=None, repr=False)

    @property
    def remedy(self) -> str:
        """The advised steps as text, one a line; empty if none is needed."""
        return "\n".join(map(str, self.steps))

    @property
    def frf(self) -> FRF:
        """The measured FRFs.

        Raises
        ------
        OptionError
            If the data are modes.
        """
        if isinstance(self.data, FRF):
            return self.data
        raise OptionError("this is an update to modes: it has no FRFs, which this takes")

    @property
    def results(self) -> Mapping[str, UpdateResult]:
        """The results by test, as in `JointResult`: this result, under an empty name."""
        return {"": self}

    @property
    def first(self) -> UpdateResult:
        """The result of the first test: this result."""
        return self

    @property
    def ok(self) -> bool:
        """Whether the fit converged with all unknowns determined."""
        return self.status == "converged"

    @property
    def is_ambiguous(self) -> bool:
        """Whether several answers fit equally well, each of them determined."""
        determined = self.status == "not-identifiable" and self.identifiability.complete
        return determined and bool(self.alternatives)

    @property
    def badge(self) -> Badge:
        """The verdict in a phrase and a colour."""
        return choose_badge(self.status, self.trust, ambiguous=self.is_ambiguous)

    @property
    def usable(self) -> bool:
        """Whether the fit converged and all requested parts of the verdict hold."""
        return self.ok and (self.trust is None or self.trust.holds)

    @property
    def iterations(self) -> int:
        """Number of accepted steps, including those of all tries of the search for a start."""
        return sum(h.counts for h in self.history)

    def why_open(self, name: str) -> str:
        """Return the reason, as a phrase, for the missing interval of an unknown.

        Parameters
        ----------
        name : str
            The unknown.

        Returns
        -------
        str
        """
        if name in self.noise.get("not_known", ()):
            return "not known: error of the model"
        return "not determined by the data"

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return the confidence interval of each determined unknown, in its unit.

        The interval of a factor is symmetric in the logarithm, in which it is estimated, and stays
        positive; that of a value is symmetric and cut off at 0. The quantile is Gaussian, or
        Student's if the noise is estimated from few numbers (``noise["degrees_of_freedom"]``).

        Parameters
        ----------
        level : float
            Probability that the interval covers the true value.

        Returns
        -------
        dict of str to (float, float)
        """
        freedom = self.noise.get("degrees_of_freedom")
        return {
            p.name: interval(p, self.values[p.name], self.std[p.name], level, freedom)
            for p in self.parameters
            if np.isfinite(self.std[p.name]) and np.isfinite(self.values[p.name])
        }

    def to_pandas(self, level: float = 0.95) -> pd.DataFrame:
        """Return a table with a row for each unknown.

        Parameters
        ----------
        level : float
            Probability that an interval covers the true value.

        Returns
        -------
        pandas.DataFrame
            Index: ``unknown``. Columns: ``group``, ``quantity``, ``start``, ``value``, ``std``,
            ``low`` and ``high`` (ends of the interval, nan for undetermined unknowns), ``unit`` and
            ``at_bound``.
        """
        import pandas as pd

        spans = self.intervals(level)
        rows = []
        for p in self.parameters:
            low, high = spans.get(p.name, (math.nan, math.nan))
            rows.append(
                {
                    "group": p.group,
                    "quantity": p.quantity,
                    "start": p.start,
                    "value": self.values[p.name],
                    "std": self.std[p.name],
                    "low": low,
                    "high": high,
                    "unit": p.value_unit,
                    "at_bound": self.at_bound.get(p.name, ""),
                }
            )
        return pd.DataFrame(rows, index=pd.Index(self.parameters.names, name="unknown"))

    def _repr_html_(self) -> str:
        return _format_html(self, self.title)

    def __repr__(self) -> str:
        return (
            f"UpdateResult({self.status}, {self.method},"
            f" {format_count(len(self.values), 'unknown')},"
            f" {format_count(self.iterations, 'iteration')})"
        )

    def _verdict_lines(self) -> list[str]:
        """Return the lines of the verdict: its parts, further remarks and the next action."""
        if self.trust is None:
            return [f"{self.message} {self.remedy}".removesuffix(" ")]
        lines = []
        for name, claim in self.trust.items():
            lines.append(f"  {name:<10}  {claim.answer:<9}  {claim.why}")
        rest = self.trust.beyond(self.status, self.message)
        if rest:
            lines.append(rest)
        if self.steps:
            first, *others = self.steps
            folded = (
                f" ({format_count(len(others), 'further step')} in the report)" if others else ""
            )
            lines.append(f"What to do next: {first}{folded}")
        return lines

    def summary(self) -> str:
        """Return the result as text: verdict, unknowns and identifiability."""
        width = max(28, 2 + max(map(len, self.parameters.names)))
        lines = [
            describe_ending(self),
            *self._verdict_lines(),
            "",
            f"{'unknown':<{width}}{'start':>12}{'value':>14}{'std':>12}  note",
        ]
        for p in self.parameters:
            value, std = self.values[p.name], self.std[p.name]
            notes = []
            if p.value_unit:
                notes.append(f"in {p.value_unit}")
            if p.nominal is not None:
                notes.append(p.physical(value, std))
            if p.name in self.at_bound:
                notes.append(f"at its {self.at_bound[p.name]} bound")
            std_text = f"{std:.3g}"
            if np.isinf(std):
                notes.append(self.why_open(p.name))
                std_text = "-"
            row = (
                f"{p.name:<{width}}{p.start:>12.6g}{value:>14.6g}{std_text:>12}  {'; '.join(notes)}"
            )
            lines.append(row.rstrip())
        ident = self.identifiability
        advice = ident.advice
        if advice in self.remedy:
            advice = ""
        determined = (
            f"The data determine {ident.rank} of {format_count(ident.n_parameters, 'unknown')}."
        )
        if self.trust is not None and self.trust.determined:  # stated by that part of the verdict
            determined = ""
        lines += ["", f"{determined} {advice}".strip()]
        lines += ident.describe_combinations()
        for number, other in enumerate(self.alternatives, 2):
            lines.append(f"  answer {number} fits as well: {_describe_alternative(other, self)}")
        if self.options.get("tier") == "reduced" and "basis" in self.options:
            lines.append(
                f"Solved in a reduced model of {self.options['basis']} basis vectors; its error:"
                f" {_describe_reduction_error(self.options)}."
            )
        if self.adequacy is not None:
            lines += _describe_residual(self.adequacy, self.message)
        if any(p.is_channel for p in self.parameters):
            lines.append(
                "After: the updated model as the sensors read it, times their calibration factors."
            )
        agreement = _format_agreement(self.correlation)
        if agreement:
            lines += ["", agreement]
        # Remove the gaps of empty paragraphs.
        return re.sub(r"\n{3,}", "\n\n", "\n".join(lines))


@dataclass(frozen=True, slots=True, eq=False)
class JointResult:
    """Result of a joint update to several tests.

    Parameters
    ----------
    results : mapping of str to UpdateResult
        Result of each test, with its model, data and agreement. The entries on the unknowns
        (values, standard deviations, history, status) are the same in all of them.
    title : str
        Title of the update.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> halves = [frf.select(references=[r]) for r in frf.references.labels]
    >>> tests = [updyn.Test(model, h, name=n) for h, n in zip(halves, ["a", "b"], strict=True)]
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> joint = updyn.update_jointly(tests, unknowns, starts=0)
    >>> list(joint.results), joint.ok
    (['a', 'b'], True)
    """

    results: Mapping[str, UpdateResult]
    title: str = ""

    def __getitem__(self, name: str) -> UpdateResult:
        """Return the result of a test."""
        return self.results[name]

    @property
    def first(self) -> UpdateResult:
        """The result of the first test, for the entries that all tests share."""
        return next(iter(self.results.values()))

    @property
    def status(self) -> str:
        """One of `STATUSES`."""
        return self.first.status

    @property
    def ok(self) -> bool:
        """Whether the fit converged with all unknowns determined."""
        return self.first.ok

    @property
    def badge(self) -> Badge:
        """The verdict in a phrase and a colour."""
        return self.first.badge

    @property
    def usable(self) -> bool:
        """Whether the fit converged and all requested parts of the verdict hold."""
        return self.first.usable

    @property
    def parameters(self) -> ParameterSet:
        """The unknowns with their start and bounds."""
        return self.first.parameters

    @property
    def values(self) -> Mapping[str, float]:
        """Estimate by unknown."""
        return self.first.values

    @property
    def std(self) -> Mapping[str, float]:
        """Standard deviation by unknown; inf for undetermined unknowns."""
        return self.first.std

    def intervals(self, level: float = 0.95) -> dict[str, tuple[float, float]]:
        """Return the confidence interval of each determined unknown, in its unit.

        Parameters
        ----------
        level : float
            Probability that the interval covers the true value.

        Returns
        -------
        dict of str to (float, float)
        """
        return self.first.intervals(level)

    def to_pandas(self, level: float = 0.95) -> pd.DataFrame:
        """Return a table with a row for each unknown, as `UpdateResult.to_pandas`.

        Parameters
        ----------
        level : float
            Probability that an interval covers the true value.

        Returns
        -------
        pandas.DataFrame
        """
        return self.first.to_pandas(level)

    @property
    def identifiability(self) -> Identifiability:
        """Identifiability of the unknowns from the data of all tests together."""
        return self.first.identifiability

    @property
    def alternatives(self) -> tuple[Alternative, ...]:
        """Other answers that fit the data of all tests equally well."""
        return self.first.alternatives

    @property
    def trust(self) -> Trust | None:
        """The verdict in five parts, over all tests."""
        return self.first.trust

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Causes of the residual that were found, each with its test."""
        return self.first.findings

    def _repr_html_(self) -> str:
        return _format_html(self.first, self.title, tests=len(self.results))

    def __repr__(self) -> str:
        tests = format_count(len(self.results), "test")
        return f"JointResult({self.status}, {tests}, {format_count(len(self.values), 'unknown')})"

    def summary(self) -> str:
        """Return the result as text: the unknowns once, and the agreement of each test."""
        of_first = _describe_residual(self.first.adequacy, self.first.message)
        agreement = _format_agreement(self.first.correlation)
        lines = []
        for line in self.first.summary().removesuffix(agreement).rstrip().splitlines():
            if line not in of_first:
                lines.append(line)
        lines[0] = describe_ending(self)
        for name, result in self.results.items():
            for line in _describe_residual(result.adequacy, result.message):
                lines.append(f"{name}: {line.strip()}")
        for name, result in self.results.items():
            lines += ["", name, _format_agreement(result.correlation)]
        return "\n".join(lines).rstrip()


def describe_ending(result: UpdateResult | JointResult) -> str:
    """Return title, status, number of iterations and verdict of a result in a line."""
    first = result.first
    return (
        f"{result.title or 'Update'}: {first.status} after"
        f" {format_count(first.iterations, 'iteration')} ({first.method}). {first.badge.phrase}."
    )


def _format_html(result: UpdateResult, title: str, tests: int = 1) -> str:
    """Return a result as HTML: verdict, unknowns with their intervals, changes."""
    intervals = result.intervals()
    rows, changes = [], []
    for p in result.parameters:
        value, std = result.values[p.name], result.std[p.name]
        low, high = intervals.get(p.name, (math.nan, math.nan))
        span, notes = "", []
        if math.isfinite(low):
            span = f"{_format_value(low, std)} to {_format_value(high, std)}"
        else:
            notes.append(result.why_open(p.name))
        if p.name in result.at_bound:
            notes.append(f"at its {result.at_bound[p.name]} bound")
        if p.value_unit:
            notes.append(f"in {p.value_unit}")
        deviation = f"{std:.2g}" if math.isfinite(std) else ""
        value_text = _format_value(value, std)
        rows.append([p.name, f"{p.start:.4g}", value_text, deviation, span, "; ".join(notes)])
        if p.start > 0.0:
            ends = [100.0 * (v / p.start - 1.0) for v in (low, value, high)]
            changes.append((p.name, ends[0], ends[1], ends[2]))
    agreement = []
    for when in ("before", "after"):
        figure = (result.correlation.get(when) or {}).get("frac_median")
        agreement.append("" if figure is None else f"{figure:.4f}")
    facts = {
        "method": result.method,
        "iterations": result.iterations,
        "tests": tests if tests > 1 else "",
        "determined": f"{result.identifiability.rank} of {format_count(len(rows), 'unknown')}",
        "FRAC, median": " → ".join(agreement) if all(agreement) else "",
    }
    header = ["unknown", "start", "value", "std. dev.", "95 % interval", "note"]
    if not any(row[-1] for row in rows):  # no empty column
        header.pop()
        rows = [row[:-1] for row in rows]
    return card(
        title or "Update",
        facts,
        f"{badge(result.badge.phrase, result.badge.colour)} {html.escape(result.message)}",
        spans(changes, "change from the start (%)"),
        table(header, rows, left=(0, 5)),
    )


def _format_value(value: float, std: float) -> str:
    """Return a number with two digits of its standard deviation, or five digits without one."""
    if not (math.isfinite(value) and math.isfinite(std) and std > 0.0):
        return f"{value:.5g}"
    decimals = 1 - math.floor(math.log10(std))
    return f"{value:.{decimals}f}" if 0 <= decimals <= 8 else f"{value:.5g}"


def interval_quantile(level: float, freedom: int | None) -> float:
    """Return the half width of an interval of probability `level`, in standard deviations.

    The distribution is Gaussian, or Student's with `freedom` degrees of freedom if given.
    """
    upper = 0.5 * (1.0 + level)
    return float(ndtri(upper) if freedom is None else stdtrit(freedom, upper))


def interval(
    parameter: Parameter, value: float, std: float, level: float = 0.95, freedom: int | None = None
) -> tuple[float, float]:
    """Return the confidence interval of an unknown, with the probability `level`.

    The distribution is that of `interval_quantile`.
    """
    wide = interval_quantile(level, freedom)
    if parameter.is_factor and value > 0:
        spread = math.exp(min(wide * std / value, 50.0))
        return value / spread, value * spread
    return max(value - wide * std, 0.0), value + wide * std


def _describe_reduction_error(options: Mapping[str, object]) -> str:
    """Return the error of a reduced model for FRFs or modes in words."""
    of_modes = "frequency error" in options
    error = options["frequency error" if of_modes else "error"]
    if not isinstance(error, float):
        return str(error)
    if of_modes:
        return f"{error:.1g} of a natural frequency, compared with the full model"
    return f"at most {error:.1g} of the peak"


def _describe_alternative(other: Alternative, result: UpdateResult) -> str:
    """Return the unknowns in which another answer differs, as text."""
    different = find_differences(result.values, result.std, [other])
    return ", ".join(f"{name} {values[1]:.6g}" for name, values in different)


def _format_agreement(correlation: Mapping[str, Any]) -> str:
    """Return the figures of agreement before and after, also on held-out data, as a table."""
    held = correlation.get("validation") or {}
    return agreement_table(
        {
            "before": correlation.get("before") or {},
            "after": correlation.get("after") or {},
            "held out, before": held.get("before") or {},
            "held out, after": held.get("after") or {},
        }
    )


def _describe_residual(found: Adequacy | None, message: str) -> list[str]:
    """Return the summary lines on the residual; no verdict if `message` contains it."""
    if found is None:
        return []
    lines = []
    if found.verdict not in message:
        lines.append(f"Residual: {found.verdict}")
    elif found.worst:
        lines.append("Residual, where it stands out most:")
    unit = "times the noise" if found.absolute else "times the typical misfit"
    for place in found.worst[:5]:
        over = ""
        if place.kind == "structure":
            over = f", serially correlated over {place.correlation_length:.0f} lines"
        where = f"{place.response} / {place.reference}, {place.low:.4g} to {place.high:.4g} Hz"
        lines.append(f"  {where}: {place.misfit:.3g} {unit}{over}")
    for suspect in found.explained_by[:3]:
        how = "" if suspect.confirmed else ", to first order"
        lines.append(
            f"  an error in {suspect.name} would explain {100.0 * suspect.explains:.0f} %{how}"
        )
    return lines


def find_result(result: UpdateResult | JointResult, test: str | None) -> UpdateResult:
    """Return the result of one test of an update; `test` is None for an update with one test."""
    if not isinstance(result, UpdateResult | JointResult):
        raise OptionError(f"expected the result of an update, found {type(result).__name__}")
    names = [name for name in result.results if name]
    if test is None and not names:
        return result.first
    if test is not None and test in names:
        return result.results[test]
    if not names:
        raise OptionError(f"test = {test!r}: this update has one test only")
    raise OptionError(f"test = {test!r}: which test's model is meant? {suggest(str(test), names)}")


def estimated_gains(result: UpdateResult) -> RealArray | None:
    """Return the estimated calibration factor of each channel, shape (n_i, n_j), or None."""
    if isinstance(result.data, ModeSet):
        return None
    gains = Gains.find(result.parameters, result.data)
    if gains is None:
        return None
    values = [result.values[p.name] if p.is_channel else 1.0 for p in result.parameters]
    return gains.factors(np.log(np.array(values)))
