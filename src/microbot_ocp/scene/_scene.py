"""What stands around an arm, and which of its capsules may come near to what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.codegen import compiles
from microbot_ocp.limits import ROUNDING, Limit
from microbot_ocp.robot import Capsule, Robot, fit_capsules, link_capsules
from microbot_ocp.scene._obstacles import KINDS, Obstacle
from microbot_ocp.scene._pairs import ACCURACY, Distances, Pair

LIMIT_NAME = "distance"


@dataclass(frozen=True, eq=False)
class Scene:
    """Obstacles around an arm.

    The arm is the capsules of the robot: those of :meth:`~microbot_ocp.Robot.with_capsules`; where
    there are none those that :func:`~microbot_ocp.fit_capsules` finds around its collision
    geometry; of robots without geometry those of :func:`~microbot_ocp.robot.link_capsules`.
    Fitted capsules only guide the optimisation where the robot has the geometry that they are
    around: whether a pose is free, and the proof of clearance, go by convex hulls of that.

    Parameters
    ----------
    obstacles : sequence
        :class:`Sphere`, :class:`Box`, :class:`~microbot_ocp.Capsule`, :class:`Cylinder`,
        :class:`HalfSpace`, :class:`ConvexMesh`, in the base frame. Those without a name are
        numbered.
    clearance : float
        Distance that the arm keeps from everything, m.
    self_collision : bool
        Whether capsules of the arm keep that distance from each other, too: those of links that
        are not neighbours and not of the ``disabled_pairs`` of a robot that was read with an SRDF
        file. Those that touch in the zero pose may do so, and a :class:`Clearance` names them; with
        an SRDF file, which says what may touch, only those without collision geometry.
    ignore : sequence of pairs of names
        Links and obstacles that may touch: ``[("hand", "part")]``.

    Raises
    ------
    InputError
        What is no obstacle, two of one name, a negative clearance, a pair to ignore that is none.

    Examples
    --------
    >>> import microbot_ocp as mo
    >>> scene = mo.Scene([mo.Sphere([1.0, 0.0, 0.5], 0.2, "ball"), mo.Box([1, 1, 0.1])], 0.01)
    >>> scene.names
    ('ball', 'box 2')
    """

    obstacles: tuple[Obstacle, ...] = ()
    clearance: float = 0.0
    self_collision: bool = True
    ignore: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        obstacles = []
        for number, obstacle in enumerate(self.obstacles, start=1):
            kind = next((k for k, v in KINDS.items() if isinstance(obstacle, v)), None)
            if kind is None:
                raise InputError(
                    f"obstacles must be of {', '.join(v.__name__ for v in KINDS.values())}, not "
                    f"{obstacle!r}"
                )
            if not isinstance(obstacle.name, str):
                raise InputError(f"name of obstacle {number} must be text, not {obstacle.name!r}")
            usual = f"{kind.replace('_', ' ')} {number}"
            obstacles.append(obstacle if obstacle.name else replace(obstacle, name=usual))
        names = [obstacle.name for obstacle in obstacles]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"names of obstacles must differ: there are several {twice[0]!r}")
        put(self, "obstacles", tuple(obstacles))
        put(self, "clearance", checks.number("clearance", self.clearance, "m", at_least=0.0))
        for pair in self.ignore:
            if isinstance(pair, str) or len(pair) != 2:
                raise InputError(f"ignore must hold pairs of names, not {pair!r}")
        put(self, "ignore", tuple((str(one), str(other)) for one, other in self.ignore))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the obstacles."""
        return tuple(obstacle.name for obstacle in self.obstacles)

    def without_parts_of(self, robot: Robot) -> Scene:
        """Return the scene for a robot that may carry less than ``ignore`` speaks of."""
        names = {*self.names, *(capsule.name for _, capsule in with_arm_capsules(robot).capsules)}
        ignored = tuple(pair for pair in self.ignore if names.issuperset(pair))
        return self if ignored == self.ignore else _ignoring(self, ignored)

    def pairs(self, robot: Robot) -> tuple[Pair, ...]:
        """Return what may touch: capsules of the arm and obstacles, and capsules of each other.

        Those of each other that overlap in the zero pose are left out.

        Raises
        ------
        InputError
            A name in ``ignore`` that neither the scene nor the robot has.
        """
        return told_apart(self, with_arm_capsules(robot))[0]

    def limit(
        self,
        robot: Robot,
        pairs: Sequence[Pair] | None = None,
        *,
        tolerance: float = 0.0,
        room: Sequence[float] | None = None,
    ) -> Limit:
        """Return the distances as a limit of the robot: one value a pair, in m.

        A value is the distance of the axis of the arm's capsule from the other thing, as if it were
        as thick as the thickest one, as far as ``room`` lets it. Its lower bound is that radius and
        the clearance, and what a solver may leave open, so that that does not decide whether a
        certificate passes.

        Parameters
        ----------
        robot : Robot
        pairs : sequence of Pair, optional
            Only these; default all.
        tolerance : float
            Share of the bound that a solver may leave open between its mesh points.
        room : array_like, optional
            What a known way has beyond the clearance at each pair, m. What a solver may leave open
            and the rounding of the distance that it sees take at most half of that each. Negative
            where capsules overlap though their links are apart: by how much they may.
        """
        chosen = self.pairs(robot) if pairs is None else tuple(pairs)
        rooms = [np.inf] * len(chosen) if room is None else [float(value) for value in room]
        radii = [capsule.radius for _, capsule in robot.capsules]
        return _limit(self, chosen, max(radii, default=0.0), float(tolerance), tuple(rooms))


