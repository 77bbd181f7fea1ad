"""One task solved again and again, with limits and payload as numeric parameters."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError, naming
from microbot_ocp._base.codegen import interpreted
from microbot_ocp._base.status import Status
from microbot_ocp.limits import (
    JOINT_QUANTITIES,
    LIMIT_TOLERANCE,
    JointLimits,
    LimitFamily,
    Limits,
    MotionSamples,
    with_reserve,
)
from microbot_ocp.motion import DurationLine, Motion, State
from microbot_ocp.ocp import Solution, SolverSettings
from microbot_ocp.ocp.solution import quiet, unpack
from microbot_ocp.ocp.starts import with_changes
from microbot_ocp.ocp.transcription import Transcription
from microbot_ocp.planning.free import (
    JERK_WEIGHT,
    OF_VARIABLES,
    FlatTranscription,
    InitialGuess,
    flat_form,
    phase_names,
    transcription,
)
from microbot_ocp.planning.search._problem import MotionProblem
from microbot_ocp.planning.search._queue import Level
from microbot_ocp.planning.search._refinement import (
    FAR_BARRIER,
    from_barrier,
    search_of,
)
from microbot_ocp.planning.search._result import Fastest, fastest, motion_from
from microbot_ocp.planning.search._search import NOTHING, START, MotionAnswer
from microbot_ocp.planning.search._settings import TimeOptimalSettings
from microbot_ocp.planning.task import (
    JERK_SMOOTHING,
    LDL,
    TIME_LIMIT,
    EndConditions,
    Task,
    TaskScale,
    bounds_in_program,
    check_limits,
    check_via,
    locked_joints,
    with_drives_noted,
    with_locked_joints_held,
)
from microbot_ocp.robot import Robot

# Relative difference of durations up to which a known motion counts as near the new optimum.
NEAR = 0.1
REFERENCE_TOLERANCE = 2e-3  # relative excess of limits of the prepared motion between mesh points

TOLERANCE = 1e-6  # default of the solver tolerance, relative
PREPARED = SolverSettings(max_iterations=150, options=LDL)  # a user waits for each solve


class _StateAtStart(NamedTuple):
    """State [1,n] of the arm at the start of a motion, and the bounds that it widens.

    Attributes
    ----------
    state : State
    acceleration_given : bool
    bounds : dict
        Lower and upper bounds by key, widened to contain the state.
    tolerance : float
        Accepted relative excess over limits: that of the state, plus that of any motion.
    """

    state: State
    acceleration_given: bool
    bounds: dict[str, tuple[FloatArray, FloatArray]]
    tolerance: float


def _start_of(family: LimitFamily, given: Sequence[ArrayLike]) -> _StateAtStart:
    if len(given) not in (2, 3):
        raise InputError(f"start must be (q, qd) or (q, qd, qdd), not {len(given)} arrays")
    count = family.robot.joint_count
    names = ("q of start", "qd of start", "qdd of start")
    rows = [
        checks.array(name, np.ravel(np.asarray(row)), (count,))[None]
        for name, row in zip(names, given, strict=False)
    ]
    complete = len(rows) == 3
    state = State(rows[0], rows[1], rows[2] if complete else np.zeros((1, count)))
    # A jump of the acceleration at the start makes its initial value irrelevant.
    orders = (0, 1, 2) if complete and family.jerk_matters else (0, 1)
    samples, bounds, excess = MotionSamples(*state, np.zeros((1, count))), {}, 0.0
    for key, values in family.values(samples, family.of_order(*orders)).items():
        member, use = family[key], family[key].use(values)[0]
        if (worst := int(use.argmax())) >= 0 and use[worst] > 1.0 + LIMIT_TOLERANCE:
            percent = 100.0 * (use[worst] - 1.0)
            raise InputError(
                f"start is beyond a limit: {member.title(worst)} is "
                f"{values.value[0, worst]:.6g} {member.units[worst]}, {percent:.3g} % over"
            )
        excess = max(excess, float(use[worst]) - 1.0)
        if not member.varies:
            value = values.value[0]
            bounds[key] = np.minimum(member.lower, value), np.maximum(member.upper, value)
    tolerance = min(LIMIT_TOLERANCE, TimeOptimalSettings.limit_tolerance + excess)
    return _StateAtStart(state, complete, bounds, tolerance)


class _Prepared(NamedTuple):
    """Result of the solve under the robot's own limits, kept for other solves."""

    reference: Solution
    smoothing: float


