"""Input checks shared by every module: one clear sentence for each kind of bad input.

A message names the argument, the value that was given, its unit and what is allowed.
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
LONGEST_WORD = 150  # characters: a longer one is a value that nobody reads
MOST_MESSAGE = 2000  # characters: only values that are longer make a longer one
LONGEST = 1e4  # s, of a motion that is given or looked for
MOST_SAMPLES = 100_000  # of a new motion
SLOW = 100.0  # s: longer motions have fewer samples, as they are slow
MOST_ITERATIONS = 10**9  # that solvers can count
MOST_WHOLE = 20_000  # intervals, starts, tries: far more than any computer does in a day
MOST_GIVEN = 2_000_000  # samples that may be asked for


class InputError(ValueError):
    """Bad input, found before any solver starts; the message is one complete sentence.

    A value that is long is quoted by its ends, the sentence is whole.
    """

    def __init__(self, *arguments: object) -> None:
        brief = (sentence(a) if isinstance(a, str) else a for a in arguments)
        super().__init__(*brief)


def warn_user(sentence: str, category: type[Warning] = UserWarning) -> None:
    """Warn, at the line outside of this package that asked for what is doubtful."""
    frame, level = sys._getframe(1), 2
    while frame.f_back and frame.f_globals.get("__name__", "").startswith("microbot_ocp."):
        frame, level = frame.f_back, level + 1
    warnings.warn(sentence, category, stacklevel=level)


@contextmanager
def naming(prefix: str) -> Iterator[None]:
    """Let messages of InputErrors within this context begin with a prefix, such as "a.toml: "."""
    try:
        yield
    except InputError as problem:
        raise InputError(f"{prefix}{problem}") from None


_brief = reprlib.Repr()
_brief.maxlevel, _brief.maxstring, _brief.maxother, _brief.maxlong = 3, 80, 80, 40
_brief.maxlist = _brief.maxtuple = _brief.maxset = _brief.maxdict = _brief.maxarray = 6


def shown(value: Any) -> str:
    """Return a value as a message may quote it: its ``repr``, of bounded length and depth."""
    try:
        return shortened(_brief.repr(value), 120)
    except Exception:  # a repr is anyone's code; a huge integer has none
        return f"a value of type {type(value).__name__}"


CONTROL = {code: f"\\x{code:02x}" for code in (*range(9), *range(11, 13), *range(14, 32), 127)}


def shortened(text: str, most: int) -> str:
    """Return ``text`` on one line with at most so many characters, the middle left out.

    Control characters, which no terminal and no log should get, are written as their codes.
    """
    text = text.translate(CONTROL)
    if len(text) <= most:
        return text
    line = " ".join(text.split())
    return line if len(line) <= most else f"{line[: most // 2]}…{line[len(line) - most // 2 + 1 :]}"


def sentence(text: str) -> str:
    """Return a message whole, but for words that are too long to be read: those by their ends.

    >>> sentence("a file of the name " + "x" * 200 + " is not there")[-60:]
    'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx is not there'
    """
    words = (shortened(word, LONGEST_WORD) for word in re.split(r"(\s+)", text))
    return shortened("".join(words), MOST_MESSAGE)


# what numpy and Python raise of what they cannot make numbers of; recursion is a RuntimeError
NO_NUMBERS = (TypeError, ValueError, OverflowError, AttributeError, RuntimeError)


def _with_unit(value: Any, unit: str) -> str:
    return f"{value} {unit}".rstrip()


def _is_numeric(value: Any) -> bool:
    """Return whether numpy would read numbers only: no text, no truth values, at any depth."""
    if isinstance(value, list | tuple):
        return all(_is_numeric(entry) for entry in value)
    if isinstance(value, str | bytes | bool | np.bool_ | complex | np.complexfloating):
        return False
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        return all(_is_numeric(entry) for entry in value.flat)
    return not isinstance(value, np.ndarray) or value.dtype.kind in "iuf"


def _remedy(value: Any) -> str:
    """Return what makes numbers of what is none."""
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
    """Return ``value`` as a finite float, within the bounds that are given."""
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
    """Return least step between samples of a motion, s: of ``most`` in 100 s, of fewer in longer
    ones.

    >>> longest_step(100.0, 1000), longest_step(10_000.0, 1000)
    (0.1, 100.0)
    """
    return duration * max(1.0, duration / SLOW) ** 0.5 / most


def time_limit(value: Any) -> float:
    """Return a wall time above 0 s; infinite is no limit."""
    if isinstance(value, float | np.floating) and value == np.inf:
        return np.inf
    return number("time_limit", value, "s", above=0.0)


def numbers(name: str, value: ArrayLike) -> FloatArray:
    """Return ``value`` as a float array of any shape."""
    try:
        # what is masked is no number
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
    """Return ``value`` as a read-only float array of ``shape`` (None: any length there)."""
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


def size(what: str, count: float, most: int) -> None:
    """Refuse what would have more than ``most`` entries (samples, intervals) before it is made."""
    if not count <= most:
        raise InputError(
            f"{what} would be {count:.3g}, {8e-9 * count:.2g} GB a column: "
            f"at most {most:,} are allowed"
        )


def joints(name: str, count: int, robot: Any) -> None:
    """Refuse what has another number of joints than the robot."""
    if count != robot.joint_count:
        raise InputError(f"{name} has {count} joints, but the robot has {robot.joint_count}")


def step_count(duration: float, step: float) -> int:
    """Return how many steps of at most ``step`` s a duration takes; too many are refused."""
    size("the number of samples", duration / step, MOST_GIVEN)
    return max(1, int(np.ceil(duration / step - 1e-9)))


MOST_DEGREES = 720.0  # two turns
MOST_NAMES = 20  # that a message lists
LONGEST_LINK = 20.0  # m: no arm has a longer one


def degrees_hint(angles: ArrayLike, beyond: float = 2 * np.pi) -> str:
    """Return words for angles given in rad that look like degrees: whole numbers beyond a turn.

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
    """A name that a result does not have; the message lists those that it has."""

    __str__ = Exception.__str__  # a KeyError would show the repr


def by_name(what: str, entries: Mapping[str, Any], name: object, hint: str = "") -> Any:
    """Give the entry of that name; without one the names that there are, the most similar first."""
    if isinstance(name, str) and name in entries:
        return entries[name]
    raise UnknownName(f"{what} has no {shown(name)}{similar(name, entries)}{hint}") from None


def similar(name: object, names: Iterable[str]) -> str:
    """Return what to say of a name that is none of these: which it may be, or which there are."""
    there = list(names)
    asked = did_you_mean(name, there, ":")
    if len(there) > MOST_NAMES:
        return asked
    listed = ", ".join(map(repr, there)) or "nothing"
    return f"{asked} It has {listed}" if asked else f", it has {listed}"


def did_you_mean(name: object, names: Iterable[str], mark: str = ";") -> str:
    """Return the question for the name nearest to one, in letters of either case, if any is near.

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
    """Return dataclasses and arrays as plain values for strict JSON: what is not finite becomes
    None.
    """
    if hasattr(type(value), "__dataclass_fields__"):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, tuple | list | np.ndarray):
        return [plain(entry) for entry in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, float | np.floating):
        return float(value) + 0.0 if np.isfinite(value) else None  # no -0.0
    return int(value) if isinstance(value, np.integer) else value
