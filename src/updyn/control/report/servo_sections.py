"""The section on the servo: drive figures, margins of the loops over the family, what the loop does over time."""

from __future__ import annotations

import math
from collections.abc import Mapping

from updyn.control.job.plant_result import Planted
from updyn.control.report.nonlinear import nonlinear_figures, nonlinear_part
from updyn.control.report.servo_figures import servo_figures
from updyn.control.servo.drive_figures import DriveFigures
from updyn.control.servo.margins import Margins
from updyn.control.servo.record import Loop, Servo, StepResponse, WindResponse
from updyn.report import formats as w
from updyn.report import markup as m
from updyn.report.plots import Figure
from updyn.report.section import Content, Section

__all__ = ["SERVO"]

#: Crossings that are listed for each loop at most.
_CROSSINGS = 12


class ServoSection(Section):
    """The servo on the plant of a job, and the figures of its drive."""

    anchor = "servo"
    name = "Servo"
    heading = "Servo"
    place = 2100

    def applies(self, content: Content) -> bool:
        """Whether there is a servo or a drive: any page shows it."""
        planted: Planted = content.further["plant"]
        return planted.servo is not None or planted.drive is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return loops, responses over time, and simulations with backlash or friction."""
        planted: Planted = content.further["plant"]
        if planted.servo is None:
            return {}
        assert planted.plant is not None
        return nonlinear_figures(planted.nonlinear) | servo_figures(planted.servo, planted.plant)

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return words, tables and places of figures."""
        return _body(content.further["plant"], figures)


SERVO = ServoSection()


def _body(planted: Planted, figures: Mapping[str, Figure]) -> str:
    parts = []
    if planted.servo is not None:
        parts += _servo(planted.servo, figures)
        parts += [
            nonlinear_part(number, found, figures) for number, found in enumerate(planted.nonlinear)
        ]
    if planted.drive is not None:
        parts.append(_drive(planted.drive))
    return "".join(parts)


# -- the loop ---------------------------------------------------------------------------------------------------
def _servo(servo: Servo, figures: Mapping[str, Figure]) -> list[str]:
    parts = [
        m.paragraph(_verdict(servo), "lead"),
        m.note(*map(_sentence, servo.notes)),
        _tiles(servo),
        _controller(servo),
    ]
    parts.append(_margins(servo))
    for loop in servo.loops:
        caption = (
            f"L of the {loop.name} loop, broken at the {loop.name}"
            + (
                ", the velocity loop closed"
                if loop.name == "position"
                else ", the position loop open"
            )
            + (
                f"; the band holds the {len(loop.members)} plants of the family"
                if loop.members
                else ""
            )
            + ". Circles: where the margins are read; dotted: 0 dB and −180°."
        )
        nichols = (
            "The same in the Nichols plane. Inside the dashed line the sensitivity is above 6 dB."
        )
        parts.append(
            f"<h3>{m.esc(loop.name.capitalize())} loop</h3><div class='pair wide'>"
            + f"<div>{_place(figures, f'bode-{loop.name}', f'Bode diagram of the {loop.name} loop', caption)}</div>"
            + f"<div>{_place(figures, f'nichols-{loop.name}', f'Nichols plot of the {loop.name} loop', nichols)}</div>"
            + "</div>"
            + _crossings(loop)
        )
    parts.append("<h3>Closed loop</h3>")
    bandwidth = (
        ""
        if servo.bandwidth is None
        else f" Vertical: the bandwidth, {w.number(servo.bandwidth, 4)} Hz (−3 dB)."
    )
    caption = f"From the reference, and the sensitivity of the outer loop.{bandwidth}"
    parts.append(_place(figures, "closed-loop", "Closed loop and sensitivity", caption))
    over_time = [
        ("step", "Step of the reference", None if servo.step is None else _step(servo.step)),
        (
            "disturbance-step",
            "Step of the disturbance",
            None if servo.disturbance_step is None else _step(servo.disturbance_step),
        ),
        ("wind", "Wind", None if servo.wind is None else _wind(servo.wind)),
    ]
    places = [
        f"<div><h3>{m.esc(heading)}</h3>{_place(figures, name, heading, said)}</div>"
        for name, heading, said in over_time
        if said is not None
    ]
    if places:
        parts.append(f"<div class='pair wide'>{''.join(places)}</div>")
    return parts


