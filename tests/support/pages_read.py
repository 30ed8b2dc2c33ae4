"""Report pages as tests read them: as a document, in a browser, and the numbers of their figures."""

from __future__ import annotations

import base64
import json
import re
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np

from programs import program


class Page(HTMLParser):
    """Elements with their attributes, texts of elements, and whether every element is closed in order."""

    VOID = ("meta", "link", "input", "br")

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.elements, self.open, self.text = [], [], []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"script", "style"} & set(self.open):
            self.text.append(data)

    @property
    def words(self):
        return re.sub(r"\s+", " ", " ".join(self.text))

    def of(self, tag):
        return [attrs for name, attrs in self.elements if name == tag]


def dump(path, profile, *switches):
    """Return the document as a browser leaves it; further switches of its command line may be given."""
    return browse(path, profile, *switches).stdout


def unfolded(path):
    """Have a page open all its sections, so that every figure of it is drawn."""
    text = path.read_text(encoding="utf-8")
    press = '<script>document.getElementById("unfold").click();</script></body>'
    path.write_text(press.join(text.rsplit("</body>", 1)), encoding="utf-8")
    return path


def browse(path, profile, *switches):
    """Open a page until it rests; its document is the standard output of the browser."""
    command = [
        program("browser"), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
        "--window-size=1400,1000", "--virtual-time-budget=20000", *switches, "--dump-dom", path.as_uri(),
    ]  # fmt: skip
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)


def settled(path, profile, last, *switches):
    """Return what a page noted, `last` at its end.

    On a busy machine the browser may let its virtual time run out before it draws a first frame, in
    which nothing is mounted yet: the page is opened again then.
    """
    return _settle(lambda number: dump(path, f"{profile}{number}", *switches), last)


def settled_and_overheard(path, profile, last):
    """Return what a page noted, what it wrote to the console, and the addresses that it asked for."""
    heard = []

    def opened(number):
        dom, *heard[:] = _listen(path, f"{profile}{number}")
        return dom

    return _settle(opened, last), *heard


def _settle(opened, last):
    found = {}
    for number in range(5):
        found = attributes(opened(number))
        if found.get(last) or "errors" in found:
            break
    return found


def told(found, name):
    """Return what a page noted as JSON."""
    return json.loads(found[name].replace("&quot;", '"'))


def overheard(path, profile):
    """Return what a page wrote to the console, and the addresses that it asked for.

    Left out is what is not of the page: what the graphics driver says of itself, and what the
    browser asks for on its own account, which no page began ("not an origin").
    """
    return _listen(path, profile)[1:]


def _listen(path, profile):
    """Return the document, the lines of the console and the addresses, as the browser logs them."""
    log = Path(f"{profile}-net.json")
    done = browse(path, profile, f"--log-net-log={log}", "--enable-logging=stderr")
    driver = ("GL Driver Message", "fallback to software WebGL")
    lines = [line for line in done.stderr.splitlines() if ":CONSOLE:" in line]
    console = [line for line in lines if not any(words in line for words in driver)]
    events = json.loads(log.read_text(encoding="utf-8"))["events"]
    begun = [event["params"] for event in events if "initiator" in event.get("params", {})]
    return (
        done.stdout,
        console,
        {one["url"] for one in begun if one["initiator"] != "not an origin"},
    )


def attributes(dom):
    return dict(re.findall(r'data-(\w+)="([^"]*)"', re.search(r"<html[^>]*>", dom)[0]))


def values(part):
    if isinstance(part, list):
        return np.array([np.nan if x is None else x for x in part], dtype=float)
    return np.frombuffer(base64.b64decode(part["bdata"]), dtype="<f4").astype(float)
