"""Further limits by name: a line here makes a limit known to files and the command line."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from microbot_ocp._base.checks import InputError, shown
from microbot_ocp.limits._limit import Limit
from microbot_ocp.limits._power import power, total_power
from microbot_ocp.limits._rms_torque import rms_torque
from microbot_ocp.limits._tool_acceleration import tool_acceleration
from microbot_ocp.limits._tool_speed import tool_speed

MEMBERS: dict[str, Callable[..., Limit]] = {
    member.__name__: member
    for member in (tool_speed, tool_acceleration, power, total_power, rms_torque)
}
# Keys in files: "tool_speed_max", and "power_min" where there may be a lower bound.
MEMBER_KEYS = {
    f"{name}_{end}": (name, side)
    for name, member in MEMBERS.items()
    for side, end in (("lower", "min"), ("upper", "max"))
    if side in inspect.signature(member).parameters
}


def limits_from_table(table: Mapping[str, Any]) -> tuple[Limit, ...]:
    """Read further limits from the keys of :data:`MEMBER_KEYS`, with numbers or lists of them."""
    bounds: dict[str, dict[str, Any]] = {}
    for key, value in table.items():
        name, side = MEMBER_KEYS[key]
        bounds.setdefault(name, {})[side] = value
    return tuple(MEMBERS[name](**sides) for name, sides in bounds.items())


def with_further(limits: Iterable[Limit], table: Mapping[str, Any]) -> tuple[Limit, ...]:
    """Return limits with those of a table added, or in the place of those of the same name."""
    given = limits_from_table(table)
    names = {limit.key for limit in given}
    return (*(limit for limit in limits if limit.key not in names), *given)


def limits_to_table(limits: Iterable[Limit]) -> dict[str, Any]:
    """Return the keys and numbers that :func:`limits_from_table` reads back.

    Raises
    ------
    InputError
        A limit of the user's own, or a bound that is an expression: files hold numbers only.
    """
    table: dict[str, Any] = {}
    for limit in limits:
        if not isinstance(limit, Limit):
            raise InputError(f"limits must be a list, each entry a Limit, not {shown(limits)}")
        sides = {side: limit.constant(side) for side in ("lower", "upper")}
        given = {side: value for side, value in sides.items() if value is not None}
        written = {
            key: given[side].item() if given[side].size == 1 else given[side].tolist()
            for key, (name, side) in MEMBER_KEYS.items()
            if name == limit.key and side in given
        }
        if not written or limits_from_table(written) != (limit,):
            raise InputError(
                f"limit {limit.name!r} is an expression of its own, which a file cannot hold: "
                "add it in Python after loading"
            )
        table |= written
    return table