@lru_cache(maxsize=64)
def _ignoring(scene: Scene, pairs: tuple[tuple[str, str], ...]) -> Scene:
    return replace(scene, ignore=pairs)


@lru_cache(maxsize=256)
def _limit(
    scene: Scene,
    pairs: tuple[Pair, ...],
    thickest: float,
    tolerance: float,
    rooms: tuple[float, ...],
) -> Limit:
    overlap = np.minimum(rooms, 0.0)
    contact = overlap + [pair.capsule.radius + scene.clearance for pair in pairs]
    most = 0.5 * np.maximum(rooms, 0.0)  # each of the margin, and of the rounding
    # what may be left open is a share of the thickest capsule, of a thin finger as of an upper
    # arm: of micrometres where a finger swings past an edge meshes do not come to an end
    share = np.where(overlap < 0.0, np.inf, most / max(2.0 * tolerance, ROUNDING))
    thicker = np.maximum(np.minimum(thickest + scene.clearance, share) - contact, 0.0)
    contact = contact + thicker
    margin = np.maximum(np.minimum(2.0 * tolerance * contact, most), 2.0 * ACCURACY)
    rows = zip(pairs, np.maximum(most, ACCURACY).tolist(), thicker.tolist(), strict=True)
    return Limit(
        LIMIT_NAME,
        Distances(tuple(replace(pair, accuracy=m, thicker=more) for pair, m, more in rows)),
        # half is what may be left open, half what a proof has to go by
        lower=contact + np.where(overlap < 0.0, 0.0, margin),
        unit="m",
        labels=tuple(pair.label for pair in pairs),
    )


def with_arm_capsules(robot: Robot) -> Robot:
    """Return the robot with capsules: its own, fitted ones, or those along its links."""
    if robot.capsules:
        return robot
    return _with_default_capsules(robot, robot.shapes)


@lru_cache(maxsize=32)
def _with_default_capsules(robot: Robot, shapes: tuple[Any, ...]) -> Robot:
    has_geometry = any(shape.role == "collision" for shape in shapes)
    return robot.with_capsules(fit_capsules(robot) if has_geometry else link_capsules(robot))


@lru_cache(maxsize=64)
def told_apart(scene: Scene, robot: Robot) -> tuple[tuple[Pair, ...], tuple[Pair, ...]]:
    """Return what may not touch: pairs that capsules tell apart, and those that overlap at zero."""
    links = {capsule.name for _, capsule in robot.capsules}
    names = links | set(scene.names)
    for name in sum(scene.ignore, ()):
        checks.one_of("name in ignore", name, sorted(names))
    ignored = {frozenset(pair) for pair in scene.ignore}
    moving = [(frame, capsule) for frame, capsule in robot.capsules if frame > 0]
    pairs = [
        Pair(frame, capsule, obstacle) for frame, capsule in moving for obstacle in scene.obstacles
    ]
    apart, overlapping = _own_pairs(robot) if scene.self_collision else ((), ())
    separate, overlap = (
        tuple(p for p in some if frozenset((p.capsule.name, p.other.name)) not in ignored)
        for some in ((*pairs, *apart), overlapping)
    )
    return separate, overlap


def _own_pairs(robot: Robot) -> tuple[list[Pair], list[Pair]]:
    """Return pairs of capsules of links that are not neighbours and not disabled.

    First those of links that are apart in the zero pose, then those that overlap there.
    """
    disabled = {frozenset(pair) for pair in robot.disabled_pairs or ()}
    pairs = [
        Pair(frame, capsule, other, other_frame)
        for frame, capsule in robot.capsules
        for other_frame, other in robot.capsules
        if frame - other_frame >= 2 and frozenset((capsule.name, other.name)) not in disabled
    ]
    if not pairs:
        return [], []
    zero = clearances(robot, pairs, np.zeros((1, robot.joint_count)))[0]
    touching = {_fitted(pair) for pair, apart in zip(pairs, zero, strict=True) if apart <= 0.0}
    return (
        [pair for pair in pairs if _fitted(pair) not in touching],
        [pair for pair in pairs if _fitted(pair) in touching],
    )


def _fitted(pair: Pair) -> Any:
    """Return what of a pair touches or not: links, where capsules are pieces of a fit, else
    itself.
    """
    other = pair.other
    fits = pair.capsule.excess > 0.0 and isinstance(other, Capsule) and other.excess > 0.0
    return frozenset((pair.capsule.name, other.name)) if fits else pair


def clearances(robot: Robot, pairs: Sequence[Pair], q: FloatArray) -> FloatArray:
    """Return distances [N,k] of pairs in poses q [N,n], m, by the functions that solvers see."""
    chosen = tuple(pairs)
    poses = checks.array("q", q, (None, robot.joint_count), "rad")
    values = Distances(chosen).derivatives(robot, compiles())[-1](np.ascontiguousarray(poses.T))
    return np.array(values).T - np.array([pair.capsule.radius for pair in chosen])
