"""Colours, line styles and titles of the methods, shared by figures and recordings."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from microbot_ocp.comparison import Comparison, Entry

LineStyle = str | tuple[float, tuple[float, ...]]

# Okabe and Ito's palette, which stays distinct with any colour vision, without its yellow (too
# faint on white), a violet and a darker green. Line styles differ as well, for prints in grey.
FIXED: dict[str, tuple[str, LineStyle]] = {
    "cubic_report": ("#0072B2", (0.0, (7.0, 2.0, 1.5, 2.0))),
    "cubic_scaled": ("#8A2BE2", (0.0, (3.0, 1.2))),
    "cubic": ("#56B4E9", (0.0, (5.0, 2.0))),
    "lspb_scaled": ("#117733", (0.0, (3.0, 1.2, 1.0, 1.2))),
    "lspb": ("#009E73", (0.0, (9.0, 2.5))),
    "straight_path": ("#CC79A7", (0.0, (1.5, 1.2))),
    "cubic_path": ("#E69F00", (0.0, (5.0, 1.2, 1.2, 1.2, 1.2, 1.2))),
    "time_optimal": ("#D55E00", "solid"),
}
# Tol's muted palette for any other method, in the order of the entries.
SPARE: tuple[tuple[str, LineStyle], ...] = (
    ("#AA4499", (0.0, (6.0, 1.5, 1.0, 1.5, 1.0, 1.5))),
    ("#999933", (0.0, (2.5, 2.5))),
    ("#44AA99", "solid"),
    ("#CC6677", (0.0, (10.0, 1.5, 2.0, 1.5))),
    ("#88CCEE", (0.0, (4.0, 1.0, 1.0, 1.0))),
    ("#B8A038", (0.0, (1.0, 2.0))),
)
# Curves without a method, the strongest first.
LOOKS: tuple[tuple[str, LineStyle], ...] = (
    *(FIXED[name] for name in ("time_optimal", "cubic_report", "lspb", "straight_path")),
    *(FIXED[name] for name in ("cubic_path", "cubic")),
    *SPARE,
)
# One colour a joint where a figure shows joints beside each other; light and dark take turns.
JOINT_COLORS = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#882255", "#56B4E9", "#661100",
)  # fmt: skip
JOINT_DASHES: tuple[LineStyle, ...] = (
    "solid",
    (0.0, (5.0, 1.5)),
    (0.0, (1.5, 1.0)),
    (0.0, (6.0, 1.5, 1.0, 1.5)),
    (0.0, (9.0, 2.0)),
    (0.0, (3.0, 1.0, 1.0, 1.0, 1.0, 1.0)),
    (0.0, (2.5, 2.5)),
    (0.0, (10.0, 1.5, 2.0, 1.5)),
)
PREFERRED = "time_optimal"


@dataclass(frozen=True)
class EntryStyle:
    """How one entry is drawn everywhere.

    Attributes
    ----------
    name, title : str
        Key of the method and what legends print.
    color : str
        ``#RRGGBB``.
    linestyle : str or (offset, dashes)
        As matplotlib takes it.
    highlighted : bool
        Whether it is drawn on top and solid.
    """

    name: str
    title: str
    color: str
    linestyle: LineStyle
    highlighted: bool

    def rgba(self, alpha: int = 255) -> tuple[int, int, int, int]:
        """Red, green, blue and ``alpha``, 0 to 255 each."""
        red, green, blue = (int(self.color[i : i + 2], 16) for i in (1, 3, 5))
        return red, green, blue, alpha


def entry_styles(comparison: Comparison) -> dict[str, EntryStyle]:
    """Style of every entry by its name; a known method looks the same in every comparison."""
    highlighted = highlighted_name(comparison)
    spare = _spare_looks()
    styles = {}
    for entry in comparison.entries:
        color, linestyle = FIXED[entry.name] if entry.name in FIXED else next(spare)
        styles[entry.name] = EntryStyle(
            name=entry.name,
            title=entry.title or entry.name.replace("_", " "),
            color=color,
            linestyle=linestyle,
            highlighted=entry.name == highlighted,
        )
    return styles


def look(place: int) -> tuple[str, LineStyle]:
    """Colour and line style of the curve at a place among others."""
    return LOOKS[place % len(LOOKS)]


def highlighted_name(comparison: Comparison) -> str | None:
    """Name of the solved entry to show on top: time_optimal if there, else the last one."""
    solved = [entry.name for entry in comparison.entries if entry.motion is not None]
    if PREFERRED in solved:
        return PREFERRED
    return solved[-1] if solved else None


def failure_sentence(entry: Entry) -> str:
    """Why an entry has no motion."""
    reasons = [text for text in (entry.status, entry.note) if text]
    return ": ".join([entry.name, "not solved", *reasons])


def _spare_looks() -> Iterator[tuple[str, LineStyle]]:
    while True:
        yield from SPARE
