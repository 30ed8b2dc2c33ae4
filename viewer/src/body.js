// The nodes of a structure with their lines, faces and points, as arrays on the graphics card; drawn by any number of
// actors, each with a shape of its own.
import {
  BufferAttribute, BufferGeometry, DataTexture, FloatType, InstancedBufferAttribute, InstancedBufferGeometry,
  NearestFilter, RGBAFormat,
} from "three";
import { floats, integers } from "./decode.js";

// Beyond this many lines they are drawn one pixel wide, and of surfaces only those at which these end, bend by more than
// 20 degrees, or change their group: the others would be all that is seen, and each costs as much as a face.
const MANY_LINES = 20000, BEND = Math.cos((20 * Math.PI) / 180);

// Which lines are drawn: all but the edges within an even surface.
function outline({ n, xyz, lines, lineGroup, faces, faceGroup }) {
  const normals = new Float32Array(faces.length), edges = new Map(); // by edge its face; -1: it stays
  for (let f = 0; f < faces.length; f += 3) {
    const [a, b, c] = [3 * faces[f], 3 * faces[f + 1], 3 * faces[f + 2]], u = [0, 0, 0], v = [0, 0, 0];
    for (let k = 0; k < 3; k++) { u[k] = xyz[b + k] - xyz[a + k]; v[k] = xyz[c + k] - xyz[a + k]; }
    const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const size = Math.hypot(...normal) || 1;
    for (let k = 0; k < 3; k++) normals[f + k] = normal[k] / size;
  }
  const key = (a, b) => (a < b ? a * n + b : b * n + a), inner = new Set();
  for (let f = 0; f < faces.length; f += 3) {
    for (let k = 0; k < 3; k++) {
      const edge = key(faces[f + k], faces[f + ((k + 1) % 3)]), other = edges.get(edge);
      if (other === undefined) { edges.set(edge, f); continue; }
      const even = Math.abs(normals[f] * normals[other] + normals[f + 1] * normals[other + 1] + normals[f + 2] * normals[other + 2]) > BEND;
      if (even && faceGroup[f / 3] === faceGroup[other / 3]) inner.add(edge); else inner.delete(edge);
    }
  }
  const kept = [];
  for (let i = 0; i < lineGroup.length; i++) if (!inner.has(key(lines[2 * i], lines[2 * i + 1]))) kept.push(i);
  return { lines: Int32Array.from(kept.flatMap((i) => [lines[2 * i], lines[2 * i + 1]])), lineGroup: Int32Array.from(kept, (i) => lineGroup[i]) };
}

export function texture(data, width, height, type = FloatType) {
  const made = new DataTexture(data, width, height, RGBAFormat, type);
  made.minFilter = made.magFilter = NearestFilter;
  made.needsUpdate = true;
  return made;
}

export class Body {
  constructor(given) {
    this.name = given.name;
    this.labels = integers(given.labels);
    this.xyz = floats(given.xyz);
    this.n = this.labels.length;
    this.real = given.real; // nodes beyond stand on the rims of discs, which show rotations
    this.disc = given.disc; // radius of the discs in m
    this.groups = given.groups;
    this.lines = integers(given.lines);
    this.lineGroup = integers(given.line_group);
    this.faces = integers(given.faces);
    this.faceGroup = integers(given.face_group);
    if (this.many && this.faces.length) Object.assign(this, outline(this));
    this.points = integers(given.points);
    this.pointGroup = integers(given.point_group);
    this.wide = Math.max(1, Math.min(1024, this.n));
    this.high = Math.max(1, Math.ceil(this.n / this.wide));
    this.geometries = new Map();
  }

  get many() { return this.lines.length / 2 > MANY_LINES; }

  // A texture of three numbers a node; positions are taken from the middle of the scene.
  texture(values, middle = [0, 0, 0]) {
    const data = new Float32Array(4 * this.wide * this.high);
    if (values) for (let i = 0; i < this.n; i++) for (let c = 0; c < 3; c++) data[4 * i + c] = values[3 * i + c] - middle[c];
    return texture(data, this.wide, this.high);
  }

  // The groups of a node, by the lines, faces and points that meet there.
  groupsAt(node) {
    const found = new Set();
    for (let i = 0; i < this.lines.length; i++) if (this.lines[i] === node) found.add(this.lineGroup[i >> 1]);
    for (let i = 0; i < this.faces.length; i++) if (this.faces[i] === node) found.add(this.faceGroup[Math.floor(i / 3)]);
    for (let i = 0; i < this.points.length; i++) if (this.points[i] === node) found.add(this.pointGroup[i]);
    return [...found].filter((group) => group >= 0);
  }

