"""Pairs of bodies that may touch, and the distances of many pairs with their derivatives.

The distance of two cores depends on the ends of one moving axis, or of two, and on constants of the
obstacle. Its derivatives by the ends depend on the kind of pair only: compiled once, they serve
every robot in every scene. The derivatives of the ends by the joints are compiled once per robot.
Matrix products combine both, so a new scene needs no compilation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.codegen import compile_recipe
from microbot_ocp._base.fast_calls import RowsInPlace, rows_in_place
from microbot_ocp.robot import Capsule, Robot, link_poses
from microbot_ocp.scene._obstacles import Obstacle, core_distance, core_parameters, core_radius

ACCURACY = 1e-6  # accuracy of coal's iterative distances (its tolerance is 1e-6), m
ROUNDING = 0.02  # parabola that makes the nearest place unique, relative to the capsule's radius


@dataclass(frozen=True)
class Pair:
    """Pair of bodies that may touch.

    Attributes
    ----------
    frame, capsule
        Link frame, 1 to n, and the capsule fixed to it.
    other : obstacle or Capsule
        Other body, fixed to ``other_frame``.
    other_frame : int
        Link frame of the other body; 0 is the base.
    accuracy : float
        Largest amount by which the solver's distance is below the true distance, m.
    facing : tuple
        Directions from the other body in which a mesh of many faces is exact.
    thicker : float
        Amount that a limit adds to the distance, m, as if the capsule were thicker by it.
    """

    frame: int
    capsule: Capsule
    other: Obstacle
    other_frame: int = 0
    accuracy: float = np.inf
    facing: tuple[tuple[float, ...], ...] = ()
    thicker: float = 0.0

    @property
    def label(self) -> str:
        """Label such as "forearm to post"."""
        return f"{self.capsule.name} to {self.other.name}"

    @property
    def radii(self) -> float:
        """Distance of the two cores at contact, m."""
        return self.capsule.radius + core_radius(self.other)


@dataclass(frozen=True, eq=False)
class Distances:
    """Distances of an arm's capsule axes from other bodies, as an expression of the state."""

    pairs: tuple[Pair, ...]

    def __call__(self, state: Any) -> Any:
        axes = dict.fromkeys(axis for pair in self.pairs for axis in _axes(pair))
        ends = {axis: _ends(state.link_poses, *axis) for axis in axes}
        values = []
        for pair in self.pairs:
            given = ca.vertcat(*(ends[axis] for axis in _axes(pair)))
            values.append(_distance(*_kind(pair))(given, _numbers(pair)))
        return ca.vertcat(*values) + _thicker(self.pairs)

    def derivatives(self, robot: Robot, compiled: bool) -> tuple[ca.Function, ...]:
        """Return functions of the distances with their derivatives.

        They are ``(q) -> values, Jacobian``; and ``(q, weights) -> gradient, Hessian`` of the
        weighted sum.
        """
        return _derivatives(robot, self.pairs, compiled)

    def in_poses(self, robot: Robot, count: int) -> DistancesInPoses:
        """Return the distances and their derivatives in a number of poses at once."""
        return DistancesInPoses(robot, self.pairs, count)


def _thicker(pairs: Sequence[Pair]) -> ca.DM:
    """Return the constants that a limit adds to the distances, m."""
    return ca.DM([pair.thicker for pair in pairs])


def _axes(pair: Pair) -> list[tuple[int, Capsule]]:
    """Return the moving axes of a pair, with their frames."""
    axes = [(pair.frame, pair.capsule)]
    if pair.other_frame and isinstance(pair.other, Capsule):
        axes.append((pair.other_frame, pair.other))
    return axes


def _axes_of(robot: Robot, pairs: Sequence[Pair]) -> list[tuple[int, Capsule]]:
    """Return the moving axes of pairs; those of the whole arm, if they suffice.

    The whole arm gives the same functions to every scene.
    """
    axes = dict.fromkeys(axis for pair in pairs for axis in _axes(pair))
    whole = dict.fromkeys((frame, capsule) for frame, capsule in robot.capsules if frame)
    return list(whole if axes.keys() <= whole.keys() else axes)


def _ends(poses: Sequence[Any], frame: int, capsule: Capsule) -> Any:
    """Return the ends [6] of a capsule's axis in the base frame."""
    turn, origin = poses[frame][:3, :3], poses[frame][:3, 3]
    return ca.vertcat(origin + turn @ capsule.start, origin + turn @ capsule.end)


def _kind(pair: Pair) -> tuple[type[Obstacle], int]:
    """Return the key of a pair's distance function: class and number of constants of the obstacle.

    The number is zero if the other body moves.
    """
    return type(pair.other), len(_numbers(pair)) - 3


