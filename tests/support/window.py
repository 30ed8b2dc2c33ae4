"""The window of `updyn serve` for tests: the server as its users start it, and a browser that listens to everything."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO
from urllib.parse import urlsplit

import pytest

from forked_server import start_server
from programs import program

#: Of a page on a loaded machine, in ms.
PATIENCE = 300_000
#: Spinners and transitions off: drawing them takes a third of a core for as long as a run lasts.
_STILL = """
const still = new CSSStyleSheet();
still.replaceSync("*, ::before, ::after { animation: none !important; transition: none !important }");
document.adoptedStyleSheets.push(still);
"""
#: What Chromium says of its own drawing by software.
_OF_THE_BROWSER = ("GPU stall", "swiftshader", "SwiftShader", "GroupMarkerNotSet")


class Server:
    """A running server: its address with the token, and the folder of the project."""

    def __init__(self, pid: int, printed: TextIO, folder: Path) -> None:
        self.pid, self.folder = pid, folder
        self.address = printed.readline().strip()
        self.base = self.address.partition("/?")[0]

    def shows(self, text: str) -> bool:
        """Whether its first page holds a text."""
        import httpx

        return text in httpx.get(self.address, follow_redirects=True).text

    @contextmanager
    def halted(self) -> Iterator[None]:
        """Let the server not answer meanwhile, as on a computer that is busy or asleep."""
        os.kill(self.pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self.pid, signal.SIGCONT)

    @property
    def port(self) -> int:
        return int(urlsplit(self.address).port or 0)


@contextmanager
def serving(folder: Path, *arguments: str) -> Iterator[Server]:
    """Start `updyn serve --no-open` in a folder; it is ended by Ctrl-C."""
    if "--no-open" not in arguments:
        arguments = (*arguments, "--no-open")
    process, printed = start_server(folder, arguments)
    assert process.pid is not None
    with printed:
        try:
            server = Server(process.pid, printed, folder)
            assert server.address.startswith("http://127.0.0.1:"), printed.read()
            yield server
        finally:
            with suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGINT)
            process.join(120)
            process.kill()
            process.join()


class Heard:
    """What went wrong in the pages, and what they asked for elsewhere."""

    def __init__(self) -> None:
        self.wrong: list[str] = []

    def listen(self, page: object) -> None:
        page.on("console", self._said)
        page.on("pageerror", lambda error: self.wrong.append(f"error: {error}"))
        page.on("request", self._asked)

    def _said(self, message: object) -> None:
        text = message.text
        if message.type == "error" and not any(word in text for word in _OF_THE_BROWSER):
            self.wrong.append(f"console: {text}")

    def _asked(self, request: object) -> None:
        parts = urlsplit(request.url)
        if parts.scheme not in ("data", "blob") and parts.hostname != "127.0.0.1":
            self.wrong.append(f"request: {request.url}")


@pytest.fixture(scope="module")
def chromium() -> Iterator[object]:
    """The browser that the tests of a module share."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program("browser"), args=["--no-sandbox"]
        )
        yield browser
        browser.close()


def visit(page: object, address: str) -> None:
    """Go to a page; until it is connected, nobody can type into it, but Playwright can."""
    page.goto(address)
    page.wait_for_selector("html:not([inert])")


def choose(page: object, label: str, option: str) -> None:
    """Choose an option of a list; a list that closes takes the clicks for the next one."""
    page.get_by_role("combobox", name=label).first.click()
    page.get_by_role("option", name=option).first.click()
    page.get_by_role("option").first.wait_for(state="hidden")


@contextmanager
def browsing(
    chromium: object, server: Server, width: int = 1280, height: int = 1000
) -> Iterator[tuple[object, Heard]]:
    """Open the window in Chromium; give the page, and its errors and requests."""
    context = chromium.new_context(viewport={"width": width, "height": height})
    context.set_default_timeout(PATIENCE)
    context.add_init_script(_STILL)
    page = context.new_page()
    heard = Heard()
    heard.listen(page)
    visit(page, server.address)
    yield page, heard
    context.close()
