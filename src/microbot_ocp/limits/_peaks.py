"""Dense maxima of what a motion asks of the limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits._use import ROUNDING, LimitUse
from microbot_ocp.motion import PiecewisePolynomial
from microbot_ocp.robot import JointLimits, Robot, inverse_dynamics, torque_and_rate

POINTS_PER_PIECE = 200  # first grid for the maxima, before they are refined
REFINEMENT_ROUNDS = 8  # each divides the grid step around a maximum by four
CANDIDATES = 60  # at most so many maxima are refined at a time


@dataclass(frozen=True)
class Peak:
    """Where a motion uses most of its limits."""

    use: float
    quantity: str = "shape"
    joint: int = 0
    time: float = 0.0
    value: float = np.nan
    limit: float = np.nan


class Demand:
    """Dense maxima of what a motion asks of the limits.

    Every piece is evaluated with both its ends, so both one-sided limits at a break count. The
    grid's largest local maxima are then refined by sampling ever closer around them.
    """

    def __init__(self, robot: Robot, limits: JointLimits) -> None:
        self.robot = robot
        uses = [LimitUse.of(limits, kind) for kind in ("q", "qd", "qdd", "tau", "taud")]
        self.uses = {use.quantity: use for use in uses if use.limited.any()}
        if {"tau", "taud"} & self.uses.keys():
            inverse_dynamics(robot)  # raises for a robot without masses

    def values(
        self, orders: Sequence[FloatArray], piece: np.ndarray, local: FloatArray, kinds: set[str]
    ) -> dict[str, FloatArray]:
        """Values [S,n] of each kind at ``local`` seconds after the start of the pieces [S]."""
        names = ("q", "qd", "qdd", "qddd")
        state: dict[str, FloatArray] = {}
        for name, coefficients in zip(names, orders, strict=True):
            state[name] = _horner(coefficients[piece], local)
        if "taud" in kinds:
            tau, taud = torque_and_rate(self.robot)(*(state[name].T for name in names))
            state["tau"], state["taud"] = np.array(tau).T, np.array(taud).T
        elif "tau" in kinds:
            tau = inverse_dynamics(self.robot)(*(state[name].T for name in names[:3]))
            state["tau"] = np.array(tau).T
        return {kind: state[kind] for kind in kinds}

    def peak(
        self, polynomial: PiecewisePolynomial, kinds: Sequence[str], *, at_rest: bool = False
    ) -> Peak:
        """The largest use of the limits of these kinds, over all joints and all times."""
        wanted = [kind for kind in kinds if kind in self.uses]
        if not wanted:
            return Peak(-np.inf)
        orders = _orders(polynomial)
        if at_rest:
            orders = [orders[0], *(np.zeros_like(c) for c in orders[1:])]
        jump = self._torque_jump(polynomial, orders) if "taud" in wanted else None
        if jump is not None:
            return jump
        lengths = np.diff(polynomial.breaks)
        pieces, points = lengths.size, POINTS_PER_PIECE
        fraction = np.linspace(0.0, 1.0, points + 1)
        piece = np.repeat(np.arange(pieces), points + 1)

        def use_at(which: np.ndarray, local: FloatArray) -> FloatArray:
            values = self.values(orders, which, local, set(wanted))
            return np.hstack([self.uses[kind](values[kind]) for kind in wanted])

        local = (lengths[:, None] * fraction).ravel()
        use = use_at(piece, local).reshape(pieces, points + 1, -1)
        k, i, channel = _candidates(use)
        center, best = lengths[k] * fraction[i], use[k, i, channel]
        reach = lengths[k] / points
        offsets = np.linspace(-1.0, 1.0, 9)
        for _ in range(REFINEMENT_ROUNDS):
            around = np.clip(center[:, None] + reach[:, None] * offsets, 0.0, lengths[k][:, None])
            found = use_at(np.repeat(k, offsets.size), around.ravel())
            found = found.reshape(k.size, offsets.size, -1)
            own = np.take_along_axis(found, channel[:, None, None], axis=2)[:, :, 0]
            pick = own.argmax(axis=1)
            row = np.arange(k.size)
            center, best = around[row, pick], np.maximum(best, own[row, pick])
            reach = reach / 4.0
        top = int(best.argmax())
        quantity = wanted[channel[top] // self.robot.joint_count]
        joint = int(channel[top] % self.robot.joint_count)
        value = self.values(orders, k[top : top + 1], center[top : top + 1], set(wanted))
        value = float(value[quantity][0, joint])
        return Peak(
            use=float(best[top]),
            quantity=quantity,
            joint=joint,
            time=float(polynomial.breaks[k[top]] + center[top]),
            value=value,
            limit=self.uses[quantity].limit(value, joint),
        )

    def _torque_jump(
        self, polynomial: PiecewisePolynomial, orders: Sequence[FloatArray]
    ) -> Peak | None:
        """An infinite torque rate: a jump of the torque of a joint whose rate is limited."""
        lengths = np.diff(polynomial.breaks)
        inner = np.arange(lengths.size - 1)
        if not inner.size:
            return None
        before = self.values(orders, inner, lengths[:-1], {"tau"})["tau"]
        after = self.values(orders, inner + 1, np.zeros(inner.size), {"tau"})["tau"]
        size = 1.0 + max(np.abs(before).max(), np.abs(after).max())
        step = np.where(self.uses["taud"].limited, after - before, 0.0)
        k, joint = np.unravel_index(np.abs(step).argmax(), step.shape)
        if abs(step[k, joint]) <= 1e-7 * size:
            return None
        value = float(np.copysign(np.inf, step[k, joint]))
        return Peak(
            use=np.inf,
            quantity="taud",
            joint=int(joint),
            time=float(polynomial.breaks[k + 1]),
            value=value,
            limit=float(
                self.uses["taud"].upper[joint] if value > 0 else self.uses["taud"].lower[joint]
            ),
        )

    def refusal(self, polynomial: PiecewisePolynomial) -> str | None:
        """Why no duration of this shape keeps the limits, or None."""
        robot = self.robot
        place = self.peak(polynomial, ["q"])
        if place.use > 1.0 + ROUNDING:
            return (
                f"the shape leaves the position limits: joint {robot.joint_names[place.joint]!r} "
                f"reaches {_position(robot, place.joint, place.value)} at {place.time:.6g} s, but "
                f"its limit is {_position(robot, place.joint, place.limit)}"
            )
        held = self.peak(polynomial, ["tau"], at_rest=True)
        if held.use > 1.0 + ROUNDING:
            unit = robot.unit("tau", held.joint)
            use = self.uses["tau"]
            pose = polynomial([held.time])[0]
            values = [_position(robot, j, q, short=True) for j, q in enumerate(pose)]
            return (
                f"holding the arm still at q = ({', '.join(values)}), {held.time:.6g} s into the "
                f"shape, takes {held.value:.6g} {unit} at joint {robot.joint_names[held.joint]!r}, "
                f"but its torque limits are {use.lower[held.joint]:g} to "
                f"{use.upper[held.joint]:g} {unit}, so no duration keeps them"
            )
        if "taud" in self.uses:
            jump = self._torque_jump(polynomial, _orders(polynomial))
            if jump is not None:
                return (
                    f"the torque of joint {robot.joint_names[jump.joint]!r} jumps at "
                    f"{jump.time:.6g} s, so no duration keeps its torque rate limit of "
                    f"{abs(jump.limit):g} {robot.unit('taud', jump.joint)}; take a shape with "
                    "continuous acceleration, such as a quintic"
                )
        return None


def _orders(polynomial: PiecewisePolynomial) -> list[FloatArray]:
    """Coefficients of position, velocity, acceleration and jerk."""
    orders = [polynomial]
    for _ in range(3):
        orders.append(orders[-1].derivative())
    return [order.coefficients for order in orders]


def _horner(coefficients: FloatArray, local: FloatArray) -> FloatArray:
    value = np.zeros((local.size, coefficients.shape[2]))
    for power in reversed(range(coefficients.shape[1])):
        value = value * local[:, None] + coefficients[:, power]
    return value


def _candidates(use: FloatArray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Local maxima of ``use`` [pieces, points, channels] that may hold the overall one."""
    finite = np.where(np.isfinite(use), use, -1e300)
    left = np.full_like(finite, -np.inf)
    right = np.full_like(finite, -np.inf)
    left[:, 1:], right[:, :-1] = finite[:, :-1], finite[:, 1:]
    curvature = np.zeros_like(finite)
    curvature[:, 1:-1] = np.abs(finite[:, :-2] - 2 * finite[:, 1:-1] + finite[:, 2:])
    curvature[:, 0], curvature[:, -1] = curvature[:, 1], curvature[:, -2]
    # A smooth maximum between grid points lies an eighth of the second difference above them.
    hope = finite + curvature
    peaks = (finite >= left) & (finite > right) & (hope >= finite.max())
    found = np.argwhere(peaks)
    order = np.argsort(-hope[tuple(found.T)], kind="stable")[:CANDIDATES]
    k, i, channel = found[order].T
    return k, i, channel


def _position(robot: Robot, joint: int, value: float, *, short: bool = False) -> str:
    if robot.joint_types[joint] == "prismatic":
        return f"{value:.6g} m"
    degrees = f"{np.degrees(value):.6g} deg"
    return degrees if short else f"{degrees} ({value:.6g} rad)"
