"""All limits of a robot as one family, and the engine that evaluates them.

Planners, certificates, figures, recordings and tables ask a :class:`LimitFamily` for the robot's
limits, their values along samples, the used share, the excess, and the expressions for an
optimal-control problem.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from microbot_ocp._base.calls import from_origins, refuse_without_derivatives
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.fast_calls import deferred_call
from microbot_ocp._base.interpolants import Read, reads
from microbot_ocp._base.relations import is_relation, reason_of
from microbot_ocp._base.threads import expanded
from microbot_ocp.limits._finite_slopes import with_finite_slopes
from microbot_ocp.limits._joint_limits import JOINT_QUANTITIES, JointLimits, Limits
from microbot_ocp.limits._limit import Limit
from microbot_ocp.limits._use import LIMIT_TOLERANCE, nearest_bound, use_of

STATE = ("q", "qd", "qdd", "qddd")
OF_TORQUES = ("tau", "taud")


class MotionSamples(NamedTuple):
    """Joint positions and their first three derivatives at some times, each [N,n]."""

    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    qddd: FloatArray

    @classmethod
    def at_rest(cls, q: FloatArray) -> MotionSamples:
        """Return poses [N,n] or [n] with all derivatives zero."""
        poses = np.atleast_2d(q)
        return cls(poses, *3 * [np.zeros_like(poses)])


class LimitValues(NamedTuple):
    """Values [N,k] of a limited quantity, with its bounds [k] or [N,k]."""

    value: FloatArray
    lower: FloatArray
    upper: FloatArray

    def row(self, i: int) -> LimitValues:
        """Return values and bounds at one time, each [1,k]."""
        return LimitValues(*(np.broadcast_to(each, self.value.shape)[[i]] for each in self))

    def entry(self, i: int, j: int) -> tuple[float, ...]:
        """Return value, lower and upper bound of one component at one time."""
        return tuple(float(np.broadcast_to(each, self.value.shape)[i, j]) for each in self)


@dataclass(frozen=True, eq=False)
class Member:
    """One limit of one robot.

    Attributes
    ----------
    key : str
        Key "q", "qd", "qdd", "qddd", "tau", "taud", or that of a further limit ("tool_speed").
    name : str
        Name such as "torque" or "tool speed".
    labels : tuple of str [k]
        Names of the components: the joints, or "" for a scalar.
    units : tuple of str [k]
    lower, upper : array [k]
        Bounds; infinite if missing, NaN if an expression of the state.
    order : int
        Highest derivative of the position in the limit: 0 to 3.
    limit : Limit or None
        Further limit, None for a limit of the joints.
    """

    key: str
    name: str
    labels: tuple[str, ...]
    units: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    order: int
    limit: Limit | None = None

    @property
    def limited(self) -> np.ndarray:
        """Mask [k] of the components with a bound on either side."""
        return ~(np.isneginf(self.lower) & np.isposinf(self.upper))

    @property
    def is_mean(self) -> bool:
        """True if the bounds are of a root mean square over the whole motion."""
        return self.limit is not None and self.limit.rms

    @property
    def varies(self) -> bool:
        """True if a bound is an expression of the state."""
        return bool(np.isnan(self.lower).any() or np.isnan(self.upper).any())

    @property
    def from_middle(self) -> bool:
        """True if the use is measured from the middle of the range."""
        if self.limit is None:
            return self.key == "q"
        with np.errstate(invalid="ignore"):
            return bool(np.any((self.lower > 0) | (self.upper < 0)))

    def title(self, component: int) -> str:
        """Return a title such as "torque of elbow" or "tool speed"."""
        label = self.labels[component]
        return f"{self.name} of {label}" if label else self.name

    def use(self, values: LimitValues) -> FloatArray:
        """Return the used share [N,k]; minus infinity without a limit."""
        return use_of(*values, from_middle=self.from_middle)

    def nearest_bound(self, values: LimitValues) -> FloatArray:
        """Return the bound [N,k] that is nearest to or violated by each value."""
        return nearest_bound(*values, from_middle=self.from_middle)


def not_judged(unjudged: Sequence[str]) -> str:
    """Return a note on the limits that cannot be verified without masses; empty if there are none.

    Examples
    --------
    >>> not_judged(["torque"])
    'torque not judged: no masses'
    """
    return f"{' and '.join(unjudged)} not judged: no masses" if len(unjudged) else ""


class LimitFamily:
    """Limits of a robot, those of the joints first.

    :meth:`of` creates a family and caches it.

    Attributes
    ----------
    robot
        Robot with these limits.
    members : tuple of Member
        Limits that hold at every instant.
    means : tuple of Member
        Limits of root mean squares over a whole motion.
    unjudged : tuple of str
        Names of the robot's limits that cannot be verified: those of torques without masses.
    """

    def __init__(self, robot: Any) -> None:
        self.robot = robot
        every = (_joint_member(robot, key) for key in JOINT_QUANTITIES)
        joints = [member for member in every if member.limited.any()]
        # A file may limit torques but have no masses, from which torques follow.
        left = () if robot.has_dynamics else OF_TORQUES
        self.unjudged = tuple(member.name for member in joints if member.key in left)
        further = [_further_member(robot, limit) for limit in robot.limits.also]
        self.members = (
            *(member for member in joints if member.key not in left),
            *(member for member in further if not member.is_mean),
        )
        self.means = tuple(member for member in further if member.is_mean)
        self._by_key = {member.key: member for member in (*self.members, *self.means)}

    @classmethod
    def of(cls, robot: Any, limits: Limits | JointLimits | None = None) -> LimitFamily:
        """Return the family of a robot, under its own or other limits.

        Raises
        ------
        InputError
            The limits add bounds of torques, but the robot has no masses.
        """
        if limits is None or limits is robot.limits:
            return _family(robot)
        limited = robot.with_limits(limits)
        for key in () if robot.has_dynamics else OF_TORQUES:
            bounds = limited.limits.bounds(key)
            if np.isfinite(bounds).any() and not np.array_equal(bounds, robot.limits.bounds(key)):
                raise InputError(
                    f"{key}_max limits the {JOINT_QUANTITIES[key].name}, but robot "
                    f"{robot.name!r} has no masses that torques follow from: give its links "
                    f"masses, or leave out {key}_max"
                )
        return _family(limited)

    def __iter__(self) -> Any:
        return iter(self.members)

    def __getitem__(self, key: str) -> Member:
        return self._by_key[key]

    def __contains__(self, key: object) -> bool:
        return key in self._by_key

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the members."""
        return tuple(member.key for member in self.members)

    def of_order(self, *orders: int) -> tuple[str, ...]:
        """Return keys of the members whose highest derivative of position is one of ``orders``."""
        return tuple(member.key for member in self.members if member.order in orders)

    @property
    def jerk_matters(self) -> bool:
        """True if any limit depends on the jerk: torque rate, jerk, or an expression of them.

        In that case the acceleration cannot jump and is zero wherever the arm rests.
        """
        return any(member.order == 3 for member in self.members)

    def bounds_motion_of(self, joint: int) -> bool:
        """Return True if any limit bounds the speed of a joint."""

        def bounds(member: Member) -> bool:
            if member.limit is None:
                return bool(member.limited[joint])
            function, _, used = _function(self.robot, (member.key,))
            moving = [place for place, k in enumerate(used) if k > 0]
            return any(joint in function.sparsity_jac(place, 0).get_col() for place in moving)

        return any(member.order > 0 and bounds(member) for member in (*self.members, *self.means))

    def refuse_means(self) -> None:
        """Raise InputError for a limit of a mean, which most planners cannot keep."""
        for member in self.means:
            raise InputError(
                f"limits bound the {member.name} over the whole motion, which only time_optimal "
                "through joint poses, without a scene, keeps: leave it out here"
            )

    def values(
        self,
        samples: MotionSamples,
        keys: Iterable[str] | None = None,
        measured: Mapping[str, FloatArray] | None = None,
    ) -> dict[str, LimitValues]:
        """Return values and bounds of the limits, or of some keys, along samples.

        ``measured`` holds known values [N,n] by key, which are not computed: torques of a drive.
        """
        wanted = self.keys if keys is None else tuple(keys)
        given = dict(zip(STATE, samples, strict=True)) | dict(measured or {})
        torques = {"tau", "taud"} & set(wanted) - set(given)
        if torques:
            jerk = samples.qddd if "taud" in torques else None
            given = self.robot.torques_along(*samples[:3], jerk) | given
        entries = {key: [given.get(key), self[key].lower, self[key].upper] for key in wanted}
        for key in wanted:
            limit = self[key].limit
            if key not in given and limit is not None and limit.knows_derivatives:
                at_once = limit.expression.in_poses(self.robot, len(samples.q))
                entries[key][0] = at_once.values(samples.q)
        if computed := tuple(key for key in wanted if entries[key][0] is None):
            function, names, used = _function(self.robot, computed)
            arrays = deferred_call(function)(*(samples[k] for k in used))
            for (key, side), array in zip(names, _as_tuple(arrays), strict=True):
                entries[key][side] = array
        return {key: LimitValues(*entry) for key, entry in entries.items()}

    def use(
        self, samples: MotionSamples, keys: Iterable[str] | None = None
    ) -> dict[str, FloatArray]:
        """Return the used share [N,k] of the limits, or of some keys, along samples."""
        return {key: self[key].use(v) for key, v in self.values(samples, keys).items()}

    def excess(self, samples: MotionSamples) -> FloatArray:
        """Return the largest relative excess [N] over any limit; negative inside of all limits."""
        uses = [use.max(axis=1) - 1.0 for use in self.use(samples).values()]
        return np.max([np.full(len(samples.q), -1.0), *uses], axis=0)

    def outside_of_tables(self, samples: MotionSamples) -> tuple[Read, int] | None:
        """Return the table lookup of a further limit farthest outside of its grid, and its sample.

        None if all lookups are inside of their grids.
        """
        found: list[tuple[float, Read, int]] = []
        for limit in self.robot.limits.also:
            if limit.knows_derivatives:  # it reads no tables
                continue
            function, _, used = _function(self.robot, (limit.key,))
            if function.is_a("MXFunction"):  # functions of scalar operations read no tables
                given = function.mx_in()
                table = np.hstack([samples[k] for k in used]).T
                for each in reads(function.call(given, True, False), given, table):
                    k = int(each.relative.argmax())
                    found.append((float(each.relative[k]), each, k))
        farthest = max(found, key=lambda one: one[0], default=None)
        return None if farthest is None or farthest[0] <= LIMIT_TOLERANCE else farthest[1:]

    def expressions(
        self, keys: Sequence[str], state: Sequence[Any], torques: ca.Function | None = None
    ) -> dict[str, tuple[Any, Any, Any]]:
        """Return the value, lower and upper bound of further limits as expressions.

        Parameters
        ----------
        keys : sequence of str
            Keys of further limits.
        state : sequence of expressions
            Expressions of q, qd, qdd and qddd, each [n].
        torques : casadi.Function, optional
            Function that replaces the robot's own torque and torque rate.

        Returns
        -------
        mapping from a key to (value [k], lower [k], upper [k])
            Expressions; a constant bound is an array.
        """
        if not keys:
            return {}
        function, names, used = _function(self.robot, tuple(keys), *([torques] if torques else []))
        entries = {key: [None, self[key].lower, self[key].upper] for key in keys}
        for (key, side), value in zip(
            names, _as_tuple(function(*(state[k] for k in used))), strict=True
        ):
            entries[key][side] = value
        return {key: (entry[0], entry[1], entry[2]) for key, entry in entries.items()}

    def derivatives(self, function: ca.Function, compiled: bool) -> tuple[ca.Function, ...] | None:
        """Return derivatives of a further limit's function, if it has them, and the function."""
        for limit in self.robot.limits.also:
            if not limit.knows_derivatives:
                continue
            if _function(self.robot, (limit.key,))[0].__hash__() == function.__hash__():
                return *limit.expression.derivatives(self.robot, compiled), function
        return None


