"""Style of figures, recordings and films: sizes, and colours and dashes of methods and joints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from microbot_ocp.tasks import Comparison, Entry

Color = tuple[int, int, int, int]
LineStyle = str | tuple[float, tuple[float, ...]]

PAGE = (8.27, 11.69)  # width and height of a printed page: A4, inches
LANDSCAPE = (PAGE[1], PAGE[0])
FIGURE_WIDTH = 9.6  # width of a figure of one column, inches
ROW_HEIGHT = 2.3  # height of a row of panels, inches
SMALL_FONT = 7.5  # font size of notes in figures, points
TINY_FONT = 6.8  # font size of the text of the printed page, points
LINE_WIDTH = 1.6  # width of a curve, points
THIN: dict[str, Any] = {"linewidth": 0.8}  # lines that divide, points
# Largest number of joints with one column each and with names in tables; more joints have one row
# each, or the busiest joint represents all.
SIDE_BY_SIDE = 4
LINK_RADIUS = 0.021  # link radius of the solid arm, relative to the reach
LINE_RADIUS = 0.005  # radius of a line in space, relative to the reach
BALL_RADIUS = 1.4  # radius of the ball at a tool or a via point, in link radii
FRAME_LENGTH = 0.07  # length of the axes of a frame, relative to the reach
LABEL_HEIGHT = 0.075  # height between labels, relative to the reach
# Radius of a torque arc in link radii; the arrow of a force at its limit is three times as long.
TORQUE_RING = 3.4
FRAME_RATE = 25.0  # frame rate of a film, Hz: 40 ms are exact in a GIF
LAST_FRAME = 1.5  # time for which the last frame of a film is shown, s

LIMIT_COLOR = "0.25"  # limits and their notes
WARNING_COLOR = "#B00020"  # failures
BOUND_COLOR = "#888888"  # limits on a light or dark page
LIMIT_LINE: dict[str, Any] = {
    "color": LIMIT_COLOR,
    "linestyle": "--",
    "linewidth": 1.0,
    "label": "_limit",
}
BEYOND_LIMIT: dict[str, Any] = {"facecolor": "0.5", "alpha": 0.18, "linewidth": 0}

# Palette of Okabe and Ito, which is distinct for any colour vision, with a violet and a dark green
# instead of its yellow (too faint on white). Line styles differ as well, for prints in grey.
FIXED: dict[str, tuple[str, LineStyle]] = {
    "cubic_report": ("#0072B2", (0.0, (7.0, 2.0, 1.5, 2.0))),
    "cubic_scaled": ("#8A2BE2", (0.0, (3.0, 1.2))),
    "cubic_textbook": ("#773366", (0.0, (2.0, 1.0, 6.0, 1.0))),
    "cubic": ("#56B4E9", (0.0, (5.0, 2.0))),
    "lspb_scaled": ("#117733", (0.0, (3.0, 1.2, 1.0, 1.2))),
    "lspb_textbook": ("#99BB66", (0.0, (8.0, 1.0, 1.0, 1.0))),
    "lspb": ("#009E73", (0.0, (9.0, 2.5))),
    "straight_path": ("#CC79A7", (0.0, (1.5, 1.2))),
    "cubic_path": ("#E69F00", (0.0, (5.0, 1.2, 1.2, 1.2, 1.2, 1.2))),
    "time_optimal": ("#D55E00", "solid"),
}
# Muted palette of Tol for any other method, in the order of the entries.
OTHERS: tuple[tuple[str, LineStyle], ...] = (
    ("#AA4499", (0.0, (6.0, 1.5, 1.0, 1.5, 1.0, 1.5))),
    ("#999933", (0.0, (2.5, 2.5))),
    ("#44AA99", "solid"),
    ("#CC6677", (0.0, (10.0, 1.5, 2.0, 1.5))),
    ("#88CCEE", (0.0, (4.0, 1.0, 1.0, 1.0))),
    ("#B8A038", (0.0, (1.0, 2.0))),
)
# Styles of curves without a method, the strongest first.
LOOKS: tuple[tuple[str, LineStyle], ...] = (
    *(FIXED[name] for name in ("time_optimal", "cubic_report", "lspb", "straight_path")),
    *(FIXED[name] for name in ("cubic_path", "cubic")),
    *OTHERS,
)
# Styles of joints in one figure; light and dark colours alternate.
JOINT_LOOKS: tuple[tuple[str, LineStyle], ...] = (
    ("#0072B2", "solid"),
    ("#D55E00", (0.0, (5.0, 1.5))),
    ("#009E73", (0.0, (1.5, 1.0))),
    ("#CC79A7", (0.0, (6.0, 1.5, 1.0, 1.5))),
    ("#E69F00", (0.0, (9.0, 2.0))),
    ("#882255", (0.0, (3.0, 1.0, 1.0, 1.0, 1.0, 1.0))),
    ("#56B4E9", (0.0, (2.5, 2.5))),
    ("#661100", (0.0, (10.0, 1.5, 2.0, 1.5))),
)
# Bars of the saturation chart by quantity, and of limits of the arm in turn.
LIMIT_COLORS = {"tau": "0.35", "taud": "0.6", "qdd": "0.6", "qddd": "#56B4E9", "qd": "#E69F00"}
FURTHER_LIMIT_COLORS = ("#009E73", "#CC79A7", "#0072B2", "#882255")
# Colours of a film besides those of its arms.
THEMES = {
    "light": {
        "paper": "#ffffff", "ink": "#1b2330", "faint": "#8a94a3", "grid": "#dfe4ea",
        "floor": "#f1f4f7", "shadow": "#d3d9e0", "joint": "#39424f", "limit": "#c8157a",
        "low": "#7d8898", "high": "#d98200",
    },
    "dark": {
        "paper": "#0f141b", "ink": "#e8edf3", "faint": "#8793a3", "grid": "#2a3340",
        "floor": "#151c25", "shadow": "#090c10", "joint": "#a9b4c2", "limit": "#ff4da6",
        "low": "#8793a3", "high": "#f0e442",
    },
}  # fmt: skip
PREFERRED = "time_optimal"


@dataclass(frozen=True)
class EntryStyle:
    """Style of one entry in all figures.

    Attributes
    ----------
    name, title : str
        Key of the method and its name in legends.
    color : str
        Colour ``#RRGGBB``.
    linestyle : str or (offset, dashes)
        Line style of matplotlib.
    highlighted : bool
        True for the entry that is drawn on top and solid.
    """

    name: str
    title: str
    color: str
    linestyle: LineStyle
    highlighted: bool


def entry_styles(comparison: Comparison) -> dict[str, EntryStyle]:
    """Return the style of every entry by its name; a built-in method has a fixed style."""
    highlighted, others = highlighted_name(comparison), cycle(OTHERS)
    return {
        e.name: EntryStyle(
            e.name, entry_title(e), *(FIXED.get(e.name) or next(others)), e.name == highlighted
        )
        for e in comparison.entries
    }


def look(place: int, joints: bool = False) -> dict[str, Any]:
    """Return colour, dashes and width of the curve (or joint) with an index ``place``."""
    looks = JOINT_LOOKS if joints else LOOKS
    color, dashes = looks[place % len(looks)]
    return {"color": color, "linestyle": dashes, "linewidth": LINE_WIDTH}


def rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour ``#RRGGBB``."""
    red, green, blue = bytes.fromhex(color[1:])
    return red, green, blue