@lru_cache(maxsize=1024)
def _numbers(pair: Pair) -> FloatArray:
    core = (
        np.zeros(0) if pair.other_frame else core_parameters(pair.other, pair.accuracy, pair.facing)
    )
    # A capsule of radius zero needs a parabola, too, so the contact distance sets a lower bound.
    rounding = ROUNDING * max(pair.capsule.radius, 0.1 * pair.radii)
    rounding = min(rounding, 4.0 * pair.accuracy)  # a quarter of the rounding is lost at contact
    return np.append(core, [rounding, pair.radii, core_radius(pair.other)])


@lru_cache(maxsize=64)
def _distance(kind: type[Obstacle], count: int) -> ca.Function:
    """Return ``(ends[6], numbers) -> distance``; ``ends[12]`` if both bodies move."""
    ends = ca.SX.sym("ends", 6 if count else 12)
    numbers = ca.SX.sym("numbers", count + 3)
    body, (rounding, contact, radius) = numbers[:-3], ca.vertsplit(numbers[-3:])
    body = body if count else ends[6:]
    value = core_distance(kind, body, ends[:3], ends[3:6], rounding, contact) - radius
    return ca.Function("distance", [ends, numbers], [value])


@lru_cache(maxsize=64)
def _of_pair(kind: type[Obstacle], count: int) -> tuple[ca.Function, ca.Function]:
    """Return ``(ends[e], numbers) -> distance, slope[e]`` and ``Hessian[e e]``."""
    distance = _distance(kind, count)
    ends, numbers = (ca.SX.sym("x", distance.size1_in(k)) for k in range(2))
    value = distance(ends, numbers)
    hessian, slope = ca.hessian(value, ends)
    slope, hessian = ca.densify(slope), ca.densify(ca.vec(ca.densify(hessian)))
    return (
        ca.Function("pair_slope", [ends, numbers], ca.cse([value, slope])),
        ca.Function("pair_curve", [ends, numbers], ca.cse([hessian])),
    )


@lru_cache(maxsize=64)
def _moving_axes(
    poses: ca.Function, axes: tuple[tuple[int, Capsule], ...]
) -> tuple[ca.Function, ca.Function]:
    """Return ``(q) -> ends [A 6], slopes [A 6 n]`` and ``(q, weights [A 6]) -> Hessian [n n]`` of
    the weighted sum.
    """
    q = ca.SX.sym("q", poses.size1_in(0))
    placed = ca.horzsplit(poses(q), 4)
    ends = ca.vertcat(*(_ends(placed, *axis) for axis in axes))
    weights = ca.SX.sym("weights", 6 * len(axes))
    slopes = ca.densify(ca.vec(ca.densify(ca.jacobian(ends, q)).T))
    curve = ca.densify(ca.vec(ca.densify(ca.hessian(ca.dot(weights, ends), q)[0])))
    both = ca.cse([ca.densify(ends), slopes])
    return (
        ca.Function("axes", [q], both),
        ca.Function("axes_curve", [q, weights], ca.cse([curve])),
    )


# derivatives --------------------------------------------------------------------------------------


@lru_cache(maxsize=64)
def _derivatives(robot: Robot, pairs: tuple[Pair, ...], compiled: bool) -> tuple[ca.Function, ...]:
    n = robot.joint_count
    axes = _axes_of(robot, pairs)
    column = {axis: number for number, axis in enumerate(axes)}
    place, bend = _of_axes(robot, tuple(axes), compiled)
    q, weights = ca.MX.sym("q", n), ca.MX.sym("weights", len(pairs))
    ends, slopes = place(q)  # [6,A], [6,A n]
    order: list[int] = []
    first = []
    # Chain rule over the kinds of pairs: J = d'(e) e'(q), H = e'^T d'' e' + sum_e d'(e) e''(q).
    # The last sum is linear in d'(e), so the pulls are summed over all pairs before one ``bend``.
    pulls, total, gradient = ca.MX(6, len(axes)), ca.MX(n * n, 1), ca.MX(n, 1)
    for key in dict.fromkeys(map(_kind, pairs)):
        chosen = [k for k, pair in enumerate(pairs) if _kind(pair) == key]
        order += chosen
        which = [[column[axis] for axis in _axes(pairs[k])] for k in chosen]
        parts = [(ends[:, list(side)], slopes[:, [a * n + j for a in side for j in range(n)]])
                 for side in zip(*which, strict=True)]  # fmt: skip
        given = [ca.vertcat(*side) for side in zip(*parts, strict=True)]
        numbers = ca.DM(np.array([_numbers(pairs[k]) for k in chosen]).T)
        slope, curve = (f.map(len(chosen)) for f in _kernels(*key, n, compiled))
        first.append(slope(*given, numbers))
        pull, down, hessian = curve(*given, numbers, weights[chosen].T)
        for row, side in enumerate(zip(*which, strict=True)):
            select = ca.DM(len(chosen), len(axes))
            for number, axis in enumerate(side):
                select[number, axis] = 1.0
            pulls = pulls + pull[6 * row : 6 * row + 6, :] @ ca.sparsify(select)
        total, gradient = total + ca.sum2(hessian), gradient + ca.sum2(down)
    back = np.argsort(order).tolist()
    values = ca.horzcat(*(value for value, _ in first)).T[back] + _thicker(pairs)
    jacobian = ca.horzcat(*(row for _, row in first)).T[back, :]
    total = ca.reshape(total, n, n) + bend(q, ca.vec(pulls))
    return (
        ca.Function("first_derivatives", [q], [values, jacobian]),
        ca.Function("second_derivatives", [q, weights], [gradient, total]),
    )


