// The FRF of a reference as a small curve, and the frequency on it: a slider that keys move too.

const SVG = "http://www.w3.org/2000/svg", WIDTH = 1000, HEIGHT = 90;

function path(freq, curve, span) {
  const [low, high] = span, f0 = freq[0], f1 = freq[freq.length - 1] - f0 || 1;
  let d = "", pen = "M";
  for (let i = 0; i < freq.length; i++) {
    const level = Math.log10(curve[i]);
    if (!Number.isFinite(level)) { pen = "M"; continue; }
    const x = ((freq[i] - f0) / f1) * WIDTH, y = 4 + (1 - (level - low) / (high - low || 1)) * (HEIGHT - 8);
    d += `${pen}${x.toFixed(1)} ${y.toFixed(1)}`;
    pen = "L";
  }
  return d;
}

export class Spectrum {
  constructor(place, operating, onLine) {
    this.operating = operating;
    this.place = place;
    this.svg = document.createElementNS(SVG, "svg");
    this.svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
    this.svg.setAttribute("preserveAspectRatio", "none");
    this.svg.setAttribute("aria-hidden", "true");
    this.slider = Object.assign(document.createElement("input"), { type: "range", min: 0, max: operating.freq.length - 1, step: 1 });
    this.slider.setAttribute("aria-label", "Frequency");
    this.said = document.createElement("output");
    place.append(this.svg, this.slider, this.said);
    this.slider.addEventListener("input", () => { this.mark(); onLine(this.line); });
    const follow = (event) => {
      if (event.type === "pointermove" && !event.buttons) return;
      const box = this.svg.getBoundingClientRect();
      this.to(operating.freq[0] + ((event.clientX - box.left) / box.width) * (operating.freq.at(-1) - operating.freq[0]));
      onLine(this.line);
    };
    this.svg.addEventListener("pointerdown", follow);
    this.svg.addEventListener("pointermove", follow);
  }

  get line() { return Number(this.slider.value); }

  // The line nearest to a frequency in Hz.
  to(freq) {
    let best = 0;
    this.operating.freq.forEach((value, i) => { if (Math.abs(value - freq) < Math.abs(this.operating.freq[best] - freq)) best = i; });
    this.slider.value = best;
    this.mark();
  }

  show(reference, layers) {
    let low = Infinity, high = -Infinity;
    for (const { curve } of layers) for (const value of curve) if (value > 0) { low = Math.min(low, Math.log10(value)); high = Math.max(high, Math.log10(value)); }
    this.svg.replaceChildren(...layers.map(({ colour, style, curve }) => {
      const line = document.createElementNS(SVG, "path");
      line.setAttribute("d", path(this.operating.freq, curve, [low, high]));
      line.style.stroke = `var(--${colour})`;
      if (style === "ghost") line.style.strokeDasharray = "5 4";
      return line;
    }), this.cursor = document.createElementNS(SVG, "line"));
    this.cursor.setAttribute("y1", 0);
    this.cursor.setAttribute("y2", HEIGHT);
    if (!this.started) { // the highest peak is where there is most to see
      this.started = true;
      const { curve } = layers[0];
      this.slider.value = curve.reduce((best, value, i) => (value > curve[best] ? i : best), 0);
    }
    this.mark();
  }

  mark() {
    const { freq } = this.operating, x = ((freq[this.line] - freq[0]) / (freq.at(-1) - freq[0] || 1)) * WIDTH;
    for (const end of ["x1", "x2"]) this.cursor?.setAttribute(end, x);
    const text = `${Number(freq[this.line].toPrecision(5))} Hz`;
    this.said.textContent = text;
    this.slider.setAttribute("aria-valuetext", text);
  }
}
