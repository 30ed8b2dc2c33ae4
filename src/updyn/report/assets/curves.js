// Arrays of a page, and curves of FRFs that are made of them.
"use strict";
const updynCurves = (() => {
  // Base64, little-endian as every browser's machine is.
  function bytes(text) {
    const raw = atob(text), out = new Uint8Array(raw.length);
    for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
    return out.buffer;
  }

  // Magnitudes of complex values, real and imaginary parts in turn, from a position on.
  function magnitude(values, from, size) {
    const out = new Float64Array(size);
    for (let i = 0, at = from; i < size; i++, at += 2) out[i] = Math.hypot(values[at], values[at + 1]);
    return out;
  }

  // Degrees in -180..180; where the phase wraps the line is broken, not drawn across. A zero has none.
  function phase(values, from, lines) {
    const x = [], y = [];
    for (let i = 0, at = from, last = null; i < lines.length; i++, at += 2) {
      const zero = values[at] === 0 && values[at + 1] === 0;
      const now = zero ? null : Math.atan2(values[at + 1], values[at]) * 180 / Math.PI;
      if (last !== null && now !== null && Math.abs(now - last) > 180) { x.push(lines[i]); y.push(null); }
      x.push(lines[i]); y.push(now); last = now;
    }
    return { x, y };
  }

  // Of many points the least and the greatest of each stretch, in their order, so that no peak is lost; gaps stay.
  function thinned({ x, y }, most) {
    if (x.length <= most) return { x, y };
    const outX = [], outY = [], stretches = Math.floor(most / 2), n = x.length;
    for (let k = 0; k < stretches; k++) {
      const from = Math.floor(k * n / stretches), to = Math.floor((k + 1) * n / stretches);
      let low = -1, high = -1, gap = -1;
      for (let i = from; i < to; i++) {
        if (y[i] === null) { gap = i; continue; }
        if (low < 0 || y[i] < y[low]) low = i;
        if (high < 0 || y[i] > y[high]) high = i;
      }
      for (const i of [...new Set([low, high, gap])].filter((at) => at >= 0).sort((a, b) => a - b)) { outX.push(x[i]); outY.push(y[i]); }
    }
    return { x: outX, y: outY };
  }
  return { bytes, magnitude, phase, thinned };
})();
