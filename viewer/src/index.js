// Every element with data-scene="ID" of a page becomes a viewer of the scene in the element with that ID, once it is
// near the window. Other scripts call mount, and hear "updyn-pick".
import style from "./viewer.css";
import { Viewer } from "./viewer.js";

const AWAY = "This browser shows no three-dimensional pictures (WebGL 2 is missing or switched off), so that the viewer is left out.";

function dress() {
  if (document.getElementById("updyn-viewer-style")) return;
  const element = Object.assign(document.createElement("style"), { id: "updyn-viewer-style", textContent: style });
  document.head.append(element);
}

function able() {
  try {
    const context = document.createElement("canvas").getContext("webgl2");
    context?.getExtension("WEBGL_lose_context")?.loseContext();
    return Boolean(context);
  } catch { return false; }
}

// Draws a scene in an element; null, with a line that says so, where there is no WebGL.
export function mount(element, scene) {
  dress();
  element.updynViewer?.dispose();
  element.classList.add("updyn-viewer");
  if (!able()) {
    const line = Object.assign(document.createElement("p"), { className: "v-said", textContent: AWAY });
    line.setAttribute("role", "note");
    element.replaceChildren(line);
    return null;
  }
  const viewer = new Viewer(element, scene);
  element.updynViewer = viewer;
  element.dataset.ready = "true";
  return viewer;
}

export function start(root = document) {
  dress();
  const waiting = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting) continue;
      waiting.unobserve(target);
      mount(target, JSON.parse(document.getElementById(target.dataset.scene).textContent));
    }
  }, { rootMargin: "300px" });
  for (const element of root.querySelectorAll("[data-scene]")) {
    element.classList.add("updyn-viewer");
    waiting.observe(element);
  }
}
