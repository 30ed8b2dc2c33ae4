// Colours are those of the page: its variables --NAME, which follow light and dark.

const probe = () => document.createElement("canvas").getContext("2d", { willReadFrequently: true });
let painter = null;

// Any colour of a style sheet as red, green and blue from 0 to 1.
function parts(text) {
  painter ??= probe();
  painter.fillStyle = "#808080";
  painter.fillStyle = text;
  painter.fillRect(0, 0, 1, 1);
  return [...painter.getImageData(0, 0, 1, 1).data.slice(0, 3)].map((part) => part / 255);
}

export const css = (element, name) => getComputedStyle(element).getPropertyValue(`--${name}`).trim() || "#808080";
export const rgb = (element, name) => parts(css(element, name));

export const RAMP = ["seq-0", "seq-1", "seq-2", "seq-3", "seq-4", "seq-5", "seq-6", "seq-7"];

// The colour at a place from 0 to 1 between colours at even distances.
export function between(stops, place) {
  const at = place * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2);
  return [0, 1, 2].map((c) => stops[low][c] + (at - low) * (stops[low + 1][c] - stops[low][c]));
}

// 256 colours between the stops of the sequential map, as bytes.
export function ramp(element) {
  const stops = RAMP.map((name) => rgb(element, name)), out = new Uint8Array(256 * 4);
  for (let i = 0; i < 256; i++) out.set([...between(stops, i / 255).map((part) => 255 * part), 255], 4 * i);
  return out;
}