@lru_cache(maxsize=64)
def _family(robot: Any) -> LimitFamily:
    return LimitFamily(robot)


def _as_tuple(answer: Any) -> tuple[Any, ...]:
    return answer if isinstance(answer, tuple) else (answer,)


def _joint_member(robot: Any, key: str) -> Member:
    quantity = JOINT_QUANTITIES[key]
    lower, upper = robot.limits.bounds(key)
    return Member(
        key=key,
        name=quantity.name,
        labels=robot.joint_names,
        units=tuple(robot.unit(key, joint) for joint in range(robot.joint_count)),
        lower=lower,
        upper=upper,
        order={"q": 0, "qd": 1, "qdd": 2, "qddd": 3, "tau": 2, "taud": 3}[key],
    )


def _further_member(robot: Any, limit: Limit) -> Member:
    if limit.knows_derivatives:  # a limit of positions; its expression is long
        size, order = len(limit.labels), 0
    else:
        function, _, used = _function(robot, (limit.key,))
        size, order = function.size1_out(0), max(used)
    labels = limit.labels or (robot.joint_names if size == robot.joint_count > 1 else ("",) * size)
    if len(labels) != size:
        raise InputError(
            f"limit {limit.name!r} has {len(labels)} labels, but its expression has {size} entries"
        )
    if size > 1 and not any(labels):
        labels = tuple(str(k + 1) for k in range(size))
    bounds = []
    for side, without in (("lower", -np.inf), ("upper", np.inf)):
        constant = limit.constant(side)
        if constant is None:
            constant = np.array([without if getattr(limit, side) is None else np.nan])
        if constant.size not in (1, size):
            raise InputError(
                f"{side} bound of limit {limit.name!r} must be one number, or {size} as its "
                f"expression has, not {constant.size}"
            )
        bounds.append(np.broadcast_to(constant, (size,)).copy())
    return Member(
        key=limit.key,
        name=limit.name,
        labels=labels,
        units=(limit.unit,) * size,
        lower=bounds[0],
        upper=bounds[1],
        order=order,
        limit=limit,
    )


