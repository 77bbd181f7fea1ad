"""How results show themselves without importing a view.

``motion.plot(robot)`` asks :func:`view_for` for the function that draws a motion and calls it. The
views register theirs by the public name of the class, as "module:function" that is imported when
it is first asked for; a user registers another one with :func:`register_view`.
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
    """What figures return: the axes of one figure as an array."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Rows and columns."""
        ...

    @property
    def flat(self) -> Any:
        """Every axes in turn."""
        ...

    @property
    def figure(self) -> Figure:
        """The figure of all of them."""
        ...

    def savefig(self, path: str | Path, **options: Any) -> Path:
        """Write the figure; the ending of the path is the format."""
        ...

    def __getitem__(self, index: Any) -> Any: ...

    def __len__(self) -> int: ...

    def __iter__(self) -> Iterator[Any]: ...


def add_views(table: Mapping[str, Mapping[str, View | str]]) -> None:
    """Register views by the public name of a class and their kind."""
    for name, views in table.items():
        _views.setdefault(name, {}).update(views)


def register_view(cls: type, kind: str, view: View | str) -> None:
    """Have objects of a class shown by a view of your own.

    Parameters
    ----------
    cls : type
        A class of this package, or one derived from it.
    kind : str
        Which of its views to replace: "table" for what Jupyter shows and ``.table()`` returns,
        "plot" for ``.plot()``, "rerun" for ``.to_rerun()``, and so on.
    view : callable or "module:function"
        Called with the arguments of the view that it replaces; a string is imported when it is
        first needed.

    Raises
    ------
    InputError
        A kind of view that the class does not have; no function.

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
    """Return the function registered for this kind of view of an object, its own class first."""
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
    """Return the name in the innermost public package: ``microbot_ocp.motion.Motion``."""
    return f"{cls.__module__.partition('._')[0]}.{cls.__qualname__}"
