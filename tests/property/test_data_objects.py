"""Properties that hold for any DOFs, FRF and model (Hypothesis, derandomised)."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from updyn.dofs import DIRECTIONS, Dof, DofSet
from updyn.frf import FRF, QUANTITIES
from updyn.model import Group, Model

nodes = st.integers(-(10**17), 10**17)
dof = st.builds(Dof, nodes, st.sampled_from(DIRECTIONS), st.sampled_from([1, -1]))
dof_lists = st.lists(dof, min_size=1, max_size=8, unique_by=lambda d: (d.node, d.direction))
seeds = st.integers(0, 2**32 - 1)


@st.composite
def frfs(draw: st.DrawFn) -> FRF:
    responses, references = draw(dof_lists), draw(dof_lists)
    steps = draw(st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=8))
    freq = np.cumsum(steps)
    shape = (len(freq), len(responses), len(references))
    rng = np.random.default_rng(draw(seeds))
    scale = 10.0 ** draw(st.integers(-12, 3))
    values = scale * (rng.normal(size=shape) + 1j * rng.normal(size=shape))
    return FRF(
        freq,
        values,
        responses,
        references,
        draw(st.sampled_from(sorted(QUANTITIES))),
        coherence=rng.uniform(size=shape) if draw(st.booleans()) else None,
        variance=scale**2 * rng.uniform(size=shape) if draw(st.booleans()) else None,
        averages=draw(st.none() | st.integers(1, 100)),
        source=draw(st.text(max_size=5)),
    )


def assert_same(a: FRF, b: FRF, rtol: float = 0.0) -> None:
    assert (a.responses, a.references, a.quantity) == (b.responses, b.references, b.quantity)
    assert (a.averages, a.source) == (b.averages, b.source)
    for name in ("freq", "values", "coherence", "variance"):
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None)
        if x is not None:
            np.testing.assert_allclose(x, y, rtol=rtol, atol=0)


# -- DOFs --------------------------------------------------------------------------------------------------
@given(dof)
def test_a_label_reads_back(d):
    assert Dof.parse(str(d)) == d
    assert DofSet([d]).labels == [str(d)]


@given(dof_lists)
def test_a_set_reads_back_from_labels_and_arrays(dofs):
    held = DofSet(dofs)
    assert list(held) == dofs
    assert DofSet(held.labels) == held
    assert DofSet.from_arrays(held.nodes, held.axes, held.signs) == held


@given(dof_lists, st.randoms(use_true_random=False))
def test_match_is_a_permutation_with_the_product_of_signs(dofs, random):
    held = DofSet(dofs)
    other = [d if random.random() < 0.5 else -d for d in random.sample(dofs, len(dofs))]
    found = held.match(other)
    assert sorted(found.index.tolist()) == list(range(len(dofs)))
    for i, sign, d in zip(found.index, found.sign, other, strict=True):
        assert held[int(i)] == (d if sign > 0 else -d)


@given(dof_lists, st.data())
def test_complement_and_match_part_the_set(dofs, data):
    some = data.draw(st.lists(st.sampled_from(dofs), unique=True))
    held = DofSet(dofs)
    rest, taken = held.complement(some).tolist(), held.match(some).index.tolist()
    assert sorted(rest + taken) == list(range(len(dofs)))
    assert rest == sorted(rest)


# -- FRF ---------------------------------------------------------------------------------------------------
@given(frfs(), st.sampled_from(sorted(QUANTITIES)), st.sampled_from(sorted(QUANTITIES)))
def test_conversion_by_way_of_any_quantity_is_the_same(frf, way, end):
    assert_same(frf.converted(way).converted(end), frf.converted(end), rtol=1e-13)
    assert_same(frf.converted(way).converted(frf.quantity), frf, rtol=1e-13)


@given(frfs(), st.data())
def test_select_after_select_is_one_select(frf, data):
    def part(responses, references, lines):
        turned = st.booleans()
        flip = lambda d: -d if data.draw(turned) else d  # noqa: E731
        pick = lambda items: data.draw(st.lists(st.sampled_from(items), min_size=1, unique=True))  # noqa: E731
        return {
            "responses": [flip(d) for d in pick(list(responses))],
            "references": [flip(d) for d in pick(list(references))],
            "lines": pick(list(lines)),
        }

    first = part(frf.responses, frf.references, frf.freq)
    second = part(first["responses"], first["references"], first["lines"])
    assert_same(frf.select(**first).select(**second), frf.select(**second))


@given(frfs(), st.sampled_from(sorted(QUANTITIES)), st.data())
def test_select_and_convert_commute(frf, quantity, data):
    lines = data.draw(st.lists(st.sampled_from(list(frf.freq)), min_size=1, unique=True))
    assert_same(
        frf.select(lines=lines).converted(quantity),
        frf.converted(quantity).select(lines=lines),
        rtol=1e-15,
    )


@given(frfs())
def test_there_and_back_through_xarray(frf):
    assert_same(FRF.from_xarray(frf.to_xarray()), frf)


# -- model -------------------------------------------------------------------------------------------------
@st.composite
def models(draw: st.DrawFn) -> Model:
    n, count = draw(st.integers(1, 5)), draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(seeds))

    def matrix() -> np.ndarray:
        factor = rng.normal(size=(n, n))
        return factor @ factor.T + np.eye(n)

    groups = {
        f"g{i}": Group(matrix(), matrix(), loss_factor=rng.uniform(), viscous=matrix())
        for i in range(count)
    }
    return Model.from_groups(groups, [f"{i}:X" for i in range(n)])


def dynamic_stiffness(model: Model, omega: float) -> np.ndarray:
    K, D, C, M = (
        m.toarray() for m in (model.stiffness, model.structural, model.viscous, model.mass)
    )
    return K + 1j * D + 1j * omega * C - omega**2 * M


@given(models(), seeds, st.floats(0.0, 10.0))
def test_scaling_is_affine_in_the_factors(model, seed, t):
    """Z at a mix of two sets of factors is the mix of the two Z, at fixed loss factors."""
    rng = np.random.default_rng(seed)
    a, b = (
        {
            g: {q: rng.uniform(0.1, 3.0) for q in ("stiffness", "mass", "viscous")}
            for g in model.groups
        }
        for _ in "ab"
    )
    mix = {g: {q: (1 - t) * a[g][q] + t * b[g][q] for q in a[g]} for g in a}
    got = dynamic_stiffness(model.scaled(mix), 1.7)
    expected = (1 - t) * dynamic_stiffness(model.scaled(a), 1.7) + t * dynamic_stiffness(
        model.scaled(b), 1.7
    )
    scale = (1 + 2 * t) * max(np.abs(dynamic_stiffness(model.scaled(x), 1.7)).max() for x in (a, b))
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-13 * scale)


@given(models(), seeds)
def test_scaling_is_the_sum_that_the_docstring_states(model, seed):
    rng = np.random.default_rng(seed)
    changes = {
        g: {
            "stiffness": rng.uniform(0.1, 3),
            "mass": rng.uniform(0.1, 3),
            "loss_factor": rng.uniform(),
        }
        for g in model.groups
    }
    omega = 2.3
    expected = sum(
        c["stiffness"] * (1 + 1j * c["loss_factor"]) * model.group(g).stiffness.toarray()
        + 1j * omega * model.group(g).viscous.toarray()
        - omega**2 * c["mass"] * model.group(g).mass.toarray()
        for g, c in changes.items()
    )
    np.testing.assert_allclose(
        dynamic_stiffness(model.scaled(changes), omega), expected, rtol=1e-12, atol=1e-12
    )


@given(models(), seeds)
def test_scaling_twice_multiplies(model, seed):
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(0.1, 3.0, 2)
    twice = model.scaled({"g0": {"stiffness": a}}).scaled({"g0": {"stiffness": b}})
    once = model.scaled({"g0": {"stiffness": a * b}})
    np.testing.assert_allclose(twice.stiffness.toarray(), once.stiffness.toarray(), rtol=1e-13)
    np.testing.assert_allclose(twice.structural.toarray(), once.structural.toarray(), rtol=1e-13)
