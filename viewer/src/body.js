// The nodes of a structure with their lines, faces and points, as arrays on the graphics card; drawn by any number of
// actors, each with a shape of its own.
import {
  BufferAttribute, BufferGeometry, DataTexture, FloatType, InstancedBufferAttribute, InstancedBufferGeometry,
  NearestFilter, RGBAFormat,
} from "three";
import { floats, integers } from "./decode.js";

// Beyond this many lines they are drawn one pixel wide.
const MANY_LINES = 20000;

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

const MAKE = {
  faces: (body) => flat(body.faces, each(body.faceGroup, 3)),
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
