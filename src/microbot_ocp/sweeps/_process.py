"""Child process that solves cases one by one for a worker of dask.

A case that exceeds the time limit or crashes ends only the child process; the worker survives and
reports the case. The solvers are loaded in the child process alone, so a worker starts quickly and
needs little memory.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import threading
import time
import traceback
from typing import IO, TYPE_CHECKING, Any, TypeAlias

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.child_process import Died, OutOfTime, end_with_parent
from microbot_ocp._base.status import Status
from microbot_ocp._base.system import OWN_GROUP

if TYPE_CHECKING:
    from microbot_ocp.sweeps._solve import Row
    from microbot_ocp.sweeps._study import Plan

MOST_WAIT = threading.TIMEOUT_MAX  # s
ATTEMPTS = 2  # number of processes that a case may crash before it is given up
CaseResult: TypeAlias = "tuple[Row, dict[str, bytes]]"
_processes = threading.local()  # one child process per thread of a worker


class CaseProcess:
    """Child process that has received a plan and solves its cases."""

    def __init__(self, digest: str, plan: bytes) -> None:
        self.digest = digest
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        # Dask makes malloc return freed memory at once, which slows solvers down: a case of
        # ``python -m benchmarks sweep`` takes 0.65 s with this setting and 0.45 s without.
        environment.pop("MALLOC_TRIM_THRESHOLD_", None)
        self._process = subprocess.Popen(
            [sys.executable, "-c", "from microbot_ocp.sweeps._process import serve; serve()"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            **OWN_GROUP,  # the parent handles Ctrl-C
        )
        try:
            self.notes: list[str] = self.ask(plan)
        except Died:
            problem = f"it ended with status {self._process.wait()}"
            raise RuntimeError(f"a process for cases did not start: {problem}") from None

    @property
    def alive(self) -> bool:
        """True if the process is running."""
        return self._process.poll() is None

    def ask(self, request: Any, time_limit: float = MOST_WAIT) -> Any:
        """Return the answer to a plan, or to the index and the numbers of a case.

        Raises
        ------
        OutOfTime, Died, RuntimeError
            No answer in time, the process died, or it could not start. The process is ended.
        """
        process, until = self._process, time.monotonic() + time_limit
        assert process.stdin is not None
        assert process.stdout is not None
        late = threading.Timer(min(time_limit, MOST_WAIT), process.kill)
        late.start()
        try:
            _send(process.stdin, request)
            answer = pickle.load(process.stdout)
        except (OSError, EOFError, pickle.UnpicklingError):
            self.end()
            raise (OutOfTime if time.monotonic() >= until else Died) from None
        finally:
            late.cancel()
        if isinstance(answer, str):
            self.end()
            raise RuntimeError(f"a process for cases did not start: {answer}")
        return answer

    def end(self) -> None:
        """End the process at once."""
        self._process.kill()
        with contextlib.suppress(OSError):  # a request may be left unsent
            self._process.communicate()


def do_cases(
    digest: str, plan: bytes, time_limit: float, first: int, rows: FloatArray
) -> tuple[list[CaseResult], list[str]]:
    """Solve cases one after the other; a worker of dask runs this function.

    Returns
    -------
    list of (row, motions), one per case
    list of str
        Notes of the process, such as a missing compiler.
    """
    done = [_case_result(digest, plan, time_limit, *case) for case in enumerate(rows, first)]
    return done, _processes.one.notes


def _case_result(
    digest: str, plan: bytes, time_limit: float, case: int, numbers: FloatArray
) -> CaseResult:
    """Return the row and the motions of a case; without an answer the row holds the reason."""
    status, reason = Status.KILLED_WORKER, f"its process ended {ATTEMPTS} times without an answer"
    for _ in range(ATTEMPTS):
        try:
            return _process(digest, plan).ask((case, numbers), time_limit)
        except Died:
            continue
        except OutOfTime:
            status, reason = Status.TIME_LIMIT, f"not done in {time_limit:g} s"
            break
    from microbot_ocp.sweeps._solve import ended, inputs

    unpacked: Plan = pickle.loads(plan)
    return inputs(unpacked.study, case, numbers) | ended(unpacked.study, status, reason), {}


def _process(digest: str, plan: bytes) -> CaseProcess:
    """Return the process of this thread; start it if it is missing or holds another study."""
    process: CaseProcess | None = getattr(_processes, "one", None)
    if process is None or process.digest != digest or not process.alive:
        if process is not None:
            process.end()
        _processes.one = process = CaseProcess(digest, plan)
    return process


def _send(stream: IO[bytes], message: Any) -> None:
    pickle.dump(message, stream)
    stream.flush()


def serve() -> None:
    """Run the child process: read the plan, prepare the solvers, solve case after case."""
    end_with_parent()
    requests, answers = sys.stdin.buffer, open(os.dup(1), "wb")  # noqa: SIM115
    os.dup2(2, 1)  # libraries may print; standard output belongs to the parent
    from microbot_ocp.sweeps._solve import CaseSolver
    from microbot_ocp.sweeps._study import versions

    with contextlib.suppress(EOFError, OSError):
        packed = pickle.load(requests)
        try:
            plan: Plan = pickle.loads(packed)
            if plan.version != versions():
                raise RuntimeError(f"the worker has {versions()}, the study is of {plan.version}")
            solver = CaseSolver(plan)
        except BaseException as problem:
            sentence = checks.sentence(f"{type(problem).__name__}: {problem}")
            place = traceback.extract_tb(problem.__traceback__)[-1]
            _send(answers, f"{sentence} ({place.filename}, line {place.lineno})")
            return
        _send(answers, solver.notes)
        while True:
            _send(answers, solver.row(*pickle.load(requests)))
