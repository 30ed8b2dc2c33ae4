"""Write docs/public-names.txt: the names that the deprecation policy covers.

    python tools/public_names.py

These are ``updyn.__all__`` and what each room below lists in its own ``__all__``. A test compares
the file with the package, so that no public name comes or goes unseen.
"""

from __future__ import annotations

import importlib
from pathlib import Path

FILE = Path(__file__).parents[1] / "docs" / "public-names.txt"

#: Rooms whose names are for users, besides those of the package itself.
ROOMS = (
    "updyn.comparison",
    "updyn.correlation",
    "updyn.demos",
    "updyn.elements",
    "updyn.elements.constraints",
    "updyn.elements.drivetrain",
    "updyn.elements.mesh",
    "updyn.elements.structure",
    "updyn.engines",
    "updyn.errors",
    "updyn.io",
    "updyn.job",
    "updyn.matching",
    "updyn.modal",
    "updyn.planning",
    "updyn.plots",
    "updyn.registry",
    "updyn.report",
    "updyn.viewer",
)


def public_names() -> list[str]:
    """Return every public name with its room, sorted; names of the package stand there only.

    Returns
    -------
    list of str
        Such as ``"updyn.update"`` or ``"updyn.correlation.mac"``.
    """
    package = importlib.import_module("updyn")
    names = [f"updyn.{name}" for name in package.__all__]
    seen = {id(getattr(package, name)) for name in package.__all__}
    for room in ROOMS:
        module = importlib.import_module(room)
        names += [f"{room}.{n}" for n in module.__all__ if id(getattr(module, n)) not in seen]
    return sorted(names)


def main() -> None:
    """Write the file."""
    FILE.write_text("".join(f"{name}\n" for name in public_names()), encoding="utf-8")


if __name__ == "__main__":
    main()
