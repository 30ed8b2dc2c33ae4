// The viewer of one scene in one element: state, and what follows from it.
import { Vector3 } from "three";
import { Actor, BY_DISPLACEMENT, BY_GROUP, PLAIN } from "./actor.js";
import { arrowsOf } from "./arrows.js";
import { Body } from "./body.js";
import { Clock } from "./clock.js";
import { between, css, rgb } from "./colours.js";
import { drawLegend } from "./legend.js";
import { Overlay } from "./overlay.js";
import { Panel } from "./panel.js";
import { nodeAt } from "./picking.js";
import { gif, png, save } from "./saving.js";
import { ModeShapes, OperatingShapes, levelled, reach, TURNS } from "./shapes.js";
import { Spectrum } from "./spectrum.js";
import { Stage } from "./stage.js";

const MANY_FACES = 20000;
// Arrows beyond which their labels are shown under the pointer only, and px from the pointer to the arrow.
const MANY_ARROWS = 24, NEAR = 18;
// Labels of parts at once, the largest changes first (others where the pointer is, up to so many nodes that are searched
// for it); px of a dash; px of a caption below the upper edge.
const MOST_PARTS = 6, MOST_NODES = 20000, DASH = 5, CAPTION = 16;
const written = (value) => Number(value.toPrecision(5)).toString();

export class Viewer {
  constructor(element, given) {
    this.element = element;
    this.given = given;
    this.state = {
      show: "rest", row: 0, reference: 0, line: 0, colouring: given.colourings.length ? 0 : "none", amplitude: 1,
      labels: true, parts: true, beside: false, hidden: new Set(),
    };
    this.bodies = given.bodies.map((body) => new Body(body));
    this.modes = given.modes && new ModeShapes(given.modes, this.bodies);
    this.operating = given.operating && new OperatingShapes(given.operating, this.bodies);
    for (const { name, style } of [...(this.modes?.layers ?? []), ...(this.operating?.references[0]?.layers ?? [])]) if (style === "ghost") this.state.hidden.add(name);
    this.picked = this.hovered = this.pointed = -1;
    this.panel = new Panel(element, this);
    this.stage = new Stage(this.panel.stage, this.panel.canvas, this.bodies.map((body) => body.xyz), {
      smooth: this.bodies.every((body) => body.faces.length < 3 * MANY_FACES), cover: this.panel.legend, arrows: given.arrows.length > 0,
    });
    if (this.modes || this.operating) this.stage.sway = reach(this.stage.radius);
    this.build();
    this.clock = new Clock(element, () => this.animate());
    this.stage.onSize = () => { if (this.hasSides && this.stage.hasRoom) this.set({ beside: true }); };
    this.stage.onDraw(() => this.overlay.draw(this.stage, this.pickedPlace(), this.arrowBoxes()));
    this.listen();
    if (this.operating) this.spectrum = new Spectrum(this.panel.spectrum, this.operating, (line) => this.set({ line }));
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.recolour = () => this.paint();
    this.dark.addEventListener("change", this.recolour);
    this.set({ show: this.modes?.rows.length ? "modes" : "rest" });
  }

