"""A process that does cases one by one, and what the worker beside it makes of its end.

A case that takes too long, or that takes its process down with it, costs that process alone: the
worker of dask lives on and knows which case it was. What does cases is loaded in that process
alone, so a worker starts at once and stays small.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import traceback
from collections.abc import Mapping
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, TypeAlias

from microbot_ocp._base.checks import FloatArray, shortened
from microbot_ocp._base.child_process import end_with_parent
from microbot_ocp._base.status import Status

if TYPE_CHECKING:
    from microbot_ocp.sweeps._solve import Row
    from microbot_ocp.sweeps._study import Plan

MOST_WAIT = 2e6  # s, that the system can count in ms; a case takes minutes
LIVES = 2  # times that a case may take its process down before it is left
Done: TypeAlias = "tuple[Row, dict[str, bytes]]"
_processes = threading.local()  # one of each thread of a worker


def _without_trimming(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment without dask's wish that freed memory is given back at once.

    A case of ``python -m benchmarks sweep`` takes 0.65 s with it and 0.45 s without.
    """
    return {k: v for k, v in environment.items() if k != "MALLOC_TRIM_THRESHOLD_"}


class _Ended(Exception):
    """The process ended without an answer; ``late`` where its time was over."""

    def __init__(self, late: bool) -> None:
        self.late = late


class CaseProcess:
    """A process that holds a plan and does its cases."""

    def __init__(self, digest: str, plan: bytes) -> None:
        self.digest = digest
        paths = os.pathsep.join(path for path in sys.path if path)
        self._pipe, theirs = Pipe()
        with theirs:
            code = f"from microbot_ocp.sweeps._process import serve; serve({theirs.fileno()})"
            self._process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what libraries print is no answer
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # Ctrl-C is the parent's
                env={**_without_trimming(os.environ), "PYTHONPATH": paths},
            )
        answer: Any
        try:
            self._pipe.send_bytes(plan)
            ready, answer = self._pipe.recv()
        except (OSError, EOFError):
            ready, answer = False, f"it ended with status {self._process.wait()}"
        if not ready:
            self.end()
            raise RuntimeError(f"a process for cases did not start: {answer}")
        self.notes: list[str] = answer

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def do(self, case: int, numbers: FloatArray, time_limit: float) -> Done:
        """The row and the motions of a case.

        Raises
        ------
        _Ended
            It is ended then.
        """
        late = False
        try:
            self._pipe.send((case, numbers))
            late = not self._pipe.poll(min(time_limit, MOST_WAIT))
            if not late:
                return self._pipe.recv()
        except (OSError, EOFError):
            pass
        self.end()
        raise _Ended(late)

    def end(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.wait()
        self._pipe.close()


def do_cases(
    digest: str, plan: bytes, time_limit: float, first: int, rows: FloatArray
) -> tuple[list[Done], list[str]]:
    """Do cases one after the other; what a worker of dask is asked for.

    Returns
    -------
    list of (row, motions), one a case
    list of str
        What the process has to say, such as that nothing could be compiled.
    """
    done, notes = [], []
    for case, numbers in enumerate(rows, first):
        lives = LIVES
        while True:
            process = _process(digest, plan)
            notes = process.notes
            try:
                done.append(process.do(case, numbers, time_limit))
                break
            except _Ended as end:
                lives -= 1
                if lives and not end.late:
                    continue
                done.append((_left(pickle.loads(plan), case, numbers, end.late, time_limit), {}))
                break
    return done, notes


def _left(plan: Plan, case: int, numbers: FloatArray, late: bool, time_limit: float) -> Row:
    """The row of a case without an answer."""
    from microbot_ocp.sweeps._solve import ended, inputs

    status, reason = (
        (Status.TIME_LIMIT, f"not done in {time_limit:g} s")
        if late
        else (Status.KILLED_WORKER, f"its process ended {LIVES} times without an answer")
    )
    return inputs(plan, case, numbers) | ended(plan, status, reason)


def end_process() -> None:
    """End the process of this thread, if it has one."""
    process = getattr(_processes, "one", None)
    if process is not None:
        process.end()
        _processes.one = None


def _process(digest: str, plan: bytes) -> CaseProcess:
    """The process of this thread, started where there is none, or one of another study."""
    process: CaseProcess | None = getattr(_processes, "one", None)
    if process is None or process.digest != digest or not process.alive:
        end_process()
        _processes.one = process = CaseProcess(digest, plan)
    return process


def serve(pipe: int) -> None:
    """What the process does: read the plan, get ready, then one case after the other."""
    end_with_parent()
    from microbot_ocp.sweeps._solve import CaseSolver
    from microbot_ocp.sweeps._study import versions

    worker = Connection(pipe)
    with contextlib.suppress(EOFError, OSError):
        packed = worker.recv_bytes()
        try:
            plan: Plan = pickle.loads(packed)
            if plan.version != versions():
                raise RuntimeError(f"the worker has {versions()}, the study is of {plan.version}")
            solver = CaseSolver(plan)
        except BaseException as problem:
            sentence = shortened(f"{type(problem).__name__}: {problem}", 200)
            place = traceback.extract_tb(problem.__traceback__)[-1]
            worker.send((False, f"{sentence} ({place.filename}, line {place.lineno})"))
            return
        worker.send((True, solver.notes))
        while True:
            question = worker.recv()
            worker.send(solver.row(*question))
