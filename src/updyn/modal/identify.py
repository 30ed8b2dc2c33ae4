"""`identify_modes`: natural frequencies, loss factors and mode shapes from measured FRFs.

1. The FRFs, as accelerances so that peaks of equal damping are equally high, are fitted by rational
   functions with common poles (`updyn.modal.vector_fitting`), twice, on every second line, with
   more and more poles. The number of poles is the one that best predicts the lines left out, which
   does not fit noise.
2. A mode is a stable pole within the band that both halves have found, to within half its
   half-power bandwidth. Indistinguishably close poles of the same shape belong to one mode, whose
   frequency varies from hit to hit: they are merged. A pole that contributes less than a tenth to
   the FRFs at its own frequency is left out.
3. Shapes follow from the residues (Ewins, Modal Testing, 2nd ed. 2000, section 4.5): the residue of
   a mode is its shape at the responses times its shape at the references; a drive point gives the
   scale. Two modes of one frequency show as a residue of rank two.

No library did it: those looked at ask the user to pick poles from a diagram, or may not be used
under this licence.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from updyn.dofs import Dof
from updyn.errors import DataError, OptionError, suggest
from updyn.frf import FRF, QUANTITIES
from updyn.linalg.threads import alone
from updyn.modal.mode_set import ModeSet
from updyn.modal.vector_fitting import Basis, Fitted, fit, growing, predicting

__all__ = [
    "DAMPING",
    "Sides",
    "identify_modes",
]

_Complex = NDArray[np.complex128]
_Real = NDArray[np.float64]

DAMPING = ("structural", "viscous")

#: Most lines on which poles are fitted, half of them at a time.
_LINES = 1200
#: Most combinations of the functions that are fitted.
_FUNCTIONS = 12
#: Both halves agree on a pole to this share of half its half-power bandwidth; poles closer than
#: that share of the bandwidth whose shapes have this MAC are one.
_AGREE, _APART, _ALIKE = 0.5, 0.3, 0.9
#: Poles that differ by less than this share agree: without damping the bandwidth is rounding.
_ROUNDING = 1e-9
#: Loss factors above this are no modes, nor is what adds less than this share at its own frequency.
_HEAVY, _SEEN = 0.5, 0.1
#: Number of poles of the first fit.
_FIRST = 4


@dataclass(frozen=True, slots=True, eq=False)
class _Lines:
    """The variable and the scaled functions of a rational fit."""

    basis: Basis
    unit: float  # omega of |x| = 1, in rad/s
    x: _Complex
    Y: _Complex  # shape (n_f, n_i n_j)
    level: _Real  # shape (n_i, n_j): what the functions were divided by

    def pole(self, omega: _Real, loss: float) -> _Complex:
        """Return poles at circular frequencies, as shares of the unit."""
        if self.basis.mirrored:
            return np.asarray(omega * (1j - 0.5 * loss))
        return np.asarray(omega**2 * (1.0 + 1j * loss))

    def frequency(self, poles: _Complex) -> _Real:
        """Return natural frequencies in Hz; nan of poles that do not oscillate."""
        squared = np.where(poles.real > 0, poles.real, np.nan)
        if self.basis.mirrored:
            squared = np.abs(poles) ** 2
        return np.asarray(np.sqrt(squared) * self.unit / (2.0 * np.pi))

    def loss(self, poles: _Complex) -> _Real:
        """Return loss factors."""
        if self.basis.mirrored:
            return np.asarray(-2.0 * poles.real / np.abs(poles))
        return np.asarray(poles.imag / poles.real)

    def width(self, poles: _Complex) -> _Real:
        """Return the distance of the half-power points from a pole, in the unit of x."""
        if self.basis.mirrored:
            return np.abs(poles.real)
        return np.abs(poles.imag)

    def modal(self, poles: _Complex, residues: _Complex) -> _Complex:
        """Return phi phi^T, shape (k, n_i, n_j), from residues of accelerance (k, n_i n_j)."""
        shape = (len(poles), *self.level.shape)
        # s^2 A / (s - p) has the residue p^2 A, where A = phi phi^T / (2 i omega_d); x A / (x - p)
        # has p A.
        factor = 1.0 / poles
        if self.basis.mirrored:
            factor = 2j * poles.imag / poles**2
        return np.asarray((residues * factor[:, None]).reshape(shape) * self.level)


@alone
def identify_modes(
    frf: FRF,
    *,
    band: tuple[float, float] | None = None,
    damping: str = "structural",
    max_poles: int = 40,
) -> ModeSet:
    """Identify the modes within the band of a measurement.

    Parameters
    ----------
    frf : FRF
        The measurement. Modes that lie closer than a few lines, or have no sensor where they move,
        cannot be found.
    band : (float, float), optional
        In Hz; modes outside of it are fitted but not returned. None: all lines.
    damping : {"structural", "viscous"}
        The form of the modes: residue / (omega_r^2 (1 + i eta_r) - omega^2), or conjugate poles in
        i omega. For light damping the difference is of the order of its square.
    max_poles : int
        Largest number of poles of the rational fit, those included that stand for what lies outside
        the band.

    Returns
    -------
    ModeSet
        At the responses, and at references that are not among them. Scaled to unit modal mass where
        a drive point was measured; ``quality`` is the share of the FRFs within the half-power band
        (at least three lines) that the fit explains.

    Raises
    ------
    DataError
        If there are too few lines, or no mode is found.
    OptionError
        If an option has no valid value.

    Notes
    -----
    Deterministic. Loss factors are those of the form chosen; twice the damping ratio where it is
    viscous.
    """
    if damping not in DAMPING:
        raise OptionError(f"damping {damping!r}: {suggest(str(damping), DAMPING)}")
    if isinstance(max_poles, bool) or not isinstance(max_poles, int) or max_poles < 1:
        raise OptionError(f"max_poles {max_poles!r}: expected a whole number of at least 1")
    frf = frf.select(band=band)
    lines = _prepared(frf, mirrored=damping == "viscous")
    most = min(max_poles, len(lines.x) // 4)
    if most < 1:
        raise DataError(
            f"modes: {len(frf.freq)} lines are too few to identify a mode; expected at least 4,"
            " better 30"
        )
    poles, found = _poles(lines, most)
    fitted = fit(lines.basis, lines.x, lines.Y, poles)
    stable = []
    for candidate in _candidates(lines, fitted, frf.freq):
        if any(_agreed(lines, pole, found) for pole in poles[candidate]):
            stable.append(candidate)
    if not stable:
        raise _none(frf)
    kept = np.array([_one(lines, fitted, c) for c in stable])
    others = np.delete(poles, np.concatenate(stable))
    final = fit(lines.basis, lines.x, lines.Y, np.concatenate([kept, others]))
    return _mode_set(frf, lines, final, len(kept))


def _none(frf: FRF) -> DataError:
    return DataError(
        f"modes: none is found between {frf.freq[0]:g} and {frf.freq[-1]:g} Hz in which both halves"
        " of the lines agree"
    )


def _prepared(frf: FRF, *, mirrored: bool) -> _Lines:
    omega = 2.0 * np.pi * frf.freq
    unit = float(omega[-1])
    values = frf.values * ((1j * omega) ** (2 - QUANTITIES[frf.quantity]))[:, None, None]
    kind = 2 * (frf.responses.axes >= 3)[:, None] + (frf.references.axes >= 3)[None, :]
    level = np.ones(kind.shape)
    for k in np.unique(kind):
        rms = float(np.sqrt(np.mean(np.abs(values[:, kind == k]) ** 2)))
        if rms > 0:
            level[kind == k] = rms
    if not np.abs(values).any():
        raise DataError("modes: all values are zero")
    x = np.asarray((omega / unit) ** 2, dtype=np.complex128)
    if mirrored:
        x = np.asarray(1j * omega / unit, dtype=np.complex128)
    Y = np.asarray(values / level, dtype=np.complex128).reshape(len(omega), -1)
    return _Lines(Basis(2, mirrored), unit, x, Y, level)


# -- poles -------------------------------------------------------------------------------------
def _poles(lines: _Lines, most: int) -> tuple[_Complex, tuple[Fitted, Fitted]]:
    """Return the poles, and the fits to each half of the lines with as many."""
    at = _telling(lines.Y)
    x, Y = lines.x[at], _combined(lines, at)
    omega = np.abs(x)
    if not lines.basis.mirrored:
        omega = np.abs(np.sqrt(x))
    begin = lines.pole(np.linspace(omega[0], omega[-1], min(_FIRST, most) + 2)[1:-1], 0.01)
    whole, halves = predicting(lines.basis, x, Y, begin, most)
    return whole.poles, halves


def _telling(Y: _Complex) -> NDArray[np.intp]:
    """Return the lines to fit: all, or of many the highest and some at even distances."""
    n = len(Y)
    if n <= _LINES:
        return np.arange(n)
    high = np.argsort(-np.sum(np.abs(Y) ** 2, axis=1), kind="stable")[: _LINES // 2]
    return np.union1d(high, np.arange(0, n, -(-2 * n // _LINES)))


def _combined(lines: _Lines, at: NDArray[np.intp]) -> _Complex:
    """Return combinations of the functions by their first right singular vectors."""
    Y = lines.Y[at]
    Vh = np.linalg.svd(lines.basis.parts(Y), full_matrices=False)
    kept = max(1, min(_FUNCTIONS, int((Vh[1] > 1e-6 * Vh[1][0]).sum())))
    return np.asarray(Y @ Vh[2][:kept].conj().T)


def _candidates(lines: _Lines, fitted: Fitted, freq: _Real) -> list[list[int]]:
    """Return positions of poles that may be modes, indistinguishable ones in one list."""
    poles = fitted.poles
    frequency, loss = lines.frequency(poles), lines.loss(poles)
    within = (frequency >= freq[0]) & (frequency <= freq[-1]) & (loss > 0) & (loss < _HEAVY)
    ascending = np.argsort(frequency, kind="stable")
    own = ascending[within[ascending]].tolist()
    shapes = fitted.residues.reshape(-1, *lines.level.shape)
    groups = [[i] for i in own[:1]]
    for i, j in pairwise(own):
        close = abs(poles[i] - poles[j]) < _APART * (lines.width(poles[i]) + lines.width(poles[j]))
        if close and _same_shape(shapes[i], shapes[j]):
            groups[-1].append(j)
        else:
            groups.append([j])
    return groups


def _same_shape(A: _Complex, B: _Complex) -> bool:
    """Return whether two residues have the same shape at the responses or the references."""
    u, _, w = np.linalg.svd(A)
    v, _, z = np.linalg.svd(B)
    mac = []
    if len(A) > 1:
        mac.append(abs(np.vdot(u[:, 0], v[:, 0])) ** 2)
    if A.shape[1] > 1:
        mac.append(abs(np.vdot(w[0], z[0])) ** 2)
    return max(mac, default=1.0) > _ALIKE


def _agreed(lines: _Lines, pole: complex, found: tuple[Fitted, Fitted]) -> bool:
    reach = max(_AGREE * float(lines.width(np.asarray(pole))), _ROUNDING * abs(pole))
    return all(float(np.abs(f.poles - pole).min()) <= reach for f in found)


def _one(lines: _Lines, fitted: Fitted, cluster: list[int]) -> np.complex128:
    """Return the single pole whose response is nearest to that of several."""
    poles = fitted.poles[cluster]
    if len(poles) == 1:
        return np.complex128(poles[0])
    # Turned so that frequency is real: without its mirror image a pole is any function of a real
    # variable.
    turn = -1j if lines.basis.mirrored else 1.0
    turned = poles * turn
    x = turned.real.mean() + np.linspace(-3.0, 3.0, 61) * float(lines.width(poles).mean()) + 0j
    U, s, _ = np.linalg.svd(
        (1.0 / (x[:, None] - turned)) @ fitted.residues[cluster], full_matrices=False
    )
    (last,) = growing(Basis(0, mirrored=False), x, U * s, turned.mean(keepdims=True), 1)
    return np.complex128(last.poles[0] / turn)


# -- shapes ------------------------------------------------------------------------------------
def _mode_set(frf: FRF, lines: _Lines, fitted: Fitted, n: int) -> ModeSet:
    """Return the modes of the first `n` poles of a fit."""
    poles, residues = fitted.poles[:n], fitted.residues[:n]
    products = lines.modal(poles, residues)
    error = lines.Y - fitted.at(lines.x)
    sides = Sides.of(frf)
    columns = []
    for pole, residue, product in zip(poles, residues, products, strict=True):
        frequency, loss = float(lines.frequency(pole)), float(lines.loss(pole))
        near = _near(frf.freq, frequency, 0.5 * loss * frequency)
        level = float(np.sum(np.abs(lines.Y[near]) ** 2))
        own = float(np.sum(np.abs(1.0 / (lines.x[near, None] - pole) * residue) ** 2))
        if own >= _SEEN**2 * level:
            quality = 1.0 - float(np.sum(np.abs(error[near]) ** 2)) / level
            for shape in sides.shapes(product):
                columns.append((frequency, shape, loss, quality))
    if not columns:
        raise _none(frf)
    frequencies, shapes, losses, qualities = zip(*columns, strict=True)
    return ModeSet(
        frequencies, np.array(shapes).T, sides.dofs, losses, sides.scaled, qualities, frf.source
    )


def _near(freq: _Real, at: float, half_width: float) -> NDArray[np.bool_]:
    """Return the lines within the half-power band, or the three that are nearest."""
    distance = np.abs(freq - at)
    return np.asarray(
        distance <= max(half_width, float(np.sort(distance)[min(2, len(distance) - 1)]))
    )


#: A singular value of a residue above this share of the first is a further mode at the same
#: frequency.
_SECOND = 0.3


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """The two sides of a measurement, responses and references, and where they meet.

    Attributes
    ----------
    rows, columns : ndarray of int, shape (n_d,)
        Responses and references of the drive points.
    sign : ndarray of float, shape (n_d,)
        Product of their signs.
    more : ndarray of int
        References that are not among the responses.
    at_references : bool
        Without a drive point, whether the references say more than the responses, as when the
        hammer roves.
    dofs : list of Dof
        Of the shapes.
    row_scale, column_scale : ndarray of float, shapes (n_i,) and (n_j,)
        Factors on responses and references that make rotations and translations equally large:
        1 for translations.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    sign: NDArray[np.float64]
    more: NDArray[np.intp]
    at_references: bool
    dofs: list[Dof]
    row_scale: _Real
    column_scale: _Real

    @classmethod
    def of(cls, frf: FRF) -> Sides:
        """Return the sides of a measurement.

        Parameters
        ----------
        frf : FRF
            The measurement.
        """
        driven = np.array([d in frf.responses for d in frf.references])
        columns, more = np.flatnonzero(driven), np.flatnonzero(~driven)
        match = frf.responses.match(frf.references[columns], "reference")
        responses, references = list(frf.responses), list(frf.references)
        roving = not len(columns) and len(references) > len(responses)
        dofs = responses
        if roving:
            dofs = references
        elif len(columns):
            dofs = [*responses, *frf.references[more]]
        scale = _scale_of_rotations(frf)
        row_scale = np.where(frf.responses.axes >= 3, scale, 1.0)
        column_scale = np.where(frf.references.axes >= 3, scale, 1.0)
        return cls(match.index, columns, match.sign, more, roving, dofs, row_scale, column_scale)

    @property
    def scaled(self) -> bool:
        """Whether the shapes have unit modal mass."""
        return len(self.rows) > 0

    def shapes(self, product: _Complex) -> list[_Complex]:
        """Return the shapes of one frequency at `dofs`, one or more.

        Parameters
        ----------
        product : ndarray of complex, shape (n_i, n_j)
            Sum over these modes of the shape at the responses times the shape at the references.

        Notes
        -----
        With the singular vectors, product = U W^T, the shapes are U G and W G^-T. At drive points
        they are equal, so that U S = W there with the symmetric S = G G^T (Ewins 2000, section 4.5,
        for one mode: phi_j = r_jj^(1/2)). Rotations are scaled first: in rad and N m the noise of
        one channel may outweigh a mode that another shows, and pass for a second mode.
        """
        scaled = product * self.row_scale[:, None] * self.column_scale
        U, s, Vh = np.linalg.svd(scaled, full_matrices=False)
        largest = max(1, min(len(s), len(self.rows) or len(s)))
        rank = max(1, int((s[:largest] > _SECOND * s[0]).sum()))
        U, W = U[:, :rank] * np.sqrt(s[:rank]), Vh[:rank].T * np.sqrt(s[:rank])
        U, W = U / self.row_scale[:, None], W / self.column_scale[:, None]
        if not self.scaled:
            if self.at_references:
                return list(W.T)
            return list(U.T)
        S = np.linalg.lstsq(U[self.rows], W[self.columns] * self.sign[:, None], rcond=None)[0]
        G = scipy.linalg.sqrtm((S + S.T) / 2)
        at_responses, at_references = U @ G, np.linalg.solve(G, W.T).T
        return list(np.concatenate([at_responses, at_references[self.more]]).T)


def _scale_of_rotations(frf: FRF) -> float:
    """Return the factor on a rotation that makes it as large as a translation.

    The root mean squares of the kinds of FRF (by force and torque, of translation and rotation) are
    taken as level q^-n with n the number of rotations, by least squares in the
    logarithm.
    """
    rotations = np.add.outer((frf.responses.axes >= 3) * 1, (frf.references.axes >= 3) * 1)
    rows, levels = [], []
    for n in np.unique(rotations):
        level = float(np.sqrt(np.mean(np.abs(frf.values[:, rotations == n]) ** 2)))
        if level > 0:
            rows.append([1.0, -float(n)])
            levels.append(np.log(level))
    if len(rows) < 2:
        return 1.0
    return float(np.exp(np.linalg.lstsq(np.array(rows), np.array(levels), rcond=None)[0][1]))
