"""Checks of the types of arguments, made of annotations; :mod:`.border` applies them.

Functions, and the methods of classes, refuse an argument of the wrong type by a sentence that names
it. Values (shapes, ranges, what is finite) are checked inside, by ``checks``. Missing and unknown
arguments stay Python's own ``TypeError``.
"""

from __future__ import annotations

import builtins
import collections.abc as abc
import functools
import inspect
import itertools
import os
import sys
import types
import typing
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base.checks import InputError, shown

PACKAGE = __name__.partition(".")[0]
MOST_ENTRIES = 1000  # of a sequence that are looked at
SPECIAL = ("__init__", "__call__")  # what is public of a class besides names without underscore
_classes: set[type] = set()


def checked(thing: Any) -> Any:
    """A function or class of this package that checks its arguments; all else as it is.

    A class is changed in place, and a function replaced in its module, so that both stay what
    their names say, for pickle and others.
    """
    if not str(getattr(thing, "__module__", "")).startswith(PACKAGE):
        return thing
    if inspect.isclass(thing):
        for kind in thing.__mro__:
            if kind.__module__.startswith(PACKAGE) and kind not in _classes:
                _classes.add(kind)
                _check_methods(kind)
        return thing
    cached = isinstance(thing, functools._lru_cache_wrapper)
    if not (inspect.isfunction(thing) or cached) or hasattr(thing, "_checks"):
        return thing
    home = sys.modules[thing.__module__]
    made = _checking(thing)
    if getattr(home, thing.__name__, None) is thing:
        setattr(home, thing.__name__, made)
    return made


def _check_methods(kind: type) -> None:
    if issubclass(kind, tuple | dict | Enum | BaseException) or getattr(kind, "_is_protocol", 0):
        return
    settings = getattr(kind, "__dataclass_params__", None)
    for name, member in list(vars(kind).items()):
        if name.startswith("_") and name not in SPECIAL:
            continue
        if isinstance(member, classmethod | staticmethod):
            if inspect.isfunction(member.__func__):
                setattr(kind, name, type(member)(_checking(member.__func__)))
        elif inspect.isfunction(member):
            data = name == "__init__" and settings is not None
            if settings is None or not data or settings.frozen:
                setattr(kind, name, _checking(member, data))


def _checking(function: Any, data: bool = False) -> Any:
    """A function that checks what it is given and calls the one given here.

    Objects of this package and functions are looked at before. Everything is where that fails by
    another error than ours: what its own checks say of a value says more than an annotation. What
    makes ``data`` has no effect, so there everything is looked at in the end.
    """
    inner = function.__wrapped__ if hasattr(function, "cache_clear") else function
    arguments_of, ours, foreign = _Arguments(inner), InputError, Exception

    def run(*arguments, **named):  # type: ignore[no-untyped-def]  # uses no global name: see below
        if not data:
            arguments_of.check(arguments, named, True)
        try:
            made = function(*arguments, **named)
        except ours:
            raise
        except foreign as problem:
            arguments_of.check(arguments, named, False, problem)
            raise
        if data:
            arguments_of.check(arguments, named, False)
        return made

    # doctest finds a function by the module that its globals are of
    own = types.FunctionType(run.__code__, inner.__globals__, inner.__name__, None, run.__closure__)
    functools.update_wrapper(own, inner)
    for name in ("cache_clear", "cache_info"):
        if hasattr(function, name):
            setattr(own, name, getattr(function, name))
    own._checks = arguments_of  # type: ignore[attr-defined]
    return own


