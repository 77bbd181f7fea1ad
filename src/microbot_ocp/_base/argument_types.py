"""Checks of argument types by annotations, for public functions and classes.

The module ``checks`` tests values (shapes, ranges, finiteness) and says more about a value than an
annotation can. Annotations are therefore read only after a call has failed with a foreign error,
and after the construction of a frozen dataclass, in which a wrong type may have no effect. Results,
which this package creates by the thousand, are not checked. A missing argument stays Python's
``TypeError``; the error for an unknown argument is a ``TypeError``, too.
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
from typing import Any

import numpy as np

from microbot_ocp._base.checks import NAME_FIRST, InputError, did_you_mean, shown
from microbot_ocp._base.foreign_words import our_name, remedy

PACKAGE = __name__.partition(".")[0]
MOST_ENTRIES = 100_000  # longest part of a sequence whose entries are checked
UNIONS = (typing.Union, types.UnionType)
SEQUENCES = (abc.Sequence, abc.Iterable, abc.Collection, list, tuple)
MAPPINGS = (abc.Mapping, dict)
# Hint for the message: the call that converts the given type (second) to the expected one (first).
MAKERS = {
    ("Robot", "str"): "mo.load_robot(name_or_path) makes one",
    ("Scene", "str"): "mo.load_scene(path) makes one",
    ("Motion", "str"): "mo.Motion.load(path) makes one",
    ("Motion", "PiecewisePolynomial"): "mo.Motion.from_polynomial(robot, polynomial) makes one",
    ("PiecewisePolynomial", "list"): "mo.straight_path(via_q) makes one",
    ("PiecewisePolynomial", "ndarray"): "mo.straight_path(via_q) makes one",
    ("text", "MX"): NAME_FIRST,
    ("text", "Symbol"): NAME_FIRST,
}


class UnknownArgument(InputError, TypeError):
    """An argument name that the function does not have."""


def refuse(
    function: Any, given: tuple[Any, ...], named: dict[str, Any], problem: Exception | None = None
) -> None:
    """Raise InputError for the first argument of a wrong type.

    An InputError stays, unless an inner call raised it here because of a foreign error: the outer
    call names its own argument.
    """
    if isinstance(problem, InputError) and problem.__cause__ is None:
        return
    rules, positional = _rules(function)
    if isinstance(problem, TypeError):
        there = inspect.signature(function).parameters
        for name in named.keys() - there.keys():
            if str(problem).endswith(f"unexpected keyword argument {name!r}"):
                hint = our_name(name, there) or remedy(name) or did_you_mean(name, there)
                raise UnknownArgument(f"{problem}{hint}") from None
    for name, value in (*zip(positional, given, strict=False), *named.items()):
        if name in rules and not rules[name][0](value):
            wanted, kind = rules[name][1], type(value).__name__
            makers = (MAKERS.get((word, kind)) for word in wanted.split())
            hint = "".join(f"; {maker}" for maker in makers if maker)
            raise InputError(f"{name} must be {wanted}, not {shown(value)}{hint}") from problem


@functools.cache
def _rules(function: Any) -> tuple[dict[str, tuple[Fits, str]], list[str]]:
    """Return the type test of every annotated parameter, and the positional parameters."""
    names = _Names(function.__globals__, ArrayLike=np.ndarray)
    parameters = inspect.signature(function).parameters.values()
    rules = {
        p.name: _rule(_evaluated(p.annotation, names))
        for p in parameters
        if p.annotation is not p.empty and p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)
    }
    return rules, [p.name for p in parameters if p.kind <= p.POSITIONAL_OR_KEYWORD]


class _Names(dict):
    """Names in annotations; a class that only type checkers import is known by its name alone."""

    def __missing__(self, name: str) -> Any:
        if hasattr(builtins, name):
            raise KeyError(name)
        ours = name[0].isupper() and name in dir(sys.modules[PACKAGE])
        return type(name, (), {"__module__": PACKAGE}) if ours else Any


def _evaluated(annotation: Any, names: _Names) -> Any:
    try:
        return eval(annotation, {}, names) if isinstance(annotation, str) else annotation
    except Exception:  # an annotation that only type checkers can read
        return Any


def _is_number(value: Any) -> bool:
    """Return True if numpy or Python may convert the value to a float for ``checks.number``."""
    if isinstance(value, int | float | np.integer | np.floating):
        return not isinstance(value, bool)
    other = complex | np.generic | type | str | bytes  # float() would accept some of them
    return not isinstance(value, other) and _succeeds(float, value)


def _is_array(value: Any) -> bool:
    return _succeeds(np.asarray, value) and (
        np.asarray(value).dtype.kind in "iuf" or _succeeds(np.asarray, value, float)
    )


def _succeeds(make: Callable[..., Any], *arguments: Any) -> bool:
    try:
        return make(*arguments) is not None
    except Exception:  # a conversion of the user's may raise anything
        return False


Fits = Callable[[Any], bool]


def _of(*kinds: type) -> Fits:
    return lambda value: isinstance(value, kinds) and (bool in kinds or type(value) is not bool)


PLAIN: dict[Any, tuple[Fits, str]] = {
    float: (_is_number, "a number"),
    int: (_of(int, np.integer), "a whole number"),
    bool: (_of(bool, np.bool_), "True or False"),
    str: (_of(str), "text"),
    Path: (_of(os.PathLike), "a path"),
    np.ndarray: (_is_array, "an array of numbers"),
    types.NoneType: (lambda value: value is None, "None"),
    abc.Callable: (callable, "a function"),
}


def fits(value: Any, hint: Any) -> bool:
    """Return True if a value is of an annotation's type, or the type is not one of this package."""
    return _rule(hint)[0](value)


