"""The window of `updyn serve` for tests: the server as its users start it, and a browser that listens to everything."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest

from programs import program

#: Of a page on a loaded machine, in ms.
PATIENCE = 300_000
#: What Chromium says of its own drawing by software.
_OF_THE_BROWSER = ("GPU stall", "swiftshader", "SwiftShader", "GroupMarkerNotSet")


class Server:
    """A running server: its address with the token, and the folder of the project."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self.process, self.folder = process, folder
        assert process.stdout is not None
        self.address = process.stdout.readline().strip()
        self.base = self.address.partition("/?")[0]

    def shows(self, text: str) -> bool:
        """Whether its first page holds a text."""
        import httpx

        return text in httpx.get(self.address, follow_redirects=True).text

    @contextmanager
    def halted(self) -> Iterator[None]:
        """Let the server not answer meanwhile, as on a computer that is busy or asleep."""
        self.process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self.process.send_signal(signal.SIGCONT)

    @property
    def port(self) -> int:
        return int(urlsplit(self.address).port or 0)


@contextmanager
def serving(folder: Path, *arguments: str) -> Iterator[Server]:
    """Start `updyn serve --no-open` in a folder; it is ended by Ctrl-C."""
    command = [sys.executable, "-m", "updyn", "serve", *arguments]
    if "--no-open" not in arguments:
        command.append("--no-open")
    process = subprocess.Popen(
        command,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    try:
        server = Server(process, folder)
        assert server.address.startswith("http://127.0.0.1:"), process.communicate(timeout=60)
        yield server
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=120)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()


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
    page = context.new_page()
    heard = Heard()
    heard.listen(page)
    visit(page, server.address)
    yield page, heard
    context.close()
