// What is written over the picture, as SVG: axes, labels of arrows and parts, the picked node.

const SVG = "http://www.w3.org/2000/svg";
const AXIS = 30, LETTER = 6.8, LINE = 16;

function made(name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

export class Overlay {
  constructor(svg) {
    this.svg = svg;
    this.leaders = made("g", { class: "v-leaders" });
    this.labels = made("g", {});
    this.mark = made("circle", { class: "v-mark", r: 9, visibility: "hidden" });
    this.axes = made("g", { class: "v-axes" });
    svg.append(this.leaders, this.labels, this.mark, this.axes);
    this.items = [];
  }

  // What is written: "text", its "kind", and "at()", its place in px; null where it is not shown. The first come first.
  name(items) {
    this.items = items;
    this.labels.replaceChildren(...items.map(({ text, kind }) => made("text", { class: `v-label v-${kind}` }, text)));
  }

  // "taken": boxes that labels keep away from.
  draw(stage, picked, taken) {
    const [width, height] = stage.size, free = width - stage.covered, leaders = [];
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.items.forEach((item, i) => {
      const element = this.labels.children[i], at = item.at();
      const found = at && places(at, LETTER * item.text.length, item.kind, free / (2 * stage.sides))
        .find(({ box }) => inside(box, free, height) && taken.every((other) => apart(box, other)));
      element.setAttribute("visibility", found ? "visible" : "hidden"); // no label over another
      if (!found) return;
      taken.push(found.box);
      if (item.kind === "part") leaders.push(leader(at, found.box));
      element.setAttribute("x", found.x);
      element.setAttribute("y", found.box[3] - 4);
      element.setAttribute("text-anchor", found.anchor);
    });
    this.leaders.replaceChildren(...leaders);
    this.mark.setAttribute("visibility", picked ? "visible" : "hidden");
    if (picked) {
      this.mark.setAttribute("cx", picked[0]);
      this.mark.setAttribute("cy", picked[1]);
    }
    this.turn(stage, height);
  }

  turn(stage, height) {
    const m = stage.camera.matrixWorldInverse.elements, x0 = 46, y0 = height - 46;
    const parts = [];
    for (const [c, name] of [..."XYZ"].entries()) {
      const x = m[4 * c], y = -m[4 * c + 1];
      parts.push(made("path", { d: `M${x0} ${y0}l${(AXIS * x).toFixed(1)} ${(AXIS * y).toFixed(1)}` }));
      if (Math.hypot(x, y) > 0.15) parts.push(made("text", { x: x0 + (AXIS + 10) * x, y: y0 + (AXIS + 10) * y + 4, "text-anchor": "middle" }, name));
    }
    this.axes.replaceChildren(...parts);
  }
}

const apart = (a, b) => a[2] < b[0] || a[0] > b[2] || a[3] < b[1] || a[1] > b[3];
const inside = (box, width, height) => box[0] >= 0 && box[1] >= 0 && box[2] <= width && box[3] <= height;

// Where labels of parts may lie about their place, in px to the right and upwards: near places first.
const AROUND = [22, 48, 80, 120, 165].flatMap((away) => [90, 270, 0, 180, 45, 135, 315, 225]
  .map((angle) => [away * Math.cos((angle * Math.PI) / 180), away * Math.sin((angle * Math.PI) / 180)]));

// Where a label may lie about its place, the best first: those of arrows on the outer side.
function places([x, y], wide, kind, middle) {
  const beside = (right, up) => {
    const low = y + 4 - up * LINE;
    return right ? { x: x + 5, anchor: "start", box: [x + 4, low - LINE + 4, x + 8 + wide, low + 4] }
      : { x: x - 5, anchor: "end", box: [x - 8 - wide, low - LINE + 4, x - 4, low + 4] };
  };
  const about = ([right, up]) => {
    const centre = x + right + (Math.abs(right) < 1 ? 0 : (Math.sign(right) * wide) / 2);
    return { x: centre, anchor: "middle", box: [centre - wide / 2, y - up - LINE / 2, centre + wide / 2, y - up + LINE / 2] };
  };
  if (kind === "side") return [about([0, 0])];
  if (kind === "part") return AROUND.map(about);
  const outer = x > middle;
  return [beside(outer, 0), beside(!outer, 0), beside(outer, 1), beside(outer, -1)];
}

// A line from a place to the nearest point of a label.
function leader([x, y], [left, top, right, bottom]) {
  const tx = Math.min(Math.max(x, left), right), ty = Math.min(Math.max(y, top), bottom);
  return made("path", { d: `M${x.toFixed(1)} ${y.toFixed(1)}L${tx.toFixed(1)} ${ty.toFixed(1)}` });
}
