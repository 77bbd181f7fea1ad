"""Input checks shared by every module: one clear sentence for each kind of bad input.

A message names the argument, the given value, its unit and the allowed values.
"""

from __future__ import annotations

import difflib
import operator
import re
import reprlib
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


NAME_FIRST = 'a name goes first, as in constraint("speed", v <= 1)'
LONGEST_WORD = 150  # characters; a longer word is shortened
MOST_MESSAGE = 2000  # characters of a message; a longer one is shortened
LONGEST = 1e4  # s, of a given or computed motion
MOST_SAMPLES = 100_000  # largest number of samples of a new motion
SLOW = 100.0  # s; a longer motion is slow and has fewer samples
MOST_ITERATIONS = 10**9  # largest count of solvers
MOST_WHOLE = 20_000  # largest number of intervals, starts or tries; more would take days
MOST_GIVEN = 2_000_000  # largest number of requested samples
ROUNDING = 1e-9
"""Slack of comparisons for errors of rounding: relative, or in SI units."""


class InputError(ValueError):
    """Bad input, found before any solver starts; the message is one complete sentence.

    A long value is shortened in its middle; the sentence stays whole.
    """

    def __init__(self, *arguments: object) -> None:
        brief = (sentence(a) if isinstance(a, str) else a for a in arguments)
        super().__init__(*brief)


