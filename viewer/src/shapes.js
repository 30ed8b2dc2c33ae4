// What is animated: the shapes of a mode in each layer, or of an operating deflection at a frequency. A layer is a body
// in one state: start, updated, test.
import { floats, integers, scaled } from "./decode.js";

// Largest displacement as a share of the reach of the scene, and largest rotation of discs in rad, at amplitude 1.
const REACH = 0.12, TURN = 0.6;

function largest(shapes, from, to) {
  let most = 0;
  for (const { re, im } of shapes) {
    for (let i = 3 * from; i < 3 * to; i += 3) {
      let sum = 0;
      for (let c = i; c < i + 3; c++) sum += re[c] * re[c] + (im ? im[c] * im[c] : 0);
      if (sum > most) most = sum;
    }
  }
  return Math.sqrt(most);
}

// Scales shapes that are compared by one factor: nodes to 1, the rims of discs to a turn that can be seen.
export function levelled(shapes, body) {
  const nodes = largest(shapes, 0, body.real), rims = largest(shapes, body.real, body.n);
  return shapes.map(({ re, im }) => {
    const scale = (values) => values && values.map((value, i) => {
      const rim = i >= 3 * body.real;
      const most = rim ? rims : nodes;
      return most > 0 ? value / most : 0;
    });
    return { re: scale(re), im: scale(im) };
  });
}

// The colour of a layer by its name: ghosts are grey.
export const colourOf = ({ role, style }) => (style === "ghost" ? "muted" : role);

// How far a largest displacement of 1 goes, for a scene of this reach.
export const reach = (radius) => REACH * radius;
export const TURNS = TURN;

export class ModeShapes {
  constructor(given, bodies) {
    this.layers = given.layers.map((layer) => ({
      ...layer, colour: colourOf(layer), body: bodies[layer.body], shapes: layer.shapes.map((part) => ({ re: scaled(part.re), im: part.im && scaled(part.im) })),
    }));
    this.rows = given.rows;
  }

  // The shape of each layer in a row; null where it has none.
  at(row) {
    return this.rows[row].members.map((member, i) => (member < 0 ? null : this.layers[i].shapes[member]));
  }
}

export class OperatingShapes {
  constructor(given, bodies) {
    this.freq = floats(given.freq);
    this.unit = given.unit;
    this.quantity = given.quantity;
    this.body = bodies[given.body];
    this.entries = { dof: integers(given.entries.dof), node: integers(given.entries.node), vector: floats(given.entries.vector) };
    this.references = given.references.map((reference) => ({
      name: reference.name,
      layers: reference.layers.map((layer) => ({
        ...layer, colour: colourOf(layer), body: this.body, curve: floats(layer.curve), re: scaled(layer.re), im: scaled(layer.im),
      })),
    }));
    this.channels = given.channels;
  }

  // The shape of each layer at a line: what the sensors say of their nodes, in their directions.
  at(reference, line) {
    const { dof, node, vector } = this.entries;
    return this.references[reference].layers.map((layer) => {
      const re = new Float32Array(3 * this.body.n), im = new Float32Array(3 * this.body.n);
      for (let e = 0; e < dof.length; e++) {
        const at = line * this.channels + dof[e];
        for (let c = 0; c < 3; c++) {
          re[3 * node[e] + c] += layer.re[at] * vector[3 * e + c];
          im[3 * node[e] + c] += layer.im[at] * vector[3 * e + c];
        }
      }
      return { re, im };
    });
  }
}
