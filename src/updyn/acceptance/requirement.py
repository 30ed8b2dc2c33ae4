"""`Requirement`: one limit of one mode, its outcome and the probability of passing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

__all__ = ["FAIL", "OPEN", "PASS", "REQUIREMENT_KINDS", "Requirement"]

PASS, FAIL, OPEN = "pass", "fail", "not decidable"
#: Kinds of requirements and their names.
REQUIREMENT_KINDS = {
    "measured": "major mode is measured",
    "pair": "mode has a pair",
    "frequency": "frequency",
    "mac": "MAC",
    "mac_off": "MAC with other modes",
    "cross": "cross-orthogonality",
    "cross_off": "cross-orthogonality with other modes",
    "mass_met": "effective mass of paired modes",
}
_AT_MOST = ("frequency", "mac_off", "cross_off")


@dataclass(frozen=True, slots=True)
class Requirement:
    """One requirement on one mode, or on the model.

    Attributes
    ----------
    kind : str
        ``"pair"``, ``"measured"`` (a major mode of the model is measured), ``"frequency"``,
        ``"mac"``, ``"mac_off"``, ``"cross"``, ``"cross_off"`` or ``"mass_met"``.
    outcome : {"pass", "fail", "not decidable"}
        Whether the requirement is met.
    measured, computed : float
        Natural frequencies in Hz of the measured and the computed mode; nan without one.
    value, limit : float
        Value as measured and its limit, as shares; nan if there is no number.
    probability : float
        Probability that the true value meets the limit, with the errors of the measured modes and
        the uncertainty of the unknowns; nan if not known.
    probability_as_delivered : float
        The same with the unknowns at their estimate.
    note : str
        Reason or remark.

    Examples
    --------
    >>> one = updyn.Requirement("frequency", "pass", 10.0, 10.2, 0.02, 0.05, 0.99, 0.99)
    >>> one.text()
    'frequency 2.00 % (at most 5.00 %)'
    """

    kind: str
    outcome: str
    measured: float = np.nan
    computed: float = np.nan
    value: float = np.nan
    limit: float = np.nan
    probability: float = np.nan
    probability_as_delivered: float = np.nan
    note: str = ""

    @property
    def is_upper(self) -> bool:
        """Whether the value must be at most the limit; else at least."""
        return self.kind in _AT_MOST

    def text(self) -> str:
        """Return what is required, with value and limit."""
        name = REQUIREMENT_KINDS[self.kind]
        if np.isnan(self.limit):
            return name
        bound = "at most" if self.is_upper else "at least"
        value, limit = (self.format_number(x) for x in (self.value, self.limit))
        return f"{name} {value} ({bound} {limit})"

    def format_number(self, value: float) -> str:
        """Return a value or a limit of this kind as text; a dash for nan.

        Parameters
        ----------
        value : float
            The number, as a share.

        Returns
        -------
        str
        """
        if np.isnan(value):
            return "-"
        if self.kind in ("frequency", "mass_met"):
            return f"{100.0 * value:.2f} %"
        return f"{value:.3f}"

    def decided(self, least_probability: float | None) -> Requirement:
        """Return the requirement with the outcome by value, or by probability if one is given.

        Parameters
        ----------
        least_probability : float, optional
            Least probability of passing; below it, the requirement fails if the probability of
            failing is as large, and is not decidable otherwise.

        Returns
        -------
        Requirement
        """
        if least_probability is None:
            met = self.value <= self.limit if self.is_upper else self.value >= self.limit
            return replace(self, outcome=PASS if met else FAIL)
        if np.isnan(self.probability):
            return self.left_open("the standard deviations of the measured mode are not known")
        if self.probability >= least_probability:
            return replace(self, outcome=PASS)
        if 1.0 - self.probability >= least_probability:
            return replace(self, outcome=FAIL)
        return self.left_open(f"passes and fails with less than {least_probability:g} probability")

    def left_open(self, why: str) -> Requirement:
        """Return the requirement as not decidable.

        Parameters
        ----------
        why : str
            The reason.

        Returns
        -------
        Requirement
        """
        note = "; ".join(filter(None, [why, self.note]))
        return replace(self, outcome=OPEN, note=note)
