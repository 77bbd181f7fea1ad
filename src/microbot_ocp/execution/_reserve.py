"""Torque reserve that feedback needs if the arm differs from the model of the plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.status import Status
from microbot_ocp._base.table import Column, Table
from microbot_ocp.execution._check import AT_REST
from microbot_ocp.execution._load import refuse_other_arm
from microbot_ocp.limits import LIMIT_TOLERANCE, JointLimits, LimitFamily, Limits
from microbot_ocp.motion import JUMP_GAP, Motion, mesh_of, polynomial_of
from microbot_ocp.planning.free import within_limits
from microbot_ocp.planning.search import time_optimal, tool_poses
from microbot_ocp.planning.task import checked_box, robust_limits as robust_limits
from microbot_ocp.robot import Robot
from microbot_ocp.simulation import COARSEST, Controller, track


@dataclass(frozen=True)
class Trial:
    """Result of one reserve.

    Attributes
    ----------
    reserve : float
        Reserve as a fraction of the torque limits.
    duration : float
        Duration of the motion planned with it, s; NaN if there is none.
    error : float
        Largest distance of the tool from its reference over all plants, m; infinite if a
        simulation fails.
    saturated : float
        Largest fraction of the simulated time in which a torque is at its true limit.
    """

    reserve: float
    duration: float
    error: float
    saturated: float


@dataclass(frozen=True, eq=False)
class Reserve:
    """Least torque reserve with which every plant follows the motion.

    Attributes
    ----------
    status : Status
        Status "not found" if no reserve keeps the bound; ``advice`` explains it.
    reserve : float
        Reserve as a fraction of the torque limits; NaN if none is enough.
    motion : Motion
        Motion planned with the reserve, the *trackable* motion; the ideal one if none is enough.
    ideal : Motion
        Motion planned without a reserve.
    bound : float
        Allowed error of the tool, m.
    trials : tuple of Trial
        Results of all reserves tried, in increasing order.
    advice : str
        Reason why no reserve keeps the bound, with a remedy; empty if one does.
    """

    status: Status
    reserve: float
    motion: Motion
    ideal: Motion
    bound: float
    trials: tuple[Trial, ...]
    advice: str = ""

    @property
    def solved(self) -> bool:
        """True if a reserve keeps the bound."""
        return self.status.solved

    @property
    def cost(self) -> float:
        """Additional duration due to the reserve, s."""
        return self.motion.duration - self.ideal.duration

    def plot(self, axes: GivenAxes | None = None) -> DrawnAxes:
        """Draw tool error and duration over the reserve; see :func:`microbot_ocp.plots.reserve`."""
        return view_for(self, "plot")(self, axes)

    def table(self) -> Table:
        """Return a table of the duration and the tool error of each reserve."""
        columns = [
            Column("reserve", "%", ".2f"),
            Column("T", "s", ".4f"),
            Column("tool error", "mm", ".3f"),
            Column("saturated", "%", ".1f"),
        ]
        scales = (100.0, 1.0, 1e3, 100.0)
        rows = [
            [scale * value for scale, value in zip(scales, vars(trial).values(), strict=True)]
            for trial in self.trials
        ]
        return Table(columns, rows)


def differing_plants(
    robot: Robot,
    *,
    mass: float = 0.0,
    friction: float = 0.0,
    payload: tuple[float, float] = (0.0, 0.0),
    count: int = 20,
    seed: int = 0,
) -> tuple[Robot, ...]:
    """Return arms that differ from the model: corners of a parameter box, and arms inside it.

    Parameters
    ----------
    robot : Robot
        Model with masses.
    mass : float
        Largest relative error of the mass of every link, with its inertia and its armature.
    friction : float
        Largest relative error of viscous and Coulomb friction of every joint.
    payload : (float, float)
        Range of the point mass at the tool, kg.
    count : int
        Number of random arms besides the corners; each link is drawn by itself.
    seed : int
        Seed of the random arms.

    Returns
    -------
    tuple of Robot
        Corners first: all masses, all frictions and the payload at an end of their ranges.

    Raises
    ------
    InputError
        A fraction is outside of 0 to 1, the payload range is negative or decreasing, or the robot
        has no masses.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> plants = mo.execution.differing_plants(mo.load_robot("microbot"), mass=0.05, count=3)
    >>> len(plants), [round(plant.links[1].mass, 3) for plant in plants[:2]]
    (5, [1.9, 2.1])
    """
    low, high = checked_box(robot, mass, friction, payload)
    if not (isinstance(count, int) and 0 <= count <= 100_000):
        raise InputError(f"count must be a whole number, 0 to 100,000, not {checks.shown(count)}")
    links, draw = len(robot.links), np.random.default_rng(seed)
    ends = [(-1.0, 1.0) if share else (0.0,) for share in (mass, friction)]
    loads = (low, high) if low != high else (low,)
    corners = [
        (np.full(links, heavy), np.full(links, rough), load)
        for heavy, rough, load in product(*ends, loads)
    ]
    inside = [(*draw.uniform(-1.0, 1.0, (2, links)), draw.uniform(low, high)) for _ in range(count)]
    return tuple(
        _differing(robot, 1.0 + mass * heavy, 1.0 + friction * rough).with_payload(load)
        for heavy, rough, load in [*corners, *inside]
    )


def _differing(robot: Robot, mass: FloatArray, friction: FloatArray) -> Robot:
    """Return the robot with its masses and frictions scaled by factors [n]."""
    links = []
    for link, m, f in zip(robot.links, mass, friction, strict=True):
        factors = dict.fromkeys(("mass", "inertia", "armature"), m)
        factors |= dict.fromkeys(("viscous_friction", "coulomb_friction"), f)
        links.append(replace(link, **{key: getattr(link, key) * by for key, by in factors.items()}))
    return robot.with_links(links)


def smallest_reserve(
    robot: Robot,
    task: Motion | ArrayLike | Callable[[float], Motion],
    controller: Controller,
    plants: Sequence[Robot],
    bound: float,
    *,
    limits: Limits | JointLimits | None = None,
    accuracy: float = COARSEST,
    **loop: Any,
) -> Reserve:
    """Find the least torque reserve with which the tool stays near its reference.

    The motion is planned with a fraction of the torques kept back. The controller executes it on
    every plant, with torques that saturate at the true limits. The end is held as long as the
    motion took, so that settling counts, unless a ``duration`` is given. The fraction doubles from
    ``accuracy`` on until no plant deviates by more than ``bound``; bisection refines it.

    Parameters
    ----------
    robot : Robot
        Model of the plan and of the controller.
    task : Motion, array_like [m,n] or callable
        Via points that :func:`microbot_ocp.time_optimal` plans through; or a motion, which is
        slowed down only if it exceeds the reduced torques; or a function from a reserve to a
        motion.
    controller : Controller
        Controller that executes the motion.
    plants : sequence of Robot
        Arms that are simulated, such as :func:`differing_plants` of the robot.
    bound : float
        Allowed distance of the tool from its reference, at any time until it has settled, m.
    limits : Limits, optional
        Limits of the plan, before a fraction is kept back; default the robot's own.
    accuracy : float
        Resolution of the reserve, as a fraction of the torque limits, and tolerance of the
        simulations, relative to the bound, unless a ``tolerance`` is given.
    **loop
        Options of :func:`microbot_ocp.track`: ``sample_rate``, ``delay``, ``noise``,
        ``saturation``, ``step`` and so on.

    Returns
    -------
    Reserve
        Least reserve, the motion planned with it, and the trials.

    Raises
    ------
    InputError
        There is no plant, a plant has other joints, the bound or the accuracy is not above 0, or
        the motion belongs to an arm with another payload.

    Examples
    --------
    >>> import numpy as np
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> plants = mo.execution.differing_plants(robot, mass=0.05, count=0)
    >>> via_q = np.radians([[0, 0, 0], [-90, 90, 90]])
    >>> loop = mo.ComputedTorque(kp=100.0)
    >>> rough = {"sample_rate": 500.0, "accuracy": 0.05}
    >>> found = mo.smallest_reserve(robot, via_q, loop, plants, 0.03, **rough)
    >>> found.solved, 0.01 < found.reserve < 0.2
    (True, True)
    """
    check_trials(robot, controller, plants, bound, accuracy=accuracy, **loop)
    # A finer tolerance costs thousands of steps when dry friction changes its sign.
    loop = {"tolerance": min(accuracy * bound, COARSEST), **loop}
    play = partial(track, robot, controller=controller, **loop)
    plan = _planner(robot, task, limits)
    ideal = plan(0.0)
    motions: dict[float, Motion] = {}
    trials: dict[float, Trial] = {}

    def keeps(reserve: float) -> bool:
        try:
            motion = plan(reserve) if reserve else ideal
        except InputError as problem:  # the reduced torques cannot hold the arm
            trials[reserve] = Trial(reserve, np.nan, np.inf, np.nan)
            advice[:] = [str(problem)]
            return False
        motions[reserve] = motion
        trials[reserve] = _trial_of(robot, motion, plants, reserve, play)
        return motion.solved and trials[reserve].error <= bound

    def ordered() -> tuple[Trial, ...]:
        return tuple(trials[each] for each in sorted(trials))

    advice = ["no reserve keeps the bound: the controller itself misses it, or torques are too low"]
    good, bad = 0.0, -accuracy
    while not keeps(good):
        bad, good = good, accuracy if not good else 2.0 * good
        if good >= 1.0 or not np.isfinite(trials[bad].duration):
            return Reserve(Status.NOT_FOUND, np.nan, ideal, ideal, bound, ordered(), advice[0])
    while good - bad > accuracy * (1.0 + ROUNDING):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if keeps(middle) else (good, middle)
    return Reserve(Status.SOLVED, good, motions[good], ideal, bound, ordered())


def check_trials(
    robot: Robot, controller: Any = None, plants: Any = None, bound: Any = None, **options: Any
) -> None:
    """Reject arguments that :func:`smallest_reserve` cannot use, before anything is planned."""
    if controller is None or plants is None or bound is None:
        raise InputError("controller, plants and bound must be given to find a reserve")
    checks.number("bound", bound, "m", above=0.0)
    checks.number("accuracy", options.pop("accuracy", COARSEST), above=0.0, at_most=0.5)
    if not (isinstance(plants, Sequence) and plants and all(isinstance(p, Robot) for p in plants)):
        raise InputError("plants must hold at least one robot, and robots only")
    for plant in plants:
        checks.joints("plant", plant.joint_count, robot)
    for name in options:
        checks.one_of(
            "option of the loop", name, (*tuple(signature(track).parameters)[4:], "limits")
        )


def _planner(
    robot: Robot,
    task: Motion | ArrayLike | Callable[[float], Motion],
    limits: Limits | JointLimits | None,
) -> Callable[[float], Motion]:
    if callable(task):
        return task
    if not isinstance(task, Motion):
        return lambda reserve: time_optimal(robot, task, limits, reserve=reserve)
    refuse_other_arm(robot, task)
    arm_limits = robot.limits if limits is None else limits.for_joints(robot.joint_count)
    shape = polynomial_of(task)

    def slowed(reserve: float) -> Motion:
        if not reserve:
            return task
        family = LimitFamily.of(robot, arm_limits.with_reserve(reserve))
        times = np.array([mark.time for mark in task.marks])
        motion = within_limits(family, shape, times, LIMIT_TOLERANCE, False)
        if motion is None:
            raise InputError(
                f"the motion cannot be slowed down enough to keep a reserve of {100 * reserve:.3g} "
                "% of the torques"
            )
        return motion

    return slowed


def _trial_of(
    robot: Robot, motion: Motion, plants: Sequence[Robot], reserve: float, play: Callable[..., Any]
) -> Trial:
    error = saturated = 0.0
    reference = motion if "duration" in play.keywords else _with_end_held(motion)
    for plant in plants:
        run = play(reference, plant=plant)
        saturated = max(saturated, run.saturated_fraction)
        if not run.solved:
            return Trial(reserve, motion.duration, np.inf, saturated)
        tool, wanted = (tool_poses(robot, q)[:, :3, 3] for q in (run.q, run.reference.q))
        error = max(error, float(np.linalg.norm(tool - wanted, axis=1).max()))
    return Trial(reserve, motion.duration, error, saturated)


def _with_end_held(motion: Motion) -> Motion:
    """Return the motion with its end held for its duration, if it ends at rest."""
    if np.abs(motion.qd[-1]).max() > AT_REST:
        return motion
    held = np.append(np.arange(motion.t.size), [-1, -1])  # the last sample, twice more
    q, qd, qdd, tau = (column[held] for column in (motion.q, motion.qd, motion.qdd, motion.tau))
    qd[-2:] = qdd[-2:] = 0.0
    end = motion.duration
    t, breaks = np.append(motion.t, [end + JUMP_GAP, 2 * end]), np.append(mesh_of(motion), 2 * end)
    return replace(motion, t=t, q=q, qd=qd, qdd=qdd, tau=tau, breaks=breaks)
