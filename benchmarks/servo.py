"""Margins of a servo on the updated model, on the drawings and on the true structure.

The azimuth axis of `updyn demo antenna` (`updyn.control.demo`): motor torque, encoders on
motor and turntable, P position loop over PI velocity loop with a notch. One controller as the
drawings would have it set, one with its notch where the updated model has the resonance, each on
the model of the drawings, the updated one, and the hidden truth: margins of the plants, and of the
truth once more line by line, from `updyn.response` and roots of |L| = 1, without any plant. Then
what the update leaves unsure: margins over a family of plants, a weight above it, and whether the
loop is robust by it; the margins of twenty random controllers; and the pointing error of the dish
under wind.

    OMP_NUM_THREADS=1 python benchmarks/servo.py [--run FOLDER of a finished updyn demo antenna]
    [--members 10] [--only-random]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

import updyn
from updyn.control.demo import (
    BAND,
    CONTROLLER,
    FIGURES,
    INPUTS,
    MOTOR,
    OUTPUTS,
    QUANTITIES,
    RATIO,
    TURNTABLE,
    azimuth_plant,
    azimuth_servo,
)
from updyn.control.ports import as_ports
from updyn.control.servo.controller import Controller, Notch
from updyn.control.servo.record import Servo
from updyn.control.space import projection
from updyn.control.spectrum import SpectralDecomposition
from updyn.control.structure import CompiledStructure
from updyn.demos.antenna import TRUTH
from updyn.demos.antenna_model import antenna
from updyn.model import Model
from updyn.updating.result import UpdateResult

_TWO_PI = 2.0 * np.pi
WIND = updyn.Wind(mean_speed=12.0, coefficient=3.0, roughness=0.01)


def updated(run: Path | None) -> UpdateResult:
    """The update of the demo, rotors free."""
    if run is not None:
        return updyn.read_result(run / "rotors free" / "run.nc")
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [sys.executable, "-m", "updyn", "demo", "antenna", "--out", folder], check=True
        )
        return updyn.read_result(Path(folder) / "rotors free" / "run.nc")


# -- line by line ----------------------------------------------------------------------------------
class Exact:
    """Loops of a controller on a model, from its frequency response with structural damping."""

    def __init__(
        self,
        model: Model,
        controller: Controller,
        receptance: Callable[[np.ndarray], np.ndarray] | None = None,
        lines: int = 200,
    ) -> None:
        self.model, self.controller, self.receptance = model, controller, receptance
        freq = np.unique(np.concatenate([np.geomspace(*BAND, lines), np.arange(5.0, 11.0, 0.03)]))
        self.freq = freq
        self.values = np.array([self.loops(f) for f in freq])

    @cache  # noqa: B019
    def loops(self, freq: float) -> tuple[complex, complex]:
        """Loop functions of the velocity and of the position loop at a line in Hz."""
        if self.receptance is None:
            H = updyn.response(self.model, [freq], [MOTOR, TURNTABLE], [MOTOR]).values[0, :, 0]
        else:
            H = self.receptance(np.array([freq]))[0, :, 0]
        H = H / RATIO
        s = 2j * np.pi * freq
        torque = complex(self.controller.torque(s))
        velocity = torque * s * H[0] / RATIO
        return velocity, self.controller.kv * torque * H[1] / (1.0 + velocity)

    def figures(self, loop: int) -> dict[str, float]:
        L = self.values[:, loop]
        gains = self.roots(lambda f: abs(self.loops(f)[loop]) - 1.0, np.abs(L) - 1.0)
        turns = self.roots(lambda f: self.loops(f)[loop].imag, L.imag)
        crossings = [self.loops(f)[loop].real for f in turns]
        negative = [-x for x in crossings if x < 0]
        phases = [np.degrees(np.angle(-self.loops(f)[loop])) for f in gains]
        at = int(np.abs(1.0 + L).argmin())
        near = np.linspace(self.freq[at - 1], self.freq[at + 1], 41)
        return {
            "crossover": gains[0] if gains else np.nan,
            "phase_margin": min(phases, key=abs, default=np.nan),
            "gain_margin_db": min(
                (-20.0 * np.log10(x) for x in negative if x < 1.0), default=np.inf
            ),
            "modulus_margin": min(abs(1.0 + self.loops(f)[loop]) for f in near),
        }

    def roots(self, function: Callable[[float], float], values: np.ndarray) -> list[float]:
        at = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
        return [float(brentq(function, self.freq[i], self.freq[i + 1], xtol=1e-9)) for i in at]


# -- tables ----------------------------------------------------------------------------------------
def figures_of(servo: Servo, loop: int) -> dict[str, float]:
    margins = servo.loops[loop].margins
    return {
        name: getattr(margins, name) if margins.stable else float("nan") for *_, name in FIGURES
    }


def table(models: dict[str, Model], plants: dict[str, updyn.Plant], controller: Controller) -> None:
    servos = {name: azimuth_servo(p, controller) for name, p in plants.items()}
    exact = Exact(models["truth"], controller)
    print(f"| | {' | '.join(servos)} | truth, line by line | drawings off | updated off |")
    print("|---|" + "---|" * (len(servos) + 3))
    for at, loop in enumerate(("velocity", "position")):
        found = {name: figures_of(s, at) for name, s in servos.items()}
        right = exact.figures(at)
        for what, unit, name in FIGURES:
            cells = [f"{values[name]:.4g}" for values in found.values()] + [f"{right[name]:.4g}"]
            off = [100 * (found[one][name] / right[name] - 1.0) for one in ("drawings", "updated")]
            print(
                f"| {loop} loop, {what}{f', {unit}' if unit else ''} | {' | '.join(cells)} |"
                f" {off[0]:+.1f} % | {off[1]:+.2f} % |"
            )
    widths = [f"{s.bandwidth:.4g}" for s in servos.values()]
    print(f"| bandwidth, Hz | {' | '.join(widths)} | | | |", flush=True)


def routes(truth: Model, controller: Controller) -> None:
    """Print the phase margin by each conversion of the damping, and by the default."""
    right = Exact(truth, controller).figures(0)["phase_margin"]
    print(f"\nphase margin of the velocity loop on the truth: {right:.2f} deg line by line")
    for route, error in (
        ("modal", "peak"),
        ("complex", "peak"),
        ("biot", "peak"),
        ("auto", "relative"),
    ):
        made = updyn.plant(
            truth, INPUTS[:1], OUTPUTS[:1], BAND, quantity=QUANTITIES[0], route=route, error=error
        )
        found = updyn.servo(
            made,
            replace(controller, kv=None),
            torque="torque",
            velocity="speed",
            step=None,
            disturbance_step=None,
        )
        margin = found.velocity_loop.margins.phase_margin
        print(
            f"  {made.n_states} states by route {made.route}, error {error!r}: {margin:.2f} deg,"
            f" {100 * (margin / right - 1):+.1f} %"
        )


def family(result: UpdateResult, controller: Controller, members: int) -> None:
    made = updyn.plant_family(result, INPUTS, OUTPUTS, BAND, quantity=QUANTITIES, n=members)
    servo = azimuth_servo(made, controller)
    print(
        f"\n{members} members, all within {100 * made.error:.2g} % of their models; least and"
        " largest margins"
    )
    for loop in servo.loops:
        for name, r in loop.worst.items():
            print(f"  {loop.name} {name}: {r.smallest:.5g} to {r.largest:.5g}")
    own = made.channel("speed", "torque")
    weight = updyn.uncertainty_weight(own)
    (w,) = weight.weights[0]
    print(weight.summary())
    loop = servo.velocity_loop
    T = loop.L / (1.0 + loop.L)
    product = np.abs(w.at(loop.freq) * T)
    at = int(product.argmax())
    print(f"  |W T| of the velocity loop: at most {product[at]:.3g}, at {loop.freq[at]:.3g} Hz")


def receptance(truth: Model) -> Callable[[np.ndarray], np.ndarray]:
    """What answers for the truth at any line: a reduced model proved to 1e-8, without any plant.

    Compared with `updyn.response` of the whole model at some lines.
    """
    structure = CompiledStructure.of(truth)
    ports = as_ports([MOTOR], "input"), as_ports([MOTOR, TURNTABLE], "output")
    found = SpectralDecomposition.of(
        projection(structure, *ports, BAND), structure.system.start
    ).receptance
    freq = np.geomspace(*BAND, 12)
    exact = updyn.response(truth, freq, [MOTOR, TURNTABLE], [MOTOR], tier="sparse").values
    off = (np.abs(found(freq) - exact) / np.abs(exact)).max(axis=(0, 2))
    print(
        f"\nthe truth at 12 lines, off by {off[0]:.1g} at the motor, {off[1]:.1g} at the turntable"
    )
    return found


def random_controllers(truth: Model, count: int = 20) -> None:
    """Compare margins by plants of the truth with those line by line, for random controllers.

    Crossover 2 to 8 Hz, position gain, integral time, notch, low-pass and dead time drawn; those
    that are not stable are left out. Gain margins as factors; margins outside the band are not
    compared.
    """
    answer, rng = receptance(truth), np.random.default_rng(0)
    about = INPUTS[:1], OUTPUTS[:2], BAND
    plants = {
        (error, tolerance): updyn.plant(
            truth, *about, tolerance, quantity=QUANTITIES[:2], error=error
        )
        for error, tolerance in (("peak", 0.02), ("relative", 0.02), ("relative", 0.01))
    }
    names = {"torque": "torque", "velocity": "speed", "position": "azimuth"}
    figures = ("crossover", "phase_margin", "gain_margin", "modulus_margin")
    worst = {key: dict.fromkeys(figures, 0.0) for key in plants}
    beyond = dict.fromkeys(plants, 0)
    done = 0
    while done < count:
        notch = Notch.of_width(
            rng.uniform(8, 11), width=rng.uniform(1, 4), depth=rng.uniform(0, 0.3)
        )
        controller = replace(
            Controller.tuned(
                plants["relative", 0.02],
                rng.uniform(2.0, 8.0),
                torque="torque",
                velocity="speed",
                kv_ratio=rng.uniform(2.0, 8.0),
                low_pass=rng.uniform(30.0, 100.0),
                dead_time=rng.uniform(0.0, 3e-3),
            ),
            notches=(notch,),
        )
        servos = {
            key: updyn.servo(p, controller, **names, step=None, disturbance_step=None)
            for key, p in plants.items()
        }
        if not all(s.stable for s in servos.values()):
            continue
        done += 1
        exact = Exact(truth, controller, answer, lines=2000)
        for key, found in servos.items():
            largest = 0.0
            for k, loop in enumerate(found.loops):
                right, m = exact.figures(k), loop.margins
                right["gain_margin"] = 10.0 ** (right["gain_margin_db"] / 20.0)
                for name in figures:
                    at = getattr(m, f"{name}_at", m.crossover)
                    if at is None or not 1.02 * BAND[0] < at < 0.98 * BAND[1]:
                        continue
                    off = 100.0 * abs(getattr(m, name) / right[name] - 1.0)
                    worst[key][name] = max(worst[key][name], off)
                    largest = max(largest, off)
            beyond[key] += largest > 2.0
    print(f"\n{count} random controllers: largest difference to the margins line by line, %")
    print(
        "| plant | states | crossover | phase margin | gain margin | modulus margin | above 2 % |"
    )
    print("|---|---|---|---|---|---|---|")
    for key, p in plants.items():
        cells = [f"{worst[key][name]:.2g}" for name in figures]
        print(
            f"| {key[0]}, {100 * key[1]:g} % | {p.n_states} {p.route} | {' | '.join(cells)} |"
            f" {beyond[key]} of {count} |",
            flush=True,
        )


def wind(plants: dict[str, updyn.Plant], controller: Controller) -> None:
    print(
        "\npointing error of the dish under wind of 12 m/s, rms about its mean by the spectrum, in"
        " arc seconds"
    )
    for name, p in plants.items():
        servo = updyn.servo(
            p,
            controller,
            torque="torque",
            velocity="speed",
            position="azimuth",
            disturbance="wind",
            pointing="dish",
            step=None,
            disturbance_step=None,
            wind=WIND,
        )
        assert servo.wind is not None
        print(f"  {name}: {np.degrees(servo.wind.rms_expected) * 3600:.4g}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--run", type=Path, help="folder of a finished updyn demo antenna; otherwise it is run"
    )
    parser.add_argument("--members", type=int, default=10)
    parser.add_argument("--only-random", action="store_true", help="only the random controllers")
    args = parser.parse_args()
    if args.only_random:
        random_controllers(antenna().scaled(TRUTH))
        return
    result = updated(args.run)
    models = {
        "drawings": result.start,
        "updated": result.model,
        "truth": result.start.scaled(TRUTH),
    }
    plants = {name: azimuth_plant(model) for name, model in models.items()}
    drives = {
        name: updyn.drive_figures(model, MOTOR, TURNTABLE, ratio=RATIO, band=BAND)
        for name, model in models.items()
    }
    print("torque to motor speed: antiresonances and resonances in Hz")
    for name, drive in drives.items():
        pairs = ", ".join(f"{p.antiresonance:.4g} / {p.resonance:.4g}" for p in drive.pairs)
        print(
            f"  {name}: {pairs}; inertia at the load {drive.inertia * RATIO**2:.5g} kg m2;"
            f" {plants[name]}"
        )
    retuned = replace(
        CONTROLLER,
        notches=(
            Notch.of_width(round(drives["updated"].pairs[-1].resonance, 2), width=1.9, depth=0.05),
        ),
    )
    for title, controller in (
        ("as the drawings would have it", CONTROLLER),
        ("by the updated model", retuned),
    ):
        print(f"\ncontroller {title}:\n{controller.summary()}\n")
        table(models, plants, controller)
    routes(models["truth"], CONTROLLER)
    random_controllers(models["truth"])
    wind(plants, retuned)
    family(result, retuned, args.members)


if __name__ == "__main__":
    main()
