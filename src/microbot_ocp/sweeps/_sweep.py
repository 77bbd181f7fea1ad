"""The data set of a sweep on the disk: whole part files, one a chunk of cases."""

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
# What pyarrow raises for damaged files.
DAMAGED = (OSError, ValueError, KeyError, NotImplementedError, RuntimeError)
SCHEMA = 2  # of the folder; part files of schema 1 do not say which sweep they are of
STAMP = b"microbot_ocp"  # key of a part file's metadata: the digest of its sweep
_PART = re.compile(r"part-([0-9]{8})\.parquet")
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


class Quartiles(NamedTuple):
    """Of a sample: how many, and the values below which a quarter, half, three quarters lie."""

    count: int
    lower: float
    median: float
    upper: float

    @classmethod
    def of(cls, values: FloatArray) -> Quartiles:
        """Return that of the values that are finite; NaN where there are none."""
        finite = values[np.isfinite(values)]
        if not finite.size:
            return cls(0, np.nan, np.nan, np.nan)
        return cls(finite.size, *map(float, np.quantile(finite, (0.25, 0.5, 0.75))))


@dataclass(frozen=True)
class CaseFailure:
    """Cases that ended alike.

    Attributes
    ----------
    status : Status
    count : int
    case : int
        The first of them, to be done again.
    reason : str
        Of that case.
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
        Of all cases, and of those that have a row.
    solved : mapping from a method to int
    certified : mapping from a method to int
    durations : mapping from a method to Quartiles, s
    savings : mapping from a method to Quartiles
        Of all others: share of their time that the best method (``best``) saves, where both are
        solved.
    best : str
        "time_optimal" where it is among the methods, else the last one.
    decides : mapping from a limit to float
        Share of the solved cases in which this limit is at work for most of the best motion.
    at_limit : mapping from a limit to float
        Mean share of the time of the best motion at this limit.
    failures : tuple of Failure
        The most frequent first.
    case_time : Quartiles
        Wall time of a case, s.
    not_compiled : int
        Cases that were done without a compiler though the study could have used one.
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
    """Files in a sweep's folder belong to another sweep, or to other cases, and are left out."""


