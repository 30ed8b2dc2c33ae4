// What the colours mean: name and unit, a scale with ticks, and a swatch for what has no place on it.
import { RAMP } from "./colours.js";

const element = (name, className, text = "") => Object.assign(document.createElement(name), { className, textContent: text });

function entry(mark, text) {
  const item = element("li", "");
  item.append(mark, text);
  return item;
}

function swatch(colour, text, dashed = false) {
  const mark = element("i", dashed ? "v-dashed" : "");
  mark.style[dashed ? "borderColor" : "background"] = `var(--${colour})`;
  return entry(mark, text);
}

function arrow(colour, text) {
  const mark = element("span", "v-arrow", "\u2191");
  mark.style.color = `var(--${colour})`;
  return entry(mark, text);
}

function bar(colours, ticks) {
  const scale = element("div", "v-scale"), ramp = element("div", "v-ramp");
  ramp.style.background = `linear-gradient(to top, ${colours.map((name) => `var(--${name})`).join(", ")})`;
  scale.append(ramp, ...ticks.map(([place, text]) => {
    const tick = element("span", "v-tick", text);
    tick.style.bottom = `${100 * place}%`;
    return tick;
  }));
  return scale;
}

function list(items) {
  const made = element("ul", "");
  made.append(...items);
  return made;
}

export function drawLegend(place, { colouring, moving, layers, arrows }) {
  place.replaceChildren();
  if (colouring === "displacement" && moving) {
    place.append(element("b", "", "Displacement (relative)"), bar(RAMP, [[0, "0"], [1, "largest"]]));
  } else if (colouring?.steps) {
    place.append(element("b", "", colouring.unit ? `${colouring.name} (${colouring.unit})` : colouring.name));
    if (colouring.scale) place.append(bar(colouring.scale.colours, colouring.scale.ticks));
    if (colouring.steps.length) place.append(list(colouring.steps.map((step) => swatch(step.colour, step.text))));
  }
  const more = layers.map(({ colour, name, style }) => swatch(colour, name, style === "ghost"));
  if (arrows.has("sensor")) more.push(arrow("third", "sensor"));
  if (arrows.has("force")) more.push(arrow("force", "force"));
  if (more.length) place.append(list(more));
  place.hidden = !place.childElementCount;
}
