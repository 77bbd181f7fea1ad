"""The largest use that a piecewise polynomial motion makes of its limits, refined off the grid."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits._family import LimitFamily, MotionSamples
from microbot_ocp.limits._history import jumps_between

POINTS_PER_PIECE = 200  # of the first grid for the maxima, before they are refined
ROUNDS = 8  # each divides the grid step around a maximum by four
CANDIDATES = 60  # most maxima that are refined at a time


class Polynomial(Protocol):
    """What is asked of a piecewise polynomial."""

    @property
    def breaks(self) -> FloatArray: ...
    @property
    def coefficients(self) -> FloatArray: ...
    def derivative(self) -> Polynomial: ...


@dataclass(frozen=True)
class Peak:
    """Where a motion uses most of its limits.

    Attributes
    ----------
    use : float
        1 at the limit; infinite where the acceleration jumps though its rate is limited.
    quantity : str
        Key of the limit; "shape" where no limit was looked at.
    joint : int
        Index of the component, from 0.
    time : float
        s.
    value, limit : float
        Value there, and the bound that it is nearer to or beyond.
    """

    use: float
    quantity: str = "shape"
    joint: int = 0
    time: float = 0.0
    value: float = np.nan
    limit: float = np.nan


def largest_use(
    family: LimitFamily, polynomial: Polynomial, keys: Iterable[str], *, at_rest: bool = False
) -> Peak:
    """Return the largest use of the limits of these keys along a motion.

    Every piece is evaluated with both its ends, so both one-sided values at a break count. The
    grid's largest local maxima are then refined by sampling ever closer around them. ``at_rest``
    takes the poses of the motion with all derivatives zero.
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
    offsets = np.linspace(-1.0, 1.0, 9)
    for _ in range(ROUNDS):
        around = np.clip(center[:, None] + reach[:, None] * offsets, 0.0, lengths[k][:, None])
        uses = use_at(np.repeat(k, offsets.size), around.ravel())
        uses = uses.reshape(k.size, offsets.size, -1)
        component = np.take_along_axis(uses, channel[:, None, None], axis=2)[:, :, 0]
        pick = component.argmax(axis=1)
        row = np.arange(k.size)
        center, best = around[row, pick], np.maximum(best, component[row, pick])
        reach = reach / 4.0
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
    """Return a jump of the acceleration that no limit of its rate allows, as an infinite use,
    or None.
    """
    rated = [key for key in keys if key in family and family[key].order == 3]
    if not rated:
        return None
    values = family.values(jumps_of(polynomial), rated)
    worst: Peak | None = None
    largest = 1.0
    for key in rated:
        use = family[key].use(values[key])
        k, joint = np.unravel_index(int(use.argmax()), use.shape)
        if use[k, joint] > largest:
            largest = float(use[k, joint])
            bound = family[key].nearest_bound(values[key])[k, joint]
            worst = Peak(
                use=np.inf,
                quantity=key,
                joint=int(joint),
                time=float(polynomial.breaks[k]),
                value=float(np.copysign(np.inf, values[key].value[k, joint])),
                limit=float(bound),
            )
    return worst


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
    places = np.argwhere(peaks)
    order = np.argsort(-hope[tuple(places.T)], kind="stable")[:CANDIDATES]
    k, i, channel = places[order].T
    return k, i, channel
