// The controls around the picture, all of them elements that a keyboard reaches.

function made(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in element && key !== "role") element[key] = value;
    else element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}

const options = (pairs) => pairs.map(([value, text]) => made("option", { value, textContent: text }));
const KEYS = "Arrows turn, with Shift they move; + and - zoom, f fits, space plays, n and p go to the next and previous"
  + " sensor, a click picks a node";

export class Panel {
  constructor(element, viewer) {
    this.viewer = viewer;
    const { given } = viewer;
    this.canvas = made("canvas", { tabIndex: 0, role: "img", "aria-label": `${given.title || "Structure"}, three-dimensional. ${KEYS}`, title: "" });
    this.svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    this.svg.setAttribute("aria-hidden", "true");
    this.svg.setAttribute("class", "v-over");
    this.legend = made("div", { className: "v-legend" });
    this.spectrum = made("div", { className: "v-spectrum", hidden: true });
    this.said = made("p", { className: "v-said", "aria-live": "polite" });
    this.stage = made("div", { className: "v-stage" }, this.canvas, this.svg, this.legend, this.said);
    this.chosen();
    this.layers = made("span", { className: "v-layers" });
    this.top = made("div", { className: "v-bar" }, ...this.what, this.layers);
    element.classList.add("updyn-viewer");
    element.replaceChildren(
      this.top, this.stage, this.spectrum,
      made("div", { className: "v-bar v-low" }, ...this.how()),
    );
  }

  field(name, control) { return made("label", {}, `${name} `, control); }

  // What is shown: at rest, modes, operating shapes, and their colours.
  chosen() {
    const { viewer } = this, { given, modes, operating } = viewer;
    const shows = [["rest", "at rest"]];
    if (modes?.rows.length) shows.push(["modes", "modes"]);
    if (operating) shows.push(["operating", "operating shapes"]);
    this.show = made("select", {}, ...options(shows));
    this.row = made("select", {}, ...options((modes?.rows ?? []).map((row, i) => [i, row.label])));
    this.reference = made("select", {}, ...options((operating?.references ?? []).map((one, i) => [i, one.name])));
    const colours = given.colourings.map((colouring, i) => [i, colouring.name]);
    if (shows.length > 1) colours.push(["displacement", "displacement"]);
    colours.push(["none", "none"]);
    this.colour = made("select", {}, ...options(colours));
    const number = (text) => (/^\d+$/.test(text) ? Number(text) : text);
    this.show.addEventListener("change", () => viewer.set({ show: this.show.value }));
    this.row.addEventListener("change", () => viewer.set({ row: Number(this.row.value) }));
    this.reference.addEventListener("change", () => viewer.set({ reference: Number(this.reference.value) }));
    this.colour.addEventListener("change", () => viewer.set({ colouring: number(this.colour.value) }));
    this.fields = {
      show: this.field("Show", this.show), row: this.field("Mode", this.row),
      reference: this.field("Force at", this.reference), colour: this.field("Colours", this.colour),
    };
    this.fields.show.hidden = shows.length < 2;
    this.fields.colour.hidden = colours.length < 2;
    this.what = Object.values(this.fields);
  }

