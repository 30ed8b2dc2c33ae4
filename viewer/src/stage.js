// Canvas, camera and what is drawn when: a frame only where something changed, none off-screen.
import { Color, OrthographicCamera, Scene, Vector2, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

// Eyes by name: where the camera stands from the middle, and what is up.
const EYES = { iso: [1, 0.78, 0.56], back: [-1, -0.78, 0.56], x: [1, 0, 0], y: [0, -1, 0], z: [0, 0, 1] };
const MARGIN = 1.28;
// What is laid over the right side of the canvas is kept free of the structure up to this share of the width.
const WIDEST_COVER = 0.5;

export class Stage {
  // "smooth": whether edges are smoothed, which costs large scenes more than it gives. "cover": what is laid over the
  // right side of the canvas.
  constructor(place, canvas, xyz, smooth = true, cover = null) {
    this.cover = cover;
    this.sway = 0; // how far the structure moves
    this.covered = 0; // px at the right that were left free by the last fit
    this.fitted = true; // whether nobody has moved the camera since
    this.canvas = canvas;
    this.place = place;
    this.renderer = new WebGLRenderer({ canvas, antialias: smooth, powerPreference: "low-power" });
    this.renderer.debug.checkShaderErrors = false; // asking for them waits for the graphics card
    this.renderer.setPixelRatio(Math.min(devicePixelRatio || 1, 2));
    this.scene = new Scene();
    this.measure(xyz);
    this.camera = new OrthographicCamera(-1, 1, 1, -1, -20 * this.radius, 20 * this.radius);
    this.uniforms = {
      uGround: { value: new Vector3(1, 1, 1) }, uScreen: { value: new Vector2(1, 1) }, uFade: { value: 0.45 },
      uReach: { value: this.radius },
    };
    this.length = { value: 1 }; // of arrows
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.addEventListener("change", () => this.invalidate());
    this.controls.addEventListener("start", () => { this.fitted = false; });
    this.listeners = [];
    this.pending = false;
    this.size = [0, 0];
    this.look("iso");
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(place);
  }

  get shared() { return { uniforms: this.uniforms, middle: this.middle }; }

  // Middle of the box around all nodes, and its reach.
  measure(xyz) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const points of xyz) {
      for (let i = 0; i < points.length; i++) {
        const c = i % 3;
        if (points[i] < low[c]) low[c] = points[i];
        if (points[i] > high[c]) high[c] = points[i];
      }
    }
    this.middle = low.map((value, c) => (Number.isFinite(value) ? (value + high[c]) / 2 : 0));
    this.box = low.map((value, c) => (Number.isFinite(value) ? (high[c] - value) / 2 : 0));
    this.radius = Math.hypot(...this.box) || 1;
  }

  // Looks from a side, with everything in view.
  look(name) {
    const eye = new Vector3(...EYES[name]).normalize().multiplyScalar(4 * this.radius);
    this.camera.up.set(0, 0, 1);
    if (name === "z") this.camera.up.set(0, 1, 0);
    this.camera.position.copy(eye);
    this.controls.target.set(0, 0, 0);
    this.camera.lookAt(0, 0, 0);
    this.fit();
  }

  fit() {
    this.controls.target.set(0, 0, 0);
    const back = new Vector3();
    this.camera.getWorldDirection(back);
    this.camera.position.copy(back.multiplyScalar(-4 * this.radius));
    this.camera.updateMatrixWorld();
    const [right, up] = [new Vector3(), new Vector3()];
    this.camera.matrixWorld.extractBasis(right, up, back);
    const half = (axis) => axis.toArray().reduce((sum, part, c) => sum + Math.abs(part) * this.box[c], 0) * MARGIN || this.radius;
    const [width, height] = this.size;
    this.covered = this.toLeave();
    const aspect = ((width - this.covered) || 1) / (height || 1);
    this.half = Math.max(half(up) + this.sway, (half(right) + this.sway) / aspect, 0.05 * this.radius);
    this.camera.zoom = 1;
    this.fitted = true;
    this.frustum();
    this.controls.update();
    this.invalidate();
  }

  // Width in px of what is laid over the canvas; 0 where too little would be left beside it.
  toLeave() {
    const width = this.cover?.offsetWidth ? this.cover.offsetWidth + 16 : 0;
    return width < WIDEST_COVER * this.size[0] ? width : 0;
  }

  // Fits anew where more is covered than before, unless somebody has moved the camera.
  refit() { if (this.fitted && this.toLeave() > this.covered) this.fit(); }

  frustum() {
    const width = this.size[0] || 1, across = (2 * this.half * width) / (this.size[1] || 1);
    const left = -0.5 * across * (1 - this.covered / width); // the middle of what is free
    Object.assign(this.camera, { left, right: left + across, top: this.half, bottom: -this.half });
    this.camera.updateProjectionMatrix();
  }

  resize() {
    const { clientWidth, clientHeight } = this.place;
    if (!clientWidth || !clientHeight || (clientWidth === this.size[0] && clientHeight === this.size[1])) return;
    const first = !this.size[0];
    this.size = [clientWidth, clientHeight];
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.uniforms.uScreen.value.set(clientWidth, clientHeight);
    if (first) this.fit();
    this.frustum();
    this.draw(); // at once: another size empties the canvas
  }

  ground(colour) {
    this.renderer.setClearColor(new Color().setRGB(...colour, "srgb"), 1);
    this.uniforms.uGround.value.set(...colour);
    this.invalidate();
  }

  // Length of a pixel in the scene.
  get pixel() { return (2 * this.half) / (this.camera.zoom * (this.size[1] || 1)); }

  onDraw(listener) { this.listeners.push(listener); }

  invalidate() {
    if (this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => { this.pending = false; this.draw(); });
  }

  draw() {
    if (!this.size[0]) return;
    this.length.value = 46 * this.pixel;
    this.renderer.render(this.scene, this.camera);
    for (const listener of this.listeners) listener();
  }

  // A point of the scene on the screen, in px, and how far it is from the eye.
  project(point, out = new Vector3()) {
    out.set(...point).project(this.camera);
    return [(out.x + 1) * 0.5 * this.size[0], (1 - out.y) * 0.5 * this.size[1], out.z];
  }

  turn(right, up) {
    this.fitted = false;
    const offset = this.camera.position.clone().sub(this.controls.target);
    offset.applyAxisAngle(this.camera.up, -right);
    const side = new Vector3().crossVectors(this.camera.up, offset).normalize();
    const tilted = offset.clone().applyAxisAngle(side, -up);
    if (tilted.angleTo(this.camera.up) > 0.02 && tilted.angleTo(this.camera.up) < Math.PI - 0.02) offset.copy(tilted);
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.invalidate();
  }

  pan(right, up) {
    this.fitted = false;
    const [x, y, z] = [new Vector3(), new Vector3(), new Vector3()];
    this.camera.matrixWorld.extractBasis(x, y, z);
    const by = x.multiplyScalar(right * this.pixel).add(y.multiplyScalar(up * this.pixel));
    this.controls.target.add(by);
    this.camera.position.add(by);
    this.controls.update();
    this.invalidate();
  }

  zoom(factor) {
    this.fitted = false;
    this.camera.zoom *= factor;
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.invalidate();
  }

  dispose() {
    this.observer.disconnect();
    this.controls.dispose();
    this.renderer.dispose();
  }
}
