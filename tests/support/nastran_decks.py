"""A deck with elements of all kinds: a stiffened plate on springs, with a box of solids, ties and local systems."""

from __future__ import annotations

from pathlib import Path

from updyn.errors import FormatError
from updyn.io.nastran.fields import format_field
from updyn.io.nastran.mystran import find_executable

NX, NY = 6, 4


def mystran() -> Path | None:
    """Return MYSTRAN's path, None where it is not there."""
    try:
        return find_executable("test")
    except FormatError:
        return None


def number(i: int, j: int) -> int:
    return 100 * (j + 1) + i + 1


def plate(case: str = "SPC = 1\nMPC = 9\n", extra: str = "", mm: bool = False) -> str:
    """Return the deck in m, kg, N, or in mm, t, N."""
    s = 1e3 if mm else 1.0  # length
    E, rho, k, kr, m, inertia = (
        (7e4, 2.7e-9, 2e3, 5e6, 2e-3, 4.0) if mm else (7e10, 2700.0, 2e6, 5e3, 2.0, 4e-3)
    )
    steel = (2.1e5, 7.85e-9) if mm else (2.1e11, 7850.0)
    lines = [
        "SOL 103",
        "CEND",
        "TITLE = stiffened plate",
        case + "METHOD = 7",
        "BEGIN BULK",
        "EIGRL,7,,,8",
    ]
    lines += ["CORD2C,5,,0.,0.,0.,0.,0.,1.,", ",1.,0.,0."]
    for j in range(NY + 1):
        for i in range(NX + 1):
            local = 5 if (i, j) in ((3, 2), (4, 2), (2, 4)) else ""
            z = 0.01 * s * i * (NX - i)
            lines.append(
                f"GRID,{number(i, j)},,{0.1 * s * i:.4f},{0.12 * s * j:.4f},{z:.4f},{local}"
            )
    for j in range(NY):
        for i in range(NX):
            nodes = [number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)]
            pid = 1 if i < 3 else 2
            lines.append(f"CQUAD4,{1000 + 10 * j + i},{pid}," + ",".join(map(str, nodes)))
    lines += [f"CBAR,{2000 + i},3,{number(i, 2)},{number(i + 1, 2)},0.,0.,1." for i in range(NX)]
    corners = [number(0, 0), number(NX, 0), number(0, NY), number(NX, NY)]
    lines += [f"CELAS1,{2100 + n},4,{c},3" for n, c in enumerate(corners)]
    lines += [f"CELAS2,{2110 + n},{k / 4},{c},1" for n, c in enumerate(corners[:1])]
    # A mass beside the plate, carried rigidly, and one hung in the mean of four grids
    lines += [f"GRID,901,,{0.7 * s},{0.24 * s},{0.1 * s}", f"RBE2,9001,{number(NX, 2)},123456,901"]
    lines += [f"CONM2,9101,901,,{m},,,,,", f",{inertia},,{inertia},,,{inertia}"]
    lines += [f"GRID,902,,{0.15 * s},{0.3 * s},{0.2 * s}"]
    lines += [
        f"RBE3,9002,,902,123456,1.,123,{number(1, 2)},{number(2, 2)},",
        f",{number(1, 3)},{number(2, 3)}",
    ]
    lines += [f"CONM2,9102,902,,{m / 2}"]
    # A box of two solids that stands on the plate's edge, and a bushing to the ground behind it
    box = {}
    for n, (x, y, z) in enumerate([(a, b, c) for a in (0, 1, 2) for b in (0, 1) for c in (0, 1)]):
        box[x, y, z] = 701 + n
        lines.append(
            f"GRID,{701 + n},,{s * (0.2 + 0.05 * x):.4f},{s * (-0.1 - 0.05 * y):.4f},{s * 0.05 * z:.4f}"
        )
    for x in (0, 1):
        ring = [(x, 1, 0), (x + 1, 1, 0), (x + 1, 0, 0), (x, 0, 0)]
        nodes = [box[a] for a in ring] + [box[a[0], a[1], 1] for a in ring]
        lines += [f"CHEXA,{2200 + x},6,{','.join(map(str, nodes[:6]))},", f",{nodes[6]},{nodes[7]}"]
    lines += [f"RBE2,9003,{number(2, 0)},123456,{box[0, 0, 0]},{box[1, 0, 0]},{box[0, 0, 1]}"]
    lines += [
        f"GRID,903,,{0.3 * s},{0.24 * s},{-0.2 * s},,123456",
        f"CBUSH,2300,8,{number(3, 2)},903,,,,0",
    ]
    lines += [f"MPC,9,{number(0, 1)},3,1.,{number(0, 2)},3,-1."]
    lines += [f"SPC1,1,2,{corners[0]},{corners[2]}"]
    lines += [f"PSHELL,1,1,{0.004 * s},1,,1,,{format_field(rho * 0.001 * s)}"]
    lines += [f"PSHELL,2,1,{0.003 * s},1,,1"]
    lines += ["PBARL,3,1,,BAR,,,,,", f",{0.01 * s},{0.02 * s}"]
    lines += [f"PELAS,4,{k},0.04", "PSOLID,6,2,,2,,1", f"PBUSH,8,K,{k},{k},{k},{kr},{kr},{kr}"]
    lines += [f"MAT1,1,{format_field(E)},,0.33,{format_field(rho)},,,0.02"]
    lines += [f"MAT1,2,{format_field(steel[0])},,0.3,{format_field(steel[1])}"]
    return "\n".join([*lines, extra, "ENDDATA", ""])
