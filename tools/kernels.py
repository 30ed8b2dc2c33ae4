"""Run tests, such as those marked `kernels`, under several kernels of OpenBLAS.

python tools/kernels.py Haswell Prescott SkylakeX -- -m kernels -n 2
python tools/kernels.py --first Prescott Haswell -- -m kernels -n 2

OpenBLAS chooses its kernel by the processor and adds in another order in each. A kernel that this
processor cannot run, and the one that it uses anyway, are named and left out. ``--first`` takes
only the first of the others, a second order of adding, and the machine's own if there is no other.
"""

from __future__ import annotations

import os
import subprocess
import sys

#: A kernel that the processor lacks instructions for is reported, and ends the process in use. So
#: does a chosen kernel of OpenBLAS 0.3.34 (numpy 2.5.5) on AMD Zen 4 and 5, in products over
#: more than 256 numbers (OpenBLAS issue 6021).
_ASK = """
import numpy, scipy.linalg, threadpoolctl
for kind in (float, complex):
    matrix = numpy.eye(64, 1024, dtype=kind)
    scipy.linalg.lu_factor(matrix @ matrix.T.copy())
libraries = threadpoolctl.threadpool_info()
found = {i["architecture"] for i in libraries if i["internal_api"] == "openblas"}
print(*sorted(found))
"""

#: OpenBLAS reports the first name of those that share a kernel.
_ALIASES = {"Katmai": "Prescott"}


def environment(kernel: str | None) -> dict[str, str]:
    """Return the environment of a process with one thread that uses a kernel; None: the default."""
    kept = {k: v for k, v in os.environ.items() if k != "OPENBLAS_CORETYPE"}
    chosen = {} if kernel is None else {"OPENBLAS_CORETYPE": kernel}
    return kept | chosen | {"OMP_NUM_THREADS": "1"}


def kernels_used(kernel: str | None) -> list[str]:
    """Return the kernels that numpy and scipy use if one is asked for.

    Empty without OpenBLAS, and where the processor cannot run what was asked for.
    """
    asked = subprocess.run(
        [sys.executable, "-c", _ASK],
        env=environment(kernel),
        capture_output=True,
        text=True,
        check=False,
    )
    if asked.returncode:
        return []
    return [_ALIASES.get(name, name) for name in asked.stdout.split()]


def runnable(kernels: list[str]) -> list[str]:
    """Return the kernels that this processor runs besides its own; say which it does not."""
    own, out = kernels_used(None), []
    print(f"this machine's own kernel of OpenBLAS: {', '.join(own) or 'none'}", flush=True)
    for kernel in kernels:
        used = kernels_used(kernel)
        if used == own and kernel in own:
            print(f"{kernel}: the machine's own", flush=True)
        elif used != [kernel]:
            print(f"{kernel}: left out, OpenBLAS uses {', '.join(used) or 'none'}", flush=True)
        else:
            out.append(kernel)
    return out


def main() -> int:
    """Run the tests under each kernel; the exit code is 1 if one fails."""
    words = sys.argv[1:]
    cut = words.index("--") if "--" in words else len(words)
    chosen: list[str | None] = [*runnable([word for word in words[:cut] if word != "--first"])]
    if "--first" in words[:cut]:
        chosen = chosen[:1] or [None]
    failed = []
    for kernel in chosen:
        print(f"== {kernel or 'the own kernel of the machine'}", flush=True)
        run = [sys.executable, "-m", "pytest", *words[cut + 1 :]]
        if subprocess.run(run, env=environment(kernel), check=False).returncode:
            failed.append(kernel or "the own kernel of the machine")
    if failed:
        print(f"failed under {', '.join(failed)}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
