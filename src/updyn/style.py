"""Design tokens for report and figures: colours, colour maps, type sizes and spaces.

No other module defines the colour of a curve. The categories are distinguishable in grey print and
for colour-blind readers (`tests/unit/test_style.py`: CIE lightness, and distance in CIELAB by the
matrices of Machado, Oliveira & Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009) 1291).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

__all__ = [
    "CATEGORIES",
    "DARK",
    "DASHES",
    "DIVERGING",
    "FIGURE_TEXT",
    "LOOKS",
    "OTHERS",
    "PAPER",
    "PRINTED",
    "SEQUENTIAL",
    "SIZES",
    "SPACES",
    "STATES",
    "category",
    "colour_scale",
    "css",
    "state",
]

#: Colours by role on a light background.
PAPER: Mapping[str, str] = {
    "ground": "#ffffff",
    "panel": "#f6f7f9",
    "text": "#1b1f24",
    "muted": "#5c6570",
    "rule": "#d9dee4",
    "grid": "#e6e9ed",
    "faint": "#c3c9d0",
    "measured": "#8b949e",
    "before": "#c44e00",
    "after": "#00558f",
    "third": "#17a673",
    "fourth": "#5a1050",
    "after-faint": "rgba(0, 85, 143, 0.15)",
    "fit-band": "rgba(0, 85, 143, 0.07)",
    "held-band": "rgba(230, 159, 0, 0.18)",
    "good": "#0b6e4f",
    "good-ground": "#e3f4ec",
    "warn": "#8a5300",
    "warn-ground": "#fff1d6",
    "bad": "#a4262c",
    "bad-ground": "#fde7e7",
    "link": "#0b5cad",
    # magnitudes in eight steps, small to large: `SEQUENTIAL` from one eighth on
    "seq-0": "#cedeee",
    "seq-1": "#a6c6e5",
    "seq-2": "#80acd8",
    "seq-3": "#5a92cb",
    "seq-4": "#4279b5",
    "seq-5": "#29609f",
    "seq-6": "#184885",
    "seq-7": "#08306b",
    # picture of a structure: change of a group by size, softer and stiffer; forces
    "less-4": "#a63c00",
    "less-3": "#d55e00",
    "less-2": "#e98a3c",
    "less-1": "#efb27c",
    "same": "#6b737c",
    "more-1": "#9cc4e4",
    "more-2": "#5aa2d6",
    "more-3": "#0072b2",
    "more-4": "#00497a",
    "none": "#bcc3cb",
    "plain": "#7f9bb3",
    "ghost": "#d5dae0",
    "edge": "#3d4650",
    "force": "#b0267f",
}
#: The same roles on a dark screen.
DARK: Mapping[str, str] = {
    "ground": "#14171b",
    "panel": "#1d2126",
    "text": "#e6e9ed",
    "muted": "#9aa4af",
    "rule": "#343a42",
    "grid": "#2b3138",
    "faint": "#4a525c",
    "measured": "#848e98",
    "before": "#f07f2e",
    "after": "#56b4e9",
    "third": "#9fe8c6",
    "fourth": "#c050e0",
    "after-faint": "rgba(86, 180, 233, 0.2)",
    "fit-band": "rgba(86, 180, 233, 0.1)",
    "held-band": "rgba(230, 159, 0, 0.2)",
    "good": "#7fdcb4",
    "good-ground": "#12362a",
    "warn": "#ffcf7a",
    "warn-ground": "#3d2d0c",
    "bad": "#ffaaaa",
    "bad-ground": "#451a1c",
    "link": "#7db8f5",
    # the same on a dark background: the largest is the lightest
    "seq-0": "#22344a",
    "seq-1": "#2b4a6e",
    "seq-2": "#336193",
    "seq-3": "#4079b5",
    "seq-4": "#5b95cf",
    "seq-5": "#83b2e0",
    "seq-6": "#aecdec",
    "seq-7": "#dbe9f6",
    # picture of a structure: change of a group by size, softer and stiffer; forces
    "less-4": "#ffb366",
    "less-3": "#e88e3c",
    "less-2": "#b97a45",
    "less-1": "#8a6a50",
    "same": "#9aa4af",
    "more-1": "#4d6f8a",
    "more-2": "#3f8cc4",
    "more-3": "#56b4e9",
    "more-4": "#a8deff",
    "none": "#525b66",
    "plain": "#7d97ad",
    "ghost": "#333a42",
    "edge": "#47525e",
    "force": "#ff7ac2",
}
#: Colours that differ between paper and a light screen: text and rules are darker.
PRINTED: Mapping[str, str] = {
    "text": "#000000",
    "muted": "#444c55",
    "rule": "#c5cbd2",
    "faint": "#b5bcc4",
    "link": "#000000",
}
#: Values of a page option that overrides the system's light or dark mode.
LOOKS = ("light", "dark")
#: Roles of the colours of measured data, of the model at the start and of the updated model, by
#: their names in legends. Used by all figures, pages and pictures; the viewer draws the test in a
#: colour apart from those of groups.
STATES: Mapping[str, str] = {"measured": "measured", "start": "before", "updated": "after"}
#: Roles of the colours of further curves in a figure with `STATES`.
OTHERS = ("third", "fourth")
#: Roles of the colours of several curves, in order, and dashes in the notation of matplotlib: the
#: colours are repeated with the next dash.
CATEGORIES = ("after", "before", "third", "fourth")
DASHES = ("-", "--", "-.", ":")
#: Evenly spaced stops of a colour map from 0 to 1, light to dark, and of one from -1 to 1.
SEQUENTIAL = ("#f7f7f7", "#a6c6e5", "#5a92cb", "#29609f", "#08306b")
DIVERGING = ("#8a3c00", "#dd8433", "#f7f7f7", "#6a9fd4", "#08519c")

#: Type sizes on pages, relative to running text, and of text in figures in px.
SIZES: Mapping[str, float] = {
    "title": 1.9,
    "heading": 1.35,
    "subheading": 1.1,
    "text": 1.0,
    "small": 0.9,
    "tiny": 0.82,
}
FIGURE_TEXT = 13
#: Spaces in px.
SPACES: Mapping[str, int] = {"narrow": 6, "normal": 12, "wide": 24}
_FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'


def category(number: int) -> tuple[str, str]:
    """Return colour on a light background and matplotlib dash of a curve, counted from 0."""
    round_, place = divmod(number, len(CATEGORIES))
    return PAPER[CATEGORIES[place]], DASHES[round_ % len(DASHES)]


def state(name: str, other: int = 0) -> str:
    """Return the role of a colour (key of `PAPER`) of one of `STATES` or of another curve."""
    return STATES.get(name, OTHERS[other % len(OTHERS)])


def colour_scale(stops: Sequence[str]) -> list[list[float | str]]:
    """Return a colour map in plotly's form: pairs of a position between 0 and 1 and a colour."""
    last = len(stops) - 1
    return [[place / last, colour] for place, colour in enumerate(stops)]


