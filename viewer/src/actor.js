// A body as it is drawn: in which colours, how wide, in which shape.
import { DoubleSide, GLSL3, Group, LineSegments, Mesh, Points, ShaderMaterial, UnsignedByteType, Vector2, Vector3 } from "three";
import { texture } from "./body.js";
import { ramp, rgb } from "./colours.js";
import { faces, hairs, lines, points } from "./shaders.js";

export const PLAIN = 0, BY_GROUP = 1, BY_DISPLACEMENT = 2;

export class Actor extends Group {
  // "shared" are the uniforms of the stage: ground, screen, reach.
  constructor(body, shared, { surface = true, width = 1.6, dots = false, squares = true, behind = false, dash = 0, shift = { value: 0 } }) {
    super();
    this.body = body;
    this.base = body.texture(body.xyz, shared.middle);
    this.still = body.texture(null);
    this.re = this.im = null;
    this.own = {
      uBase: { value: this.base }, uRe: { value: this.still }, uIm: { value: this.still }, uWide: { value: body.wide },
      uPhase: { value: new Vector2(0, 0) }, uColour: { value: new Vector3(0.5, 0.5, 0.5) },
      uColouring: { value: PLAIN }, uPalette: { value: null }, uRamp: { value: null }, uShift: shift,
    };
    this.shared = shared.uniforms;
    this.materials = [];
    if (surface && body.faces.length) this.put(Mesh, "faces", faces, { uFade: { value: 0.15 } }, { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 });
    if (body.lines.length) {
      const near = { value: behind ? -0.0008 : surface ? 0.0004 : 0.0008 };
      // Edges on a surface of the same colour would not be seen.
      this.edge = surface && body.faces.length ? { uColouring: { value: PLAIN }, uColour: { value: new Vector3(0, 0, 0) } } : null;
      const dashes = { value: dash };
      if (body.many) this.put(LineSegments, "hairs", hairs, { uNear: near, uDash: dashes, ...this.edge });
      else this.put(Mesh, "lines", lines, { uNear: near, uWidth: { value: this.edge ? 1 : width }, uDash: dashes, ...this.edge });
    }
    if (body.points.length && squares) this.put(Points, "points", points, { uSize: { value: 13 }, uNear: { value: 0.001 }, uRound: { value: 0 } });
    if (dots) {
      this.put(Points, "nodes", points, { uSize: { value: 9 }, uNear: { value: 0.0012 }, uRound: { value: 1 } });
      this.put(Mesh, "stems", { ...lines, defines: { STEMS: 1 } }, { uNear: { value: 0.0008 }, uWidth: { value: 1.2 }, uDash: { value: 0 } });
    }
  }

  put(Kind, geometry, shader, uniforms, options = {}) {
    const material = new ShaderMaterial({
      ...shader, ...options, glslVersion: GLSL3, side: DoubleSide, uniforms: { ...this.shared, ...this.own, ...uniforms },
    });
    const drawn = new Kind(this.body.geometry(geometry), material);
    drawn.frustumCulled = false; // where nodes are is known to the shader only
    this.materials.push(material);
    this.add(drawn);
    return drawn;
  }

  // Colours of the groups, the first for what is in none, each as red, green and blue.
  palette(colours) {
    const high = Math.ceil(colours.length / 256), data = new Uint8Array(4 * 256 * high);
    colours.forEach((colour, i) => data.set([...colour.map((part) => Math.round(255 * part)), 255], 4 * i));
    this.own.uPalette.value?.dispose();
    this.own.uPalette.value = texture(data, 256, high, UnsignedByteType);
  }

  colour(colouring, plain, element) {
    this.own.uColouring.value = colouring;
    this.own.uColour.value.set(...plain);
    if (colouring === BY_DISPLACEMENT) {
      this.own.uRamp.value?.dispose();
      this.own.uRamp.value = texture(ramp(element), 256, 1, UnsignedByteType);
    }
    this.edge?.uColour.value.set(...rgb(element, "edge"));
  }

  // What is shown: real and imaginary part at each node, (n, 3) each, the largest of them 1; null: at rest.
  shape(re, im) {
    for (const old of [this.re, this.im]) old?.dispose();
    this.re = re && this.body.texture(re);
    this.im = im && this.body.texture(im);
    this.values = re && { re, im };
    this.own.uRe.value = this.re ?? this.still;
    this.own.uIm.value = this.im ?? this.still;
  }

  phase(cosine, sine) { this.own.uPhase.value.set(cosine, sine); }

  // Position of a node at rest.
  restOf(node) { return [...this.base.image.data.slice(4 * node, 4 * node + 3)]; }

  // Position of a node as it is drawn now.
  placeOf(node, out = [0, 0, 0]) {
    const { x, y } = this.own.uPhase.value;
    for (let c = 0; c < 3; c++) {
      const i = 3 * node + c;
      out[c] = this.base.image.data[4 * node + c];
      if (this.values) out[c] += x * this.values.re[i] - (this.values.im ? y * this.values.im[i] : 0);
    }
    return out;
  }

  // How far to the right it is drawn, of half the width.
  get shift() { return this.own.uShift.value; }

  dispose() {
    for (const material of this.materials) material.dispose();
    for (const made of [this.base, this.still, this.re, this.im, this.own.uPalette.value, this.own.uRamp.value]) made?.dispose();
  }
}
