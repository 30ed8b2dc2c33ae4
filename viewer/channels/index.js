// All channels in one picture: the level of each over frequency, measured ones below those of a model. The channel
// under the pointer is drawn out, named, and chosen by a click; so it is by keys.
import uPlot from "uplot";
import plain from "uplot/dist/uPlot.min.css";
import style from "./channels.css";

const HEIGHT = 360, NEAR = 24;

function dress() {
  if (document.getElementById("updyn-channels-style")) return;
  document.head.append(Object.assign(document.createElement("style"), { id: "updyn-channels-style", textContent: plain + style }));
}

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim() || "#808080";

// Levels of all channels of a set, each over its own lines, as floats; 0 and what is not finite are gaps.
function levels(values, channels, size) {
  const out = [];
  for (let k = 0; k < channels; k++) {
    const own = new Array(size);
    for (let i = 0, at = 2 * size * k; i < size; i++, at += 2) {
      const level = Math.hypot(values[at], values[at + 1]);
      own[i] = level > 0 && Number.isFinite(level) ? level : null;
    }
    out.push(own);
  }
  return out;
}

// "given": { sets: { measured: { lines, values, colour, width, bold, dash }, ... }, shown, units, names, quantity,
// say(channel), choose(channel) }; the sets are drawn in their order, no channel is -1.
export class Channels {
  constructor(place, given) {
    dress();
    Object.assign(this, { place, given, at: -1 });
    this.n = given.names.length;
    this.kinds = [...new Set(given.units)];
    this.unit = this.kinds[0];
    this.shown = given.shown;
    this.sets = Object.entries(given.sets).map(([key, set]) => ({ key, ...set, levels: levels(set.values, this.n, set.lines.length) }));
    this.log = false;
    place.classList.add("updyn-channels");
    place.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.resize()).observe(place);
    this.draw();
  }

  // Channels of the unit that is shown.
  get channels() { return this.given.names.map((_, k) => k).filter((k) => this.given.units[k] === this.unit); }

  set(changes) {
    Object.assign(this, changes);
    this.draw();
  }

  draw() {
    this.plot?.destroy();
    const sets = this.sets.filter(({ key }) => this.shown.has(key)), channels = this.channels;
    this.drawn = sets;
    const facets = [], series = [{}];
    for (const set of sets) {
      for (const k of channels) {
        facets.push([set.lines, set.levels[k]]);
        series.push({ label: this.given.names[k], stroke: colour(set.colour), width: set.width, points: { show: set.lines.length < 40, size: 4 }, spanGaps: false,
          facets: [{ scale: "x", auto: true, sorted: 1 }, { scale: "y", auto: true }] });
      }
    }
    const axis = { stroke: colour("text"), grid: { stroke: colour("grid"), width: 1 }, ticks: { stroke: colour("faint"), width: 1 }, font: this.font(12), labelFont: this.font(13) };
    const span = this.span(sets, channels);
    this.plot = new uPlot({
      mode: 2, width: this.width, height: HEIGHT, legend: { show: false }, padding: [10, 24, 0, 0],
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false } },
      scales: {
        x: { time: false, distr: this.log ? 3 : 1, range: (u, low, high) => [low, high] },
        y: { distr: 3, range: () => span },
      },
      axes: [
        { ...axis, label: "frequency (Hz)", space: 70, size: 42, labelSize: 22, values: (u, splits) => splits.map((f) => (f === null ? "" : String(Number(f.toPrecision(6))))) },
        { ...axis, label: `${this.given.quantity} magnitude (${this.unit})`, size: 62, labelSize: 24, values: (u, splits) => splits.map(power) },
      ],
      series,
      hooks: {
        ready: [(u) => this.over(u)],
        draw: [() => this.trace()],
      },
    }, [null, ...facets], this.place);
  }

  font(size) { return `${size}px ${getComputedStyle(document.body).fontFamily}`; }

  get width() { return Math.max(this.place.clientWidth, 200); }

  // Whole decades around the levels, at most nine of them from the top.
  span(sets, channels) {
    let low = Infinity, high = 0;
    for (const { levels: own } of sets) {
      for (const k of channels) for (const v of own[k]) if (v !== null) { if (v < low) low = v; if (v > high) high = v; }
    }
    if (!(high > 0)) return [0.1, 1];
    const top = Math.ceil(Math.log10(high) * (1 + 1e-12));
    return [10 ** Math.max(Math.floor(Math.log10(low)), top - 9), 10 ** top];
  }

  // A canvas over the plot, for the one channel that is drawn out.
  over(u) {
    this.canvas = Object.assign(document.createElement("canvas"), { className: "u-traced" });
    this.canvas.style.cssText = "position:absolute;inset:0;pointer-events:none;width:100%;height:100%";
    u.over.append(this.canvas);
    u.over.addEventListener("mousemove", (event) => {
      const box = u.over.getBoundingClientRect();
      this.point(u, event.clientX - box.left, event.clientY - box.top);
    });
    u.over.addEventListener("click", () => { if (this.at >= 0) this.given.choose(this.at); });
  }

  // The channel nearest to the pointer, by the curves that are drawn.
  point(u, left, top) {
    const f = u.posToVal(left, "x");
    let best = -1, least = NEAR;
    for (const { lines, levels: own } of this.drawn) {
      const i = nearest(lines, f);
      for (const k of this.channels) {
        const v = own[k][i];
        if (v === null) continue;
        const away = Math.abs(u.valToPos(v, "y") - top);
        if (away < least) { least = away; best = k; }
      }
    }
    if (best >= 0) this.pick(best);
  }

  pick(k) {
    this.at = k;
    this.trace();
    this.given.say(k);
  }

  trace() {
    const u = this.plot, { canvas } = this;
    if (!u || !canvas) return;
    const ratio = devicePixelRatio || 1, { width, height } = u.over.getBoundingClientRect();
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    if (this.at < 0 || this.given.units[this.at] !== this.unit) return;
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.lineJoin = "round";
    for (const { lines, levels: own, colour: name, bold, dash } of this.drawn) {
      context.strokeStyle = colour(name);
      context.lineWidth = bold;
      context.setLineDash(dash ?? []);
      context.beginPath();
      let pen = false;
      for (let i = 0; i < lines.length; i++) {
        const v = own[this.at][i];
        if (v === null) { pen = false; continue; }
        const x = u.valToPos(lines[i], "x"), y = u.valToPos(v, "y");
        if (pen) context.lineTo(x, y); else context.moveTo(x, y);
        pen = true;
      }
      context.stroke();
    }
  }

  key(event) {
    if (event.altKey || event.ctrlKey || event.metaKey || event.target !== this.place) return;
    const channels = this.channels, at = channels.indexOf(this.at), n = channels.length;
    if (event.key === "ArrowRight") this.pick(channels[(at + 1) % n]);
    else if (event.key === "ArrowLeft") this.pick(channels[(Math.max(at, 0) - 1 + n) % n]);
    else if (event.key === "Escape") this.pick(-1);
    else if (event.key === "Enter" && this.at >= 0) this.given.choose(this.at);
    else return;
    event.preventDefault();
  }

  resize() {
    const { width } = this;
    if (this.plot && this.place.clientWidth && width !== this.plot.width) this.plot.setSize({ width, height: HEIGHT });
  }
}

function nearest(lines, f) {
  let low = 0, high = lines.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (lines[middle] < f) low = middle; else high = middle;
  }
  return f - lines[low] < lines[high] - f ? low : high;
}

// 10 to whole powers; other marks have no text.
const HIGH = { "-": "\u207b", 0: "\u2070", 1: "\u00b9", 2: "\u00b2", 3: "\u00b3", 4: "\u2074", 5: "\u2075", 6: "\u2076", 7: "\u2077", 8: "\u2078", 9: "\u2079" };
function power(value) {
  const exponent = Math.log10(value);
  if (value === null || Math.abs(exponent - Math.round(exponent)) > 1e-9) return "";
  return `10${[...String(Math.round(exponent))].map((sign) => HIGH[sign]).join("")}`;
}
