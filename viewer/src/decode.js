// Arrays of a scene: base64 of little-endian numbers.

function bytes(text) {
  const binary = atob(text), out = new Uint8Array(binary.length);
  for (let i = 0; i < binary.length; i++) out[i] = binary.charCodeAt(i);
  return out.buffer;
}

export const floats = (text) => new Float32Array(bytes(text));
export const integers = (text) => new Int32Array(bytes(text));

// Shapes are whole numbers of 16 bits, 32767 of them being "scale".
export function scaled({ data, scale }) {
  const whole = new Int16Array(bytes(data)), out = new Float32Array(whole.length);
  for (let i = 0; i < whole.length; i++) out[i] = (whole[i] * scale) / 32767;
  return out;
}
