"""A recording of every kind, with two moments between which its arm moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

import microbot_ocp as mo
from microbot_ocp.ocp.search import solve
from microbot_ocp.views.recording import (
    BRANCH,
    ITERATION,
    PROGRESS,
    TIME,
    Recording,
    SolutionRecording,
    of_branches,
    of_comparison,
    of_motion,
    of_solution,
    of_tracking,
    record_iterations,
)

VIA_Q = np.radians([[0, 0, 0], [-8, 45, 30], [-90, 90, 90]])


class Moment(NamedTuple):
    """A place of the time cursor: s on the first timeline, whole numbers on the others."""

    timeline: str
    value: float

    def as_argument(self) -> dict[str, float | int]:
        """For the viewer's ``set_time``."""
        if self.timeline == TIME:
            return {"duration": self.value}
        return {"sequence": int(self.value)}


class Saved(Protocol):
    """What can be saved."""

    def save(self, path: Path) -> Path:
        """Write an ``.rrd``."""
        ...


class Kind(NamedTuple):
    """How a kind of recording is made, and when to look at it."""

    make: Callable[[], Saved]
    moments: tuple[Moment, Moment]
    view: str = "3D"  # class of the view to look at


@cache  # two kinds show it
def comparison() -> Recording:
    """Cubic segments, LSPB, the cubic's path at its best timing, and the best of all motions."""
    methods = ["cubic", "lspb", "cubic_path", "time_optimal"]
    return of_comparison(mo.compare(mo.load_robot("microbot"), VIA_Q, methods))


def motion() -> Recording:
    """A 7R arm on quintic segments, as fast as its limits allow."""
    robot = mo.load_robot("panda")
    via = np.radians([[0, -30, 0, -120, 0, 90, 45], [60, 40, 30, -60, 40, 130, 0]])
    scaled = mo.shortest_duration(robot, mo.quintic(via, [0.0, 1.0]))
    made = mo.Motion.from_polynomial(robot, scaled.polynomial, label="quintic, scaled")
    return of_motion(robot, made, mo.certify(robot, made))


def planar() -> Recording:
    """A planar arm falls from level."""
    robot = mo.load_robot("planar_2r")
    fall = mo.simulate(robot, None, [0.0, 0.0], None, np.linspace(0.0, 1.2, 601))
    return of_motion(robot, fall.as_motion("free fall"))


def prismatic() -> Recording:
    """An arm with a slide."""
    robot = mo.load_robot("stanford")
    via = np.array([[0.0, -0.6, 0.4, 0.0, 0.5, 0.0], [1.2, 0.5, 0.9, 0.5, -0.5, 0.5]])
    scaled = mo.shortest_duration(robot, mo.quintic(via, [0.0, 1.0]))
    made = mo.Motion.from_polynomial(robot, scaled.polynomial, label="quintic, scaled")
    return of_motion(robot, made, mo.certify(robot, made))


def tracking() -> Recording:
    """Computed torque with heavier links than it knows, weak drives, and a start off the motion."""
    robot = mo.load_robot("microbot")
    wanted = mo.Motion.from_polynomial(robot, mo.cubic(VIA_Q, [0.0, 1.6, 3.2]), label="cubic")
    weak = mo.Limits(tau_max=0.8 * np.abs(wanted.tau).max(axis=0))
    heavy = [mo.Link(1.15 * k.mass, k.center_of_mass, k.inertia) for k in robot.links]
    run = mo.track(
        robot,
        wanted,
        mo.ComputedTorque(100.0),
        plant=robot.with_links(heavy),
        saturation=weak,
        q0=wanted.q[0] + np.radians([5.0, -8.0, 10.0]),
    )
    return of_tracking(robot, run, weak)


def branches() -> Recording:
    """Every way for a 6R arm to reach a pose."""
    robot = mo.load_robot("ur5e")
    pose = np.array(mo.forward_kinematics(robot)(np.radians([40, -80, 90, -60, -70, 20])))
    found = mo.solve_ik_all(robot, pose[:3, 3], pose[:3, :3])
    return of_branches(robot, found, pose[:3, 3], pose[:3, :3])


def solution() -> SolutionRecording:
    """A cart that is to stand still 1 m further on, pushed, then braked by less."""
    problem = mo.OptimalControlProblem("cart")
    for name, push in (("push", (0.0, 1.0)), ("brake", (-0.5, 0.0))):
        phase = problem.phase(name, duration=(0.1, 10.0))
        x = phase.state("x", initial=0.0 if name == "push" else None,
                        final=1.0 if name == "brake" else None, unit="m")  # fmt: skip
        v = phase.state("v", initial=0.0 if name == "push" else None,
                        final=0.0 if name == "brake" else None, upper=0.7, unit="m/s")  # fmt: skip
        a = phase.control("a", lower=push[0], upper=push[1], unit="m/s^2")
        phase.derivative(x, v)
        phase.derivative(v, a)
        phase.end_cost(phase.duration)
    problem.link(*problem.phases)
    return of_solution(solve(problem, mesh=20, scheme="shooting"), "cart")


class Iterations:
    """The free solver on its way to the best of all motions."""

    def save(self, path: Path) -> Path:
        """Solve, and write every iterate."""
        with record_iterations(path) as progress:
            mo.time_optimal(mo.load_robot("microbot"), VIA_Q, mesh=20, starts=1, progress=progress)
        return path


KINDS: Mapping[str, Kind] = {
    "comparison": Kind(comparison, (*(Moment(TIME, t) for t in (0.3, 1.2)), Moment(PROGRESS, 600))),
    "motion": Kind(motion, (Moment(TIME, 0.1), Moment(TIME, 0.45))),
    "planar": Kind(planar, (Moment(TIME, 0.1), Moment(TIME, 0.55))),
    "prismatic": Kind(prismatic, (Moment(TIME, 0.2), Moment(TIME, 0.8))),
    "tracking": Kind(tracking, (Moment(TIME, 0.1), Moment(TIME, 1.3))),
    "solution": Kind(solution, (Moment(TIME, 0.5), Moment(TIME, 1.5)), "TimeSeries"),
    "inverse_kinematics": Kind(branches, (Moment(BRANCH, 1), Moment(BRANCH, 2))),
    "iterations": Kind(Iterations, tuple(Moment(ITERATION, k) for k in (0, 3, 90))),
}
