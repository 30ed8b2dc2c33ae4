"""From the residue of a mode to its shape: what responses, references and drive points make of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from updyn.dofs import Dof
from updyn.frf import FRF

__all__ = ["Sides"]

_Complex = NDArray[np.complex128]

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
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    sign: NDArray[np.float64]
    more: NDArray[np.intp]
    at_references: bool
    dofs: list[Dof]

    @classmethod
    def of(cls, frf: FRF) -> Sides:
        """Look at a measurement.

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
        dofs = (
            references if roving else responses + [references[int(j)] for j in more if len(columns)]
        )
        return cls(match.index, columns, match.sign, more, roving, dofs)

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
        for one mode: phi_j = r_jj^(1/2)).
        """
        U, s, Vh = np.linalg.svd(product, full_matrices=False)
        largest = max(1, min(len(s), len(self.rows) or len(s)))
        rank = max(1, int((s[:largest] > _SECOND * s[0]).sum()))
        U, W = U[:, :rank] * np.sqrt(s[:rank]), Vh[:rank].T * np.sqrt(s[:rank])
        if not self.scaled:
            return list((W if self.at_references else U).T)
        S = np.linalg.lstsq(U[self.rows], W[self.columns] * self.sign[:, None], rcond=None)[0]
        G = scipy.linalg.sqrtm((S + S.T) / 2)
        at_responses, at_references = U @ G, np.linalg.solve(G, W.T).T
        return list(np.concatenate([at_responses, at_references[self.more]]).T)
