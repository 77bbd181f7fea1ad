"""Limits, goals and published motion times of cuRobo V2, for the benchmark motionbenchmaker.

Read in github.com/NVlabs/curobo, commit a35a708: the figures in docs/reference/benchmarks.rst, the
conditions in benchmark/motion_plan_benchmark.py, the limits in franka.yml and franka_panda.urdf.
Their 2600 problems are of MotionBenchMaker and of Motion Policy Networks; the times of single
problems are not published.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import microbot_ocp as mo
from microbot_ocp._base.deadline import processor_time
from microbot_ocp.views.plots import styled

OWN = ("makers", "makers-poses")  # conditions under the makers' limits, with joint and pose goals
CONDITIONS = (*OWN, "curobo", "curobo-torque")
WIDENED = 0.2  # rad by which their benchmark widens the position limits
ACCELERATION, JERK = 15.0, 500.0  # rad/s^2 and rad/s^3 of every joint
PAYLOAD = 3.0  # kg, a point mass in the frame of the hand, whose origin is our tool
DEVELOPING = 50  # last number of each family that served for development
SHARES = (50, 75, 98)  # published percentiles of the motion time
TITLES = {"curobo": "their limits", "curobo-torque": "with torque limits and 3 kg"}
# Success in %, mean and percentiles of the motion time in s, median of the planning time in s on an
# RTX 6000 Ada.
PUBLISHED = {
    "curobo": (99.73, (1.250, 1.243, 1.486, 2.128), 0.035),
    "curobo-torque": (99.73, (1.336, 1.304, 1.540, 2.738), 0.043),
}


def under(robot: mo.Robot, conditions: str) -> mo.Robot:
    """Return a Panda under the limits of some conditions, with their payload."""
    if conditions in OWN:
        return robot
    own = robot.limits
    theirs = robot.with_limits(
        q_min=own.q_min - WIDENED,
        q_max=own.q_max + WIDENED,
        qdd_max=ACCELERATION,
        qddd_max=JERK,
        taud_max=np.inf,
    )
    if conditions == "curobo-torque":
        return theirs.with_payload(PAYLOAD)
    return theirs.with_limits(tau_max=np.inf)


def pose_goal(robot: mo.Robot, via: np.ndarray) -> list[mo.Stop]:
    """Return stops at the joint pose of a start and at the tool pose of a goal, via [2,n].

    Their goal is the pose of panda_hand, which is fixed to our tool: both leave the same freedom.
    """
    tool = np.array(mo.forward_kinematics(robot)(via[1]))
    return [mo.Stop(q=via[0]), mo.Stop(position=tool[:3, 3], orientation=tool[:3, :3])]


class Stopwatch:
    """Processor times of a search, which reports its progress here."""

    def __init__(self) -> None:
        self._begun = processor_time()
        self._first: float | None = None

    def __call__(self, event: Any) -> None:
        if self._first is None and not isinstance(event, str):
            self._first = self.spent

    @property
    def planning(self) -> float:
        """Processor time until the first iteration of a solver, or so far without one, s."""
        return self.spent if self._first is None else self._first

    @property
    def spent(self) -> float:
        """Processor time so far, s."""
        return processor_time() - self._begun


def torques(robot: mo.Robot, conditions: str, samples: Any) -> dict[str, float]:
    """Return the largest torques of samples of a motion by the dynamics of an arm.

    "torque" is the largest of any joint, N m, "torque_share" the largest share of the maker's
    limits, "loaded_..." the same with the payload of their benchmark, which evaluates with it by
    default. Samples are a position, a velocity and an acceleration [N,n].
    """
    found = {}
    loaded = robot.with_payload(PAYLOAD)
    held = loaded if conditions == "curobo-torque" else robot
    for name, moved in {"torque": held, "loaded_torque": loaded}.items():
        used = np.abs(moved.torques_along(*samples)["tau"])
        found |= {name: float(used.max())}
        found |= {f"{name}_share": float((used / robot.limits.tau_max).max())}
    return found


def sets(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of each arm, conditions and set of problems by their title, in order.

    Problems that did not serve for development are a set of their own.
    """
    kinds = itertools.product(dict.fromkeys(r["robot"] for r in rows), CONDITIONS, (False, True))
    found = {}
    for robot, conditions, held_out in kinds:
        own = [r for r in rows if (r["robot"], r["conditions"]) == (robot, conditions)]
        own = [r for r in own if (r["number"] > DEVELOPING) == held_out]
        if own:
            numbers = [r["number"] for r in own]
            title = conditions if robot == "panda" else f"{robot} {conditions}"
            found[f"{title}, {min(numbers)} to {max(numbers)}"] = own
    return found


