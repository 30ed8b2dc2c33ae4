"""Build the wheel, install it into an empty environment, and run tests against it.

    python tools/wheel_tests.py --dependencies lowest tests/contract tests/unit/engines
    python tools/wheel_tests.py --dependencies newest tests/contract

``lowest`` takes the lowest version of everything that pyproject.toml names for updyn itself, and
the newest of what these need; ``newest`` the newest of all. uv has to be on the path or beside this
Python (``pip install uv``). The source is not on the path: what the wheel lacks is missing.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESOLUTIONS = {"lowest": "lowest-direct", "newest": "highest"}


def run(*words: str | Path, **more: str) -> None:
    """Run a program, and end where it fails."""
    subprocess.run([str(w) for w in words], check=True, cwd=ROOT, env=os.environ | more)


def uv() -> str:
    """Return the path of uv."""
    beside = Path(sys.executable).with_name("uv.exe" if sys.platform == "win32" else "uv")
    found = str(beside) if beside.exists() else shutil.which("uv")
    if found is None:
        raise SystemExit("uv is needed: python -m pip install uv")
    return found


def main() -> None:
    """Build, install, test."""
    ask = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    ask.add_argument("--dependencies", choices=RESOLUTIONS, default="newest")
    ask.add_argument("--extras", default="test", help="installed with the wheel")
    ask.add_argument("--keep", type=Path, help="the environment, kept there for another run")
    ask.add_argument("tests", nargs="*", default=["tests/contract"])
    given, more = ask.parse_known_args()
    with tempfile.TemporaryDirectory() as scratch:
        place = given.keep or Path(scratch) / "environment"
        python = place / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
        if not python.exists():
            run(uv(), "venv", "--quiet", "--seed", "--python", sys.executable, place)
        run(uv(), "build", "--quiet", "--wheel", "--out-dir", scratch)
        (wheel,) = Path(scratch).glob("*.whl")
        install = (uv(), "pip", "install", "--quiet", "--python", python)
        resolution = RESOLUTIONS[given.dependencies]
        # What pyproject.toml names is direct; of a wheel it would not be.
        run(*install, "--resolution", resolution, "-r", "pyproject.toml")
        # Extras beside it, without a change of what was installed.
        run(*install, f"{wheel}[{given.extras}]")
        run(uv(), "pip", "list", "--python", python)
        tests = [str(ROOT / name) for name in given.tests]
        clean = {"PYTHONPATH": "", "OMP_NUM_THREADS": "1"}
        run(python, "-m", "pytest", "-q", "-p", "no:cacheprovider", *more, *tests, **clean)


if __name__ == "__main__":
    main()
