"""The source as the contract tests read it: files, rooms, imports (module level and inside functions)."""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterator
from pathlib import Path

import updyn

SRC = Path(updyn.__file__).parent

#: Rooms from the bottom up, as in the design; those on one line are siblings and do not import each
#: other.
ORDER = (
    ("arrays",),
    ("settings",),
    ("tracebacks",),
    ("errors",),
    ("units",),
    ("registry",),
    ("remedy",),
    ("text_table",),
    ("style",),
    ("progress",),
    ("notebook",),
    ("foreign",),
    ("shapes",),
    ("dofs",),
    ("geometry",),
    ("force_spectrum",),
    ("frf",),
    ("exchanged", "grouping"),
    ("group",),
    ("merging",),
    ("nonlinear",),
    ("model",),
    ("variants",),
    ("positions",),
    ("engines",),
    ("linalg",),
    ("dynamics",),
    ("sensitivity",),
    ("correlation",),
    ("modal",),
    ("matching",),
    ("elements",),
    ("signals",),
    ("io",),
    ("outputs",),
    ("updating.problem",),
    ("updating.fit",),
    ("updating.judge",),
    ("updating",),
    ("comparison", "planning", "uncertainty"),
    ("acceptance", "candidates", "modification", "population"),
    ("store",),
    ("viewer",),
    ("report",),
    ("plots",),
    ("job",),
    ("demos",),
    ("cli", "web"),
    ("control",),
)
LEVEL = {room: level for level, rooms in enumerate(ORDER) for room in rooms}
#: An import of the package that does not begin a line.
_INNER = re.compile(r"^.+\bfrom updyn\.", re.MULTILINE)
#: Names that only the package itself holds and that any module may ask it for.
FACADE = {"__version__"}
#: A private module beside its room.
PRIVATE = {"__main__": "cli"}


def files() -> list[Path]:
    return sorted(p for p in SRC.rglob("*.py"))


def module_of(path: Path, root: Path = SRC) -> str:
    parts = list(path.relative_to(root).with_suffix("").parts)
    if parts[-1] == "__init__":
        parts.pop()
    return ".".join([root.name, *parts])


def imports_of(path: Path) -> tuple[tuple[int, str, str | None], ...]:
    """Return the imports of a file of the package, as `imports`."""
    source = path.read_text(encoding="utf-8")
    return imports(source, module_of(path), path.name == "__init__.py")


def modules_imported(path: Path) -> set[str]:
    """Return the modules of the package that a file imports, those in function bodies included."""
    found = set()
    for _, target, name in imports_of(path):
        inner = f"{target}.{name}"
        if inner in modules():
            found.add(inner)
        elif target in modules():
            found.add(target)
    return found


@functools.cache
def modules() -> dict[str, Path]:
    """Return the files of the package by module."""
    return {module_of(path): path for path in files()}


def inner_imports(source: str) -> Iterator[tuple[int, str]]:
    """Yield line and module of every import of the package inside a function."""
    if not _INNER.search(source):  # parsing takes a hundred times as long
        return
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, functions):
            continue
        for node in ast.walk(function):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("updyn."):
                yield node.lineno, str(node.module)


def dotted(node: ast.AST) -> str:
    """Return the dotted name that an expression is; "" if it is none."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (base := dotted(node.value)):
        return f"{base}.{node.attr}"
    return ""


def room_of(module: str) -> str | None:
    """Return the room of a module, or None for the package itself."""
    parts = module.split(".")
    if len(parts) == 1:
        return None
    inner = ".".join(parts[1:3])
    if inner in LEVEL:
        return inner
    return PRIVATE.get(parts[1], parts[1])


@functools.cache
def imports(source: str, module: str, is_package: bool) -> tuple[tuple[int, str, str | None], ...]:
    """Return line, module and (for ``from`` imports) name of every import, type-checking ones left out."""
    return tuple(_find_imports(source, module, is_package))


def _find_imports(
    source: str, module: str, is_package: bool
) -> Iterator[tuple[int, str, str | None]]:
    tree = ast.parse(source)
    typing_only = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If)
        and dotted(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")
        for child in node.body
        for inner in ast.walk(child)
    }
    for node in ast.walk(tree):
        if id(node) in typing_only:
            continue
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name, None
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")
                up = parts[: len(parts) - node.level + (1 if is_package else 0)]
                base = ".".join([*up, base] if base else up)
            for alias in node.names:
                yield node.lineno, base, alias.name
        elif isinstance(node, ast.Call) and dotted(node.func) in (
            "importlib.import_module",
            "import_module",
        ):
            target = node.args[0] if node.args else None
            if isinstance(target, ast.Constant) and isinstance(target.value, str):
                yield node.lineno, target.value, None


def used_rooms(
    source: str, module: str, is_package: bool, package: str = "updyn"
) -> Iterator[tuple[int, str]]:
    """Yield line and room of every import within the package; ``""`` stands for the package's own namespace."""
    for line, target, name in imports(source, module, is_package):
        parts = target.split(".")
        if parts[0] != package:
            continue
        if len(parts) > 1:
            inner = f"{target}.{name}"
            yield line, str(room_of(inner if inner in modules() else target))
        elif name is None or name in FACADE:
            if name is None:
                yield line, ""
        else:
            found = PRIVATE.get(name, name)
            yield line, found if found in LEVEL else ""
