"""Waiting for a page whose policy of content forbids what `Page.wait_for_function` evaluates."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Frame, Page

#: Seconds between two looks.
_PAUSE = 0.05


def wait_for(page: Page | Frame, condition: str, seconds: float = 120.0) -> None:
    """Wait until a function of JavaScript without arguments returns what counts as true.

    `Page.wait_for_function` evaluates a string within the page, where it does not hold at once; the
    policy of the pages refuses that.
    """
    until = time.monotonic() + seconds
    while not page.evaluate(f"() => Boolean(({condition})())"):
        assert time.monotonic() < until, f"waited in vain for {condition}"
        time.sleep(_PAUSE)
