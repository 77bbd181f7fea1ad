"""Independent certification of a motion: re-simulation, limits on a dense grid, consistency.

No result of the planner is reused: the limits are checked between mesh points, the torques are
recomputed, and the arm is simulated with them, segment by segment, by an integrator that knows the
forward dynamics only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.check import Check, problems_of
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.growth import growth_said
from microbot_ocp.certificate._certificate import Certificate, LimitCheck, ResimulationFigures
from microbot_ocp.certificate._resimulation import (
    NEAR_SINGULAR,
    Resimulation,
    resimulate,
    torque_sizes,
)
from microbot_ocp.limits import (
    AT_LIMIT,
    LIMIT_TOLERANCE,
    LimitFamily,
    LimitHistory,
    Member,
    MotionSamples,
    StateHistory,
)
from microbot_ocp.motion import (
    TORQUE_EXCESS,
    Motion,
    State,
    dense_times,
    history_of,
    jump_gaps,
    other_arm,
    quadrature,
    torque_along,
)
from microbot_ocp.planning.search import places_along
from microbot_ocp.planning.task import Segment, Stop, Task, is_task, task_of
from microbot_ocp.robot import JointLimits, Limits, Robot, mass_matrix_condition
from microbot_ocp.scene import Scene, clearance_along, has_coal, with_arm_capsules


class Tolerances(NamedTuple):
    """Tolerances of a certificate; see :func:`certify`."""

    limit: float = LIMIT_TOLERANCE
    position: float = 1e-3
    torque: float = 1e-5
    via: float = position


USUAL = Tolerances()


def certify(
    robot: Robot,
    motion: Motion,
    limits: Limits | JointLimits | None = None,
    *,
    via_q: ArrayLike | Sequence[Stop] | None = None,
    segments: Sequence[Segment] | None = None,
    cycle: bool = False,
    scene: Scene | None = None,
    limit_tolerance: float = LIMIT_TOLERANCE,
    position_tolerance: float = USUAL.position,
    torque_tolerance: float = USUAL.torque,
    via_tolerance: float = USUAL.via,
    simulated: bool = True,
    time_limit: float = np.inf,
) -> Certificate:
    """Check a motion against the limits and against the arm's forward dynamics.

    - Limits: on a dense grid (at least 20 points to each interval between ``motion.breaks``, 5
      if there are thousands; steps of at most 0.25 ms, longer beyond 100 s) with torques from
      inverse dynamics; the torque rate by exact differentiation. At a break both one-sided values
      count. Limits of the torque rate or the jerk allow no jump of the acceleration, neither inside
      nor at a start or end at rest, because the arm is held there before and after with the torque
      of gravity. A start or end in motion is taken as continued. The torque step of a payload that
      the tool picks up or puts down at a stop does not count as a rate.
    - Stored torques: compared with inverse dynamics at every sample. Between two samples the torque
      must stay near the torques at both; otherwise positions, velocities and accelerations
      contradict each other.
    - Re-simulation: the forward dynamics, driven by the motion's own torque as a function of time,
      are integrated segment by segment (at most 0.1 s, never across a jump), each from the
      motion's own state at its start, and compared with the motion's state at the end. The
      difference is judged as the torque that would cause it. A single simulation over the whole
      time would amplify rounding errors of an unstable arm; the amplification is reported, not
      judged.
    - Conditioning of the mass matrix along the motion: if it is nearly singular, torques do not
      determine the acceleration. The certificate names the direction, and judges the motion by
      inverse dynamics there.
    - Clearance, if a scene is given: proved between samples, too, by :func:`clearance`, with
      distances by coal. Without coal the clearance is not proved, and the certificate fails.

    For a robot without masses the limits of position, velocity, acceleration and jerk, the via
    points and the consistency of the samples are checked, and the verdict says so. Torque limits
    from the robot's file are named as not judged; torque limits in ``limits`` are refused.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    limits : Limits or JointLimits, optional
        Default ``robot.limits``.
    via_q : array_like [m,n] or sequence of Stop, optional
        Via points, rad (m), that the motion must pass; its marks name them if there are as many.
        With stops, the marks give the time of each stop, and every segment is checked with its
        payload and within its tolerances.
    segments, cycle
        See :func:`microbot_ocp.time_optimal`.
    scene : Scene, optional
        Obstacles that the motion must keep clear of.
    limit_tolerance : float
        Allowed relative violation of a limit.
    position_tolerance : float
        Allowed position error at the end of a re-simulated segment, rad (m).
    torque_tolerance : float
        Allowed torque error relative to the largest torque of the joint: of the stored torques, and
        of the torque that explains the error of a segment. Rounded or interpolated torques, such as
        those of ``Motion.resample`` without the robot, need a larger tolerance, such as 1e-3.
    via_tolerance : float
        Allowed distance to a via point, rad (m).
    simulated : bool
        True to re-simulate the motion; False judges limits, via points and clearance only.
    time_limit : float
        Wall time, s, after which no further segments are simulated and the certificate fails.

    Returns
    -------
    Certificate
        Verdict, with the figures of every check.

    Raises
    ------
    InputError
        The robot has another number of joints, a via point or a tolerance is invalid, or torque
        limits are given for a robot without masses.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> from microbot_ocp.trajectories import cubic
    >>> robot = mo.load_robot("microbot")
    >>> shape = cubic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 3.0])
    >>> certificate = certify(robot, Motion.from_polynomial(robot, shape, label="cubic"))
    >>> certificate.ok, certificate.resimulation_status.solved
    (True, True)
    """
    count = robot.joint_count
    checks.joints("motion", motion.joint_count, robot)
    tolerances = Tolerances(
        limit=checks.number("limit_tolerance", limit_tolerance, at_least=0.0),
        position=checks.number("position_tolerance", position_tolerance, at_least=0.0),
        torque=checks.number("torque_tolerance", torque_tolerance, above=0.0),
        via=checks.number("via_tolerance", via_tolerance, at_least=0.0),
    )
    via = None
    if via_q is not None and (is_task(via_q) or segments is not None or cycle):
        arm = robot if scene is None else with_arm_capsules(robot)  # parts hang on capsules
        stops = list(cast("Sequence[Any]", via_q))
        subject = task_of(arm, stops, limits, segments=segments, cycle=cycle)
    else:
        if via_q is not None:
            via = checks.array("via_q", cast("ArrayLike", via_q), (None, count), "rad")
        subject = LimitFamily.of(robot, limits)
    with deadline.within(time_limit):
        return certified(subject, motion, scene, tolerances, via, simulated=simulated)


def certified(
    subject: LimitFamily | Task,
    motion: Motion,
    scene: Scene | None,
    tolerances: Tolerances,
    via: FloatArray | None = None,
    *,
    simulated: bool = True,
) -> Certificate:
    """Certify a motion under limits or through the stops of a task; arguments are checked before.

    With a scene the certificate passes only if the clearance is proved.
    """
    if isinstance(subject, Task):
        from microbot_ocp.certificate._task_certificate import certificate_of_task

        certificate = certificate_of_task(subject, motion, tolerances, simulated=simulated)
    else:
        certificate = certificate_of(subject, motion, via, tolerances, simulated=simulated)
    if other := other_arm(subject.robot, motion):
        passes, _, because = certificate.verdict.partition(": ")
        verdict = f"{passes}: {other}; {because}"
        certificate = replace(certificate, verdict=verdict)
    if scene is None:
        return certificate
    places: Any = [(0.0, motion.duration, subject.robot, scene)]
    if isinstance(subject, Task):
        places = places_along(subject, motion, scene)
    clearance = clearance_along(places, motion) if has_coal() else None
    check = Check("clearance", False, "clearance is not proved: that needs coal")
    if clearance is not None:
        least = clearance.pair, clearance.time, clearance.minimum, clearance.wanted, "m"
        check = Check("clearance", clearance.proved, clearance.sentence, *least)
    if certificate.ok and not check.passed:
        verdict = f"Failed: {check.problem}."
    else:
        verdict = f"{certificate.verdict.removesuffix('.')}; {check.problem}."
    return replace(
        certificate,
        ok=certificate.ok and check.passed,
        verdict=verdict,
        clearance=clearance,
        wall_time=certificate.wall_time + (clearance.wall_time if clearance else 0.0),
        checks=(*certificate.checks, check),
    )


def certificate_of(
    family: LimitFamily,
    motion: Motion,
    via: FloatArray | None,
    tolerances: Tolerances | None = None,
    history: StateHistory | None = None,
    start: float = 0.0,
    *,
    simulated: bool = True,
) -> Certificate:
    """Certify a motion under limits; arguments are checked before.

    ``history`` holds the states for the limits if the motion is one part of a longer motion. The
    part begins at ``start`` (s), and all times count from the beginning of the whole motion.
    """
    started = time.perf_counter()
    robot: Robot = family.robot
    tolerances = tolerances or Tolerances()
    t, ratio = dense_times(motion)
    history = history or history_of(motion, t)
    limit_checks, saturated = limit_checks_of(family, history)
    limit_checks += tuple(_mean_check(family, member, motion) for member in family.means)
    vias = [] if via is None else _check_vias(motion, via, t, tolerances.via)
    figures: dict[str, Any] = {}
    passed = [_limit_kept(check, tolerances.limit) for check in limit_checks]
    if outside := family.outside_of_tables(history.samples):
        read, k = outside
        moment = start + float(history.t[k])
        problem = f"{read.at(k)}, at {moment:.4g} s"
        passed.append(Check("table", False, problem, read.name, moment, float(read.values[k])))
    if robot.has_dynamics and simulated:
        again = resimulate(robot, motion, tolerances.torque, start)
        stored = _stored_torque(robot, motion, tolerances.torque, start)
        strays = _between_samples(motion, partial(torque_along, robot), "torque", start)
        passed += [_check_resimulation(again, tolerances), *vias, stored, strays]
        state = motion.sample(t)
        condition, at = _condition(robot, t, state)
        figures = {
            "condition_peak": condition,
            "condition_time": start + float(t[at]),
            "condition_pose": state.q[at],
            "stored_torque_error": stored.value,
            "stored_torque_joint": stored.where,
            "stored_torque_time": stored.time,
            **{f.name: getattr(again, f.name) for f in fields(ResimulationFigures)},
        }
        but = _remarks(robot, again, figures)
        otherwise = _summary(limit_checks, again)
    else:
        strays = _between_samples(motion, lambda state: state.qdd, "acceleration", start)
        passed += [*vias, strays]
        but = "; not simulated"
        if not robot.has_dynamics:
            but = (
                f"; kinematics only: {robot.name} has no masses, so nothing was simulated "
                "and no torque was checked"
            )
        otherwise = _tightest(limit_checks, family.unjudged)
    problems = "; ".join(problems_of(passed))
    return Certificate(
        label=motion.label,
        ok=not problems,
        verdict=(f"Failed: {problems}" if problems else f"Passed: {otherwise}") + but + ".",
        limit_checks=limit_checks,
        grid_step=float(np.diff(t).max()),
        grid_ratio=ratio,
        saturated_fraction=saturated,
        between_samples_error=strays.value,
        between_samples_time=strays.time,
        unjudged=() if robot.has_dynamics else family.unjudged,
        checks=tuple(passed),
        wall_time=time.perf_counter() - started,
        **figures,
    )


def _remarks(robot: Robot, again: Resimulation, figures: dict[str, Any]) -> str:
    """Return the remarks on poses at which torques hardly determine the motion, or not at all."""
    remarks = ""
    if figures["condition_peak"] > NEAR_SINGULAR:
        remarks += (
            f"; mass matrix near singular at {figures['condition_time']:.4g} s (condition number "
            f"{figures['condition_peak']:.2g} at q = {_pose(robot, figures['condition_pose'])})"
        )
    if again.undetermined_direction is not None:
        besides = again.undetermined_besides
        more = f" and of {besides} more direction{'s' * (besides > 1)}" if besides else ""
        remarks += (
            f"; for {100 * again.undetermined_fraction:.3g} % of the time no torque determines the "
            f"motion of {_direction(robot, again.undetermined_direction)}{more}: judged by inverse "
            "dynamics there"
        )
    return remarks


def limit_checks_of(
    family: LimitFamily, states: StateHistory
) -> tuple[tuple[LimitCheck, ...], float]:
    """Check every limit; return the checks and the fraction of time in which one is used."""
    history = LimitHistory.of(family, states)
    limit_checks = []
    busy = np.zeros(history.t.size, dtype=bool)
    for member in family:
        t, values, use = history.judged(member.key)
        peaks = use.max(axis=0)
        if member.key != "q" and peaks.max() >= AT_LIMIT:
            busy |= (history.use[member.key] >= AT_LIMIT).any(axis=1)
        i = int(use[:, peaks.argmax()].argmax())
        bound, jump = member.nearest_bound(values.row(i))[0], i >= history.t.size
        worst = float(t[i]), values.value[i], bound
        limit_checks.append(_limit_check(member, peaks, *worst, jump=jump))
    spans = np.diff(history.t)
    share_of_time = float((0.5 * (busy[:-1] + 0.0 + busy[1:]) * spans).sum() / spans.sum())
    return tuple(limit_checks), share_of_time


def _mean_check(family: LimitFamily, member: Member, motion: Motion) -> LimitCheck:
    """Check a root-mean-square limit over the motion and the dwell after it."""

    def squares(samples: MotionSamples) -> FloatArray:
        return family.values(samples, [member.key])[member.key].value ** 2

    assert member.limit is not None
    t, weights = quadrature(motion.t)
    rest, held = member.limit.dwell, squares(MotionSamples.at_rest(motion.q[-1]))[0]
    value = np.sqrt((weights @ squares(motion.samples(t)) + rest * held) / (motion.duration + rest))
    use = value / member.upper  # 0 where there is no bound
    return _limit_check(member, use, motion.duration, value, member.upper)


def _limit_check(
    member: Member,
    use: FloatArray,
    time: float,
    values: FloatArray,
    bounds: FloatArray,
    *,
    jump: bool = False,
) -> LimitCheck:
    """Return the check of a limit from its use [k], for the component with the largest use."""
    joint = int(use.argmax())
    return LimitCheck(
        quantity=member.key,
        name=member.name,
        labels=member.labels,
        utilisation=np.where(member.limited, use, np.nan),
        violation=max(0.0, float(use[joint]) - 1.0),
        joint=member.labels[joint],
        time=time,
        value=float(values[joint]),
        limit=float(bounds[joint]),
        unit=member.units[joint],
        jump=jump,
    )


CONDITION_POINTS = 10_000  # samples at which the mass matrix is evaluated first


def _condition(robot: Robot, t: FloatArray, state: State) -> tuple[float, int]:
    """Return the largest condition number of the mass matrix, and its index in ``t``.

    A coarse pass finds the neighbourhood of the peak, a second pass evaluates every sample in it.
    """
    function, apart = mass_matrix_condition(robot), -(-t.size // CONDITION_POINTS)
    at = apart * int(np.array(function(state.q[::apart].T)).argmax())
    first = max(0, at - apart)
    values = np.array(function(state.q[first : at + apart].T)).ravel()
    return float(values.max()), first + int(values.argmax())


def _stored_torque(robot: Robot, motion: Motion, allowed: float, start: float) -> Check:
    """Check the stored torques against inverse dynamics, relative to the torque of each joint."""
    again = torque_along(robot, State(motion.q, motion.qd, motion.qdd))
    ratio = np.abs(motion.tau - again) / torque_sizes(robot, motion)
    i, joint = np.unravel_index(int(ratio.argmax()), ratio.shape)
    error, name, moment = float(ratio[i, joint]), robot.joint_names[joint], start + motion.t[i]
    problem = (
        f"stored torque of {name} at {moment:.4g} s differs from inverse dynamics by "
        f"{error:.3g} of its largest torque (allowed: {allowed:.3g})"
    )
    passed = not error > allowed
    return Check("stored torque", passed, problem, name, float(moment), error, allowed)


def _between_samples(
    motion: Motion, moved: Callable[[State], FloatArray], what: str, first: float
) -> Check:
    """Check that the torque half-way between two samples is near the torques at both.

    ``moved`` returns the torque of states, or the acceleration for a robot without masses;
    ``first`` is the start time of the motion, s.
    """
    start, end = motion.t[:-1], motion.t[1:]
    long = ~jump_gaps(motion.t)
    middle = 0.5 * (start + end)[long]
    tau = moved(motion.sample(middle))
    ends = moved(State(motion.q, motion.qd, motion.qdd))
    low, high = np.minimum(ends[:-1], ends[1:])[long], np.maximum(ends[:-1], ends[1:])[long]
    # Interpolating over a jump between two samples overshoots by less than the jump.
    outside = (np.maximum(tau - high, low - tau) - (high - low)).max(axis=1)
    worst = int(outside.argmax())
    size = max(float(np.abs(ends).max()), ROUNDING)
    stray, moment = max(0.0, float(outside[worst] / size)), first + float(middle[worst])
    problem = (
        "position, velocity and acceleration contradict each other: half-way between two samples, "
        f"at {moment:.4g} s, the {what} leaves their range by {stray:.3g} of the largest {what}"
    )
    allowed = TORQUE_EXCESS
    name = f"{what} between samples"
    return Check(name, not stray > allowed, problem, time=moment, value=stray, allowed=allowed)


def _check_vias(motion: Motion, via: FloatArray, t: FloatArray, tolerance: float) -> list[Check]:
    """Check the least distance in joint space, rad (m), to each via point."""
    q = motion.sample(t).q
    names = [f"via point {k + 1}" for k in range(via.shape[0])]
    if len(motion.marks) == via.shape[0]:
        names = [mark.name for mark in motion.marks]
    nearest = [int(((q - target) ** 2).sum(axis=1).argmin()) for target in via]
    moment, reach = t[nearest], float(np.diff(t).max())
    distance = np.zeros(via.shape[0])
    each = np.arange(via.shape[0])
    for _ in range(6):
        around = moment[:, None] + reach * np.linspace(-1, 1, 17)
        around = np.clip(around, 0.0, motion.duration)
        q = motion.sample(around.ravel()).q.reshape(*around.shape, -1)
        apart = np.sqrt(((q - via[:, None]) ** 2).sum(axis=2))
        best = apart.argmin(axis=1)
        moment, distance, reach = around[each, best], apart[each, best], reach / 8
    checks = []
    for name, at, least in zip(names, moment.tolist(), distance.tolist(), strict=True):
        problem = f"{name} is missed by {least:.3g} rad (nearest at {at:.4g} s)"
        where = name, at, least, tolerance, "rad", "via"
        checks.append(Check("via point", not least > tolerance, problem, *where))
    return checks


def _check_resimulation(again: Resimulation, tolerances: Tolerances) -> Check:
    """Check that the torques reproduce the motion."""
    solved = again.resimulation_status.solved
    near = again.defect <= tolerances.torque and again.position_defect <= tolerances.position
    problem = (
        f"re-simulation differs from the motion at {again.defect_time:.4g} s as if the torque of "
        f"{again.defect_joint} were wrong by {again.defect:.2g} of its largest (largest position "
        f"error of the {again.segments} segments: {again.position_defect:.2g} rad)"
    )
    if not solved:
        problem = f"re-simulation stopped: {again.message}"
    return Check(
        "re-simulation",
        solved and near,
        problem,
        again.defect_joint,
        again.defect_time,
        again.defect,
        tolerances.torque,
    )


def _limit_kept(check: LimitCheck, tolerance: float) -> Check:
    passed = not check.violation > tolerance
    where = check.joint, check.time, check.value, check.limit, check.unit
    return Check(check.name, passed, check.excess, *where)


SOLVER_ROUNDING = 1e-7  # relative excess over a limit due to the tolerance of the solver


def _tightest(limit_checks: tuple[LimitCheck, ...], unjudged: Sequence[str] = ()) -> str:
    # The use of the position range depends on the path only, so any other limit is named first.
    used = [check for check in limit_checks if check.quantity != "q"] or list(limit_checks)
    but = f" but that of {' and '.join(unjudged)}" if unjudged else ""
    if not used:
        return f"there is no limit{but}"
    tightest = max(used, key=lambda check: check.largest_use)
    worst = max(check.violation for check in limit_checks)
    verdict = "is kept" if worst <= SOLVER_ROUNDING else f"is kept to within {100 * worst:.2g} %"
    use = f"{100 * tightest.largest_use:.4g} % at {tightest.time:.4g} s"
    return f"every limit{but} {verdict}, the tightest being {tightest.title} with {use}"


def summary(certificate: Certificate, *, simulated: bool) -> str:
    """Return the summary of a certificate of several parts that all passed."""
    limits = _tightest(certificate.limit_checks, certificate.unjudged)
    return "; ".join([limits, *(_agreement(certificate) if simulated else ["not simulated"])])


ALL_ALONG = 1.0 - ROUNDING  # fraction of time from which a motion is undetermined all along


def _agreement(figures: ResimulationFigures) -> list[str]:
    """Return the remark on the re-simulation; none if torques never determine the motion."""
    if not np.isfinite(figures.defect):
        return ["kinematics only"]
    if figures.undetermined_fraction > ALL_ALONG:
        return []
    to = f" to {figures.defect:.1g} of the torques" if figures.defect > ROUNDING else ""
    return [f"re-simulation of {figures.segments} segments agrees{to}"]


LARGEST_REPORTED_ERROR = 0.1  # largest error to first order that is reported as a number, rad


def _summary(limit_checks: tuple[LimitCheck, ...], again: Resimulation) -> str:
    parts = [_tightest(limit_checks)] if limit_checks else []
    parts += _agreement(again)
    grown = growth_said(again.amplification)
    open_loop = f"an open-loop simulation is meaningless, as it amplifies errors up to {grown}"
    if again.final_position_error < LARGEST_REPORTED_ERROR:
        error = again.final_position_error
        open_loop = (
            f"open-loop simulation ends within {error:.2g} rad, amplifying errors up to {grown}"
        )
    return "; ".join([*parts, open_loop])


NAMED_SHARE = 0.3  # smallest component of a direction that is named, relative to its largest one


def _direction(robot: Robot, direction: FloatArray) -> str:
    """Return the names of the joints that make up a direction, with their components if several."""
    parts = np.abs(direction) >= NAMED_SHARE * np.abs(direction).max()
    if parts.sum() == 1:
        return robot.joint_names[int(np.abs(direction).argmax())]
    chosen = zip(direction[parts], np.array(robot.joint_names)[parts], strict=True)
    return "(" + ", ".join(f"{value:.2g} {name}" for value, name in chosen) + ")"


def _pose(robot: Robot, q: FloatArray) -> str:
    entries = [
        f"{value:.4g} m" if kind == "prismatic" else f"{np.degrees(value):.4g} deg"
        for value, kind in zip(q, robot.joint_types, strict=True)
    ]
    return "(" + ", ".join(entries) + ")"
