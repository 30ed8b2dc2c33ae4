"""`hear_picks`: receive clicks in an embedded page, which can only send messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from nicegui import events, ui

__all__ = ["hear_picks"]

#: Accept messages only from frames of this page and only of the expected form.
_LISTEN = """
window.addEventListener("message", (event) => {
  const frames = [...document.querySelectorAll("iframe")];
  const own = frames.some((frame) => frame.contentWindow === event.source);
  const picked = own && event.data && event.data.updynPick;
  if (picked && typeof picked === "object") emitEvent("updyn_pick", picked);
});
"""


def hear_picks(hear: Callable[[Mapping[str, Any]], Any]) -> None:
    """Call `hear` with the message of each pick in an embedded page; messages are not validated."""

    def take(event: events.GenericEventArguments) -> None:
        if isinstance(event.args, dict):
            hear(event.args)

    ui.on("updyn_pick", take)
    ui.add_body_html(f"<script>{_LISTEN}</script>")
