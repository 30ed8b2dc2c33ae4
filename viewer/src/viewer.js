// The viewer of one scene in one element: state, and what follows from it.
import { Vector3 } from "three";
import { Actor, BY_DISPLACEMENT, BY_GROUP, PLAIN } from "./actor.js";
import { arrowsOf } from "./arrows.js";
import { Body } from "./body.js";
import { Clock } from "./clock.js";
import { css, rgb } from "./colours.js";
import { drawLegend } from "./legend.js";
import { Overlay } from "./overlay.js";
import { Panel } from "./panel.js";
import { nodeAt } from "./picking.js";
import { gif, png, save } from "./saving.js";
import { ModeShapes, OperatingShapes, levelled, reach, TURNS } from "./shapes.js";
import { Spectrum } from "./spectrum.js";
import { Stage } from "./stage.js";

const MANY_FACES = 20000;
const written = (value) => Number(value.toPrecision(5)).toString();

export class Viewer {
  constructor(element, given) {
    this.element = element;
    this.given = given;
    this.state = {
      show: "rest", row: 0, reference: 0, line: 0, colouring: given.colourings.length ? 0 : "none", amplitude: 1,
      labels: true, hidden: new Set(),
    };
    this.bodies = given.bodies.map((body) => new Body(body));
    this.modes = given.modes && new ModeShapes(given.modes, this.bodies);
    this.operating = given.operating && new OperatingShapes(given.operating, this.bodies);
    this.picked = -1;
    this.panel = new Panel(element, this);
    this.stage = new Stage(this.panel.stage, this.panel.canvas, this.bodies.map((body) => body.xyz), this.bodies.every((body) => body.faces.length < 3 * MANY_FACES), this.panel.legend);
    if (this.modes || this.operating) this.stage.sway = reach(this.stage.radius);
    this.build();
    this.clock = new Clock(element, () => this.animate());
    this.stage.onDraw(() => this.overlay.draw(this.stage, (arrow) => this.tip(arrow), this.pickedPlace()));
    this.listen();
    if (this.operating) this.spectrum = new Spectrum(this.panel.spectrum, this.operating, (line) => this.set({ line }));
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.recolour = () => this.paint();
    this.dark.addEventListener("change", this.recolour);
    this.set({ show: this.modes?.rows.length ? "modes" : "rest" });
  }

  // -- what is drawn
  build() {
    const { shared, scene } = this.stage, [model] = this.bodies;
    const actor = (body, options) => {
      const made = new Actor(body, shared, options);
      scene.add(made);
      return made;
    };
    this.base = actor(model, { width: 2.2 });
    this.ghost = actor(model, { surface: false, width: 1, squares: false, behind: true });
    const layer = ({ body, style }) => (style === "surface" ? this.base
      : actor(body, { surface: false, width: style === "dots" ? 2.2 : 1.6, dots: style === "dots", squares: false }));
    this.actors = { modes: (this.modes?.layers ?? []).map(layer), operating: [] };
    this.actors.operating = (this.operating?.references[0]?.layers ?? []).map(layer);
    this.all = new Set([this.base, this.ghost, ...this.actors.modes, ...this.actors.operating]);
    this.arrows = new Map();
    for (const kind of ["sensor", "force"]) {
      const own = this.given.arrows.filter((arrow) => arrow.kind === kind);
      if (!own.length) continue;
      const mesh = arrowsOf(own, this.base, this.stage.uniforms, this.stage.length);
      scene.add(mesh);
      this.arrows.set(kind, mesh);
    }
    this.overlay = new Overlay(this.panel.svg);
  }

  get moving() { return this.state.show !== "rest"; }

  // Layers of what is shown, with their actors and whether they are seen.
  layers() {
    const { show, reference, row, hidden } = this.state;
    if (show === "rest") return [];
    const layers = show === "modes" ? this.modes.layers : this.operating.references[reference].layers;
    return layers.map((layer, i) => ({
      ...layer, actor: this.actors[show][i], index: i, shown: !hidden.has(layer.name),
      missing: show === "modes" && this.modes.rows[row].members[i] < 0,
    }));
  }

  set(changes) {
    Object.assign(this.state, changes);
    const { show, row, reference, line } = this.state;
    if ("show" in changes || "reference" in changes) {
      if (show === "operating") {
        this.spectrum.show(reference, this.operating.references[reference].layers);
        this.state.line = this.spectrum.line;
      }
    }
    if (["show", "row", "reference", "line", "hidden"].some((key) => key in changes)) {
      const layers = this.layers();
      for (const actor of this.all) actor.visible = false;
      this.ghost.visible = this.moving;
      this.base.visible = !this.moving;
      this.base.shape(null);
      const shapes = show === "modes" ? this.modes.at(row) : show === "operating" ? this.operating.at(reference, this.state.line) : [];
      const present = layers.filter((layer) => shapes[layer.index]);
      const same = new Map(); // one scale for what is on one body, so that layers are compared
      for (const layer of present) same.set(layer.body, [...(same.get(layer.body) ?? []), layer]);
      const ready = new Map();
      const aligned = show === "modes" && present.every(({ body }) => body.real === body.n);
      for (const [body, those] of aligned ? [[this.bodies[0], present]] : same) {
        const level = aligned ? joint(those.map(({ index }) => shapes[index])) : levelled(those.map(({ index }) => shapes[index]), body);
        those.forEach((layer, i) => ready.set(layer, level[i]));
      }
      for (const layer of present) {
        layer.actor.visible = layer.shown;
        layer.actor.shape(...spread(ready.get(layer), layer.body, this.stage.radius));
      }
      this.clock.activate(this.moving);
      this.phase(this.clock.phase);
      if (!this.moving) this.phase(0);
    }
    this.panel.update(line);
    this.paint();
  }