def warn_user(sentence: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line outside of this package that made the doubtful call."""
    frame, level = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").startswith("microbot_ocp."):
        frame, level = frame.f_back, level + 1
    warnings.warn(sentence, category, stacklevel=level)


@contextmanager
def naming(prefix: str) -> Iterator[None]:
    """Put a prefix, such as "a.toml: ", before InputErrors raised inside of the context."""
    try:
        yield
    except InputError as problem:
        raise InputError(f"{prefix}{problem}") from None


_brief = reprlib.Repr()
_brief.maxlevel, _brief.maxstring, _brief.maxother, _brief.maxlong = 3, 80, 80, 40
_brief.maxlist = _brief.maxtuple = _brief.maxset = _brief.maxdict = _brief.maxarray = 6


def shown(value: Any) -> str:
    """Return the ``repr`` of a value for a message, limited in length and depth."""
    try:
        return shortened(_brief.repr(value), 120)
    except Exception:  # a user's __repr__ may raise anything; a huge integer has none
        return f"a value of type {type(value).__name__}"


CONTROL = {code: f"\\x{code:02x}" for code in (*range(9), *range(11, 13), *range(14, 32), 127)}


def shortened(text: str, most: int) -> str:
    """Return ``text`` on one line of at most ``most`` characters, shortened in the middle.

    Control characters, which harm terminals and logs, are written as their codes.
    """
    text = text.translate(CONTROL)
    if len(text) <= most:
        return text
    line = " ".join(text.split())
    return line if len(line) <= most else f"{line[: most // 2]}…{line[len(line) - most // 2 + 1 :]}"


def sentence(text: str) -> str:
    """Return a message whole, except that unreadably long words are shortened in the middle.

    >>> sentence("a file of the name " + "x" * 200 + " is not there")[-60:]
    'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx is not there'
    """
    words = (shortened(word, LONGEST_WORD) for word in re.split(r"(\s+)", text))
    return shortened("".join(words), MOST_MESSAGE)


# Errors of numpy and Python for values that are no numbers; recursion raises a RuntimeError.
NO_NUMBERS = (TypeError, ValueError, OverflowError, AttributeError, RuntimeError)


def _with_unit(value: Any, unit: str) -> str:
    return f"{value} {unit}".rstrip()


def _is_numeric(value: Any) -> bool:
    """Return True if numpy would read only numbers: no text and no truth values at any depth."""
    if isinstance(value, list | tuple):
        return all(_is_numeric(entry) for entry in value)
    if isinstance(value, str | bytes | bool | np.bool_ | complex | np.complexfloating):
        return False
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        return all(_is_numeric(entry) for entry in value.flat)
    return not isinstance(value, np.ndarray) or value.dtype.kind in "iuf"


def _remedy(value: Any) -> str:
    """Return advice for a value that could be converted to numbers."""
    if isinstance(value, Iterator):
        return "; make a list of it"
    return "; call it" if callable(value) else ""


def number(
    name: str,
    value: Any,
    unit: str = "",
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> float:
    """Return ``value`` as a finite float within the given bounds."""
    try:
        if not _is_numeric(value) or (isinstance(value, np.ndarray) and value.ndim):
            raise TypeError
        result = float(value)
    except NO_NUMBERS:
        raise InputError(f"{name} must be a number, not {shown(value)}{_remedy(value)}") from None
    if not np.isfinite(result):
        raise InputError(f"{name} must be finite, not {_with_unit(value, unit)}")
    for bound, breaks, words in (
        (above, operator.le, "above"),
        (at_least, operator.lt, "at least"),
        (at_most, operator.gt, "at most"),
    ):
        if bound is not None and breaks(result, bound):
            allowed = f"{words} {_with_unit(f'{bound:g}', unit)}"
            raise InputError(f"{name} must be {allowed}, not {value}")
    return result


def whole(
    name: str, value: Any, unit: str = "", *, at_least: int = 1, at_most: float = MOST_WHOLE
) -> int:
    """Return ``value`` as a whole number within the bounds."""
    number(name, value, unit, at_least=at_least, at_most=at_most)
    if not isinstance(value, int | np.integer):
        raise InputError(f"{name} must be a whole number, not {value}")
    return int(value)


def longest_step(duration: float, most: int) -> float:
    """Return the largest sampling step of a motion, s: T / most up to 100 s, larger beyond.

    The number of samples decreases with the square root of T / 100 s.
    >>> longest_step(100.0, 1000), longest_step(10_000.0, 1000)
    (0.1, 100.0)
    """
    return duration * max(1.0, duration / SLOW) ** 0.5 / most


def time_limit(value: Any) -> float:
    """Return a wall time above 0 s; infinite means no limit."""
    if isinstance(value, float | np.floating) and value == np.inf:
        return np.inf
    return number("time_limit", value, "s", above=0.0)


def numbers(name: str, value: ArrayLike) -> FloatArray:
    """Return ``value`` as a float array of any shape."""
    try:
        # A masked entry is no number.
        if value is None or not _is_numeric(value) or np.ma.is_masked(value):
            raise TypeError
        return np.array(value, dtype=float)
    except NO_NUMBERS:
        sentence = f"{name} must be an array of numbers, not {shown(value)}{_remedy(value)}"
        raise InputError(sentence) from None


def array(
    name: str,
    value: ArrayLike,
    shape: tuple[int | None, ...],
    unit: str = "",
    *,
    finite: bool = True,
) -> FloatArray:
    """Return ``value`` as a read-only float array of ``shape``; None allows any length."""
    result = numbers(name, value)
    pairs = zip(result.shape, shape, strict=False)
    if result.ndim != len(shape) or any(want not in (None, have) for have, want in pairs):
        wanted = "[" + ", ".join("any" if s is None else str(s) for s in shape) + "]"
        raise InputError(f"{name} must have shape {wanted}, not {list(result.shape)}")
    bad = np.isnan(result) if not finite else ~np.isfinite(result)
    if bad.any():
        where = ", ".join(str(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"{name} must be finite, but entry [{where}] is {_with_unit(result[bad][0], unit)}"
        )
    result.setflags(write=False)
    return result


def times(
    name: str, value: ArrayLike, count: int | None = None, *, from_zero: bool = False
) -> FloatArray:
    """Return at least two strictly increasing times, s."""
    wanted = f"{name} must be at least two strictly increasing times{' from 0' * from_zero}, s"
    if np.ndim(numbers(name, value)) == 0:
        raise InputError(f"{wanted}, not {shown(value)}")
    t = array(name, value, (count,), "s")
    if t.size < 2 or (from_zero and t[0] != 0.0):
        raise InputError(f"{wanted}, not {shown(t.tolist())}")
    stuck = np.flatnonzero(np.diff(t) <= 0)
    if stuck.size:
        i = int(stuck[0])
        raise InputError(
            f"{wanted}, but {name}[{i + 1}] is {t[i + 1]:g} s after {name}[{i}] of {t[i]:g} s"
        )
    return t


def size(label: str, count: float, most: int) -> None:
    """Raise InputError for more than ``most`` entries (samples, intervals) before they are made."""
    if not count <= most:
        raise InputError(
            f"{label} would be {count:.3g}, {8e-9 * count:.2g} GB a column: "
            f"at most {most:,} are allowed"
        )


def joints(name: str, count: int, robot: Any) -> None:
    """Raise InputError if a number of joints differs from the robot's."""
    if count != robot.joint_count:
        raise InputError(f"{name} has {count} joints, but the robot has {robot.joint_count}")


def step_count(duration: float, step: float) -> int:
    """Return the number of steps of at most ``step`` s in a duration; too many raise InputError."""
    size("the number of samples", duration / step, MOST_GIVEN)
    return max(1, int(np.ceil(duration / step - ROUNDING)))


MOST_DEGREES = 720.0  # two turns
MOST_NAMES = 20  # most names in a message
LONGEST_LINK = 20.0  # m; no arm has a longer link


def degrees_hint(angles: ArrayLike, beyond: float = 2 * np.pi) -> str:
    """Return advice if angles in rad look like degrees: whole numbers beyond a turn.

    >>> degrees_hint([0.0, 90.0]), degrees_hint([0.0, 1.5])
    ('; that looks like degrees: use np.radians, a key in _deg or an option in -deg', '')
    """
    values = np.asarray(angles, dtype=float)
    values = np.abs(values[np.isfinite(values)])
    largest = values.max(initial=0.0)
    if not beyond < largest <= MOST_DEGREES or np.any(values % 1.0):
        return ""
    return "; that looks like degrees: use np.radians, a key in _deg or an option in -deg"


class UnknownName(InputError, KeyError):
    """A name that a result does not have; the message lists the names that it has."""

    __str__ = Exception.__str__  # KeyError would print the repr


def by_name(label: str, entries: Mapping[str, Any], name: object, hint: str = "") -> Any:
    """Return the entry of a name; raise UnknownName with similar or all names if there is none."""
    if isinstance(name, str) and name in entries:
        return entries[name]
    raise UnknownName(f"{label} has no {shown(name)}{similar(name, entries)}{hint}") from None


def similar(name: object, names: Iterable[str]) -> str:
    """Return the end of a message about an unknown name: the similar name, or all names."""
    there = list(names)
    asked = did_you_mean(name, there, ":")
    if len(there) > MOST_NAMES:
        return asked
    listed = ", ".join(map(repr, there)) or "nothing"
    return f"{asked} It has {listed}" if asked else f", it has {listed}"


def did_you_mean(name: object, names: Iterable[str], mark: str = ";") -> str:
    """Return a question about the most similar name, in any case of letters; empty if none is near.

    >>> did_you_mean("UR5E", ["panda", "ur5e"])
    "; did you mean 'ur5e'?"
    """
    there = {other.lower(): other for other in names}
    close = difflib.get_close_matches(str(name).lower(), there, 1)
    return f"{mark} did you mean {there[close[0]]!r}?" if close else ""


def one_of(name: str, value: str, allowed: Iterable[str]) -> str:
    """Return ``value`` if it is one of ``allowed``."""
    names = list(allowed)
    if not isinstance(value, str) or value not in names:
        asked = did_you_mean(value, names)
        raise InputError(f"{name} must be one of {', '.join(names)}, not {shown(value)}{asked}")
    return value


def plain(value: Any) -> Any:
    """Return dataclasses and arrays as plain values for strict JSON; NaN and inf become None."""
    if hasattr(type(value), "__dataclass_fields__"):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [plain(entry) for entry in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float | np.floating):
        return float(value) + 0.0 if np.isfinite(value) else None  # + 0.0 turns -0.0 into 0.0
    return int(value) if isinstance(value, np.integer) else value