  how() {
    const { viewer } = this;
    const button = (text, title, act) => {
      const one = made("button", { type: "button", textContent: text, title });
      one.addEventListener("click", act);
      return one;
    };
    const slider = (name, [min, max, step, value], act) => {
      const one = made("input", { type: "range", min, max, step, value });
      one.addEventListener("input", () => act(Number(one.value)));
      return this.field(name, one);
    };
    this.play = button("Pause", "Space", () => this.toggle());
    this.phases = made("input", { type: "range", min: 0, max: 360, step: 1, value: 0, "aria-label": "Phase in degrees" });
    this.phases.addEventListener("input", () => {
      this.playing(false);
      viewer.clock.phase = (Number(this.phases.value) * Math.PI) / 180;
      viewer.phase(viewer.clock.phase);
    });
    this.moving = made("span", { className: "v-moving" }, this.play, this.field("Phase", this.phases),
      slider("Size", [0, 3, 0.05, 1], (amplitude) => { viewer.state.amplitude = amplitude; viewer.phase(viewer.clock.phase); }));
    this.gif = button("GIF", "Save the animation as a GIF", async () => {
      this.gif.disabled = true;
      try { await viewer.keep("gif"); } finally { this.gif.disabled = false; }
    });
    const views = [["Fit", "Everything in view (f)", () => viewer.stage.fit()]];
    for (const name of ["iso", "x", "y", "z"]) views.push([name === "iso" ? "Iso" : name.toUpperCase(), `Look from ${name === "iso" ? "the corner" : name.toUpperCase()}`, () => viewer.stage.look(name)]);
    this.boxOf = new Map();
    const box = (key, text) => {
      const one = made("input", { type: "checkbox", checked: viewer.state[key] });
      one.addEventListener("change", () => viewer.set({ [key]: one.checked }));
      this.boxOf.set(key, one);
      return made("label", {}, one, ` ${text}`);
    };
    this.beside = box("beside", "side by side");
    const node = made("input", { type: "text", inputMode: "numeric", size: 6, "aria-label": "Pick the node of this number" });
    node.addEventListener("change", () => {
      if (node.value.trim() && !viewer.find(Number(node.value))) this.say(`There is no node ${node.value.trim()} here.`);
    });
    const out = [this.moving, made("span", { className: "v-views" }, ...views.map((one) => button(...one)))];
    if (viewer.given.arrows.length) out.push(box("labels", "sensors and forces"));
    if (viewer.given.colourings.some(({ labels }) => labels.some(Boolean))) out.push(box("parts", "labels of parts"));
    out.push(this.beside);
    return [...out, this.field("Node", node), made("span", {}, button("PNG", "Save the picture as a PNG", () => viewer.keep("png")), this.gif)];
  }

  toggle() { this.playing(!this.viewer.clock.playing); }

  playing(playing) {
    this.viewer.clock.play(playing);
    this.play.textContent = playing ? "Pause" : "Play";
  }

  phase(angle) { this.phases.value = Math.round((angle * 180) / Math.PI); }

  // What is shown, in words.
  get shown() {
    const { state, modes, spectrum, operating } = this.viewer;
    if (state.show === "modes") return modes.rows[state.row].label;
    if (state.show === "operating") return `force at ${operating.references[state.reference].name}, ${spectrum.said.textContent}`;
    return "";
  }

  update() {
    const { viewer } = this, { state } = viewer;
    this.show.value = state.show;
    this.row.value = state.row;
    this.reference.value = state.reference;
    this.colour.value = state.colouring;
    this.fields.row.hidden = state.show !== "modes";
    this.fields.reference.hidden = state.show !== "operating";
    this.spectrum.hidden = state.show !== "operating";
    this.moving.hidden = this.gif.hidden = !viewer.moving;
    this.beside.hidden = !viewer.hasSides;
    for (const [key, box] of this.boxOf) box.checked = state[key];
    this.play.textContent = viewer.clock.playing ? "Pause" : "Play";
    this.boxes();
    // no empty bar over a scene without choices
    this.top.hidden = Object.values(this.fields).every((field) => field.hidden) && !this.layers.childElementCount;
  }

  // A box for each layer; what a row lacks cannot be chosen.
  boxes() {
    const { viewer } = this, layers = viewer.layers();
    const mark = layers.map(({ name, missing }) => `${name} ${missing}`).join();
    if (mark === this.layers.dataset.mark) {
      this.layers.querySelectorAll("input").forEach((box, i) => { box.checked = layers[i].shown && !layers[i].missing; });
      return;
    }
    this.layers.dataset.mark = mark;
    this.layers.replaceChildren(...(layers.length < 2 ? [] : layers).map(({ name, colour, style, shown, missing }) => {
      const box = made("input", { type: "checkbox", checked: shown && !missing, disabled: missing });
      box.addEventListener("change", () => {
        const hidden = new Set(viewer.state.hidden);
        if (box.checked) hidden.delete(name); else hidden.add(name);
        viewer.set({ hidden });
      });
      const swatch = made("i", { className: style === "ghost" ? "v-dashed" : "" });
      swatch.style[style === "ghost" ? "borderColor" : "background"] = `var(--${colour})`;
      return made("label", { className: missing ? "v-missing" : "" }, box, swatch, ` ${name}`);
    }));
  }

  say(text) { this.said.textContent = text; }
}
