"""Use of every limit along a motion, and the largest use of a piecewise polynomial.

Jumps of the acceleration, which limits of jerk and torque rate exclude, count as well; the rule for
rest at the ends of a motion is defined here. Theory: docs/theory/certificates.md, equation (1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError, shown
from microbot_ocp.limits._family import LimitFamily, LimitValues, MotionSamples
from microbot_ocp.limits._joint_limits import JointLimits, Limits
from microbot_ocp.limits._use import AT_LIMIT

JUMP_TIME = 1e-6  # s, assumed duration of a jump of the acceleration
SHORTEST = 2e-3  # s; shorter gaps and spells are an effect of the solver's mesh


class StateHistory(NamedTuple):
    """States along a motion, and the jumps of the acceleration at its ends and inside of it.

    Attributes
    ----------
    t : array [N]
        Times, s.
    samples : MotionSamples [N]
        States without the jumps; next to a jump, the jerk is the one-sided value.
    jump_t : array [J]
        Times of the jumps, s.
    jumps : MotionSamples [J]
        States from :func:`jumps_between`.
    """

    t: FloatArray
    samples: MotionSamples
    jump_t: FloatArray
    jumps: MotionSamples

    def between(self, start: float, end: float) -> StateHistory:
        """Return the part between two times of the grid, with the jumps at both.

        The sample at the end belongs to the next part.
        """
        first, last = (int(np.abs(self.t - at).argmin()) for at in (start, end))
        here = slice(first, last + (last == self.t.size - 1))
        near = (self.jump_t >= self.t[first]) & (self.jump_t <= self.t[last])
        return StateHistory(
            self.t[here],
            MotionSamples(*(each[here] for each in self.samples)),
            self.jump_t[near],
            MotionSamples(*(each[near] for each in self.jumps)),
        )


def jumps_between(
    starts: MotionSamples, ends: MotionSamples, *, cycle: bool = False
) -> MotionSamples:
    """Return the jumps [K+1] of the acceleration before, between and after K pieces of a motion.

    An arm at rest at an end of its motion is held there, so the acceleration beyond that end is
    zero. Beyond a moving end there is no jump; a cycle continues at its other end. An end counts as
    at rest if its speed is at most the gain of a jump from standstill during :data:`JUMP_TIME`.

    Parameters
    ----------
    starts, ends : MotionSamples [K]
        States at the starts and ends of the pieces.
    cycle : bool
        True if a motion with moving ends continues at its start.

    Returns
    -------
    MotionSamples [K+1]
        States before the jumps (at the start of the motion after it), with the jump of the
        acceleration divided by :data:`JUMP_TIME` as the jerk.
    """
    first, last = starts.qdd[:1], ends.qdd[-1:]
    before = np.concatenate([_beyond(starts, 0, last if cycle else first), ends.qdd])
    after = np.concatenate([starts.qdd, _beyond(ends, -1, first if cycle else last)])
    # Position and velocity are continuous at a jump.
    q, qd = (np.concatenate([a[:1], b]) for a, b in zip(starts[:2], ends[:2], strict=True))
    return MotionSamples(q, qd, before, (after - before) / JUMP_TIME)


def _beyond(states: MotionSamples, row: int, moving: FloatArray) -> FloatArray:
    """Return the acceleration [1,n] beyond an end: zero if the arm rests there, else ``moving``."""
    rests = np.abs(states.qd[row]).max() <= JUMP_TIME * np.abs(states.qdd[row]).max()
    return np.zeros_like(moving) if rests else moving


class Spell(NamedTuple):
    """An interval of time, s, in which a component is at one of its limits.

    ``quantity`` is the key of the limit, ``joint`` the index of the component (0 for a scalar
    limit), ``side`` 1 at the upper bound and -1 at the lower one.
    """

    quantity: str
    joint: int
    side: int
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class LimitHistory:
    """Use of every limit along a motion, on a dense grid.

    Attributes
    ----------
    t : array [N]
        Times, s.
    family : LimitFamily
        Limits of the robot.
    limited : mapping from the key of a limit to LimitValues
        Values [N,k] with their bounds, SI.
    use : mapping from the key of a limit to array [N,k]
        Share of the limit: 1 at the limit, minus infinity without one; 0 in the middle of the
        range of q.
    jumps : LimitHistory, optional
        Use of the limits that depend on the jerk by the jumps of the acceleration, at the ends
        of the motion and inside of it.
    """

    t: FloatArray
    family: LimitFamily
    limited: Mapping[str, LimitValues]
    use: Mapping[str, FloatArray]
    jumps: LimitHistory | None = None

    @classmethod
    def of(
        cls,
        family: LimitFamily,
        history: StateHistory,
        measured: Mapping[str, FloatArray] | None = None,
    ) -> LimitHistory:
        """Return the use of the limits along a motion.

        ``measured`` holds known values [N,n] by key, which are not computed: torques of a drive.
        """

        def used(values: dict[str, LimitValues]) -> dict[str, FloatArray]:
            return {key: family[key].use(v) for key, v in values.items()}

        values = family.values(history.samples, measured=measured)
        leaps = family.values(history.jumps, family.of_order(3))
        jumps = cls(history.jump_t, family, leaps, used(leaps))
        return cls(history.t, family, values, used(values), jumps)

    def judged(self, key: str) -> tuple[FloatArray, LimitValues, FloatArray]:
        """Return times, values and use of a limit in motion, followed by those of the jumps."""
        if self.jumps is None or key not in self.jumps.use:
            return self.t, self.limited[key], self.use[key]
        pair = self.limited[key], self.jumps.limited[key]
        columns = zip(*(np.broadcast_arrays(*values) for values in pair), strict=True)
        joined = map(np.concatenate, columns)
        use = np.concatenate([self.use[key], self.jumps.use[key]])
        return np.append(self.t, self.jumps.t), LimitValues(*joined), use

    @property
    def values(self) -> dict[str, FloatArray]:
        """Values [N,k] by the key of the limit, SI."""
        return {key: entry.value for key, entry in self.limited.items()}

    def spells(self, quantity: str, share: float = AT_LIMIT) -> list[Spell]:
        """Return the spells with a use of at least ``share`` of a limit, sorted by joint and time.

        Gaps shorter than 2 ms are closed; spells shorter than 2 ms are left out.
        """
        if quantity not in self.use:
            return []
        entries = []
        use, values = self.use[quantity], self.limited[quantity]
        nearest = self.family[quantity].nearest_bound(values)
        for joint in range(use.shape[1]):
            for side, bound in ((1, values.upper), (-1, values.lower)):
                of_joint = np.broadcast_to(bound, use.shape)[:, joint]
                busy = (use[:, joint] >= share) & (nearest[:, joint] == of_joint)
                for start, end in _runs(self.t, busy):
                    entries.append(Spell(quantity, joint, side, start, end))
        return sorted(entries, key=lambda spell: (spell.joint, spell.start))

    def every_spell(self) -> list[Spell]:
        """Return the spells at all limits but position, which every motion approaches."""
        return [spell for key in self.use if key != "q" for spell in self.spells(key)]


def limit_history(
    robot: Any, motion: Any, limits: Limits | JointLimits | None = None
) -> LimitHistory:
    """Return the use of every limit along a motion, on the dense grid of its certificate.

    Parameters
    ----------
    robot : Robot
        Robot with masses if torques are limited.
    motion : Motion
    limits : Limits, optional
        Default the robot's own.

    Returns
    -------
    LimitHistory
        Values, bounds and use of every limit over the time.

    Raises
    ------
    InputError
        The motion has another number of joints.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> robot = mo.load_robot("microbot")
    >>> shape = mo.cubic([[0.0, 0.0, 0.0], [0.5, 0.8, 0.4]], [0.0, 3.0])
    >>> history = limit_history(robot, mo.Motion.from_polynomial(robot, shape, label="cubic"))
    >>> sorted(history.use), history.spells("tau")
    (['q', 'qd', 'tau'], [])
    """
    for name, value, method in (("robot", robot, "limits"), ("motion", motion, "history")):
        if not (hasattr(value, method) and hasattr(value, "joint_count")):
            raise InputError(f"{name} must be a {name.title()}, not {shown(value)}")
    count = robot.joint_count
    if motion.joint_count != count:
        raise InputError(f"motion is of {motion.joint_count} joints, but the robot has {count}")
    return LimitHistory.of(LimitFamily.of(robot, limits), motion.history())


def _runs(t: FloatArray, busy: np.ndarray) -> list[tuple[float, float]]:
    """Return the intervals of time in which ``busy`` [N] holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], busy, [False]]).astype(int)))
    joined: list[list[float]] = []
    for first, after in edges.reshape(-1, 2):
        start, end = float(t[first]), float(t[after - 1])
        if joined and start - joined[-1][1] < SHORTEST:
            joined[-1][1] = end
        else:
            joined.append([start, end])
    return [(start, end) for start, end in joined if end - start >= SHORTEST]


