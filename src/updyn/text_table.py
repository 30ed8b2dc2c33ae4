"""`text_table`: rows in columns, for the terminal."""

from __future__ import annotations

from collections.abc import Collection, Sequence

__all__ = ["text_table"]


def text_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], left: Collection[int] = (0,)
) -> str:
    """Return rows in columns of equal width, two blanks apart.

    Parameters
    ----------
    header : sequence of str
        Names of the columns.
    rows : sequence of sequence of str
        As many cells each.
    left : collection of int
        Columns that are aligned to the left; the others are aligned to the right.

    Returns
    -------
    str
        One line a row, without blanks at the end.
    """
    cells = [list(header), *(list(row) for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    lines = []
    for row in cells:
        columns = enumerate(zip(row, widths, strict=True))
        padded = [c.ljust(w) if i in left else c.rjust(w) for i, (c, w) in columns]
        lines.append("  ".join(padded).rstrip())
    return "\n".join(lines)
