"""Solution of one case, from its numbers to its row; a row does not depend on earlier cases."""

from __future__ import annotations

import contextlib
import tempfile
import time
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import NotCompiled, compiler, interpreted, usable_folder
from microbot_ocp._base.status import Status
from microbot_ocp._base.system import locked
from microbot_ocp.certificate import certify
from microbot_ocp.limits import AT_LIMIT, limit_history
from microbot_ocp.motion import Motion
from microbot_ocp.planning import TimeOptimalSolver, straight_path, time_path
from microbot_ocp.robot import Robot, forward_kinematics
from microbot_ocp.sweeps._quantities import DYNAMICS, CaseTask, NoTask, robot_with, task_of
from microbot_ocp.sweeps._study import AXES, BY_SOLVER, Plan, Study, versions
from microbot_ocp.tasks import Entry, compare
from microbot_ocp.trajectories import Segments, fastest_path

BY_TIMING = ("cubic_path", "straight_path")
Row = dict[str, Any]


class CaseSolver:
    """Solver of the cases of a plan in one process; prepared solvers are built once."""

    def __init__(self, plan: Plan) -> None:
        self.study = plan.study
        self.notes: list[str] = []
        self._tool = forward_kinematics(plan.study.robot)
        self._solvers: dict[Any, TimeOptimalSolver] = {}
        with contextlib.ExitStack() as stack, warnings.catch_warnings(record=True) as caught:
            with contextlib.suppress(OSError):  # one process compiles, the others load the result
                stack.enter_context(locked(usable_folder()))
            warnings.simplefilter("always", NotCompiled)
            for values, via in plan.prepared:
                robot = robot_with(self.study.reference_robot, values)
                self._solvers[_key(values)] = self._new_solver(robot, via, compiled=True)
        notes = [str(warning.message) for warning in caught]
        if plan.prepared and compiler() is None:
            notes = ["no C compiler was found: CasADi's virtual machine runs, which is slower"]
        self.compiled = bool(plan.prepared) and not notes
        self.notes += notes[:1]

    def row(self, case: int, numbers: FloatArray) -> tuple[Row, dict[str, bytes]]:
        """Return the row of a case, and its motions as bytes of ``.npz`` if they are kept."""
        begin = time.perf_counter()
        row = inputs(self.study, case, numbers)
        motions: dict[str, bytes] = {}
        values = self.study.source.values(numbers)
        with interpreted():
            try:
                task = task_of(self.study.robot, self.study.source.poses, values)
            except (InputError, NoTask) as problem:
                status = problem.status if isinstance(problem, NoTask) else Status.NOT_POSSIBLE
                row |= ended(self.study, status, str(problem))
            else:
                row |= self._pose_columns(task)
                row |= self._methods(task, values, motions)
        row["case_time"] = time.perf_counter() - begin
        row["compiled"] = self.compiled
        return row, motions

    def _methods(self, task: CaseTask, values: Row, motions: dict[str, bytes]) -> Row:
        row: Row = {}
        moving = task.robot.with_payload(task.payload) if task.payload else task.robot
        first: Entry | None = None
        for name in self.study.methods:
            started = time.perf_counter()
            try:
                entry = self._entry(name, task, moving, values)
            except Exception as problem:  # a user's method may raise anything
                is_input = isinstance(problem, InputError)
                status = Status.NOT_POSSIBLE if is_input else Status.FAILED
                reason = str(problem) if is_input else f"{type(problem).__name__}: {problem}"
                entry = Entry(name, "", status=status, note=reason)
            row |= self._columns(entry, moving, time.perf_counter() - started)
            if not entry.status.solved and first is None:
                first = entry
            if self.study.motions and entry.motion is not None:
                motions[name] = _as_bytes(entry.motion)
        row["status"] = str(first.status if first else Status.SOLVED)
        row["reason"] = " ".join(first.note.split()) if first else ""
        return row

    def _entry(self, name: str, task: CaseTask, moving: Robot, values: Row) -> Entry:
        method = self.study.methods[name]  # type: ignore[call-overload]
        if method is not None:
            motion = method(moving, task.via_q)
            if not isinstance(motion, Motion):
                raise ValueError(f"method {name} returned {type(motion).__name__}, no motion")
            return _certified(name, moving, task, motion)
        prepared = self._prepared_entry(name, task, moving, values)
        if prepared is not None and (
            _is_certified(prepared) or prepared.status is Status.NOT_POSSIBLE
        ):
            return prepared
        settings = {k: self.study.settings[k] for k in ("mesh", "starts", "seed", "grid")}
        compared = compare(moving, task.via_q, [name], **settings).entries[0]
        return prepared if prepared is not None and not _is_certified(compared) else compared

    def _prepared_entry(
        self, name: str, task: CaseTask, moving: Robot, values: Row
    ) -> Entry | None:
        """Return the entry by a prepared solver or path timing; None without either."""
        if name == BY_SOLVER and self.study.prepares:
            solver = self._solvers.get(_key(values))
            if solver is None:  # no solver was prepared for these masses, friction and gravity
                robot = task.robot.with_limits(self.study.reference_robot.limits)
                solver = self._new_solver(robot, task.via_q, compiled=False)
            search = self.study.settings["starts"] > 1
            motion = solver(task.robot.limits, task.payload, via_q=task.via_q, search=search)
            return _certified(name, moving, task, motion)
        if name in BY_TIMING and self.study.settings["prepared"]:
            return self._timed(name, moving, task)
        return None

    def _timed(self, name: str, robot: Robot, task: CaseTask) -> Entry:
        via = task.via_q
        path = straight_path(via) if name == "straight_path" else fastest_path(robot, Segments(via))
        timing = time_path(robot, path, grid=self.study.settings["grid"], compiled=False)
        if not timing.solved:
            reason = f"path blocked beyond s = {timing.blocked_at:.3g}"
            return Entry(name, "", status=timing.status, note=reason)
        return _certified(name, robot, task, timing.motion())

    def _columns(self, entry: Entry, robot: Robot, spent: float) -> Row:
        name = entry.name
        row: Row = {f"{name}_status": str(entry.status), f"{name}_solve_time": spent}
        if entry.motion is None:
            return row
        shares = limit_shares(self.study, robot, entry.motion)
        row[f"{name}_duration"] = float(entry.motion.duration)
        row[f"{name}_certified"] = bool(entry.certificate and entry.certificate.ok)
        row |= {f"{name}_at_{key}": share for key, share in shares.items()}
        if shares and max(shares.values()) > 0.0:
            row[f"{name}_limit"] = max(shares, key=shares.__getitem__)
        return row

    def _pose_columns(self, task: CaseTask) -> Row:
        row: Row = {}
        for point, q in (("start", task.via_q[0]), ("goal", task.via_q[-1])):
            row |= {f"{point}_q_{k + 1}": float(value) for k, value in enumerate(q)}
            place = np.array(self._tool(q))[:3, 3]
            row |= {f"{point}_{axis}": float(x) for axis, x in zip(AXES, place, strict=True)}
        return row

    def _new_solver(self, robot: Robot, via: FloatArray, *, compiled: bool) -> TimeOptimalSolver:
        settings = {k: self.study.settings[k] for k in ("mesh", "starts", "seed")}
        return TimeOptimalSolver(robot, via, compiled=compiled, **settings)