@lru_cache(maxsize=64)
def _kernels(
    kind: type[Obstacle], count: int, joints: int, compiled: bool
) -> Sequence[ca.Function]:
    """Return derivatives of one distance by the joints, from the derivatives of the axis ends.

    ``(ends, slopes[e,n], numbers) -> distance, slope[n]``; with a further ``weight`` ->
    weight times the slope by the ends [e], by the joints [n], and times the curvature by the joints
    [n n].
    """

    def make() -> Sequence[ca.Function]:
        slope_of, curve_of = _of_pair(kind, count)
        ends, numbers = (ca.SX.sym("x", slope_of.size1_in(k)) for k in range(2))
        slopes, weight = ca.SX.sym("slopes", ends.shape[0], joints), ca.SX.sym("weight")
        value, slope = slope_of(ends, numbers)
        hessian = ca.reshape(curve_of(ends, numbers), ends.shape[0], ends.shape[0])
        first = ca.cse([value, slopes.T @ slope])
        turned = weight * (slopes.T @ (hessian @ slopes))
        second = ca.cse([weight * slope, weight * (slopes.T @ slope), ca.vec(turned)])
        inputs = [ends, slopes, numbers]
        return (
            ca.Function("pair_slope", inputs, first),
            ca.Function("pair_curve", [*inputs, weight], second),
        )

    recipe = f"{kind.__name__}, {count} numbers, {joints} joints"
    return compile_recipe(recipe, make) if compiled else make()


@lru_cache(maxsize=64)
def _of_axes(
    robot: Robot, axes: tuple[tuple[int, Capsule], ...], compiled: bool
) -> Sequence[ca.Function]:
    """Return functions of the axis ends: ``(q) -> ends [6,A], slopes [6,A n]``,
    and ``(q, weights [6 A]) -> Hessian`` of the weighted sum.
    """
    poses, count = link_poses(robot), robot.joint_count

    def make() -> Sequence[ca.Function]:
        place, bend = _moving_axes(poses, axes)
        q, weights = ca.SX.sym("q", count), ca.SX.sym("weights", 6 * len(axes))
        ends, slopes = place(q)
        slopes = ca.horzcat(*ca.vertsplit(ca.reshape(slopes, count, 6 * len(axes)).T, 6))
        both, curve = [ca.reshape(ends, 6, len(axes)), slopes], bend(q, weights)
        return (
            ca.Function("axes", [q], both),
            ca.Function("axes_curve", [q, weights], [ca.reshape(curve, count, count)]),
        )

    places = [(frame, c.start.tolist(), c.end.tolist()) for frame, c in axes]
    return compile_recipe(f"{poses.serialize()} {places}", make) if compiled else make()


# many poses ---------------------------------------------------------------------------------------

_in_rows = lru_cache(maxsize=128)(rows_in_place)  # one table of a function serves every scene


@dataclass(frozen=True, eq=False)
class _Group:
    """Pairs of one kind, in N poses.

    Attributes
    ----------
    chosen : list of int [K]
        Indices of the pairs.
    axes : list of list of int [K]
        Indices of the moving axes, one list for each side of the pairs.
    sums : list of array [A,K]
        Matrices that sum rows of pairs by their axes, one for each side.
    slopes, curves : RowsInPlace
        Functions of the pairs, for N K rows.
    """

    chosen: list[int]
    axes: list[list[int]]
    sums: list[FloatArray]
    slopes: RowsInPlace
    curves: RowsInPlace

    @cached_property
    def values(self) -> FloatArray:
        """Distances [N,K], m, in the memory of the functions."""
        return self.slopes.outputs[0].reshape(-1, len(self.chosen))

    @cached_property
    def parts(self) -> list[FloatArray]:
        """Slopes [N,K,6] by the ends of the axes of each side, in the memory of the functions."""
        slopes = self.slopes.outputs[1].reshape(len(self.values), len(self.chosen), -1)
        return np.split(slopes, len(self.axes), axis=2)


