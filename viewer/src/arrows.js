// Arrows of sensors and forces, and the marker of the picked node. A sensor's arrow begins at its node, a force's ends
// there; a rotation or a torque has a second head.
import { BufferAttribute, BufferGeometry, DoubleSide, GLSL3, Mesh, ShaderMaterial, Vector3 } from "three";
import { arrows as shader } from "./shaders.js";

const SIDES = 8, HEAD = 0.3, HEAD_WIDTH = 0.085, SHAFT_WIDTH = 0.022, SECOND = 0.22;

// Triangles of a cone or cylinder about "along", from "from" to "to", as offsets.
function round(out, along, across, up, from, to, wide, narrow) {
  const rim = (at, radius, i) => {
    const angle = (2 * Math.PI * i) / SIDES, c = radius * Math.cos(angle), s = radius * Math.sin(angle);
    return [0, 1, 2].map((k) => at * along[k] + c * across[k] + s * up[k]);
  };
  for (let i = 0; i < SIDES; i++) {
    const a = rim(from, wide, i), b = rim(from, wide, i + 1), c = rim(to, narrow, i), d = rim(to, narrow, i + 1);
    out.push(...a, ...b, ...c, ...c, ...b, ...d, ...a, ...b, ...[0, 1, 2].map((k) => from * along[k]));
  }
}

function offsets({ kind, vector, rotation }) {
  const along = new Vector3(...vector), out = [];
  const across = new Vector3(...(Math.abs(along.x) < 0.8 ? [1, 0, 0] : [0, 1, 0])).cross(along).normalize();
  const up = along.clone().cross(across);
  const axes = [along, across, up].map((v) => v.toArray());
  const start = kind === "force" ? -1.15 : 0, tip = kind === "force" ? 0 : 1;
  const thick = kind === "force" ? 1.35 : 1;
  round(out, ...axes, start, tip - HEAD, SHAFT_WIDTH * thick, SHAFT_WIDTH * thick);
  for (const back of rotation ? [0, SECOND] : [0]) round(out, ...axes, tip - back - HEAD, tip - back, HEAD_WIDTH * thick, 0);
  return out;
}

// One mesh for all arrows of a kind on a body, moving with an actor's shape.
export function arrowsOf(arrows, actor, shared, length) {
  const node = [], offset = [];
  for (const arrow of arrows) {
    const own = offsets(arrow);
    for (const value of own) offset.push(value);
    for (let i = 0; i < own.length / 3; i++) node.push(arrow.node);
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("aNode", new BufferAttribute(Float32Array.from(node), 1));
  geometry.setAttribute("aOffset", new BufferAttribute(Float32Array.from(offset), 3));
  geometry.setDrawRange(0, node.length);
  const material = new ShaderMaterial({
    ...shader, glslVersion: GLSL3, side: DoubleSide,
    uniforms: { ...shared, ...actor.own, uLength: length, uColour: { value: new Vector3(0, 0, 0) } },
  });
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  return mesh;
}
