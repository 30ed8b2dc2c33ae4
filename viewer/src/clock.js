// The phase of the animation. It stands where the viewer is off-screen or its page is hidden, and where the reader wants
// less motion it starts at rest.

export class Clock {
  constructor(element, tick) {
    this.tick = tick;
    this.phase = 0;
    this.period = 1.6; // s
    this.playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.active = this.visible = false;
    this.running = false;
    this.observer = new IntersectionObserver((entries) => {
      this.visible = entries.at(-1).isIntersecting;
      this.run();
    });
    this.observer.observe(element);
    this.onShow = () => this.run();
    document.addEventListener("visibilitychange", this.onShow);
  }

  get moves() { return this.playing && this.active && this.visible && !document.hidden; }

  // Whether there is anything to animate.
  activate(active) { this.active = active; this.run(); }

  play(playing) { this.playing = playing; this.run(); }

  run() {
    if (this.running || !this.moves) return;
    this.running = true;
    let last = performance.now();
    const frame = (now) => {
      if (!this.moves) { this.running = false; return; }
      this.phase = (this.phase + (2 * Math.PI * Math.max(now - last, 0)) / (1000 * this.period)) % (2 * Math.PI);
      last = now;
      this.tick();
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  dispose() {
    this.active = false;
    this.observer.disconnect();
    document.removeEventListener("visibilitychange", this.onShow);
  }
}
