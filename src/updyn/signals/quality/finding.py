"""`RecordFinding`: a fault of time records."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RecordFinding"]


@dataclass(frozen=True, slots=True)
class RecordFinding:
    """A fault of a record, or of several as a whole.

    Attributes
    ----------
    kind : str
        ``"no-pulse"``, ``"clipped"``, ``"double-hit"``, ``"short-force"``, ``"cut-off"``,
        ``"leakage"``, ``"drift"``, ``"mains"``, ``"noise-floor"`` or ``"level-dependence"``.
    channel : str
        The channel.
    record : int or None
        The number of the record, from 1. None: all records together.
    value : float
        Size of the fault, in the unit that the statement names.
    statement : str
        The fault, in a sentence.
    remedy : str
        The remedy, in a sentence.
    band : (float, float) or None
        The affected lines in Hz. None: all.

    Examples
    --------
    >>> import numpy as np
    >>> import xarray
    >>> force = np.zeros((3, 1024))
    >>> force[:, 100:110] = 50.0 * np.sin(np.pi * np.arange(10) / 10)
    >>> force[1] += 0.2 * np.roll(force[1], 90)  # the hammer bounced
    >>> records = xarray.DataArray(
    ...     np.stack([force, force / 2.0], axis=1),  # a mass of 2 kg
    ...     dims=("record", "channel", "time"),
    ...     coords={
    ...         "channel": ["1:X", "2:X"],
    ...         "unit": ("channel", ["N", "m/s^2"]),
    ...         "time": np.arange(1024) / 1024,
    ...     },
    ... )
    >>> (found,) = updyn.check_records(records, "1:X")
    >>> found.kind, found.record, round(found.value, 2)
    ('double-hit', 2, 0.2)
    """

    kind: str
    channel: str
    record: int | None
    value: float
    statement: str
    remedy: str
    band: tuple[float, float] | None = None
