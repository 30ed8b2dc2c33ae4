"""Pages written for a code host, as MyST reads them: anchors, and links out of docs/."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent

#: A link other than a picture: words (brackets allowed), file, anchor.
_LINK = r"(?<!!)\[((?:[^\[\]]|\[+[^\[\]]*\]+)*)\]\((?!https?:)([^)#\s]*)((?:#[^)\s]+)?)\)"

#: Pages outside docs/ and their names on the site.
SHOWN = {"benchmarks/README.md": "measured.md", "CONTRIBUTING.md": "contributing.md"}


def write(folder: Path) -> None:
    """Write copies of the pages outside docs/ for the site.

    Parameters
    ----------
    folder : Path
        Below docs/.
    """
    for given, name in SHOWN.items():
        page = ROOT / given
        change = partial(_relink, page=page, folder=folder)
        text = _prose_of(page.read_text(encoding="utf-8"), change)
        (folder / name).write_text(text, encoding="utf-8")
    readme = ROOT / "README.md"
    what = readme.read_text(encoding="utf-8").split("<!-- what -->")[1].split("<!-- end of")[0]
    (folder / "what.txt").write_text(_relink(what, readme, folder.parent), encoding="utf-8")


def _relink(text: str, page: Path, folder: Path) -> str:
    def relocate(found: re.Match[str]) -> str:
        return f"]({os.path.relpath(page.parent / found[1], folder)}{found[2]})"

    return re.sub(r"\]\((?!https?:)([^)#\s]+)((?:#[^)\s]+)?)\)", relocate, text)


def to_site(text: str, page: Path) -> str:
    """Return a page with explicit anchors as targets, and links to files outside docs/ replaced.

    Parameters
    ----------
    text : str
        Markdown, as a code host shows it.
    page : Path
        Path of the page.

    Returns
    -------
    str
        Markdown for MyST.
    """
    return _prose_of(text, lambda piece: _convert(piece, page))


def _prose_of(text: str, change: Callable[[str], str]) -> str:
    pieces = re.split(r"(^```.*?^```$)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(p if p.startswith("```") else change(p) for p in pieces)


def _convert(text: str, page: Path) -> str:
    def target(found: re.Match[str]) -> str:
        return f"({_label(page, found[1])})="

    def link(found: re.Match[str]) -> str:
        return _link(found[1], found[2], found[3], page)

    text = re.sub(r'^<a id="([^"]+)"></a>$', target, text, flags=re.MULTILINE)
    return re.sub(_LINK, link, text)


def _label(page: Path, anchor: str) -> str:
    """Return the target of an explicit anchor; several pages may have the same."""
    return f"{page.stem}--{anchor}"


def _link(words: str, file: str, anchor: str, page: Path) -> str:
    there = (page.parent / file).resolve() if file else page
    outside = not there.is_relative_to(DOCS)
    if outside and (name := SHOWN.get(there.relative_to(ROOT).as_posix())):
        file = os.path.relpath(DOCS / "site" / "api" / name, page.parent)
    elif outside or there.suffix != ".md":
        return words  # a file of the repository, which the site does not show
    if anchor and f'<a id="{anchor[1:]}">' in there.read_text(encoding="utf-8"):
        return f"[{words}](#{_label(there, anchor[1:])})"
    return f"[{words}]({file}{anchor})"
