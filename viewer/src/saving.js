// Pictures to keep: a PNG with its legend, and the animation as a GIF.
import { GIFEncoder, applyPalette, quantize } from "gifenc";

const FRAMES = 24, WIDEST = 720;

function put(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

// The picture of now on a canvas of its own, with a line of text below.
function copy(stage, width, height, caption, { text, ground }) {
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.fillStyle = ground;
  context.fillRect(0, 0, width, height);
  stage.draw();
  context.drawImage(stage.canvas, 0, 0, width, height);
  context.fillStyle = text;
  context.font = `${Math.round(Math.max(12, width / 60))}px system-ui, sans-serif`;
  context.textBaseline = "bottom";
  context.fillText(caption, 12, height - 8, width - 24);
  return { canvas, context };
}

export async function png(stage, caption, colours) {
  const { canvas } = copy(stage, stage.canvas.width, stage.canvas.height, caption, colours);
  return new Promise((done) => canvas.toBlob(done, "image/png"));
}

// "frame(phase)" puts the scene in a phase of its period of "period" seconds.
export async function gif(stage, caption, colours, frame, period) {
  const scale = Math.min(1, WIDEST / stage.canvas.width);
  const width = Math.round(stage.canvas.width * scale), height = Math.round(stage.canvas.height * scale);
  const encoder = GIFEncoder();
  for (let i = 0; i < FRAMES; i++) {
    frame((2 * Math.PI * i) / FRAMES);
    const { context } = copy(stage, width, height, caption, colours);
    const { data } = context.getImageData(0, 0, width, height);
    const palette = quantize(data, 128);
    encoder.writeFrame(applyPalette(data, palette), width, height, { palette, delay: Math.round((1000 * period) / FRAMES) });
    await new Promise((done) => { setTimeout(done, 0); }); // the page stays usable
  }
  encoder.finish();
  return new Blob([encoder.bytes()], { type: "image/gif" });
}

export const save = put;
