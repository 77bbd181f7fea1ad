"""Data set of a sweep on the disk: one part file per chunk of cases."""

from __future__ import annotations

import contextlib
import json
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.archive import no_archive, read_document
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.reading import opened as opened_file
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.status import Status
from microbot_ocp._base.writing import (
    digest_of_document,
    made_folder,
    remove_leftovers,
    whole_file,
    write_whole,
)
from microbot_ocp.sweeps._extra import needed
from microbot_ocp.sweeps._solve import Row
from microbot_ocp.sweeps._study import Study, outcome_columns, versions
from microbot_ocp.tasks import METHODS

if TYPE_CHECKING:
    from microbot_ocp._base.table import Table

BEST = "time_optimal"
ABOUT = "study.json"
SEAL = "document_digest"
PARTS = "cases"
MOTIONS = "motions"
TYPES = {"int": "int64", "float": "float64", "bool": "bool_", "text": "string"}
TIMES = re.compile(r".*_time")  # columns that differ from run to run
# pyarrow raises any of these for damaged files.
DAMAGED = (OSError, ValueError, KeyError, NotImplementedError, RuntimeError)
SCHEMA = 2  # version of the folder; part files of schema 1 do not name their sweep
STAMP = b"microbot_ocp"  # metadata key of a part file for the digest of its sweep
_PART = re.compile(r"part-([0-9]{8})\.parquet")
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


