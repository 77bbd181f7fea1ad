"""Cases of a sweep: a grid, random draws or a table, computed from the index on demand."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError, shown
from microbot_ocp._base.reading import opened
from microbot_ocp.robot import Robot
from microbot_ocp.sweeps._extra import needed
from microbot_ocp.sweeps._quantities import (
    DYNAMICS,
    check_name,
    column_names,
    plain_name,
    pose_names,
    scale_to_si,
    widths,
)

MOST_CASES = 10**9
MOST_PREPARED = 8  # robots of different masses, gravity or friction with compiled kernels


@dataclass(frozen=True)
class Between:
    """Range of a quantity, component by component: for random draws, or for a grid with ``steps``.

    Parameters
    ----------
    lower, upper : float or array_like
        Ends of the range; equal ends fix a component.
    steps : int, optional
        Number of grid values per component, both ends included.
    """

    lower: ArrayLike
    upper: ArrayLike
    steps: int | None = None


@dataclass(frozen=True)
class OneOf:
    """Discrete values of a quantity, each a number or a list of numbers."""

    values: Any


class Axis(NamedTuple):
    """Independent dimension of the cases.

    Its ``columns`` take the rows of ``values`` [K,k]. For random draws from a range, ``values`` is
    None and the single column varies from ``lower`` to ``upper``.
    """

    columns: slice
    lower: float = 0.0
    upper: float = 0.0
    values: FloatArray | None = None

    def at(self, share: FloatArray) -> FloatArray:
        """Return values [K,k] at positions ``share`` [K] along the axis, from 0 to 1."""
        if self.values is None:
            return (self.lower + (self.upper - self.lower) * share)[:, None]
        rows = np.minimum((share * len(self.values)).astype(int), len(self.values) - 1)
        return self.values[rows]


@dataclass(frozen=True, eq=False)
class Cases:
    """Declaration of cases, built by :meth:`grid`, :meth:`random` or :meth:`table`.

    Quantities are named ``start_q``, ``goal_q``, ``via1_q`` (rad; prismatic: m; ``..._q_deg`` in
    degrees) or ``start_position`` and so on (tool origin in the base frame, m); ``payload`` (kg, a
    point mass at the tool), ``masses`` (kg, one per link; inertias scale with the masses),
    ``gravity`` (m/s^2), ``viscous_friction``, ``coulomb_friction``, and the limits of task files:
    ``qd_max``, ``tau_max``, ``tool_speed_max``.

    Attributes
    ----------
    kind : str
        "grid", "random" or "table".
    quantities : mapping from a name to a constant, :class:`Between` or :class:`OneOf`
    count : int or None
        Number of random draws.
    seed : int
        Seed of the random draws.
    columns : mapping from a name to array [N]
        Columns of the table.
    origin : str
        Name of the table's file, for messages.
    """

    kind: str
    quantities: Mapping[str, Any]
    count: int | None = None
    seed: int = 0
    columns: Mapping[str, FloatArray] = field(default_factory=dict)
    origin: str = "the table"

    @classmethod
    def grid(cls, **quantities: Any) -> Cases:
        """Return all combinations of the values; the quantity named last varies fastest.

        Parameters
        ----------
        **quantities
            Constants, :class:`Between` with ``steps``, :class:`OneOf`.
        """
        return cls("grid", quantities)

    @classmethod
    def random(cls, count: int, *, seed: int = 0, **quantities: Any) -> Cases:
        """Return scrambled Sobol points: every leading part of the sequence is evenly spread.

        Parameters
        ----------
        count : int
            Number of cases; a power of two is spread most evenly.
        seed : int
            Seed of the scrambling.
        **quantities
            Constants, :class:`Between`, :class:`OneOf`.

        Raises
        ------
        InputError
            A count that is no integer from 1, or a seed that is no integer from 0.
        """
        for name, value, least in (("count", count, 1), ("seed", seed, 0)):
            checks.whole(name, value, at_least=least, at_most=MOST_CASES)
        return cls("random", quantities, int(count), int(seed))

    @classmethod
    def table(cls, source: str | Path | Mapping[str, ArrayLike], **fixed: Any) -> Cases:
        """Return one case per row of a table.

        Parameters
        ----------
        source : str, Path or mapping
            A CSV or Parquet file, or columns [N] by name. A column is named like its quantity, with
            a number from 1 if the quantity has components (``start_q_deg_1``, ``start_q_deg_2``).
        **fixed
            Constants for all cases.

        Raises
        ------
        InputError
            A file that cannot be read, columns of different lengths, a value that is no number.
        """
        origin = "the table" if isinstance(source, Mapping) else Path(source).name
        read = source if isinstance(source, Mapping) else _read(Path(source))
        columns = {}
        for name, values in read.items():
            column = checks.array(f"column {name} of {origin}", values, (None,), finite=False)
            if columns and column.size != next(iter(columns.values())).size:
                raise InputError(f"columns of {origin} must be equally long, but {name} is not")
            columns[str(name)] = column
        if not columns or not next(iter(columns.values())).size:
            raise InputError(f"{origin} must have at least one column and one row")
        return cls("table", fixed, columns=columns, origin=origin)

    def of(self, robot: Robot) -> CaseSource:
        """Return the cases of a robot.

        Raises
        ------
        InputError
            A quantity that is unknown, is missing, has the wrong width or has no value.
        """
        return CaseSource(self, robot)


class CaseSource:
    """Cases of one robot by index, in SI units.

    Attributes
    ----------
    count : int
        Number of cases.
    names : tuple of str
        Names of the quantities, without ``_deg``.
    width : mapping from a name to int
        Number of components per quantity.
    poses : tuple of str
        Names of the poses of a task, in the order of the motion.
    """

    def __init__(self, cases: Cases, robot: Robot) -> None:
        self.cases, self._robot = cases, robot
        self.width: dict[str, int] = {}
        self._axes: list[Axis] = []
        constants: list[FloatArray] = []
        place = 0
        for name, given in self._quantities().items():
            value, axes = self._read(name, given, place)
            place += value.size
            constants.append(value)
            self._axes += axes
            plain = plain_name(name)
            if plain in self.width:
                raise InputError(f"give {plain} or {name}, not both")
            self.width[plain] = value.size
        self.names = tuple(self.width)
        self.poses = pose_names(self.names)
        self._constant = np.concatenate(constants)
        if cases.kind == "table":
            self._axes = [self._rows_of_table()]
        self.count = int(cases.count or 0)
        if cases.kind != "random":
            self._sizes = tuple(len(axis.values) for axis in self._axes if axis.values is not None)
            self.count = int(np.prod([float(size) for size in self._sizes]))
        checks.number("the count of cases", self.count, at_most=MOST_CASES)

    @property
    def content(self) -> dict[str, Any]:
        """Data that determine every row, for the digest of the study."""
        drawn = self.cases.seed if self.cases.kind == "random" else None
        return {
            "kind": self.cases.kind,
            "count": self.count,
            "seed": drawn,
            "width": self.width,
            "axes": [(a.columns.start, a.columns.stop, *a[1:]) for a in self._axes],
            "constant": self._constant,
        }

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the input columns of a data set."""
        return tuple(c for name, width in self.width.items() for c in column_names(name, width))

    @property
    def varying(self) -> tuple[str, ...]:
        """Names of the quantities that differ between cases."""
        varies = np.zeros(self._constant.size, dtype=bool)
        for axis in self._axes:
            table = axis.values
            varies[axis.columns] = table is None or (table != table[0]).any(axis=0)
        return tuple(name for name, of_name in self.values(varies).items() if of_name.any())

    def rows(self, start: int, stop: int) -> FloatArray:
        """Return values [K,c] of the cases from ``start`` up to ``stop``, in the order of the
        columns.
        """
        values = np.tile(self._constant, (stop - start, 1))
        if not self._axes:
            return values
        if self.cases.kind != "random":
            steps = np.unravel_index(np.arange(start, stop), self._sizes)
            for axis, index in zip(self._axes, steps, strict=True):
                assert axis.values is not None
                values[:, axis.columns] = axis.values[index]
            return values
        qmc = needed("scipy.stats.qmc")
        # The whole sequence depends on the seed alone, so chunks can be drawn in any order.
        engine = qmc.Sobol(len(self._axes), scramble=True, seed=self.cases.seed)
        if start:
            engine.fast_forward(start)
        with warnings.catch_warnings():  # scipy warns of counts that are no power of two
            warnings.simplefilter("ignore", UserWarning)
            shares = engine.random(stop - start)
        for axis, share in zip(self._axes, shares.T, strict=True):
            values[:, axis.columns] = axis.at(share)
        return values

    def values(self, row: FloatArray) -> dict[str, FloatArray]:
        """Return values of the quantities by name, from a row [c]."""
        parts = np.split(row, np.cumsum(list(self.width.values()))[:-1])
        return dict(zip(self.names, parts, strict=True))

    def chunks(self, size: int, skipped: set[int]) -> Iterator[tuple[int, int, FloatArray]]:
        """Yield number, first case and rows of every chunk that is not in ``skipped``."""
        for number in range(-(-self.count // size)):
            if number not in skipped:
                start = number * size
                yield number, start, self.rows(start, min(start + size, self.count))

    def reference(self) -> dict[str, FloatArray]:
        """Return one value per quantity, a finite value if any case has one."""
        row = self.rows(0, 1)[0]
        for axis in self._axes:
            if axis.values is not None and not np.isfinite(row[axis.columns]).all():
                finite = np.isfinite(axis.values).all(axis=1)
                row[axis.columns] = axis.values[int(finite.argmax())]
        return self.values(row)

    def robots(self) -> list[dict[str, FloatArray]]:
        """Return all combinations of masses, gravity and friction; empty if there are many."""
        reference = self.reference()
        row = np.concatenate(list(reference.values()))
        kinds = np.repeat([name in DYNAMICS for name in reference], list(self.width.values()))
        places, choices = [], []
        for axis in self._axes:
            chosen = kinds[axis.columns]
            if not chosen.any():
                continue
            if axis.values is None:
                return []
            places.append(np.arange(row.size)[axis.columns][chosen])
            choices.append(np.unique(axis.values[:, chosen], axis=0))
        if np.prod([float(len(values)) for values in choices]) > MOST_PREPARED:
            return []
        robots = []
        for combination in product(*choices):
            for at, values in zip(places, combination, strict=True):
                row[at] = values
            every = self.values(row.copy())
            robots.append({name: value for name, value in every.items() if name in DYNAMICS})
        return robots

    def _quantities(self) -> dict[str, Any]:
        """Return quantities as given; each quantity of a table becomes discrete values [N,w]."""
        given = dict(self.cases.quantities)
        columns = set(self.cases.columns)
        for name, value in given.items() if columns else ():
            if isinstance(value, Between | OneOf):
                raise InputError(f"{name} must be a constant beside a table, not {shown(value)}")
        for name in self.cases.columns:
            stem = name.rsplit("_", 1)[0] if name.rsplit("_", 1)[-1].isdigit() else name
            check_name(stem)
            if stem in self.cases.quantities:
                raise InputError(f"{stem} is a column of {self.cases.origin} and given beside it")
            if stem in given:
                continue
            fitting = [
                c for w in widths(self._robot, stem) if columns >= set(c := column_names(stem, w))
            ]
            if not fitting:
                most = column_names(stem, widths(self._robot, stem)[-1])
                raise InputError(
                    f"{self.cases.origin} has the column {name}, but {stem} needs {', '.join(most)}"
                )
            given[stem] = OneOf(np.column_stack([self.cases.columns[c] for c in fitting[-1]]))
        return given

    def _rows_of_table(self) -> Axis:
        """Return the rows of a table as one axis, completed by the constants."""
        values = np.tile(self._constant, (len(next(iter(self.cases.columns.values()))), 1))
        for axis in self._axes:
            values[:, axis.columns] = axis.values
        if np.isnan(values).any():
            row, column = np.argwhere(np.isnan(values))[0]
            raise InputError(f"{self.cases.origin} has no {self.columns[column]} in row {row + 1}")
        return Axis(slice(0, self._constant.size), values=values)

    def _read(self, name: str, given: Any, place: int) -> tuple[FloatArray, list[Axis]]:
        """Return the first value [w] of a quantity and its axes, both in SI units."""
        check_name(name)
        if isinstance(given, Between):
            lower, upper = self._range(name, given)
            axes = []
            for k, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
                steps = np.linspace(low, high, given.steps)[:, None] if given.steps else None
                if low < high:
                    axes.append(Axis(slice(place + k, place + k + 1), low, high, steps))
            return lower, axes
        choices = self._choices(name, given)
        choices = choices * scale_to_si(self._robot, name, choices.shape[1])
        columns = slice(place, place + choices.shape[1])
        return choices[0], [Axis(columns, values=choices)] if len(choices) > 1 else []

    def _choices(self, name: str, given: Any) -> FloatArray:
        """Return the discrete values [K,w] of a quantity; K is 1 for a constant."""
        allowed = widths(self._robot, name)
        if not isinstance(given, OneOf):
            return self._numbers(name, given, allowed)[None]
        if self.cases.kind == "table":
            return given.values
        if not isinstance(given.values, list | tuple | np.ndarray) or not len(given.values):
            raise InputError(f"{name} must have at least one of values, not {shown(given)}")
        rows = [self._numbers(f"{name}, one of values", v, allowed) for v in given.values]
        if len({row.size for row in rows}) > 1:
            raise InputError(f"{name} must have values of one length, not {shown(given)}")
        return np.array(rows)

    def _range(self, name: str, given: Between) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper ends [w] of a range, in SI units."""
        kind, steps = self.cases.kind, given.steps
        if kind == "grid" and (type(steps) is not int or steps < 2):
            raise InputError(f"{name} needs steps of at least 2 on a grid, not {shown(steps)}")
        if kind == "random" and steps is not None:
            raise InputError(f"{name} has steps, which are for grids: random draws have none")
        checks.number(f"steps of {name}", steps or 1, at_most=MOST_CASES)
        allowed = widths(self._robot, name)
        ends = [
            self._numbers(f"{name}, {end}", value, (1, *allowed))  # one number for all components
            for end, value in (("from", given.lower), ("to", given.upper))
        ]
        size = max(end.size for end in ends)
        size = size if size in allowed else allowed[-1]
        if {end.size for end in ends} - {1, size} or not np.isfinite(np.concatenate(ends)).all():
            raise InputError(f"{name} must go from and to as many finite numbers, not {given}")
        scale = scale_to_si(self._robot, name, size)
        lower, upper = (np.broadcast_to(end, size) * scale for end in ends)
        if (lower > upper).any():
            raise InputError(f"{name} must go from the lower to the upper, not {given}")
        return lower, upper

    def _numbers(self, name: str, value: Any, allowed: tuple[int, ...]) -> FloatArray:
        single: Any = value if isinstance(value, str) or not np.isscalar(value) else [value]
        numbers = checks.array(name, single, (None,), finite=False)
        if numbers.size not in allowed:
            wanted = " or ".join(str(w) for w in allowed)
            raise InputError(f"{name} must be {wanted} numbers, not {shown(value)}")
        return numbers


def _read(path: Path) -> Mapping[str, Any]:
    """Return columns of a CSV or Parquet file."""
    readers = {".parquet": ("pyarrow.parquet", "read_table"), ".csv": ("pyarrow.csv", "read_csv")}
    if path.suffix not in readers:
        raise InputError(f"table {str(path)!r} must end in .csv or .parquet")
    module, read = readers[path.suffix]
    try:
        opened(path).close()  # refuses a pipe, on which pyarrow would block
        table = getattr(needed(module), read)(path)
        return {name.strip(): table[name].to_numpy() for name in table.column_names}
    except InputError:  # pyarrow is not installed
        raise
    except (OSError, ValueError, KeyError) as problem:  # ArrowInvalid is a ValueError
        reason = getattr(problem, "strerror", None) or problem
        raise InputError(f"table {str(path)!r} cannot be read: {reason}") from None
