// A figure in the format of the report, in the colours of the page. It emits "pick" with the ends of a dragged band, or
// with a clicked frequency twice, and "row" with the number of a clicked row of a map. It has a smallest width, because
// plotly cannot place titles in the few px that a page without its styles gives it.
// The figures of a page are drawn in turn, and the browser shows each before the next.
let turn = Promise.resolve();
const takeTurn = (draw) => (turn = turn.then(() => new Promise((done) => setTimeout(done))).then(draw, draw));

export default {
  template: "<div style='min-width: 240px'><div ref='place'></div></div>",
  props: { figure: Object },
  mounted() {
    const place = this.$refs.place;
    this.observer = new ResizeObserver(() => { if (place.clientWidth !== this.width) this.draw(); });
    this.observer.observe(place);
    this.dark = matchMedia("(prefers-color-scheme: dark)");
    this.dark.addEventListener("change", this.draw);
  },
  beforeUnmount() {
    this.observer.disconnect();
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
      if (this.isDrawing || this.isGone) return;
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
