"""Distribution of a study over the workers of dask.distributed.

The client computes cases on demand, keeps a few chunks in flight and writes each answer as one
file; it is the only writer. Therefore workers need no common disk, memory does not grow with the
number of cases, and a restarted client continues with the chunks whose files are missing.
"""

from __future__ import annotations

import contextlib
import os
import queue
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.status import Status
from microbot_ocp._base.system import uninterrupted_children
from microbot_ocp.robot import Robot
from microbot_ocp.sweeps._cases import Cases
from microbot_ocp.sweeps._extra import needed
from microbot_ocp.sweeps._process import ATTEMPTS, do_cases
from microbot_ocp.sweeps._study import OwnMethod, Plan, Study
from microbot_ocp.sweeps._sweep import Sweep, opened
from microbot_ocp.tasks import Progress, Step

# Dask checks its event loops every 20 ms and samples its stacks every 10 ms, in each process.
MONITORING = {"distributed.admin.tick.interval": "1s", "distributed.worker.profile.enabled": False}


class SweepStopped(RuntimeError):
    """Error of a sweep that lost its scheduler or workers; the same call continues it."""


def sweep(
    robot: Robot,
    cases: Cases,
    methods: Sequence[str] | Mapping[str, OwnMethod | None] = Study.methods,
    *,
    out: str | Path,
    client: Any = None,
    workers: int | None = None,
    time_limit: float = Study.time_limit,
    motions: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> Sweep:
    """Solve every case by every method on the workers of dask.distributed.

    A second call with equal arguments and folder continues an unfinished sweep. Every case has one
    row. It does not depend on the number, order or failures of the workers, except for wall times
    and for cases that the time limit ends.

    Parameters
    ----------
    robot : Robot
    cases : Cases
    methods : sequence of str, or mapping from a name to a function, optional
        "cubic", "lspb", "straight_path", "cubic_path", "time_optimal". A user's function takes the
        robot of the case (with its payload) and the via points [m,n] and returns a motion; None
        instead of a function selects the built-in method of that name.
    out : str or Path
        Folder of the results.
    client : dask.distributed.Client or str, optional
        An open client, or the address of a scheduler; by default processes of this machine, which
        listen on the loopback interface alone and end with the call.
    workers : int, optional
        Number of processes without a client; default one per processor, at most eight per
        processor.
    time_limit : float
        Wall time of one case, s; a case that takes longer is ended with the status "time limit".
    motions : bool
        Keep the motions as ``motions/CASE/METHOD.npz``.
    progress : callable, optional
        Called with a :class:`~microbot_ocp.Step` whose text has rate, time left and failures.
    **settings
        ``prepared``, ``mesh``, ``starts``, ``grid``, ``seed``: see :class:`Study`.

    Returns
    -------
    Sweep
        Results of all cases, to read and to draw.

    Raises
    ------
    InputError
        Bad cases, methods or settings, another study in the folder, the extra ``scale`` missing:
        before any case is solved.
    SweepStopped
        The scheduler or all workers are lost; the same call continues.

    Notes
    -----
    A script that calls this must be importable: put its statements under
    ``if __name__ == "__main__":``.

    Examples
    --------
    >>> import tempfile
    >>> import microbot_ocp as mo
    >>> cases = mo.sweeps.Cases.grid(
    ...     start_q=[0, 0, 0], goal_q_deg=[90, 45, 45], payload=mo.Between(0, 2, 3)
    ... )
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = mo.sweep(mo.load_robot("microbot"), cases, ["cubic"], out=folder, workers=1)
    ...     durations = results.read(["cubic_duration"])["cubic_duration"]
    >>> bool((durations[1:] > durations[:-1]).all())  # a heavier payload takes longer
    True
    """
    study = Study(robot, cases, methods, settings, time_limit, motions)
    return run_study(study, out, client=client, workers=workers, progress=progress)


MOST_WORKERS = 8  # workers per processor; a worker needs about 150 MB


def run_study(
    study: Study,
    out: str | Path,
    *,
    client: Any = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Run a checked study; arguments and errors are those of :func:`sweep`."""
    for module in ("distributed", "pyarrow.parquet"):
        needed(module)
    if workers is not None:
        checks.number("workers", workers, at_least=1, at_most=MOST_WORKERS * _processors())
        if client is not None:
            raise InputError(
                "workers is for processes of this machine: give it or client, not both"
            )
    results = opened(study, Path(out))
    reporter = _Reporter(results, progress)
    if not results.finished:
        plan = study.plan()
        with _connected(client, workers) as connected:
            try:
                _Run(study, plan, results, connected, reporter).run()
            except KeyboardInterrupt:
                reporter("interrupted")
                raise
    reporter("done")
    return results


@contextlib.contextmanager
def _connected(client: Any, workers: int | None) -> Iterator[Any]:
    """Yield the given client, or a client of new processes on this machine."""
    distributed = needed("distributed")
    if client is not None and not isinstance(client, str):
        if not hasattr(client, "submit") or not hasattr(client, "scheduler_info"):
            raise InputError(
                f"client must be a dask.distributed.Client, not {checks.shown(client)}"
            )
        yield client
        return
    if isinstance(client, str):
        try:
            connected = distributed.Client(client, timeout="10s", set_as_default=False)
        except (OSError, ValueError) as problem:
            reason = str(problem) or type(problem).__name__
            raise InputError(f"no scheduler answers at {client!r}: {reason}") from None
        with connected:
            yield connected
        return
    with (
        needed("dask.config").set(MONITORING),
        _own_cluster(distributed) as cluster,
        distributed.Client(cluster, set_as_default=False) as connected,
    ):
        cluster.scale(workers or _processors())
        yield connected


def _own_cluster(distributed: Any) -> Any:
    """Return a scheduler in this process, whose workers ignore Ctrl-C: the scheduler ends them."""
    with uninterrupted_children():
        return distributed.LocalCluster(
            n_workers=0,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            silence_logs=50,  # level CRITICAL: the results report errors
        )


def _processors() -> int:
    """Return the number of processors of this process, by CPU affinity and cgroup quota."""
    return needed("dask.system").CPU_COUNT


class _Chunk(NamedTuple):
    """Group of consecutive cases that one worker solves."""

    number: int
    first: int
    rows: FloatArray
    deaths: int = 0  # number of submissions that ended with KilledWorker


class _Reporter:
    """Progress report: cases done, rate, time left, failures."""

    def __init__(self, results: Sweep, progress: Progress | None) -> None:
        self._progress, self._count = progress, results.count
        self._begun, self._before = time.monotonic(), results.done
        self.done = self._before
        self.failures = int(np.sum(results.read(["status"])["status"] != Status.SOLVED))
        self.notes: dict[str, None] = {}

    def __call__(self, stage: str = "solve") -> None:
        if self._progress is None:
            return
        text = f"{self.done:,} of {self._count:,} cases"
        spent, done = time.monotonic() - self._begun, self.done - self._before
        if done and stage != "done":
            rate = done / spent
            left = timedelta(seconds=round((self._count - self.done) / rate))
            text += f", {rate:.3g} a second, {left} left"
        elif stage != "done":
            text += ", starting"
        text += f", {self.failures:,} without a solution" if self.failures else ""
        text += "".join(f"; {note}" for note in self.notes)
        self._progress(Step(self.done, self._count, stage, text))


CHUNKS_AHEAD = 2  # chunks in flight per thread of a worker: one in work, one waiting
POLL_INTERVAL = 0.2  # time between two polls of the answers, s
WORKER_TIMEOUT = 120.0  # time without any worker after which the sweep stops, s


class _Run:
    """Run of a study: chunks in flight, answers, and new submissions after a lost worker."""

    def __init__(
        self, study: Study, plan: Plan, results: Sweep, client: Any, reporter: _Reporter
    ) -> None:
        self.study, self.results, self.client, self.reporter = study, results, client, reporter
        self._packed = needed("cloudpickle").dumps(plan)
        self._answers: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._flying: dict[Any, _Chunk] = {}
        self._sent = 0
        self._last_worker = time.monotonic()

    def run(self) -> None:
        """Wait until every chunk has its file."""
        size = int(self.results.about["chunk"])
        todo = self.study.source.chunks(size, set(self.results.parts))
        self.reporter()
        try:
            # Invariant: every chunk is in todo, in flight, or has its file.
            while self._fill(todo) or self._flying:
                try:
                    future = self._answers.get(timeout=POLL_INTERVAL)
                except queue.Empty:
                    self._check()
                else:
                    self._take(future)
                self.reporter()
        finally:
            for future in self._flying:
                with contextlib.suppress(Exception):
                    future.cancel()

    def _fill(self, todo: Iterator[tuple[int, int, FloatArray]]) -> bool:
        """Send chunks until the workers are busy; return False if no chunk is left."""
        room = CHUNKS_AHEAD * max(1, self._threads()) - len(self._flying)
        for _ in range(room):
            following = next(todo, None)
            if following is None:
                return False
            self._send(_Chunk(*following))
        return True

    def _threads(self) -> int:
        of_cluster = getattr(self.client.cluster, "scheduler_info", None)
        info = of_cluster or self.client.scheduler_info(-1)
        return sum(worker["nthreads"] for worker in info["workers"].values())

    def _send(self, chunk: _Chunk) -> None:
        self._sent += 1
        key = f"microbot_ocp-sweep-{self.study.digest[:12]}-{os.getpid()}-{self._sent}"
        arguments = self.study.digest, self._packed, self.study.time_limit, chunk.first, chunk.rows
        future = self.client.submit(do_cases, *arguments, key=key, pure=False)
        self._flying[future] = chunk
        future.add_done_callback(self._answers.put)

    def _take(self, future: Any) -> None:
        chunk = self._flying.pop(future)
        if future.status == "finished":
            done, notes = future.result()
            self.reporter.notes |= dict.fromkeys(notes)
            rows = self.results._write(chunk.number, done)
            self.reporter.done += len(rows)
            self.reporter.failures += sum(row["status"] != Status.SOLVED for row in rows)
            return
        if future.status != "error":
            raise self._stopped("the scheduler ended")
        problem = future.exception()
        # A crashing case ends its child process, not the worker, so the worker was killed from
        # outside and the chunk is worth another attempt.
        killed = isinstance(problem, needed("distributed.scheduler").KilledWorker)
        if killed and chunk.deaths + 1 < ATTEMPTS:
            self._send(chunk._replace(deaths=chunk.deaths + 1))
            return
        sentence = checks.sentence(f"{type(problem).__name__}: {problem}")
        raise self._stopped(f"a worker could not do its cases: {sentence}")

    def _check(self) -> None:
        """Raise SweepStopped if the scheduler or all workers are lost."""
        if self.client.status not in ("running", "newly-created"):
            raise self._stopped("the scheduler ended")
        if self._threads():
            self._last_worker = time.monotonic()
        elif time.monotonic() - self._last_worker > WORKER_TIMEOUT:
            raise self._stopped(f"there was no worker for {WORKER_TIMEOUT:g} s")

    def _stopped(self, why: str) -> SweepStopped:
        progress = f"{self.reporter.done:,} of {self.results.count:,} cases are kept in"
        return SweepStopped(f"{why}; {progress} {self.results.folder}: the same command continues")
