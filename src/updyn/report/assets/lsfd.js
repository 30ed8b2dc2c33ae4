// FRFs from poles, with residues by least squares, as `updyn.modal.synthesis` computes them: each receptance is
// sum R / (w^2 (1 + i eta) + s^2) + L / s^2 + U with s = i omega + decay. The inner products of the terms are kept, so
// that a mode more or less costs one small system of equations.
"use strict";
class UpdynSynthesis {
  // "lines" in Hz; "values" channel by channel, real and imaginary parts in turn; "power" of s, by quantity.
  constructor({ lines, weights, values, decay, power }) {
    Object.assign(this, { lines, values, n: lines.length, channels: values.length / (2 * lines.length) });
    this.squares = weights.map((w) => w * w);
    const n = this.n;
    this.s2 = { re: new Float64Array(n), im: new Float64Array(n) }; // s^2
    this.factor = { re: new Float64Array(n), im: new Float64Array(n) }; // s^power
    for (let i = 0; i < n; i++) {
      const omega = 2 * Math.PI * lines[i];
      this.s2.re[i] = decay * decay - omega * omega;
      this.s2.im[i] = 2 * decay * omega;
      [this.factor.re[i], this.factor.im[i]] = [[1, 0], [decay, omega], [this.s2.re[i], this.s2.im[i]]][power];
    }
    this.kept = new Map(); // terms and their inner products, by name
    this.used = this.squares.reduce((count, w) => count + (w > 0), 0);
  }

  // The function of a pole; of no frequency and of 0 those of the residual terms U and L. Of unit weighted length.
  term(pole) {
    const name = `${pole.f},${pole.loss}`;
    if (this.kept.has(name)) return this.kept.get(name);
    const { n, s2, factor, squares } = this, re = new Float64Array(n), im = new Float64Array(n);
    const w2 = (2 * Math.PI * pole.f) ** 2;
    let length = 0;
    for (let i = 0; i < n; i++) {
      const a = pole.f === Infinity ? 1 : w2 + s2.re[i], b = pole.f === Infinity ? 0 : w2 * pole.loss + s2.im[i];
      const size = a * a + b * b;
      if (!size) continue;
      re[i] = (factor.re[i] * a + factor.im[i] * b) / size;
      im[i] = (factor.im[i] * a - factor.re[i] * b) / size;
      length += squares[i] * (re[i] * re[i] + im[i] * im[i]);
    }
    const scale = length > 0 ? 1 / Math.sqrt(length) : 1;
    for (let i = 0; i < n; i++) { re[i] *= scale; im[i] *= scale; }
    const term = { name, re, im };
    term.measured = Array.from({ length: this.channels }, (_, k) => this.inner(term, this.values, 2 * n * k));
    this.kept.set(name, term);
    return term;
  }

  // Weighted inner product of a term with values from a position on: sum w^2 conj(term) value.
  inner(term, values, from) {
    let re = 0, im = 0;
    for (let i = 0, at = from; i < this.n; i++, at += 2) {
      const w = this.squares[i], a = term.re[i], b = term.im[i], c = values[at], d = values[at + 1];
      re += w * (a * c + b * d);
      im += w * (a * d - b * c);
    }
    return [re, im];
  }

  product(one, other) {
    const name = `${one.name}|${other.name}`;
    let found = this.kept.get(name);
    if (!found) {
      let re = 0, im = 0;
      for (let i = 0; i < this.n; i++) {
        const w = this.squares[i];
        re += w * (one.re[i] * other.re[i] + one.im[i] * other.im[i]);
        im += w * (one.re[i] * other.im[i] - one.im[i] * other.re[i]);
      }
      found = [re, im];
      this.kept.set(name, found);
    }
    return found;
  }