class TimeOptimalSolver:
    """Solver for the fastest motion through via points, for changing limits and payloads.

    The kernels of the program are built once; limits, payload and via points are numbers in it. The
    first call solves the task with the robot's own limits as :func:`microbot_ocp.time_optimal`
    does, with fewer refinements. Every later solve starts from that motion and its multipliers, so
    that results do not depend on the order of calls; if the limits are far from the robot's own, it
    starts from that motion at another speed. With other via points it starts from their own scaled
    cubic. The mesh is refined as in a first solve, and the motion is slowed down if it still
    exceeds limits by more than the default ``limit_tolerance`` of :class:`TimeOptimalSettings`.

    Threads may call one solver concurrently. Copies and pickles, for other processes, contain the
    motion under the robot's own limits; kernels are rebuilt.

    Parameters
    ----------
    robot : Robot
        Robot with limits. A kind of limit that it lacks (say, torque rates) cannot be added
        later.
    via_q : array_like [m,n]
        Via points, rad (prismatic: m).
    mesh : int
        Intervals of each phase before refinement.
    starts : int
        Number of initial guesses of a search.
    rounds : int
        Largest number of refinements.
    compiled : bool
        Compile the kernels to C if there is a compiler.
    seed : int
        Seed of the random starts.
    tolerance : float
        Solver tolerance, relative. Below the default, the weight of the squared jerk decreases in
        proportion. The default leaves some 1e-4 of the duration, and slopes right to some percent;
        1e-8 leaves 1e-6 for a fifth more iterations.

    Raises
    ------
    InputError
        As :func:`microbot_ocp.time_optimal`.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> via_q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])
    >>> solver = mo.TimeOptimalSolver(mo.load_robot("microbot"), via_q)
    >>> round(solver().duration, 2), round(solver(payload=0.5).duration, 2)
    (1.92, 2.26)
    """

    def __init__(
        self,
        robot: Robot,
        via_q: ArrayLike,
        *,
        mesh: int = 80,
        starts: int = 5,
        rounds: int = 8,
        compiled: bool = True,
        seed: int = 0,
        tolerance: float = TOLERANCE,
    ) -> None:
        checks.whole("mesh", mesh, "intervals", at_least=4)
        checks.whole("rounds", rounds, at_least=0)
        checks.number("tolerance", tolerance, above=0.0)
        self._tolerance = tolerance
        given = {"mesh": mesh, "starts": starts, "compiled": compiled, "seed": seed}
        self._settings = TimeOptimalSettings(limit_tolerance=REFERENCE_TOLERANCE, **given)
        self.robot, self._rounds = robot, rounds
        self.via_q = check_via(check_limits(robot, None), via_q)
        self._own: _Prepared | None = None
        self._phases = phase_names(len(self.via_q) - 1)
        self._kernels = self._transcribed()

    def _transcribed(self) -> Any:
        held: Robot = with_locked_joints_held(LimitFamily.of(self.robot)).robot
        via, compiled = self.via_q, self._settings.compiled
        flat = flat_form(held, via.tobytes(), len(via), payload=True)
        if flat is not None:
            return flat
        return transcription(held, via.tobytes(), len(via), compiled, payload=True)

    def __call__(
        self,
        limits: Limits | JointLimits | None = None,
        payload: float = 0.0,
        *,
        reserve: ArrayLike = 0.0,
        via_q: ArrayLike | None = None,
        start: Sequence[ArrayLike] | None = None,
        search: bool = False,
        time_limit: float = TIME_LIMIT,
    ) -> Motion:
        """Solve once more.

        Parameters
        ----------
        limits : Limits, optional
            Default: the robot's own.
        payload : float
            Point mass at the tool, kg; the motion is one of ``robot.with_payload(payload)``.
        reserve : float or array_like [n]
            Share of the torque limits reserved for feedback, for all joints or per joint.
        via_q : array_like [m,n], optional
            Other via points, as many as the solver was made with, rad (prismatic: m).
        start : (q, qd) or (q, qd, qdd), each array_like [n], optional
            State of the arm at the start, such as ``other.sample([t])``; its pose replaces the
            first via point. The acceleration applies under limits of jerks or torque rates, and is
            free if it is omitted; without such limits accelerations may jump. The state may exceed
            a limit by as much as a certificate tolerates.
        search : bool
            Try every initial guess, to find other local optima. By default the others are tried
            only if the motion under the robot's own limits leads to no solution.
        time_limit : float
            Wall time, s, after which the best motion so far is returned with the status
            "time limit"; infinite means no limit.

        Returns
        -------
        Motion
            ``motion.solved`` is True if the solver converged; ``motion.provenance`` is the record
            of the solve.

        Raises
        ------
        InputError
            Invalid limits or payload, a via point that cannot be held, or a start beyond the
            limits; raised before any solver starts.
        """
        with deadline.within(time_limit):
            limits = with_reserve(self.robot.limits, limits, reserve)
            family = check_limits(self.robot.with_payload(payload), limits)
            self._check_kinds(family)
            via, moving = self.via_q, None if start is None else _start_of(family, start)
            if via_q is not None:
                via = checks.array("via_q", via_q, (None, self.robot.joint_count), "rad")
            if moving is not None:
                via = np.vstack([moving.state.q, via[1:]])
            via = check_via(family, via, moving=moving is not None)
            if len(via) != len(self.via_q):
                raise InputError(
                    f"via_q must have {len(self.via_q)} points, as the solver was made with, "
                    f"not {len(via)}"
                )
            tolerance = moving.tolerance if moving else TimeOptimalSettings.limit_tolerance
            prepared = None
            if via_q is None and moving is None:
                prepared = self._own or self._under_own_limits()
            # The cost of smoothing must stay below the solver tolerance.
            weight = prepared.smoothing if prepared else JERK_SMOOTHING
            weight *= min(1.0, self._tolerance / TOLERANCE)
            settings = replace(self._settings, limit_tolerance=tolerance)
            under_way = moving is not None and bool(moving.state.qd.any())
            about = {"again": True, "moving": under_way, "weight": weight}
            problem = MotionProblem.through(family, via, settings, **about)
            # The prepared motion, at another speed if the limits are far, is one more start.
            known = prepared.reference if prepared and prepared.reference.status.solved else None
            slower = 1.0 if known is None else self._slower(family)
            near = known if abs(slower - 1.0) <= NEAR else None
            first = None
            if known is not None and near is None:
                guesses = problem.guesses(known, slower)
                first = InitialGuess("prepared, at another speed", guesses)
            tries = settings.starts
            starts = tries + (known is not None) if search else 1
            settings = replace(settings, starts=starts, tries=tries)
            kernels = self._numbered(problem, float(payload), moving)
            problem = replace(problem, given=kernels, first=first, settings=settings)
            best = self._solved(problem, near, slower)
            # Compilation does not pay: an arm with this payload is evaluated once.
            with interpreted() if payload else nullcontext():
                motion = motion_from(best)
            method = "free time-optimal motion, solved again with other numbers"
            more = {"method": method, "start": best.answer.start, "payload": float(payload)}
            motion = replace(motion, provenance={**motion.provenance, **more})
            return with_drives_noted(family.robot, motion)

    def _solved(self, problem: MotionProblem, near: Solution | None, slower: float) -> Fastest:
        """Return the fastest motion, from a known one if one is near.

        ``slower`` is the ratio of the durations that the limits of both let expect.
        """
        search = search_of(problem, quiet)
        # A tighter tolerance asks for a proportionally smaller gap.
        exact = min(1.0, self._tolerance / TOLERANCE)
        given: dict[str, Any] = {
            "rounds": self._rounds,
            "settings": replace(PREPARED, gap=exact * search.refiner.settings.gap),
            # Slopes need the digits of every solve, and a mesh that does not follow rough ones.
            "rough": search.refiner.rough if exact == 1.0 else None,
            "tolerance": min(search.refiner.tolerance, self._tolerance),
        }
        search = replace(search, refiner=replace(search.refiner, **given))
        if near is None:
            return fastest(search)
        begin, refiner = time.perf_counter(), replace(search.refiner, once=True)
        if not problem.is_flat:
            # The gap of a program with states asks for a second solve.
            far = from_barrier(refiner, FAR_BARRIER)
            refiner = replace(refiner, settings=replace(far, gap=np.inf))
        solution = refiner.solve([phase.mesh for phase in near.phases], near)
        expected = slower * near.duration
        if abs(solution.duration - expected) > NEAR * expected:
            solution = replace(solution, status=Status.NOT_ACCEPTED)
        later = search.refiner
        if problem.is_flat and not problem.kernels().is_stiff:
            # On a mesh that nearly fits, one exact solve takes less than a rough and a further one.
            later = replace(later, rough=None)
        about: dict[str, Any] = {"way": problem.ways[0], "step": START, "level": Level.FULL}
        about["solves"] = tuple(refiner.history)
        later = replace(later, history=[])
        answer = MotionAnswer("prepared", solution, later, problem.smoothing, **about)
        return fastest(search, NOTHING.and_(answer, begin))

    def _numbered(
        self, problem: MotionProblem, payload: float, moving: _StateAtStart | None
    ) -> Transcription | FlatTranscription:
        """Return the program with the numbers of one call."""
        numbers = {"payload": payload, JERK_WEIGHT: problem.smoothing}
        if not isinstance(self._kernels, FlatTranscription):
            changes = self._changes(problem, numbers, moving)
            phases = self._kernels.problem.phases
            return self._kernels.with_phases(
                with_changes(phase, changed) for phase, changed in zip(phases, changes, strict=True)
            )
        family = with_locked_joints_held(problem.family)
        conditions, widened = Task.through(family, problem.via).conditions, {}
        if moving is not None:
            q, qd, qdd = (part[0] for part in moving.state)
            given = moving.acceleration_given and family.jerk_matters
            start = EndConditions((q, q), (qd, qd), qdd=(qdd, qdd) if given else None)
            conditions = replace(conditions, ends=(start, *conditions.ends[1:]))
            widened = moving.bounds
        kernels = self._kernels.under(family, conditions, problem.scale, widened)
        return kernels.with_parameters(dict.fromkeys(self._phases, numbers))

    def along(
        self,
        name: str,
        values: ArrayLike,
        *,
        joint: int | None = None,
        time_limit: float = TIME_LIMIT,
    ) -> DurationLine:
        """Return the shortest duration over one parameter, with slopes and binding limits.

        Parameters
        ----------
        name : str
            "payload", "reserve", or a limit that means plus and minus, such as "tau_max".
        values : array_like [K]
            Values in the parameter's SI unit.
        joint : int, optional
            Index of the joint of the limit or reserve, from 0; default all joints.
        time_limit : float
            Wall time of each solve, s.

        Returns
        -------
        DurationLine

        Raises
        ------
        InputError
            Unknown name or joint, and errors of a call.

        Examples
        --------
        >>> import numpy as np
        >>> import microbot_ocp as mo
        >>> via_q = np.radians([[0, 0, 0], [-90, 90, 90]])
        >>> solver = mo.TimeOptimalSolver(mo.load_robot("microbot"), via_q)
        >>> line = solver.along("tau_max", [150.0, 200.0], joint=2)
        >>> bool(line.duration[1] < line.duration[0]), bool((line.slope < 0.0).all())
        (True, True)
        """
        usual, count = self.robot.limits, self.robot.joint_count
        keys = {f"{key}_max": key for key in JOINT_QUANTITIES if key != "q"}
        checks.one_of("name", name, ("payload", "reserve", *keys))
        if joint is not None:
            checks.whole("joint", joint, at_least=0, at_most=count - 1)
        chosen = np.ones(count) if joint is None else np.eye(count)[joint]
        given = checks.array("values", values, (None,))
        T, slopes, binding = np.full(given.size, np.nan), np.full(given.size, np.nan), []
        for k, value in enumerate(given.tolist()):
            limits, payload = usual, 0.0
            if name == "payload":
                payload = value
            elif name == "reserve":
                limits = usual.with_reserve(value * chosen)
            else:
                bounds = np.where(chosen > 0.0, value, getattr(usual, name))
                limits = usual.changed({name: bounds})
            with naming(f"{name} {value:g}: "):
                motion = self(limits, payload, time_limit=time_limit)
            binding.append(frozenset())
            if not motion.solved:
                continue
            prices = motion.sensitivities(self.robot.with_limits(limits), payload)
            T[k], binding[k] = motion.duration, prices.binding
            if name == "payload":
                slopes[k] = prices.payload_mass
                continue
            key = keys.get(name, "tau")
            lower, upper = usual.bounds(key) if name == "reserve" else (-chosen, chosen)
            slope = (prices.lower[key] * lower + prices.upper[key] * upper) @ chosen
            slopes[k] = -slope if name == "reserve" else slope
        units = {"payload": "kg", "reserve": ""}
        unit = units[name] if name in units else self.robot.unit(keys[name], joint or 0)
        return DurationLine(name, unit, given, T, slopes, tuple(binding))

    def _slower(self, family: LimitFamily) -> float:
        """Return the typical duration under the limits of a family, relative to the own ones."""
        usual, requested = (
            TaskScale.of(limits_family, self.via_q).durations.sum()
            for limits_family in (LimitFamily.of(self.robot), family)
        )
        return requested / usual

    # Concurrent first calls each find their own motion, and the last one is kept: no call waits for
    # another beyond its own time limit.

    def _under_own_limits(self) -> _Prepared:
        family = LimitFamily.of(self.robot)
        problem = MotionProblem.through(family, self.via_q, self._settings, given=self._kernels)
        search = search_of(problem, quiet)
        # A gap of infinity ends at the barrier parameter from which later solves start.
        settings = replace(search.refiner.settings, gap=np.inf)
        search = replace(search, refiner=replace(search.refiner, settings=settings))
        answer = fastest(search).answer
        # Later solves keep the smoothing of this motion, or their optimum would differ from it.
        prepared = _Prepared(answer.solution, answer.smoothing)
        if answer.solved and not deadline.over():
            self._own = prepared
        return prepared

    def _changes(
        self, problem: MotionProblem, numbers: Mapping[str, float], moving: _StateAtStart | None
    ) -> list[dict[str, Any]]:
        """Return the numbers of each phase of the program with states."""
        size, via = problem.scale, problem.via
        family, own = with_locked_joints_held(problem.family), LimitFamily.of(self.robot)
        declared = {c.name for c in self._kernels.problem.phases[0].constraints}
        pairs = {key: family.robot.limits.bounds(key) for key in OF_VARIABLES}
        for member in family:
            if member.name in declared:
                given = member.lower, member.upper
                pairs[member.name] = bounds_in_program(own[member.key], given)
        # Released bounds at the start imply that a locked joint keeps its given position: the
        # program has no other condition for it.
        free = np.where(locked_joints(own), np.inf, 0.0)

        def at(point: FloatArray) -> dict[str, Any]:
            return {"q": (point - free, point + free)} if not free.all() else {}

        changes: list[dict[str, Any]] = [
            {
                "initial": at(start),
                "bounds": pairs,
                "parameters": numbers,
                "durations": (shortest, longest),
            }
            for start, shortest, longest in zip(via[:-1], size.shortest, size.longest, strict=True)
        ]
        changes[-1]["final"] = at(via[-1])
        first = changes[0]
        first["initial"] = {"q": via[0]}
        if moving is not None:
            names = {key: key if key in OF_VARIABLES else family[key].name for key in moving.bounds}
            widened = {
                names[key]: bounds_in_program(own[key], pair) for key, pair in moving.bounds.items()
            }
            first["bounds"] = pairs | {name: widened[name] for name in pairs if name in widened}
            first["initial"]["qd"] = moving.state.qd[0]
            if family.jerk_matters:
                qdd = moving.state.qdd[0]
                slack = free if moving.acceleration_given else np.inf
                first["initial"]["qdd"] = (qdd - slack, qdd + slack)
        return changes

    def _check_kinds(self, family: LimitFamily) -> None:
        """Raise InputError if more than the numbers of limits change: expressions are built in."""
        declared = LimitFamily.of(self.robot)
        freed = np.flatnonzero(locked_joints(declared) & ~locked_joints(family))
        if freed.size:
            raise InputError(
                f"limits let joint {self.robot.joint_names[freed[0]]!r} move, but the solver was "
                "made for a robot that locks it"
            )
        for member in family:
            if member.key in ("q", "qdd"):  # bounds of variables exist in every program
                continue
            if member.key not in declared:
                raise InputError(
                    f"limits bound {member.key}, but the solver was made for a robot without any "
                    f"limit of {member.key}: make it with robot.with_limits(...)"
                )
            before = declared[member.key].limit
            if member.limit is not None and before is not None:
                built, requested = (
                    (m.expression, *(b for b in (m.lower, m.upper) if callable(b)))
                    for m in (before, member.limit)
                )
                if built != requested:
                    raise InputError(
                        f"limit {member.name!r} has another expression than the one that the "
                        "solver was made with: only its numbers may change"
                    )

    def __getstate__(self) -> dict[str, Any]:
        base = self._own
        plain = base and (_plain_of(base.reference), base.smoothing)
        return vars(self) | {"_own": plain, "_kernels": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._kernels = self._transcribed()
        if state["_own"] is not None:
            plain, smoothing = state["_own"]
            self._own = _Prepared(_from_plain(self._kernels, plain), smoothing)


def _plain_of(solution: Solution) -> tuple[Any, ...]:
    """Return a solution as plain data, without the kernels of the phases."""
    # Kernels hold compiled functions and cannot be pickled: meshes and parameters suffice to build
    # them again.
    phases: Any = [solved.layout.phase for solved in solution.phases if solved.layout]
    parameters = {phase.name: {p.name: p.value for p in phase.parameters} for phase in phases}
    meshes = [phase.mesh for phase in solution.phases]
    return replace(solution, phases=()), meshes, parameters


def _from_plain(kernels: Any, plain: tuple[Any, ...]) -> Solution:
    """Return the solution of plain data, with kernels that have its parameter values."""
    solution, meshes, parameters = plain
    if any(parameters.values()):
        kernels = kernels.with_parameters(parameters)
    return replace(solution, phases=unpack(kernels.layouts(meshes), solution.variables))
