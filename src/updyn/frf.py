"""`FRF`: frequency response functions with DOFs, quantity, coherence and variance."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, IndexArray, NumberArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import DataError, DofError, in_all, key_path, suggest
from updyn.force_spectrum import check_rms, check_spectrum, find_rms, make_flat_spectrum
from updyn.geometry import Geometry
from updyn.notebook import PlotCurve, card, curves
from updyn.settings import NOTEBOOK, ROUNDING
from updyn.units import RATES, Unit, find_ratio, find_unit

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = [
    "EXCITATIONS",
    "FRF",
    "QUANTITIES",
    "ROUNDING",
    "SWEEPS",
    "TRANSMISSIBILITY",
    "check_band",
    "check_decay",
    "check_force_quantity",
    "check_lines",
    "check_quantity",
    "reference_noun",
    "unit",
]

#: Power of (i omega) relative to receptance.
QUANTITIES = {"receptance": 0, "mobility": 1, "accelerance": 2}
#: Quantity of a response over the motion of a base or of another sensor.
TRANSMISSIBILITY = "transmissibility"
#: Directions in which the frequency of a sine changes.
SWEEPS = ("up", "down")
#: Kinds of force that a level can be of.
EXCITATIONS = ("sine", "random")
#: Suffix to the unit of displacement.
_POWER_UNITS = {"receptance": "", "mobility": "/s", "accelerance": "/s²"}
#: Dimensions of the variables of a dataset.
_DIMS = ("freq", "response", "reference")
#: Remedy for missing values.
_GAPS = "`updyn.complete_parts` cuts data with gaps into parts that have none"
_INVERSES = {
    "dynamic stiffness": "receptance",
    "impedance": "mobility",
    "apparent mass": "accelerance",
    "mechanical impedance": "mobility",
    "dynamic mass": "accelerance",
}


def check_quantity(quantity: object) -> str:
    """Return `quantity` if it is a key of `QUANTITIES` or a transmissibility; else DataError."""
    if isinstance(quantity, str):
        if quantity in QUANTITIES or quantity == TRANSMISSIBILITY:
            return quantity
        plain = quantity.casefold().replace("_", " ").replace("-", " ").strip()
        if plain in _INVERSES:
            raise DataError(
                f"quantity {quantity!r} is a force over a motion. One measured element of it is not"
                f" the inverse of one {_INVERSES[plain]} (all other DOFs would have to be held), so"
                f" it is not converted: supply {_INVERSES[plain]}, measured with one force at a"
                " time"
            )
    raise DataError(
        f"quantity {quantity!r}: {suggest(str(quantity), [*QUANTITIES, TRANSMISSIBILITY])}"
    )


def check_force_quantity(quantity: object) -> str:
    """Return `quantity` if it is a motion over a force; else raise DataError."""
    if check_quantity(quantity) == TRANSMISSIBILITY:
        raise DataError(
            f"quantity {quantity!r} is no motion over a force; expected one of"
            f" {', '.join(map(repr, QUANTITIES))}"
        )
    return str(quantity)


def reference_noun(quantity: str) -> str:
    """Return the noun for the reference of a channel: ``"force"``, or ``"reference"`` sensor."""
    return "reference" if quantity == TRANSMISSIBILITY else "force"


def unit(quantity: str, response: str, reference: str) -> str:
    """Return the unit of a channel, from its two DOFs: ``"(m/s²)/N"``, ``"rad/(N m)"``, ..."""
    if quantity == TRANSMISSIBILITY:
        above, below = ("rad" if "R" in dof else "m" for dof in (response, reference))
        return "1" if above == below else f"{above}/{below}"
    motion = ("rad" if "R" in response else "m") + _POWER_UNITS[quantity]
    force = "(N m)" if "R" in reference else "N"
    return f"({motion})/{force}" if "/" in motion else f"{motion}/{force}"


@dataclass(frozen=True, slots=True, eq=False, init=False)
class FRF:
    """Frequency response functions, immutable.

    Parameters
    ----------
    freq : array_like of float, shape (n_f,)
        Lines in Hz, finite, not negative, strictly increasing.
    values : array_like of complex, shape (n_f, n_responses, n_references)
        Motion over force: m/N, m/s/N or m/s2/N for translations (rad and N m for rotations). A
        transmissibility is a motion over a motion, without unit if both are translations.
    responses, references : iterable of str or Dof
        Signed DOF labels of the sensors and of the forces, each DOF once. The reference of a
        transmissibility is the sensor whose motion divides the responses.
    quantity : {"receptance", "mobility", "accelerance", "transmissibility"}
        Quantity of `values`. There is no default: if a file does not give it, the user must.
    coherence : array_like of float, shape of `values`, optional
        Ordinary coherence gamma^2 between 0 and 1 (stored as "coherence" by analysers). Values
        above 1 by rounding in single precision (at most 2.4e-7) are set to 1.
    variance : array_like of float, shape of `values`, optional
        E|dH|^2 of each value, in the unit of `values` squared.
    averages : int, optional
        Number of averages behind each value; together with `coherence` it gives the variance.
    geometry : Geometry, optional
        Positions of the nodes.
    source : str, optional
        Origin of the data, for documentation.
    decay : float
        Decay rate in 1/s of an exponential window exp(-decay t) on all records whose added damping
        was not removed: the values are H at i omega + decay, not at i omega. Comparisons evaluate
        the model there.
    base : iterable of str or Dof, optional
        Of a transmissibility under base excitation: DOFs of the model that move together as the
        rigid base, the reference among them. A sign reverses the motion of a DOF.
    force : str or Dof, optional
        Of a transmissibility between two sensors: DOF of the model where the only force acts, of
        unknown size.
    level : float or array_like of float, shape (n_f,), optional
        Amplitude of the force of each reference, in N (N m), above 0: of all lines, or of each
        line; kept with the shape (n_f,). Of a stepped or swept sine, whose response depends on it
        if the structure is not linear. None if it is not stated.
    sweep : {"up", "down"}, optional
        Direction in which the frequency of a stated level changed, which selects one of several
        steady responses.
    excitation : {"sine", "random"}, optional
        Force of a stated level: a sine of this amplitude (the default), or a random force of this
        RMS.
    spectrum : array_like of float, shape (n_s, 2), optional
        Of a random force: frequencies in Hz, and the one-sided power spectral density of the force
        in N^2/Hz ((N m)^2/Hz) there, linear in between and zero outside. It gives the level. By
        default it is constant from the first line to the last. Selections of lines keep it.

    Raises
    ------
    DataError
        If there is no line, response or reference, shapes disagree, a number is not finite, is
        complex instead of real, or is masked, or lines are not ascending; the message says where.
    DofError
        If a label cannot be read or occurs twice.

    Examples
    --------
    >>> import numpy as np
    >>> lines = np.array([10.0, 20.0])
    >>> frf = updyn.FRF(lines, np.ones((2, 1, 1)), ["1:Z"], ["1:Z"], "accelerance")
    >>> frf.band(15, 25).freq
    array([20.])
    """

    freq: RealArray
    values: ComplexArray
    responses: DofSet
    references: DofSet
    quantity: str
    coherence: RealArray | None
    variance: RealArray | None
    averages: int | None
    geometry: Geometry | None
    source: str
    decay: float
    base: DofSet | None
    force: Dof | None
    level: RealArray | None
    sweep: str | None
    excitation: str | None
    spectrum: RealArray | None

    def __init__(
        self,
        freq: ArrayLike,
        values: ArrayLike,
        responses: Iterable[str | Dof],
        references: Iterable[str | Dof],
        quantity: str,
        coherence: ArrayLike | None = None,
        variance: ArrayLike | None = None,
        averages: int | None = None,
        geometry: Geometry | None = None,
        source: str = "",
        decay: float = 0.0,
        base: Iterable[str | Dof] | None = None,
        force: str | Dof | None = None,
        level: ArrayLike | None = None,
        sweep: str | None = None,
        excitation: str | None = None,
        spectrum: ArrayLike | None = None,
    ) -> None:
        set_ = partial(object.__setattr__, self)
        set_("quantity", check_quantity(quantity))
        set_("responses", DofSet(responses))
        set_("references", DofSet(references))
        for what in ("responses", "references"):
            if not len(getattr(self, what)):
                raise DataError(f"{what}: expected at least one DOF, found none")
        set_("freq", check_lines(freq))
        shape = (len(self.freq), len(self.responses), len(self.references))
        set_("values", self._array("values", values, np.complex128, shape))
        set_("coherence", self._check_range("coherence", coherence, 1.0, shape))
        set_("variance", self._check_range("variance", variance, np.inf, shape))
        whole = isinstance(averages, int | np.integer) and not isinstance(averages, bool)
        if averages is not None and not (whole and averages >= 1):
            raise DataError(f"averages {averages!r}: expected a whole number of at least 1")
        if averages is not None:
            averages = int(averages)
        set_("averages", averages)
        if geometry is not None and not isinstance(geometry, Geometry):
            raise DataError(f"geometry: expected a Geometry, found {type(geometry).__name__}")
        set_("geometry", geometry)
        set_("source", source)
        set_("decay", check_decay(decay))
        set_("base", None if base is None else _check_base(base))
        set_("force", None if force is None else _check_force(force))
        self._check_excitation()
        spectrum = None if spectrum is None else check_spectrum(spectrum)
        if spectrum is not None and level is None:
            level = find_rms(spectrum)
        set_("level", None if level is None else self._check_level(level))
        set_("sweep", None if sweep is None else self._check_sweep(sweep))
        set_("excitation", None if excitation is None else self._check_kind(excitation))
        set_("spectrum", self._find_spectrum(spectrum))

    def _check_level(self, level: ArrayLike) -> RealArray:
        """Return the force amplitude of each line, shape (n_f,)."""
        with key_path("level"):
            if self.quantity == TRANSMISSIBILITY:
                raise DataError(
                    "level: the amplitude of a force, but the data are a transmissibility"
                )
            given = _numbers("level", level, np.float64)
            if given.shape not in ((), self.freq.shape):
                raise DataError(
                    f"level: expected one number, or one for each of {len(self.freq)} lines, found"
                    f" shape {given.shape}"
                )
            array = np.broadcast_to(given, self.freq.shape).copy()
            wrong = ~(np.isfinite(array) & (array > 0.0))
            if wrong.any():
                i = int(np.argmax(wrong))
                raise DataError(
                    f"level at {self.freq[i]:g} Hz is {array[i]:g}; expected a force amplitude"
                    " above 0 in N"
                )
        array.flags.writeable = False
        return array

    def _check_sweep(self, sweep: object) -> str:
        with key_path("sweep"):
            if sweep not in SWEEPS:
                raise DataError(f"sweep {sweep!r}: {suggest(str(sweep), SWEEPS)}")
            if self.level is None:
                raise DataError("sweep: given without a level; state the force amplitude, too")
        return str(sweep)

    def _check_kind(self, excitation: object) -> str:
        with key_path("excitation"):
            if excitation not in EXCITATIONS:
                raise DataError(
                    f"excitation {excitation!r}: {suggest(str(excitation), EXCITATIONS)}"
                )
            if self.level is None:
                raise DataError("excitation: given without a level; state the force, too")
            if excitation == "random" and self.sweep is not None:
                raise DataError("sweep: of a sine, but the excitation is random")
        return str(excitation)

    def _find_spectrum(self, given: RealArray | None) -> RealArray | None:
        """Return the spectrum of a random force; raise DataError if the level is another one."""
        if not self.is_random or self.level is None:
            if given is not None:
                raise DataError(
                    'spectrum: only of a random force; expected excitation="random"',
                    key=("spectrum",),
                )
            return None
        if given is None:
            if len(self.freq) < 2:
                raise DataError(
                    "excitation: a random force has a band, but the data have one line; state its"
                    " spectrum",
                    key=("excitation",),
                )
            band = float(self.freq[0]), float(self.freq[-1])
            given = make_flat_spectrum(band, float(self.level[0]))
        check_rms(given, self.level)
        given.flags.writeable = False
        return given

    def _check_excitation(self) -> None:
        """Refuse a base or a force that the quantity does not have, and both at once."""
        for name in ("base", "force"):
            if getattr(self, name) is not None and self.quantity != TRANSMISSIBILITY:
                raise DataError(
                    f"{name}: only for the quantity {TRANSMISSIBILITY!r}; the data are"
                    f" {self.quantity}, whose forces are its references",
                    key=(name,),
                )
        if self.base is not None and self.force is not None:
            raise DataError(
                "base and force: expected one of them; the structure is excited by its base, or by"
                " a force",
                key=("force",),
            )

    def _check_range(
        self, name: str, given: ArrayLike | None, high: float, shape: tuple[int, ...]
    ) -> RealArray | None:
        if given is None:
            return None
        array = self._array(name, given, np.float64, shape)
        if name == "coherence" and (array > 1.0).any():
            array = np.where((array > 1.0) & (array <= 1.0 + ROUNDING.coherence_excess), 1.0, array)
            array.flags.writeable = False
        outside = (array < 0.0) | (array > high)
        if outside.any():
            at = np.argwhere(outside)[0]
            raise DataError(
                f"{name} {self._place_text(at)} is {array[tuple(at)]:g}; expected 0 to {high:g}"
            )
        return array

    def _place_text(self, at: Sequence[int] | NumberArray) -> str:
        line, row, column = map(int, at)
        return (
            f"at {self.freq[line]:g} Hz, response {self.responses[row]}, reference"
            f" {self.references[column]}"
        )

    def _array(
        self, name: str, given: ArrayLike, dtype: type, shape: tuple[int, ...]
    ) -> NumberArray:
        array = _numbers(name, given, dtype)
        if array.shape != shape:
            raise DataError(
                f"{name}: expected shape (lines, responses, references) = {shape}, found"
                f" {array.shape}"
            )
        if not np.isfinite(array).all():
            gap = ""
            if name == "values" and np.isnan(array).any():
                gap = f"; {_GAPS}"
            raise DataError(
                f"{name} {self._place_text(np.argwhere(~np.isfinite(array))[0])} is not finite{gap}"
            )
        array.flags.writeable = False
        return array

    def __repr__(self) -> str:
        return (
            f"FRF({self.quantity}, {len(self.freq)} lines {self.freq[0]:g}-{self.freq[-1]:g} Hz, "
            f"{len(self.responses)} responses x {len(self.references)} references"
            + (f", window exp(-{self.decay:g} t)" if self.decay else "")
            + (f", {self.level_text}" if self.level is not None else "")
            + ")"
        )

    def _repr_html_(self) -> str:
        size = np.abs(self.values).reshape(len(self.freq), -1)
        pairs = [(i, j) for i in self.responses.labels for j in self.references.labels]
        shown = [PlotCurve(f"{i} / {j}", size[:, k]) for k, (i, j) in enumerate(pairs)]
        if len(pairs) > NOTEBOOK.most_channels:
            rms = np.sqrt(np.mean(size**2, axis=1))
            shown = [PlotCurve(f"rms of {len(pairs)} channels", rms)]
        units = ", ".join(dict.fromkeys(unit(self.quantity, i, j) for i, j in pairs))
        title = f"{self.quantity} ({units})"
        if len(shown) == 1:
            title += f": {shown[0].name}"
        over = _format_labels(self.references)
        facts = {
            "lines": f"{len(self.freq)} from {self.freq[0]:g} to {self.freq[-1]:g} Hz",
            "responses": _format_labels(self.responses),
            "over" if self.quantity == TRANSMISSIBILITY else "forces": over,
            "base": "" if self.base is None else _format_labels(self.base),
            "force": "" if self.force is None else str(self.force),
            "coherence": "" if self.coherence is None else "known",
            "variance": "" if self.variance is None else "known",
            "window": f"exp(-{self.decay:g} t)" if self.decay else "",
            "level": self.level_text,
            "source": self.source,
        }
        picture = curves(self.freq, shown, ("frequency (Hz)", title))
        return card(f"FRF, {self.quantity}", facts, picture)

    def __reduce__(self) -> tuple[object, ...]:
        return FRF, tuple(getattr(self, f.name) for f in fields(self))  # makes arrays read-only

    @property
    def level_text(self) -> str:
        """Level and kind of the force as text; empty if no level is stated."""
        if self.level is None:
            return ""
        units = {"N m" if "R" in label else "N" for label in self.references.labels}
        low, high = (f"{limit:.6g}" for limit in (self.level.min(), self.level.max()))
        size = low if low == high else f"{low} to {high}"
        kind = " random" if self.is_random else f" {self.sweep}" if self.sweep else ""
        return f"level {size} {' or '.join(sorted(units))}{kind}"

    @property
    def is_random(self) -> bool:
        """Whether the level is the RMS of a random force."""
        return self.excitation == "random"

    # -- conversion ----------------------------------------------------------------------------
    @property
    def power(self) -> int:
        """Power of s relative to receptance; 0 for a transmissibility, a ratio of receptances."""
        return QUANTITIES.get(self.quantity, 0)

    @property
    def modal_power(self) -> int:
        """Power of s in the contribution of a mode, s^power / (s^2 - pole^2).

        2 for a transmissibility, as for an accelerance: relative to the motion of a base, a mode is
        excited by the inertia forces of the base acceleration.
        """
        return QUANTITIES.get(self.quantity, QUANTITIES["accelerance"])

    @property
    def s(self) -> ComplexArray:
        """Laplace variable s = i omega + decay of the values, in 1/s, shape (n_f,)."""
        return np.asarray(2j * np.pi * self.freq + self.decay)

    def converted(self, quantity: str) -> FRF:
        """Return the measurement converted to another quantity.

        Mobility is i omega times receptance, accelerance -omega^2 times (Ewins, Modal Testing, 2nd
        ed. 2000, section 2.3); with a `decay`, i omega + decay replaces i omega.

        Parameters
        ----------
        quantity : {"receptance", "mobility", "accelerance"}
            The target quantity; the variance is converted, too. A transmissibility is not
            converted: its force was not measured.

        Returns
        -------
        FRF
            The converted data; the same object if the quantity is unchanged.

        Raises
        ------
        DataError
            If the quantity is unknown, there is a 0 Hz line, which cannot be converted, or one of
            the two quantities is a transmissibility.
        """
        if check_quantity(quantity) == self.quantity:
            return self
        if TRANSMISSIBILITY in (quantity, self.quantity):
            raise DataError(
                f"{self.quantity} cannot be converted to {quantity}: a transmissibility is a motion"
                " over a motion, and its force is not known"
            )
        power = QUANTITIES[quantity] - QUANTITIES[self.quantity]
        if self.s[0] == 0.0:
            positive = "a positive frequency"
            if len(self.freq) > 1:
                positive = f"{self.freq[1]} Hz"
            raise DataError(
                f"the 0 Hz line cannot be converted from {self.quantity} to {quantity}; drop it"
                f" first, for instance with a band that starts at {positive}"
            )
        factor = (self.s**power)[:, None, None]
        variance = self.variance
        if variance is not None:
            variance = variance * np.abs(factor) ** 2
        return replace(self, values=self.values * factor, variance=variance, quantity=quantity)

    def with_excitation(
        self, base: Iterable[str | Dof] | None = None, force: str | Dof | None = None
    ) -> FRF:
        """Return a transmissibility with its excitation in the model.

        Parameters
        ----------
        base : iterable of str or Dof, optional
            DOFs of the model that move together as the rigid base, the reference among them.
        force : str or Dof, optional
            DOF of the model where the only force acts.

        Returns
        -------
        FRF
            The same values.

        Raises
        ------
        DataError
            If the values are no transmissibility, or both are given.
        DofError
            If a label cannot be read or occurs twice.

        Examples
        --------
        >>> frf = updyn.FRF([5.0], [[[1.2]]], ["4:Z"], ["1:Z"], "transmissibility")
        >>> frf.with_excitation(base=["1:Z", "2:Z"]).base.labels
        ['1:Z', '2:Z']
        """
        more: dict[str, Any] = {"base": base, "force": force}
        return replace(self, **more)

    def with_level(
        self,
        level: ArrayLike | None,
        sweep: str | None = None,
        excitation: str | None = None,
        spectrum: ArrayLike | None = None,
    ) -> FRF:
        """Return the same values with another statement of their level.

        Parameters
        ----------
        level : float or array_like of float, shape (n_f,), or None
            Force amplitude in N (N m), of all lines or of each line; of a random force the RMS, or
            None if the spectrum gives it.
        sweep : {"up", "down"}, optional
            Direction in which the frequency changed.
        excitation : {"sine", "random"}, optional
            Kind of the force; by default a sine.
        spectrum : array_like of float, shape (n_s, 2), optional
            Of a random force: frequencies in Hz and densities in N^2/Hz; by default constant from
            the first line to the last.

        Returns
        -------
        FRF
            The same values.

        Raises
        ------
        DataError
            If a level is not above 0, the number of levels is not that of the lines, the spectrum
            has another level or is not that of a random force, or the values are a
            transmissibility.

        Examples
        --------
        >>> frf = updyn.FRF([5.0, 6.0], [[[1.2]], [[1.1]]], ["4:Z"], ["1:Z"], "accelerance")
        >>> frf.with_level(20.0, "up").level
        array([20., 20.])
        """
        more: dict[str, Any] = {"level": level, "spectrum": spectrum}
        return replace(self, sweep=sweep, excitation=excitation, **more)

    # -- selection -----------------------------------------------------------------------------
    def select(
        self,
        *,
        band: tuple[float, float] | None = None,
        exclude: Iterable[tuple[float, float]] = (),
        lines: ArrayLike | None = None,
        responses: Iterable[str | Dof] | None = None,
        references: Iterable[str | Dof] | None = None,
    ) -> FRF:
        """Return a part of the data; a selection that is not in the data is an error.

        Parameters
        ----------
        band : (float, float), optional
            Lowest and highest line to keep, in Hz, both included.
        exclude : iterable of (float, float)
            Bands in Hz, both ends included, whose lines are excluded.
        lines : array_like of float, optional
            Lines to keep, in Hz; each must be a line of the data (to 1e-9 relative). Nothing is
            interpolated.
        responses, references : iterable of str or Dof, optional
            DOFs to keep, in the order given. With the opposite sign the values change sign.

        Returns
        -------
        FRF
            The part, lines ascending.

        Raises
        ------
        DataError
            If the selection is empty, a band is not two numbers or has no line, or a line is not
            in the data (the message names the nearest).
        DofError
            If a DOF is not in the data.
        """
        keep = np.arange(len(self.freq))
        unused = "is excluded"
        if band is not None:
            with key_path("band"):
                low, high = check_band(band)
            unused = f"lies outside the band {low:g} to {high:g} Hz"
            keep = np.flatnonzero((self.freq >= low) & (self.freq <= high))
            if keep.size == 0:
                raise DataError(
                    f"band {low:g} to {high:g} Hz holds no line; the data run {self.freq[0]:g} to"
                    f" {self.freq[-1]:g} Hz",
                    key=("band",),
                )
        left_out = list(exclude)
        for each in left_out:
            with key_path("exclude"):
                keep = self._lines_outside(keep, each)
        if left_out and band is not None:
            unused += ", or is excluded"
        if lines is not None:
            chosen = self.find_lines(lines)
            outside = np.setdiff1d(chosen, keep)
            if outside.size:
                raise DataError(
                    f"line {self.freq[outside[0]]:g} Hz {unused}{in_all(outside.size)}",
                    key=("band",),
                )
            keep = chosen
        chosen_rows = self.responses
        if responses is not None:
            chosen_rows = DofSet(responses)
        chosen_columns = self.references
        if references is not None:
            chosen_columns = DofSet(references)
        with key_path("responses"):
            rows = self.responses.match(chosen_rows, "response")
        with key_path("references"):
            columns = self.references.match(chosen_columns, "reference")
        sign = rows.sign[:, None] * columns.sign[None, :]
        at = np.ix_(keep, rows.index, columns.index)
        parts = {}
        for name in ("coherence", "variance"):
            whole = getattr(self, name)
            if whole is not None:
                parts[name] = whole[at]
        if self.level is not None:
            parts["level"] = self.level[keep]
        return replace(
            self,
            freq=self.freq[keep],
            values=self.values[at] * sign,
            responses=chosen_rows,
            references=chosen_columns,
            **parts,
        )

    def __getitem__(self, channels: object) -> FRF:
        """Return channels by label: ``frf[responses]`` or ``frf[responses, references]``.

        Each of the two is a label (``"3:Z"``; with the opposite sign the values change sign), a
        pattern (``"3:*"``, ``"*:Z"``; it matches sensors of either sign and keeps their signs), a
        list of labels and patterns, or ``:`` for all. Use `band` or `select` to choose lines.

        Parameters
        ----------
        channels : str, Dof, iterable of them, slice, or a pair of these
            The selected channels.

        Returns
        -------
        FRF
            The part, in the order given.

        Raises
        ------
        DofError
            If a label or a pattern matches nothing, or another type is given.
        """
        if not isinstance(channels, tuple):
            channels = (channels, slice(None))
        if len(channels) != 2:
            raise DofError(
                f"frf[...]: {len(channels)} entries; expected responses, or responses and"
                " references. Put a list of labels in brackets: frf[[...], ...]"
            )
        return self.select(
            responses=_select_dofs(channels[0], self.responses, "response"),
            references=_select_dofs(channels[1], self.references, "reference"),
        )

    __iter__ = None  # not a sequence: indexed by labels, not by positions

    def band(self, low: float, high: float) -> FRF:
        """Return the lines of a band; see `select` for other selections.

        Parameters
        ----------
        low, high : float
            Lowest and highest line to keep, in Hz, both included.

        Returns
        -------
        FRF
            The part.

        Raises
        ------
        DataError
            If no line is left, or the band is not two ascending numbers.
        """
        return self.select(band=(low, high))

    def _lines_outside(self, keep: IndexArray, band: tuple[float, float]) -> IndexArray:
        """Return the positions of lines without those in a band."""
        low, high = check_band(band)
        rest = keep[(self.freq[keep] < low) | (self.freq[keep] > high)]
        if rest.size == keep.size:
            nearest = self.freq[keep][np.argmin(np.abs(self.freq[keep] - 0.5 * (low + high)))]
            raise DataError(
                f"exclude: {low:g} to {high:g} Hz holds no line that is used; the nearest is at"
                f" {nearest:.9g} Hz"
            )
        if rest.size == 0:
            raise DataError(f"exclude: without {low:g} to {high:g} Hz no line remains")
        return rest

    def find_lines(self, lines: ArrayLike) -> IndexArray:
        """Return the positions of `lines` in the data, ascending.

        Parameters
        ----------
        lines : array_like of float, shape (k,)
            Lines in Hz, in any order.

        Returns
        -------
        ndarray of int, shape (k,)
            Positions in `freq`.

        Raises
        ------
        DataError
            If a line is not in the data (to 1e-9 relative), or occurs twice.
        """
        wanted = np.sort(np.atleast_1d(_numbers("lines", lines, np.float64)))
        if wanted.ndim != 1 or wanted.size == 0 or not np.isfinite(wanted).all():
            raise DataError("lines: expected at least one finite frequency in Hz, in one dimension")
        right = np.clip(np.searchsorted(self.freq, wanted), 1, max(len(self.freq) - 1, 1))
        left = right - 1
        right = np.minimum(right, len(self.freq) - 1)
        at = np.where(
            np.abs(self.freq[left] - wanted) <= np.abs(self.freq[right] - wanted), left, right
        )
        off = np.abs(self.freq[at] - wanted) > 1e-9 * np.maximum(np.abs(wanted), 1e-300)
        if off.any():
            i = int(np.flatnonzero(off)[0])
            raise DataError(
                f"line {wanted[i]:.9g} Hz is not in the data ({int(off.sum())} such); nearest:"
                f" {self.freq[left[i]]:.9g} and {self.freq[right[i]]:.9g} Hz. Lines are not"
                " interpolated"
            )
        if (np.diff(at) == 0).any():
            raise DataError(f"line {self.freq[at[:-1][np.diff(at) == 0][0]]:g} Hz is named twice")
        return at

    # -- xarray --------------------------------------------------------------------------------
    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset` over ``freq`` (Hz), ``response`` and ``reference`` (labels).

        Returns
        -------
        xarray.Dataset
            Variables ``frf`` and, if present, ``coherence``, ``variance`` and the geometry:
            ``xyz`` in m by ``node``, ``trace`` (lines to draw), ``face`` (faces to draw),
            ``node_axes`` (displacement directions); and ``level`` (N) by line.
        """
        import xarray as xr

        data: dict[str, tuple[tuple[str, ...], NumberArray]] = {"frf": (_DIMS, self.values)}
        for name in ("coherence", "variance"):
            if getattr(self, name) is not None:
                data[name] = (_DIMS, getattr(self, name))
        attrs: dict[str, object] = {"quantity": self.quantity, "source": self.source}
        if self.averages is not None:
            attrs["averages"] = self.averages
        if self.decay:
            attrs["decay"] = self.decay
        if self.base is not None:
            attrs["base"] = " ".join(self.base.labels)
        if self.force is not None:
            attrs["force"] = str(self.force)
        if self.sweep is not None:
            attrs["sweep"] = self.sweep
        if self.excitation is not None:
            attrs["excitation"] = self.excitation
        if self.level is not None:
            data["level"] = (_DIMS[:1], self.level)
        if self.spectrum is not None:
            data["spectrum"] = (("spectrum_point", "spectrum_column"), self.spectrum)
        coords = {
            "freq": self.freq,
            "response": self.responses.labels,
            "reference": self.references.labels,
        }
        out = xr.Dataset(data, coords=coords, attrs=attrs)
        out["freq"].attrs["units"] = "Hz"
        if self.level is not None:
            out["level"].attrs["units"] = "N"
        if self.spectrum is not None:
            out["spectrum"].attrs["units"] = "Hz, N^2/Hz"
        if self.geometry is not None:
            out["node"] = ("node", self.geometry.nodes)
            out["xyz"] = (("node", "axis"), self.geometry.xyz, {"units": "m"})
            if len(self.geometry.lines):
                out["trace"] = (("trace_line", "end"), self.geometry.lines)
            if self.geometry.axes is not None:
                out["node_axes"] = (("node", "direction", "axis"), self.geometry.axes)
            if len(self.geometry.faces):
                out["face"] = (("face_number", "corner"), self.geometry.faces)
        return out

    def to_pandas(self, part: str = "values") -> pd.DataFrame:
        """Return a table with one row per line and one column per channel.

        Parameters
        ----------
        part : {"values", "coherence", "variance"}
            Values of the table.

        Returns
        -------
        pandas.DataFrame
            Index: lines in Hz (``freq``); columns: labels of ``response`` and ``reference``. The
            quantity and the source are in its ``attrs``.

        Raises
        ------
        DataError
            If the data have no such part.
        """
        import pandas as pd

        parts = ("values", "coherence", "variance")
        if part not in parts:
            raise DataError(f"part {part!r}: {suggest(str(part), parts)}")
        array = getattr(self, part)
        if array is None:
            raise DataError(f"part {part!r}: the data have no {part}")
        columns = pd.MultiIndex.from_product(
            [self.responses.labels, self.references.labels], names=["response", "reference"]
        )
        rows = pd.Index(self.freq, name="freq")
        out = pd.DataFrame(array.reshape(len(self.freq), -1), index=rows, columns=columns)
        out.attrs = {"quantity": self.quantity, "source": self.source}
        if self.decay:
            out.attrs["decay"] = self.decay
        return out

    @classmethod
    def from_xarray(cls, data: xr.Dataset, *, quantity: str | None = None) -> FRF:
        """Build from a dataset in the form of `to_xarray`.

        Parameters
        ----------
        data : xarray.Dataset
            Variable ``frf`` over the dimensions ``freq`` (Hz), ``response`` and ``reference``
            (labels), in any order.
        quantity : str, optional
            The measured quantity, if the dataset does not give it.

        Returns
        -------
        FRF
            The same data.

        Raises
        ------
        DataError
            If a variable, a dimension or the quantity is missing, `quantity` contradicts the
            dataset, or a variable has an attribute ``units`` that is not SI.
        """
        for name in ("frf", *_DIMS):
            if name not in data.variables:
                raise DataError(
                    f"dataset: no variable {name!r}; {suggest(name, map(str, data.variables))}"
                )
        if quantity is not None:  # an invalid quantity is reported as such
            check_quantity(quantity)
        quantity_label = data.attrs.get("quantity", _find_quantity(data))
        if quantity_label is None and quantity is None:
            raise DataError(
                "the dataset does not say what it measured: give quantity='receptance', 'mobility',"
                " 'accelerance' or 'transmissibility'"
            )
        if quantity_label is not None and quantity is not None and quantity_label != quantity:
            raise DataError(
                f"quantity {quantity!r} contradicts the dataset, which states {quantity_label!r}"
            )
        _check_units(data, str(quantity_label or quantity))
        arrays: dict[str, Any] = {}
        for name in ("frf", "coherence", "variance"):
            if name in data.variables:
                if set(data[name].dims) != set(_DIMS):
                    raise DataError(
                        f"dataset: {name!r} has dimensions {data[name].dims}; expected {_DIMS}"
                    )
                arrays[name] = data[name].transpose(*_DIMS).values
        averages = _attribute(data, "averages")
        if isinstance(averages, float) and averages.is_integer():
            averages = int(averages)
        return cls(
            freq=data["freq"].values,
            values=arrays.pop("frf"),
            responses=map(str, data["response"].values),
            references=map(str, data["reference"].values),
            quantity=str(quantity_label or quantity),
            averages=averages,
            geometry=_geometry(data),
            source=str(data.attrs.get("source", "")),
            decay=_attribute(data, "decay", 0.0),
            base=str(data.attrs["base"]).split() if "base" in data.attrs else None,
            force=str(data.attrs["force"]) if "force" in data.attrs else None,
            level=_level(data),
            sweep=str(data.attrs["sweep"]) if "sweep" in data.attrs else None,
            excitation=str(data.attrs["excitation"]) if "excitation" in data.attrs else None,
            spectrum=data["spectrum"].values if "spectrum" in data.variables else None,
            **arrays,
        )


