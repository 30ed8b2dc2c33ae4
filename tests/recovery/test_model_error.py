"""The residual of a fit in a reduced model is judged as that of the whole; what explains it is named in both."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.model import Group, Model


def grid(m: int = 12) -> Model:
    """A square of masses on springs held along one side: two halves, a seam between them, the support."""
    n = m * m
    node = np.arange(n).reshape(m, m)
    half = np.repeat(np.arange(m) >= m // 2, m)
    i = np.r_[node[:-1].ravel(), node[:, :-1].ravel()]
    j = np.r_[node[1:].ravel(), node[:, 1:].ravel()]

    def group(own: np.ndarray, mass: np.ndarray | None, loss: float) -> Group:
        ends = np.zeros((int(own.sum()), n))
        ends[np.arange(len(ends)), i[own]] = 1.0
        ends[np.arange(len(ends)), j[own]] -= 1.0
        return Group(
            1e6 * ends.T @ ends, None if mass is None else np.diag(1.0 * mass), loss_factor=loss
        )

    groups = {
        "left": group(~half[i] & ~half[j], ~half, 0.01),
        "right": group(half[i] & half[j], half, 0.02),
        "seam": group(half[i] != half[j], None, 0.1),
        "support": Group(np.diag(np.where(np.arange(n) < m, 1e6, 0.0)), loss_factor=0.01),
    }
    return Model.from_groups(groups, [f"{d + 1}:Z" for d in range(n)])


@pytest.mark.parametrize("noise", [None, {"relative": 0.01}], ids=["estimated", "stated"])
def test_a_reduced_model_is_judged_as_the_whole(add_noise, noise) -> None:
    model = grid()
    sensors = ["144:Z", "75:Z", "40:Z", "9:-Z"]
    true = model.scaled({"seam": {"stiffness": 0.8}, "left": {"stiffness": 1.1}})
    exact = updyn.response(true, np.linspace(15.0, 90.0, 60), sensors, sensors[:1])
    data = add_noise(exact, np.random.default_rng(3), 0.01)
    held = updyn.parameters(
        model, stiffness=["left", "right", "support"], loss_factor=["left", "right", "support"]
    )
    whole, fast = (
        updyn.update(model, data, held, tier=tier, backend="superlu", starts=0, noise=noise)
        for tier in ("sparse", "reduced")
    )
    for result in (whole, fast):
        assert result.adequacy.outcome == "structure"
        assert result.adequacy.explained_by[0].name == "seam.stiffness"
        assert result.adequacy.explained_by[0].change == pytest.approx(np.log(0.8), rel=0.5)
        assert result.remedy.startswith("Free seam.stiffness")
    assert fast.adequacy.misfit == pytest.approx(whole.adequacy.misfit, rel=1e-2)
    first, other = whole.adequacy.explained_by[0], fast.adequacy.explained_by[0]
    assert (other.explains, other.energy) == pytest.approx((first.explains, first.energy), rel=0.02)
    freed = held + updyn.parameters(model, stiffness="seam")
    assert updyn.update(
        model, data, freed, tier="reduced", backend="superlu", starts=0, noise=noise
    ).adequacy.adequate
