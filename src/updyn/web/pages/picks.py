"""`listen_for_picks`: receive clicks in an embedded page, which can only send messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from nicegui import events, ui

__all__ = ["listen_for_picks"]

#: Accept messages only from frames of this page and only of the expected form.
_LISTEN = """
window.addEventListener("message", (event) => {
  const frames = [...document.querySelectorAll("iframe")];
  const own = frames.some((frame) => frame.contentWindow === event.source);
  const picked = own && event.data && event.data.updynPick;
  if (picked && typeof picked === "object") emitEvent("updyn_pick", picked);
});
"""


def listen_for_picks(handle: Callable[[Mapping[str, Any]], None]) -> None:
    """Call `handle` with each pick in an embedded page; its message is not validated."""

    def forward(event: events.GenericEventArguments) -> None:
        if isinstance(event.args, dict):
            handle(event.args)

    ui.on("updyn_pick", forward)
    ui.add_body_html(f"<script>{_LISTEN}</script>")
