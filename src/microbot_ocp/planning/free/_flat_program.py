"""The flat program of a free motion: spline coefficients and durations are unknown, no states.

A fully actuated arm is flat: torques are functions of q(t) and its derivatives. Only the position
is unknown, as a cubic spline with a piecewise linear acceleration. Phases share velocities and
accelerations at via points, and each has one duration. Limits are rows; there are no equations.

Theory: docs/theory/flat.md.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LimitFamily
from microbot_ocp.ocp import OptimalControlProblem, Solution, SolverSettings
from microbot_ocp.ocp.problem import with_phases, with_values
from microbot_ocp.ocp.solution import StartingPoint
from microbot_ocp.ocp.solvers import LEAST_WARM_BARRIER
from microbot_ocp.ocp.transcription import Guess, Meshes, Program, guess_table, mesh_of
from microbot_ocp.planning.free._flat_evaluation import (
    FlatEvaluation,
    FlatProgram,
    FlatStructure,
    functions_of,
)
from microbot_ocp.planning.free._flat_layout import FlatLayout, resampled
from microbot_ocp.planning.free._flat_loops import Form
from microbot_ocp.planning.free._flat_rows import (
    POINT_KEYS,
    FlatRows,
    Scales,
    flat_rows,
    window_places,
)
from microbot_ocp.planning.free._initial_guesses import guess_along
from microbot_ocp.planning.free._point_limits import (
    FRICTION_RATE,
    HELD,
    RATED,
    point_limits,
    without_distances,
)
from microbot_ocp.planning.free._problem import JERK_WEIGHT, free_problem, phase_shapes
from microbot_ocp.planning.free._spline import DEGREE, SplineLayout, spline_layout
from microbot_ocp.planning.task import (
    ROUGH_TOLERANCE,
    Conditions,
    Task,
    TaskScale,
    dry_friction,
    finite_scale,
    has_windows,
)
from microbot_ocp.robot import Robot

# Tolerance of stationarity, scaled, of stiff programs if the mesh is refined afterwards: two thirds
# of the iterations of a Panda go from here to ROUGH_TOLERANCE, and change its duration by 3e-7.
ROUGH_DUAL = 1e-4
SLOWING = 1.2  # factor between two durations of a guess that is slowed down
GROSS_EXCESS = 10.0  # scaled excess of a limit above which a guess is slowed down
# A barrier problem of IPOPT is solved to this multiple of its barrier parameter, which it reduces
# down to the tolerance of complementarity divided by one more (Waechter and Biegler 2006, eq. 7).
BARRIER_FACTOR = 10.0
ROUGH_FACTOR = 2.0  # complementarity at which a rough solve ends, per barrier parameter of the next
LEAST_RATIO = 0.1  # shortest phase per longest: a guess for a shorter one from rest may diverge
LEAST_INTERVALS = 4  # smallest number of intervals of a phase, for one inner coefficient


@dataclass(eq=False)
class FlatTranscription:
    """Problem of a free motion in the unknowns of the flat program, for any mesh.

    It replaces a :class:`~microbot_ocp.ocp.transcription.Transcription` of the problem.

    Attributes
    ----------
    problem : OptimalControlProblem
        Problem with states, for the names of phases and the parameters in use.
    families : tuple of LimitFamily
        Limits of each phase.
    conditions : Conditions
    size : TaskScale
    payload : bool
        True if the phases have the parameter "payload".
    widened : mapping from a key to (lower, upper), each [n]
        Bounds of the first phase for a start beyond the limits of its family.
    """

    problem: OptimalControlProblem
    families: tuple[LimitFamily, ...]
    conditions: Conditions
    size: TaskScale
    payload: bool = False
    widened: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._structures: dict[tuple[bytes, ...], FlatStructure] = {}
        asked = [
            tuple(k for k in f.keys if k not in (*POINT_KEYS, "taud", "qddd"))
            for f in self.families
        ]
        keys = [_with_rated(family, k) for family, k in zip(self.families, asked, strict=True)]
        phases = [(f.robot, k) for f, k in zip(self.families, keys, strict=True)]
        # Equal phases share one object; a cache that several threads fill may return two.
        limits = {phase: point_limits(*phase, self.payload) for phase in dict.fromkeys(phases)}
        self.limits = tuple(limits[phase] for phase in phases)

    def with_parameters(self, values: Mapping[str, Mapping[str, Any]]) -> FlatTranscription:
        """Return the transcription with other values of phase parameters, by phase and name."""
        changed = copy.copy(self)
        phases = (with_values(p, values.get(p.name, {})) for p in self.problem.phases)
        changed.problem = with_phases(self.problem, phases)
        return changed

    def under(
        self,
        family: LimitFamily,
        conditions: Conditions,
        size: TaskScale,
        widened: Mapping[str, tuple[FloatArray, FloatArray]],
    ) -> FlatTranscription:
        """Return the transcription with the numbers of other limits and conditions."""
        changed = copy.copy(self)
        changed.families = (family,) * len(self.families)
        changed.conditions, changed.size, changed.widened = conditions, size, widened
        return changed

    def _bounds(self, phase: int, key: str) -> tuple[FloatArray, FloatArray]:
        """Return bounds [n] of a joint's limit in a phase."""
        if phase == 0 and key in self.widened:
            return self.widened[key]
        return self.families[phase].robot.limits.bounds(key)

    def _meshes(self, meshes: Meshes) -> list[FloatArray]:
        count = len(self.families)
        several = isinstance(meshes, Sized) and getattr(meshes, "ndim", 1) > 0
        chosen: list[Any] = list(meshes) if several else [meshes] * count  # type: ignore[arg-type]
        return [mesh_of(max(m, LEAST_INTERVALS) if isinstance(m, int) else m) for m in chosen]

    def layouts(self, meshes: Meshes) -> tuple[FlatLayout, ...]:
        """Return the layout of every phase on a mesh for each."""
        return self.program(meshes).layouts

    def structure(self, meshes: Sequence[FloatArray]) -> FlatStructure:
        """Return the structure of the program on meshes, whatever its numbers; cached."""
        key = *(mesh.tobytes() for mesh in meshes), self._kinds
        if key not in self._structures:
            if len(self._structures) >= 8:
                self._structures.pop(next(iter(self._structures)))
            self._structures[key] = self._made(meshes)
        return self._structures[key]

    @property
    def _kinds(self) -> bytes:
        """Key of the kinds of joint limits and of the jumps of accelerations."""
        keys = (*POINT_KEYS, "taud", "qddd")
        limits = [f.robot.limits.bounds(key) for f in self.families for key in keys]
        return np.isfinite(limits).tobytes() + bytes(self._jumps)

    @property
    def _jumps(self) -> list[bool]:
        """True for each via point at which the acceleration jumps; never at both ends."""
        return [False, *(end.acceleration_jumps for end in self.conditions.ends[1:-1]), False]

    def _made(self, meshes: Sequence[FloatArray]) -> FlatStructure:
        layout = spline_layout(meshes, self.families[0].robot.joint_count, self._jumps)
        rows = flat_rows(layout, self.families, self.limits, self.conditions)
        return FlatStructure(rows, *window_places(rows))

    @property
    def _starts(self) -> FloatArray:
        """Positions [m-1,n] at the start of the phases, zero for free ones."""
        low, high = np.array([end.q for end in self.conditions.ends[:-1]]).swapaxes(0, 1)
        known = np.isfinite(low) & np.isfinite(high)
        return 0.5 * (np.where(known, low, 0.0) + np.where(known, high, 0.0))

    def _scales(self, structure: FlatStructure) -> Scales:
        layout = structure.rows.layout
        size, n = self.size, layout.count
        limits = self.families[0].robot.limits
        motion = np.array(
            [
                np.full(n, size.position),
                finite_scale(*limits.bounds("qd"), otherwise=size.velocity),
                finite_scale(*limits.bounds("qdd"), otherwise=size.acceleration),
            ]
        )
        unknowns = np.full(layout.size, size.position)
        for inner, duration in zip(layout.inner, size.durations, strict=True):
            if duration < size.durations.max():
                unknowns[inner] *= duration / size.durations.max()
        for _, v, before, after in layout.nodes:
            unknowns[v : v + n] = motion[1]
            unknowns[before : before + n] = unknowns[after : after + n] = motion[2]
        unknowns[layout.durations] = size.time
        torque = self.limits[0].torque_scale  # independent of the current limits
        torque = torque if torque.size else np.ones(n)
        rate = finite_scale(*limits.bounds("taud"), otherwise=size.acceleration / size.time)
        jerk = finite_scale(*limits.bounds("qddd"), otherwise=size.jerk)
        return Scales(unknowns, motion, torque, rate, jerk, size.durations)

    def program(self, meshes: Meshes) -> FlatProgram:
        """Return the program on a mesh for each phase."""
        chosen = self._meshes(meshes)
        structure = self.structure(chosen)
        rows, phases, scales = structure.rows, self.problem.phases, self._scales(structure)
        values = [{p.name: float(p.value[0]) for p in phase.parameters} for phase in phases]
        # Kernels ignore numbers that their problem does not have; zero would be divided by.
        held = np.array([[known.get(key, 1.0) for key in HELD] for known in values])
        pairs = sorted({pair for limit in rows.limits for pair in limit.pairs})
        form = Form(
            joints=rows.layout.count,
            rows=rows.at_points.shape[1],
            points=rows.layout.points,
            torques=rows.torques,
            friction=rows.friction,
            pairs=np.array(pairs),
            scales=scales,
            starts=self._starts,
            jerk_weight=values[0][JERK_WEIGHT] / self.size.jerk**2,
        )
        evaluation = FlatEvaluation(structure, form, held[rows.phase])
        functions = functions_of(structure, evaluation)
        x = ca.MX.sym("x", rows.layout.size)
        f, g = functions["values"].call([x])
        low, high = self._variable_bounds(structure, scales)
        layouts = tuple(
            FlatLayout(phase, mesh, k, rows, scales, family, form.starts[k], low == high)
            for k, (phase, mesh, family) in enumerate(
                zip(phases, chosen, self.families, strict=True)
            )
        )
        return FlatProgram(
            low,
            high,
            *self._row_bounds(structure, scales),
            layouts=layouts,  # type: ignore[arg-type]
            nlp={"x": x, "f": f, "g": g},
            functions=functions,
            parameters=np.zeros(0),
            cost_scale=self.size.time,
            structure=structure,
            evaluation=evaluation,
        )

    def _variable_bounds(
        self, structure: FlatStructure, scales: Scales
    ) -> tuple[FloatArray, FloatArray]:
        layout, n = structure.rows.layout, structure.rows.layout.count
        low, high = np.full(layout.size, -np.inf), np.full(layout.size, np.inf)
        low[layout.durations], high[layout.durations] = self.size.shortest, self.size.longest
        for k, (places, end) in enumerate(zip(layout.nodes, self.conditions.ends, strict=True)):
            beside = [j for j in (k - 1, k) if 0 <= j < len(layout.meshes)]
            keys, given = ("q", "qd", "qdd", "qdd"), (end.q, end.qd, end.qdd, end.qdd)
            for at, key, bounds in zip(places, keys, given, strict=True):
                limits = [self._bounds(j, key) for j in beside]
                low[at : at + n], high[at : at + n] = _within(bounds, limits)
        limits = self.families[0].robot.limits
        held = (limits.qdd_min == 0.0) & (limits.qdd_max == 0.0)
        if held.any():
            positions, start = [q // n for q, *_ in layout.nodes], low[:n][held]
            for table in (low, high):
                of_joints = table[: layout.durations.start].reshape(-1, n)
                of_joints[:, held] = 0.0
                of_joints[np.ix_(positions, held)] = start
        return low / scales.unknowns, high / scales.unknowns

    def _row_bounds(
        self, structure: FlatStructure, scales: Scales
    ) -> tuple[FloatArray, FloatArray]:
        rows = structure.rows
        low, high = np.full(rows.height, -np.inf), np.full(rows.height, np.inf)
        for k, family in enumerate(self.families):
            mine, limits = rows.phase == k, rows.limits[k]
            of_limits = limits.bounds(family, {} if k else self.widened)
            spans = (rows.lengths()[mine] * scales.durations[k])[:, None]
            for side, bound in enumerate((low, high)):
                motion = np.array([self._bounds(k, key)[side] for key in POINT_KEYS])
                rate = (self._bounds(k, "taud")[side] / scales.rate)[rows.torques]
                for numbers, sizes in (
                    (rows.at_points[mine, : limits.count], of_limits[side]),
                    (rows.of_motion[mine], motion / scales.motion),
                    # A row is a torque difference times (typical / actual duration): its bound is
                    # the rate times half an interval of the typical duration.
                    (rows.of_rates[mine], spans * rate),
                    (rows.of_jerks[mine], self._bounds(k, "qddd")[side] / scales.jerk),
                ):
                    there = numbers >= 0
                    bound[numbers[there]] = np.broadcast_to(sizes, numbers.shape)[there]
        for stop in rows.at_stops:
            low[stop.numbers], high[stop.numbers] = stop.bounds
        return low, high

    @cached_property
    def is_stiff(self) -> bool:
        """True with limits of jerks or torque rates, or with dry friction.

        Stationarity is then reached slowly, and the next mesh changes the solution anyway.
        """
        return any(f.jerk_matters or has_windows(f) for f in self.families)

    def solver_settings(
        self, program: Program, settings: SolverSettings, first: float | None, last: float
    ) -> SolverSettings:
        """Return solver settings of the flat program, with its first and last barrier parameter.

        Complementarity costs duration, and the last barrier parameter bounds it. Stationarity
        cannot be as exact: an acceleration is a coefficient divided by the square of an interval,
        and on short intervals rounding dominates it.
        """
        rough = self.is_stiff and not np.isfinite(settings.gap)
        end = ROUGH_FACTOR * LEAST_WARM_BARRIER if rough else (BARRIER_FACTOR + 1.0) * last
        given: dict[str, Any] = {
            "linear_solver": "band",
            "nlp_scaling_method": "none",  # rows and unknowns are scaled already
            "compl_inf_tol": end,
        }
        tolerance = max(settings.tolerance, ROUGH_DUAL if rough else ROUGH_TOLERANCE)
        if first is not None:
            # IPOPT reduces its barrier parameter only at a stationary point: begin with the last.
            given["mu_init"] = last if self.is_stiff and not rough else first
            if rough:  # the first barrier problem is solved no more exactly than the program
                given["barrier_tol_factor"] = max(BARRIER_FACTOR, tolerance / first)
        more = dict(settings.options.get("ipopt", {}))
        more.pop("linear_solver", None)
        given |= more
        options = {**settings.options, "ipopt": given}
        return replace(settings, tolerance=tolerance, options=options)

    # starts -----------------------------------------------------------------------------------

    def starting_point(self, program: FlatProgram, guess: Any) -> StartingPoint:
        """Return unknowns from guesses of q, qd and qdd, or from an earlier solution."""
        layout, names = program.structure.rows.layout, [p.name for p in self.problem.phases]
        if isinstance(guess, Solution):
            olds = [phase.layout for phase in guess.phases]
            if all(isinstance(old, FlatLayout) for old in olds) and guess.variables is not None:
                return self._from_solution(program, guess)
            guess = {n: guess_along(s) for n, s in zip(names, phase_shapes(guess), strict=True)}
        motion = []
        for name, mesh in zip(names, layout.meshes, strict=True):
            given: Guess = guess[name]
            tables = [
                guess_table(given.values.get(key, 0.0), layout.count, mesh) for key in POINT_KEYS
            ]
            motion.append((float(given.duration or 1.0), np.array(tables)))
        x = self._packed(layout, motion, self._starts) / program.scales.unknowns
        if any(family.jerk_matters for family in self.families):
            x = self._slowed(program, x)
        return StartingPoint(self._inside(program, x))

    def _slowed(self, program: FlatProgram, x: FloatArray) -> FloatArray:
        """Return unknowns of a motion slowed down until it exceeds no limit grossly.

        Rates grow with the cube of the speed. From far beyond the limits, as torque rates of a
        curved guess are, a solve takes several times the iterations. Slowing down ends where it
        does not help, because gravity alone exceeds a torque.
        """
        layout = program.structure.rows.layout
        n = layout.count
        # Coefficients between via points are products of a rate and the power of the duration.
        factors = np.ones(layout.size)
        factors[layout.durations] = SLOWING
        for _, v, before, after in layout.nodes:
            factors[v : v + n] = 1.0 / SLOWING
            factors[before : before + n] = factors[after : after + n] = SLOWING**-2
        excess, slower = np.inf, x
        while (slower <= program.variable_upper)[layout.durations].all():
            rows = program.row_values(self._inside(program, slower))
            over = np.maximum(rows - program.row_upper, program.row_lower - rows)
            least, excess = excess, float(over.max(initial=0.0))
            if not excess < least:
                break
            x, slower = slower, factors * slower
            if excess <= GROSS_EXCESS:
                break
        return x

    @staticmethod
    def _inside(program: FlatProgram, x: FloatArray) -> FloatArray:
        fixed = program.variable_lower == program.variable_upper
        return np.where(fixed, program.variable_lower, x)

    @staticmethod
    def _packed(
        layout: SplineLayout, motion: Sequence[tuple[float, FloatArray]], starts: FloatArray
    ) -> FloatArray:
        """Return unknowns from durations and motion [3,N+1,n] at the mesh points of all phases.

        A coefficient is the blossom of the spline's polynomial at three consecutive knots, here
        around a mesh point: q + T v (b - a) / 3 - T^2 w a b / 6, with the acceleration w and the
        lengths a and b of the intervals before and after.
        """
        x, n = np.zeros(layout.size), layout.count
        for k, (T, (q, v, a)) in enumerate(motion):
            h = np.diff(layout.meshes[k])
            before, after = h[1:-2, None], h[2:-1, None]
            inner = slice(2, -2)
            c = (
                q[inner]
                - starts[k]
                + T * v[inner] * (after - before) / DEGREE
                - T**2 * a[inner] * before * after / 6.0
            )
            x[layout.inner[k]] = c.ravel()
            x[layout.durations.start + k] = T
            for (at_q, at_v, end, start), j in ((layout.nodes[k], 0), (layout.nodes[k + 1], -1)):
                x[at_q : at_q + n], x[at_v : at_v + n] = q[j], v[j]
                at = start if j == 0 else end
                x[at : at + n] = a[j]
        return x

    def _from_solution(self, program: FlatProgram, guess: Solution) -> StartingPoint:
        layout, scales = program.structure.rows.layout, program.scales
        olds: list[Any] = [phase.layout for phase in guess.phases]
        assert guess.variables is not None
        same = all(np.array_equal(o.mesh, m) for o, m in zip(olds, layout.meshes, strict=True))
        old_rows = olds[0].rows_of_all
        pairs = zip(guess.phases, layout.meshes, strict=True)
        motion = [(phase.duration, resampled(phase, mesh)) for phase, mesh in pairs]
        packed = self._packed(layout, motion, self._starts)
        x = self._inside(program, packed / scales.unknowns)
        multipliers = guess.row_multipliers, guess.variable_multipliers
        if not guess.status.solved or multipliers[1] is None:
            return StartingPoint(x)
        if same and old_rows.height == program.structure.rows.height:
            return StartingPoint(x, *multipliers)
        # Multipliers at via points and of durations carry over; inner coefficients have no bounds.
        moved = _moved_rows(old_rows, program.structure.rows, multipliers[0])
        variables, old_layout, n = np.zeros(layout.size), old_rows.layout, layout.count
        for old, new in zip(old_layout.nodes, layout.nodes, strict=True):
            for a, b in zip(old, new, strict=True):
                variables[b : b + n] = multipliers[1][a : a + n]
        variables[layout.durations] = multipliers[1][old_layout.durations]
        return StartingPoint(x, moved, variables)


def _with_rated(family: LimitFamily, keys: Sequence[str]) -> tuple[str, ...]:
    """Return the keys of limits at points with the torques whose differences are rates.

    These come first, in the order of the joints. At a reversal dry friction jumps, and no rate of
    it is limited.
    """
    if "taud" not in family:
        return tuple(keys)
    if dry_friction(family.robot).any():
        return RATED, FRICTION_RATE, *keys
    return "tau", *(key for key in keys if key != "tau")


@lru_cache(maxsize=16)
def flat_form(
    robot: Robot,
    via_bytes: bytes,
    count: int,
    *,
    payload: bool = False,
    conditions: Conditions | None = None,
) -> FlatTranscription | None:
    """Return the flat transcription of a free motion's problem; None if it needs states.

    It needs states with means over the motion, further limits other than distances, ends in motion,
    and a segment far shorter than others.
    """
    deadline.check()  # the functions of seven joints take a second
    via = np.frombuffer(via_bytes).reshape(count, -1)
    family = LimitFamily.of(robot)
    given = conditions or Task.through(family, via).conditions
    families = tuple(LimitFamily.of(moving) for moving in given.robots)
    size = TaskScale.of(family, via)
    if not _is_flat(families, given, size):
        return None
    # It gives phases their names and parameters: expressions of distances would take a tenth of a
    # second for every scene.
    bare = replace(given, robots=tuple(map(without_distances, given.robots)))
    problem = free_problem(without_distances(robot), via, payload=payload, conditions=bare)
    return FlatTranscription(problem, families, given, size, payload)


def _is_flat(families: Sequence[LimitFamily], conditions: Conditions, size: TaskScale) -> bool:
    keys = set[tuple[str, ...]]()
    for family in families:
        own = [member.limit for member in family if member.limit is not None]
        if family.means or not all(limit.knows_derivatives for limit in own):
            return False
        keys.add(tuple(key for key in family.keys if family[key].limit is None))
    start, *_, end = conditions.ends
    moves = not conditions.closed and not all(np.all(b == 0.0) for p in (start, end) for b in p.qd)
    short = not size.durations.min() >= LEAST_RATIO * size.durations.max() > 0.0
    return len(keys) == 1 and not (moves or short)


def _within(
    given: Any, beside: Sequence[tuple[FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Return bounds at a via point: the given ones, within those of the limits on both sides."""
    lower, upper = (-np.inf, np.inf) if given is None else given
    fixed = np.isfinite(lower) & np.isfinite(upper)
    low = np.maximum(lower, np.max([bounds[0] for bounds in beside], axis=0))
    high = np.minimum(upper, np.min([bounds[1] for bounds in beside], axis=0))
    return np.where(fixed, lower, low), np.where(fixed, upper, high)


def _moved_rows(old: FlatRows, new: FlatRows, values: FloatArray) -> FloatArray:
    """Return multipliers of rows on another mesh, with the same density along the phase.

    A multiplier of a difference of torques is a costate of the torque and keeps its value.
    """
    moved = np.zeros(new.height)
    places = [_fractions(rows) for rows in (old, new)]
    for index, (before, after) in enumerate(zip(old.tables, new.tables, strict=True)):
        before, after = (table.reshape(len(table), -1) for table in (before, after))
        for phase in range(len(new.layout.meshes)):
            for column in range(min(before.shape[1], after.shape[1])):
                there = [
                    np.flatnonzero((rows.phase == phase) & (table[:, column] >= 0))
                    for rows, table in ((old, before), (new, after))
                ]
                if not all(points.size for points in there):
                    continue
                (s_old, w_old), (s_new, w_new) = (
                    (fractions[points], np.ones(points.size) if index == 2 else weights[points])
                    for (fractions, weights), points in zip(places, there, strict=True)
                )
                density = values[before[there[0], column]] / w_old
                moved[after[there[1], column]] = np.interp(s_new, s_old, density) * w_new
    return moved


def _fractions(rows: FlatRows) -> tuple[FloatArray, FloatArray]:
    """Return the fraction of its phase at every point, and the length that belongs to the point."""
    fractions, weights = [], []
    for mesh in rows.layout.meshes:
        s = np.empty(2 * mesh.size - 1)
        s[::2], s[1::2] = mesh, 0.5 * (mesh[:-1] + mesh[1:])
        h = np.diff(s)
        fractions.append(s)
        weights.append(0.5 * (np.append(h, 0.0) + np.insert(h, 0, 0.0)))
    return np.concatenate(fractions), np.concatenate(weights)