  phase(angle) {
    const size = this.state.amplitude * reach(this.stage.radius);
    for (const actor of this.all) actor.phase(this.moving ? size * Math.cos(angle) : 0, this.moving ? size * Math.sin(angle) : 0);
    this.stage.invalidate();
  }

  animate() { this.phase(this.clock.phase); this.panel.phase(this.clock.phase); }

  // Colours of now: those of the page, and of what is asked for.
  paint() {
    const { element, state, given } = this, colour = (name) => rgb(element, name);
    this.stage.ground(colour("ground"));
    const chosen = typeof state.colouring === "number" ? given.colourings[state.colouring] : null;
    const layers = this.layers();
    const primary = layers.find((layer) => layer.actor === this.base);
    const plain = colour(primary ? primary.role : "plain");
    if (chosen) {
      this.base.palette([colour("none"), ...this.groupSteps(chosen)[0].map((step) => colour(step < 0 ? "none" : chosen.steps[step].colour))]);
      this.base.colour(BY_GROUP, plain, element);
    } else {
      this.base.colour(state.colouring === "displacement" && this.moving ? BY_DISPLACEMENT : PLAIN, plain, element);
    }
    this.ghost.colour(PLAIN, colour("ghost"), element);
    for (const layer of layers) if (layer.actor !== this.base) layer.actor.colour(PLAIN, colour(layer.role), element);
    for (const [kind, mesh] of this.arrows) {
      mesh.material.uniforms.uColour.value.copy(new Vector3(...colour(kind === "force" ? "force" : "text")));
      mesh.visible = state.labels;
    }
    this.overlay.name(state.labels ? given.arrows : []);
    const seen = layers.filter((layer) => layer.shown && !layer.missing);
    drawLegend(this.panel.legend, {
      colouring: chosen ?? state.colouring, moving: this.moving, arrows: state.labels ? this.arrows : new Map(),
      layers: seen.filter((layer) => layer.actor !== this.base || !(chosen || state.colouring === "displacement")),
    });
    this.stage.refit();
    this.stage.invalidate();
  }

  // Step and text of each group: of the mode that is shown, where they differ by mode.
  groupSteps({ by_row: rows, step_of_group: steps, texts }) {
    return (this.state.show === "modes" && rows[this.state.row]) || [steps, texts];
  }

  // -- nodes
  get pickable() {
    const seen = this.layers().filter((layer) => layer.shown && !layer.missing).map((layer) => layer.actor);
    return this.base.visible || !seen.length ? this.base : seen[0];
  }

  tip(arrow) {
    const at = this.base.placeOf(arrow.node), length = this.stage.length.value * (arrow.kind === "force" ? -1.15 : 1);
    return at.map((value, c) => value + length * arrow.vector[c]);
  }

  pickedPlace() { return this.picked < 0 ? null : this.pickedActor.placeOf(this.picked); }

  // What is known of a node, as the event for other scripts has it.
  about(actor, node) {
    const { body } = actor, label = body.labels[node];
    const arrows = this.given.arrows.filter((arrow) => this.bodies[0].labels[arrow.node] === label);
    return {
      label, body: body.name, position: [...body.xyz.slice(3 * node, 3 * node + 3)],
      groups: body.groupsAt(node).map((group) => body.groups[group]),
      sensors: arrows.filter(({ kind }) => kind === "sensor").map((arrow) => arrow.label),
      forces: arrows.filter(({ kind }) => kind === "force").map((arrow) => arrow.label),
    };
  }

  pick(node, actor = this.pickable) {
    this.picked = node;
    this.pickedActor = actor;
    this.stage.invalidate();
    if (node < 0) { this.panel.say(""); return null; }
    const found = this.about(actor, node);
    const parts = [`Node ${found.label}`, `(${found.position.map(written).join(", ")}) m`];
    const colouring = this.given.colourings[typeof this.state.colouring === "number" ? this.state.colouring : 0];
    const titles = colouring ? this.groupSteps(colouring)[1] : [];
    if (actor.body === this.bodies[0]) parts.push(...body_titles(actor.body, node, titles));
    if (found.sensors.length) parts.push(`sensors ${found.sensors.join(", ")}`);
    if (found.forces.length) parts.push(`forces ${found.forces.join(", ")}`);
    this.panel.say(parts.join(" · "));
    this.element.dispatchEvent(new CustomEvent("updyn-pick", { detail: found, bubbles: true }));
    return found;
  }

