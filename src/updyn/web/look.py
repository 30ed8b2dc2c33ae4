"""The look of the pages: the tokens of `updyn.style`, light or dark as the page is."""

from __future__ import annotations

from updyn.style import css

__all__ = ["FIGURE_SCRIPTS", "HEAD", "THEMES"]

#: How the pages look: as the browser prefers, or as chosen.
THEMES = {"auto": "as the system", "light": "light", "dark": "dark"}


#: Address of the scripts of the report, which draw the figures.
FIGURE_SCRIPTS = "/figure-scripts"
#: Put into the head of every page.
HEAD = f"""<style>
{css()}
body, body.body--dark {{ background: var(--ground); color: var(--text); }}
body.body--dark {{ --q-primary: var(--after) !important; --q-positive: var(--good) !important;
  --q-negative: var(--bad) !important; }}
/* The first layer has precedence for declarations with !important. */
@layer theme {{
  body.body--dark :is(.bg-primary, .bg-positive, .bg-negative, .q-notification .text-white) {{
    color: var(--ground) !important; }}
}}
.cm-editor, .cm-gutters {{ background: var(--panel) !important; color: var(--text) !important; }}
.cm-activeLine, .cm-activeLineGutter {{ background: var(--after-faint) !important; }}
.cm-cursor {{ border-left-color: var(--text) !important; }}
.q-header {{ background: var(--panel) !important; color: var(--text) !important;
  border-bottom: 1px solid var(--rule); }}
.q-card, .q-table__card {{ background: var(--panel); box-shadow: none;
  border: 1px solid var(--rule); }}
.updyn-nav a {{ color: var(--text) !important; }}
.updyn-nav a[aria-current] {{ background: var(--after-faint); font-weight: 600; }}
:focus-visible {{ outline: 2px solid var(--link); outline-offset: 2px; }}
</style>
<script defer src="{FIGURE_SCRIPTS}/plotly-cartesian.min.js"></script>
<script defer src="{FIGURE_SCRIPTS}/report.js"></script>"""
