"""Public faces (``__init__.py`` with its stub), and argument checks of all that they name.

Importing :mod:`border` adds a finder to Python's import system, as the import hooks of beartype and
typeguard do. When a module of this package has run, its functions and classes that a face names
check their arguments from then on, for every caller. The names stand in the stubs alone.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from enum import Enum
from importlib.machinery import PathFinder
from types import FunctionType, ModuleType
from typing import Any

import lazy_loader

from microbot_ocp._base import interrupts

PACKAGE = __name__.partition(".")[0]
_faces: dict[str, frozenset[str]] = {}  # names of each face


def attach_stub(name: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list], list]:
    """Return lazy_loader's functions for a stub, whose errors name the nearest public name."""
    load, directory, names = lazy_loader.attach_stub(name, file)
    _faces[name] = frozenset(names)

    def public(wanted: str) -> Any:
        try:
            value = sys.modules[name].__dict__[wanted] = load(wanted)
        except AttributeError:
            if wanted.startswith("_") or wanted in names:
                raise
            from microbot_ocp._base.checks import similar
            from microbot_ocp._base.foreign_words import WORDS, WORDS_OF_ARMS, remedy

            words = WORDS | WORDS_OF_ARMS if ".ocp" not in name else WORDS_OF_ARMS | WORDS
            hint = remedy(wanted, words) or similar(wanted, names)
            raise AttributeError(f"{name} has no {wanted!r}{hint}") from None
        return value

    return public, directory, names


class _Finder:
    """A finder for the modules of this package, which are checked when they have run."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> Any:
        spec = PathFinder.find_spec(name, path, target) if name.startswith(f"{PACKAGE}.") else None
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def checked(module: ModuleType) -> None:
                execute(module)
                _check_public(module)

            spec.loader.exec_module = checked
        return spec


sys.meta_path.insert(0, _Finder)


def _check_public(module: ModuleType) -> None:
    """Add checks to the functions and classes of a module that a face names."""
    home = module.__name__
    for face in sorted(filter(lambda face: home.startswith(f"{face}."), _faces), reverse=True):
        for name in _faces[face] & vars(module).keys():
            thing = vars(module)[name]
            if getattr(thing, "__module__", None) != home:
                continue
            if isinstance(thing, type):
                _check_methods(thing)
            elif isinstance(_inner(thing), FunctionType):
                function = checking(thing, notes=isinstance(thing, FunctionType))
                function.__module__ = face  # pickle looks the function up there
                setattr(module, name, function)


def _check_methods(kind: type) -> None:
    if issubclass(kind, tuple | dict | Enum | BaseException) or getattr(kind, "_is_protocol", 0):
        return
    settings = getattr(kind, "__dataclass_params__", None)
    ours = [base for base in reversed(kind.__mro__) if base.__module__.startswith(PACKAGE)]
    for name, member in {k: v for base in ours for k, v in vars(base).items()}.items():
        function = getattr(member, "__func__", member)
        given = isinstance(function, FunctionType) and not hasattr(function, "_is_checked")
        data = settings if name == "__init__" else None
        if not given or (name.startswith("_") and name not in ("__init__", "__call__")):
            continue
        if data is None or (data.frozen and not hasattr(kind, "_is_answer")):
            outer = checking(function, data=data is not None)
            setattr(kind, name, outer if member is function else type(member)(outer))


def _inner(function: Any) -> Any:
    return getattr(function, "__wrapped__", function)  # inspect.unwrap takes 5 ms to import


def _refuse(*call: Any) -> None:
    from microbot_ocp._base.argument_types import refuse  # imports numpy

    refuse(*call)


def checking(function: Any, data: bool = False, notes: bool = False) -> Any:
    """Return a wrapper that checks argument types after an error, or after a dataclass is made."""
    inner = _inner(function)
    call, failed = functools.partial(interrupts.obeyed, notes=notes), Exception
    refuse = _refuse

    # The globals and the name of this code are replaced below, so it reads no global name.
    def run(*arguments, **named):  # type: ignore[no-untyped-def]
        try:
            answer = call(function, arguments, named)
        except failed as problem:
            refuse(inner, arguments, named, problem)
            raise
        if data:
            refuse(inner, arguments, named)
        return answer

    # Doctest assigns a function to the module of its globals; tracebacks name its code.
    code = run.__code__.replace(co_name=inner.__name__, co_qualname=inner.__qualname__)
    outer = FunctionType(code, inner.__globals__, inner.__name__, None, run.__closure__)
    functools.update_wrapper(outer, inner)
    for name in {"cache_clear", "cache_info"} & set(dir(function)):
        setattr(outer, name, getattr(function, name))
    outer._is_checked = True  # pyright: ignore[reportFunctionMemberAccess]
    return outer