def css() -> str:
    """Return the tokens as style sheet variables for light screen, dark screen and paper."""
    # The attribute ``data-look`` of the root overrides the system's light or dark mode. The class
    # ``paper`` of the root is set while a page is printed, as figures are drawn before the print
    # rules apply.
    sizes = {f"size-{name}": f"{size:g}rem" for name, size in SIZES.items()}
    spaces = {f"space-{name}": f"{space}px" for name, space in SPACES.items()}
    rest = {"font": _FONT, "figure-text": f"{FIGURE_TEXT}px", **sizes, **spaces}
    dark = _declarations(DARK)
    by_system = f":root:not(.paper, [data-look]) {dark}"
    return "\n".join(
        (
            f":root {_declarations({'color-scheme': 'light dark'}, variables=False)}",
            f":root {_declarations({**PAPER, **rest})}",
            *(f":root[data-look={look}] {{ color-scheme: {look}; }}" for look in LOOKS),
            ":root.paper { color-scheme: light; }",
            f"@media screen and (prefers-color-scheme: dark) {{ {by_system} }}",
            f"@media screen {{ :root[data-look=dark]:not(.paper) {dark} }}",
            f"@media print {{ :root {_declarations(PRINTED)} :root {{ color-scheme: light; }} }}",
            "",
        )
    )


def _declarations(values: Mapping[str, str], *, variables: bool = True) -> str:
    mark = "--" if variables else ""
    return "{ " + " ".join(f"{mark}{name}: {value};" for name, value in values.items()) + " }"
