"""A scene as HTML: a fragment of a page, a whole page, or a frame for a notebook."""

from __future__ import annotations

from functools import lru_cache
from html import escape
from importlib import resources

from updyn.style import css
from updyn.viewer.encoding import as_json
from updyn.viewer.scene import Scene

__all__ = ["POLICY", "fragment", "html", "page", "script"]

#: Content security policy: the page loads no other resource.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:;"
    " font-src data:; base-uri 'none'; form-action 'none'"
)
#: In a separate page the viewer fills the window: the picture takes what the controls leave.
_FILLED = (
    " body { margin: 8px; height: calc(100vh - 16px); display: flex; flex-direction: column;"
    " background: var(--ground); color: var(--text); font-family: var(--font); --v-height: auto; }"
    " body > .updyn-viewer { flex: 1; display: flex; flex-direction: column; margin: 0; }"
    " .v-stage { flex: 1 0 300px; }"
)
_WITHOUT_SCRIPTS = "The viewer is drawn by a script, and scripts are switched off here."


@lru_cache(maxsize=1)
def script() -> str:
    """Return the script of the viewer, escaped for a script element; call ``updynViewer.start()``.

    Returns
    -------
    str
    """
    text = (resources.files("updyn.viewer") / "assets" / "viewer.min.js").read_text(
        encoding="utf-8"
    )
    return text.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def fragment(scene: Scene, name: str = "updyn-scene") -> str:
    """Return a scene as HTML for a page that has `script` and the variables of `updyn.style.css`.

    Parameters
    ----------
    scene : Scene
        The scene.
    name : str
        Id of the element with the data, unique in the page.

    Returns
    -------
    str
        HTML.
    """
    at = escape(name)
    return (
        f'<div data-scene="{at}"><noscript>{_WITHOUT_SCRIPTS}</noscript></div>\n'
        f'<script type="application/json" id="{at}">{as_json(scene)}</script>'
    )


def page(scene: Scene) -> str:
    """Return a scene as a whole page, which needs no network and no other file.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    str
        HTML.
    """
    title = escape(scene.title or "Structure")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{title}</title><link rel="icon" href="data:,">'
        f"<style>{css()}{_FILLED}</style></head>\n"
        f"<body>{fragment(scene)}\n<script>{script()}\nupdynViewer.start();</script></body></html>\n"
    )


def html(scene: Scene, *, height: int = 640) -> str:
    """Return a scene as a sandboxed frame for a notebook, complete also in an exported notebook.

    Parameters
    ----------
    scene : Scene
        The scene.
    height : int
        Height of the frame, in px.

    Returns
    -------
    str
        HTML: 0.7 MB plus the data of the scene.
    """
    title = escape(scene.title or "Structure", quote=True)
    return (
        f'<iframe title="{title}" sandbox="allow-scripts allow-downloads" loading="lazy"'
        f' style="width: 100%; height: {int(height)}px; border: 0"'
        f' srcdoc="{escape(page(scene), quote=True)}"></iframe>'
    )
