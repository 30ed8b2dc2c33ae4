"""An element between or on measured DOFs, and the FRFs of a model with this element.

With the dynamic stiffness D(s) of the element and its incidence vectors U, exactly: H' = H - H U (1
/ D + U^T H U)^-1 U^T H (Sherman & Morrison, Ann. Math. Stat. 21 (1950) 124; Woodbury).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from updyn import sensitivity
from updyn.arrays import ComplexArray, IndexArray, NumberArray, RealArray
from updyn.frf import FRF, TRANSMISSIBILITY
from updyn.updating.judge.causes.altered import Alteration, replace_channels
from updyn.updating.judge.causes.labels import list_unsigned_labels
from updyn.updating.problem.channels import Gains
from updyn.updating.problem.problem import FRFPart, LineBlock

__all__ = ["AddedElement", "ElementEffect", "ElementVectors", "MeasuredDofs", "Receptances"]


#: Power of s in the dynamic stiffness of an element.
_POWERS = {"stiffness": 0, "viscous": 1, "mass": 2}


@dataclass(frozen=True, slots=True)
class AddedElement(Alteration):
    """A spring, a dashpot or a mass of size `value` in SI units (rotational ones for rotations).

    `quantity` is ``"stiffness"``, ``"viscous"`` or ``"mass"``; it acts between two DOFs, or, unless
    `between`, between each DOF and the ground. `loss` is the loss factor of a spring.
    """

    quantity: str
    labels: tuple[str, ...]
    between: bool
    value: float = 0.0
    loss: float = 0.0

    @property
    def incidence(self) -> RealArray:
        """Incidence vectors over the labels, shape (len(labels), k)."""
        return np.array([[1.0], [-1.0]]) if self.between else np.eye(len(self.labels))

    def unit_stiffness(self, s: ComplexArray) -> ComplexArray:
        """Return the dynamic stiffness of an element of size 1, shape (n_f,)."""
        return np.asarray((1.0 + 1j * self.loss) * s ** _POWERS[self.quantity])

    def block(self, part: FRFPart, x: RealArray, lines: slice, *, derivatives: bool) -> LineBlock:
        """Return the model with the element and the data of a part at a block of lines."""
        frf, s = part.frf, part.frf.s[lines]
        dofs = part.solver.system.dofs.match(list(self.labels)).index
        rate = s**frf.power
        H, dH = sensitivity.receptance(
            part.solver,
            part.unknowns,
            part.values(x),
            frf.freq[lines],
            np.concatenate([part.rows, dofs]),
            np.concatenate([part.columns, dofs]),
            derivatives=derivatives,
            lines=frf.freq,
            weights=part.coordinates.slope(x)[:, None] * rate,
        )
        n_i, n_j, U = len(part.rows), len(part.columns), self.incidence
        left, right = H[:, :n_i, n_j:] @ U, U.T @ H[:, n_i:, :n_j]
        G = self._effective_stiffness(U.T @ H[:, n_i:, n_j:] @ U, s)
        P, Q = left @ G, G @ right
        altered = (H[:, :n_i, :n_j] - P @ right) * (part.sign * rate[:, None, None])
        if dH is not None:  # d H' = (1, -P U^T) d H (1; -U Q)
            rows = dH[..., :n_i, :] - (P @ U.T) @ dH[..., n_i:, :]
            dH = (rows[..., :n_j] - rows[..., n_j:] @ (U @ Q)) * part.sign
        gains = Gains.find(part.coordinates.parameters, frf) if part.as_read else None
        if gains is not None:
            gains.apply(x, altered, dH)
        return LineBlock(lines, altered, dH, frf.values[lines])

    def _effective_stiffness(self, own_receptance: ComplexArray, s: ComplexArray) -> ComplexArray:
        """Return (1 / D + U^T H U)^-1, shape (n_f, k, k)."""
        D = (self.value * self.unit_stiffness(s))[:, None, None]
        return np.asarray(
            np.linalg.solve(
                np.eye(own_receptance.shape[-1]) + D * own_receptance,
                D * np.eye(own_receptance.shape[-1]),
            )
        )


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredDofs:
    """Unsigned DOFs, the measured ones first; positions of responses and references in them."""

    labels: list[str]
    rows: IndexArray
    columns: IndexArray

    @classmethod
    def of(cls, frf: FRF) -> Self:
        """Return the DOFs of data."""
        rows, columns = list_unsigned_labels(frf.responses), list_unsigned_labels(frf.references)
        labels = list(dict.fromkeys(rows + columns))
        at = {label: i for i, label in enumerate(labels)}
        return cls(
            labels,
            np.array([at[one] for one in rows], dtype=np.intp),
            np.array([at[one] for one in columns], dtype=np.intp),
        )

    @classmethod
    def with_translations(cls, part: FRFPart) -> Self:
        """Return the DOFs of data, then the other translations of their nodes in the model."""
        measured = cls.of(part.frf)
        nodes = {label.partition(":")[0] for label in measured.labels if ":R" not in label}
        dofs = [part.solver.system.dofs[i] for i in part.solver.other_dofs(part.rows[:0])]
        labels = [f"{dof.node}:{dof.direction}" for dof in dofs if str(dof.node) in nodes]
        more = [label for label in labels if ":R" not in label]
        return replace(measured, labels=list(dict.fromkeys([*measured.labels, *more])))

    def find_positions(self, labels: Sequence[str]) -> list[int]:
        """Return the positions of some labels."""
        return [self.labels.index(label) for label in labels]


@dataclass(frozen=True, eq=False)  # no slots, for the cached property
class Receptances:
    """Receptances between the DOFs of measured nodes, shape (n_f, m, m) in m/N; `s` is in 1/s.

    Under base excitation, the base is held, and a last column has the transmissibilities.
    """

    dofs: MeasuredDofs
    H: ComplexArray
    s: ComplexArray

    @classmethod
    def of(cls, part: FRFPart, x: RealArray) -> Self:
        """Return the receptances of the model of a part at x."""
        dofs = MeasuredDofs.with_translations(part)
        square = replace_channels(part, dofs.labels, dofs.labels, "receptance")
        H = square.responses(x)
        if part.frf.quantity == TRANSMISSIBILITY:
            references = list_unsigned_labels(part.frf.references)
            driven = replace_channels(part, dofs.labels, references, TRANSMISSIBILITY)
            H = np.concatenate([H, driven.responses(x)], axis=2)
            dofs = replace(dofs, columns=np.array([len(dofs.labels)]))
        return cls(dofs, H, square.frf.s)

    def log_change(self, element: AddedElement) -> ComplexArray:
        """Return ln(H' / H) at the channels, shape (n_f, n_i, n_j); 0 where either is 0."""
        return self.find_effect(element).evaluate(element.value)[0]

    def slope(self, element: AddedElement) -> ComplexArray:
        """Return the derivative of ln H' by the size of the element, shape (n_f, n_i, n_j)."""
        return self.find_effect(element).evaluate(element.value)[1]

    def find_effect(self, element: AddedElement) -> ElementEffect:
        """Return the effect of an element, of any size."""
        U, at = element.incidence, np.array(self.dofs.find_positions(element.labels))
        rows, columns = self.dofs.rows, self.dofs.columns
        return ElementEffect(
            element.unit_stiffness(self.s)[:, None, None],
            U.T @ self.H[:, at[:, None], at] @ U,
            self.H[:, rows[:, None], at] @ U,
            U.T @ self.H[:, at[:, None], columns],
            self.channel_response,
        )

    @cached_property
    def channel_response(self) -> ComplexArray:
        """Receptances of the channels, shape (n_f, n_i, n_j)."""
        return np.asarray(self.H[:, self.dofs.rows[:, None], self.dofs.columns])

    def derive_by_product(self, unit_stiffness: ComplexArray) -> ComplexArray:
        """Return the slope of ln H' at size 0 over (h_i u) (u^T h_j), shape (n_f, n_i, n_j)."""
        H = self.channel_response
        return np.asarray(-unit_stiffness[:, None, None] / np.where(H == 0.0, 1.0, H))


@dataclass(frozen=True, slots=True, eq=False)
class ElementEffect:
    """Receptances of the channels with an element, as a function of its size.

    With the incidence vectors U of the element: its dynamic stiffness `unit` for size 1, shape
    (n_f, 1, 1), `own` U^T H U (n_f, k, k), `left` H U (n_f, n_i, k), `right` U^T H (n_f, k, n_j),
    and `response` H (n_f, n_i, n_j).
    """

    unit: ComplexArray
    own: ComplexArray
    left: ComplexArray
    right: ComplexArray
    response: ComplexArray

    def evaluate(self, size: float) -> tuple[ComplexArray, ComplexArray]:
        """Return ln(H' / H), 0 where either is 0, and its derivative, shape (n_f, n_i, n_j)."""
        unity = np.eye(self.own.shape[1])
        # Motion of the DOFs of the element over that without it.
        relative = np.linalg.solve(unity + size * self.unit * self.own, unity)
        left, H = self.left @ relative, self.response
        added = left @ (size * self.unit * self.right)
        altered = H - added
        usable = (H != 0.0) & (altered != 0.0)
        change = np.log1p(-np.where(usable, added, 0.0) / np.where(usable, H, 1.0))
        product = left @ (-self.unit * (relative @ self.right))
        return np.asarray(change), product / np.where(altered == 0.0, 1.0, altered)


class ElementVectors:
    """Incidence vectors of several elements of one kind, and products of receptances with them."""

    # A vector is 1 at `first` and -1 at `second`: another DOF, or the ground, which is the last.

    def __init__(self, receptances: Receptances, elements: Sequence[AddedElement]) -> None:
        dofs = receptances.dofs
        position = {label: i for i, label in enumerate(dofs.labels)}
        ground = len(dofs.labels)
        pairs: list[tuple[int, int]] = []
        starts: list[int] = []
        for one in elements:
            starts.append(len(pairs))
            at = [position[label] for label in one.labels]
            pairs += [(at[0], at[1])] if one.between else [(i, ground) for i in at]
        self.first, self.second = np.array(pairs, dtype=np.intp).T
        self.starts = np.array(starts, dtype=np.intp)
        H, n_f = receptances.H, len(receptances.s)
        self.own = np.zeros((n_f, ground + 1, ground + 1), dtype=np.complex128)
        self.own[:, :-1, :-1] = H[:, :, :ground]
        self.left = np.zeros((n_f, len(dofs.rows), ground + 1), dtype=np.complex128)
        self.left[:, :, :-1] = H[:, dofs.rows, :ground]
        self.right = np.zeros((n_f, ground + 1, len(dofs.columns)), dtype=np.complex128)
        self.right[:, :-1] = H[:, :, dofs.columns]

    def _form(self, G: NumberArray) -> NumberArray:
        """Return u^T G u of each vector, for G of shape (..., m, m)."""
        a, b = self.first, self.second
        return np.asarray(G[..., a, a] - G[..., a, b] - G[..., b, a] + G[..., b, b])

    def list_flexibilities(self, unit_stiffness: ComplexArray) -> RealArray:
        """Return the median over the lines of |D(s) u^T H u| for each element of size 1."""
        own = np.maximum.reduceat(np.abs(self._form(self.own)), self.starts, axis=1)
        return np.asarray(np.median(own * np.abs(unit_stiffness)[:, None], axis=0))

    def sum_products(self, factor: ComplexArray) -> RealArray:
        """Return the real part of the sum of factor (h_i u) (u^T h_j) for each element."""
        # The sum over lines and the shorter side of the channels is the product of two matrices.
        n, by_reference = self.left.shape[2], self.right.swapaxes(1, 2)
        if factor.shape[1] < factor.shape[2]:
            pair = self.left, factor @ by_reference
        else:
            pair = factor.swapaxes(1, 2) @ self.left, by_reference
        left, right = (one.reshape(-1, n) for one in pair)
        G = left.real.T @ right.real - left.imag.T @ right.imag
        return np.asarray(np.add.reduceat(self._form(G), self.starts))

    def sum_squares(self, factor: ComplexArray, chunk: int) -> RealArray:
        """Return the sum of |factor (h_i u) (u^T h_j)|^2 for each element."""
        ends = np.append(self.starts[1:], len(self.first))
        out = np.empty(len(self.starts))
        square = np.abs(factor) ** 2
        single = np.flatnonzero(ends - self.starts == 1)
        for some in np.split(single, range(chunk, len(single), chunk)):
            left, right = self._products(self.starts[some])
            by_response = square @ (np.abs(right) ** 2).swapaxes(1, 2)
            out[some] = np.einsum("fie,fie->e", np.abs(left) ** 2, by_response)
        for k in np.flatnonzero(ends - self.starts > 1):
            left, right = self._products(np.arange(self.starts[k], ends[k]))
            out[k] = np.sum(np.abs(factor * (left @ right)) ** 2)
        return out

    def _products(self, at: IndexArray) -> tuple[ComplexArray, ComplexArray]:
        """Return h_i u and u^T h_j of some vectors, shape (n_f, n_i, k) and (n_f, k, n_j)."""
        a, b = self.first[at], self.second[at]
        left, right = self.left, self.right
        return left[:, :, a] - left[:, :, b], right[:, a] - right[:, b]