def _check_base(base: object) -> DofSet:
    with key_path("base"):
        if isinstance(base, str | Dof) or not isinstance(base, Iterable):
            raise DataError(f'base {base!r}: expected a list of DOFs, such as ["0:Z"]')
        dofs = DofSet(base)
        if not len(dofs):
            raise DataError("base: expected at least one DOF, found none")
        return dofs


def _check_force(force: object) -> Dof:
    with key_path("force"):
        if not isinstance(force, str | Dof):
            raise DataError(f'force {force!r}: expected one DOF, such as "12:Z"')
        return DofSet([force])[0]


def _format_labels(dofs: DofSet) -> str:
    """Return the labels as text; for many labels, the first ones and their number."""
    text = ", ".join(dofs[: NOTEBOOK.most_channels].labels)
    return text if len(dofs) <= NOTEBOOK.most_channels else f"{text}, ... ({len(dofs)} in all)"


def _select_dofs(given: object, existing: DofSet, what: str) -> list[str | Dof] | None:
    """Return the DOFs that match labels and patterns; None for all."""
    if isinstance(given, slice):
        if given != slice(None):
            raise DofError(f"{what}s: expected labels or ':' for all, found the slice {given}")
        return None
    items = [given] if isinstance(given, str | Dof) else given
    if not isinstance(items, Iterable):
        raise DofError(
            f"{what}s: expected a label such as {str(existing[0])!r}, a pattern such as '*:Z', a"
            f" list of them or ':', found {given!r}"
        )
    found: dict[str | Dof, None] = {}
    for item in items:
        if not isinstance(item, str | Dof):
            raise DofError(f"{what}s: expected labels or patterns, found {item!r} among them")
        if not isinstance(item, str) or not set("*?[") & set(item):
            found[item] = None
            continue
        hits = [dof for dof in existing if _matches(item, dof)]
        if not hits:
            raise DofError(f"{what}s: no label like {item!r}; {suggest(item, existing.labels)}")
        found |= dict.fromkeys(map(str, hits))
    return list(found)


