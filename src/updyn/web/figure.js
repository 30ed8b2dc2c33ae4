// A figure in the format of the report, in the colours of the page. It emits "pick" with the ends of a dragged band, or
// with a clicked frequency twice, and "row" with the number of a clicked row of a map. It has a smallest width, because
// plotly cannot place titles in the few px that a page without its styles gives it.
// A figure is drawn once it is on the screen or near it; until then it has its height. Figures are drawn in turn, each
// once the browser has shown the one before and has nothing else to do, or after a time.
const NEAR = "300px", PATIENCE = 200; // ms
const idle = window.requestIdleCallback?.bind(window) ?? ((done) => setTimeout(done));
const pause = () => new Promise((done) => idle(() => done(), { timeout: PATIENCE }));
let turn = Promise.resolve();
const takeTurn = (draw) => { const drawn = turn.then(draw); turn = drawn.then(pause, pause); return drawn; };

export default {
  template: `<div :style="{ minWidth: '240px', minHeight: (figure.height || 0) + 'px' }"><div ref='place'></div></div>`,
  props: { figure: Object },
  mounted() {
    const place = this.$refs.place;
    this.observer = new ResizeObserver(() => { if (place.clientWidth !== this.width) this.draw(); });
    this.observer.observe(place);
    this.sight = new IntersectionObserver((entries) => {
      this.isNear = entries.at(-1).isIntersecting;
      if (this.isNear && this.isOutdated) this.draw();
    }, { rootMargin: NEAR });
    this.sight.observe(this.$el);
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.dark.addEventListener("change", this.draw);
  },
  beforeUnmount() {
    this.observer.disconnect();
    this.sight.disconnect();
    this.dark.removeEventListener("change", this.draw);
    this.isOutdated = false;
    this.isGone = true;
    if (this.width && !this.isDrawing) Plotly.purge(this.$refs.place);
  },
  watch: { figure: "draw" },
  methods: {
    // Draws one figure after the other: plotly misplaces the legend if it is asked again before it has ended.
    async draw() {
      this.isOutdated = !this.isGone;
      if (this.isDrawing || this.isGone || !this.isNear) return;
      this.isDrawing = true;
      try {
        while (this.isOutdated) {
          this.isOutdated = false;
          await takeTurn(() => this.drawOnce());
        }
      } finally { this.isDrawing = false; }
    },
    async drawOnce() {
      if (this.isGone) return;
      const place = this.$refs.place, isFirst = !this.width;
      this.width = place.clientWidth;
      if (!this.width) return; // hidden
      await updynReport.show(place, this.figure);
      if (this.isGone) Plotly.purge(place);
      if (this.isGone || !isFirst) return;
      place.on("plotly_click", ({ points, xvals }) => {
        const row = points?.[0]?.data.type === "heatmap" ? points[0].pointIndex[0] : null;
        if (row === null) this.$emit("pick", [xvals[0], xvals[0]]);
        else this.$emit("row", row);
      });
      place.on("plotly_selected", (event) => {
        if (!event?.range) return;
        this.draw(); // without the frame of the selection
        this.$emit("pick", event.range.x);
      });
    },
  },
};