  // By group the node that is nearest to the middle of its lines, faces and points; -1 for a group without any.
  anchors() {
    if (this.anchorOf) return this.anchorOf;
    const parts = [[this.lines, this.lineGroup], [this.faces, this.faceGroup], [this.points, this.pointGroup]];
    const middle = this.groups.map(() => [0, 0, 0, 0]), nearest = this.groups.map(() => Infinity);
    const each = (act) => {
      for (const [at, group] of parts) {
        const corners = group.length ? at.length / group.length : 1;
        for (let i = 0; i < at.length; i++) { const of = group[Math.floor(i / corners)]; if (of >= 0) act(of, at[i]); }
      }
    };
    each((group, node) => { for (let c = 0; c < 3; c++) middle[group][c] += this.xyz[3 * node + c]; middle[group][3]++; });
    this.anchorOf = this.groups.map(() => -1);
    each((group, node) => {
      let away = 0;
      for (let c = 0; c < 3; c++) away += (this.xyz[3 * node + c] - middle[group][c] / middle[group][3]) ** 2;
      if (away < nearest[group]) { nearest[group] = away; this.anchorOf[group] = node; }
    });
    return this.anchorOf;
  }

  geometry(kind) {
    if (!this.geometries.has(kind)) this.geometries.set(kind, MAKE[kind](this));
    return this.geometries.get(kind);
  }

  dispose() { for (const geometry of this.geometries.values()) geometry.dispose(); }
}

const own = (values, size, Kind = BufferAttribute) => new Kind(Float32Array.from(values), size);

// Groups are numbered from 1 in a palette, in which 0 is what is in none.
const each = (groups, times) => Float32Array.from({ length: groups.length * times }, (_, i) => groups[Math.floor(i / times)] + 1);

function corners(count) {
  const made = new InstancedBufferGeometry();
  made.setAttribute("position", own([0, -1, 0, 1, -1, 0, 0, 1, 0, 1, 1, 0], 3));
  made.setIndex([0, 1, 2, 2, 1, 3]);
  made.instanceCount = count;
  return made;
}

function flat(nodes, group) {
  const made = new BufferGeometry();
  made.setAttribute("aNode", own(nodes, 1));
  made.setAttribute("aGroup", own(group, 1));
  made.setDrawRange(0, nodes.length);
  return made;
}

// Faces whose vertices are shaded once for each node and group, however many faces meet there.
function shared(nodes, groups) {
  const vertices = new Map(), index = new Uint32Array(nodes.length), node = [], group = [];
  const most = groups.reduce((high, one) => Math.max(high, one), 0) + 2;
  for (let i = 0; i < nodes.length; i++) {
    const of = groups[Math.floor(i / 3)] + 1, key = nodes[i] * most + of;
    let at = vertices.get(key);
    if (at === undefined) {
      at = node.length;
      vertices.set(key, at);
      node.push(nodes[i]);
      group.push(of);
    }
    index[i] = at;
  }
  const made = flat(node, group);
  made.setIndex(new BufferAttribute(index, 1));
  made.setDrawRange(0, index.length);
  return made;
}

const MAKE = {
  faces: (body) => shared(body.faces, body.faceGroup),
  points: (body) => flat(body.points, each(body.pointGroup, 1)),
  nodes: (body) => flat(Int32Array.from({ length: body.real }, (_, i) => i), new Float32Array(body.real)),
  hairs: (body) => flat(body.lines, each(body.lineGroup, 2)),
  lines: (body) => {
    const made = corners(body.lines.length / 2);
    made.setAttribute("aEnds", own(body.lines, 2, InstancedBufferAttribute));
    made.setAttribute("aGroup", own(each(body.lineGroup, 1), 1, InstancedBufferAttribute));
    return made;
  },
  stems: (body) => {
    const made = corners(body.real);
    made.setAttribute("aEnds", own(Array.from({ length: 2 * body.real }, (_, i) => i >> 1), 2, InstancedBufferAttribute));
    made.setAttribute("aGroup", own(new Float32Array(body.real), 1, InstancedBufferAttribute));
    return made;
  },
};
