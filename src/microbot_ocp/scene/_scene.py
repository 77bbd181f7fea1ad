"""Obstacles around an arm, the pairs of bodies that may not touch, and the limit of distances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp.limits import ROUNDING, Limit
from microbot_ocp.robot import Capsule, Robot, fit_capsules, link_capsules
from microbot_ocp.scene._obstacles import KINDS, Obstacle
from microbot_ocp.scene._pairs import ACCURACY, Distances, Pair

LIMIT_NAME = "distance"


@dataclass(frozen=True, eq=False)
class Scene:
    """Obstacles around an arm.

    The arm is represented by capsules: those of :meth:`~microbot_ocp.Robot.with_capsules`; without
    them, those that :func:`~microbot_ocp.fit_capsules` fits around its collision geometry; for
    robots without geometry, those of :func:`~microbot_ocp.robot.link_capsules`. Fitted capsules
    only guide the optimisation if the robot has the geometry inside them: whether a pose is free,
    and the proof of clearance, are decided by the convex hulls of that geometry.

    Parameters
    ----------
    obstacles : sequence
        :class:`Sphere`, :class:`Box`, :class:`~microbot_ocp.Capsule`, :class:`Cylinder`,
        :class:`HalfSpace`, :class:`ConvexMesh`, in the base frame. Unnamed obstacles are numbered.
    clearance : float
        Distance that the arm keeps from everything, m.
    self_collision : bool
        True to keep the clearance also between capsules of links that are not neighbours and not
        among the ``disabled_pairs`` of the SRDF file of the robot. Pairs that touch in the zero
        pose may touch, and a :class:`Clearance` names them; if an SRDF file says which links may
        touch, this holds only for links without collision geometry.
    ignore : sequence of pairs of names
        Links and obstacles that may touch: ``[("hand", "part")]``.

    Raises
    ------
    InputError
        An entry is no obstacle, two obstacles have one name, the clearance is negative, or an entry
        of ``ignore`` is no pair.

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
        """Return the scene without ignored pairs that belong to another payload."""
        names = {*self.names, *(capsule.name for _, capsule in with_arm_capsules(robot).capsules)}
        ignored = tuple(pair for pair in self.ignore if names.issuperset(pair))
        return self if ignored == self.ignore else _ignoring(self, ignored)

    def pairs(self, robot: Robot) -> tuple[Pair, ...]:
        """Return the pairs that may not touch: arm and obstacles, and links of the arm.

        Links whose capsules overlap in the zero pose are left out.

        Raises
        ------
        InputError
            A name in ``ignore`` belongs neither to the scene nor to the robot.
        """
        return separated_pairs(self, with_arm_capsules(robot))[0]

    def limit(
        self,
        robot: Robot,
        pairs: Sequence[Pair] | None = None,
        *,
        tolerance: float = 0.0,
        room: Sequence[float] | None = None,
    ) -> Limit:
        """Return the distances as a limit of the robot: one value per pair, m.

        Distances are measured from the axis of the arm's capsule. All capsules are treated as if
        they were as thick as the thickest one, as far as ``room`` allows. The lower bound is that
        radius plus the clearance plus a margin for the violation that a solver leaves between mesh
        points, so that this violation does not fail a certificate.

        Parameters
        ----------
        robot : Robot
            Arm with capsules.
        pairs : sequence of Pair, optional
            Pairs to limit; default all.
        tolerance : float
            Relative violation of the bound that a solver leaves between its mesh points.
        room : array_like, optional
            Distance of a known path beyond the clearance at each pair, m. Margin and rounding of
            the solver's distance take at most half of it each. Negative values are the overlap that
            is allowed to capsules whose links are apart.
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
    most = 0.5 * np.maximum(rooms, 0.0)  # largest margin, and largest rounding
    # The tolerance is relative to the bound. A thin finger, treated as thick as the upper arm, gets
    # an absolute tolerance of that size; tolerances of micrometres would refine meshes endlessly.
    share = np.where(overlap < 0.0, np.inf, most / max(2.0 * tolerance, ROUNDING))
    thicker = np.maximum(np.minimum(thickest + scene.clearance, share) - contact, 0.0)
    contact = contact + thicker
    margin = np.maximum(np.minimum(2.0 * tolerance * contact, most), 2.0 * ACCURACY)
    rows = zip(pairs, np.maximum(most, ACCURACY).tolist(), thicker.tolist(), strict=True)
    return Limit(
        LIMIT_NAME,
        Distances(tuple(replace(pair, accuracy=m, thicker=more) for pair, m, more in rows)),
        # Half of the margin is for the solver's violation, half for the proof of clearance.
        lower=contact + np.where(overlap < 0.0, 0.0, margin),
        unit="m",
        labels=tuple(pair.label for pair in pairs),
    )


def with_arm_capsules(robot: Robot) -> Robot:
    """Return the robot with capsules: its own, or fitted ones, or capsules along its links."""
    if robot.capsules:
        return robot
    return _with_default_capsules(robot, robot.shapes)


@lru_cache(maxsize=32)
def _with_default_capsules(robot: Robot, shapes: tuple[Any, ...]) -> Robot:
    has_geometry = any(shape.role == "collision" for shape in shapes)
    return robot.with_capsules(fit_capsules(robot) if has_geometry else link_capsules(robot))


@lru_cache(maxsize=64)
def separated_pairs(scene: Scene, robot: Robot) -> tuple[tuple[Pair, ...], tuple[Pair, ...]]:
    """Return the pairs that may not touch: those apart at zero, and those that overlap there."""
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
    """Return pairs of capsules of links that are neither neighbours nor disabled.

    The first list holds the links that are apart in the zero pose, the second those that overlap.
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
    touching = {_contact_key(pair) for pair, apart in zip(pairs, zero, strict=True) if apart <= 0.0}
    return (
        [pair for pair in pairs if _contact_key(pair) not in touching],
        [pair for pair in pairs if _contact_key(pair) in touching],
    )


def _contact_key(pair: Pair) -> Any:
    """Return the key that pairs of one decision share: the links if fitted, else the pair."""
    other = pair.other
    fits = pair.capsule.excess > 0.0 and isinstance(other, Capsule) and other.excess > 0.0
    return frozenset((pair.capsule.name, other.name)) if fits else pair


def clearances(robot: Robot, pairs: Sequence[Pair], q: FloatArray) -> FloatArray:
    """Return the distances [N,k] of pairs in poses q [N,n], m, by the solver's functions."""
    chosen = tuple(pairs)
    poses = checks.array("q", q, (None, robot.joint_count), "rad")
    values = Distances(chosen).in_poses(robot, len(poses)).values(poses)
    return values - np.array([pair.capsule.radius for pair in chosen])
