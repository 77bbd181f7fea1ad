"""How every picture looks: one style, and colours and dashes of methods, curves and joints."""

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
        A4, inches: a printed page, and turned on its side the figures of many panels.
    width, row : float
        Width of a figure of one column, and height of a row of panels, inches.
    lane : float
        Height of the lane of one joint in a chart of saturation, inches.
    small, tiny : float
        Size of notes in figures and of the text of the printed page, points.
    line : float
        Width of a curve, points.
    ink, warning : str
        Colours of limits and notes, and of what went wrong.
    dpi, screen_dpi : int
        Dots an inch of a file and of a notebook or a live plot.
    side_by_side : int
        So many joints have columns side by side and their names in tables; of more each has a row,
        or the busiest stand for all.
    points : int
        Samples of a curve of a solution in each phase.
    stretch : float
        A limit that would stretch an axis by more is named, not drawn.
    room : float
        Length of an axis over that of what is drawn on it, as a share more.
    rate, samples : float, int
        Samples a second of a recorded arm, smoother than any screen; and at most so many of all
        arms together (38 MB of a 7R arm) where nobody asks for a rate.
    dashes : int
        Of a limit's line over a whole timeline.
    link, ghost, plate : float
        Radii of a link of the arm on top and of the first ghost, half the edge of the base's plate;
        shares of the reach.
    joint, mass : (radius, length), (least, most)
        A joint's drum, and radii of the balls at centres of mass; in link radii.
    film_joint : float
        Size of a film's joints, whose torques' arcs are as much wider, over those of recordings.
    ring : float
        Radius of a torque's arc in link radii; a slide's arrow at the limit is three times as long.
    arrow, letter, label : float
        The longest arrow at a tool, the width of a letter, and the height between labels; shares of
        the reach.
    plane : float
        From the middle to the edge of what is drawn of a half space, share of the reach.
    see_through : int
        Opacity of ghosts, of 255.
    neutral, near, saturated, broken : Color
        A share of a limit goes from neutral to near; at the limit it jumps to a pink that nothing
        else has; where it is broken, red. Told apart on a dark screen with any colour vision.
    bright, dull, speed, motion, ball, variable : Color
        Marked places, limits and base, limits of speeds and further ones, velocities, centres of
        mass, variables of an optimal-control problem.
    obstacle, capsule, tube, part, metal : Color
        What stands around an arm, its capsules, tubes of tool lines, carried parts, and geometry
        that has no colour of its own.
    screen : (width, height)
        Of Rerun's view of the arms: its shape.
    field : float
        Angle of Rerun's eye from bottom to top, deg.
    tilt, steep_tilt : float
        Angle from which the eye looks down, and the same where all that moves is level, deg.
    panel : (width, height)
        Of the box in which one iterate's curve is drawn.
    frame : (width, height)
        Of a film, inches.
    frame_rate, hold : float
        Frames a second (40 ms, which a GIF can say exactly), and how long the last one stays, s.
    frames : int
        At most so many in a film.
    patch : float
        Longest edge of an obstacle's face in a film, share of the reach: small faces sort well.
    triangles : int
        Of a robot's own meshes in a film: more are drawn more coarsely.
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
        """The page on its side."""
        return self.page[1], self.page[0]

    @property
    def limit_line(self) -> dict[str, Any]:
        """A limit in figures."""
        return {"color": self.ink, "linestyle": "--", "linewidth": 1.0, "label": "_limit"}

    @property
    def beyond_limit(self) -> dict[str, Any]:
        """The shade beyond a limit in figures."""
        return {"facecolor": "0.5", "alpha": 0.18, "linewidth": 0}


STYLE = Style()

# Okabe and Ito's palette, which stays distinct with any colour vision, without its yellow (too
# faint on white), a violet and a darker green. Line styles differ as well, for prints in grey.
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


def entry_styles(comparison: Comparison) -> dict[str, EntryStyle]:
    """Return the style of every entry by its name; a known method looks the same everywhere."""
    highlighted, spare = highlighted_name(comparison), cycle(SPARE)
    return {
        e.name: EntryStyle(
            e.name, entry_title(e), *(FIXED.get(e.name) or next(spare)), e.name == highlighted
        )
        for e in comparison.entries
    }


def look(place: int, joints: bool = False) -> dict[str, Any]:
    """Return colour and dashes of the curve, or of the joint, at a place among others."""
    looks = JOINT_LOOKS if joints else LOOKS
    color, dashes = looks[place % len(looks)]
    return {"color": color, "linestyle": dashes, "linewidth": STYLE.line}


def rgb(color: str) -> tuple[int, int, int]:
    """Return red, green and blue, 0 to 255, of a colour ``#RRGGBB``."""
    red, green, blue = (int(color[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue


def entry_title(entry: Entry) -> str:
    """Return what people read of an entry."""
    return entry.title or entry.name.replace("_", " ")


def method_title(method: str) -> str:
    """Return what people read of a method."""
    from microbot_ocp.tasks import METHODS

    return METHODS[method].title if method in METHODS else method


def highlighted_name(comparison: Comparison) -> str | None:
    """Return the name of the solved entry to show on top: time_optimal if there, else the last."""
    solved = [entry.name for entry in comparison.entries if entry.motion is not None]
    return PREFERRED if PREFERRED in solved else next(reversed(solved), None)


def main_methods(comparison: Comparison) -> list[str]:
    """Return the names of the reference and of the entry on top, as far as they are solved."""
    pair = dict.fromkeys([comparison.reference, highlighted_name(comparison)])
    return [name for name in pair if name in comparison.motions]


def failure_sentence(entry: Entry) -> str:
    """Say why an entry has no motion."""
    return ": ".join([entry.name, "not solved", *filter(None, (entry.status, entry.note))])


def failures(comparison: Comparison, methods: list[str] | None = None) -> Iterator[str]:
    """Yield why entries, all or those of these names, have no motion."""
    for entry in comparison.entries:
        if entry.motion is None and (methods is None or entry.name in methods):
            yield failure_sentence(entry)
