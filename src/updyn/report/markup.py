"""Small pieces of HTML, each escaping its text, for sections without a template."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

__all__ = [
    "definition_table",
    "details",
    "esc",
    "figure",
    "note",
    "paragraph",
    "row",
    "swatch",
    "table",
]


def esc(text: object) -> str:
    """Return `text` as HTML text or attribute value."""
    return html.escape(str(text), quote=True)


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph; `text` is escaped."""
    return f"<p{_class(kind)}>{esc(text)}</p>"


def note(*sentences: str) -> str:
    """Return a note that stands out; nothing where there are no sentences."""
    said = [s for s in sentences if s]
    return f'<div class="note">{"".join(paragraph(s) for s in said)}</div>' if said else ""


def figure(name: str, alternative: str, caption: str, *, height: int) -> str:
    """Return the place of a figure; `alternative` describes it to readers who cannot see it."""
    return (
        f'<figure><div class="plot" data-figure="{esc(name)}" role="img"'
        f' aria-label="{esc(alternative)}" '
        f'style="min-height:{int(height)}px"></div><figcaption>{esc(caption)}</figcaption></figure>'
    )


def details(summary: str, content: str) -> str:
    """Return a part that is folded away; `content` is HTML."""
    return f"<details><summary>{esc(summary)}</summary>{content}</details>"


def swatch(kind: str) -> str:
    """Return a patch of colour for a legend."""
    return f'<span class="swatch {esc(kind)}"></span>'


def row(cells: Sequence[str], kinds: Sequence[str] = (), kind: str = "", link: str = "") -> str:
    """Return a table row with its first cell as header; `kinds` are classes by column.

    With `link` the header leads there.
    """
    first = f'<a href="{esc(link)}">{esc(cells[0])}</a>' if link else esc(cells[0])
    out = [f'<th scope="row">{first}</th>']
    for i, cell in enumerate(cells[1:], 1):
        out.append(f"<td{_class(kinds[i] if i < len(kinds) else '')}>{esc(cell)}</td>")
    return f"<tr{_class(kind)}>{''.join(out)}</tr>"


def table(
    head: Sequence[str], rows: Iterable[str], *, caption: str = "", kinds: Sequence[str] = ()
) -> str:
    """Return a table in a box that scrolls sideways; `rows` are HTML, made by `row`."""
    heads = ""
    for i, name in enumerate(head):
        is_text = i < len(kinds) and kinds[i] in ("text", "note-cell")
        heads += f'<th scope="col"{_class("text" if is_text else "")}>{esc(name)}</th>'
    # Beside the table, not inside: it must not scroll.
    said = f"<figcaption>{esc(caption)}</figcaption>" if caption else ""
    return (
        f'<figure class="table">{said}<div class="scroll"><table><thead><tr>{heads}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div></figure>"
    )


def definition_table(items: Iterable[tuple[str, str]]) -> str:
    """Return names and values below each other, both escaped."""
    rows = "".join(f'<tr><th scope="row">{esc(k)}</th><td>{esc(v)}</td></tr>' for k, v in items)
    return f'<div class="scroll"><table class="long"><tbody>{rows}</tbody></table></div>'


def _class(kind: str) -> str:
    return f' class="{esc(kind)}"' if kind else ""