def _matches(pattern: str, dof: Dof) -> bool:
    """Return whether a pattern matches a DOF, with or without its sign."""
    return fnmatchcase(str(dof), pattern) or fnmatchcase(f"{dof.node}:{dof.direction}", pattern)


def _numbers(name: str, given: ArrayLike, dtype: type) -> NumberArray:
    """Return an array of `dtype`; reject texts, booleans, masks and lost imaginary parts.

    The result is a copy unless the given array is immutable and owns its memory.
    """
    try:
        array = np.asarray(given)
    except ValueError as error:
        raise DataError(f"{name}: not an array of numbers ({error})") from error
    if np.ma.is_masked(given):
        raise DataError(
            f"{name}: holds masked values; leave out their lines, responses or references, or"
            f" {_GAPS}"
        )
    kinds, expected = "iuf", "real"
    if dtype is np.complex128:
        kinds, expected = "iufc", "complex or real"
    if array.dtype.kind not in kinds:
        raise DataError(f"{name}: expected {expected} numbers, found {array.dtype}")
    return array.astype(dtype, copy=array.flags.writeable or array.base is not None)


def _attribute(data: xr.Dataset, name: str, default: object = None) -> Any:
    """Return an attribute of a dataset; files store a number as an array of size one."""
    value = data.attrs.get(name, default)
    single = isinstance(value, np.ndarray | np.generic) and value.size == 1
    return value.item() if single else value