class DistancesInPoses:
    """Distances of k pairs in N poses with derivatives by the joints, for repeated evaluation.

    The functions of a pair depend on its kind, those of the axes on the arm: both are built once,
    and arrays over all pairs and poses join them by the chain rule.
    """

    def __init__(self, robot: Robot, pairs: Sequence[Pair], count: int) -> None:
        axes = _axes_of(robot, pairs)
        column = {axis: number for number, axis in enumerate(axes)}
        # Further limits would change the key of these functions with every scene.
        of_axes = _moving_axes(link_poses(robot.with_limits(also=())), tuple(axes))
        self._place, self._bend = (_in_rows(f)(count) for f in of_axes)
        ends, moved = self._place.outputs
        self._ends = ends.reshape(count, len(axes), 6)
        self._moved = moved.reshape(count, len(axes), 6, -1)
        self._thicker = np.array([pair.thicker for pair in pairs])
        self._groups = list[_Group]()
        for key in dict.fromkeys(map(_kind, pairs)):
            chosen = [k for k, pair in enumerate(pairs) if _kind(pair) == key]
            rows = ([column[axis] for axis in _axes(pairs[k])] for k in chosen)
            sides = [list(side) for side in zip(*rows, strict=True)]
            sums = [(np.arange(len(axes))[:, None] == side).astype(float) for side in sides]
            functions = [_in_rows(f)(count * len(chosen)) for f in _of_pair(*key)]
            for memory in functions:
                shape = (count, len(chosen), -1)
                memory.inputs[1].reshape(shape)[...] = [_numbers(pairs[k]) for k in chosen]
            self._groups.append(_Group(chosen, sides, sums, *functions))
        self._place.inputs[0][...] = np.nan  # no poses yet

    def _move(self, q: FloatArray) -> None:
        """Place the axes in poses [N,n], unless they are there."""
        if np.array_equal(q, self._place.inputs[0]):
            return
        self._place.inputs[0][...] = q
        self._place.run()
        for group in self._groups:
            rows = group.slopes.inputs[0].reshape(len(q), len(group.chosen), -1)
            for k, side in enumerate(group.axes):
                rows[..., 6 * k : 6 * k + 6] = self._ends[:, side]
            group.slopes.run()

    def values(self, q: FloatArray) -> FloatArray:
        """Return the distances [N,k], m, in poses [N,n]."""
        self._move(q)
        values = np.empty((len(q), self._thicker.size))
        for group in self._groups:
            values[:, group.chosen] = group.values
        return values + self._thicker

    def slopes(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distances [N,k], m, in poses [N,n], and their slopes [N,k,n]."""
        values = self.values(q)
        slopes = np.empty((*values.shape, q.shape[1]))
        for group in self._groups:
            slopes[:, group.chosen] = sum(
                (part[:, :, None] @ self._moved[:, side])[:, :, 0]
                for part, side in zip(group.parts, group.axes, strict=True)
            )
        return values, slopes

    def curvature(self, q: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return gradient [N,n] and Hessian [N,n,n] of the sum with weights [N,k].

        H = e'^T d'' e' + sum_e d'(e) e''(q): pairs of one axis are summed before the products.
        """
        self._move(q)
        (count, axes), joints = self._ends.shape[:2], q.shape[1]
        pulls, bows = np.zeros((count, axes, 6)), np.zeros((count, axes, 36))
        hessian = np.zeros((count, joints, joints))
        for group in self._groups:
            group.curves.inputs[0][...] = group.slopes.inputs[0]
            group.curves.run()
            weight = weights[:, group.chosen, None]
            curve = weight * group.curves.outputs[0].reshape(count, len(group.chosen), -1)
            for part, sums in zip(group.parts, group.sums, strict=True):
                pulls += sums @ (weight * part)
            if len(group.axes) == 1:
                bows += group.sums[0] @ curve
                continue
            both = np.concatenate([self._moved[:, side] for side in group.axes], axis=2)
            both = both.reshape(-1, 12, joints)
            bent = both.swapaxes(1, 2) @ (curve.reshape(-1, 12, 12) @ both)
            hessian += bent.reshape(count, -1, joints, joints).sum(axis=1)
        moved = self._moved
        bent = moved.swapaxes(2, 3) @ (bows.reshape(count, axes, 6, 6) @ moved)
        hessian += bent.sum(axis=1)
        self._bend.inputs[0][...], self._bend.inputs[1][...] = q, pulls.reshape(count, -1)
        self._bend.run()
        hessian += self._bend.outputs[0].reshape(hessian.shape)
        gradient = pulls.reshape(count, 1, -1) @ moved.reshape(count, -1, joints)
        return gradient[:, 0], hessian
