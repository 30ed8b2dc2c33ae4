// What the colours mean: name and unit, and a swatch for each step.
import { RAMP } from "./colours.js";

const element = (name, className, text = "") => Object.assign(document.createElement(name), { className, textContent: text });

function swatch(colour, text) {
  const item = element("li", ""), mark = element("i", "");
  mark.style.background = `var(--${colour})`;
  item.append(mark, text);
  return item;
}

export function drawLegend(place, { colouring, moving, layers, arrows }) {
  place.replaceChildren();
  if (colouring === "displacement" && moving) {
    const bar = element("div", "v-ramp");
    bar.style.background = `linear-gradient(to right, ${RAMP.map((name) => `var(--${name})`).join(", ")})`;
    const ends = element("div", "v-ends");
    ends.append(element("span", "", "0"), element("span", "", "largest"));
    place.append(element("b", "", "Displacement (relative)"), bar, ends);
  } else if (colouring?.steps) {
    place.append(element("b", "", colouring.unit ? `${colouring.name} (${colouring.unit})` : colouring.name));
    const list = element("ul", "");
    list.append(...colouring.steps.map((step) => swatch(step.colour, step.text)));
    place.append(list);
  }
  const more = [...layers.map(({ role, name }) => swatch(role, name))];
  if (arrows.has("sensor")) more.push(swatch("text", "sensor"));
  if (arrows.has("force")) more.push(swatch("force", "force"));
  if (more.length) {
    const list = element("ul", "");
    list.append(...more);
    place.append(list);
  }
  place.hidden = !place.childElementCount;
}
