"""Slopes of the shortest period by the free quantities, from the multipliers of a motion.

By the envelope theorem a quantity changes the period by the multipliers times the changes of the
limits and conditions on the motion as it is. All of these are evaluated for the cell with other
values of the quantity: limits of every segment, poses at the stops, distances from obstacles.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import interpreted
from microbot_ocp.layout._quantities import Quantity, cell_with
from microbot_ocp.limits import JOINT_QUANTITIES, LimitFamily
from microbot_ocp.motion import Motion
from microbot_ocp.planning.search import in_order, scenes_of, tool_poses
from microbot_ocp.planning.task import Task, task_of
from microbot_ocp.scene import Scene, clearances, guiding_pairs, with_arm_capsules
from microbot_ocp.tasks import CellFile

STEP = 1e-4  # share of the range of a quantity, far above rounding


def task_in(cell: CellFile, motion: Motion) -> Task:
    """Return the task of a cell with its stops in the order of a motion of it."""
    order = motion.provenance.get("order", range(len(cell.stops)))
    stops = [cell.stops[k] for k in order]
    robot = cell.robot if cell.scene is None else with_arm_capsules(cell.robot)
    segments = in_order(cell.segments, order)
    return task_of(robot, stops, cell.limits, segments=segments, cycle=cell.cycle)


def slopes(
    cell: CellFile, quantities: Sequence[Quantity], values: FloatArray, motion: Motion
) -> FloatArray | None:
    """Return the slopes [d] of the period, s per unit; None of a motion without multipliers.

    A slope is NaN where the task is refused with a value beside the present one.

    Parameters
    ----------
    cell : CellFile
        Cell of the start.
    quantities : sequence of Quantity, d
    values : array [d]
        Values of the quantities that the motion belongs to.
    motion : Motion
    """
    multipliers = motion.provenance.get("multipliers")
    if not multipliers or "stops" not in multipliers:
        return None
    weighed = _weighed(motion, multipliers, task_in(cell_with(cell, quantities, values), motion))
    found = []
    with interpreted():  # each placement is used once
        for k, quantity in enumerate(quantities):
            step = STEP * (quantity.upper - quantity.lower)
            sides = []
            with suppress(InputError):
                for side in (step, -step):
                    moved = values.copy()
                    moved[k] += side
                    changed = cell_with(cell, quantities, moved)
                    sides.append(weighed(task_in(changed, motion), changed.scene))
            found.append((sides[0] - sides[1]) / (2.0 * step) if len(sides) == 2 else np.nan)
    return np.array(found)


def _weighed(motion: Motion, multipliers: Any, task: Task) -> Callable[[Task, Scene | None], float]:
    """Return a function of a task: all its conditions on the motion times their multipliers, s."""
    arrivals = np.array([mark.time for mark in motion.marks])
    leaves, at_stops = arrivals + task.dwells, motion.sample(arrivals)
    samples = [
        {
            key: motion.samples(np.minimum(leaves[k] + row["t"], arrivals[k + 1]))
            for key, row in segment.items()
        }
        for k, segment in enumerate(multipliers["segments"])
    ]

    def total(other: Task, scene: Scene | None) -> float:
        value = _of_bounds(multipliers, other.family)
        for k, conditions in enumerate(multipliers["stops"]):
            for row in other.conditions.ends[k].rows:
                if row.name in conditions:
                    met = row.expression(at_stops.q[k], at_stops.qd[k])
                    value += float(np.array(met).ravel() @ np.array(conditions[row.name]))
        scenes = (
            () if scene is None else scenes_of(other, scene, tool_poses(other.robot, at_stops.q))
        )
        for k, segment in enumerate(multipliers["segments"]):
            for key, row in segment.items():
                by_row = np.array(row["slopes"])
                if "pairs" in row:
                    held = other.payloads[k].on(other.robot)
                    pairs = guiding_pairs(held, scenes[k].without_parts_of(held))
                    near = clearances(held, [pairs[p] for p in row["pairs"]], samples[k][key].q)
                else:
                    near = other.families[k].values(samples[k][key], [key])[key].value
                value += float((by_row * near).sum())
        return value

    return total


def _of_bounds(multipliers: Any, family: LimitFamily) -> float:
    """Return the bounds of the joints times their multipliers, s."""
    value = 0.0
    for key in JOINT_QUANTITIES:
        for side in ("lower", "upper"):
            if key in family and key in multipliers[side]:
                bounds, by_bound = getattr(family[key], side), np.array(multipliers[side][key])
                value += float(by_bound[np.isfinite(bounds)] @ bounds[np.isfinite(bounds)])
    return value
