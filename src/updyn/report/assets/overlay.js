// The overlay of measured and computed FRFs: one channel at a time, chosen by lists, buttons, arrow keys or a click on
// the maps of correlation. Arrays come as base64 and are decoded once.
"use strict";
const updynOverlay = (() => {
  const data = updynReport.read("updyn-frf");
  const root = document.getElementById("overlay");
  const find = (id) => document.getElementById(id);
  const pick = { response: find("pick-response"), reference: find("pick-reference") };
  const nR = data.responses.length, nC = data.references.length;

  const { bytes, phase } = updynCurves;
  const freq = data.freq ? new Float64Array(bytes(data.freq)) : new Float64Array(0);
  const grid = data.grid ? new Float64Array(bytes(data.grid)) : new Float64Array(0); // lines of the models' curves
  const n = freq.length, FEW = 200; // measured lines up to which they are points
  const linesOf = (name) => name === "measured" ? freq : grid;
  const sets = {};
  for (const name of ["measured", "before", "after"]) if (data[name]) sets[name] = new Float32Array(bytes(data[name]));
  const coherence = data.coherence ? new Float32Array(bytes(data.coherence)) : null;

  const channel = () => Number(pick.response.value) * nC + Number(pick.reference.value);

  const styles = {
    measured: { color: "@measured", width: 4.5 }, // wide and below: a curve that fits runs inside it,
    before: { color: "@before", width: 1.4, dash: "dot" },
    after: { color: "@after", width: 1.6 },
  };

  const words = { measured: "measured", before: "start", after: "updated" };

  function traces(k, held) {
    const out = [];
    for (const name of Object.keys(sets)) {
      const lines = linesOf(name), from = 2 * lines.length * k;
      const level = updynCurves.magnitude(sets[name], from, lines.length);
      // Few measured lines are points: nothing is known between them. A single one is a point of the models, too.
      const isPoints = (name === "measured" && n <= FEW) || lines.length === 1;
      const points = isPoints ? { mode: "markers", marker: { color: styles[name].color, size: 7 } } : {};
      const common = { type: "scatter", mode: "lines", line: styles[name], name: words[name], ...points };
      out.push({ ...common, legendgroup: name, x: lines, y: level, hovertemplate: `%{x:.5g} Hz: %{y:.4g} ${words[name]}<extra></extra>` });
      out.push({ ...common, ...phase(sets[name], from, lines), legendgroup: name, showlegend: false, yaxis: "y2",
        hovertemplate: `%{x:.5g} Hz: %{y:.1f}° ${words[name]}<extra></extra>` });
      if (name === "measured" && (!data.everyLineUsed || n <= 60) && !held && data.used.length) {
        out.push({ type: "scatter", mode: "markers", name: "lines used in the fit", x: data.used.map((i) => freq[i]),
          y: data.used.map((i) => level[i]), hoverinfo: "skip",
          marker: { symbol: "circle-open", size: 8, color: "@text", line: { width: 1.1 } } });
      }
    }
    if (coherence) {
      out.push({ type: "scatter", mode: "lines", name: "coherence", showlegend: false, yaxis: "y3", x: freq,
        y: coherence.subarray(n * k, n * (k + 1)), line: { color: "@muted", width: 1.2 },
        hovertemplate: "%{x:.5g} Hz: coherence %{y:.3f}<extra></extra>" });
    }
    return out;
  }

  function band(range, name) {
    return { type: "rect", xref: "x", yref: "paper", x0: range[0], x1: range[1], y0: 0, y1: 1, layer: "below",
      fillcolor: "@" + name, line: { width: 0 } };
  }

  function span(log) { // from the first line to the last, whatever markers would like; points are not cut in half
    if (n < 2) return undefined;
    const [low, high] = [freq[0], freq[n - 1]].map((f) => log ? Math.log10(f) : f);
    const room = n <= FEW ? 0.01 * (high - low) : 0;
    return [low - room, high + room];
  }

  function decades(drawn) {
    let low = Infinity, high = 0;
    for (const trace of drawn) {
      if (!trace.yaxis) for (const v of trace.y) { if (v > 0 && v < low) low = v; if (v > high) high = v; }
    }
    return Math.log10(high / low);
  }

  function make() {
    const k = channel(), i = Number(pick.response.value), j = Number(pick.reference.value), held = data.heldOut[i];
    const log = document.querySelector("input[name=freq-scale]:checked").value === "log";
    const shapes = [], drawn = traces(k, held);
    if (data.fitBand && !held) shapes.push(band(data.fitBand, "fit-band"));
    if (data.validationBand) shapes.push(band(data.validationBand, "held-band"));
    const foot = coherence ? { phase: [0.22, 0.42], level: [0.47, 1] } : { phase: [0, 0.27], level: [0.33, 1] };
    const own = {
      shapes, showlegend: true, // a zoom in frequency stays from channel to channel
      xaxis: { uirevision: log, range: span(log), title: { text: "frequency (Hz)" }, type: log ? "log" : "linear", anchor: coherence ? "y3" : "y2" },
      yaxis: { uirevision: k, type: "log", domain: foot.level, exponentformat: "power", dtick: decades(drawn) > 2 ? 1 : "D2",
        title: { text: `${data.quantity}<br>magnitude (${data.units[i][j]})` } },
      yaxis2: { domain: foot.phase, range: [-190, 190], tickvals: [-180, -90, 0, 90, 180], title: { text: "phase (°)" } },
    };
    if (coherence) own.yaxis3 = { domain: [0, 0.16], range: [0, 1.05], tickvals: [0, 0.5, 1], title: { text: "coherence" } };
    return { data: drawn, own, height: coherence ? 640 : 560 };
  }

  const percent = (v) => v === null ? "–" : v < 1e-4 ? "<0.01 %" : `${100 * v < 10 ? (100 * v).toPrecision(2) : (100 * v).toFixed(0)} %`;

  function say() {
    const i = Number(pick.response.value), j = Number(pick.reference.value);
    const of = (name) => data[name] ? data[name][i][j] : null;
    const digits = (v) => v === null ? "–" : v < 0.99 || v >= 1 ? v.toFixed(2).replace("-", "−") : v < 0.9995 ? v.toFixed(3) : ">0.999";
    const both = (what, name, say) => `${what} ${["Before", "After"].filter((when) => data[name + when]).map((when) => say(of(name + when))).join(" → ") || "–"}`;
    find("channel-name").textContent = `Response at ${pick.response.selectedOptions[0].dataset.label}, ${data.noun} at ` +
      `${pick.reference.selectedOptions[0].dataset.label} (channel ${channel() + 1} of ${nR * nC})`;
    find("channel-figures").textContent = [both("FRAC", "frac", digits), both("correlation", "correlation", digits),
      both("relative residual", "residual", percent)].join(", ") +
      (data.heldOut[i] ? "; held out: this response did not enter the fit" : "");
  }

  function select(i, j) {
    pick.response.value = String((i + nR) % nR);
    pick.reference.value = String((j + nC) % nC);
    again();
  }
  // Forward runs through the responses, then on to the next reference.
  function step(by) {
    const at = (Number(pick.reference.value) * nR + Number(pick.response.value) + by + nR * nC) % (nR * nC);
    select(at % nR, Math.floor(at / nR));
  }

  let redraw;
  function again() {
    say();
    redraw();
  }

  function start() {
    say();
    redraw = updynReport.draw(find("overlay-plot"), make);
    pick.response.addEventListener("change", again);
    pick.reference.addEventListener("change", again);
    find("previous-channel").addEventListener("click", () => step(-1));
    find("next-channel").addEventListener("click", () => step(1));
    for (const input of document.querySelectorAll("input[name=freq-scale]")) input.addEventListener("change", again);
    root.addEventListener("keydown", (event) => {
      if (event.target.matches("select, input") || event.altKey || event.ctrlKey || event.metaKey) return;
      if (event.key === "ArrowRight") step(1);
      else if (event.key === "ArrowLeft") step(-1);
      else return;
      event.preventDefault();
    });
    for (const name of ["frf-correlation-before", "frf-correlation-after"]) {
      updynReport.whenDrawn(name, (map) => map.on("plotly_click", (event) => {
        select(event.points[0].y, event.points[0].x);
        updynReport.reveal("frfs");
        root.scrollIntoView();
        root.focus({ preventScroll: true });
      }));
    }
  }
  // All channels in one picture; a channel that is chosen there is shown here.
  function together() {
    const place = find("all-channels-plot");
    if (!place) return;
    const names = [], units = [], figure = (k, name) => (data[name] ? data[name][Math.floor(k / nC)][k % nC] : null);
    for (let i = 0; i < nR; i++) for (let j = 0; j < nC; j++) {
      names.push(`Response ${pick.response.options[i].dataset.label}, ${data.noun} ${pick.reference.options[j].dataset.label}`);
      units.push(data.units[i][j]);
    }
    const looks = { measured: { width: 1, bold: 3.5 }, before: { width: 0.8, bold: 2, dash: [4, 3] }, after: { width: 0.8, bold: 2 } };
    const given = {
      names, units, quantity: data.quantity, sets: {},
      say: (k) => {
        const line = find("all-channels-said");
        if (k < 0) { line.textContent = ""; return; }
        const residual = figure(k, data.residualAfter ? "residualAfter" : "residualBefore");
        line.textContent = `${names[k]}${residual === null ? "" : `: relative residual ${percent(residual)}`}; Enter or a click shows it in detail`;
      },
      choose: (k) => {
        select(Math.floor(k / nC), k % nC);
        updynReport.reveal("frfs");
        root.scrollIntoView();
        root.focus({ preventScroll: true });
      },
    };
    for (const name of Object.keys(sets)) given.sets[name] = { lines: linesOf(name), values: sets[name], colour: name, ...looks[name] };
    const mount = () => {
      const boxes = [...document.querySelectorAll("input[name=all-sets]")];
      const shown = () => new Set(boxes.filter((box) => box.checked).map((box) => box.value));
      const drawn = new updynChannels.Channels(place, { ...given, shown: shown() });
      for (const box of boxes) box.addEventListener("change", () => drawn.set({ shown: shown() }));
      for (const input of document.querySelectorAll("input[name=all-scale]")) {
        input.addEventListener("change", () => drawn.set({ log: document.querySelector("input[name=all-scale]:checked").value === "log" }));
      }
      find("all-units")?.addEventListener("change", (event) => drawn.set({ unit: event.target.value }));
      updynReport.follow(() => drawn.draw());
      place.updynChannels = drawn;
    };
    new IntersectionObserver((entries, observer) => {
      if (!entries.some((entry) => entry.isIntersecting)) return;
      observer.disconnect();
      mount();
    }, { rootMargin: "300px" }).observe(place);
    addEventListener("beforeprint", () => { if (!place.updynChannels) mount(); });
  }
  return { start, together };
})();

updynOverlay.start();
updynOverlay.together();