class _Arguments:
    """Checks of the arguments of a function, made of its annotations when it is first called."""

    def __init__(self, function: Any) -> None:
        self.function = function
        self.known: dict[str, Check] | None = None
        self.first: dict[str, Check] = {}  # those that are looked at before
        self.places: list[str] = []

    def _read(self) -> dict[str, Check]:
        found: dict[str, Check] = {}
        variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        for name, parameter in inspect.signature(self.function).parameters.items():
            check = None
            if parameter.annotation in ARRAYS:
                check = ARRAYS[parameter.annotation]
            elif parameter.annotation is not inspect.Parameter.empty:
                check = check_of(_resolved(parameter.annotation, self.function))
            if check is not None and parameter.kind not in variable:
                found[name] = check
            if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD):
                self.places.append(name)
        self.first = {name: check for name, check in found.items() if check.first}
        self.known = found
        return found

    def check(
        self,
        arguments: tuple[Any, ...],
        named: dict[str, Any],
        first: bool,
        problem: Exception | None = None,
    ) -> None:
        """Refuse the first argument of a wrong type."""
        known = self._read() if self.known is None else self.known
        checks = self.first if first else known
        if not checks:
            return
        for name, value in itertools.chain(
            zip(self.places, arguments, strict=False), named.items()
        ):
            check = checks.get(name)
            if check is not None and not check.passes(value):
                raise InputError(f"{name} must be {check.said}, not {shown(value)}") from problem


def _resolved(annotation: Any, function: Any) -> Any:
    """What an annotation stands for."""
    if not isinstance(annotation, str):
        return annotation
    try:
        return eval(annotation, function.__globals__)
    except Exception:  # a name that only type checkers know, alone or in a union
        pass
    try:
        return eval(annotation, function.__globals__, _Unloaded(function.__globals__))
    except Exception:  # what only type checkers read
        return Any


class _Named:
    """Stands for a class that is not imported yet."""


class _Unloaded(dict):
    """Names that only type checkers import: our public classes by name, all else anything."""

    def __init__(self, known: dict[str, Any]) -> None:
        super().__init__()
        self.known = known

    def __missing__(self, name: str) -> Any:
        if name in self.known or hasattr(builtins, name):
            raise KeyError(name)
        ours = name[0].isupper() and name in dir(sys.modules[PACKAGE])
        return type(name, (_Named,), {}) if ours else Any


class Check(NamedTuple):
    """Whether a value is of a type, what to call that, and whether it is looked at before."""

    passes: Callable[[Any], bool]
    said: str
    first: bool = False


NUMBERS = (int, float, np.integer, np.floating)
SEQUENCES = (abc.Sequence, abc.Iterable, abc.Collection, list, tuple)
SCALARS = ("a number", "a whole number", "True or False", "text")
NONE = Check(lambda value: value is None, "None", True)


def _number(value: Any) -> bool:
    """Whether numpy or Python may make a float of it: what ``checks.number`` looks at."""
    if isinstance(value, NUMBERS):
        return not isinstance(value, bool)
    other = complex | np.generic | type | str | bytes  # of which float may make one, too
    if isinstance(value, other) or not hasattr(value, "__float__"):
        return False
    try:
        return float(value) is not None
    except Exception:  # of an array, or of a symbol
        return False


