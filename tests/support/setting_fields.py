"""The settings of the package: fields of the frozen objects in modules named `settings`."""

from __future__ import annotations

import ast
import dataclasses
import functools
import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from rooms import SRC, module_of

#: Words before the reason of a setting whose value decides no result: a limit of effort, a size of
#: a drawing or a text, the default of an argument, a tolerance decades away from what it separates.
EXEMPT = ("Effort", "Drawing", "Default", "Rounding")


@dataclass(frozen=True)
class Setting:
    """A field of a settings object.

    Attributes
    ----------
    module, instance, field : str
        Module, name of the object in it, and name of the field.
    comment : str
        The comment above the field: ``[unit] Meaning. Why: reason.`` A word of `EXEMPT` in place
        of ``Why`` states that no test has to notice another value.
    place : str
        File and line of the field.
    """

    module: str
    instance: str
    field: str
    comment: str
    place: str

    @property
    def package(self) -> str:
        """Return the package of the setting."""
        return self.module.removeprefix("updyn.").removesuffix(".settings")

    @property
    def name(self) -> str:
        """Return ``package.INSTANCE.field``."""
        return f"{self.package}.{self.instance}.{self.field}"

    @property
    def is_exempt(self) -> bool:
        """Return whether the comment states that no test has to notice another value."""
        return any(f" {word}: " in self.comment for word in EXEMPT)

    @property
    def object(self) -> Any:
        """Return the settings object."""
        return getattr(importlib.import_module(self.module), self.instance)


@functools.cache
def list_modules() -> tuple[ModuleType, ...]:
    """Return the modules of settings."""
    paths = sorted(SRC.rglob("settings.py"))
    return tuple(importlib.import_module(module_of(path)) for path in paths)


def list_classes() -> list[type]:
    """Return the classes of all settings objects."""
    return [
        value
        for module in list_modules()
        for value in vars(module).values()
        if isinstance(value, type) and value.__module__ == module.__name__
    ]


@functools.cache
def list_settings() -> tuple[Setting, ...]:
    """Return all fields of all settings objects."""
    return tuple(setting for module in list_modules() for setting in _settings_of(module))


@functools.cache
def read_attributes() -> frozenset[tuple[str, str]]:
    """Return the pairs of a name and its attribute that the package reads."""
    return frozenset(
        (node.value.id, node.attr)
        for path in SRC.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
    )


def _settings_of(module: ModuleType) -> Iterator[Setting]:
    """Yield the settings of a module."""
    path = Path(module.__file__ or "")
    source = path.read_text(encoding="utf-8")
    lines = _field_lines(source)
    for instance, value in vars(module).items():
        if isinstance(value, type) or not dataclasses.is_dataclass(value):
            continue
        for field in dataclasses.fields(value):
            line = lines[type(value).__name__, field.name]
            comment = _comment_above(source.splitlines(), line)
            place = f"{path.relative_to(SRC)}:{line}"
            yield Setting(module.__name__, instance, field.name, comment, place)


def _field_lines(source: str) -> dict[tuple[str, str], int]:
    """Return the line of each field by class and name."""
    return {
        (node.name, field.target.id): field.lineno
        for node in ast.parse(source).body
        if isinstance(node, ast.ClassDef)
        for field in node.body
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
    }


def _comment_above(lines: list[str], line: int) -> str:
    """Return the comment on the lines directly above a line, without its marks."""
    comment: list[str] = []
    for text in reversed(lines[: line - 1]):
        if not text.lstrip().startswith("#:"):
            break
        comment.insert(0, text.lstrip().removeprefix("#:").strip())
    return " ".join(comment)
