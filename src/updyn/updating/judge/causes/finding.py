"""`Finding`: a cause that was found for a misfit, in words, with what repairs it."""

from __future__ import annotations

from dataclasses import dataclass

from updyn.errors import DataError
from updyn.frf import FRF
from updyn.updating.judge.causes.catalogue import read_fault

__all__ = ["Finding"]

#: Share of the misfit that a cause has to explain to speak against an answer.
_MOST_OF_IT = 0.5
#: Share of it from which nothing is left to explain.
_ALL_OF_IT = 0.95
#: Kinds that spoil some lines and leave the others as they are.
_LOCAL = ("mains", "missing-mode")
#: Kinds that spoil an answer however few the channels: a fit takes their values for responses.
_SPOILING = ("dead-channel",)
#: A calibration, as a logarithm, that leaves an answer that may be used.
_MILD = 0.3


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is wrong with the data or the model, found from both.

    Attributes
    ----------
    kind : str
        ``"sign"``, ``"swapped"``, ``"quantity"``, ...
    channels : tuple of str
        Labels of the sensors that it is about, ``"force 2:Z"`` for a reference; of ``"no-support"``
        the group; of what the model lacks the DOFs, or the unknown: ``"floors.mass_damping"``.
        Empty: all.
    value : float
        By how much, in the unit that the statement names; 0 where the kind says it all.
    odds : float
        How much likelier the data are with it than without it, times how often it happens.
    explains : float
        Share of the misfit that is left without it and not with it; or, where the unknowns can
        imitate it, of how far they have to go from their start to do so. Of what the data show by
        themselves: share of the data that it concerns.
    statement : str
        What is wrong, in a sentence.
    remedy : str
        What to do: the line of the job that undoes it, or what to look at.
    written : str
        The fault as the job writes it; empty where no change of the data undoes it.
    also : tuple of str
        Other faults that these data do not tell from it, as the job writes them; ``kind:channels``
        where no change of the data undoes one.
    test : str
        Which test, where there are several.
    of_misfit : float
        Share of the misfit alone that is left without it and not with it; 0 where it was not
        compared with a model.

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
    remedy: str
    written: str = ""
    also: tuple[str, ...] = ()
    test: str = ""
    of_misfit: float = 0.0

    @property
    def grave(self) -> bool:
        """Whether the answer cannot be believed while it is so.

        A calibration of some tens of per cent, or a mode that the model lacks, leaves an answer
        that may be used with care.
        """
        if self.kind in _SPOILING:
            return True
        if self.explains < _MOST_OF_IT or self.kind in _LOCAL:
            return False
        return self.kind != "calibration" or abs(self.value) > _MILD

    @property
    def overruling(self) -> bool:
        """Whether it leaves nothing of the misfit to explain, so that no other answer is wanted.

        One that only brings unknowns back to their start leaves what another answer may explain.
        """
        return self.grave and self.of_misfit > _ALL_OF_IT

    def repair(self, frf: FRF) -> FRF:
        """Return data without the fault.

        Parameters
        ----------
        frf : FRF
            The data, as measured.

        Returns
        -------
        FRF
            The same, but for what was wrong.

        Raises
        ------
        DataError
            If no change of the data undoes it.
        """
        if not self.written:
            raise DataError(f"{self.kind}: no change of the data undoes it. {self.remedy}")
        return read_fault(self.written).repair(frf)