# Largest use of a piecewise polynomial motion ----------------------------------------------------


class Polynomial(Protocol):
    """Interface of a piecewise polynomial."""

    @property
    def breaks(self) -> FloatArray: ...
    @property
    def coefficients(self) -> FloatArray: ...
    def derivative(self) -> Polynomial: ...


@dataclass(frozen=True)
class Peak:
    """Largest use of the limits along a motion.

    Attributes
    ----------
    use : float
        Share of the limit, 1 at the limit; infinite for a jump of the acceleration under a limit
        of its rate.
    quantity : str
        Key of the limit; "shape" if there is no motion to evaluate.
    joint : int
        Index of the component, from 0.
    time : float
        Time of the largest use, s.
    value, limit : float
        Value at that time, and its nearest or violated bound.
    """

    use: float
    quantity: str = "shape"
    joint: int = 0
    time: float = 0.0
    value: float = np.nan
    limit: float = np.nan


POINTS_PER_PIECE = 200  # grid points of a piece on which maxima are located
REFINEMENTS = 8  # each divides the grid step around a maximum by four
MOST_CANDIDATES = 60  # maxima that are refined


def largest_use(
    family: LimitFamily, polynomial: Polynomial, keys: Iterable[str], *, at_rest: bool = False
) -> Peak:
    """Return the largest use of the limits of these keys along a motion.

    Every piece is evaluated with both its ends, so both one-sided values at a break count. The
    largest local maxima on the grid are refined by sampling ever closer around them. ``at_rest``
    evaluates the poses of the motion with all derivatives zero.
    """
    wanted = [key for key in keys if key in family]
    if not wanted:
        return Peak(-np.inf)
    orders = orders_of(polynomial)
    jump = None if at_rest else largest_jump(family, polynomial, wanted)
    if jump is not None:
        return jump
    if at_rest:
        orders = [orders[0], *(np.zeros_like(c) for c in orders[1:])]
    lengths = np.diff(polynomial.breaks)
    pieces, points = lengths.size, POINTS_PER_PIECE
    fraction = np.linspace(0.0, 1.0, points + 1)
    piece = np.repeat(np.arange(pieces), points + 1)

    def use_at(which: np.ndarray, local: FloatArray) -> FloatArray:
        use = family.use(samples_of(orders, which, local), wanted)
        return np.hstack([use[key] for key in wanted])

    local = (lengths[:, None] * fraction).ravel()
    use = use_at(piece, local).reshape(pieces, points + 1, -1)
    k, i, channel = _candidates(use)
    center, best = lengths[k] * fraction[i], use[k, i, channel]
    reach = lengths[k] / points
    # Nine points across a bracket have a spacing of a quarter of its half-width.
    offsets = np.linspace(-1.0, 1.0, 9)
    for _ in range(REFINEMENTS):
        around = np.clip(center[:, None] + reach[:, None] * offsets, 0.0, lengths[k][:, None])
        uses = use_at(np.repeat(k, offsets.size), around.ravel())
        uses = uses.reshape(k.size, offsets.size, -1)
        component = np.take_along_axis(uses, channel[:, None, None], axis=2)[:, :, 0]
        row, pick = np.arange(k.size), component.argmax(axis=1)
        center, best = around[row, pick], np.maximum(best, component[row, pick])
        reach = reach / 4.0
        # Only maxima that may still become the largest are refined further.
        inner = np.clip(pick, 1, offsets.size - 2)
        bend = component[row, inner - 1] - 2 * component[row, inner] + component[row, inner + 1]
        hope = best + np.abs(bend)
        kept = hope >= best.max()
        k, channel = k[kept], channel[kept]
        center, best, reach = center[kept], best[kept], reach[kept]
        if hope.max() - best.max() <= ROUNDING:
            break
    top = int(best.argmax())
    channels = [(key, joint) for key in wanted for joint in range(len(family[key].labels))]
    quantity, joint = channels[int(channel[top])]
    values = family.values(samples_of(orders, k[[top]], center[[top]]), [quantity])[quantity]
    return Peak(
        use=float(best[top]),
        quantity=quantity,
        joint=joint,
        time=float(polynomial.breaks[k[top]] + center[top]),
        value=float(values.value[0, joint]),
        limit=float(family[quantity].nearest_bound(values)[0, joint]),
    )