def _whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _array(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "iuf" or np.asarray(value, float).dtype.kind == "f"
    except Exception:  # anyone's code
        return False


ARRAY = Check(_array, "an array of numbers")
ARRAYS = {  # as annotations are written: what ArrayLike stands for has text among its parts
    "ArrayLike": ARRAY,
    "ArrayLike | None": Check(lambda v: v is None or _array(v), "an array of numbers or None"),
}


def check_of(hint: Any) -> Check | None:
    """The check of an annotation; None where it takes anything."""
    if isinstance(hint, str):  # inside of another one
        return None
    if hint is None or hint is type(None):
        return NONE
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _either([check_of(part) for part in inner])
    if origin is typing.Literal:
        said = "one of " + ", ".join(map(str, inner))
        return Check(lambda value: isinstance(value, str | int) and value in inner, said)
    if origin is typing.Annotated:
        return check_of(inner[0])
    if hint is Callable or hint is abc.Callable or origin is abc.Callable:
        return Check(callable, "a function", True)
    if origin in SEQUENCES or hint in SEQUENCES:
        return _sequence(origin or hint, inner)
    if origin in (abc.Mapping, dict) or hint in (abc.Mapping, dict):
        return _mapping(inner)
    if origin is np.ndarray or "_NestedSequence" in str(hint):
        return ARRAY
    return _class(hint) if inspect.isclass(hint) and origin is None else None


def _either(parts: list[Check | None]) -> Check | None:
    if ARRAY in parts:  # numpy's ArrayLike has many parts, text among them
        others = [part for part in parts if part is not None and part.said not in SCALARS]
        kept = list(dict.fromkeys(others))
        said = " or ".join(dict.fromkeys(part.said for part in kept))
        return Check(
            lambda value: isinstance(value, str) or any(part.passes(value) for part in kept), said
        )
    known = [part for part in parts if part is not None]
    if len(known) < len(parts):
        return None
    said = " or ".join(dict.fromkeys(part.said for part in known))
    first = all(part.first for part in known)
    return Check(lambda value: any(part.passes(value) for part in known), said, first)


def _class(hint: type) -> Check | None:
    if hint is float:
        return Check(_number, "a number")
    if hint is int:
        return Check(_whole, "a whole number")
    if hint is bool:
        return Check(lambda value: isinstance(value, bool | np.bool_), "True or False")
    if hint is str:
        return Check(lambda value: isinstance(value, str), "text")
    if hint is Path:
        return Check(lambda value: isinstance(value, os.PathLike), "a path")
    if hint is np.ndarray:
        return ARRAY
    article = "an" if hint.__name__[0] in "AEIO" else "a"
    if issubclass(hint, _Named):
        name = hint.__name__
        kinds = Check(lambda value: name in (k.__name__ for k in type(value).__mro__), "")
        return kinds._replace(said=f"{article} {name}", first=True)
    if hint.__module__.startswith("casadi"):
        return Check(lambda value: _can_be(hint, value), f"{article} CasADi {hint.__name__}")
    if not hint.__module__.startswith(PACKAGE):
        return None
    if getattr(hint, "_is_protocol", False):
        wanted = [name for kind in hint.__mro__[:-1] for name in _members(kind)]
        return Check(
            lambda value: all(hasattr(value, name) for name in wanted), f"{article} {hint.__name__}"
        )
    if issubclass(hint, Enum):  # the value of a member does as well
        values = [member.value for member in hint]
        return Check(
            lambda value: isinstance(value, hint) or (isinstance(value, str) and value in values),
            f"{article} {hint.__name__}",
        )
    named = issubclass(hint, tuple)  # a plain one often does as well
    return Check(lambda value: isinstance(value, hint), f"{article} {hint.__name__}", not named)


def _members(kind: type) -> list[str]:
    """Public names of a protocol."""
    names = {**getattr(kind, "__annotations__", {}), **vars(kind)}
    return [name for name in names if not name.startswith("_")]


def _can_be(kind: type, value: Any) -> bool:
    if isinstance(value, kind):
        return True
    try:
        return kind.__name__ in ("SX", "MX", "DM") and kind(value) is not None
    except Exception:  # CasADi has many
        return False


def _sequence(kind: Any, inner: tuple[Any, ...]) -> Check:
    entries = inner[0] if inner and (len(inner) == 1 or inner[1] is Ellipsis) else None
    check = None if entries is None else check_of(entries)

    def passes(value: Any) -> bool:
        if isinstance(value, str | bytes | abc.Mapping | type):
            return False
        if not isinstance(value, abc.Iterable) or getattr(value, "ndim", 1) == 0:
            return False
        if isinstance(value, abc.Iterator):  # what is looked at would be gone
            return kind is abc.Iterable
        if kind is tuple and entries is None and inner:
            return isinstance(value, tuple | list) and len(value) == len(inner)
        return check is None or all(map(check.passes, itertools.islice(value, MOST_ENTRIES)))

    return Check(passes, "a list" if check is None else f"a list, each entry {check.said}")


def _mapping(inner: tuple[Any, ...]) -> Check:
    checks = [check_of(part) for part in inner] or [None, None]
    key, entry = checks[0], checks[-1]

    def passes(value: Any) -> bool:
        return isinstance(value, abc.Mapping) and all(
            (key is None or key.passes(k)) and (entry is None or entry.passes(v))
            for k, v in value.items()
        )

    said = "a mapping" if entry is None else f"a mapping, each entry {entry.said}"
    return Check(passes, said)
