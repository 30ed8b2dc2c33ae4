"""The look of the pages: the tokens of `updyn.style`, light or dark as the page is."""

from __future__ import annotations

from typing import Any

from updyn.style import DARK, FIGURE_TEXT, PAPER

__all__ = ["HEAD", "THEMES", "colour", "text_style"]

#: How the pages look: as the browser prefers, or as chosen.
THEMES = {"auto": "as the system", "light": "light", "dark": "dark"}


def _variables(colours: dict[str, str]) -> str:
    return " ".join(f"--{name}: {value};" for name, value in colours.items())


#: Put into the head of every page. Charts ask `updynColour` when they are drawn.
HEAD = f"""<style>
body {{ {_variables(dict(PAPER))} background: var(--ground); color: var(--text); }}
body.body--dark {{ {_variables(dict(DARK))} background: var(--ground); color: var(--text); }}
body.body--dark {{ --q-primary: var(--after) !important; }}
body.body--dark .bg-primary {{ color: var(--ground) !important; }}
body.body--dark iframe {{ color-scheme: dark; }}
body.body--light iframe {{ color-scheme: light; }}
.q-header {{ background: var(--panel) !important; color: var(--text) !important;
  border-bottom: 1px solid var(--rule); }}
.q-card, .q-table__card {{ background: var(--panel); box-shadow: none;
  border: 1px solid var(--rule); }}
.updyn-nav a {{ color: var(--text) !important; }}
.updyn-nav a[aria-current] {{ background: var(--after-faint); font-weight: 600; }}
:focus-visible {{ outline: 2px solid var(--link); outline-offset: 2px; }}
</style>
<script>
const updynColour = (name) => getComputedStyle(document.body).getPropertyValue("--" + name).trim();
</script>"""


def colour(name: str, key: str = "color") -> dict[str, str]:
    """Return a chart option whose value, a token of `updyn.style.PAPER`, is resolved when drawn."""
    return {f":{key}": f"updynColour({name!r})"}


def text_style() -> dict[str, Any]:
    """Return the style of the texts of a chart."""
    return {"fontSize": FIGURE_TEXT, **colour("muted")}