def jumps_of(polynomial: Polynomial) -> MotionSamples:
    """Return jumps of the acceleration [K+1] at the breaks of a motion, both ends included."""
    orders, lengths = orders_of(polynomial), np.diff(polynomial.breaks)
    pieces = np.arange(lengths.size)
    starts, ends = (samples_of(orders, pieces, local) for local in (0.0 * lengths, lengths))
    return jumps_between(starts, ends)


def largest_jump(family: LimitFamily, polynomial: Polynomial, keys: Iterable[str]) -> Peak | None:
    """Return the worst jump of the acceleration that a limit of its rate excludes, or None.

    The use of such a jump is infinite, as the rate is.
    """
    rated = [key for key in keys if key in family and family[key].order == 3]
    if not rated:
        return None
    values = family.values(jumps_of(polynomial), rated)
    uses = {key: family[key].use(values[key]) for key in rated}
    worst = max(rated, key=lambda key: uses[key].max())
    k, joint = np.unravel_index(int(uses[worst].argmax()), uses[worst].shape)
    if not uses[worst][k, joint] > 1.0:
        return None
    return Peak(
        use=np.inf,
        quantity=worst,
        joint=int(joint),
        time=float(polynomial.breaks[k]),
        value=float(np.copysign(np.inf, values[worst].value[k, joint])),
        limit=float(family[worst].nearest_bound(values[worst])[k, joint]),
    )