def _place(figures: Mapping[str, Figure], name: str, alternative: str, caption: str) -> str:
    if name not in figures:
        return ""
    return m.figure(name, alternative, caption, height=figures[name]["height"])


def _verdict(servo: Servo) -> str:
    if not all(loop.margins.stable for loop in servo.loops):
        return "The loop is UNSTABLE on the nominal plant; its crossings are no margins."
    bad = sorted({i for loop in servo.loops for i in loop.unstable_members})
    count = len(servo.loops[0].members)
    if bad:
        return (
            f"The loop is stable on the nominal plant, and UNSTABLE on {len(bad)} of {count} plants"
            " of the family."
        )
    return "The loop is stable" + (f", on all {count} plants of the family too." if count else ".")


def _tiles(servo: Servo) -> str:
    smallest = (
        "smallest of all loops and plants"
        if servo.velocity_loop.members
        else "smallest of the loops"
    )
    outer, inner = servo.loops[-1].margins, servo.velocity_loop.margins
    tiles = [("Bandwidth", _hz(servo.bandwidth), f"closed {servo.loops[-1].name} loop, −3 dB")]
    if servo.position_loop is not None:
        tiles.append(("Position crossover", _hz(outer.crossover), "|L| falls through 1"))
    tiles.append(("Velocity crossover", _hz(inner.crossover), "|L| falls through 1"))
    tiles.append(("Phase margin", _degrees(_worst_of(servo, "phase_margin")), smallest))
    gain = _worst_of(servo, "gain_margin")
    tiles.append(("Gain margin", _db(gain), smallest))
    modulus = _worst_of(servo, "modulus_margin")
    tiles.append(("Modulus margin", w.number(modulus, 3), "smallest |1 + L|; above 0.5 is usual"))
    if servo.wind is not None:
        unit = servo.wind.output_unit
        tiles.append(
            (
                "Error in wind",
                f"{w.number(servo.wind.rms, 3)} {unit}",
                f"rms of {servo.wind.output}",
            )
        )
    made = "".join(
        f"<div><dt>{m.esc(name)}</dt><dd>{m.esc(value)}<small>{m.esc(hint)}</small></dd></div>"
        for name, value, hint in tiles
    )
    return f'<dl class="tiles">{made}</dl>'


def _worst_of(servo: Servo, name: str) -> float | None:
    found = [getattr(each, name) for loop in servo.loops for each in (loop.margins, *loop.members)]
    if any(not each.stable for loop in servo.loops for each in (loop.margins, *loop.members)):
        return None
    known = [v for v in found if v is not None]
    return min(known, key=abs) if known else None


def _controller(servo: Servo) -> str:
    c = servo.controller
    rows = [
        (
            "gain of the velocity loop, kp",
            f"{w.number(c.kp, 5)} (unit of {servo.torque} per unit of velocity)",
        ),
        ("integral time, ti", "none" if c.ti is None else f"{w.number(c.ti, 5)} s"),
        ("gain of the position loop, kv", "none" if c.kv is None else f"{w.number(c.kv, 5)} 1/s"),
    ]
    rows += [
        (
            "notch",
            (
                f"{w.number(n.frequency, 5)} Hz, width {w.number(n.width, 4)} Hz, depth"
                f" {w.number(n.depth, 3)}"
            ),
        )
        for n in c.notches
    ]
    if c.low_pass is not None:
        order = (
            "first order"
            if c.low_pass_damping is None
            else f"damping ratio {w.number(c.low_pass_damping, 3)}"
        )
        rows.append(("low-pass", f"{w.number(c.low_pass, 5)} Hz, {order}"))
    if c.feed_forward:
        rows.append(("velocity feed-forward", f"{w.number(100 * c.feed_forward, 3)} %"))
    rows.append(("dead time", f"{w.number(1e3 * c.dead_time, 4)} ms" if c.dead_time else "none"))
    reads = f"{servo.torque} → {servo.velocity}" + (f", {servo.position}" if servo.position else "")
    inertia = servo.plant.get("inertia")
    rows = [("loop", reads), *rows]
    if inertia is not None:
        rows.append(("rigid-body inertia of the plant", w.number(float(inertia), 5)))
    return m.details("Controller", m.definition_table(rows))


