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


@dataclass(frozen=True)
class Style:
    """Sizes, colours and spacings of figures, recordings and films.

    Attributes
    ----------
    page : (width, height)
        Size of a printed page and, as landscape, of figures with many panels: A4, inches.
    width, row : float
        Width of a figure of one column, and height of a row of panels, inches.
    lane : float
        Height of the lane of one joint in a chart of saturation, inches.
    small, tiny : float
        Font sizes of notes in figures and of the text of the printed page, points.
    line : float
        Width of a curve, points.
    ink, warning, bound : str
        Colours of limits with their notes, of failures, and of limits on a light or dark page.
    dpi, screen_dpi : int
        Resolution of files, and of notebooks and live plots, dots per inch.
    side_by_side : int
        Largest number of joints with one column each and with names in tables; more joints have one
        row each, or the busiest joint represents all.
    points : int
        Number of samples of a solution's curve per phase.
    stretch : float
        Largest factor by which a limit may stretch an axis; a limit beyond it is named, not drawn.
    room : float
        Margin of an axis, relative to its data.
    rate, samples : float, int
        Default sampling rate of a recorded arm, Hz, and largest default number of samples of all
        arms together (38 MB for a 7R arm).
    dashes : int
        Number of dashes of a limit's line over the whole timeline.
    link, ghost, plate : float
        Link radius of the solid arm and of the first ghost, and half the edge of the base plate,
        relative to the reach.
    joint, mass : (radius, length), (least, most)
        Size of a joint's drum, and range of the radii of centres of mass, in link radii.
    film_joint : float
        Size of joints and torque arcs in a film, relative to a recording.
    ring : float
        Radius of a torque arc in link radii; the arrow of a force at its limit is three times as
        long.
    arrow, letter, label : float
        Longest arrow at a tool, width of a letter, and height between labels, relative to the
        reach.
    plane : float
        Half the edge of the drawn part of a half space, relative to the reach.
    see_through : int
        Opacity of ghosts, 0 to 255.
    neutral, near, saturated, broken : Color
        Colours of the use of a limit: interpolated from neutral to near below the limit, saturated
        at the limit, broken above it. They are distinct on a dark screen for any colour vision.
    bright, dull, speed, motion, ball, variable : Color
        Colours of marked places, of limits and base, of limits other than torque, of velocities, of
        centres of mass, and of variables of an optimal-control problem.
    obstacle, capsule, tube, part, metal : Color
        Colours of obstacles, capsules of the arm, tubes of tool lines, carried parts, and geometry
        without a colour.
    screen : (width, height)
        Aspect of Rerun's view of the arms.
    field : float
        Vertical field of view in Rerun, deg.
    tilt, steep_tilt : float
        Downward angle of the eye, for general motions and for motions in a level plane, deg.
    panel : (width, height)
        Size of the box of one curve of an iterate.
    frame : (width, height)
        Size of a film, inches.
    frame_rate, hold : float
        Frame rate of a film, Hz (40 ms is exact in a GIF), and display time of its last frame, s.
    frames : int
        Largest number of frames of a film.
    patch : float
        Longest edge of an obstacle's face in a film, relative to the reach; depth sorting needs
        small faces.
    triangles : int
        Largest number of triangles of a robot's meshes in a film; larger meshes are simplified.
    """

    page: tuple[float, float] = (8.27, 11.69)
    width: float = 9.6
    row: float = 2.3
    lane: float = 0.24
    small: float = 7.5
    tiny: float = 6.8
    line: float = 1.6

    ink: str = "0.25"
    warning: str = "#B00020"
    bound: str = "#888888"
    dpi: int = 150
    screen_dpi: int = 90
    side_by_side: int = 4
    points: int = 400
    stretch: float = 2.0
    room: float = 0.06
    rate: float = 200.0
    samples: int = 12_000
    dashes: int = 40
    link: float = 0.021
    ghost: float = 0.0165
    plate: float = 0.07
    joint: tuple[float, float] = (1.5, 3.6)
    mass: tuple[float, float] = (1.3, 2.2)
    film_joint: float = 1.1
    ring: float = 3.4
    arrow: float = 0.3
    letter: float = 0.026
    label: float = 0.075
    plane: float = 1.0
    see_through: int = 110
    neutral: Color = (130, 142, 160, 255)
    near: Color = (240, 228, 66, 255)
    saturated: Color = (255, 60, 150, 255)
    broken: Color = (225, 50, 40, 255)
    bright: Color = (245, 245, 245, 255)
    dull: Color = (165, 165, 165, 255)
    speed: Color = (86, 180, 233, 255)
    motion: Color = (170, 235, 255, 255)
    ball: Color = (60, 200, 160, 255)
    variable: Color = (240, 150, 80, 255)
    obstacle: Color = (205, 160, 105, 255)
    capsule: Color = (150, 190, 230, 60)
    tube: Color = (0, 158, 115, 110)
    part: Color = (160, 120, 255, 255)
    metal: Color = (190, 195, 205, 255)
    screen: tuple[float, float] = (1.25, 1.0)
    field: float = 55.0
    tilt: float = 20.0
    steep_tilt: float = 60.0
    panel: tuple[float, float] = (1.7, 1.0)
    frame: tuple[float, float] = (8.0, 4.5)
    frame_rate: float = 25.0
    hold: float = 1.5
    frames: int = 3000
    patch: float = 0.07
    triangles: int = 12_000

    @property
    def landscape(self) -> tuple[float, float]:
        """Size of the page in landscape."""
        return self.page[1], self.page[0]

    @property
    def limit_line(self) -> dict[str, Any]:
        """Line style of a limit in figures."""
        return {"color": self.ink, "linestyle": "--", "linewidth": 1.0, "label": "_limit"}

    @property
    def beyond_limit(self) -> dict[str, Any]:
        """Shade beyond a limit in figures."""
        return {"facecolor": "0.5", "alpha": 0.18, "linewidth": 0}


STYLE = Style()

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
    return {"color": color, "linestyle": dashes, "linewidth": STYLE.line}


def rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour ``#RRGGBB``."""
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
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
