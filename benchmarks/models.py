"""Models of any size for the benchmarks: solids of eight-node bricks, space frames and chains."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

import updyn
from updyn.elements.structure import Truss, structure

#: Steel, and an element edge of 0.1 m.
E, NU, RHO, EDGE = 2.1e11, 0.3, 7850.0, 0.1


def brick() -> tuple[np.ndarray, np.ndarray]:
    """Stiffness (24, 24) in N/m and consistent mass in kg of a trilinear brick.

    2 x 2 x 2 Gauss points; Hughes, The Finite Element Method (1987), section 3.5. The DOFs are
    x, y, z node by node.
    """
    corners = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=float)
    lame, shear = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
    D = np.zeros((6, 6))
    D[:3, :3] = lame
    D += np.diag([2 * shear] * 3 + [shear] * 3)
    K, M, jacobian = np.zeros((24, 24)), np.zeros((24, 24)), EDGE / 2
    for point in corners / np.sqrt(3.0):
        factors = 1.0 + corners * point
        N = factors.prod(axis=1) / 8
        others = factors[:, [1, 2, 0]] * factors[:, [2, 0, 1]]
        dN = corners / 8 * others / jacobian
        B = np.zeros((6, 24))
        for i in range(3):
            B[i, i::3] = dN[:, i]
        for row, (i, j) in enumerate(((1, 2), (0, 2), (0, 1)), start=3):
            B[row, i::3], B[row, j::3] = dN[:, j], dN[:, i]
        K += B.T @ D @ B * jacobian**3
        M += RHO * np.kron(np.outer(N, N), np.eye(3)) * jacobian**3
    return K, M


def solid(cells: tuple[int, int, int], parts: int = 20, *, lumped: bool = False) -> updyn.Model:
    """A block of bricks clamped at its lower end, in `parts` layers with loss factors of 1 to 4 %.

    Parameters
    ----------
    cells : (int, int, int)
        Bricks in x, y and z; 3 (x+1) (y+1) z DOFs.
    parts : int
        Groups, layers along z.
    lumped : bool
        A diagonal mass: half the memory.
    """
    nx, ny, nz = (c + 1 for c in cells)
    node = np.arange(nx * ny * nz).reshape(nz, ny, nx)
    x, y, z = (i.ravel() for i in np.meshgrid(*(np.arange(c) for c in cells), indexing="ij"))
    corner = np.stack(
        [node[z + c, y + b, x + a] for c in (0, 1) for b in (0, 1) for a in (0, 1)], axis=1
    )
    held = 3 * nx * ny
    dofs = (3 * corner[:, :, None] + np.arange(3)).reshape(len(corner), 24) - held
    K, M = brick()
    if lumped:
        M = np.diag(M.sum(axis=1))
    layer = z * parts // cells[2]
    n = 3 * nx * ny * nz - held
    groups = {
        f"layer {part + 1}": updyn.Group(
            _assemble(dofs[layer == part], K, n),
            _assemble(dofs[layer == part], M, n),
            loss_factor=0.01 + 0.03 * (part % 4) / 3,
        )
        for part in range(parts)
    }
    labels = [f"{i + 1}:{d}" for i in range(n // 3) for d in "XYZ"]
    return updyn.Model.from_groups(groups, labels)


def _assemble(dofs: np.ndarray, local: np.ndarray, n: int) -> sp.csr_array:
    i, j = np.nonzero(local)
    rows, columns = dofs[:, i].ravel(), dofs[:, j].ravel()
    values = np.tile(local[i, j], len(dofs))
    free = (rows >= 0) & (columns >= 0)
    return sp.csr_array(
        sp.coo_array(
            (values[free], (rows[free].astype(np.int32), columns[free].astype(np.int32))),
            shape=(n, n),
        )
    )


def footbridge(spans: int = 4, bays: int = 19, wide: int = 4, pieces: int = 0) -> updyn.Model:
    """A double-layer space frame over several spans, in groups with loss factors of 1 to 4 %.

    Parameters
    ----------
    spans, bays : int
        Spans, and squares of 1 m along each of them. The upper layer is held at its edges at the
        ends of each span.
    wide : int
        Squares across. 3 (spans bays (2 wide + 1) + wide + 1) - 6 (spans + 1) DOFs.
    pieces : int
        Groups, as many squares long each; 0: one for each span.

    Notes
    -----
    Node 1 + (wide + 1) i + j is the upper one i m along and j m across; the lower layer stands half
    a square off.
    """
    along = spans * bays
    upper = 1 + np.arange((along + 1) * (wide + 1)).reshape(along + 1, wide + 1)
    lower = upper.max() + 1 + np.arange(along * wide).reshape(along, wide)
    ends = [(lower, upper[i : along + i, j : wide + j]) for i in (0, 1) for j in (0, 1)]
    for layer in (upper, lower):
        ends += [(layer[:-1], layer[1:]), (layer[:, :-1], layer[:, 1:])]
    bars = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ends])
    xyz = np.array(
        [[i, j, 1.0] for i in range(along + 1) for j in range(wide + 1)]
        + [[i + 0.5, j + 0.5, 0.0] for i in range(along) for j in range(wide)]
    )
    number, name = pieces or spans, "piece" if pieces else "span"
    piece = np.minimum(xyz[bars - 1, 0].mean(axis=1) * number // along, number - 1)
    parts = [
        Truss(f"{name} {s + 1}", bars[piece == s], E, RHO, 1e-3, loss_factor=0.01 + 0.01 * (s % 4))
        for s in range(number)
    ]
    return structure(xyz, parts, grounded=[int(n) for n in upper[::bays, [0, -1]].flat])


#: By about how many DOFs.
SOLIDS = {
    "120": (1, 1, 10),
    "1k": (5, 5, 10),
    "10k": (12, 12, 20),
    "50k": (20, 20, 38),
    "150k": (30, 30, 52),
    "300k": (38, 38, 66),
    "500k": (45, 45, 80),
    "1M": (32, 32, 310),  # slender: the factor of a stout one (57 x 57 x 99) takes 17 GiB
}


def sensors(model: updyn.Model, n: int = 30) -> list[str]:
    """DOFs spread over a model, the first three of which carry forces in the benchmarks.

    There are fewer than n where the model has no more.
    """
    spread = np.linspace(model.n_dofs - 1, model.n_dofs // 20, n)
    return [str(model.dofs[i]) for i in dict.fromkeys(spread.astype(int).tolist())]


def chain(n: int, parts: int = 10) -> updyn.Model:
    """Masses of 1 kg on springs of 1e6 N/m, one end held, in `parts` pieces with 2 % of loss."""
    piece = np.arange(n) * parts // n
    groups = {}
    for part in range(parts):
        own = np.flatnonzero(piece == part)
        left = own[own > 0]
        rows = np.concatenate([own, left - 1, own[own > 0], left - 1])
        columns = np.concatenate([own, left - 1, left - 1, left])
        values = 1e6 * np.concatenate([np.ones(len(own) + len(left)), -np.ones(2 * len(left))])
        K = sp.csr_array(sp.coo_array((values, (rows, columns)), shape=(n, n)))
        groups[f"piece {part + 1}"] = updyn.Group(
            K, sp.diags_array((piece == part) * 1.0), loss_factor=0.02
        )
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def drive_train(n: int, parts: int = 10) -> updyn.Model:
    """A shaft line, free to turn: `n` inertias of 0.5 to 1.5 kg m2 between equal shafts.

    Each shaft has 1e6 N m/rad and 20 N m s/rad.
    """
    piece = np.arange(n) * parts // n
    inertia = 1.0 + 0.5 * np.cos(np.arange(n))
    groups = {}
    for part in range(parts):
        left = np.flatnonzero(piece[:-1] == part)
        rows = np.concatenate([left, left + 1, left, left + 1])
        columns = np.concatenate([left, left + 1, left + 1, left])
        values = np.concatenate([np.ones(2 * len(left)), -np.ones(2 * len(left))])
        shafts = sp.csr_array(sp.coo_array((values, (rows, columns)), shape=(n, n)))
        own = {"stiffness": 1e6 * shafts, "viscous": 20.0 * shafts} if len(left) else {}
        groups[f"piece {part + 1}"] = updyn.Group(
            mass=sp.diags_array((piece == part) * inertia), **own
        )
    return updyn.Model.from_groups(groups, [f"{i + 1}:RZ" for i in range(n)])


def full(n: int, parts: int = 5) -> updyn.Model:
    """Groups whose matrices have no zeros, as superelements; natural frequencies from 5 Hz."""
    random = np.random.default_rng(0)
    groups = {}
    for part in range(parts):
        Q = np.linalg.qr(random.normal(size=(n, n)))[0]
        K = (Q * (1e3 * np.linspace(1.0, 100.0, n) ** 2)) @ Q.T
        mass = (Q * np.linspace(0.5, 1.5, n)) @ Q.T
        groups[f"body {part + 1}"] = updyn.Group(
            (K + K.T) / 2, (mass + mass.T) / 2, loss_factor=0.02
        )
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


def damped(model: updyn.Model, viscous: float = 0.0) -> updyn.Model:
    """The same structure without loss factors, with C = `viscous` (s) times K."""
    groups = {}
    for name, g in model.groups.items():
        C = g.stiffness * viscous if viscous else None
        groups[name] = updyn.Group(g.stiffness, g.mass, viscous=C)
    return updyn.Model.from_groups(groups, [str(d) for d in model.dofs])
