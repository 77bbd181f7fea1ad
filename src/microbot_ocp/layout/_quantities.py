"""Free quantities of a cell: their names, units, bounds, and the cell with other values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.planning.task import Stop, reach_of
from microbot_ocp.robot import rotation_of
from microbot_ocp.tasks import CellFile

AXES = ("x", "y", "z")
PLACE = (*AXES, "yaw")
KINDS = ("base", "tool", "stops", "gear ratio")
REACH = 0.25  # share of the reach: default displacement in both directions
TURN = 0.5 * np.pi  # rad, default turn in both directions
GEARS = (0.5, 2.0)


@dataclass(frozen=True)
class Quantity:
    """One free quantity of a cell.

    Attributes
    ----------
    kind : str
        "base", "tool", "stops" or "gear ratio".
    target : str
        Name of the stop or joint; empty for base and tool.
    axis : str
        "x", "y", "z" or "yaw"; empty for a gear ratio.
    start : float
        Value in the given cell, in the unit of the quantity.
    lower, upper : float
        Bounds.
    """

    kind: str
    target: str
    axis: str
    start: float
    lower: float = 0.0
    upper: float = 0.0

    @property
    def name(self) -> str:
        """Name such as "base.x", "stops.place.yaw" or "gear ratio.elbow"."""
        return ".".join(filter(None, (self.kind, self.target, self.axis)))

    @property
    def unit(self) -> str:
        """Unit "m" or "rad"; empty for a gear ratio."""
        return {"yaw": "rad", "": ""}.get(self.axis, "m")


def quantities_of(cell: CellFile, free: Any, bounds: Any) -> tuple[Quantity, ...]:
    """Return the free quantities of a cell.

    Raises
    ------
    InputError
        A name that is unknown or stands twice, a quantity that the cell does not have, bounds that
        are no range around the start.
    """
    names = list(_names(free))
    if not names:
        raise InputError("free must name at least one quantity, such as {'base': ('x', 'y')}")
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"free has {name!r} twice")
    given = dict(_ranges(bounds or {}))
    for name in given:
        checks.one_of("bounds", name, names)
    return tuple(_bounded(cell, _quantity(cell, name), given.get(name)) for name in names)


def _names(free: Any) -> Iterator[str]:
    """Yield dotted names out of ``{"base": ("x", "y")}`` or ``("base.x", "base.y")``."""
    if isinstance(free, str):
        yield free
    elif isinstance(free, Mapping):
        for key, value in free.items():
            yield from (f"{key}.{name}" for name in _names(value))
    elif isinstance(free, Sequence):
        for name in free:
            yield from _names(name)
    else:
        raise InputError(f"free must be names of quantities, not {checks.shown(free)}")


def _ranges(bounds: Any) -> Iterator[tuple[str, Any]]:
    """Yield dotted names with their ranges out of ``{"base": {"x": (-0.1, 0.1)}}``."""
    if not isinstance(bounds, Mapping):
        raise InputError(f"bounds must be a mapping of names, not {checks.shown(bounds)}")
    for key, value in bounds.items():
        if isinstance(value, Mapping):
            yield from ((f"{key}.{name}", pair) for name, pair in _ranges(value))
        else:
            yield str(key), value


def _quantity(cell: CellFile, name: str) -> Quantity:
    kind, _, rest = name.partition(".")
    checks.one_of("free quantity", kind, KINDS)
    if kind == "gear ratio":
        checks.one_of(f"joint of {kind}", rest, cell.robot.joint_names)
        cell.mounting.factors(cell.robot)
        return Quantity(kind, rest, "", cell.mounting.gear_ratio.get(rest, 1.0))
    if kind == "stops":
        target, _, axis = rest.rpartition(".")
        stops = {stop.name: stop for stop in cell.stops}
        checks.one_of("stop of the free stops", target, stops)
        checks.one_of(f"free quantity of stop {target!r}", axis, PLACE)
        stop = stops[target]
        if stop.position is None:
            raise InputError(f"stop {target!r} is a joint pose: only tool positions can be free")
        if axis == "yaw":
            if stop.orientation is None:
                raise InputError(f"{name} is without effect: any orientation will do there")
            return Quantity(kind, target, axis, 0.0)
        return Quantity(kind, target, axis, float(stop.position[AXES.index(axis)]))
    checks.one_of(f"free quantity of the {kind}", rest, PLACE if kind == "base" else ("yaw",))
    key = rest if kind == "base" else "tool_yaw"
    return Quantity(kind, "", rest, getattr(cell.mounting, key))


def _bounded(cell: CellFile, quantity: Quantity, given: Any) -> Quantity:
    """Return the quantity with bounds: those given, or usual ones around the start."""
    name, start = quantity.name, quantity.start
    if given is None:
        size = TURN if quantity.axis == "yaw" else REACH * reach_of(cell.robot)
        usual = (
            (start - size, start + size) if quantity.axis else (GEARS[0] * start, GEARS[1] * start)
        )
        return replace(quantity, lower=usual[0], upper=usual[1])
    low, high = checks.array(f"bounds of {name}", given, (2,), quantity.unit).tolist()
    if not low <= start <= high or low == high:
        raise InputError(
            f"bounds of {name} must be a range that holds the present {start:.6g}, not "
            f"{low:g} to {high:g} {quantity.unit}".rstrip()
        )
    if quantity.kind == "gear ratio" and low <= 0.0:
        raise InputError(f"bounds of {name} must be above 0, not from {low:g}")
    return replace(quantity, lower=low, upper=high)


def cell_with(cell: CellFile, quantities: Sequence[Quantity], values: FloatArray) -> CellFile:
    """Return the cell with other values of the quantities."""
    mounting, gears, stops = {}, dict(cell.mounting.gear_ratio), {}
    for quantity, value in zip(quantities, values.tolist(), strict=True):
        if value == quantity.start:
            continue
        if quantity.kind == "gear ratio":
            gears[quantity.target] = value
        elif quantity.kind == "stops":
            stops.setdefault(quantity.target, {})[quantity.axis] = value
        else:
            mounting["tool_yaw" if quantity.kind == "tool" else quantity.axis] = value
    moved = tuple(_moved(stop, stops.get(stop.name, {})) for stop in cell.stops)
    changed = replace(cell, stops=moved) if stops else cell
    return changed.mounted(replace(cell.mounting, **mounting, gear_ratio=gears))


def _moved(stop: Stop, changes: Mapping[str, float]) -> Stop:
    if not changes:
        return stop
    assert stop.position is not None
    position = [changes.get(axis, old) for axis, old in zip(AXES, stop.position, strict=True)]
    turned = stop.orientation
    if "yaw" in changes:
        turned = rotation_of([0.0, 0.0, changes["yaw"]]) @ np.array(turned)
    return replace(stop, position=position, orientation=turned)
