"""Print the size and density of the code: what a reader has to hold in mind, as figures.

python tools/density.py [FOLDER ...]     (default: src/updyn)

Code lines are those that hold code: docstrings, comments and blank lines are left out. Conditional
expressions and comprehensions are counted for 1,000 lines that are not blank, comments and long
lines for 100 of all lines.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from pathlib import Path

COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
SILENT = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
LONG = 100


def docstring_lines(tree: ast.AST) -> set[int]:
    """Return the numbers of the lines that docstrings take."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        if not isinstance(node, DOCUMENTED) or not node.body:
            continue
        first = node.body[0]
        is_text = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
        if is_text and isinstance(first.value.value, str):
            lines.update(range(first.lineno, first.end_lineno + 1))
    return lines


def measured(source: str) -> dict[str, int]:
    """Return the counts of one module."""
    tree = ast.parse(source)
    code, comments = set(), set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comments.add(token.start[0])
        elif token.type not in SILENT:
            code.update(range(token.start[0], token.end[0] + 1))
    nodes = list(ast.walk(tree))
    lines = source.splitlines()
    return {
        "modules": 1,
        "lines": len(lines),
        "written": sum(bool(line.strip()) for line in lines),
        "code": len(code - docstring_lines(tree)),
        "conditionals": sum(isinstance(node, ast.IfExp) for node in nodes),
        "comprehensions": sum(isinstance(node, COMPREHENSIONS) for node in nodes),
        "comments": len(comments),
        "long": sum(len(line) > LONG for line in lines),
    }


def total(folder: Path) -> dict[str, int]:
    """Return the counts of all modules below a folder."""
    sums: dict[str, int] = {}
    for path in sorted(folder.rglob("*.py")):
        for key, count in measured(path.read_text(encoding="utf-8")).items():
            sums[key] = sums.get(key, 0) + count
    return sums


def main(folders: list[str]) -> None:
    """Print a row for each folder."""
    head = "folder modules code conditionals/1000 comprehensions/1000 comments_% long_%"
    print(*head.split(), sep="\t")
    for folder in folders:
        t = total(Path(folder))
        shares = (
            f"{1000 * t['conditionals'] / t['written']:.1f}",
            f"{1000 * t['comprehensions'] / t['written']:.1f}",
            f"{100 * t['comments'] / t['lines']:.1f}",
            f"{100 * t['long'] / t['lines']:.1f}",
        )
        print(folder, t["modules"], t["code"], *shares, sep="\t")


if __name__ == "__main__":
    main(sys.argv[1:] or ["src/updyn"])
