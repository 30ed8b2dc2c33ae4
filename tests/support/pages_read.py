"""Report pages as tests read them: as a document, in a browser, and the numbers of their figures."""

from __future__ import annotations

import base64
import re
import subprocess
from html.parser import HTMLParser

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
    command = [
        program("browser"), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
        "--window-size=1400,1000", "--virtual-time-budget=20000", *switches, "--dump-dom", path.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    return done.stdout


def attributes(dom):
    return dict(re.findall(r'data-(\w+)="([^"]*)"', re.search(r"<html[^>]*>", dom)[0]))


def values(part):
    if isinstance(part, list):
        return np.array([np.nan if x is None else x for x in part], dtype=float)
    return np.frombuffer(base64.b64decode(part["bdata"]), dtype="<f4").astype(float)
