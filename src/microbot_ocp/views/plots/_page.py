"""Pages of axes: new ones or the caller's, styled without global state, saved in one place.

pyplot is never imported: no global state keeps a figure alive.
"""

from __future__ import annotations

import io
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection
from matplotlib.colors import to_rgba, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from mpl_toolkits.mplot3d import Axes3D

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.showing import DrawnAxes, GivenAxes
from microbot_ocp._base.writing import made_folder, write_whole
from microbot_ocp.views._style import STYLE

FORMATS = (".png", ".pdf", ".svg", ".jpg", ".jpeg")
SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
    "font.size": 9.0,
    "axes.titlesize": 10.5,
    "axes.labelsize": 9.5,
    "legend.fontsize": 9.0,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "axes.grid": True,
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "pdf.fonttype": 42,  # text stays text
    "text.parse_math": False,  # names may hold a dollar sign
}
COLORED = {
    Text: ("color",),
    Line2D: ("color", "markeredgecolor", "markerfacecolor"),
    Patch: ("facecolor", "edgecolor"),
    Collection: ("facecolor", "edgecolor"),
}
Drawn = Figure | Axes | np.ndarray | DrawnAxes


def halo(color: str = "white") -> list[Any]:
    """Return path effects with which text stays legible on curves."""
    return [withStroke(linewidth=2.5, foreground=color)]


def styled(changes: Mapping[str, Any] | None = None) -> Any:
    """Return a context (or decorator) in which figures look alike, whatever the user has set.

    ``changes`` are settings of matplotlib's.
    """
    return style.context(["default", {**SETTINGS, **(changes if changes is not None else {})}])


class _Shown:
    """Axes that can be written to a file, and shown by Jupyter in the last line of a cell."""

    def savefig(self, path: str | Path, **options: Any) -> Path:
        """Write the whole figure as :func:`write` does."""
        return write(self, path, **options)  # pyright: ignore[reportArgumentType]

    def _repr_png_(self) -> bytes | None:
        drawn: Any = self
        if isinstance(drawn, np.ndarray) and not drawn.size:
            return None
        stream = io.BytesIO()
        with styled():
            figure_of(drawn).savefig(stream, format="png", dpi=STYLE.screen_dpi)
        return stream.getvalue()


class AxesGrid(_Shown, np.ndarray):
    """Axes of one figure as an array: ``axes[0, 1]``, ``axes.shape``, ``axes.savefig(path)``.

    The last line of a Jupyter cell shows the figure.
    """

    @property
    def figure(self) -> Figure:
        """The figure of all of them."""
        return figure_of(self)


class ShownAxes(_Shown, Axes):
    """Axes made here: ``axes.savefig(path)`` writes their figure, Jupyter shows it."""


class ShownAxes3D(_Shown, Axes3D):
    """The same in three dimensions."""