def entry_title(entry: Entry) -> str:
    """Return the title of an entry."""
    return entry.title or entry.name.replace("_", " ")


def method_title(method: str) -> str:
    """Return the title of a method."""
    from microbot_ocp.tasks import METHODS

    return METHODS[method].title if method in METHODS else method


def highlighted_name(comparison: Comparison) -> str | None:
    """Return the name of the entry drawn on top: time_optimal, or else the last with a motion."""
    solved = [entry.name for entry in comparison.entries if entry.motion is not None]
    return PREFERRED if PREFERRED in solved else next(reversed(solved), None)


def main_methods(comparison: Comparison) -> list[str]:
    """Return the names of the reference and of the entry on top, if they have a motion."""
    pair = dict.fromkeys([comparison.reference, highlighted_name(comparison)])
    return [name for name in pair if name in comparison.motions]


def failure_sentence(entry: Entry) -> str:
    """Return a sentence with the reason why an entry has no motion."""
    return ": ".join([entry.name, "not solved", *filter(None, (entry.status, entry.note))])


def failures(comparison: Comparison, methods: list[str] | None = None) -> Iterator[str]:
    """Yield a sentence for every entry without a motion, of all entries or those in ``methods``."""
    for entry in comparison.entries:
        if entry.motion is None and (methods is None or entry.name in methods):
            yield failure_sentence(entry)
