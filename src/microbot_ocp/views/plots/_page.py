"""Pages of axes (new or given by the caller) with one style, and their files.

pyplot is never imported, so that no global state keeps a figure alive.
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
from cycler import cycler
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection
from matplotlib.colors import to_rgba, to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from mpl_toolkits.mplot3d import Axes3D

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.showing import DrawnAxes, GivenAxes
from microbot_ocp._base.writing import made_folder, write_whole
from microbot_ocp.views._style import JOINT_LOOKS, SMALL_FONT, WARNING_COLOR

LETTERS = 13  # letters of a legend in an inch
SCREEN_DPI = 90  # resolution of notebooks and live plots, dots per inch
FORMATS = (".png", ".pdf", ".svg", ".jpg", ".jpeg")
COLORED = {
    Text: ("color",),
    Line2D: ("color", "markeredgecolor", "markerfacecolor"),
    Patch: ("facecolor", "edgecolor"),
    Collection: ("facecolor", "edgecolor"),
}
Drawn = Figure | Axes | np.ndarray | DrawnAxes


def halo(color: str = "white") -> list[Any]:
    """Return path effects that keep text legible on curves."""
    return [withStroke(linewidth=2, foreground=color)]


def styled(changes: Mapping[str, Any] | str | None = None) -> Any:
    """Return a context (or decorator) with the style of this package instead of the user's.

    ``changes`` are further matplotlib settings, or the name of a style of matplotlib.
    """
    palette = {"axes.prop_cycle": cycler(color=[color for color, _ in JOINT_LOOKS])}
    layers: list[Any] = ["default", f"{__package__}.figures", palette, changes or {}]
    return style.context(layers)


class _FigureOutput:
    """Mixin of axes that write their figure to a file and show it in Jupyter."""

    def savefig(self, path: str | Path, **options: Any) -> Path:
        """Write the whole figure by :func:`write`."""
        return write(self, path, **options)  # pyright: ignore[reportArgumentType]

    def _repr_png_(self) -> bytes | None:
        drawn: Any = self
        if isinstance(drawn, np.ndarray) and not drawn.size:
            return None
        stream = io.BytesIO()
        with styled():
            figure_of(drawn).savefig(stream, format="png", dpi=SCREEN_DPI)
        return stream.getvalue()


class AxesGrid(_FigureOutput, np.ndarray):
    """Axes of one figure as an array: ``axes[0, 1]``, ``axes.shape``, ``axes.savefig(path)``.

    The last line of a Jupyter cell shows the figure.
    """

    @property
    def figure(self) -> Figure:
        """Figure of the axes."""
        return figure_of(self)


class ShownAxes(_FigureOutput, Axes):
    """New axes: ``axes.savefig(path)`` writes their figure, Jupyter shows it."""


class ShownAxes3D(_FigureOutput, Axes3D):
    """Three-dimensional :class:`ShownAxes`."""


@dataclass(frozen=True, eq=False)
class Page:
    """Page that a figure function draws on.

    Attributes
    ----------
    axes : AxesGrid
        One axes per panel.
    is_new : bool
        False for axes of the caller, which get no title and no legend outside of the axes.
    """

    axes: AxesGrid
    is_new: bool

    def legend(self, handles: Sequence[Any], columns: int, warnings: Iterable[str] = ()) -> None:
        """Draw one legend: below a new page, or in the first axes of the caller.

        Parameters
        ----------
        handles : sequence of artists with labels
        columns : int
            Largest number of columns.
        warnings : iterable of str
            Failures, in red above the entries, wrapped to the page.
        """
        figure, width = self.axes.figure, 40
        target: Any = figure if self.is_new else self.axes.flat[0]
        place: dict[str, Any] = {"loc": "best", "fontsize": SMALL_FONT}
        if self.is_new:
            width = int(LETTERS * figure.get_figwidth())
            widest = max((len(str(handle.get_label())) for handle in handles), default=1)
            fit = max(1, width // (widest + 10))
            place = {"loc": "outside lower center", "ncols": min(columns, fit)}
        warning = "\n".join(line for text in warnings for line in textwrap.wrap(text, width))
        if not handles and not warning:
            return
        legend = target.legend(
            handles=list(handles), title=warning, frameon=not self.is_new, handlelength=3.6, **place
        )
        legend.get_title().set_color(WARNING_COLOR)


def new_page(size: tuple[float, float], title: str = "") -> Figure:
    """Return an empty figure of a size in inches; the caller needs the context :func:`styled`."""
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title)
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
    """Return a page with the given axes after a check, or with new axes.

    Parameters
    ----------
    axes : Axes, array or nested sequence of Axes, optional
        Axes [rows, columns], or [rows * columns] row by row.
    rows, columns : int
    size : (width, height)
        Size of a new figure, inches.
    title : str
        Title of a new figure.
    transposed : bool
        True to lay out a new figure with rows and columns exchanged; the returned axes stay
        [rows, columns].
    **subplots
        Arguments of ``Figure.subplots``.

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
    others = [shown(entry) for entry in given if not isinstance(entry, Axes)]
    if others or given.size != rows * columns:
        wanted = f"{rows} x {columns}" if rows * columns > 1 else "one"
        instead = others[0] if others else given.size
        raise InputError(f"axes must be {wanted} matplotlib axes, not {instead}")
    return given.reshape(rows, columns).view(AxesGrid)