def _rule(hint: Any) -> tuple[Fits, str]:
    """Return the test of an annotation and the words for it, empty where every value passes."""
    kind, inner = typing.get_origin(hint) or hint, typing.get_args(hint)
    if kind in PLAIN:
        return PLAIN[kind]
    if kind is typing.Literal:
        listed = ", ".join(map(str, inner))
        return lambda value: isinstance(value, str | int) and value in inner, f"one of {listed}"
    if kind in UNIONS + SEQUENCES + MAPPINGS:
        rules = [_rule(part) for part in inner if part is not Ellipsis]
        if kind in UNIONS:
            called = " or ".join(dict.fromkeys(words for _, words in rules))
            return lambda value: any(test(value) for test, _ in rules), called
        each = f", each entry {rules[-1][1]}" if rules and rules[-1][1] else ""
        if kind in SEQUENCES:
            size = f" of {len(inner)}" if len(inner) > 1 and inner[1] is not Ellipsis else ""
            return lambda value: _is_sequence(value, kind, inner, rules), f"a list{size}{each}"
        return lambda value: _is_mapping(value, rules), f"a mapping{each}"
    if not inspect.isclass(kind):
        return lambda value: True, ""
    article = "an" if kind.__name__[0] in "AEIO" else "a"
    if kind.__module__.startswith("casadi"):
        return lambda value: _can_be(kind, value), f"a CasADi {kind.__name__}"
    return lambda value: _is_ours(value, kind), f"{article} {kind.__name__}"


def _is_ours(value: Any, kind: Any) -> bool:
    if not kind.__module__.startswith(PACKAGE):
        return True
    if getattr(kind, "_is_protocol", False):
        return all(hasattr(value, name) for name in dir(kind) if not name.startswith("_"))
    if isinstance(value, kind):
        return True
    if issubclass(kind, Enum) and isinstance(value, str):  # the value of a member is accepted, too
        return value in [member.value for member in kind]
    return kind.__name__ in [base.__name__ for base in type(value).__mro__]


def _can_be(kind: Any, value: Any) -> bool:
    made = kind.__name__ in ("SX", "MX", "DM") and _succeeds(kind, value)
    return made or isinstance(value, kind)


def _is_mapping(value: Any, rules: list[tuple[Fits, str]]) -> bool:
    return isinstance(value, abc.Mapping) and all(
        test(part) for entry in value.items() for part, (test, _) in zip(entry, rules, strict=False)
    )


def _is_sequence(value: Any, kind: Any, inner: tuple[Any, ...], rules: Any) -> bool:
    if isinstance(value, str | bytes | abc.Mapping | type):
        return False
    if not isinstance(value, abc.Iterable) or getattr(value, "ndim", 1) == 0:
        return False
    if isinstance(value, abc.Iterator):  # a test would consume it
        return kind is abc.Iterable
    if len(inner) > 1 and inner[1] is not Ellipsis:  # a tuple of fixed length
        return isinstance(value, tuple | list) and len(value) == len(inner)
    return not rules or all(map(rules[0][0], itertools.islice(value, MOST_ENTRIES)))