  // Picks a node by its number; false where there is none.
  find(label) {
    for (const actor of [this.pickable, this.base]) {
      const node = actor.body.labels.indexOf(label);
      if (node >= 0) { this.pick(node, actor); return true; }
    }
    return false;
  }

  listen() {
    const { canvas } = this.panel;
    let from = null;
    const at = (event) => {
      const box = canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    canvas.addEventListener("pointerdown", (event) => { from = at(event); });
    canvas.addEventListener("pointerup", (event) => {
      const [x, y] = at(event);
      if (from && Math.hypot(x - from[0], y - from[1]) < 5) this.pick(nodeAt(this.stage, this.pickable, x, y));
      from = null;
    });
    const turn = Math.PI / 24;
    const keys = {
      ArrowLeft: () => this.stage.turn(-turn, 0), ArrowRight: () => this.stage.turn(turn, 0),
      ArrowUp: () => this.stage.turn(0, turn), ArrowDown: () => this.stage.turn(0, -turn),
      "+": () => this.stage.zoom(1.2), "=": () => this.stage.zoom(1.2), "-": () => this.stage.zoom(1 / 1.2),
      f: () => this.stage.fit(), " ": () => this.panel.toggle(),
      n: () => this.step(1), p: () => this.step(-1), Escape: () => this.pick(-1),
    };
    const shifted = {
      ArrowLeft: () => this.stage.pan(-30, 0), ArrowRight: () => this.stage.pan(30, 0),
      ArrowUp: () => this.stage.pan(0, 30), ArrowDown: () => this.stage.pan(0, -30),
    };
    canvas.addEventListener("keydown", (event) => {
      const act = (event.shiftKey && shifted[event.key]) || keys[event.key];
      if (!act || event.ctrlKey || event.altKey || event.metaKey) return;
      act();
      event.preventDefault();
    });
    canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); this.panel.say("The graphics card was taken away; the picture returns with it."); });
    canvas.addEventListener("webglcontextrestored", () => { this.panel.say(""); this.set({ show: this.state.show }); });
  }

  // The next node, of those with sensors or forces where there are some.
  step(by) {
    const { body } = this.pickable;
    const nodes = this.given.arrows.length && body === this.bodies[0] ? [...new Set(this.given.arrows.map((arrow) => arrow.node))]
      : Array.from({ length: body.real }, (_, i) => i);
    const at = nodes.indexOf(this.picked);
    this.pick(nodes[at < 0 ? (by > 0 ? 0 : nodes.length - 1) : (at + by + nodes.length) % nodes.length]);
  }

  // -- pictures
  get caption() { return [this.given.title, this.panel.shown].filter(Boolean).join(" – "); }

  get colours() { return { text: css(this.element, "text"), ground: css(this.element, "ground") }; }

  screenshot() { return png(this.stage, this.caption, this.colours); }

  // An animated picture; the animation of the page stands meanwhile.
  async animation() {
    const { playing } = this.clock;
    this.clock.play(false);
    const made = await gif(this.stage, this.caption, this.colours, (angle) => this.phase(angle), this.clock.period);
    this.clock.play(playing);
    this.phase(this.clock.phase);
    return made;
  }

  async keep(kind) {
    const name = (this.given.title || "structure").replace(/[^\p{L}\p{N}._-]+/gu, "-").slice(0, 60);
    const made = kind === "png" ? await this.screenshot() : await this.animation();
    save(made, `${name}.${kind}`);
    return made;
  }

  dispose() {
    this.dark.removeEventListener("change", this.recolour);
    this.clock.dispose();
    for (const actor of this.all) actor.dispose();
    for (const body of this.bodies) body.dispose();
    this.stage.dispose();
    this.element.replaceChildren();
    delete this.element.updynViewer;
  }
}

// Shapes without discs on several bodies: one scale, so that the test lies over the model.
function joint(shapes) {
  let most = 0;
  for (const { re, im } of shapes) {
    for (let i = 0; i < re.length; i += 3) {
      let sum = 0;
      for (let c = i; c < i + 3; c++) sum += re[c] * re[c] + (im ? im[c] * im[c] : 0);
      if (sum > most) most = sum;
    }
  }
  const scale = most > 0 ? 1 / Math.sqrt(most) : 0;
  return shapes.map(({ re, im }) => ({ re: re.map((value) => value * scale), im: im && im.map((value) => value * scale) }));
}

// Rims of discs turn by an angle of their own, whatever the reach of the scene.
function spread({ re, im }, body, radius) {
  if (body.real === body.n) return [re, im];
  const rim = (TURNS * body.disc) / reach(radius);
  const scale = (values) => values && values.map((value, i) => (i < 3 * body.real ? value : value * rim));
  return [scale(re), scale(im)];
}

const body_titles = (body, node, texts) => body.groupsAt(node).map((group) => texts[group] || body.groups[group]);