def _find_quantity(data: xr.Dataset) -> str | None:
    """Return the quantity implied by the unit of the values; None if the unit is unknown."""
    found = find_ratio(str(data["frf"].attrs.get("units", "")))
    return found.kind if found else None


def _check_units(data: xr.Dataset, quantity: str) -> None:
    frf = "1" if quantity == TRANSMISSIBILITY else f"m{RATES[check_quantity(quantity)]}/N"
    units: dict[str, tuple[str, Callable[[str], Unit | None]]] = {
        "freq": ("Hz", lambda label: find_unit(label, "frequency")),
        "frf": (frf, find_ratio),
        "coherence": ("1", lambda label: None),
        "variance": (f"({frf})^2", _square),
        "xyz": ("m", lambda label: find_unit(label, "length")),
    }
    for name, (expected, find) in units.items():
        label = _unit_label(data, name)
        if label in ("", expected):
            continue
        found = find(label)
        fault = f"dataset: {name} is in {label!r}"
        if found is not None and found.kind in QUANTITIES and found.kind != quantity:
            raise DataError(f"{fault}, a unit of {found.kind}; expected {expected!r}")
        if found is None or found.factor != 1.0:
            remedy = ""
            if found is not None:
                remedy = f": multiply it by {found.factor:g}, and write {expected!r}"
            raise DataError(f"{fault}; expected {expected!r}{remedy}")