def _entries(drawn: Any) -> np.ndarray:
    """Return the entries of an array or nested sequence; any other object is one entry."""
    return np.array(drawn, dtype=object).ravel()


def figure_of(drawn: Drawn) -> Figure:
    """Return the whole figure of axes, of an array of axes, or of a figure."""
    first = next(iter(_entries(drawn)), None)
    if isinstance(first, Figure):
        return first
    if not isinstance(first, Axes):
        raise InputError(f"a figure or its axes are needed, not {shown(first)}")
    return first.figure.figure  # type: ignore[return-value]  # a subfigure has a parent figure


def save(
    drawn: Drawn | Mapping[str, Drawn], folder: str | Path, name: str = "figure"
) -> list[Path]:
    """Write figures into a folder, each as PNG (150 dots per inch) and as PDF.

    One figure is ``FOLDER/NAME.png`` and ``FOLDER/NAME.pdf``, by default ``figure.png`` and
    ``figure.pdf``; a figure of a mapping has its key as NAME. Existing files are replaced.

    Parameters
    ----------
    drawn : Figure, Axes, array of Axes, or a mapping from a name to one of them
    folder : str or Path
        Folder, created if it does not exist.
    name : str
        Name of the files of a single figure, without ending.

    Returns
    -------
    list of Path
        Written files.

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
    """Write one figure; the ending of the path is the format (``.png``, ``.pdf``, ``.svg``).

    Parameters
    ----------
    drawn : Figure, Axes or array of Axes
    path : str or Path
    theme : str
        "light" for the drawn colours, or "dark" for inverted greys on a dark page.
    **options
        Arguments of ``Figure.savefig``, such as ``dpi``; default 150 dots per inch.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        Nothing to draw; an unknown ending or theme.
    """
    target = Path(path)
    checks.one_of("theme", theme, ("light", "dark"))
    figure, stream = figure_of(drawn), io.BytesIO()
    format = options.pop("format", target.suffix[1:].lower() or "png")
    formats = figure.canvas.get_supported_filetypes()
    if format not in formats:
        raise InputError(f"path must end in one of {', '.join(formats)}, not {target.suffix!r}")
    undated = {"CreationDate": None} if format == "pdf" else None  # files are reproducible
    settings = {"metadata": undated, **options}
    with styled(), darkened(figure) if theme == "dark" else nullcontext():
        figure.savefig(stream, format=format, **settings)
    return write_whole(target, stream.getvalue())


@contextmanager
def darkened(figure: Figure) -> Iterator[None]:
    """Invert the greys of a figure inside the context; colours stay.

    The colours of the palette are distinct on light and dark pages. All changes are undone at the
    end of the context.
    """
    undo = []
    for artist in dict.fromkeys(figure.findobj()):  # findobj repeats some artists
        for name in next((parts for k, parts in COLORED.items() if isinstance(artist, k)), ()):
            old = getattr(artist, f"get_{name}")()
            if not isinstance(old, str) or old not in ("auto", "none", "face"):
                undo.append((artist, name, old))
                many = not isinstance(old, str) and np.ndim(old) == 2
                getattr(artist, f"set_{name}")(
                    _inverted_greys(old) if many else _inverted_greys([old])[0]
                )
        if effects := artist.get_path_effects():
            undo.append((artist, "path_effects", effects))
            artist.set_path_effects(halo("0.075"))
    try:
        yield
    finally:
        for artist, name, old in undo:
            getattr(artist, f"set_{name}")(old)


def _inverted_greys(colors: Any) -> np.ndarray:
    """Return colours [N,4] with inverted greys: white to near black, black to near white."""
    rgba = to_rgba_array([to_rgba(color) for color in colors])
    grey = np.ptp(rgba[:, :3], axis=1) == 0.0
    lightness = rgba[grey, :3].mean(axis=1, keepdims=True)
    rgba[grey, :3] = np.interp(lightness, (0.0, 1.0), (0.92, 0.075))
    return rgba
