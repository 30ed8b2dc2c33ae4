// Canvas, camera and what is drawn when: a frame only where something changed, none off-screen.
import { Color, OrthographicCamera, Scene, Vector2, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";

// Eyes by name: where the camera stands from the middle, and what is up.
const EYES = { iso: [1, 0.78, 0.56], x: [1, 0, 0], y: [0, -1, 0], z: [0, 0, 1] };
// Other corners, from which long structures extend over more of the width; taken where the picture becomes larger by GAIN.
const CORNERS = [[0.42, -1, 0.4], [1, -0.42, 0.4]], GAIN = 1.25;
// What is left free around the structure, for the ends of lines, and for arrows with their labels (px and share of the height).
const MARGIN = 20, ARROW_MARGIN = 60, WIDEST_MARGIN = 0.2;
// What is laid over the right side of the canvas is kept free of the structure up to this share of the width.
const WIDEST_COVER = 0.5;

export class Stage {
  // "smooth": whether edges are smoothed, which costs large scenes more than it gives. "cover": what is laid over the
  // right side of the canvas. "arrows": whether there are any.
  constructor(place, canvas, xyz, { smooth = true, cover = null, arrows = false }) {
    this.cover = cover;
    this.margin = arrows ? ARROW_MARGIN : MARGIN;
    this.sides = 1; // pictures side by side
    this.shifts = { left: { value: 0 }, right: { value: 0 } }; // of half the width
    this.xyz = xyz;
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
    this.radius = Math.hypot(...low.map((value, c) => (Number.isFinite(value) ? (high[c] - value) / 2 : 0))) || 1;
  }

  // Looks from a side, with everything in view.
  look(name) {
    this.camera.up.set(0, 0, 1);
    if (name === "z") this.camera.up.set(0, 1, 0);
    const sizes = [EYES[name], ...(name === "iso" ? CORNERS : [])].map((eye) => [this.turnTo(eye).pixel, eye]);
    const [best] = [...sizes].sort((a, b) => a[0] - b[0]);
    this.turnTo(best[0] * GAIN < sizes[0][0] ? best[1] : sizes[0][1]);
    this.fit();
  }

  // Puts the camera in a direction, and returns what is in view.
  turnTo(eye) {
    this.controls.target.set(0, 0, 0);
    this.camera.position.set(...eye).normalize().multiplyScalar(4 * this.radius);
    this.camera.lookAt(0, 0, 0);
    this.camera.updateMatrixWorld();
    return this.view();
  }

  // The middle of all nodes to the right and upwards, and the size of a pixel with which they fill the picture.
  view() {
    const [right, up, back] = [new Vector3(), new Vector3(), new Vector3()];
    this.camera.matrixWorld.extractBasis(right, up, back);
    const extent = (axis) => {
      let low = Infinity, high = -Infinity;
      for (const points of this.xyz) {
        for (let i = 0; i < points.length; i += 3) {
          const at = axis.x * (points[i] - this.middle[0]) + axis.y * (points[i + 1] - this.middle[1]) + axis.z * (points[i + 2] - this.middle[2]);
          if (at < low) low = at;
          if (at > high) high = at;
        }
      }
      return low <= high ? [(low + high) / 2, high - low] : [0, 0];
    };
    const [x, wide] = extent(right), [y, high] = extent(up), [width, height] = this.size;
    this.covered = this.toLeave();
    const least = (0.1 * this.radius) / (height || 1);
    // arrows have room at rest, and the structure in motion
    const needed = (margin, more) => {
      const free = (size) => Math.max(size - 2 * Math.min(margin, WIDEST_MARGIN * height), 1);
      return Math.max((wide + more) / free((width - this.covered) / this.sides), (high + more) / free(height));
    };
    return { right, up, x, y, pixel: Math.max(needed(this.margin, 0), needed(MARGIN, 2 * this.sway), least) };
  }

  // Whether two pictures side by side are as large as one.
  get hasRoom() {
    const [one, two] = [1, 2].map((sides) => { this.sides = sides; return this.view().pixel; });
    this.sides = 1;
    return two <= one * (1 + 1e-6);
  }

  fit() {
    const back = new Vector3();
    this.camera.getWorldDirection(back);
    this.camera.updateMatrixWorld();
    const { right, up, x, y, pixel } = this.view();
    this.controls.target.copy(right.multiplyScalar(x).add(up.multiplyScalar(y)));
    this.camera.position.copy(this.controls.target).add(back.multiplyScalar(-4 * this.radius));
    this.half = (pixel * (this.size[1] || 1)) / 2;
    this.camera.zoom = 1;
    this.fitted = true;
    this.frustum();
    this.controls.update();
    this.invalidate();
  }

  // Draws one picture, or two side by side.
  split(sides) {
    if (sides === this.sides) return;
    this.sides = sides;
    this.fit();
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
    const aside = this.sides > 1 ? (width - this.covered) / (2 * width) : 0;
    this.shifts.left.value = -aside;
    this.shifts.right.value = aside;
  }

  resize() {
    const { clientWidth, clientHeight } = this.place;
    if (!clientWidth || !clientHeight || (clientWidth === this.size[0] && clientHeight === this.size[1])) return;
    const first = !this.size[0];
    this.size = [clientWidth, clientHeight];
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.uniforms.uScreen.value.set(clientWidth, clientHeight);
    if (first) { this.look("iso"); this.onSize?.(); }
    else if (this.fitted) this.fit();
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

  // A point of the scene on the screen, in px, and how far it is from the eye; "shift" to the right, of half the width.
  project(point, shift = 0, out = new Vector3()) {
    out.set(...point).project(this.camera);
    return [(out.x + shift + 1) * 0.5 * this.size[0], (1 - out.y) * 0.5 * this.size[1], out.z];
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
