"""Registry of the functions that show results, so that results need not import the views.

``motion.plot(robot)`` calls the function that :func:`view_for` returns for a motion. The views
register theirs by the public name of the class, as a string "module:function" whose module is
imported at the first call; a user registers another view with :func:`register_view`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GivenAxes: TypeAlias = "Axes | np.ndarray | DrawnAxes | Sequence[Any]"
View = Callable[..., Any]
_views: dict[str, dict[str, View | str]] = {}  # public name of a class -> kind -> function


class DrawnAxes(Protocol):
    """Axes of one figure as an array, which figures return."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Numbers of rows and columns."""
        ...

    @property
    def flat(self) -> Any:
        """Iterator over all axes, row by row."""
        ...

    @property
    def figure(self) -> Figure:
        """Figure of all axes."""
        ...

    def savefig(self, path: str | Path, **options: Any) -> Path:
        """Write the figure in the format of the path's suffix."""
        ...

    def __getitem__(self, index: Any) -> Any: ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Any]: ...


def add_views(table: Mapping[str, Mapping[str, View | str]]) -> None:
    """Register views by the public name of a class and their kind."""
    for name, views in table.items():
        _views.setdefault(name, {}).update(views)


def register_view(cls: type, kind: str, view: View | str) -> None:
    """Show objects of a class by a view of your own.

    Parameters
    ----------
    cls : type
        A class of this package, or one derived from it.
    kind : str
        Name of the view to replace: "table" for Jupyter and ``.table()``, "plot" for ``.plot()``,
        "rerun" for ``.to_rerun()``, and so on.
    view : callable or "module:function"
        Function with the arguments of the view that it replaces; the module of a string is
        imported at the first call.

    Raises
    ------
    InputError
        The class has no view of this kind, or ``view`` is no function.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> class Recorded(mo.Motion):
    ...     pass
    >>> mo.register_view(Recorded, "plot", lambda robot, motion, axes: f"{motion.duration} s")
    >>> Recorded([0.0, 2.0], *[[[0.0], [1.0]]] * 4).plot(mo.load_robot("planar_2r"))
    '2.0 s'
    """
    from microbot_ocp._base import checks  # loads numpy, which importing the package must not do

    kinds = sorted({kind for each in _ancestors(cls) for kind in _views.get(each, ())})
    if not kinds:
        raise checks.InputError(f"cls must be a class that has views, not {cls.__qualname__}")
    checks.one_of("kind", kind, kinds)
    if not callable(view) and ":" not in view:
        raise checks.InputError(f"view must be a function or 'module:function', not {view!r}")
    add_views({_public_name(cls): {kind: view}})


def view_for(result: object, kind: str) -> View:
    """Return the function that shows an object by this kind of view; a subclass's view wins."""
    for name in _ancestors(type(result)):
        view = _views.get(name, {}).get(kind)
        if isinstance(view, str):
            module, _, function = view.partition(":")
            view = getattr(import_module(module), function)
            _views[name][kind] = view
        if view is not None:
            return view
    raise LookupError(f"no view {kind!r} is registered for {type(result).__qualname__}")


def _ancestors(cls: type) -> list[str]:
    return [_public_name(each) for each in cls.__mro__]


def _public_name(cls: type) -> str:
    """Return a class's name in its innermost public package: ``microbot_ocp.motion.Motion``."""
    return f"{cls.__module__.partition('._')[0]}.{cls.__qualname__}"
