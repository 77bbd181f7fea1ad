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
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, TypeAlias

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.child_process import Died, OutOfTime, end_with_parent
from microbot_ocp._base.status import Status

if TYPE_CHECKING:
    from microbot_ocp.sweeps._solve import Row
    from microbot_ocp.sweeps._study import Plan

MOST_WAIT = 2e6  # s, that the system can count in ms; a case takes minutes
LIVES = 2  # times that a case may take its process down before it is left
Done: TypeAlias = "tuple[Row, dict[str, bytes]]"
_processes = threading.local()  # one of each thread of a worker


class CaseProcess:
    """A process that holds a plan and does its cases."""

    def __init__(self, digest: str, plan: bytes) -> None:
        self.digest = digest
        self._pipe, theirs = Pipe()
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        # Dask wishes that freed memory is given back at once: a case of ``python -m benchmarks
        # sweep`` takes 0.65 s with that and 0.45 s without.
        environment.pop("MALLOC_TRIM_THRESHOLD_", None)
        with theirs:
            code = f"from microbot_ocp.sweeps._process import serve; serve({theirs.fileno()})"
            self._process = subprocess.Popen(
                [sys.executable, "-c", code],
                stdin=subprocess.DEVNULL,
                stdout=2,  # what libraries print is no answer
                pass_fds=[theirs.fileno()],
                start_new_session=True,  # Ctrl-C is the parent's
                env=environment,
            )
        try:
            self.notes: list[str] = self.ask(plan)
        except Died:
            problem = f"it ended with status {self._process.wait()}"
            raise RuntimeError(f"a process for cases did not start: {problem}") from None

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def ask(self, question: Any, time_limit: float = MOST_WAIT) -> Any:
        """Return the answer to a plan, or to the number of a case with its numbers.

        Raises
        ------
        OutOfTime, Died, RuntimeError
            There is none, or the process cannot get ready; it is ended then.
        """
        problem: Exception = Died()
        with contextlib.suppress(OSError, EOFError):
            self._pipe.send(question)
            problem = OutOfTime()
            if self._pipe.poll(min(time_limit, MOST_WAIT)):
                problem = Died()
                answer = self._pipe.recv()
                if not isinstance(answer, str):
                    return answer
                problem = RuntimeError(f"a process for cases did not start: {answer}")
        self.end()
        raise problem

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
    done = [_done(digest, plan, time_limit, *case) for case in enumerate(rows, first)]
    return done, _processes.one.notes


def _done(digest: str, plan: bytes, time_limit: float, case: int, numbers: FloatArray) -> Done:
    """Return the row and the motions of a case; of one without an answer, why."""
    status, reason = Status.KILLED_WORKER, f"its process ended {LIVES} times without an answer"
    for _ in range(LIVES):
        try:
            return _process(digest, plan).ask((case, numbers), time_limit)
        except Died:
            continue
        except OutOfTime:
            status, reason = Status.TIME_LIMIT, f"not done in {time_limit:g} s"
            break
    from microbot_ocp.sweeps._solve import ended, inputs

    whole: Plan = pickle.loads(plan)
    return inputs(whole.study, case, numbers) | ended(whole.study, status, reason), {}


def _process(digest: str, plan: bytes) -> CaseProcess:
    """Return the process of this thread, started where there is none, or one of another study."""
    process: CaseProcess | None = getattr(_processes, "one", None)
    if process is None or process.digest != digest or not process.alive:
        if process is not None:
            process.end()
        _processes.one = process = CaseProcess(digest, plan)
    return process


def serve(pipe: int) -> None:
    """Do the work of the process: read the plan, get ready, then one case after the other."""
    end_with_parent()
    from microbot_ocp.sweeps._solve import CaseSolver
    from microbot_ocp.sweeps._study import versions

    worker = Connection(pipe)
    with contextlib.suppress(EOFError, OSError):
        packed = worker.recv()
        try:
            plan: Plan = pickle.loads(packed)
            if plan.version != versions():
                raise RuntimeError(f"the worker has {versions()}, the study is of {plan.version}")
            solver = CaseSolver(plan)
        except BaseException as problem:
            sentence = checks.sentence(f"{type(problem).__name__}: {problem}")
            place = traceback.extract_tb(problem.__traceback__)[-1]
            worker.send(f"{sentence} ({place.filename}, line {place.lineno})")
            return
        worker.send(solver.notes)
        while True:
            worker.send(solver.row(*worker.recv()))