def _unit_label(data: xr.Dataset, name: str) -> str:
    """Return the unit of a variable in the dataset; empty if it has none."""
    return str(data[name].attrs.get("units", "")).strip() if name in data.variables else ""


def _square(label: str) -> Unit | None:
    """Return the unit of a variance, the square of motion per force; None if it is unknown."""
    inner = re.fullmatch(r"\((.+)\)\s*(?:\^2|\*\*2|²)", label)
    found = find_ratio(inner[1]) if inner else None
    return Unit(found.kind, found.factor**2) if found else None


def _level(data: xr.Dataset) -> NumberArray | None:
    """Return the force amplitude of a dataset: a variable over the lines, or an attribute."""
    if "level" in data.variables:
        if data["level"].dims not in ((), _DIMS[:1]):
            raise DataError(
                f"dataset: 'level' has dimensions {data['level'].dims}; expected {_DIMS[:1]}"
            )
        return np.asarray(data["level"].values)
    level = _attribute(data, "level")
    return None if level is None else np.asarray(level)


def _geometry(data: xr.Dataset) -> Geometry | None:
    if "xyz" not in data.variables:
        return None
    if "node" not in data.variables:  # xarray would create the coordinate 0, 1, 2, ...
        raise DataError("dataset: 'xyz' without 'node', the numbers of the nodes")
    more = {}
    for argument, name in (("lines", "trace"), ("axes", "node_axes"), ("faces", "face")):
        if name in data.variables:
            more[argument] = data[name].values
    xyz = data["xyz"].transpose("node", "axis").values
    return Geometry(data["node"].values, xyz, **more)