# -- margins ----------------------------------------------------------------------------------------------------
def _margins(servo: Servo) -> str:
    head, kinds = ["figure"], [""]
    for loop in servo.loops:
        head += [f"{loop.name} loop", "at"] + (["worst of family", "plant"] if loop.members else [])
        kinds += ["", ""] + (["", ""] if loop.members else [])
    rows = []
    for title, name, say in _FIGURES:
        cells = [title]
        for loop in servo.loops:
            cells += [say(getattr(loop.margins, name)), _hz(_at(loop.margins, name))]
            if loop.members:
                spread = loop.worst[name]
                high = name == "gain_reduction"
                value = spread.largest if high else spread.smallest
                which = spread.largest_member if high else spread.smallest_member
                none = which is None or say(value) in ("–", "∞")
                cells += [say(value), "–" if none else str(which)]
        if any(cell != "–" for cell in cells[1:]):
            rows.append(m.row(cells, kinds))
    closed = ["closed-loop bandwidth"]
    for loop in servo.loops:
        closed += [_hz(loop.bandwidth), "–"] + (["–", "–"] if loop.members else [])
    rows.append(m.row(closed, kinds))
    caption = "Margins; a dash: there is none, as the loop is unstable or nothing bounds it"
    caption += ". Plants of the family are counted from 0" if servo.loops[0].members else ""
    bad = [
        f"{loop.name} loop: plants {_listed(loop.unstable_members)}"
        for loop in servo.loops
        if loop.unstable_members
    ]
    some = any(0 < len(loop.unstable_members) < len(loop.members) for loop in servo.loops)
    rest = " The worst are of the stable ones." if some else ""
    more = m.note(f"Unstable: {'; '.join(bad)}.{rest}") if bad else ""
    return m.table(head, rows, caption=caption, kinds=kinds) + more


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")


def _listed(members: tuple[int, ...]) -> str:
    return ", ".join(str(i) for i in members[:12]) + (", ..." if len(members) > 12 else "")


def _at(margins: Margins, name: str) -> float | None:
    return margins.crossover if name == "crossover" else getattr(margins, f"{name}_at", None)


