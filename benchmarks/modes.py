"""Updating on measured modes alone, and beside FRFs.

Three studies, on space frames that stand on supports (`models.footbridge`):

- ``exact``: twelve unknown stiffnesses of a frame of 2,037 DOFs, off by up to 30 %, from three
  modes without noise at 20 sensors.
- ``bridge``: eight unknown stiffnesses of a bridge of 948 DOFs, off by up to 40 %, from eight modes
  at 58 sensors; frequencies to 0.1 %, shapes to 5 or 20 % of their rms. With standard deviations
  that are stated, with none (estimated), and by ``method="modal"`` with its fixed weight of shapes.
  In a second set the true bridge has a deck of 3 % more mass here and there that the model lacks.
- ``damping``: stiffnesses and loss factors of a chain of twelve masses, from eight modes; how far
  the estimates are from the truth in their standard deviations.
- ``mixed``: 17 stiffnesses of that bridge, off by up to 30 %, most of which the data do not
  determine, from five modes at 58 sensors whose shapes hold 5 or 30 % of other modes, so that no
  values of the unknowns reproduce them; frequencies to 0.1 %.
- ``frequencies``: a chain of four unknown springs from its four natural frequencies, which four
  chains have, by random starts; and a chain of 16 masses, 14 unknown springs, six modes at six
  sensors.

    python benchmarks/modes.py [exact bridge damping mixed frequencies] [--draws 10]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from models import RHO, E, chain, footbridge

import updyn
from updyn.elements.structure import Truss, structure
from updyn.modal import ModeSet
from updyn.model import Group, Model
from updyn.updating.result import UpdateResult

Make = Callable[[Model, ModeSet], UpdateResult]


def measured(
    model: Model, n: int, dofs: list[str], noise: Mapping[str, float], seed: int, *, stated: bool
) -> ModeSet:
    """The lowest modes of a model as a test gives them: with noise, of any scale and sign."""
    found, rng = updyn.modes(model, n), np.random.default_rng(seed)
    at = model.dofs.match(dofs)
    shapes = found.shapes[at.index].real * at.sign[:, None] * rng.choice([-3.0, 3.0], n)
    rms = np.sqrt(np.mean(shapes**2, axis=0))
    off = {kind: share * rng.standard_normal(n) for kind, share in noise.items()}
    shapes = shapes + noise.get("shape", 0.0) * rms * rng.standard_normal(shapes.shape)
    f = found.frequency * (1.0 + off.get("frequency", 0.0))
    loss = found.loss_factor * np.maximum(1.0 + off.get("loss_factor", 0.0), 0.05)
    known = {}
    if stated:
        known = {
            "std_frequency": noise["frequency"] * f,
            "std_loss_factor": noise.get("loss_factor", 0.0) * loss,
            "std_shapes": noise["shape"] * np.broadcast_to(rms, shapes.shape),
        }
    return ModeSet(f, shapes, dofs, loss_factor=loss, source="simulated", **known)


def scattered(model: Model, far: float, rng: np.random.Generator) -> Model:
    """A model whose stiffnesses are off by up to a share."""
    off = rng.uniform(-far, far, len(model.groups))
    return model.scaled(
        {g: {"stiffness": float(np.exp(o))} for g, o in zip(model.groups, off, strict=True)}
    )


def exact(draws: int) -> None:
    true = footbridge(4, 19, pieces=12)
    rng = np.random.default_rng(0)
    dofs = [str(true.dofs[int(i)]) for i in rng.choice(true.n_dofs, 20, replace=False)]
    worst, seconds = [], []
    for draw in range(draws):
        start = scattered(true, 0.3, np.random.default_rng([1, draw]))
        modes = measured(true, 3, dofs, {}, draw, stated=False)
        begun = time.process_time()
        result = updyn.update(start, modes, updyn.parameters(start, stiffness="all"))
        seconds.append(time.process_time() - begun)
        worst.append(max(abs(_stiffness(result.model, true) - 1.0)))
    found = sum(one < 1e-6 for one in worst)
    print(
        f"frame of {true.n_dofs} DOFs, 12 unknowns, 3 exact modes at 20 sensors: {found} of"
        f" {draws} to 1e-6 (median of the worst unknown {np.median(worst):.1g});"
        f" {np.median(seconds):.1f} s"
    )


def _stiffness(model: Model, true: Model) -> np.ndarray:
    return np.array([_size(model.group(g)) / _size(true.group(g)) for g in true.groups])


def _size(group: Group) -> float:
    assert group.stiffness is not None
    return float(np.abs(group.stiffness.data).sum())


def bridge(draws: int) -> None:
    nominal = footbridge(1, 35, pieces=8)
    upper = [f"{node}:{d}" for node in range(8, 176, 6) for d in "ZY"]
    dofs = (upper + [f"{node}:Z" for node in range(190, 316, 5)])[:58]
    print("\n| bridge | shapes | how | frequency, rms | worst | MAC, lowest | before | stiffness |")
    print("|---|---|---|---|---|---|---|---|")
    for lacking in (False, True):
        for share in (0.05, 0.2):
            noise = {"frequency": 1e-3, "shape": share}
            for how, make, stated in (
                ("stated", _default, True),
                ("default", _default, False),
                ("fixed weight of shapes 0.1", _fixed, False),
            ):
                _bridge_row(nominal, dofs, noise, how, make, draws, lacking=lacking, stated=stated)


def _default(start: Model, modes: ModeSet) -> UpdateResult:
    return updyn.update(start, modes, updyn.parameters(start, stiffness="piece*"))


def _fixed(start: Model, modes: ModeSet) -> UpdateResult:
    unknowns = updyn.parameters(start, stiffness="piece*")
    return updyn.update(start, modes, unknowns, method="modal")


def _bridge_row(
    nominal: Model,
    dofs: list[str],
    noise: Mapping[str, float],
    how: str,
    make: Make,
    draws: int,
    *,
    lacking: bool,
    stated: bool,
) -> None:
    rows = []
    for draw in range(draws):
        rng = np.random.default_rng([2, draw])
        true = _with_deck(nominal, rng) if lacking else nominal
        start = scattered(nominal, 0.4, rng)
        modes = measured(true, 8, dofs, noise, draw, stated=stated)
        result = make(start, modes)
        clean = measured(true, 8, dofs, {}, draw, stated=False)
        found, first = (updyn.correlate(m, clean) for m in (result.model, start))
        off = np.abs(found.frequency_change)
        rows.append(
            [
                float(np.sqrt(np.mean(off**2))),
                float(off.max()),
                float(found.pairs.mac.min()),
                float(first.pairs.mac.min()),
                100.0 * float(np.abs(_stiffness(result.model, nominal) - 1.0).max()),
            ]
        )
    rms, worst, mac, before, stiff = np.median(rows, axis=0)
    kind = "with a deck" if lacking else "as modelled"
    cells = [kind, f"{100 * noise['shape']:.0f} %", how, f"{rms:.2f} %", f"{worst:.2f} %"]
    cells += [f"{mac:.4f}", f"{before:.4f}", f"{stiff:.1f} %"]
    print(f"| {' | '.join(cells)} |", flush=True)


def _with_deck(model: Model, rng: np.random.Generator) -> Model:
    """The bridge with 3 % of its mass in addition, on some of its DOFs."""
    at = rng.choice(model.n_dofs // 3, 20, replace=False)
    own = np.zeros(model.n_dofs)
    total = float(model.mass.diagonal().sum()) / 3.0
    own[(3 * at[:, None] + np.arange(3)).ravel()] = 0.03 * total / len(at)
    return Model.from_groups({**model.groups, "deck": Group(mass=np.diag(own))}, model.dofs)


def damping(draws: int) -> None:
    start = chain(12, 4)
    changes = {
        f"piece {p + 1}": {"stiffness": s, "loss_factor": eta}
        for p, (s, eta) in enumerate(((1.3, 0.01), (0.8, 0.04), (1.1, 0.02), (0.9, 0.03)))
    }
    true = start.scaled(changes)
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    truth = np.array([changes[p.group][p.quantity] for p in unknowns])
    noise = {"frequency": 1e-3, "shape": 0.03, "loss_factor": 0.1}
    for stated in (True, False):
        scores, held = [], []
        for draw in range(draws):
            modes = measured(true, 8, [f"{i}:X" for i in range(1, 13)], noise, draw, stated=stated)
            result = updyn.update(start, modes, unknowns)
            found, std = (np.array(list(m.values())) for m in (result.values, result.std))
            scores.append((found - truth) / std)
            bounds = np.array([result.intervals()[p.name] for p in unknowns])
            held.append((bounds[:, 0] < truth) & (truth < bounds[:, 1]))
        for kind in ("stiffness", "loss_factor"):
            own = [p.quantity == kind for p in unknowns]
            rms = np.sqrt(np.mean(np.array(scores)[:, own] ** 2))
            print(
                f"chain, {kind}, noise {'stated' if stated else 'estimated'}: rms of the error"
                f" {rms:.2f} standard deviations; 95 % intervals hold"
                f" {100.0 * np.mean(np.array(held)[:, own]):.0f} % ({draws} draws)"
            )


def bridge_by_kind(along: int = 35, wide: int = 4) -> Model:
    """The bridge of `footbridge(1, 35)` in 17 groups: by kind of bar, in pieces along it."""
    upper = 1 + np.arange((along + 1) * (wide + 1)).reshape(along + 1, wide + 1)
    lower = upper.max() + 1 + np.arange(along * wide).reshape(along, wide)
    kinds = {
        "diagonals": (
            2,
            [(lower, upper[i : along + i, j : wide + j]) for i in (0, 1) for j in (0, 1)],
        ),
        "upper chord": (4, [(upper[:-1], upper[1:])]),
        "lower chord": (4, [(lower[:-1], lower[1:])]),
        "upper bars across": (4, [(upper[:, :-1], upper[:, 1:])]),
        "lower bars across": (3, [(lower[:, :-1], lower[:, 1:])]),
    }
    xyz = np.array(
        [[i, j, 1.0] for i in range(along + 1) for j in range(wide + 1)]
        + [[i + 0.5, j + 0.5, 0.0] for i in range(along) for j in range(wide)]
    )
    parts = []
    for kind, (number, ends) in kinds.items():
        bars = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ends])
        piece = np.minimum(xyz[bars - 1, 0].mean(axis=1) * number // along, number - 1)
        parts += [
            Truss(f"{kind} {k + 1}", bars[piece == k], E, RHO, 1e-3, loss_factor=0.01)
            for k in range(number)
        ]
    return structure(xyz, parts, grounded=[int(n) for n in upper[::along, [0, -1]].flat])


def _mixed_modes(true: Model, dofs: list[str], share: float, rng: np.random.Generator) -> ModeSet:
    """Five modes whose shapes hold a share of the 14 lowest, and 2 % of noise."""
    found, at = updyn.modes(true, 14), true.dofs.match(dofs)
    shapes = found.shapes[at.index].real * at.sign[:, None]
    shapes = shapes / np.sqrt(np.mean(shapes**2, axis=0))
    shapes = shapes[:, :5] + shapes @ (share * rng.standard_normal((14, 5)) / np.sqrt(14.0))
    shapes = shapes + 0.02 * rng.standard_normal(shapes.shape)
    return ModeSet(found.frequency[:5] * (1.0 + 1e-3 * rng.standard_normal(5)), shapes, dofs)


def mixed(draws: int) -> None:
    start = bridge_by_kind()
    upper = [f"{node}:{d}" for node in range(8, 176, 6) for d in "ZY"]
    dofs = (upper + [f"{node}:Z" for node in range(190, 316, 5)])[:58]
    unknowns = updyn.parameters(start, stiffness="all", bounds={"*": (0.2, 5.0)})
    print("\n| other modes | starts | frequency, worst | before | MAC, lowest | before | seconds |")
    print("|---|---|---|---|---|---|---|")
    for share in (0.05, 0.3):
        for starts in (0, 8):
            rows = []
            for draw in range(draws):
                rng = np.random.default_rng(draw)
                modes = _mixed_modes(scattered(start, 0.3, rng), dofs, share, rng)
                begun = time.process_time()
                result = updyn.update(start, modes, unknowns, starts=starts)
                seconds = time.process_time() - begun
                after, before = (updyn.correlate(m, modes) for m in (result.model, start))
                off = [float(np.abs(c.frequency_change).max()) for c in (after, before)]
                rows.append([*off, after.pairs.mac.min(), before.pairs.mac.min(), seconds])
            table = np.array(rows)
            worst = [*table[:, :2].max(axis=0), *table[:, 2:4].min(axis=0), table[:, 4].max()]
            cells = [f"{100 * share:.0f} %", str(starts), f"{worst[0]:.2f} %", f"{worst[1]:.1f} %"]
            cells += [f"{worst[2]:.3f}", f"{worst[3]:.3f}", f"{worst[4]:.1f}"]
            print(f"| {' | '.join(cells)} |", flush=True)


def frequencies(draws: int) -> None:
    model = chain(4, 4)
    f = updyn.modes(model.scaled(_factors((0.871, 1.127, 1.016, 1.036))), 4).frequency
    modes = ModeSet(f, std_frequency=1e-3 * f)
    found, seconds = [], []
    for draw in range(draws):
        rng = np.random.default_rng([3, draw])
        start = model.scaled(_factors(np.exp(rng.uniform(np.log(0.4), np.log(2.5), 4))))
        unknowns = updyn.parameters(start, stiffness="all", bounds={"*": (0.1, 10.0)})
        begun = time.process_time()
        result = updyn.update(start, modes, unknowns)
        seconds.append(time.process_time() - begun)
        found.append(1 + len(result.alternatives))
    print(
        f"chain of four springs from its four frequencies: all four answers in"
        f" {sum(n == 4 for n in found)} of {draws} starts; {np.median(seconds):.1f} s"
    )
    model, seconds, noise = chain(16, 14), [], {"frequency": 1e-3, "shape": 0.03}
    for draw in range(draws):
        rng = np.random.default_rng([4, draw])
        true = scattered(model, 0.3, rng)
        dofs = [f"{i}:X" for i in (16, 13, 10, 8, 5, 2)]
        modes = measured(true, 6, dofs, noise, draw, stated=False)
        begun = time.process_time()
        updyn.update(model, modes, updyn.parameters(model, stiffness="all"))
        seconds.append(time.process_time() - begun)
    print(f"chain of 16 masses, 14 unknowns, six modes: {np.median(seconds):.1f} s")


def _factors(values: Iterable[float]) -> dict[str, dict[str, float]]:
    return {f"piece {k}": {"stiffness": float(v)} for k, v in enumerate(values, 1)}


STUDIES = {
    "exact": exact,
    "bridge": bridge,
    "damping": damping,
    "mixed": mixed,
    "frequencies": frequencies,
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("studies", nargs="*", default=list(STUDIES), help=", ".join(STUDIES))
    parser.add_argument("--draws", type=int, default=10)
    options = parser.parse_args()
    for name in options.studies:
        STUDIES[name](options.draws)