@dataclass(frozen=True, eq=False)
class Page:
    """Where a figure function draws.

    Attributes
    ----------
    axes : AxesGrid
        One axes a panel.
    is_new : bool
        Whether the page was made here; only then it gets a title and a legend outside the axes.
    """

    axes: AxesGrid
    is_new: bool

    def legend(self, handles: Sequence[Any], columns: int, warnings: Iterable[str] = ()) -> None:
        """Draw one legend: below the page, or in the first axes where the caller gave them.

        Parameters
        ----------
        handles : sequence of artists with labels
        columns : int
            At most so many.
        warnings : iterable of str
            What went wrong, in red above the entries, broken where the page ends.
        """
        figure, width = self.axes.figure, 40
        target: Any = figure if self.is_new else self.axes.flat[0]
        place: dict[str, Any] = {"loc": "best", "fontsize": STYLE.small}
        if self.is_new:
            width = int(13.0 * figure.get_figwidth())
            widest = max((len(str(handle.get_label())) for handle in handles), default=1)
            fit = max(1, int(13.0 * figure.get_figwidth() // (widest + 10)))
            place = {"loc": "outside lower center", "ncols": min(columns, fit)}
        warning = "\n".join(line for text in warnings for line in textwrap.wrap(text, width))
        if not handles and not warning:
            return
        legend = target.legend(
            handles=list(handles), title=warning, frameon=not self.is_new, handlelength=3.6, **place
        )
        legend.get_title().set_color(STYLE.warning)


def new_page(size: tuple[float, float], title: str = "") -> Figure:
    """Return an empty figure of a size in inches; call it within :func:`styled`."""
    figure = Figure(figsize=size, layout=ConstrainedLayoutEngine(w_pad=0.07, h_pad=0.05))
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title, fontsize=13, fontweight="bold")
    return figure


def axes_page(
    axes: GivenAxes | None,
    rows: int,
    columns: int,
    *,
    size: tuple[float, float],
    title: str = "",
    transposed: bool = False,
    **subplots: Any,
) -> Page:
    """Return the given axes, checked, or those of a new figure.

    Parameters
    ----------
    axes : Axes, array or nested sequence of Axes, optional
        [rows, columns], or [rows * columns] in that order.
    rows, columns : int
    size : (width, height)
        Of a new figure, inches.
    title : str
        Of a new figure.
    transposed : bool
        Whether a new figure has a column for each row; the axes returned stay [rows, columns].
    **subplots
        For ``Figure.subplots``.

    Raises
    ------
    InputError
        Axes of another shape, or no axes at all.
    """
    if axes is not None:
        return Page(_checked(axes, rows, columns), is_new=False)
    figure = new_page(size, title)
    shape = (columns, rows) if transposed else (rows, columns)
    given = {"axes_class": ShownAxes, **subplots.pop("subplot_kw", {})}
    grid = figure.subplots(*shape, squeeze=False, subplot_kw=given, **subplots)
    return Page((grid.T if transposed else grid).view(AxesGrid), is_new=True)


def _checked(axes: Any, rows: int, columns: int) -> AxesGrid:
    given = _entries(axes)
    strange = [shown(entry) for entry in given if not isinstance(entry, Axes)]
    if strange or given.size != rows * columns:
        wanted = f"{rows} x {columns}" if rows * columns > 1 else "one"
        instead = strange[0] if strange else given.size
        raise InputError(f"axes must be {wanted} matplotlib axes, not {instead}")
    return given.reshape(rows, columns).view(AxesGrid)


def _entries(drawn: Any) -> np.ndarray:
    """Return what an array or a sequence of sequences holds; all else is one entry."""
    return np.array(drawn, dtype=object).ravel()


def figure_of(drawn: Drawn) -> Figure:
    """Return the whole figure that axes, an array of axes or a figure belong to."""
    first = next(iter(_entries(drawn)), None)
    if isinstance(first, Figure):
        return first
    if not isinstance(first, Axes):
        raise InputError(f"a figure or its axes are needed, not {shown(first)}")
    return first.figure.figure  # type: ignore[return-value]  # of a subfigure the whole one


def save(
    drawn: Drawn | Mapping[str, Drawn], folder: str | Path, name: str = "figure"
) -> list[Path]:
    """Write figures into a folder, each as PNG (150 dots an inch) and as PDF.

    One figure is ``FOLDER/NAME.png`` and ``FOLDER/NAME.pdf``, by default ``figure.png`` and
    ``figure.pdf``; of a mapping each figure has its key as NAME. Files of these names are replaced.

    Parameters
    ----------
    drawn : Figure, Axes, array of Axes, or a mapping from a name to such
    folder : str or Path
        Made where it is not there.
    name : str
        Of the files of a single figure.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        Nothing to draw; a folder with the ending of a picture.
    """
    target = Path(folder)
    if target.suffix in FORMATS:
        raise InputError(
            f"folder must be a folder, not {target.name!r}: axes.savefig({target.name!r}) writes "
            "one file"
        )
    given = drawn if isinstance(drawn, Mapping) else {name: drawn}
    figures = {key: figure_of(each) for key, each in given.items()}
    made_folder(target)
    return [
        write(figure, target / f"{key}{ending}")
        for key, figure in figures.items()
        for ending in (".png", ".pdf")
    ]


def write(drawn: Drawn, path: str | Path, theme: str = "light", **options: Any) -> Path:
    """Write one figure; the ending of the path says how (``.png``, ``.pdf``, ``.svg``).

    Parameters
    ----------
    drawn : Figure, Axes or array of Axes
    path : str or Path
    theme : str
        "light" as it was drawn, or "dark": greys, black and white change places, for a dark page.
    **options
        For ``Figure.savefig``, such as ``dpi``; default 150 dots an inch.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        Nothing to draw; another ending or theme.
    """
    target = Path(path)
    checks.one_of("theme", theme, ("light", "dark"))
    figure, stream = figure_of(drawn), io.BytesIO()
    format = options.pop("format", target.suffix[1:].lower() or "png")
    formats = figure.canvas.get_supported_filetypes()
    if format not in formats:
        raise InputError(f"path must end in one of {', '.join(formats)}, not {target.suffix!r}")
    undated = {"CreationDate": None} if format == "pdf" else None  # same figure, same file
    settings = {"dpi": STYLE.dpi, "metadata": undated, **options}
    with styled(), darkened(figure) if theme == "dark" else nullcontext():
        figure.savefig(stream, format=format, **settings)
    return write_whole(target, stream.getvalue())


@contextmanager
def darkened(figure: Figure) -> Iterator[None]:
    """Show the figure with light greys for dark ones and the other way round; colours stay.

    The colours of the palette are told apart on both. What was changed is put back at the end.
    """
    undo = []
    for artist in dict.fromkeys(figure.findobj()):  # some are found twice
        for name in next((parts for k, parts in COLORED.items() if isinstance(artist, k)), ()):
            old = getattr(artist, f"get_{name}")()
            if not isinstance(old, str) or old not in ("auto", "none", "face"):
                undo.append((artist, name, old))
                many = not isinstance(old, str) and np.ndim(old) == 2
                getattr(artist, f"set_{name}")(_turned(old) if many else _turned([old])[0])
        if effects := artist.get_path_effects():
            undo.append((artist, "path_effects", effects))
            artist.set_path_effects(halo("0.075"))
    try:
        yield
    finally:
        for artist, name, old in undo:
            getattr(artist, f"set_{name}")(old)


def _turned(colors: Any) -> np.ndarray:
    """Return colours [N,4] with the lightness of greys turned round: from 1 and 0 to near both."""
    rgba = to_rgba_array([to_rgba(color) for color in colors])
    grey = np.ptp(rgba[:, :3], axis=1) < 0.03
    rgba[grey, :3] = 0.92 + (0.075 - 0.92) * rgba[grey, :3].mean(axis=1, keepdims=True)
    return rgba