def _certified(name: str, robot: Robot, task: CaseTask, motion: Motion) -> Entry:
    certificate = certify(robot, motion, via_q=task.via_q)
    return Entry(name, "", motion, certificate, motion.status, motion.advice)


def _is_certified(entry: Entry) -> bool:
    """Return whether an entry is solved and its certificate passed."""
    return entry.status.solved and entry.certificate is not None and entry.certificate.ok


def _key(values: Mapping[str, FloatArray]) -> tuple[tuple[str, bytes], ...]:
    """Return the key of a prepared solver: bytes of masses, friction and gravity."""
    return tuple((name, np.asarray(values[name]).tobytes()) for name in DYNAMICS if name in values)


def limit_shares(study: Study, robot: Robot, motion: Motion) -> dict[str, float]:
    """Return the share of the duration at each limit, by the name of the limit's column."""
    history = limit_history(robot, motion)
    weight = np.gradient(history.t)
    return {
        name: float(weight[history.use[key][:, k] >= AT_LIMIT].sum() / weight.sum())
        for key, k, name in study.limit_columns
        if key in history.use
    }


def inputs(study: Study, case: int, numbers: FloatArray) -> Row:
    """Return the columns of a case that are known before it is solved."""
    row: Row = {"case": case, "seed": study.settings["seed"], "version": versions()}
    return row | dict(zip(study.source.columns, map(float, numbers), strict=True))


def ended(study: Study, status: Status, reason: str) -> Row:
    """Return the outcome columns of a case that no method could finish."""
    row: Row = {"status": str(status), "reason": " ".join(reason.split())}
    return row | {f"{name}_status": str(status) for name in study.methods}


def repeat_case(study: Study, case: int) -> tuple[Row, dict[str, bytes]]:
    """Solve one case of a study in this process; return its row and motions (bytes of ``.npz``).

    Raises
    ------
    InputError
        There is no such case.
    """
    if not 0 <= case < study.source.count:
        raise InputError(f"case must be from 0 to {study.source.count - 1}, not {case}")
    return CaseSolver(study.plan()).row(case, study.source.rows(case, case + 1)[0])


def _as_bytes(motion: Motion) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "motion.npz"
        motion.save(path)
        return path.read_bytes()
