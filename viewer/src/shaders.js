// Vertices know nothing but the number of their node. Positions, and real and imaginary part of what is animated, lie in
// textures with a texel a node: another shape is another texture, and a frame is two numbers.

const PLACE = `
precision highp float; precision highp int; precision highp sampler2D;
uniform sampler2D uBase, uRe, uIm, uPalette, uRamp;
uniform int uWide, uColouring;
uniform vec2 uPhase;
uniform vec3 uColour;
uniform float uShift; // to the right, of half the width: for pictures side by side
ivec2 cell(float node) { int i = int(node + 0.5); return ivec2(i % uWide, i / uWide); }
vec3 rest(float node) { return texelFetch(uBase, cell(node), 0).xyz; }
vec3 displacement(float node) {
  ivec2 at = cell(node);
  return uPhase.x * texelFetch(uRe, at, 0).xyz - uPhase.y * texelFetch(uIm, at, 0).xyz;
}
vec3 place(float node) { return rest(node) + displacement(node); }
vec3 shade(float node, float group) {
  if (uColouring == 1) { int g = int(group + 0.5); return texelFetch(uPalette, ivec2(g % 256, g / 256), 0).rgb; }
  if (uColouring == 2) {
    ivec2 at = cell(node);
    float size = length(vec2(length(texelFetch(uRe, at, 0).xyz), length(texelFetch(uIm, at, 0).xyz)));
    return texelFetch(uRamp, ivec2(int(255.0 * min(size, 1.0)), 0), 0).rgb;
  }
  return uColour;
}`;

// What is farther away fades into the ground: depth, where there is no perspective.
const FADE = `
precision highp float;
uniform vec3 uGround;
uniform float uFade;
in vec3 vColour;
in float vFar;
out vec4 colour;
vec3 faded(vec3 c) { return mix(c, uGround, uFade * clamp(vFar, 0.0, 1.0)); }`;

const FAR = "uniform float uReach; float far(vec4 seen, vec4 middle) { return 0.5 - 0.5 * (seen.z - middle.z) / uReach; }";

export const faces = {
  vertexShader: `${PLACE}
${FAR}
in float aNode, aGroup;
out vec3 vColour, vSeen;
out float vFar;
void main() {
  vec4 seen = modelViewMatrix * vec4(place(aNode), 1.0);
  vSeen = seen.xyz; vFar = far(seen, modelViewMatrix * vec4(0.0, 0.0, 0.0, 1.0)); vColour = shade(aNode, aGroup);
  gl_Position = projectionMatrix * seen;
  gl_Position.x += uShift * gl_Position.w;
}`,
  fragmentShader: `${FADE}
in vec3 vSeen;
void main() {
  vec3 n = normalize(cross(dFdx(vSeen), dFdy(vSeen)));
  float light = 0.66 + 0.22 * abs(n.z) + 0.12 * abs(dot(n, normalize(vec3(-0.5, 0.8, 0.4))));
  colour = vec4(faded(vColour * light), 1.0);
}`,
};

// Leaves out every second piece of a line: by its place along the line, so that dashes continue over many short lines.
const DASH = `
uniform float uDash; // length of a dash in px; 0: none
flat in vec2 vAlong;
void dash() { if (uDash > 0.0 && fract(dot(gl_FragCoord.xy, vAlong) / (2.0 * uDash)) > 0.5) discard; }`;

// Lines of a width in pixels: four corners for each, moved apart on the screen.
export const lines = {
  vertexShader: `${PLACE}
${FAR}
uniform vec2 uScreen;
uniform float uWidth, uNear;
in vec2 aEnds;
in float aGroup;
out vec3 vColour;
out float vFar;
flat out vec2 vAlong;
void main() {
  bool second = position.x > 0.5;
  vec3 first = rest(aEnds.x);
#ifndef STEMS
  first += displacement(aEnds.x);
#endif
  vec4 a = modelViewMatrix * vec4(first, 1.0), b = modelViewMatrix * vec4(place(aEnds.y), 1.0);
  vec4 pa = projectionMatrix * a, pb = projectionMatrix * b;
  vec2 along = (pb.xy / pb.w - pa.xy / pa.w) * uScreen;
  along = dot(along, along) > 1e-9 ? normalize(along) : vec2(1.0, 0.0);
  vec2 across = vec2(-along.y, along.x) * position.y;
  vec4 seen = second ? b : a;
  gl_Position = second ? pb : pa;
  gl_Position.xy += (across + along * (second ? 0.5 : -0.5)) * uWidth / uScreen * gl_Position.w;
  gl_Position.z -= uNear * gl_Position.w;
  gl_Position.x += uShift * gl_Position.w;
  vAlong = along.x < 0.0 || (along.x == 0.0 && along.y < 0.0) ? -along : along;
  vFar = far(seen, modelViewMatrix * vec4(0.0, 0.0, 0.0, 1.0)); vColour = shade(second ? aEnds.y : aEnds.x, aGroup);
}`,
  fragmentShader: `${FADE}
${DASH}
void main() { dash(); colour = vec4(faded(vColour), 1.0); }`,
};

// The same of one pixel, for many of them.
export const hairs = {
  vertexShader: `${PLACE}
${FAR}
uniform float uNear;
in float aNode, aGroup;
out vec3 vColour;
out float vFar;
flat out vec2 vAlong;
void main() {
  vec4 seen = modelViewMatrix * vec4(place(aNode), 1.0);
  vAlong = vec2(0.7071, 0.7071);
  vFar = far(seen, modelViewMatrix * vec4(0.0, 0.0, 0.0, 1.0)); vColour = shade(aNode, aGroup);
  gl_Position = projectionMatrix * seen;
  gl_Position.z -= uNear * gl_Position.w;
  gl_Position.x += uShift * gl_Position.w;
}`,
  fragmentShader: lines.fragmentShader,
};

export const points = {
  vertexShader: `${PLACE}
${FAR}
uniform float uSize, uNear;
in float aNode, aGroup;
out vec3 vColour;
out float vFar;
void main() {
  vec4 seen = modelViewMatrix * vec4(place(aNode), 1.0);
  vFar = far(seen, modelViewMatrix * vec4(0.0, 0.0, 0.0, 1.0)); vColour = shade(aNode, aGroup);
  gl_Position = projectionMatrix * seen;
  gl_Position.z -= uNear * gl_Position.w;
  gl_Position.x += uShift * gl_Position.w;
  gl_PointSize = uSize;
}`,
  fragmentShader: `${FADE}
uniform int uRound;
void main() {
  vec2 at = 2.0 * gl_PointCoord - 1.0;
  float edge = uRound == 1 ? dot(at, at) : max(abs(at.x), abs(at.y)) * max(abs(at.x), abs(at.y));
  if (edge > 1.0) discard;
  colour = vec4(edge > 0.62 ? uGround : faded(vColour), 1.0);
}`,
};

// Arrows of a length in pixels, which move with their node.
export const arrows = {
  vertexShader: `${PLACE}
${FAR}
uniform float uLength;
in float aNode;
in vec3 aOffset;
out vec3 vColour;
out float vFar;
void main() {
  vec4 seen = modelViewMatrix * vec4(place(aNode) + uLength * aOffset, 1.0);
  vFar = 0.0; vColour = uColour;
  gl_Position = projectionMatrix * seen;
  gl_Position.z -= 0.002 * gl_Position.w;
  gl_Position.x += uShift * gl_Position.w;
}`,
  fragmentShader: `${FADE}
void main() { colour = vec4(faded(vColour), 1.0); }`,
};