@lru_cache(maxsize=128)
def _function(
    robot: Any, keys: tuple[str, ...], torques: ca.Function | None = None
) -> tuple[ca.Function, tuple[tuple[str, int], ...], tuple[int, ...]]:
    """Return one function of the state, [n] for each argument, for further limits.

    Returns
    -------
    function, names, used
        Each output has a name (key, side): side 0 is the value, 1 and 2 are lower and upper
        bounds that are expressions. ``used`` has the indices of its arguments in the state.
    """
    further = {limit.key: limit for limit in robot.limits.also}
    reasons: list[str] = []
    for symbol in (ca.SX.sym, ca.MX.sym):  # MX for expressions that call functions
        symbols: list[Any] = [symbol(name, robot.joint_count) for name in STATE]
        if torques is not None:
            extra = [symbol(torques.name_in(k)) for k in range(4, torques.n_in())]
            state = robot.motion_state(*symbols, lambda *given, e=extra: torques(*given, *e))
            symbols = [*symbols, *extra]
        else:
            state = robot.motion_state(*symbols)
        try:
            outputs, names = _outputs(further, keys, state)
            every = ca.vertcat(*outputs)
            used = tuple(k for k, s in enumerate(symbols) if ca.depends_on(every, s)) or (0,)
            function = ca.Function("limits", [symbols[k] for k in used], outputs)
            if symbol is ca.SX.sym and function.find_functions():
                continue
            if not function.is_a("SXFunction"):
                with suppress(RuntimeError):  # tables have no scalar operations
                    scalar = expanded(function)
                    function = function if scalar.find_functions() else scalar
        except Exception as found:  # a user's expression may raise anything
            reasons.append(reason_of(found))
            continue
        if function.is_a("SXFunction"):
            function = with_finite_slopes(function)
        return function, tuple(names), used
    named = ", ".join(repr(further[key].name) for key in keys)
    raise InputError(f"the expression of limit {named} cannot be evaluated: {reasons[0]}")


def _outputs(
    further: Mapping[str, Limit], keys: Sequence[str], state: Any
) -> tuple[list[Any], list[tuple[str, int]]]:
    outputs, names = [], []
    for key in keys:
        limit = further[key]
        value = _column(limit.expression(state))
        if not isinstance(value, ca.DM) and any(map(is_relation, ca.vertsplit(value))):
            raise TypeError("it is a relation, 0 or 1: give its sides by expression and bounds")
        outputs.append(value)
        names.append((key, 0))
        for side, bound in ((1, limit.lower), (2, limit.upper)):
            if callable(bound):
                given = _column(bound(state))
                if given.shape[0] not in (1, value.shape[0]):
                    raise TypeError(
                        f"its bound has {given.shape[0]} entries, its value {value.shape[0]}"
                    )
                outputs.append(given * ca.DM.ones(value.shape[0], 1))
                names.append((key, side))
    return outputs, names


def _column(value: Any) -> Any:
    if isinstance(value, ca.MX):
        value = from_origins(value)
        refuse_without_derivatives("it", value)
    if isinstance(value, int | float | np.ndarray | list | tuple):
        value = ca.DM(np.atleast_1d(np.asarray(value, dtype=float)))
    return ca.densify(ca.vec(value))
