// Draws the figures of the page. A figure is plotly data in which a text "@name" stands for the colour --name of the
// style sheet, so that figures follow the ground of the page: light, dark or paper.
"use strict";
const updynReport = (() => {
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  // One a figure: "again" draws it, or draws it again in the colours of now. A figure is drawn once it is unfolded, one
  // after the other, so that the page can be read and used meanwhile.
  const painters = [], queue = [];
  const config = {
    responsive: true, displaylogo: false, modeBarButtons: [["toImage"]], // SVG: a bitmap would be refused by the policy
    toImageButtonOptions: { format: "svg", filename: document.title },
  };

  function paint(value, key) {
    if (typeof value === "string") {
      return /^(fill|bg|border)?color$/.test(key) && value.startsWith("@") ? colour(value.slice(1)) : value;
    }
    if (Array.isArray(value)) return value.map((part) => paint(part, key));
    if (value === null || typeof value !== "object" || ArrayBuffer.isView(value)) return value;
    return Object.fromEntries(Object.entries(value).map(([name, part]) => [name, paint(part, name)]));
  }

  function axis(own) {
    const line = { gridcolor: colour("grid"), linecolor: colour("faint"), zerolinecolor: colour("faint") };
    const ticks = { ticks: "outside", tickcolor: colour("faint"), minorloglabels: "complete" }; // 20, not 2, after 10
    const merged = { automargin: true, ...ticks, ...line, ...own };
    const font = { size: parseFloat(colour("figure-text")) }; // else larger than all other texts of the figure
    if (own && own.title) merged.title = { standoff: 8, font, ...own.title };
    return merged;
  }

  function layout(own, height) {
    const out = {
      height, autosize: true, paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
      font: { family: getComputedStyle(document.body).fontFamily, size: parseFloat(colour("figure-text")), color: colour("text") },
      margin: { l: 60, r: 16, t: 30, b: 48 }, hovermode: "closest", dragmode: "zoom",
      modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("faint"), activecolor: colour("link") },
      hoverlabel: { bgcolor: colour("panel"), font: { color: colour("text") }, bordercolor: colour("faint") },
      colorway: ["after", "before", "third", "fourth", "measured", "muted"].map(colour),
      ...paint(own),
    };
    for (const key of Object.keys(out)) if (/^[xy]axis\d*$/.test(key)) out[key] = axis(out[key]);
    // The legend stands above the data, never on them, and as near to those of a high figure as of a low one.
    out.legend = { orientation: "h", x: 0, xanchor: "left", y: 1 + 7 / height, yanchor: "bottom", ...(own.legend || {}) };
    if (out.legend.orientation === "v") Object.assign(out.legend, { x: 1.02, y: 1, yanchor: "top" });
    return out;
  }

  // "options" are those of plotly that differ from other figures.
  function react(place, { data, own, height }, options = {}) {
    return Plotly.react(place, paint(data), layout(own, height), { ...config, ...options });
  }
  // Draws a figure now, for pages that decide when.
  const show = (place, figure) => react(place, fitted(figure, place));

  function draw(place, make, options = {}) {
    const painter = { place, done: false };
    painter.again = () => {
      const made = react(place, make(), options);
      if (!painter.done) {
        painter.done = true;
        document.documentElement.dataset.drawn = String(document.querySelectorAll(".main-svg").length);
        place.dispatchEvent(new Event("updyn-drawn"));
      }
      return made;
    };
    painters.push(painter);
    ask(place);
    return () => { if (painter.done) painter.again(); else ask(place); };
  }

  // What is folded has a width in browsers that hide it by content-visibility.
  const isShown = (place) => place.clientWidth > 0 && (place.checkVisibility?.() ?? true);
  // Has what is unfolded within an element drawn.
  function ask(within) {
    const idle = !queue.length;
    for (const painter of painters) {
      if (painter.done || queue.includes(painter) || !within.contains(painter.place) || !isShown(painter.place)) continue;
      queue.push(painter);
    }
    if (idle && queue.length) setTimeout(next);
  }
  function next() {
    const painter = queue.shift();
    if (!painter.done) painter.again();
    if (queue.length) setTimeout(next);
  }

  // A long name along an axis with its beginning and its end, which tells it from others; an entity counts as one letter,
  // a tag as none. "room" is the width of the figure in pixels.
  function shortened(text, room) {
    const [FIRST, LAST] = room > 480 ? [18, 14] : [11, 9];
    const parts = text.match(/<[^>]*>|&\w+;|[^]/gu) ?? [], letters = parts.filter((part) => !/^<./.test(part));
    if (letters.length <= FIRST + LAST) return text;
    let n = 0;
    return parts.map((part) => {
      if (/^<./.test(part) || ++n < FIRST || n > letters.length - LAST) return part;
      return n === FIRST ? "…" : "";
    }).join("");
  }

  // Names of which two would be the same when shortened are whole.
  function shorten(texts, room) {
    const short = texts.map((text) => shortened(text, room));
    return short.map((text, i) => short.indexOf(text) === short.lastIndexOf(text) ? text : texts[i]);
  }

  // On a narrow page names and ticks leave room to data, panels are below each other, and the legend is in rows above
  // the data; the figure grows by them.
  const NARROW = 640, LETTER = 7; // px; width of a letter of an axis
  function fitted(figure, place) {
    const { data } = figure, own = { ...figure.layout };
    const height = Math.max(figure.height, parseFloat(getComputedStyle(place).minHeight) || 0); // more on a wide page
    if (place.clientWidth > NARROW) return { data, own, height };
    for (const key of Object.keys(own)) {
      if (/^yaxis\d*$/.test(key) && own[key].ticktext) own[key] = { ...own[key], ticktext: shorten(own[key].ticktext, place.clientWidth) };
    }
    const beside = (key, least) => Math.max(least, 14 + LETTER * longest(own[key]?.ticktext)); // as wide as the margin
    const room = place.clientWidth - beside("yaxis", 60) - beside("yaxis2", 16);
    if (own.xaxis?.ticktext && own.xaxis.tickangle === 0) own.xaxis = thinned(own.xaxis, room);
    const rows = data.map((trace) => trace.type === "heatmap" ? fittedMap(trace, own, place.clientWidth) : trace);
    const high = stacked(own, height);
    if (!own.showlegend) return { data: rows, own, height: high };
    const entries = data.filter((trace) => trace.showlegend !== false).length;
    own.legend = { orientation: "h", ...(own.annotations?.length ? { y: 1 + 26 / high } : {}) }; // above titles of panels
    return { data: rows, own, height: high + 12 * Math.max(entries - 2, 0) };
  }

  const longest = (texts) => Math.max(0, ...(texts ?? []).map((text) => String(text).replace(/<[^>]*>/g, "").length));

  // An axis with its tick at 0, or at 1 if logarithmic, else the first, and the others that have room on both sides of it.
  function thinned(axis, room) {
    const at = axis.tickvals.map(axis.type === "log" ? Math.log10 : Number);
    const [low, high] = axis.range ?? [Math.min(...at), Math.max(...at)];
    const needed = (i, j) => 0.5 * LETTER * (longest([axis.ticktext[i]]) + longest([axis.ticktext[j]])) + 6;
    const isApart = (i, j) => room * Math.abs(at[i] - at[j]) >= needed(i, j) * (high - low);
    const origin = Math.max(at.indexOf(0), 0), kept = [origin];
    for (let i = origin + 1; i < at.length; i++) if (isApart(i, kept.at(-1))) kept.push(i);
    for (let i = origin - 1; i >= 0; i--) if (isApart(i, kept[0])) kept.unshift(i);
    return { ...axis, tickvals: kept.map((i) => axis.tickvals[i]), ticktext: kept.map((i) => axis.ticktext[i]) };
  }

  // A map without the values in its cells if these are too narrow, and with as many names of columns as there is room for.
  function fittedMap(trace, own, width) {
    const bar = trace.showscale === false ? 0 : 70;
    const cell = (width - 40 - bar - LETTER * longest(own.yaxis?.ticktext ?? trace.y)) / (trace.x?.length || 1);
    if (own.xaxis?.dtick === 1 && cell < 14) own.xaxis = { ...own.xaxis, dtick: Math.ceil(14 / cell) };
    if (!trace.text || cell >= LETTER * longest(trace.text.flat())) return trace;
    const { texttemplate, ...rest } = trace;
    return rest;
  }

  // Puts panels next to each other below each other; returns the height of the figure.
  function stacked(own, height) {
    const across = Object.keys(own).filter((key) => /^xaxis\d*$/.test(key) && own[key].domain);
    if (across.length < 2) return height;
    const step = 1.4 / (1.4 * across.length - 0.4), tops = across.map((_, i) => 1 - i * step);
    across.forEach((key, i) => {
      const down = key.replace("x", "y");
      own[key] = { ...own[key], domain: [0, 1] };
      own[down] = { ...own[down], domain: [Math.max(tops[i] - step / 1.4, 0), tops[i]] };
    });
    own.annotations = (own.annotations ?? []).map((note, i) => ({ ...note, x: 0, y: tops[i] }));
    return 110 + 250 * across.length;
  }

  function repaint() {
    for (const painter of painters) if (painter.done) painter.again();
    for (const again of followers) again();
  }
  const followers = []; // what others draw in the colours of the page
  const follow = (again) => followers.push(again);

  // Paper: everything opened, in light colours, figures as wide as the sheet, then back.
  const sheet = 680;
  function toPaper() {
    document.documentElement.classList.add("paper");
    for (const part of document.querySelectorAll("details:not([open])")) { part.open = true; part.dataset.opened = ""; }
    for (const { place } of painters) {
      const width = place.closest(".pair") ? sheet / 2 - 10 : sheet;
      place.style.width = (place.closest(".overlay") ? width - 34 : width) + "px"; // its frame takes the rest
    }
    for (const { again } of painters) again();
    for (const again of followers) again();
    for (const { place } of painters) Plotly.Plots.resize(place);
  }
  function fromPaper() {
    document.documentElement.classList.remove("paper");
    for (const part of document.querySelectorAll("details[data-opened]")) { part.open = false; delete part.dataset.opened; }
    for (const { place } of painters) place.style.width = "";
    repaint();
    for (const { place } of painters) if (place.clientWidth) Plotly.Plots.resize(place);
  }

  // A link to a folded section opens it.
  function reveal(id) {
    const target = id && document.getElementById(id);
    if (!target) return;
    for (const part of target.querySelectorAll("details.fold")) part.open = true;
    for (let part = target.closest("details"); part; part = part.parentElement.closest("details")) part.open = true;
  }
  function folding() {
    const button = document.getElementById("unfold"), folds = document.querySelectorAll("details.fold");
    if (!button) return;
    button.addEventListener("click", () => {
      const open = button.getAttribute("aria-pressed") !== "true";
      for (const part of folds) part.open = open;
      button.setAttribute("aria-pressed", String(open));
      button.textContent = open ? "Fold all" : "Open all";
    });
    for (const link of document.querySelectorAll('a[href^="#"]')) {
      link.addEventListener("click", () => reveal(decodeURIComponent(link.hash.slice(1))));
    }
    addEventListener("hashchange", () => reveal(decodeURIComponent(location.hash.slice(1))));
    reveal(decodeURIComponent(location.hash.slice(1)));
  }

  // Copies the lines of an element; they are selected as well, where a browser refuses the clipboard.
  async function copy(id) {
    const lines = document.getElementById(id), said = document.querySelector(`[data-copied=${id}]`);
    getSelection().selectAllChildren(lines);
    let done = false;
    try { await navigator.clipboard.writeText(lines.textContent); done = true; } catch { done = document.execCommand("copy"); }
    said.textContent = done ? "Copied. " : "Selected; copy with Ctrl+C. ";
  }

  function start() {
    for (const button of document.querySelectorAll("button[data-copy]")) button.addEventListener("click", () => copy(button.dataset.copy));
    const figures = read("updyn-figures");
    for (const place of document.querySelectorAll("[data-figure]")) {
      const figure = figures[place.dataset.figure];
      draw(place, () => fitted(figure, place));
    }
    for (const part of document.querySelectorAll("details")) { // the window may be wider than when a figure was drawn
      part.addEventListener("toggle", () => {
        if (!part.open) return;
        for (const { place, done } of painters) if (done && part.contains(place)) Plotly.Plots.resize(place);
        ask(part);
      });
    }
    if (parent !== window) document.documentElement.classList.add("framed"); // the margins are those of the window
    folding();
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
    addEventListener("beforeprint", toPaper);
    addEventListener("afterprint", fromPaper);
  }
  // Acts on the figure of this name now or once it is drawn.
  function whenDrawn(name, act) {
    const place = document.querySelector(`[data-figure=${name}]`);
    if (place?.classList.contains("js-plotly-plot")) act(place);
    else place?.addEventListener("updyn-drawn", () => act(place), { once: true });
  }
  return { read, draw, show, follow, reveal, shorten, start, whenDrawn };
})();
