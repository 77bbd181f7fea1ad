"""Switches of controls between their bounds, and mesh points where they are.

A mesh that has no point at a switch smears it over an interval; the time integral of the control
over the interval still says where it would be.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.ocp.problem import Variable
from microbot_ocp.ocp.solution import PhaseSolution
from microbot_ocp.ocp.transcription.schemes import Collocation
from microbot_ocp.ocp.verification import phase_layout, point_values

AT_BOUND = 1e-3  # of a control's range: nearer to a bound it counts as at it
# The end of a short ramp is worth so little that a barrier keeps it farther away.
RAMP_AT_BOUND = 1e-2
NEARLY_AT_BOUND = 0.2  # beyond a switch: an interval that holds a small rest of the other side
LONGEST_RAMP = 3  # intervals between two bounds that still count as a switch
BRACKET = 0.1  # of the interval next to a switch: how near to it points are added
RAMP_LEFT = 0.125  # of a ramp's length, to each side of the switch, after its points are moved


@dataclass(frozen=True)
class Switch:
    """A jump of a control from one of its bounds to the other.

    Attributes
    ----------
    control, component : which
    place : where it would be if the control were exactly at its bounds on both sides, as a fraction
        of the phase: the time integral of the control over the ramp is kept
    begin, end : fractions between which the control is at neither bound
    rising : from the lower bound to the upper one
    continuous : whether the control cannot jump, but has a ramp
    offset : how far the mesh is from holding the switch, as a fraction of the phase: half of a
        ramp, or the distance to the nearest mesh point
    """

    control: str
    component: int
    place: float
    begin: float
    end: float
    rising: bool
    continuous: bool
    offset: float


def find_switches(phase: PhaseSolution) -> tuple[Switch, ...]:
    """Jumps of controls between their bounds.

    A control at the bound A up to ``a``, and at the other bound B from ``b`` on, would do the same
    on average with one jump at tau: ``A (tau - a) + B (b - tau) = integral of u from a to b``.
    """
    found = []
    for control in phase_layout(phase).phase.controls:
        values = interval_values(phase, control)
        for i in range(control.size):
            if np.isfinite(control.lower[i] - control.upper[i]):
                found += _component_switches(phase.mesh, control, i, values)
    return tuple(found)


@dataclass(frozen=True, eq=False)
class IntervalValues:
    """Least, largest and mean value [N, size] of a control in every interval."""

    least: FloatArray
    largest: FloatArray
    mean: FloatArray


def interval_values(phase: PhaseSolution, control: Variable) -> IntervalValues:
    if control.shape == "linear":
        nodes = phase.values[control.name]
        values = np.stack([nodes[:-1], nodes[1:]])
        return IntervalValues(values.min(axis=0), values.max(axis=0), values.mean(axis=0))
    layout = phase_layout(phase)
    least, largest, mean = (np.zeros((layout.intervals, control.size)) for _ in range(3))
    for group in layout.groups:
        values, own = point_values(phase, group, control), group.intervals
        least[own], largest[own] = values.min(axis=1), values.max(axis=1)
        scheme = group.kind.scheme
        if control.shape == "polynomial" and isinstance(scheme, Collocation):
            mean[own] = np.einsum("j,kji->ki", scheme.weights, values)
        else:
            mean[own] = values[:, 0]
    return IntervalValues(least, largest, mean)


def _component_switches(
    mesh: FloatArray, control: Variable, component: int, values: IntervalValues
) -> list[Switch]:
    low, high = float(control.lower[component]), float(control.upper[component])
    if low == high:
        return []
    continuous = control.shape == "linear"
    ends = values.least[:, component], values.largest[:, component]
    means = values.mean[:, component]
    tight = _at_bounds(*ends, low, high, RAMP_AT_BOUND if continuous else AT_BOUND)
    loose = _at_bounds(*ends, low, high, NEARLY_AT_BOUND)
    steps = np.diff(mesh)
    found = []
    for before, after in itertools.pairwise(np.flatnonzero(loose)):
        if loose[before] == loose[after]:
            continue
        # an interval that is only nearly at its bound holds a rest of the ramp
        first, last = before + bool(tight[before]), after - bool(tight[after])
        if last - first + 1 > LONGEST_RAMP:
            continue
        begin, end = float(mesh[first]), float(mesh[last + 1])
        one, other = (high, low) if loose[before] > 0 else (low, high)
        area = float(means[first : last + 1] @ steps[first : last + 1])
        place = float(np.clip((area - other * end + one * begin) / (one - other), begin, end))
        offset = (end - begin) / 2 if continuous else float(np.abs(mesh - place).min())
        found.append(
            Switch(control.name, component, place, begin, end, other > one, continuous, offset)
        )
    return found


def _at_bounds(
    least: FloatArray, largest: FloatArray, low: float, high: float, share: float
) -> np.ndarray:
    """1 for intervals [N] at the upper bound, -1 at the lower one, else 0."""
    near = share * (high - low)
    return (least >= high - near).astype(int) - (largest <= low + near).astype(int)


def move_to_switches(mesh: FloatArray, switches: Sequence[Switch], accuracy: float) -> FloatArray:
    """Put mesh points where the controls switch.

    The nearest mesh point moves to the switch, unless it is an end of the phase or holds another
    switch already: then a point is added. Points on both sides keep the intervals at the switch
    short: in the one that holds the rest of it the multipliers belong to a switch in its middle. A
    ramp of a continuous control becomes shorter: points go to both sides of the switch, and what
    was inside the ramp is dropped.
    """
    points = mesh.copy()
    taken = [s.place for s in switches if not s.continuous and s.offset <= accuracy]
    for switch in switches:
        if switch.offset <= accuracy:
            continue
        if switch.continuous:
            reach = RAMP_LEFT * (switch.end - switch.begin)
            inside = (points > switch.begin) & (points < switch.end)
            fresh = [switch.place - reach, switch.place + reach]
            points = np.concatenate([points[~inside], [p for p in fresh if 0.0 < p < 1.0]])
        else:
            nearest = int(np.abs(points - switch.place).argmin())
            own = points[nearest]
            free = 0.0 < own < 1.0 and all(abs(own - t) > accuracy for t in taken)
            if free:
                points = np.delete(points, nearest)
            before = switch.place - points[points < switch.place - 1e-9].max()
            after = points[points > switch.place + 1e-9].min() - switch.place
            reach = BRACKET * min(before, after)
            sides = [switch.place - reach, switch.place + reach] if reach > accuracy else []
            points = np.concatenate([points, [switch.place], sides])
            taken.append(switch.place)
        points = np.sort(points)
    return points[np.concatenate([[True], np.diff(points) > 1e-9])]