def comparison(rows: list[dict[str, Any]]) -> str:
    """Return our figures by conditions beside the published ones, as Markdown."""
    columns = {"": ["certified and clear", "solved", "motion time, mean, s"]}
    columns[""] += [*(f"{share} %" for share in SHARES), "torque, share of the limit", "search, s"]
    for title, own in sets(rows).items():
        conditions = own[0]["conditions"]
        tried = [r for r in own if r["ends_free_by_meshes"]]
        found = certified(tried, conditions)
        if not found:
            continue
        times = np.array([r["duration"] for r in found])
        columns[title] = [
            f"{len(found)} of {len(tried)}",
            str(sum(r["outcome"] == "solved" for r in found)),
            *(f"{t:.3f}" for t in (times.mean(), *np.percentile(times, SHARES))),
            f"{100 * np.median([r['torque_share'] for r in found]):.0f} %",
            f"{np.median([r['processor'] for r in found]):.1f}",
        ]
        if conditions in PUBLISHED:
            success, motion, search = PUBLISHED[conditions]
            columns.pop(f"{conditions}, theirs", None)  # beside the last set
            columns[f"{conditions}, theirs"] = [f"{success} % of 2600", "-"]
            columns[f"{conditions}, theirs"] += [*(f"{t:.3f}" for t in motion), "-", f"{search}"]
    lines = [f"| {' | '.join(row)} |" for row in (columns, *zip(*columns.values(), strict=True))]
    return "\n".join([lines[0], "|---" * len(columns) + "|", *lines[1:]])


def families(rows: list[dict[str, Any]]) -> str:
    """Return medians by family and conditions, s, as Markdown: motion, first motion, search."""
    kinds = sets(rows)
    lines = [f"| family | {' | '.join(kinds)} |", "|---" * (len(kinds) + 1) + "|"]
    for family in sorted({r["family"] for r in rows}):
        cells = []
        for own in kinds.values():
            of_family = [r for r in own if r["family"] == family]
            found = certified(of_family, own[0]["conditions"])
            keys = ("duration", "first", "processor")
            times = [np.median([r[key] for r in found if r[key] is not None]) for key in keys]
            cells.append("{:.3f}, {:.1f}, {:.1f}".format(*times) if found else "-")
        lines.append(f"| {family} | {' | '.join(cells)} |")
    return "\n".join(lines)


def certified(rows: list[dict[str, Any]], conditions: str) -> list[dict[str, Any]]:
    """Return the rows of some conditions with a certified motion that is proved to keep clear."""
    own = [r for r in rows if r["conditions"] == conditions]
    return [r for r in own if r["outcome"] in ("solved", "known motion")]


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw shares of motions over the motion time and over the time of the search.

    The published percentiles stand beside the motion times. Problems that did not serve for
    development are drawn alone where there are any.
    """
    with styled():
        figure = Figure((7.2, 2.7), layout="constrained")
        *axes, last = figure.subplots(1, 3, sharey=True)
        kinds = zip(axes, TITLES.items(), ("C0", "C1"), strict=True)
        for axis, (conditions, title), color in kinds:
            found = certified(rows, conditions)
            found = [r for r in found if r["number"] > DEVELOPING] or found
            own = {"label": f"ours, {len(found)} problems", "where": "post", "color": color}
            axis.step(*_shares(r["duration"] for r in found), **own)
            others = {"label": "cuRobo V2, 2600", "color": "black"}
            axis.plot(PUBLISHED[conditions][1][1:], SHARES, "o", **others)
            axis.set(title=title, xlabel="motion time [s]")
            axis.legend(loc="lower right")
            for key, style in {"first": "--", "processor": "-"}.items():
                spent = (r[key] for r in found if r[key] is not None)
                last.step(*_shares(spent), style, where="post", color=color)
        axes[1].sharex(axes[0])
        last.set(xscale="log", xlabel="processor time [s]", title="time of the search")
        last.xaxis.set_major_formatter("{x:g}")
        last.xaxis.set_minor_formatter("")
        for time, what in ((0.75, "first\nmotion"), (20.0, "last")):
            last.text(time, 45.0, what)
        axes[0].set_ylabel("problems [%]")
        figure.savefig(path)


def _shares(values: Iterable[float]) -> tuple[list[float], np.ndarray]:
    """Return values in ascending order, and the shares of values up to each, %."""
    ordered = sorted(values)
    return ordered, 100 * np.arange(1, len(ordered) + 1) / max(len(ordered), 1)
