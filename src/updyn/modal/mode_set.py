"""`ModeSet`: measured modes at signed DOFs, with their scale and quality."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import BoolArray, ComplexArray, NumberArray, RealArray
from updyn.dofs import Dof, DofSet, positions
from updyn.errors import DataError
from updyn.frf import check_band
from updyn.modal.settings import FREQUENCY_COVARIANCE
from updyn.modal.stabilisation import Diagram
from updyn.notebook import PlotCurve, card, curves, render_view, table

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

__all__ = ["ModeSet"]


#: Arguments of a set, except the diagram, peaks without a mode and leaning peaks.
_FIELDS = (
    "frequency",
    "shapes",
    "dofs",
    "loss_factor",
    "scaled",
    "quality",
    "source",
    "std_frequency",
    "std_loss_factor",
    "std_shapes",
    "cov_frequency",
)


@dataclass(frozen=True, slots=True, eq=False, init=False)
class ModeSet:
    """Measured modes, immutable, in ascending order of frequency.

    Parameters
    ----------
    frequency : array_like of float, shape (n,)
        Natural frequencies in Hz, at least 0, in any order; the modes are sorted.
    shapes : array_like of complex, shape (N, n), optional
        Mode shapes as columns. If `scaled`, they have unit modal mass (phi^T M phi = 1, transpose,
        not conjugate), in 1/sqrt(kg) for translations; else the scale is arbitrary. None: natural
        frequencies only; the attribute then has the shape (0, n).
    dofs : iterable of str or Dof
        Signed labels of the N rows.
    loss_factor : array_like of float, shape (n,), optional
        Modal loss factor eta, twice the damping ratio. None: not known (nan).
    scaled : bool or array_like of bool, shape (n,)
        Whether each shape has unit modal mass.
    quality : array_like of float, shape (n,), optional
        Share, 0 to 1, of the residual of all other modes within the half-power band that the mode
        explains. None: not known (nan).
    source : str
        Origin of the modes, for the record.
    std_frequency : array_like of float, shape (n,), optional
        Standard deviations of the frequencies, in Hz. None: not known (nan).
    std_loss_factor : array_like of float, shape (n,), optional
        Standard deviations of the loss factors.
    std_shapes : array_like of float, shape (N, n), optional
        Standard deviations of the components of `real_shapes`, in the same unit, at fixed length
        and sign. They exclude errors in phase and scale, which do not change the shape. So
        std_shapes / |shape| are those of the shape of unit length, with |shape| the root of the sum
        of squares of `real_shapes`. A column of nan: not known for this mode. None, or nan
        throughout: not known.
    cov_frequency : array_like of float, shape (n, n), optional
        Covariance of the frequencies in Hz^2, positive definite; nan in the row and the column of a
        mode: not known. `std_frequency` then has the roots of its diagonal. None, or nan
        throughout: the errors of the frequencies are independent.
    diagram : Diagram, optional
        The stabilisation diagram of the identification.
    unexplained : array_like of float, shape (m,)
        Frequencies in Hz of significant peaks of the measurement without a mode.
    lean : array_like of float, shape (n,), optional
        Shift of the frequency in Hz from small motion to the largest motion of the test, for modes
        whose stiffness depends on the level. None, and nan for all other modes: not known.

    Raises
    ------
    DataError
        If there is no mode, array shapes do not agree, a number is masked or not finite (except nan
        for unknown values), a frequency or a standard deviation is negative, a shape is zero, or
        the standard deviations of a shape are known for some of its components only. If
        `cov_frequency` is not symmetric or not positive definite, or contradicts `std_frequency`.
    DofError
        If a label cannot be read or occurs twice.

    Examples
    --------
    >>> import numpy as np
    >>> modes = updyn.ModeSet(np.array([12.0, 31.0]), np.eye(2), ["1:Z", "2:Z"])
    >>> modes.frequency
    array([12., 31.])
    >>> updyn.ModeSet([15.57, 44.70, 70.72]).has_shapes
    False
    """

    frequency: RealArray
    shapes: ComplexArray
    dofs: DofSet
    loss_factor: RealArray
    scaled: BoolArray
    quality: RealArray
    source: str
    std_frequency: RealArray
    std_loss_factor: RealArray
    std_shapes: RealArray | None
    cov_frequency: RealArray | None
    diagram: Diagram | None
    unexplained: RealArray
    lean: RealArray
    digest: str = field(init=False)

    def __init__(
        self,
        frequency: ArrayLike,
        shapes: ArrayLike | None = None,
        dofs: Iterable[str | Dof] = (),
        loss_factor: ArrayLike | None = None,
        scaled: ArrayLike = False,
        quality: ArrayLike | None = None,
        source: str = "",
        *,
        std_frequency: ArrayLike | None = None,
        std_loss_factor: ArrayLike | None = None,
        std_shapes: ArrayLike | None = None,
        cov_frequency: ArrayLike | None = None,
        diagram: Diagram | None = None,
        unexplained: ArrayLike = (),
        lean: ArrayLike | None = None,
    ) -> None:
        labels = DofSet(dofs)
        f = _array("frequency", frequency, np.float64)
        if f.ndim != 1 or f.size == 0:
            raise DataError(
                "modes: expected at least one frequency in a row, found an array of shape"
                f" {f.shape}"
            )
        n = len(f)
        if not (np.isfinite(f).all() and (f >= 0).all()):
            raise DataError(
                f"modes: frequency {f[~(np.isfinite(f) & (f >= 0))][0]:g} Hz; expected finite, at"
                " least 0"
            )
        phi = _array("shapes", np.zeros((0, n)) if shapes is None else shapes, np.complex128)
        if shapes is None and len(labels):
            raise DataError(f"modes: {len(labels)} DOFs and no shapes; leave out both, or neither")
        if phi.shape != (len(labels), n):
            raise DataError(
                f"modes: expected shapes of (DOFs, modes) = {(len(labels), n)}, found {phi.shape}"
            )
        bad = ~np.isfinite(phi).all(axis=0)
        if len(labels):
            bad |= ~phi.any(axis=0)
        if bad.any():
            raise DataError(
                f"modes: the shape at {f[bad][0]:g} Hz is zero or holds a number that is not finite"
            )
        order = np.argsort(f, kind="stable")
        covariance = None if cov_frequency is None else _cov_frequency(cov_frequency, f)
        if covariance is not None:
            std_frequency = _std_of_covariance(covariance, std_frequency, f)
        given = {
            "loss_factor": loss_factor,
            "quality": quality,
            "std_frequency": std_frequency,
            "std_loss_factor": std_loss_factor,
        }
        arrays: dict[str, NumberArray] = {
            "frequency": f[order],
            "shapes": phi[:, order],
            "scaled": _flags("scaled", scaled, n)[order],
        }
        for name, values in given.items():
            arrays[name] = _row(name, np.nan if values is None else values, n)[order]
        std = None if std_shapes is None else _std_shapes(std_shapes, phi.shape, f)
        object.__setattr__(self, "std_shapes", None)
        object.__setattr__(self, "cov_frequency", None)
        if std is not None:
            arrays["std_shapes"] = std[:, order]
        if covariance is not None:
            arrays["cov_frequency"] = covariance[np.ix_(order, order)]
        hashed = blake2b("".join(labels.labels).encode(), digest_size=8)
        for name, array in arrays.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)
            hashed.update(np.ascontiguousarray(array).tobytes())
        object.__setattr__(self, "dofs", labels)
        object.__setattr__(self, "source", source)
        object.__setattr__(self, "diagram", diagram)
        peaks = np.sort(_array("unexplained", unexplained, np.float64).reshape(-1))
        peaks.flags.writeable = False
        object.__setattr__(self, "unexplained", peaks)
        shift = _row("lean", np.nan if lean is None else lean, n)[order]
        shift.flags.writeable = False
        object.__setattr__(self, "lean", shift)
        object.__setattr__(self, "digest", hashed.hexdigest())

    def __len__(self) -> int:
        return len(self.frequency)

    def __repr__(self) -> str:
        shown = [f"{f:.6g}" for f in self.frequency[:6]]
        if len(self) > 6:
            shown.append("...")
        what = f"modes at {len(self.dofs)} DOFs" if self.has_shapes else "natural frequencies"
        return f"ModeSet({len(self)} {what}: {', '.join(shown)} Hz; {self.digest})"

    def _repr_html_(self) -> str:
        columns = (
            ("frequency (Hz)", self.frequency, "{:.6g}"),
            ("std. dev. (Hz)", self.std_frequency, "{:.2g}"),
            ("damping (%)", 100.0 * self.damping, "{:.3g}"),
            ("std. dev. (%)", 100.0 * self.std_damping, "{:.2g}"),
            ("collinearity", self.phase_collinearity, "{:.3f}"),
            ("quality", self.quality, "{:.3f}"),
        )
        known = [column for column in columns if np.isfinite(column[1]).any()]
        rows = []
        for k in range(len(self)):
            values = [(float(values[k]), form) for _, values, form in known]
            cells = [form.format(v) if np.isfinite(v) else "" for v, form in values]
            rows.append([str(k + 1), *cells])
        facts = {"modes": len(self), "DOFs": len(self.dofs), "source": self.source}
        header = ("mode", *(name for name, _, _ in known))
        return card("Modes", facts, render_view(self, self._picture), table(header, rows))

    def _picture(self) -> str:
        """Return a picture of damping over frequency; empty if damping is not known."""
        damping = PlotCurve("damping", 100.0 * self.damping)
        titles = ("frequency (Hz)", "damping (%)")
        return curves(self.frequency, [damping], titles, log_y=False, stems=True)

    def __reduce__(self) -> tuple[object, ...]:
        names = (*_FIELDS, "diagram", "unexplained", "lean")
        return _restore, ({name: getattr(self, name) for name in names},)

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with a row for each mode, without the shapes.

        Returns
        -------
        pandas.DataFrame
            Index: ``mode``, from 1. Columns: ``frequency`` and ``std_frequency`` in Hz;
            ``damping`` and ``std_damping`` as shares of critical damping; ``scaled``, ``quality``
            and ``phase_collinearity``.
        """
        import pandas as pd

        names = ("frequency", "std_frequency", "damping", "std_damping", "scaled", "quality")
        columns = {name: getattr(self, name) for name in (*names, "phase_collinearity")}
        out = pd.DataFrame(columns, index=pd.RangeIndex(1, len(self) + 1, name="mode"))
        out.attrs = {"source": self.source}
        return out

    def to_xarray(self) -> xr.Dataset:
        """Return an `xarray.Dataset` over ``mode`` (from 1) and ``dof`` (labels).

        Returns
        -------
        xarray.Dataset
            Variables ``frequency`` and ``std_frequency`` in Hz, ``loss_factor``,
            ``std_loss_factor``, ``scaled``, ``quality``, ``shapes`` and, if known, ``std_shapes``
            and ``cov_frequency`` in Hz^2, over ``mode`` and ``other_mode``.
        """
        import xarray as xr

        data: dict[str, object] = {"shapes": (("dof", "mode"), self.shapes)}
        if self.std_shapes is not None:
            data["std_shapes"] = (("dof", "mode"), self.std_shapes)
        if self.cov_frequency is not None:
            square = {"units": "Hz^2"}
            data["cov_frequency"] = (("mode", "other_mode"), self.cov_frequency, square)
        for name in ("frequency", "std_frequency"):
            data[name] = ("mode", getattr(self, name), {"units": "Hz"})
        for name in ("loss_factor", "std_loss_factor", "scaled", "quality"):
            data[name] = ("mode", getattr(self, name))
        coords = {"mode": np.arange(1, len(self) + 1), "dof": self.dofs.labels}
        return xr.Dataset(data, coords=coords, attrs={"source": self.source})

    @property
    def has_shapes(self) -> bool:
        """Whether shapes are known; if not, the set has only frequencies and damping."""
        return len(self.dofs) > 0

    @property
    def damping(self) -> RealArray:
        """Damping ratios, half the loss factors; shape (n,)."""
        return self.loss_factor / 2.0

    @property
    def std_damping(self) -> RealArray:
        """Standard deviations of the damping ratios, shape (n,); nan: not known."""
        return self.std_loss_factor / 2.0

    def renamed(self, dofs: Iterable[str | Dof], *, source: str | None = None) -> ModeSet:
        """Return the same modes with other labels of the rows.

        Parameters
        ----------
        dofs : iterable of str or Dof
            One label for each row.
        source : str, optional
            Origin of the modes, including later changes. None: unchanged.

        Returns
        -------
        ModeSet
            The set with these labels.
        """
        given = {name: getattr(self, name) for name in _FIELDS} | {"dofs": dofs}
        if source is not None:
            given["source"] = source
        given |= {"diagram": self.diagram, "unexplained": self.unexplained, "lean": self.lean}
        return ModeSet(**given)

    @property
    def phase_collinearity(self) -> RealArray:
        """Modal phase collinearity, shape (n,): 1 for a shape that is real up to a factor.

        With the eigenvalues a and b of the 2 x 2 matrix of inner products of real and imaginary
        part it is ((a - b) / (a + b))^2 (Pappa, Elliott & Schenk, J. Guidance Control Dyn. 16
        (1993) 852, without the mean removed); nan without shapes.
        """
        if not self.has_shapes:
            return np.full(len(self), np.nan)
        xx = np.sum(self.shapes.real**2, axis=0)
        yy = np.sum(self.shapes.imag**2, axis=0)
        xy = np.sum(self.shapes.real * self.shapes.imag, axis=0)
        return np.asarray(((xx - yy) ** 2 + 4.0 * xy**2) / (xx + yy) ** 2)

    @property
    def real_shapes(self) -> RealArray:
        """Real parts of the shapes after rotation to the most real phase; shape (N, n).

        The largest component is positive.
        """
        if not self.has_shapes:
            return np.zeros(self.shapes.shape)
        turn = np.exp(-0.5j * np.angle(np.sum(self.shapes**2, axis=0)))
        real = (self.shapes * turn).real
        largest = real[np.argmax(np.abs(real), axis=0), np.arange(len(self))]
        return np.asarray(real * np.where(largest < 0, -1.0, 1.0))

    def select(
        self, modes: ArrayLike | None = None, *, band: tuple[float, float] | None = None
    ) -> ModeSet:
        """Return some of the modes.

        Parameters
        ----------
        modes : array_like of int or bool, optional
            Numbers from 0 in ascending order of frequency, each once; or a flag for each mode.
        band : (float, float), optional
            Band in Hz, including both limits.

        Returns
        -------
        ModeSet
            The selected modes.

        Raises
        ------
        DataError
            If no mode is selected, a number does not exist or occurs twice, or `modes` has another
            type.
        """
        keep = np.arange(len(self))
        if modes is not None:
            keep = positions(modes, len(self), "modes", DataError)
        if band is not None:
            low, high = check_band(band)
            keep = keep[(self.frequency[keep] >= low) & (self.frequency[keep] <= high)]
        if not keep.size:
            raise DataError(f"modes: the selection contains no mode of {self!r}")
        parts = (self.loss_factor[keep], self.scaled[keep], self.quality[keep])
        covariance = None
        if self.cov_frequency is not None:
            covariance = self.cov_frequency[np.ix_(keep, keep)]
        return ModeSet(
            self.frequency[keep],
            self.shapes[:, keep],
            self.dofs,
            *parts,
            source=self.source,
            std_frequency=self.std_frequency[keep],
            std_loss_factor=self.std_loss_factor[keep],
            std_shapes=None if self.std_shapes is None else self.std_shapes[:, keep],
            cov_frequency=covariance,
            diagram=self.diagram,
            unexplained=self.unexplained,
            lean=self.lean[keep],
        )