class Quartiles(NamedTuple):
    """Size of a sample with its lower quartile, median and upper quartile."""

    count: int
    lower: float
    median: float
    upper: float

    @classmethod
    def of(cls, values: FloatArray) -> Quartiles:
        """Return the quartiles of the finite values; NaN without finite values."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return cls(0, np.nan, np.nan, np.nan)
        return cls(finite.size, *map(float, np.quantile(finite, (0.25, 0.5, 0.75))))


@dataclass(frozen=True)
class CaseFailure:
    """Group of failed cases with equal status and similar reason.

    Attributes
    ----------
    status : Status
    count : int
        Number of cases.
    case : int
        Index of the first case, to repeat it.
    reason : str
        Reason of the first case.
    """

    status: Status
    count: int
    case: int
    reason: str


@dataclass(frozen=True, eq=False)
class SweepSummary:
    """Statistics of a sweep.

    Attributes
    ----------
    count, done : int
        Number of all cases, and of cases with a row.
    solved : mapping from a method to int
    certified : mapping from a method to int
    durations : mapping from a method to Quartiles, s
    savings : mapping from a method to Quartiles
        Share of the duration of every other method that the method ``best`` saves, over the cases
        that both solve.
    best : str
        "time_optimal" if it is among the methods, or else the last method.
    decides : mapping from a limit to float
        Share of the solved cases in which the best motion is at this limit longest.
    at_limit : mapping from a limit to float
        Mean share of the duration of the best motion at this limit.
    failures : tuple of CaseFailure
        Groups of failed cases, the most frequent first.
    case_time : Quartiles
        Wall time of a case, s.
    not_compiled : int
        Number of cases solved without compiled kernels although the study could use them.
    """

    count: int
    done: int
    solved: Mapping[str, int]
    certified: Mapping[str, int]
    durations: Mapping[str, Quartiles]
    savings: Mapping[str, Quartiles]
    best: str
    decides: Mapping[str, float]
    at_limit: Mapping[str, float]
    failures: tuple[CaseFailure, ...]
    case_time: Quartiles
    not_compiled: int = 0


class SweepFileWarning(UserWarning):
    """Warning of skipped files in the folder, which belong to another sweep or other cases."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Results of a sweep, finished or not.

    The cases are Parquet files in ``FOLDER/cases``, one row per case, for any reader of Parquet:
    ``pandas.read_parquet("FOLDER/cases")``.

    Attributes
    ----------
    folder : Path
    about : mapping
        Content of ``study.json``: methods, settings, columns, versions.
    """

    folder: Path
    about: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"<Sweep of {self.count} cases in {str(self.folder)!r}: {self.done} done>"

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()

    @property
    def count(self) -> int:
        """Number of all cases."""
        return int(self.about["count"])

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods."""
        return tuple(self.about["methods"])

    @property
    def best(self) -> str:
        """Method that the others are compared with: "time_optimal", or else the last method."""
        return BEST if BEST in self.methods else self.methods[-1]

    @property
    def reference(self) -> str:
        """Method with the least median duration among the baselines, or else among the others."""
        others = [name for name in self.methods if name != self.best]
        textbook = [name for name in others if name in METHODS and METHODS[name].baseline]
        medians = self.summary().durations
        return min(
            textbook or others, key=lambda name: np.nan_to_num(medians[name].median, nan=np.inf)
        )

    @property
    def done(self) -> int:
        """Number of cases with a row."""
        return sum(len(self._cases(number)) for number in self.parts)

    @property
    def finished(self) -> bool:
        """True if every case has a row."""
        return self.done == self.count

    @property
    def parts(self) -> list[int]:
        """Numbers of the chunks with a valid file."""
        needed("pyarrow.parquet")
        with_rows = []
        for number in self._numbers():
            with contextlib.suppress(*DAMAGED):
                with_rows += [number] if self._belongs(number) else []
        return with_rows

    def read(self, columns: Sequence[str] | None = None) -> dict[str, np.ndarray]:
        """Return columns [N] by name, in the order of the cases; by default all columns.

        Without a motion the numbers of a method are NaN and its texts empty.

        Raises
        ------
        InputError
            An unknown column; the extra ``scale`` is not installed.
        """
        kinds = dict(self.about["columns"])
        names = list(kinds) if columns is None else list(columns)
        for name in names:
            if name not in kinds:
                raise InputError(f"there is no column {name!r} in {self.folder}")
        wanted = list(dict.fromkeys(["case", *names]))
        needed("pyarrow.parquet")
        try:
            belongs = {self._part(number): self._belongs(number) for number in self._numbers()}
            paths = [str(path) for path, belonging in belongs.items() if belonging]
            table = _rows(paths, columns=wanted) if paths else self._schema().empty_table()
        except DAMAGED as problem:
            raise InputError(
                f"a file in {self.folder / PARTS} is damaged: "
                f"{problem}; run the sweep again to solve its cases anew"
            ) from None
        if len(paths) < len(belongs):
            strays = ", ".join(path.name for path, belonging in belongs.items() if not belonging)
            warnings.warn(
                f"{self.folder / PARTS} has files of other cases, which are left out: {strays}",
                SweepFileWarning,
                stacklevel=2,
            )
        order, empty = np.argsort(table["case"].to_numpy()), {"text": "", "bool": False}
        arrays = {}
        for name in names:  # a missing number is NaN
            rest = empty.get(kinds[name])
            column = table[name] if rest is None else table[name].fill_null(rest)
            arrays[name] = column.to_numpy()[order]
        return arrays

    def savings(self, method: str) -> FloatArray:
        """Return the share [N] of a method's duration that the best method saves.

        It is NaN for a case that one of the two methods did not solve.
        """
        names = [method, self.best]
        read = self.read([f"{name}_{key}" for name in names for key in ("status", "duration")])
        slow, fast = (
            np.where(read[f"{name}_status"] == Status.SOLVED, read[f"{name}_duration"], np.nan)
            for name in names
        )
        return 1.0 - fast / slow

    def summary(self) -> SweepSummary:
        """Return statistics of the cases done so far."""
        limits, best = list(self.about["limits"]), self.best
        columns = ["case", "status", "reason", "case_time", "compiled", f"{best}_limit"]
        for method in self.methods:
            columns += [f"{method}_{key}" for key in ("status", "duration", "certified")]
        columns += [f"{best}_at_{name}" for name in limits]
        read = self.read(columns)
        solved = {m: read[f"{m}_status"] == Status.SOLVED for m in self.methods}
        durations = {m: np.where(solved[m], read[f"{m}_duration"], np.nan) for m in self.methods}
        others = [m for m in self.methods if m != best]
        decided = read[f"{best}_limit"][solved[best]]
        at_work = {name: read[f"{best}_at_{name}"][solved[best]] for name in limits}
        return SweepSummary(
            count=self.count,
            done=read["case"].size,
            solved={m: int(s.sum()) for m, s in solved.items()},
            certified={m: int((s & read[f"{m}_certified"]).sum()) for m, s in solved.items()},
            durations={m: Quartiles.of(d) for m, d in durations.items()},
            savings={m: Quartiles.of(1.0 - durations[best] / durations[m]) for m in others},
            best=best,
            decides={name: float((decided == name).mean()) for name in limits if decided.size},
            at_limit={name: float(share.mean()) for name, share in at_work.items() if share.size},
            failures=_failures(read),
            case_time=Quartiles.of(read["case_time"]),
            not_compiled=int((~read["compiled"] & np.isfinite(read["case_time"])).sum()),
        )

    def table(self) -> Table:
        """Return durations and savings of the methods: printed, in Jupyter, as Markdown or CSV."""
        return view_for(self, "table")(self)

    def plot(self, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Return the time saved over the workspace, and more: :func:`microbot_ocp.plots.sweep`."""
        return view_for(self, "plot")(self, axes, **options)

    def to_rerun(self, path: str | Path) -> Path:
        """Write a Rerun recording: every goal as a point, coloured by the time saved."""
        return view_for(self, "rerun")(self, path)

    def _numbers(self) -> list[int]:
        """Return the numbers of all part files, valid or not."""
        names = (_PART.fullmatch(path.name) for path in (self.folder / PARTS).glob("part-*"))
        return sorted(int(name[1]) for name in names if name)

    def _part(self, number: int) -> Path:
        return self.folder / PARTS / f"part-{number:08d}.parquet"

    def _cases(self, number: int) -> range:
        """Return the cases of a chunk; empty if the sweep has no such chunk."""
        chunk = int(self.about["chunk"])
        return range(number * chunk, min((number + 1) * chunk, self.count))

    def _belongs(self, number: int) -> bool:
        """Return whether a part file belongs to this sweep and holds the cases of its number.

        Raises
        ------
        One of ``DAMAGED``.
        """
        part, cases = self._part(number), self._cases(number)
        with opened_file(part) as stream:
            about = needed("pyarrow.parquet").read_metadata(stream)
        stamp = (about.metadata or {}).get(STAMP, b"").decode()
        if not cases or stamp != (self.about["digest"] if self.about["schema"] > 1 else ""):
            return False
        columns, wanted = about.schema.to_arrow_schema(), self._schema()
        # Files of schema 1 may hold columns of other types: compare the names only.
        same = columns.equals(wanted) if stamp else columns.names == wanted.names
        if not same or not about.num_rows:
            raise ValueError(f"{part.name} has other columns, or no row")
        numbers = about.row_group(0).column(0).statistics
        if numbers is None or numbers.min != cases.start:
            return False
        if about.num_rows != len(cases) or numbers.max != cases.stop - 1:
            raise ValueError(f"{part.name} has {about.num_rows} rows, not {len(cases)}")
        return True

    def _schema(self) -> Any:
        """Return names and types of the columns as a pyarrow schema."""
        arrow = needed("pyarrow")
        return arrow.schema([(n, getattr(arrow, TYPES[k])()) for n, k in self.about["columns"]])

    def _write(self, number: int, done: Iterable[tuple[Row, Mapping[str, bytes]]]) -> list[Row]:
        """Write the motions of a chunk and after them its rows, whose file marks completion."""
        arrow, parquet = needed("pyarrow"), needed("pyarrow.parquet")
        schema = self._schema().with_metadata({STAMP: self.about["digest"].encode()})
        rows = []
        for row, motions in done:
            rows.append(row)
            for name, content in motions.items():
                place = made_folder(self.folder / MOTIONS / f"{row['case']:09d}")
                write_whole(place / f"{name}.npz", content)
        with whole_file(self._part(number)) as partial:
            table = arrow.Table.from_pylist(rows, schema=schema)
            parquet.write_table(table, partial, write_page_checksum=True)
        return rows


def load_sweep(folder: str | Path) -> Sweep:
    """Return the results of a sweep from its folder.

    Raises
    ------
    InputError
        A folder that holds no sweep, or a damaged one.
    """
    path = Path(folder) / ABOUT
    about = read_document(path, "sweep", _ABOUT, SEAL)
    if not _is_about(about):
        raise no_archive(path, "sweep", ValueError("it is not whole"))
    return Sweep(Path(folder), about)


# Keys and types of the document that readers rely on.
_ABOUT: dict[str, Any] = {
    **dict.fromkeys(("methods", "limits", "varying", "joints"), list[str]),
    **dict.fromkeys(("settings", "quantities"), dict),
    **dict.fromkeys(("count", "chunk"), int),
    "columns": list[list[str]],
    "digest": str,
}


def _is_about(about: Mapping[str, Any]) -> bool:
    """Return whether a document has a valid schema, methods, counts and columns."""
    columns, methods = set(map(tuple, about["columns"])), about["methods"]
    # Columns may have been removed by hand from folders of schema 1.
    outcomes = outcome_columns if about["schema"] == SCHEMA else lambda *_: [("status", "text")]
    return (
        about.get("schema") in (1, SCHEMA)
        and bool(methods)
        and all(0 < about[key] < 10**12 for key in ("count", "chunk"))
        and all(len(column) == 2 and column[1] in TYPES for column in columns)
        and {("case", "int"), *outcomes(methods, about["limits"])} <= columns
    )


def opened(study: Study, folder: Path) -> Sweep:
    """Return the results in the folder of a study, which is created or continued.

    Raises
    ------
    InputError
        The folder holds another study.
    NotWritten
        The folder cannot be created.
    """
    if (folder / ABOUT).exists():
        earlier = load_sweep(folder)
        if earlier.about["digest"] != study.digest:
            raise InputError(
                f"{str(folder)!r} holds another study, of {earlier.count} cases by "
                f"{earlier.about.get('version')}: give another folder, or remove this one"
            )
        remove_leftovers(folder / PARTS)
        for number in earlier._numbers():
            if earlier._cases(number) and not _is_complete(earlier, number):
                earlier._part(number).unlink()
        return earlier
    made_folder(folder / PARTS)
    about = {
        "schema": SCHEMA,
        "digest": study.digest,
        "version": versions(),
        "origin": study.origin,
        "robot": study.robot.name,
        "joints": list(study.robot.joint_names),
        "count": study.source.count,
        "chunk": study.chunk,
        "kind": study.cases.kind,
        "seed": study.cases.seed,
        "quantities": {name: repr(given) for name, given in study.cases.quantities.items()},
        "varying": list(study.source.varying),
        "methods": list(study.methods),
        "settings": dict(study.settings),
        "time_limit": study.time_limit,
        "limits": [name for _, _, name in study.limit_columns],
        "columns": [list(pair) for pair in study.schema],
    }
    about[SEAL] = digest_of_document(about, SEAL)
    write_whole(folder / ABOUT, json.dumps(about, indent=2) + "\n")
    return Sweep(folder, about)


def _is_complete(sweep: Sweep, number: int) -> bool:
    """Return whether a part file belongs to the sweep and its checksums match."""
    try:
        return sweep._belongs(number) and _rows(str(sweep._part(number))).num_rows > 0
    except DAMAGED:
        return False


def _rows(paths: str | list[str], **options: Any) -> Any:
    """Return the table of part files after a check of the page checksums."""
    table = needed("pyarrow.parquet").read_table(paths, page_checksum_verification=True, **options)
    table.validate(full=True)
    return table


def _failures(read: Mapping[str, np.ndarray]) -> tuple[CaseFailure, ...]:
    """Group failures by status and reason; reasons that differ only in numbers are equal."""
    places_of: dict[tuple[str, str], list[int]] = {}
    for k in np.flatnonzero(read["status"] != Status.SOLVED):
        kind = _NUMBER.sub("#", read["reason"][k])[:120]
        places_of.setdefault((read["status"][k], kind), []).append(int(k))
    failures = []
    for (status, _), places in places_of.items():
        case = int(read["case"][places[0]])
        checks.one_of(f"status of case {case}", status, Status)
        failures.append(CaseFailure(Status(status), len(places), case, read["reason"][places[0]]))
    return tuple(sorted(failures, key=lambda failure: -failure.count))
