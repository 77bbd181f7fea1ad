"""One limit as data: a name, a unit, an expression of the motion's state, bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError

Expression = Callable[[Any], Any]  # a motion's state -> a CasADi expression or a number
Bound = ArrayLike | Expression | None


def above_zero(name: str, bound: Bound, unit: str) -> Bound:
    """Return an upper bound of what is never negative; InputError for one that allows nothing."""
    if bound is None or callable(bound):
        return bound
    if np.any(checks.numbers(f"upper bound of limit {name!r}", bound) <= 0):
        raise InputError(f"upper bound of limit {name!r} must be above 0 {unit}, not {bound}")
    return bound


@dataclass(frozen=True)
class Limit:
    """A bound on any quantity of a motion, beside the limits of the joints.

    Parameters
    ----------
    name : str
        Such as "tool speed"; figures, tables and messages use it.
    expression : callable
        ``state -> CasADi expression [k]``; ``state`` is a
        :class:`~microbot_ocp.robot.MotionState`.
    lower, upper : float, array_like [k] or callable, optional
        Bounds in ``unit``: numbers, or expressions of the state where the limit varies along the
        motion. Default none on that side.
    unit : str
        SI.
    labels : sequence of str, optional
        Of the components; default the names of the joints where there is one a joint.
    rms : bool
        Whether the upper bound is one of the root mean square over the whole motion, not of every
        instant; of planners only :func:`microbot_ocp.time_optimal` through joint poses keeps it.
    dwell : float
        Rest at the end that such a mean is taken over, too, s.

    Raises
    ------
    InputError
        No name, an expression that cannot be called, no bound at all, NaN, a lower bound above the
        upper one.

    Examples
    --------
    >>> import casadi as ca
    >>> height = Limit("tool height", lambda state: state.tool[2, 3], lower=0.2, unit="m")
    >>> height.key, height.lower, height.upper
    ('tool_height', (0.2,), None)
    """

    name: str
    expression: Expression
    lower: Any = None
    upper: Any = None
    unit: str = ""
    labels: tuple[str, ...] = ()
    rms: bool = False
    dwell: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"name of a limit must be text, not {self.name!r}")
        if not callable(self.expression):
            raise InputError(
                f"expression of limit {self.name!r} must be a function of the motion's state, "
                f"not {type(self.expression).__name__}"
            )
        for side in ("lower", "upper"):
            put(self, side, self._checked(side, getattr(self, side)))
        if self.lower is None and self.upper is None:
            raise InputError(f"limit {self.name!r} must have a lower or an upper bound")
        low, high = self.constant("lower"), self.constant("upper")
        if (
            low is not None
            and high is not None
            and (low.size in (1, high.size) or high.size == 1)
            and np.any(low > high)
        ):
            raise InputError(
                f"lower bound of limit {self.name!r} must be at most its upper bound, not "
                f"{low.tolist()} above {high.tolist()} {self.unit}".rstrip()
            )
        checks.number(f"dwell of limit {self.name!r}", self.dwell, "s", at_least=0.0)
        if self.rms and (low is not None or high is None or not np.all(high > 0.0)):
            raise InputError(
                f"limit {self.name!r} of a root mean square must have an upper bound of numbers "
                "above 0 and no lower one"
            )
        if not isinstance(self.unit, str):
            raise InputError(f"unit of limit {self.name!r} must be text, not {self.unit!r}")
        put(self, "labels", tuple(self.labels))

    def _checked(self, side: str, bound: Any) -> Any:
        if bound is None or callable(bound):
            return bound
        name = f"{side} bound of limit {self.name!r}"
        values = np.atleast_1d(checks.numbers(name, bound))
        values = checks.array(name, values, (None,), self.unit, finite=False)
        return tuple(values.tolist())

    @property
    def key(self) -> str:
        """Its name as one word, as columns and mappings have it."""
        return self.name.strip().replace(" ", "_")

    def constant(self, side: str) -> FloatArray | None:
        """Give the bound [k] or [1] of a side; None where there is none or it is an expression."""
        bound = getattr(self, checks.one_of("side", side, ("lower", "upper")))
        return None if bound is None or callable(bound) else np.array(bound)
