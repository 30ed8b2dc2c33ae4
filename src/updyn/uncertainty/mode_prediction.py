"""Modes of the updated model at any DOF, with standard deviations from those of the unknowns."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from updyn.arrays import RealArray
from updyn.correlation.clusters import cluster_modes
from updyn.correlation.settings import MODE_PAIRING
from updyn.dofs import Dof, DofSet
from updyn.errors import SolverError
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.uncertainty.counts import check_count
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.posterior import Posterior, find_update
from updyn.uncertainty.updated_modes import UpdatedModes
from updyn.updating.result import JointResult, UpdateResult, find_result

__all__ = ["exclude_span", "predict_modes", "select_count"]


def predict_modes(
    source: UpdateResult | JointResult | Draws,
    n: int | None = None,
    *,
    dofs: Iterable[str | Dof] | None = None,
    test: str | None = None,
    tier: str | None = None,
) -> ModeSet:
    """Predict the modes of the updated structure, with standard deviations.

    Parameters
    ----------
    source : UpdateResult, JointResult or Draws
        An update, or draws of a bootstrap or a sampling. The covariance of the unknowns is
        propagated by exact derivatives (delta method).
    n : int, optional
        Number of modes: the lowest ones without rigid-body modes. By default all modes up to the
        highest measured frequency, or within 0.6 % above it.
    dofs : iterable of str or Dof, optional
        Signed DOFs of the shapes, measured or not. By default all DOFs of the model.
    test : str, optional
        Test whose model is used; required if the update has several.
    tier : {"dense", "sparse", "reduced"}, optional
        ``"reduced"``: a reduced model about the estimate with certified error, by default above
        3,000 DOFs. Else the full model.

    Returns
    -------
    ModeSet
        Undamped modes of unit modal mass, with loss factors by modal strain energy.
        `std_frequency`, `std_loss_factor` and `std_shapes` are nan where an undetermined
        combination of the unknowns changes the value.

    Raises
    ------
    OptionError
        If `source` is neither an update nor draws with their update (`Draws.of`), an option is not
        understood, or the model has no mode up to the highest measured frequency.
    DofError
        If a DOF is not in the model.
    SolverError
        If the modes cannot be computed.

    Notes
    -----
    Derivatives: R. L. Fox & M. P. Kapoor, AIAA J. 6 (1968) 2426; R. B. Nelson, AIAA J. 14 (1976)
    1201. As in every `ModeSet`, `std_shapes` is at fixed length and sign: it excludes the part of a
    derivative along the shape. In a cluster of modes within 0.6 % of frequency, it excludes the
    part in the span of their shapes, as their rotation within the span is hardly determined
    (`updyn.correlate` compares the spans). Modes of one frequency that the unknowns couple have no
    derivatives; their standard deviations are nan.

    Standard deviations cover the uncertainty of the unknowns, not errors of the model.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> modes = updyn.predict_modes(result, 3)
    >>> modes.shapes.shape, bool((modes.std_frequency < 0.01 * modes.frequency).all())
    ((12, 3), True)
    """
    result = find_result(find_update(source), test)
    n, highest = select_count(result, n)
    updated = UpdatedModes.of(result, n, highest, tier)
    posterior, found = Posterior.of(source), updated.modes
    labels = updated.model.dofs if dofs is None else DofSet(dofs)
    match = updated.model.dofs.match(labels)
    shapes = found.shapes[match.index] * match.sign[:, None]
    loss = np.array([updated.loss_factor(k).factor for k in range(updated.number)])
    std_frequency, std_loss = np.full((2, updated.number), np.nan)
    std_shapes = np.full((len(labels), updated.number), np.nan)
    for members in cluster_modes(found.frequency):
        for k in members[members < updated.number].tolist():
            try:
                slope = updated.differentiate(k)
            except SolverError:
                continue
            std_frequency[k] = posterior.propagate(slope.frequency, found.frequency[k])
            std_loss[k] = posterior.propagate(slope.loss_factor, loss[k])
            across = exclude_span(slope.shape[match.index], found.shapes[match.index][:, members])
            std_shapes[:, k] = posterior.propagate(across, np.abs(shapes[:, k]).max())
    return ModeSet(
        found.frequency[: updated.number],
        shapes[:, : updated.number],
        labels,
        loss,
        scaled=True,
        source="updated model",
        std_frequency=std_frequency,
        std_loss_factor=std_loss,
        std_shapes=std_shapes,
    )


def select_count(result: UpdateResult, n: int | None) -> tuple[int | None, float]:
    """Return a number of modes, validated, and the frequency in Hz up to which None selects."""
    if n is not None:
        n = check_count("n", n, "modes", 1, result.start.n_dofs)
    data = result.data
    highest = float((data.freq if isinstance(data, FRF) else data.frequency)[-1])
    return n, highest * (1.0 + MODE_PAIRING.close_frequencies)


def exclude_span(derivatives: RealArray, span: RealArray) -> RealArray:
    """Return derivatives (k, n) without their part in the span of shapes (k, m)."""
    return np.asarray(derivatives - span @ np.linalg.lstsq(span, derivatives, rcond=None)[0])