def _restore(given: dict[str, Any]) -> ModeSet:
    return ModeSet(**given)


def _array(name: str, given: ArrayLike, dtype: type) -> NumberArray:
    if np.ma.is_masked(given):
        raise DataError(f"modes: {name}: holds masked values; leave out their modes or DOFs")
    try:
        array = np.asarray(given)
    except ValueError as error:
        raise DataError(f"modes: {name}: expected numbers ({error})") from error
    if array.dtype.kind not in ("iufc" if dtype is np.complex128 else "iuf"):
        raise DataError(f"modes: {name}: expected numbers, found {array.dtype}")
    return array.astype(dtype)


def _std_shapes(given: ArrayLike, shape: tuple[int, ...], f: RealArray) -> RealArray | None:
    """Return standard deviations of shapes; None if all are unknown."""
    std = _array("std_shapes", given, np.float64)
    if std.shape != shape:
        raise DataError(f"modes: expected std_shapes as shapes, {shape}, found {std.shape}")
    unknown = np.isnan(std)
    bad = ~unknown.all(axis=0) & ~(np.isfinite(std) & (std >= 0)).all(axis=0)
    if bad.any():
        raise DataError(
            f"modes: std_shapes at {f[bad][0]:g} Hz: expected finite numbers of at least 0, or nan"
            " in the whole column"
        )
    return None if unknown.all() else std