def samples_of(orders: Sequence[FloatArray], piece: np.ndarray, local: FloatArray) -> MotionSamples:
    """Return the state at ``local`` seconds [S] after the start of the pieces [S]."""
    return MotionSamples(*(_horner(coefficients[piece], local) for coefficients in orders))


def orders_of(polynomial: Polynomial) -> list[FloatArray]:
    """Return coefficients of position, velocity, acceleration and jerk."""
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
    """Return local maxima of ``use`` [pieces, points, channels] that may hold the overall one."""
    finite = np.where(np.isfinite(use), use, -1.0)  # below any use of a limit
    left = np.full_like(finite, -np.inf)
    right = np.full_like(finite, -np.inf)
    left[:, 1:], right[:, :-1] = finite[:, :-1], finite[:, 1:]
    curvature = np.zeros_like(finite)
    curvature[:, 1:-1] = np.abs(finite[:, :-2] - 2 * finite[:, 1:-1] + finite[:, 2:])
    curvature[:, 0], curvature[:, -1] = curvature[:, 1], curvature[:, -2]
    # A smooth maximum between grid points lies an eighth of the second difference above them.
    hope = finite + curvature
    peaks = (finite >= left) & (finite > right) & (hope >= finite.max())
    places = np.argwhere(peaks)
    order = np.argsort(-hope[tuple(places.T)], kind="stable")[:MOST_CANDIDATES]
    k, i, channel = places[order].T
    return k, i, channel
