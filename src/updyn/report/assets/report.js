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

  // On a narrow page the legend stands in rows above the data, and the figure grows by them; names leave room to data.
  function fitted(figure, place) {
    const { data, height } = figure, own = { ...figure.layout };
    if (place.clientWidth > 640) return { data, own, height };
    for (const key of Object.keys(own)) {
      if (/^yaxis\d*$/.test(key) && own[key].ticktext) own[key] = { ...own[key], ticktext: shorten(own[key].ticktext, place.clientWidth) };
    }
    if (!own.showlegend) return { data, own, height };
    const entries = data.filter((trace) => trace.showlegend !== false).length;
    own.legend = { orientation: "h" };
    return { data, own, height: height + 12 * Math.max(entries - 2, 0) };
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