def _cov_frequency(given: ArrayLike, f: RealArray) -> RealArray | None:
    """Return the covariance of the frequencies; None if it is unknown throughout."""
    covariance = _array("cov_frequency", given, np.float64)
    n = len(f)
    if covariance.shape != (n, n):
        raise DataError(f"modes: cov_frequency: expected shape {(n, n)}, found {covariance.shape}")
    unknown = np.isnan(np.diag(covariance))
    partly = np.isnan(covariance) != (unknown[:, None] | unknown)
    if partly.any():
        i, j = np.argwhere(partly)[0]
        raise DataError(
            f"modes: cov_frequency of {f[i]:g} and {f[j]:g} Hz is {covariance[i, j]:g}; expected"
            " nan in the whole row and column of a mode, or nowhere in them"
        )
    if unknown.all():
        return None
    known = covariance[np.ix_(~unknown, ~unknown)]
    variance = np.diag(known)
    bad = ~(np.isfinite(variance) & (variance > 0.0))
    if bad.any():
        raise DataError(
            f"modes: cov_frequency: variance {variance[bad][0]:g} at {f[~unknown][bad][0]:g} Hz;"
            " expected a finite number above 0"
        )
    correlation = known / np.sqrt(variance[:, None] * variance)
    most = FREQUENCY_COVARIANCE.asymmetry
    if not np.allclose(correlation, correlation.T, rtol=0.0, atol=most):
        raise DataError("modes: cov_frequency: expected a symmetric matrix")
    least = float(np.linalg.eigvalsh(correlation).min())
    if not least > len(correlation) * np.finfo(float).eps:
        raise DataError(
            "modes: cov_frequency: expected a positive definite matrix; the least eigenvalue of its"
            f" correlation matrix is {least:.2g}; shrink the terms outside its diagonal"
        )
    return np.asarray(0.5 * (covariance + covariance.T))


