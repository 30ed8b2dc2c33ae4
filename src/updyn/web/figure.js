// A figure in the format of the report, in the colours of the page. It emits "pick" with the ends of a dragged band, or
// with a clicked frequency twice. It has a smallest width, because plotly cannot place titles in the few px that a page
// without its styles gives it.
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
    if (this.width) Plotly.purge(this.$refs.place);
  },
  watch: { figure: "draw" },
  methods: {
    draw() {
      const place = this.$refs.place, isFirst = !this.width;
      this.width = place.clientWidth;
      if (!this.width) return; // hidden
      updynReport.show(place, this.figure);
      if (!isFirst) return;
      place.on("plotly_click", ({ xvals }) => this.$emit("pick", [xvals[0], xvals[0]]));
      place.on("plotly_selected", (event) => {
        if (!event?.range) return;
        this.draw(); // without the frame of the selection
        this.$emit("pick", event.range.x);
      });
    },
  },
};
