"""Profiles of controllers: small files of figures, each with its source."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError, naming
from microbot_ocp._base.reading import text_of
from microbot_ocp._base.schema import ANY, FLAG, NEEDED, TABLE, TEXT, Key, parsed, read_table
from microbot_ocp.limits import JOINT_QUANTITIES, JointLimits, Limit, Limits
from microbot_ocp.robot import Robot

COLUMNS = ("q", "qd", "qdd", "tau")
HELD = ("hold", "linear")  # commands are held, so the drives lag the rows by one step
INTERPOLATIONS = (*HELD, "cubic", "quintic")
LIMIT_KEYS = tuple(f"{key}_{side}" for key in JOINT_QUANTITIES for side in ("min", "max"))
BRAKING_KEYS = ("q_min", "q_max", "qd_max", "deceleration", "offset")


@dataclass(frozen=True)
class Profile:
    """Interpolation of a controller between rows, and the limits that its commands must keep.

    Attributes
    ----------
    name, description : str
        Name and description of the controller.
    interpolation : "hold", "linear", "cubic" or "quintic"
        Rule between rows. "hold": a row is a command, and velocity, acceleration and jerk are its
        differences from step to step. "linear": commands lie on straight lines between the rows and
        are held. "cubic", "quintic": Hermite polynomials through the velocities, or through
        velocities and accelerations.
    rate : float or None
        Command rate, Hz; None if the installation decides.
    limits : Limits
        Limits besides those of the robot.
    columns : tuple of str
        Quantities of the rows, from "q", "qd", "qdd" and "tau".
    gravity : bool
        True if efforts include the torque of gravity.
    rests : bool
        True if the first and the last row must be at rest.
    sources : mapping
        Source of each figure, and the figures that are left out because no source states them.
    """

    name: str
    interpolation: str
    rate: float | None = None
    limits: Limits = field(default_factory=Limits)
    columns: tuple[str, ...] = COLUMNS
    gravity: bool = True
    rests: bool = True
    description: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        checks.one_of("interpolation", self.interpolation, INTERPOLATIONS)
        for key in self.columns:
            checks.one_of("columns", key, COLUMNS)
        if self.rate is not None:
            checks.number("rate", self.rate, "Hz", above=0.0)

    @property
    def step(self) -> float:
        """Time between two commands, s."""
        if self.rate is None:
            raise InputError(f"profile {self.name!r} needs a rate in Hz, such as '{self.name}@500'")
        return 1.0 / self.rate

    def limits_of(self, robot: Robot) -> JointLimits:
        """Return the tighter one of each limit of a robot and of the controller.

        Plan under these limits if a motion would otherwise have to be slowed down much.

        Raises
        ------
        InputError
            The robot has another number of joints than the limits.
        """
        with naming(f"profile {self.name}, for other joints than {robot.name}'s: "):
            return robot.limits.tightened(self.limits.for_joints(robot.joint_count))


@dataclass(frozen=True)
class _Ahead:
    """Velocity predicted for a time ahead (s), at the present acceleration."""

    time: float

    def __call__(self, state: Any) -> Any:
        return state.qd + self.time * state.qdd if self.time else state.qd


@dataclass(frozen=True)
class _Braking:
    """Largest velocity from which a joint can still brake before the end of its range.

    Upwards it is ``min(qd_max, max(0, sqrt(2 deceleration (end - q)) - offset))``, and likewise
    downwards.
    """

    sign: float
    end: tuple[float, ...]
    qd_max: tuple[float, ...]
    deceleration: tuple[float, ...]
    offset: tuple[float, ...]

    def __call__(self, state: Any) -> Any:
        import casadi as ca  # importing here lets the command line list profiles without CasADi

        room = ca.fmax(0.0, self.sign * (ca.DM(self.end) - state.q))
        fast = ca.sqrt(2.0 * ca.DM(self.deceleration) * room) - ca.DM(self.offset)
        return self.sign * ca.fmin(ca.DM(self.qd_max), ca.fmax(0.0, fast))


def packaged_profiles() -> tuple[str, ...]:
    """Return the names of the profiles that come with the package.

    Examples
    --------
    >>> packaged_profiles()
    ('fr3', 'hold', 'panda', 'ros2_jtc_cubic', 'ros2_jtc_linear', 'ros2_jtc_quintic', 'ur_servoj')
    """
    names = (file.name for file in _packaged().iterdir())
    return tuple(sorted(name[:-5] for name in names if name.endswith(".toml")))


def _packaged() -> Any:
    return resources.files("microbot_ocp.execution") / "profiles"


def load_profile(source: str | Path | Profile) -> Profile:
    """Load the profile of a controller.

    Parameters
    ----------
    source : str, Path or Profile
        Name from :func:`packaged_profiles`, or path of a ``.toml`` file; ``@RATE`` after a name
        sets the rate in Hz: "hold@250". A profile is returned unchanged.

    Raises
    ------
    InputError
        The name is unknown, the file is missing, or a key is unknown or of the wrong kind.

    Examples
    --------
    >>> profile = load_profile("fr3")
    >>> profile.rate, profile.interpolation
    (1000.0, 'hold')
    """
    if isinstance(source, Profile):
        return source
    name, _, rate = str(source).partition("@")
    if name in packaged_profiles():
        text, origin = (_packaged() / f"{name}.toml").read_text("utf-8"), f"{name}.toml"
    elif Path(str(source)).suffix == ".toml":
        text, origin, rate = text_of(str(source), "profile file"), Path(str(source)).name, ""
    else:
        raise InputError(
            f"profile must be one of {', '.join(packaged_profiles())}, optionally followed by "
            f"@RATE in Hz, or the path of a .toml file, not {checks.shown(source)}"
        )
    with naming(f"{origin}: "):
        profile = _profile(parsed(text))
    if not rate:
        return profile
    try:
        hertz = float(rate)
    except ValueError:
        raise InputError(f"rate of profile {name!r} must be a number of Hz, not {rate!r}") from None
    return replace(profile, rate=checks.number("rate", hertz, "Hz", above=0.0))


PROFILE = {
    "name": Key(str, needed=True),
    "description": TEXT,
    "interpolation": NEEDED,
    "rate": ANY,
    "columns": Key(choices=COLUMNS, several=True),
    "gravity": FLAG,
    "rests": FLAG,
    "limits": TABLE,
    "braking": TABLE,
    "look_ahead": ANY,
    "sources": ANY,
}


def _profile(data: Mapping[str, Any]) -> Profile:
    from microbot_ocp.limits import MEMBER_KEYS, limits_from_table  # this import loads CasADi

    given = read_table(data, PROFILE)
    limits, braking = (given.pop(key, {}) for key in ("limits", "braking"))
    ahead = given.pop("look_ahead", None)
    if "columns" in given:
        given["columns"] = tuple(given["columns"])
    keys = dict.fromkeys((*LIMIT_KEYS, *MEMBER_KEYS), ANY)
    bounds = read_table(limits, keys, "in table [limits]")
    also = list(limits_from_table({key: bounds.pop(key) for key in MEMBER_KEYS if key in bounds}))
    bounds = {key: checks.numbers(key, value).tolist() for key, value in bounds.items()}
    velocity: Any = np.negative(bounds.get("qd_max", 0.0)), bounds.get("qd_max", 0.0)
    if braking:
        braking = read_table(braking, dict.fromkeys(BRAKING_KEYS, NEEDED), "in table [braking]")
        rows = (checks.array(key, braking[key], (None,)) for key in BRAKING_KEYS)
        low, high, *others = (tuple(row.tolist()) for row in rows)
        velocity = _Braking(-1.0, low, *others), _Braking(1.0, high, *others)
        also.append(Limit("velocity before the end", _Ahead(0.0), *velocity, unit="rad/s"))
    if ahead is not None:
        ahead = checks.number("look_ahead", ahead, "s", above=0.0)
        if not (braking or "qd_max" in bounds):
            raise InputError("look_ahead needs qd_max in table [limits], or a table [braking]")
        also.append(Limit("velocity ahead", _Ahead(ahead), *velocity, unit="rad/s"))
    return Profile(**given, limits=Limits(**bounds, also=also))