def _std_of_covariance(covariance: RealArray, given: ArrayLike | None, f: RealArray) -> RealArray:
    """Return the roots of the diagonal of a covariance; refuse other given deviations."""
    std = np.sqrt(np.diag(covariance))
    if given is not None:
        stated = _row("std_frequency", given, len(f))
        close = FREQUENCY_COVARIANCE.std_difference
        differs = ~np.isclose(stated, std, rtol=close, atol=0.0, equal_nan=True)
        if differs.any():
            raise DataError(
                f"modes: std_frequency at {f[differs][0]:g} Hz is {stated[differs][0]:g}, and the"
                f" root of its variance in cov_frequency {std[differs][0]:g}; state one of them"
            )
    return np.asarray(std)


def _row(name: str, given: ArrayLike, n: int) -> RealArray:
    """Return a number for each mode, shape (n,); nan if not known."""
    array = _for_each(name, _array(name, given, np.float64), n)
    least = 0.0 if name.startswith("std_") else -np.inf
    bad = np.isinf(array) | (array < least)
    if bad.any():
        expected = "a finite number" + " of at least 0" * (least == 0.0)
        raise DataError(
            f"modes: {name}: mode {int(np.argmax(bad)) + 1} has {array[bad][0]:g}; expected"
            f" {expected}, or nan where it is not known"
        )
    return array


def _flags(name: str, given: ArrayLike, n: int) -> BoolArray:
    """Return a flag for each mode, shape (n,); 0 and 1 are accepted as flags."""
    array: Any = np.ma.asanyarray(given)
    if array.dtype.kind == "b":
        array = array.astype(np.int8)
    numbers = _array(name, array, np.float64)
    if not np.isin(numbers, (0.0, 1.0)).all():
        raise DataError(f"modes: {name}: expected True or False, found {given!r}")
    return _for_each(name, numbers.astype(np.bool_), n)


def _for_each(name: str, array: NumberArray, n: int) -> NumberArray:
    if array.shape not in ((), (n,)):
        raise DataError(
            f"modes: {name}: expected {n}, one for each mode, found an array of shape {array.shape}"
        )
    return np.broadcast_to(array, (n,)).copy()
