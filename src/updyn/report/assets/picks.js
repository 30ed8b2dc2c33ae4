// Modes picked in the stabilisation diagram at a click, as a line for the job.
"use strict";
(() => {
  const place = document.querySelector('[data-figure="diagram"]'), out = document.getElementById("picks");
  const picked = new Set();
  const written = (f) => Number(f.toPrecision(7)).toString();
  function show() {
    const sorted = [...picked].sort((a, b) => a - b);
    out.textContent = sorted.length ? `[modes]\npick = [${sorted.map(written).join(", ")}]` : out.dataset.none;
    Plotly.relayout(place, { shapes: sorted.map((f) => ({
      type: "line", x0: f, x1: f, y0: 0, y1: 1, yref: "paper",
      line: { color: getComputedStyle(document.documentElement).getPropertyValue("--before").trim(), width: 1.4 } })) });
  }
  updynReport.whenDrawn("diagram", () => place.on("plotly_click", (event) => {
    const point = event.points.find((p) => p.data.yaxis !== "y2");
    if (!point) return;
    // A click beside a picked mode takes it back.
    const near = [...picked].find((f) => Math.abs(f - point.x) <= 1e-3 * f);
    if (near === undefined) picked.add(point.x); else picked.delete(near);
    show();
    // Within another page, as in a window of updyn serve: it is told.
    if (parent !== window) parent.postMessage({ updynPick: { frequency: point.x } }, "*");
  }));
  document.getElementById("copy-picks").addEventListener("click", () => navigator.clipboard?.writeText(out.textContent));
})();