  // The fit of some poles; null with fewer lines than terms, and where a loss factor is not known.
  fit(poles) {
    if (poles.some((pole) => pole.loss === null)) return null;
    const terms = [...poles, { f: 0, loss: 0 }, { f: Infinity, loss: 0 }].map((pole) => this.term(pole));
    const m = terms.length;
    if (this.used <= m) return null;
    const A = Array.from({ length: 2 * m }, () => new Float64Array(2 * m)); // [[Re, -Im], [Im, Re]]
    for (let i = 0; i < m; i++) {
      for (let j = 0; j < m; j++) {
        const [re, im] = this.product(terms[i], terms[j]);
        A[i][j] = A[m + i][m + j] = re;
        A[m + i][j] = im;
        A[i][m + j] = -im;
      }
    }
    factorise(A);
    const solve = (right) => substitute(A, [...right.map(([re]) => re), ...right.map(([, im]) => im)]);
    const residues = Array.from({ length: this.channels }, (_, k) => solve(terms.map((term) => term.measured[k])));
    return { terms, residues, solve, curves: [] };
  }

  // The synthesised values of a channel, real and imaginary parts in turn.
  curve({ terms, residues, curves }, channel) {
    if (curves[channel]) return curves[channel];
    const out = new Float64Array(2 * this.n), own = residues[channel], m = terms.length;
    terms.forEach(({ re, im }, r) => {
      const a = own[r], b = own[m + r];
      for (let i = 0, at = 0; i < this.n; i++, at += 2) {
        out[at] += a * re[i] - b * im[i];
        out[at + 1] += a * im[i] + b * re[i];
      }
    });
    curves[channel] = out;
    return out;
  }

  // FRAC of a channel over the lines from "first" up to "end".
  frac(curve, channel, first, end) {
    const from = 2 * this.n * channel;
    let re = 0, im = 0, measured = 0, computed = 0;
    for (let i = first; i < end; i++) {
      const a = this.values[from + 2 * i], b = this.values[from + 2 * i + 1], c = curve[2 * i], d = curve[2 * i + 1];
      re += a * c + b * d;
      im += a * d - b * c;
      measured += a * a + b * b;
      computed += c * c + d * d;
    }
    return measured && computed ? (re * re + im * im) / (measured * computed) : 0;
  }

  // Of loss factors that a mode may have the one with which a pole at this frequency explains most of the residual.
  loss(f, poles) {
    const fit = this.fit(poles);
    if (!fit) return 0.01;
    const rest = Array.from({ length: this.channels }, (_, k) => {
      const out = this.curve(fit, k).slice(), from = 2 * this.n * k;
      for (let at = 0; at < out.length; at++) out[at] = this.values[from + at] - out[at];
      return out;
    });
    const m = fit.terms.length, least = Math.max((this.lines[this.n - 1] - this.lines[0]) / (this.n - 1) / f / 2, 1e-5);
    let best = least, most = -1;
    for (let loss = least; loss < 0.3; loss *= 1.4) {
      const term = this.term({ f, loss }), right = fit.terms.map((own) => this.product(own, term));
      const part = fit.solve(right);
      let own = 1; // of the weighted length of the term what is not among the others
      right.forEach(([re, im], r) => { own -= re * part[r] + im * part[m + r]; });
      let gain = 0;
      for (const channel of rest) { const [re, im] = this.inner(term, channel, 0); gain += re * re + im * im; }
      if (gain / Math.max(own, 1e-9) > most) { most = gain / Math.max(own, 1e-9); best = loss; }
    }
    return best;
  }
}

// Cholesky factors of a symmetric matrix, in its lower part. Of modes that are the same to rounding one is left out.
function factorise(A) {
  for (let j = 0; j < A.length; j++) {
    for (let i = j; i < A.length; i++) {
      let sum = A[i][j];
      for (let k = 0; k < j; k++) sum -= A[i][k] * A[j][k];
      if (i === j) A[j][j] = sum > 1e-14 ? Math.sqrt(sum) : Infinity;
      else A[i][j] = sum / A[j][j];
    }
  }
}

function substitute(A, b) {
  const x = Float64Array.from(b), n = x.length;
  for (let i = 0; i < n; i++) { for (let k = 0; k < i; k++) x[i] -= A[i][k] * x[k]; x[i] /= A[i][i]; }
  for (let i = n - 1; i >= 0; i--) { for (let k = i + 1; k < n; k++) x[i] -= A[k][i] * x[k]; x[i] /= A[i][i]; }
  return x;
}