def check_band(band: object) -> tuple[float, float]:
    """Return the two ascending frequencies of a band in Hz; DataError for anything else."""
    array = _numbers("band", band, np.float64)  # type: ignore[arg-type]
    if array.shape != (2,):
        raise DataError(f"band {band!r}: expected two frequencies in Hz, lowest and highest")
    low, high = map(float, array)
    if not low < high:
        raise DataError(f"band {low:g} to {high:g} Hz: the first must be below the second")
    return low, high


def check_decay(decay: object) -> float:
    """Return the decay of an exponential window in 1/s; DataError if not finite or below 0."""
    real = isinstance(decay, int | float | np.integer | np.floating)
    if isinstance(decay, bool) or not real or not 0.0 <= float(decay) < np.inf:  # type: ignore[arg-type]
        raise DataError(f"decay {decay!r}: expected a number in 1/s, 0 or above")
    return float(decay)  # type: ignore[arg-type]


def check_lines(freq: ArrayLike) -> RealArray:
    """Return lines in Hz as a read-only array; DataError unless finite, >= 0 and ascending."""
    array = _numbers("freq", freq, np.float64)
    if array.ndim != 1 or array.size == 0:
        raise DataError(
            f"freq: expected at least one line in one dimension, found shape {array.shape}"
        )
    if not np.isfinite(array).all():
        raise DataError(
            f"freq: line {int(np.flatnonzero(~np.isfinite(array))[0]) + 1} is not finite"
        )
    if array[0] < 0:
        raise DataError(f"freq: the first line is {array[0]:g} Hz; expected 0 or above")
    down = np.flatnonzero(np.diff(array) <= 0)
    if down.size:
        i = int(down[0])
        raise DataError(
            f"freq: lines must increase; line {i + 2} ({array[i + 1]:g} Hz) does not exceed "
            f"line {i + 1} ({array[i]:g} Hz)"
        )
    array.flags.writeable = False
    return array
