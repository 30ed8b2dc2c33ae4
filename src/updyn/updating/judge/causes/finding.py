"""`Finding`: a probable cause of a misfit, with its statement, remedy and repair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from updyn.errors import DataError
from updyn.frf import FRF
from updyn.notebook import card, table
from updyn.remedy import Remedy
from updyn.text_table import percent
from updyn.updating.judge.causes.catalogue import CAUSES, read_fault
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.settings import CAUSE_ODDS

__all__ = ["Finding", "Findings", "make_fault_finding"]

#: Kinds that affect some lines only.
_LOCAL_KINDS = ("mains", "missing-mode")
#: Kinds that make an answer implausible even with few channels, because a fit takes their values
#: for responses.
_GRAVE_KINDS = ("dead-channel",)


@dataclass(frozen=True, slots=True)
class Finding:
    """A probable cause of a misfit: a fault of the data or of the model.

    Attributes
    ----------
    kind : str
        ``"sign"``, ``"swapped"``, ``"quantity"``, ...
    channels : tuple of str
        Labels of the affected sensors, ``"force 2:Z"`` for a reference. For ``"no-support"`` the
        group; for something that the model lacks its DOFs, or the unknown:
        ``"floors.mass_damping"``. Empty: all.
    value : float
        Size, in the unit that the statement names; 0 for kinds without a size.
    odds : float
        Posterior odds of the cause: likelihood ratio of the data with and without it, times its
        prior odds.
    explains : float
        Share of the misfit that it explains; or, if the unknowns can imitate it, share of their
        distance from the start that it makes unnecessary. For a fault found in the data alone:
        share of the affected data.
    statement : str
        A sentence that describes it.
    step : Remedy
        Advice: the setting of the job that corrects it, or what to check.
    written : str
        Text of the fault for the job; empty if no change of the data corrects it.
    also : tuple of str
        Other faults that these data do not distinguish from it, as texts for the job;
        ``kind:channels`` for one that no change of the data corrects.
    test : str
        Name of the test, if there are several.
    of_misfit : float
        Share of the misfit alone that it explains; 0 if it was not compared with a model.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> crossed = replace(frf, values=frf.values[:, [0, 3, 2, 1, 4]])  # two cables
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all")
    >>> found = updyn.update(model, crossed, unknowns, starts=0)
    >>> found.findings[0].written
    'swapped:5:X,10:X'
    >>> repaired = found.findings[0].repair(crossed)
    """

    kind: str
    channels: tuple[str, ...]
    value: float
    odds: float
    explains: float
    statement: str
    step: Remedy
    written: str = ""
    also: tuple[str, ...] = ()
    test: str = ""
    of_misfit: float = 0.0

    @property
    def remedy(self) -> str:
        """The advice as text."""
        return str(self.step)

    @property
    def grave(self) -> bool:
        """Whether an answer with this cause is not plausible.

        With a calibration off by some tens of per cent, or a mode that the model lacks, an answer
        may be used with care.
        """
        if self.kind in _GRAVE_KINDS:
            return True
        if self.explains < CAUSE_ODDS.grave_share or self.kind in _LOCAL_KINDS:
            return False
        return self.kind != "calibration" or abs(self.value) > CAUSE_ODDS.mild_calibration

    @property
    def concerns_model(self) -> bool:
        """Whether the model has the fault, and not the data."""
        cause = CAUSES.find(self.kind)
        return cause.alters_model or cause.concerns_model

    @property
    def overruling(self) -> bool:
        """Whether it is grave and explains all of the misfit, so that the search can end.

        A cause that only brings unknowns back to their start does not explain the misfit, because
        another answer may explain it.
        """
        return self.grave and self.of_misfit > 1.0 - CAUSE_ODDS.negligible_share

    def repair(self, frf: FRF) -> FRF:
        """Return the data without the fault.

        Parameters
        ----------
        frf : FRF
            Measured data.

        Returns
        -------
        FRF
            The data with the fault corrected.

        Raises
        ------
        DataError
            If no change of the data corrects it.
        """
        if not self.written:
            raise DataError(f"{self.kind}: no change of the data corrects it. {self.remedy}")
        return read_fault(self.written).repair(frf)


class Findings(tuple[Finding, ...]):
    """Findings, the likeliest first; a notebook shows them as a table."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        rows = []
        for one in self:
            channels = ", ".join(one.channels) or "all"
            most = CAUSE_ODDS.shown_odds
            odds = f"{one.odds:.2g} to 1" if one.odds < most else f"> {most:.0e} to 1"
            rows.append(
                [one.kind, channels, odds, percent(one.explains), one.statement, one.remedy]
            )
        header = ("cause", "channels", "odds", "explains", "statement", "remedy")
        return card("Suspected faults", {"found": len(self)}, table(header, rows, (0, 1, 4, 5)))


def make_fault_finding(fault: Fault, log_odds: float, explains: float, test: str) -> Finding:
    """Return the finding of a fault of a test."""
    return Finding(
        fault.kind,
        fault.channels,
        fault.value,
        float(np.exp(min(log_odds, 700.0))),  # exp(710) overflows
        explains,
        fault.statement(),
        fault.remedy,
        fault.repair_text,
        test=test,
    )
