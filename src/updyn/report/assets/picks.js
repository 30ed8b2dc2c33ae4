// Modes are picked, left out and added in the figure; the synthesised FRFs follow, and so do the lines for the job.
"use strict";
const updynPicks = (() => {
  const data = updynReport.read("updyn-picks"), base = updynReport.read("updyn-figures").picker;
  const find = (id) => document.getElementById(id);
  const { bytes, magnitude, phase, thinned } = updynCurves;
  const lines = new Float64Array(bytes(data.freq)), values = new Float32Array(bytes(data.values));
  const indicator = new Float32Array(bytes(data.cmif)), weights = new Float64Array(bytes(data.weights));
  const synthesis = new UpdynSynthesis({ lines, weights, values, decay: data.decay, power: data.power });
  const n = lines.length, spacing = (lines[n - 1] - lines[0]) / (n - 1);
  const POINTS = 2000, FEW = 200; // points of a curve at most; lines up to which they are points
  const NEAR = 6, TWICE = 400; // pixels from a click to what it means; milliseconds between two that are one
  const place = find("picker-plot"), channel = find("picker-channel");
  const entries = data.modes.map((mode) => ({ ...mode, found: true }));
  // "earlier": the modes and the fit before the last change, to compare with.
  let range = null, fit = null, earlier = null, redraw, said = "";

  const on = () => entries.filter((entry) => entry.on).sort((a, b) => a.f - b.f);
  const digits = (f) => Number(f.toPrecision(7));
  const shown = (f) => String(Number(f.toPrecision(5)));

  // -- what is picked
  function written() {
    const rows = [], found = entries.filter((entry) => entry.found && entry.pole === null);
    if (found.some((entry) => !entry.on)) rows.push(["pick", found.filter((entry) => entry.on).map((entry) => digits(entry.f))]);
    const poles = entries.filter((entry) => entry.on && entry.pole !== null).map((entry) => digits(entry.pole));
    if (poles.length) rows.push(["poles", poles]);
    return Object.fromEntries(rows.map(([key, numbers]) => [key, [...new Set(numbers)].sort((a, b) => a - b)]));
  }

  function remember() { earlier = { modes: on(), fit }; }

  function toggle(entry) {
    const others = entries.filter((other) => other !== entry && other.on && other.found && other.pole === null);
    if (entry.on && entry.found && entry.pole === null && !others.length) { said = "At least one of the modes that were found stays."; again(false); return; }
    remember();
    if (entry.found) entry.on = !entry.on;
    else entries.splice(entries.indexOf(entry), 1);
    said = `${shown(entry.f)} Hz ${entry.found && entry.on ? "is a mode again" : "is left out"}.`;
    again();
  }

  function add(f) {
    if (!data.canAdd) { said = "These modes were found all at once, from data without noise; none can be added."; again(false); return; }
    if (!(f > 0 && f >= lines[0] && f <= lines[n - 1])) { said = `${f} Hz is not within the band, ${shown(lines[0])} to ${shown(lines[n - 1])} Hz.`; again(false); return; }
    const out = entries.find((entry) => !entry.on && Math.abs(entry.f - f) <= 0.5 * entry.loss * entry.f); // within its half-power band
    if (out) { toggle(out); return; }
    remember();
    const loss = synthesis.loss(f, on());
    entries.push({ f, loss, pole: f, on: true, found: false });
    said = `A mode at ${shown(f)} Hz is added, with a loss factor of ${(100 * loss).toPrecision(2)} % until it is refined.`;
    again();
  }

  // Two clicks at one place show the whole band; what the first one picked is taken back.
  let last = { time: -Infinity, x: 0, y: 0, entries: [] };
  let pressed = { x: 0, y: 0 }; // the click that plotly makes of a touch has no place of its own
  function click({ timeStamp: time }) {
    const { x, y } = pressed;
    if (time - last.time < TWICE && Math.hypot(x - last.x, y - last.y) < NEAR) {
      entries.splice(0, entries.length, ...last.entries);
      last = { ...last, time: -Infinity };
      range = null;
      said = "";
      again();
      return;
    }
    last = { time, x, y, entries: entries.map((entry) => ({ ...entry })) };
    choose(x, y);
  }

  // What a click at a place of the figure means: a mode near it, a peak without a mode, a pole, or a frequency.
  function choose(x, y) {
    const { xaxis, yaxis, yaxis2, yaxis4 } = place._fullLayout, box = place.getBoundingClientRect();
    const left = x - box.left - xaxis._offset, top = y - box.top;
    if (left < 0 || left > xaxis._length || top < yaxis._offset || top > yaxis4._offset + yaxis4._length) return;
    const away = (f) => Math.abs(xaxis.d2p(f) - left);
    const nearest = (items, of) => items.filter((item) => away(of(item)) <= NEAR).sort((a, b) => away(of(a)) - away(of(b)))[0];
    const mode = nearest(entries, (entry) => entry.f);
    if (mode) { toggle(mode); return; }
    const peak = nearest(data.peaks, (f) => f);
    if (peak !== undefined) { add(peak); return; }
    const order = top - yaxis2._offset;
    const [frequencies, orders] = data.poles.length ? data.poles : [[], []];
    const pole = nearest(frequencies.map((f, k) => [f, orders[k]]).filter(([, y]) => Math.abs(yaxis2.d2p(y) - order) <= NEAR), ([f]) => f);
    add(pole ? pole[0] : onPeak(xaxis.p2d(left), xaxis.p2d(NEAR) - xaxis.p2d(0)));
  }

  // The highest line of the first singular value near a frequency; the frequency itself where there is no maximum.
  function onPeak(f, reach) {
    let best = -1;
    for (let i = 1; i < n - 1; i++) {
      if (Math.abs(lines[i] - f) > reach) continue;
      if (indicator[i] >= indicator[i - 1] && indicator[i] > indicator[i + 1] && (best < 0 || indicator[i] > indicator[best])) best = i;
    }
    return best < 0 ? Number(f.toPrecision(5)) : lines[best];
  }

  // -- curves
  function within() { // positions of the lines that are shown
    if (!range) return [0, n];
    let first = 0, end = n;
    while (first < n && lines[first] < range[0]) first++;
    while (end > first && lines[end - 1] > range[1]) end--;
    return [first, end];
  }

  // A zero has no place on a logarithmic axis.
  const gaps = (y) => Array.from(y, (v) => (v > 0 ? v : null));
  function sizes(pairs, first, end) { return { x: lines.subarray(first, end), y: gaps(magnitude(pairs, 2 * first, end - first)) }; }

  function together(curve, first, end) { // rms over all channels
    const y = new Float64Array(end - first);
    for (let k = 0; k < data.channels.length; k++) {
      const own = curve(k);
      for (let i = first; i < end; i++) y[i - first] += (own[2 * i] ** 2 + own[2 * i + 1] ** 2) / data.channels.length;
    }
    return { x: lines.subarray(first, end), y: gaps(y.map(Math.sqrt)) };
  }

  const measured = (k) => values.subarray(2 * n * k, 2 * n * (k + 1));

  function curves(first, end) {
    const out = {}, k = Number(channel.value), all = channel.value === "all";
    for (let c = 0; c < indicator.length / n; c++) {
      out[`cmif-${c}`] = { x: lines.subarray(first, end), y: gaps(indicator.subarray(c * n + first, c * n + end)) };
    }
    out.measured = all ? together(measured, first, end) : sizes(measured(k), first, end);
    if (!all) out["measured-phase"] = phase(measured(k), 2 * first, lines.subarray(first, end));
    if (fit) {
      const computed = (c) => synthesis.curve(fit, c);
      if (all) out.synthesised = together(computed, first, end);
      else {
        const own = computed(k);
        out.synthesised = sizes(own, first, end);
        out["synthesised-phase"] = phase(own, 2 * first, lines.subarray(first, end));
      }
    }
    return out;
  }

  // A logarithmic axis for what is shown, nine decades at most.
  function span(drawn) {
    let low = Infinity, high = 0;
    for (const { y } of drawn) for (const v of y) if (v > 0) { if (v < low) low = v; if (v > high) high = v; }
    if (!high) return {};
    const [bottom, top] = [Math.max(Math.log10(low), Math.log10(high) - 9), Math.log10(high)], room = Math.max(0.05 * (top - bottom), 0.1);
    return { range: [bottom - room, top + room], dtick: top - bottom < 2 ? "D2" : Math.ceil((top - bottom) / 4) };
  }

  function make() {
    const [first, end] = within(), drawn = curves(first, end), row = base.row - 1;
    const marks = {
      mode: on().filter((entry) => entry.found), added: on().filter((entry) => !entry.found),
      "left-out": entries.filter((entry) => !entry.on), peak: data.peaks.filter((f) => !entries.some((entry) => entry.on && entry.pole !== null && Math.abs(entry.pole - f) <= spacing)).map((f) => ({ f })),
    };
    const traces = base.data.map((trace) => {
      const curve = drawn[trace.meta], marked = marks[trace.meta];
      if (curve) {
        const points = end - first <= FEW && trace.meta.startsWith("measured") ? { mode: "markers", marker: { color: trace.line.color, size: 5 } } : {};
        return { ...trace, ...points, ...thinned(curve, POINTS) };
      }
      if (marked) return { ...trace, x: marked.map((entry) => entry.f), y: marked.map(() => row) };
      return trace;
    });
    const indicators = Object.keys(drawn).filter((name) => name.startsWith("cmif")).map((name) => drawn[name]);
    const unit = channel.value === "all" ? data.together : data.channels[Number(channel.value)].unit;
    const room = 0.005 * (lines[n - 1] - lines[0]), narrow = place.clientWidth < 640;
    const own = {
      ...base.layout,
      shapes: on().map((entry) => ({ type: "line", x0: entry.f, x1: entry.f, y0: 0, y1: 1, yref: "paper", layer: "below", opacity: 0.45,
        line: { color: entry.found ? "@after" : "@before", width: 1, dash: entry.found ? "solid" : "dash" } })),
      xaxis: { ...base.layout.xaxis, range: range ?? [lines[0] - room, lines[n - 1] + room] },
      yaxis: { ...base.layout.yaxis, ...span(indicators) },
      yaxis3: { ...base.layout.yaxis3, ...span([drawn.measured, drawn.synthesised].filter(Boolean)), title: { text: `${data.quantity} (${unit})` } },
    };
    if (!narrow) return { data: traces, own, height: base.height };
    const height = base.height + 120; // the legend has a row for each name, below what it names
    return { data: traces, own: { ...own, legend: { y: -70 / height, yanchor: "top" } }, height };
  }

  // -- what is said
  function median(values) {
    const sorted = [...values].sort((a, b) => a - b), middle = sorted.length >> 1;
    return sorted.length % 2 ? sorted[middle] : 0.5 * (sorted[middle - 1] + sorted[middle]);
  }
  const score = (v) => (v < 0.99 || v >= 1 ? v.toFixed(2) : v < 0.9995 ? v.toFixed(3) : ">0.999");

  // Positions of the lines that are shown and that the modes can explain, or could before the last change; of all that
  // are shown where there is none.
  function explained() {
    const [first, end] = within(), reach = ({ f, loss }) => data.reach * f * loss, modes = [...on(), ...(earlier?.modes ?? [])];
    const low = Math.min(...modes.map((mode) => mode.f - reach(mode))), high = Math.max(...modes.map((mode) => mode.f + reach(mode)));
    let from = first, to = end;
    while (from < end && lines[from] < low) from++;
    while (to > from && lines[to - 1] > high) to--;
    return from < to ? [from, to] : [first, end];
  }

  function say() {
    const [first, end] = explained(), of = (made) => data.channels.map((_, k) => synthesis.frac(synthesis.curve(made, k), k, first, end));
    let text = "Nothing is synthesised: there are too few lines for so many modes, or a loss factor is not known.";
    if (fit && end > first) {
      const now = of(fit), before = earlier?.fit ? of(earlier.fit) : null;
      const both = (figure) => (before ? `${score(figure(before))} → ` : "") + score(figure(now));
      const sorted = (fracs) => [...fracs].sort((a, b) => a - b), worst = now.indexOf(sorted(now)[0]);
      const k = Number(channel.value), title = channel.selectedOptions[0].text;
      const own = `${title[0].toUpperCase()}${title.slice(1)}: FRAC ${channel.value === "all" ? "" : both((fracs) => fracs[k])}`;
      const all = now.length < 2 ? "" : `${channel.value === "all" ? "" : `; of ${data.note ? "the channels drawn" : "all channels"} `}${both(median)} in the median, ` +
        `${both((fracs) => sorted(fracs)[0])} at least${String(worst) === channel.value ? "" : ` (${data.channels[worst].name})`}`;
      text = `${own}${all}; from ${shown(lines[first])} to ${shown(lines[end - 1])} Hz${before ? ", before → after the last change" : ""}.`;
      find("worst-channel").dataset.channel = worst;
    }
    find("picker-frac").textContent = text;
  }

  function list() {
    const box = find("picked-modes");
    box.replaceChildren(...[...entries].sort((a, b) => a.f - b.f).map((entry) => {
      const button = Object.assign(document.createElement("button"), { type: "button", textContent: `${shown(entry.f)} Hz` });
      button.className = entry.found ? "mode" : "mode added";
      button.setAttribute("aria-pressed", String(entry.on));
      button.addEventListener("click", () => toggle(entry));
      return button;
    }));
    const added = entries.filter((entry) => !entry.found).length, out = entries.filter((entry) => !entry.on).length;
    const count = on().length;
    find("picker-count").textContent = `${count} ${count === 1 ? "mode" : "modes"}${added ? `, ${added} of them not refined yet` : ""}${out ? `; ${out} left out` : ""}.`;
    find("picker-said").textContent = said;
    const keys = written(), rows = Object.entries(keys).map(([key, numbers]) => `${key} = [${numbers.join(", ")}]`);
    find("picks").textContent = rows.length ? ["[modes]", ...rows].join("\n") : find("picks").dataset.none;
    for (const row of document.querySelectorAll("[data-modes]")) {
      row.hidden = row.dataset.modes.split(" ").some((f) => entries.some((entry) => !entry.on && digits(entry.f) === digits(Number(f))));
    }
    return keys;
  }

  function again(changed = true) {
    if (changed) fit = synthesis.fit(on());
    const keys = list();
    if (!changed) return;
    say();
    redraw();
    // Within another page, as in a window of updyn serve: it hears of it.
    if (parent !== window) parent.postMessage({ updynPick: { pick: keys.pick ?? [], poles: keys.poles ?? [] } }, "*");
  }

  function show(k) {
    channel.value = String(k);
    say();
    redraw();
  }

  // Picks that the address of the page states, "#pick=13.5,51.8&poles=853.5": those of a job that has not run since.
  function restore() {
    const given = new URLSearchParams(location.hash.slice(1)), list = (key) => (given.get(key) ?? "").split(",").map(Number).filter((f) => f > 0);
    if (!given.has("pick") || !given.has("poles")) return;
    const pick = list("pick"), poles = list("poles"), picked = new Set();
    for (const f of pick) { // the nearest mode, or peak without one
      const away = (other) => Math.abs(other - f), entry = [...entries].sort((a, b) => away(a.pole ?? a.f) - away(b.pole ?? b.f))[0];
      const peak = data.peaks.find((other) => away(other) < away(entry.pole ?? entry.f));
      if (peak === undefined) picked.add(entry); else poles.push(peak);
    }
    const same = (entry) => poles.some((f) => entry.pole !== null && Math.abs(f - entry.pole) <= 1e-6 * f);
    for (const entry of entries) entry.on = picked.has(entry) || same(entry) || (entry.pole === null && !pick.length);
    for (const f of poles) {
      if (entries.some((entry) => entry.pole !== null && Math.abs(f - entry.pole) <= 1e-6 * f)) continue;
      entries.push({ f, loss: synthesis.loss(f, on()), pole: f, on: true, found: false });
    }
  }

  // What is typed; no form, which a page within another one may not send.
  function enter() {
    const text = find("add-frequency").value.trim().replace(",", "."), f = Number(text);
    if (text && !entries.some((entry) => entry.on && Math.abs(entry.f - f) <= 1e-6 * f)) add(f);
  }

  function start() {
    if (parent !== window) document.documentElement.classList.add("within");
    restore();
    data.channels.forEach(({ name }, k) => channel.add(new Option(name, String(k))));
    if (data.together) channel.add(new Option("all channels, rms", "all"));
    channel.value = String(data.worst);
    fit = synthesis.fit(on());
    list();
    say();
    redraw = updynReport.draw(place, make, { doubleClick: false });
    place.addEventListener("updyn-drawn", () => {
      place.on("plotly_relayout", (change) => {
        if (change["xaxis.range[0]"] === undefined) return;
        range = [change["xaxis.range[0]"], change["xaxis.range[1]"]];
        say();
        redraw();
      });
      place.addEventListener("pointerdown", ({ clientX: x, clientY: y }) => { pressed = { x, y }; }, true);
      place.addEventListener("click", click);
    }, { once: true });
    channel.addEventListener("change", () => show(channel.value));
    find("worst-channel").addEventListener("click", (event) => show(event.currentTarget.dataset.channel ?? data.worst));
    find("add-mode").addEventListener("click", enter);
    find("add-frequency").addEventListener("keydown", (event) => { if (event.key === "Enter") enter(); });
    find("copy-picks").addEventListener("click", () => navigator.clipboard?.writeText(find("picks").textContent));
  }
  return { start, entries, synthesis };
})();

updynPicks.start();