  // -- what is drawn
  build() {
    const { shared, scene, shifts: { left, right } } = this.stage, [model, test] = this.bodies;
    const actor = (body, options) => {
      const made = new Actor(body, shared, options);
      scene.add(made);
      return made;
    };
    this.base = actor(model, { width: 2.2, shift: right });
    const still = { surface: false, width: 1, squares: false, behind: true };
    this.ghost = actor(model, { ...still, shift: right });
    this.testGhost = test && actor(test, { ...still, shift: left });
    const looks = {
      dots: { width: 2.2, dots: true, shift: left }, wire: { width: 1.6, shift: right },
      ghost: { width: 1.2, dash: DASH * Math.min(devicePixelRatio || 1, 2), shift: right },
    };
    const layer = ({ body, style }) => (style === "surface" ? this.base : actor(body, { surface: false, squares: false, ...looks[style] }));
    this.actors = { modes: (this.modes?.layers ?? []).map(layer), operating: [] };
    this.actors.operating = (this.operating?.references[0]?.layers ?? []).map(layer);
    this.all = new Set([this.base, this.ghost, ...(this.testGhost ? [this.testGhost] : []), ...this.actors.modes, ...this.actors.operating]);
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

  // Whether there are layers of a test and of a model, to be drawn side by side.
  get hasSides() {
    const styles = this.layers().map(({ style }) => style);
    return styles.includes("dots") && styles.some((style) => style !== "dots");
  }

  get isSplit() { return this.state.beside && this.hasSides; }

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
    if (["show", "row", "reference", "line", "hidden", "beside"].some((key) => key in changes)) {
      const layers = this.layers();
      for (const actor of this.all) actor.visible = false;
      this.stage.split(this.isSplit ? 2 : 1);
      this.ghost.visible = this.moving;
      if (this.testGhost) this.testGhost.visible = this.isSplit;
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
    const plain = colour(primary ? primary.colour : "plain");
    if (chosen) {
      const [steps, , places] = this.groupSteps(chosen), stops = chosen.scale?.colours.map(colour);
      this.base.palette([colour("none"), ...steps.map((step, group) => {
        const place = places?.[group] ?? null;
        return place !== null ? between(stops, place) : colour(step < 0 ? "none" : chosen.steps[step].colour);
      })]);
      this.base.colour(BY_GROUP, plain, element);
    } else {
      this.base.colour(state.colouring === "displacement" && this.moving ? BY_DISPLACEMENT : PLAIN, plain, element);
    }
    for (const ghost of [this.ghost, this.testGhost]) ghost?.colour(PLAIN, colour("ghost"), element);
    for (const layer of layers) if (layer.actor !== this.base) layer.actor.colour(PLAIN, colour(layer.colour), element);
    for (const [kind, mesh] of this.arrows) {
      mesh.material.uniforms.uColour.value.copy(new Vector3(...colour(kind === "force" ? "force" : "third")));
      mesh.visible = state.labels;
    }
    this.nameAll();
    const seen = layers.filter((layer) => layer.shown && !layer.missing);
    drawLegend(this.panel.legend, {
      colouring: this.base.visible && chosen ? chosen : state.colouring, moving: this.moving, arrows: state.labels ? this.arrows : new Map(),
      layers: seen.filter((layer) => layer.actor !== this.base || !(chosen || state.colouring === "displacement")),
    });
    this.stage.refit();
    this.stage.invalidate();
  }

  // Step, text and place on the scale of each group: of the mode that is shown, where they differ by mode.
  groupSteps({ by_row: rows, step_of_group: steps, texts, scale }) {
    const row = this.state.show === "modes" ? this.state.row : -1;
    return [...(rows[row] ?? [steps, texts]), scale?.by_row[row] ?? scale?.of_group];
  }

  // -- labels over the picture
  nameAll() {
    const { colouring } = this.state, chosen = typeof colouring === "number" ? this.given.colourings[colouring] : null;
    this.overlay.name([...this.sideNames(this.layers()), ...this.partNames(chosen), ...this.arrowNames()]);
  }

  screen(actor, place) { return this.stage.project(place, actor.shift); }

  sideNames(layers) {
    if (!this.isSplit) return [];
    const names = (test) => layers.filter((layer) => layer.shown && !layer.missing && (layer.style === "dots") === test).map(({ name }) => name);
    return [1, 3].map((quarter) => ({
      text: names(quarter === 1).join(", "), kind: "side",
      at: () => [(quarter / 4) * (this.stage.size[0] - this.stage.covered), CAPTION],
    }));
  }

  // Groups with their change, the largest first.
  partNames(chosen) {
    if (!this.state.parts || !chosen || !this.base.visible) return [];
    const places = this.groupSteps(chosen)[2] ?? [], anchors = this.base.body.anchors();
    const rank = (group) => Math.abs((places[group] ?? 0.5) - 0.5);
    const named = chosen.labels.map((text, group) => ({ text, group })).filter(({ text, group }) => text && anchors[group] >= 0);
    const first = named.sort((a, b) => rank(b.group) - rank(a.group)).slice(0, MOST_PARTS).map(({ group }) => group);
    const about = this.pointed < 0 ? [] : this.base.body.groupsAt(this.pointed);
    const shown = about.some((group) => chosen.labels[group]) ? about : first;
    return named.filter(({ group }) => shown.includes(group))
      .map(({ text, group }) => ({ text, kind: "part", at: () => this.screen(this.base, this.base.restOf(anchors[group])) }));
  }

  // Labels of sensors and forces; of many, those of the node under the pointer and of the picked one.
  arrowNames() {
    const { arrows } = this.given, few = arrows.length <= MANY_ARROWS;
    const shown = (node) => few || node === this.hovered || (this.picked >= 0 && this.pickedActor.body === this.bodies[0] && node === this.picked);
    return (this.state.labels ? arrows : []).map((arrow) => ({
      text: arrow.label, kind: arrow.kind, at: () => (shown(arrow.node) ? this.screen(this.base, this.tip(arrow)) : null),
    }));
  }

  // The boxes around the arrows at rest, in px: labels of parts do not jump while the structure moves.
  arrowBoxes() {
    return (this.state.labels ? this.given.arrows : []).map((arrow) => {
      const at = this.base.restOf(arrow.node), [ax, ay] = this.screen(this.base, at), [bx, by] = this.screen(this.base, this.tip(arrow, at));
      return [Math.min(ax, bx) - 3, Math.min(ay, by), Math.max(ax, bx) + 3, Math.max(ay, by)];
    });
  }

  // Shows the labels of what is under the pointer.
  point(x, y) {
    const arrow = this.arrowAt(x, y), before = this.pointed;
    const named = this.state.parts && this.base.visible && this.base.body.real <= MOST_NODES;
    this.pointed = named ? nodeAt(this.stage, this.base, x, y) : -1;
    if (arrow === this.hovered && before === this.pointed) return;
    this.hovered = arrow;
    this.nameAll();
    this.stage.invalidate();
  }

  // The node whose arrows are under the pointer; -1 for none.
  arrowAt(x, y) {
    let best = -1, least = NEAR;
    for (const arrow of this.state.labels ? this.given.arrows : []) {
      const [ax, ay] = this.screen(this.base, this.base.placeOf(arrow.node)), [bx, by] = this.screen(this.base, this.tip(arrow));
      const along = Math.min(1, Math.max(0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2 || 1)));
      const away = Math.hypot(x - ax - along * (bx - ax), y - ay - along * (by - ay));
      if (away < least) { least = away; best = arrow.node; }
    }
    return best;
  }

  // -- nodes
  get pickable() {
    const seen = this.layers().filter((layer) => layer.shown && !layer.missing).map((layer) => layer.actor);
    return this.base.visible || !seen.length ? this.base : seen[0];
  }

  // What is picked at a place: in the left one of two pictures the test.
  pickableAt(x) {
    const onLeft = this.isSplit && x < (this.stage.size[0] - this.stage.covered) / 2;
    return (onLeft && this.layers().find((layer) => layer.style === "dots" && layer.shown && !layer.missing)?.actor) || this.pickable;
  }

  tip(arrow, at = this.base.placeOf(arrow.node)) {
    const length = this.stage.length.value * (arrow.kind === "force" ? -1.15 : 1);
    return at.map((value, c) => value + length * arrow.vector[c]);
  }

  pickedPlace() { return this.picked < 0 ? null : this.screen(this.pickedActor, this.pickedActor.placeOf(this.picked)); }

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
      const actor = this.pickableAt(x);
      if (from && Math.hypot(x - from[0], y - from[1]) < 5) this.pick(nodeAt(this.stage, actor, x, y), actor);
      from = null;
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons) this.point(...at(event));
    });
    canvas.addEventListener("pointerleave", () => this.point(-Infinity, -Infinity));
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
