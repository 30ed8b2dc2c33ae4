// What is written over the picture, as SVG: axes, labels of arrows, the picked node.

const SVG = "http://www.w3.org/2000/svg";
const AXIS = 30, MOST_LABELS = 120;

function made(name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

export class Overlay {
  constructor(svg) {
    this.svg = svg;
    this.labels = made("g", {});
    this.mark = made("circle", { class: "v-mark", r: 9, visibility: "hidden" });
    this.axes = made("g", { class: "v-axes" });
    svg.append(this.labels, this.mark, this.axes);
    this.texts = [];
  }

  // Labels of arrows: what is written, where it is.
  name(items) {
    this.texts = items.slice(0, MOST_LABELS);
    this.labels.replaceChildren(...this.texts.map(({ label, kind }) => made("text", { class: `v-label v-${kind}` }, label)));
  }

  draw(stage, tipOf, picked) {
    const [width, height] = stage.size;
    this.svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const taken = [];
    this.texts.forEach((item, i) => {
      const element = this.labels.children[i], [x, y] = stage.project(tipOf(item));
      const wide = 6.6 * item.label.length, right = x > width / 2;
      const box = right ? [x + 4, y - 12, x + 8 + wide, y + 4] : [x - 8 - wide, y - 12, x - 4, y + 4];
      const free = taken.every((other) => box[2] < other[0] || box[0] > other[2] || box[3] < other[1] || box[1] > other[3]);
      element.setAttribute("visibility", free ? "visible" : "hidden"); // no label over another
      if (!free) return;
      taken.push(box);
      element.setAttribute("x", right ? x + 5 : x - 5);
      element.setAttribute("y", y + 4);
      element.setAttribute("text-anchor", right ? "start" : "end");
    });
    this.mark.setAttribute("visibility", picked ? "visible" : "hidden");
    if (picked) {
      const [x, y] = stage.project(picked);
      this.mark.setAttribute("cx", x);
      this.mark.setAttribute("cy", y);
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