@dataclass(frozen=True, eq=False)
class Sweep:
    """Results of a sweep, finished or not.

    The cases are Parquet files in ``FOLDER/cases``, one row a case, for any reader of Parquet:
    ``pandas.read_parquet("FOLDER/cases")``.

    Attributes
    ----------
    folder : Path
    about : mapping
        What ``study.json`` says: methods, settings, columns, versions.
    """

    folder: Path
    about: Mapping[str, Any]

    def __repr__(self) -> str:
        return f"<Sweep of {self.count} cases in {str(self.folder)!r}: {self.done} done>"

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()

    @property
    def count(self) -> int:
        """Of all cases."""
        return int(self.about["count"])

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods."""
        return tuple(self.about["methods"])

    @property
    def best(self) -> str:
        """The method that others are compared with: "time_optimal", or the last one."""
        return BEST if BEST in self.methods else self.methods[-1]

    @property
    def reference(self) -> str:
        """The fastest baseline in the median, of the textbook's methods if any: the headline."""
        others = [name for name in self.methods if name != self.best]
        textbook = [name for name in others if name in METHODS and METHODS[name].baseline]
        medians = self.summary().durations
        return min(
            textbook or others, key=lambda name: np.nan_to_num(medians[name].median, nan=np.inf)
        )

    @property
    def done(self) -> int:
        """How many cases have a row."""
        return sum(len(self._cases(number)) for number in self.parts)

    @property
    def finished(self) -> bool:
        """Whether every case has its row."""
        return self.done == self.count

    @property
    def parts(self) -> list[int]:
        """Numbers of the chunks whose files are there."""
        needed("pyarrow.parquet")
        with_rows = []
        for number in self._numbers():
            with contextlib.suppress(*DAMAGED):
                with_rows += [number] if self._belongs(number) else []
        return with_rows

    def read(self, columns: Sequence[str] | None = None) -> dict[str, np.ndarray]:
        """Return columns [N] by name, in the order of the cases; by default all of them.

        Where a method has no motion its numbers are NaN and its texts empty.

        Raises
        ------
        InputError
            A column that is not there; the extra ``scale`` is not installed.
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
                f"{problem}; the sweep's command does its cases again"
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
        for name in names:  # a number that is not there is NaN
            rest = empty.get(kinds[name])
            column = table[name] if rest is None else table[name].fill_null(rest)
            arrays[name] = column.to_numpy()[order]
        return arrays

    def savings(self, method: str) -> FloatArray:
        """Return the share [N] of its time that the best method saves; NaN where one of them is not
        solved.
        """
        names = [method, self.best]
        read = self.read([f"{name}_{what}" for name in names for what in ("status", "duration")])
        slow, fast = (
            np.where(read[f"{name}_status"] == Status.SOLVED, read[f"{name}_duration"], np.nan)
            for name in names
        )
        return 1.0 - fast / slow

    def summary(self) -> SweepSummary:
        """Return statistics of what is done so far."""
        limits, best = list(self.about["limits"]), self.best
        columns = ["case", "status", "reason", "case_time", "compiled", f"{best}_limit"]
        for method in self.methods:
            columns += [f"{method}_{what}" for what in ("status", "duration", "certified")]
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
        """Give the numbers of all part files that are there, whatever they hold."""
        names = (_PART.fullmatch(path.name) for path in (self.folder / PARTS).glob("part-*"))
        return sorted(int(name[1]) for name in names if name)

    def _part(self, number: int) -> Path:
        return self.folder / PARTS / f"part-{number:08d}.parquet"

    def _cases(self, number: int) -> range:
        """Return cases of a chunk; none where the sweep has no such chunk."""
        chunk = int(self.about["chunk"])
        return range(number * chunk, min((number + 1) * chunk, self.count))

    def _belongs(self, number: int) -> bool:
        """Return whether a part file is of this sweep, and of the cases that its name says.

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
        # what schema 1 wrote may have been kept in fewer digits
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
        """Return names and types of the columns, as pyarrow has them."""
        arrow = needed("pyarrow")
        return arrow.schema([(n, getattr(arrow, TYPES[k])()) for n, k in self.about["columns"]])

    def _write(self, number: int, done: Iterable[tuple[Row, Mapping[str, bytes]]]) -> list[Row]:
        """Write the rows of a chunk, its motions first: where the rows are, everything is."""
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


# What readers ask of the document.
_ABOUT: dict[str, Any] = {
    **dict.fromkeys(("methods", "limits", "varying", "joints"), list[str]),
    **dict.fromkeys(("settings", "quantities"), dict),
    **dict.fromkeys(("count", "chunk"), int),
    "columns": list[list[str]],
    "digest": str,
}


def _is_about(about: Mapping[str, Any]) -> bool:
    """Return whether a document says of a sweep what its readers ask for."""
    columns, methods = set(map(tuple, about["columns"])), about["methods"]
    # folders of schema 1 may have been thinned by hand
    outcomes = outcome_columns if about["schema"] == SCHEMA else lambda *_: [("status", "text")]
    return (
        about.get("schema") in (1, SCHEMA)
        and bool(methods)
        and all(0 < about[key] < 10**12 for key in ("count", "chunk"))
        and all(len(column) == 2 and column[1] in TYPES for column in columns)
        and {("case", "int"), *outcomes(methods, about["limits"])} <= columns
    )


def opened(study: Study, folder: Path) -> Sweep:
    """Return the folder of a study: a new one, or the one that it was begun in.

    Raises
    ------
    InputError
        The folder holds another study.
    NotWritten
        It cannot be made.
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
            if earlier._cases(number) and not _whole(earlier, number):
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


def _whole(sweep: Sweep, number: int) -> bool:
    """Return whether a part file has all its rows as they were written."""
    try:
        return sweep._belongs(number) and _rows(str(sweep._part(number))).num_rows > 0
    except DAMAGED:
        return False


def _rows(paths: str | list[str], **options: Any) -> Any:
    """Return the table of part files, whose pages are compared with their checksums."""
    table = needed("pyarrow.parquet").read_table(paths, page_checksum_verification=True, **options)
    table.validate(full=True)
    return table


def _failures(read: Mapping[str, np.ndarray]) -> tuple[CaseFailure, ...]:
    """Return failures that differ in their numbers only count as one."""
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
