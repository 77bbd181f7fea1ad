"""How much of every limit a motion uses, moment by moment: which actuator saturates when."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits._use import LimitUse
from microbot_ocp.motion import JUMP_GAP, Motion, State, mesh_of, torque_along
from microbot_ocp.robot import JointLimits, Limits, Robot, torque_and_rate

GRID_STEP = 0.25e-3  # s, the longest step of the dense grid
GRID_RATIO = 20  # dense grid points to each mesh interval, at least
SATURATED = 0.99  # share of a limit from which on it counts as used up
SHORTEST = 2e-3  # s: gaps and spells shorter than this are put down to the solver's mesh

QUANTITY_NAMES = {
    "q": "position",
    "qd": "velocity",
    "qdd": "acceleration",
    "tau": "torque",
    "taud": "torque rate",
}


class Spell(NamedTuple):
    """A stretch of time, s, in which a joint has one of its limits used up.

    ``side`` is 1 at the upper limit, -1 at the lower one.
    """

    quantity: str
    joint: int
    side: int
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class LimitHistory:
    """Use of every kind of limit along a motion, on a dense grid.

    Attributes
    ----------
    t : array [N], s
    uses : tuple of LimitUse
        One for every kind of limit that the robot has.
    values : mapping from "q", "qd", "qdd", "tau", "taud" to array [N,n]
        SI; those that some limit is of.
    shares : mapping from a quantity to array [N,n]
        1 at the limit, minus infinity where a joint has none; for q 0 in the middle of its range.
    """

    t: FloatArray
    uses: tuple[LimitUse, ...]
    values: Mapping[str, FloatArray]
    shares: Mapping[str, FloatArray]

    @classmethod
    def of(
        cls,
        robot: Robot,
        limits: JointLimits,
        motion: Motion,
        t: FloatArray,
        state: State,
    ) -> LimitHistory:
        """The use of the limits at times t [N] with their states."""
        uses = tuple(LimitUse.of(limits, quantity) for quantity in QUANTITY_NAMES)
        uses = tuple(use for use in uses if use.limited.any())
        values = {"q": state.q, "qd": state.qd, "qdd": state.qdd}
        if any(use.quantity == "taud" for use in uses):
            columns = (*state, _jerk(motion, t))
            tau, taud = torque_and_rate(robot)(*(column.T for column in columns))
            values["tau"], values["taud"] = np.array(tau).T, np.array(taud).T
            _add_jumps(robot, motion, t, values["taud"])
        elif any(use.quantity == "tau" for use in uses):
            values["tau"] = torque_along(robot, state)
        shares = {use.quantity: use(values[use.quantity]) for use in uses}
        return cls(t, uses, values, shares)

    def spells(self, quantity: str, share: float = SATURATED) -> list[Spell]:
        """When which joint uses a limit to ``share`` or more, in the order of joints and time.

        Gaps of less than 2 ms are closed, spells of less are left out.
        """
        if quantity not in self.shares:
            return []
        found = []
        values, shares = self.values[quantity], self.shares[quantity]
        (use,) = (use for use in self.uses if use.quantity == quantity)
        middle = np.zeros(shares.shape[1])
        if quantity == "q":
            both = np.isfinite(use.lower) & np.isfinite(use.upper)
            middle = np.where(both, 0.5 * (use.lower + use.upper), values.mean(axis=0))
        for joint in range(shares.shape[1]):
            for side in (1, -1):
                busy = (shares[:, joint] >= share) & (side * (values[:, joint] - middle[joint]) > 0)
                for start, end in _runs(self.t, busy):
                    found.append(Spell(quantity, joint, side, start, end))
        return sorted(found, key=lambda spell: (spell.joint, spell.start))


def limit_history(
    robot: Robot, motion: Motion, limits: Limits | JointLimits | None = None
) -> LimitHistory:
    """How much of every limit a motion uses, on the dense grid of its certificate.

    Parameters
    ----------
    robot : Robot
        With masses where torques are limited.
    motion : Motion
    limits : Limits, optional
        Default the robot's own.

    Returns
    -------
    LimitHistory

    Raises
    ------
    InputError
        A motion of another number of joints.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> shape = mo.cubic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 3.0])
    >>> history = limit_history(robot, mo.Motion.from_polynomial(robot, shape, label="cubic"))
    >>> sorted(history.shares), history.spells("tau")
    (['q', 'qd', 'tau'], [])
    """
    count = robot.joint_count
    if motion.joint_count != count:
        raise InputError(f"motion is of {motion.joint_count} joints, but the robot has {count}")
    chosen = (robot.limits if limits is None else limits).for_joints(count)
    t, _ = dense_times(motion)
    return LimitHistory.of(robot, chosen, motion, t, motion.sample(t))


def dense_times(motion: Motion) -> tuple[FloatArray, float]:
    """Dense grid and its least number of points to a mesh interval."""
    mesh = mesh_of(motion)
    lengths = np.diff(mesh)
    points = np.maximum(GRID_RATIO, np.ceil(lengths / GRID_STEP - 1e-9)).astype(int)
    first = np.repeat(np.cumsum(points) - points, points)
    place = (np.arange(points.sum()) - first) / np.repeat(points, points)
    grid = np.repeat(mesh[:-1], points) + place * np.repeat(lengths, points)
    # Just before each break as well, for the limits from the left.
    before = mesh[1:-1] - np.minimum(2 * JUMP_GAP, 1e-3 * lengths[:-1])
    return np.unique(np.concatenate([grid, before, motion.t])), float(points.min())


def _jerk(motion: Motion, t: FloatArray) -> FloatArray:
    """Slope of the acceleration [N,n], by differences inside the interval between two samples."""
    i = np.clip(np.searchsorted(motion.t, t, side="right") - 1, 0, motion.t.size - 2)
    start, end = motion.t[i], motion.t[i + 1]
    reach = 0.05 * (end - start)
    low = np.clip(t - reach, start, end)
    # The end of an interval belongs to the next one when sampled.
    high = np.clip(t + reach, start, end - 1e-3 * (end - start))
    step = (high - low)[:, None]
    return (motion.sample(high).qdd - motion.sample(low).qdd) / step


def _add_jumps(robot: Robot, motion: Motion, t: FloatArray, taud: FloatArray) -> None:
    """Where two samples stand for a jump, the torque rate is their difference over the gap."""
    first = np.flatnonzero(np.diff(motion.t) <= 2 * JUMP_GAP)
    if not first.size:
        return
    ends = np.concatenate([first, first + 1])
    tau = torque_along(robot, State(motion.q[ends], motion.qd[ends], motion.qdd[ends]))
    gap = (motion.t[first + 1] - motion.t[first])[:, None]
    taud[np.searchsorted(t, motion.t[first])] = (tau[first.size :] - tau[: first.size]) / gap


def _runs(t: FloatArray, busy: np.ndarray) -> list[tuple[float, float]]:
    """Stretches of time in which ``busy`` [N] holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], busy, [False]]).astype(int)))
    joined: list[list[float]] = []
    for first, after in edges.reshape(-1, 2):
        start, end = float(t[first]), float(t[after - 1])
        if joined and start - joined[-1][1] < SHORTEST:
            joined[-1][1] = end
        else:
            joined.append([start, end])
    return [(start, end) for start, end in joined if end - start >= SHORTEST]
