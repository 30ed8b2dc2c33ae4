"""The look of the pages: the tokens of `updyn.style`, light or dark as the page is."""

from __future__ import annotations

from updyn.style import css

__all__ = ["FIGURE_SCRIPTS", "HEAD", "THEMES", "WIDEST"]

#: How the pages look: as the browser prefers, or as chosen.
THEMES = {"auto": "as the system", "light": "light", "dark": "dark"}


#: Address of the scripts of the report, which draw the figures.
FIGURE_SCRIPTS = "/figure-scripts"
#: Widest content of a page in px: more would part what belongs together.
WIDEST = 1760
#: Put into the head of every page.
HEAD = f"""<style>
{css()}
body, body.body--dark {{ background: var(--ground); color: var(--text); }}
body.body--dark {{ --q-primary: var(--after) !important; --q-positive: var(--good) !important;
  --q-negative: var(--bad) !important; --q-warning: var(--warn) !important; }}
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
/* Pages and their header have the same margins. */
.q-header, .updyn-content {{ padding-inline: max(16px, (100% - {WIDEST}px) / 2) !important; }}
.q-btn.disabled {{ filter: grayscale(1); opacity: 0.45 !important; }}
.updyn-drop {{ padding: 28px 16px; text-align: center; cursor: pointer; }}
.q-uploader {{ background: var(--ground); border: 2px dashed var(--faint) !important;
  max-height: none; }}
.q-uploader__header {{ background: transparent !important; color: var(--text) !important; }}
.q-uploader__list {{ display: none; }}
.q-uploader__dnd {{ background: var(--after-faint); outline-color: var(--after); }}
.updyn-demo {{ color: var(--after); }}
.updyn-steps {{ flex-basis: 100%; }}
.updyn-steps ol {{ display: flex; flex-wrap: wrap; list-style: none; margin: 0; padding: 0; }}
.updyn-steps li {{ display: flex; align-items: center; }}
.updyn-steps li + li::before {{ content: "›"; color: var(--muted); padding: 0 2px; }}
.updyn-steps a {{ display: flex; align-items: center; gap: 4px; padding: 3px 8px;
  border-radius: 4px; text-decoration: none; }}
.nicegui-link, .nicegui-link:visited {{ color: var(--link) !important; }}
.updyn-nav a {{ color: var(--text) !important; }}
.updyn-nav a[aria-current] {{ background: var(--after-faint); font-weight: 600; }}
html[inert] {{ cursor: progress; }}
html[inert]::after {{ content: ""; position: fixed; inset: 0 0 auto; height: 3px; z-index: 9999;
  background: var(--after); }}
:focus-visible {{ outline: 2px solid var(--link); outline-offset: 2px; }}
</style>
<script>
/* Text typed before the page is connected would be lost. */
document.documentElement.inert = true;
(function wait() {{
  if (window.did_handshake) document.documentElement.inert = false;
  else setTimeout(wait, 20);
}})();
/* What was pressed is clicked although it moves before the button of the mouse is released, as
   where the message of an entry vanishes when the focus leaves the entry. The pointer itself may
   move by a few pixels only. */
document.addEventListener("pointerdown", (press) => {{
  const pressed = press.target.closest("button, a, [role=checkbox], [role=radio], [role=tab]");
  if (!pressed) return;
  pressed.setPointerCapture(press.pointerId);
  const follow = (move) => {{
    const distance = Math.hypot(move.clientX - press.clientX, move.clientY - press.clientY);
    if (distance > 4) pressed.releasePointerCapture(move.pointerId);
  }};
  const forget = () => pressed.removeEventListener("pointermove", follow);
  pressed.addEventListener("pointermove", follow);
  pressed.addEventListener("lostpointercapture", forget, {{ once: true }});
}}, true);
</script>
<script defer src="{FIGURE_SCRIPTS}/plotly-cartesian.min.js"></script>
<script defer src="{FIGURE_SCRIPTS}/report.js"></script>"""
