"""A drive point at which the force takes energy out of the structure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from updyn.frf import FRF, QUANTITIES
from updyn.updating.judge.causes.channel_factor import Delay, WrongSign
from updyn.updating.judge.causes.conjugate import ConjugatedData
from updyn.updating.judge.causes.fault import FORCE, Fault
from updyn.updating.judge.causes.moved import MisplacedSensor
from updyn.updating.judge.causes.quantity import WrongQuantity
from updyn.updating.judge.causes.settings import CAUSE_ODDS, DATA_FAULT
from updyn.updating.judge.causes.shown import DataFault, Detection
from updyn.updating.judge.causes.square import CollocatedFrfs

__all__ = ["DrivePoint"]


@dataclass(frozen=True, slots=True)
class DrivePoint(DataFault):
    """At a share `value` of the lines the force takes energy out of the structure at these DOFs.

    The mean power of a force is |F|^2 Re(Y) / 2, with Y the mobility of its drive point: Re(Y) >= 0
    if the structure is passive (Ewins, Modal Testing, 2nd ed. 2000, section 2.3). With e^(i omega
    t), the receptance has a negative imaginary part, the accelerance a positive one.
    """

    explanations: tuple[str, ...] = ()

    kind: ClassVar[str] = "drive-point"
    is_symptom: ClassVar[bool] = True
    needs_forces: ClassVar[bool] = True
    advice: ClassVar[str] = (
        "Check the direction of sensor and force, the quantity that the file states, and"
        " time delays between the channels."
    )

    @classmethod
    def detect_faults(cls, frf: FRF) -> Iterable[Detection]:
        """Yield the affected drive points as one fault."""
        square = CollocatedFrfs.of(frf)
        shares, log_odds = {}, 0.0
        for i, label in enumerate(square.labels):
            clear, sure, active = _count_lines(square, i)
            share = active / max(clear, 1)
            ratio = _log_likelihood_ratio(active / max(sure, 1))
            gain = min(sure, DATA_FAULT.most_independent) * ratio + float(np.log(cls.odds))
            if share >= DATA_FAULT.least_negative and gain > CAUSE_ODDS.likely_log_odds:
                shares[label] = share
                log_odds = max(log_odds, gain)
        if shares:
            channels = tuple(shares)
            fault = cls(channels, max(shares.values()), tuple(_iter_explanations(frf, channels)))
            yield Detection(fault, log_odds, sum(shares.values()) / len(square.labels))

    def mask_values(self, frf: FRF) -> FRF:
        """Return the data in which these values have no weight."""
        square = CollocatedFrfs.of(frf)
        at = [square.labels.index(label) for label in self.channels]
        return square.mask_pairs(frf, zip(at, at, strict=True))

    def statement(self) -> str:
        """Return a sentence with the drive points, the share of lines and possible causes."""
        possible_causes = ""
        if self.explanations:
            possible_causes = f" Possible causes: {', or '.join(self.explanations)}."
        return (
            f"At the drive point {self.channel_text} the force takes energy out of the structure at"
            f" {100.0 * self.value:.0f} % of the lines (the real part of the mobility is negative),"
            f" which is impossible for a passive structure.{possible_causes}"
        )


def _iter_explanations(frf: FRF, channels: Sequence[str]) -> Iterator[str]:
    """Yield the faults without which these drive points would be passive."""
    if _is_passive(WrongSign(tuple(channels)), frf, channels):
        yield "the opposite sign of sensor or force"
    for name, power in QUANTITIES.items():
        if name != frf.quantity and _is_passive(WrongQuantity((), power), frf, channels):
            yield f"data that are {name}"
    if _is_passive(ConjugatedData(), frf, channels):
        yield "conjugated data"
    for label in channels:
        yield from _iter_other_force_places(frf, label)
    for periods in DATA_FAULT.delay_periods:
        for late in (periods / frf.freq[-1], -periods / frf.freq[-1]):
            if _is_passive(Delay(tuple(channels), float(late)), frf, channels):
                yield f"a delay of about {late:.1g} s"
                return


def _is_passive(fault: Fault, frf: FRF, channels: Sequence[str]) -> bool:
    square = CollocatedFrfs.of(fault.repair(frf))
    for label in channels:
        clear, _, active = _count_lines(square, square.labels.index(label))
        if active > DATA_FAULT.negative_by_chance * clear:
            return False
    return True


def _iter_other_force_places(frf: FRF, stated: str) -> Iterator[str]:
    """Yield the only other sensor at which a force would put energy into the structure."""
    # The number of lines with a significant sign has to be so large that, with the share of
    # negative signs of the stated place, all would be positive only by a small chance at any of
    # the sensors.
    square = CollocatedFrfs.of(frf)
    _, sure, active = _count_lines(square, square.labels.index(stated))
    share = min(active / max(sure, 1), 0.5)
    taken = {str(abs(dof)) for dof in frf.references}
    others = [str(abs(dof)) for dof in frf.responses if str(abs(dof)) not in taken]
    found = []
    for place in others:
        relabelled = MisplacedSensor((f"{FORCE}{stated}", f"{FORCE}{place}")).repair(frf)
        for fault, sign in (
            (None, ""),
            (WrongSign((f"{FORCE}{place}",)), " with the opposite sign"),
        ):
            repaired = CollocatedFrfs.of(relabelled if fault is None else fault.repair(relabelled))
            clear, sure, active = _count_lines(repaired, repaired.labels.index(place))
            certain = -min(sure, DATA_FAULT.most_independent) * float(np.log1p(-share))
            passive = active <= DATA_FAULT.negative_by_chance * clear
            if passive and certain > CAUSE_ODDS.likely_log_odds + float(np.log(len(others))):
                found.append(f"a force at {place}, not at {stated},{sign}".rstrip(","))
    if len(found) == 1:
        yield found[0]


def _log_likelihood_ratio(share: float) -> float:
    """Return the log likelihood ratio of a line with a sign, for a share of negative signs."""
    if share <= DATA_FAULT.negative_by_chance:
        return 0.0
    quiet = 0.0
    if share < 1.0:
        quiet = (1.0 - share) * np.log((1.0 - share) / (1.0 - DATA_FAULT.negative_by_chance))
    return float(share * np.log(share / DATA_FAULT.negative_by_chance) + quiet)


def _count_lines(square: CollocatedFrfs, i: int) -> tuple[int, int, int]:
    """Return the numbers of lines above the noise, with a certain sign of Re(Y), and negative."""
    H, noise = square.values[:, i, i], square.noise[:, i, i]
    clear = (np.abs(H) > DATA_FAULT.phase_stds * noise) & (square.freq > 0.0)
    to_mobility = square.s[clear] ** (1 - QUANTITIES[square.quantity])
    Y, std = H[clear] * to_mobility, noise[clear] * np.abs(to_mobility) / np.sqrt(2.0)
    doubt = DATA_FAULT.outlier_stds * std + DATA_FAULT.phase_error * np.abs(Y)
    return len(Y), int(np.count_nonzero(np.abs(Y.real) > doubt)), int(np.sum(Y.real < -doubt))