def _hz(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{w.number(value, 4)} Hz"


def _degrees(value: float | None) -> str:
    return "–" if value is None or not math.isfinite(value) else f"{w.number(value, 3)}°"


def _db(value: float | None) -> str:
    if value is None or math.isnan(value) or value <= 0:
        return "–"
    return "∞" if math.isinf(value) else f"{w.number(20.0 * math.log10(value), 3)} dB"


def _ms(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "–"
    return "∞" if math.isinf(value) else f"{w.number(1e3 * value, 3)} ms"


_FIGURES = (
    ("crossover", "crossover", _hz),
    ("phase margin", "phase_margin", _degrees),
    ("gain margin", "gain_margin", _db),
    ("gain reduction", "gain_reduction", _db),
    ("delay margin", "delay_margin", _ms),
    ("modulus margin", "modulus_margin", lambda v: w.number(v, 3)),
)


def _crossings(loop: Loop) -> str:
    found = loop.margins
    rows = [
        (
            float(f),
            m.row(
                [_hz(float(f)), "|L| = 1", _degrees(float(p)), f"delay {_ms(float(d))}"],
                ("", "text", "", ""),
            ),
        )
        for f, p, d in zip(
            found.gain_crossings, found.phase_margins, found.delay_margins, strict=True
        )
    ] + [
        (float(f), m.row([_hz(float(f)), "phase −180°", _db(float(g)), ""], ("", "text", "", "")))
        for f, g in zip(found.phase_crossings, found.gain_margins, strict=True)
    ]
    if not rows:
        return ""
    shown = [text for _, text in sorted(rows, key=lambda r: r[0])[:_CROSSINGS]]
    more = f"; the first {_CROSSINGS} of {len(rows)}" if len(rows) > _CROSSINGS else ""
    table = m.table(["at", "crossing", "margin", ""], shown, kinds=("", "text", "", ""))
    return m.details(f"All crossings of the {loop.name} loop{more}", table)


# -- over time --------------------------------------------------------------------------------------------------
def _step(step: StepResponse) -> str:
    if step.of == "disturbance":
        text = (
            f"{w.number(step.size, 4)} {step.input_unit} at {step.input}: {step.output} deviates by"
            " at most "
        )
        text += f"{w.number(step.peak, 4)} {step.output_unit} after {w.number(step.peak_time, 3)} s"
        return f"{text}, and comes to {w.number(step.final, 4)} {step.output_unit}."
    said = (
        []
        if step.rise_time is None
        else [f"rises from 10 to 90 % in {w.number(step.rise_time, 3)} s"]
    )
    if step.overshoot is not None:
        said.append(f"overshoots by {w.number(100 * step.overshoot, 3)} %")
    if step.settling_time is None:
        said.append("is not within 2 % when the record ends")
    else:
        said.append(f"stays within 2 % after {w.number(step.settling_time, 3)} s")
    return f"A step of {w.number(step.size, 4)} {step.input_unit} {', '.join(said)}."


def _wind(wind: WindResponse) -> str:
    text = f"{wind.output} is off by {w.number(wind.rms, 3)} {wind.output_unit} rms, at most by "
    text += (
        f"{w.number(wind.peak, 3)} {wind.output_unit}; in the mean by {w.number(wind.mean, 3)}"
        f" {wind.output_unit}."
    )
    if wind.rms_expected is not None:
        text += (
            f" From the spectrum, mean left out: {w.number(wind.rms_expected, 3)}"
            f" {wind.output_unit} rms."
        )
    return text


# -- the drive --------------------------------------------------------------------------------------------------
def _drive(drive: DriveFigures) -> str:
    mass, stiff = ("kg m²", "N m/rad") if "R" in drive.motor else ("kg", "N/m")
    load_mass, load_stiff = ("kg m²", "N m/rad") if "R" in drive.load else ("kg", "N/m")
    rows = [
        ("gear ratio", _ratio(drive), ""),
        ("inertia at the motor", w.number(drive.inertia, 5), f"{mass}, all in rigid-body motion"),
        ("the motor's own", w.number(drive.motor_inertia, 5), mass),
        ("the rest, at the motor", w.number(drive.rest_inertia, 5), mass),
        ("the rest, at the load", w.number(drive.load_inertia, 5), load_mass),
        ("inertia ratio", w.number(drive.inertia_ratio, 4), "rest over motor, at the motor"),
        ("stiffness at the motor", w.number(drive.stiffness_at_motor, 5), f"{stiff}, load held"),
        (
            "stiffness at the load",
            w.number(drive.stiffness_at_load, 5),
            f"{load_stiff}, motor held",
        ),
    ]
    if drive.first_resonance is not None:
        rows.append(("first resonance", w.number(drive.first_resonance, 5), "Hz"))
    kinds = ("", "", "text")
    parts = [
        f"<h3>The drive from {m.esc(drive.motor)} to {m.esc(drive.load)}</h3>",
        m.note(*drive.notes),
        m.table(["figure", "value", ""], [m.row(row, kinds) for row in rows], kinds=kinds),
    ]
    if drive.pairs:
        pairs = [
            m.row(
                [
                    w.number(v, 5)
                    for v in (
                        p.antiresonance,
                        p.antiresonance_damping,
                        p.resonance,
                        p.resonance_damping,
                    )
                ]
            )
            for p in drive.pairs
        ]
        head = ["antiresonance (Hz)", "damping ratio", "resonance (Hz)", "damping ratio"]
        caption = (
            "Torque to motor speed: antiresonances are the frequencies with the rotor locked,"
            " resonances with it free"
        )
        parts.append(m.table(head, pairs, caption=caption))
    if drive.bandwidth is not None:
        parts.append(m.paragraph(drive.bandwidth.rule))
    return "".join(parts)


def _ratio(drive: DriveFigures) -> str:
    return "–" if drive.ratio is None else f"{w.number(drive.ratio, 6)} ({drive.ratio_from})"
