"""The search for the best values of free quantities: a coarse map, then steps along slopes.

The map is made of quick looks: the best branches from rest to rest. Whole solves, with branches and
orders chosen anew, begin at the given cell and at the best nodes of the map. Steps minimise a
quadratic model of slopes within a trust region, so that a kink, where the branch or the order
changes, shortens the next step.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from microbot_ocp._base import checks, deadline
from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.quasi_random import quasi_random
from microbot_ocp.layout._quantities import Quantity, cell_with
from microbot_ocp.layout._slopes import slopes
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.planning.search import rested_duration
from microbot_ocp.scene import clearances, guiding_pairs
from microbot_ocp.tasks import Cell, CellFile

NODES_A_LINE = 13  # a map of one quantity has so many
DECIMALS = 6  # digits of the values
SAME = 1e-6  # relative difference of equal estimates
MODEL_ITERATIONS = 200  # steps to the minimum of the quadratic model
# Most work of a solve, in that of the longest successful one so far: without a way past an obstacle
# the search for one would only end at the time limit of the cell
PATIENCE = 10.0


@dataclass(frozen=True)
class DesignSettings:
    """Settings of the search for a design.

    Attributes
    ----------
    nodes : int
        Nodes of the map at most, of two quantities in a square; of three or more they are spread
        evenly at random.
    solves : int
        Whole solves at most, those of the differences at the end besides.
    starts : int
        Nodes of the map from which steps begin, besides the given cell.
    radius : float
        First step, relative to the ranges of the quantities.
    least_radius : float
        Step after which a descent ends.
    gain : float
        Relative gain of the period below which a step is not taken.
    """

    nodes: int = 49
    solves: int = 40
    starts: int = 3
    radius: float = 0.1
    least_radius: float = 0.002
    gain: float = 2e-4

    def __post_init__(self) -> None:
        checks.whole("nodes", self.nodes, at_least=4)
        checks.whole("solves", self.solves, at_least=2)
        checks.whole("starts", self.starts, at_least=0)
        for key in ("radius", "least_radius", "gain"):
            checks.number(key, getattr(self, key), above=0.0, at_most=1.0)


@dataclass(frozen=True, eq=False)
class Node:
    """Values of the quantities, and the quick look at the cell with them.

    Attributes
    ----------
    values : array [d]
    estimate : float
        Time from rest to rest, s; infinite where it is not known, NaN where there is no motion.
    refusal : str
        Reason why there is no motion; empty where there may be one.
    """

    values: FloatArray
    estimate: float
    refusal: str = ""


@dataclass(frozen=True, eq=False)
class Solved:
    """Values of the quantities, and the certified motion of the cell with them.

    Attributes
    ----------
    values : array [d]
    cell : Cell or None
        None where the task is refused, or the motion is not solved and certified.
    refusal : str
        Reason for that.
    """

    values: FloatArray
    cell: Cell | None
    refusal: str = ""

    @property
    def period(self) -> float:
        """Duration of the motion, s; infinite without one."""
        return np.inf if self.cell is None else self.cell.motion.duration


@dataclass(eq=False)
class LayoutSearch:
    """Quick looks and solves of a cell with other values of its free quantities.

    Attributes
    ----------
    cell : CellFile
        Cell of the start, with capsules around its arm where it has a scene.
    quantities : tuple of Quantity, d
    settings : DesignSettings
    progress : StepProgress
    held : array [d] of bool
        True for quantities without effect, which stay as they are.
    """

    cell: CellFile
    quantities: tuple[Quantity, ...]
    settings: DesignSettings
    progress: StepProgress
    nodes: list[Node] = field(default_factory=list)
    solved: list[Solved] = field(default_factory=list)
    held: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    _looks: dict[bytes, tuple[Node, FloatArray]] = field(init=False, default_factory=dict)
    _longest: float = field(init=False, default=0.0)

    @property
    def start(self) -> FloatArray:
        """Values [d] of the given cell."""
        return np.array([quantity.start for quantity in self.quantities])

    @property
    def lower(self) -> FloatArray:
        return np.array([quantity.lower for quantity in self.quantities])

    @property
    def size(self) -> FloatArray:
        """Ranges [d] of the quantities."""
        return np.array([quantity.upper for quantity in self.quantities]) - self.lower

    def at_bounds(self, values: FloatArray) -> np.ndarray:
        """Return a mask [d] of values at a bound of their range."""
        above = values - self.lower
        return np.minimum(np.abs(above), np.abs(self.size - above)) <= SAME

    @property
    def best(self) -> Solved:
        """Fastest certified motion; the start where nothing is faster."""
        return min(self.solved, key=lambda solved: solved.period)

    @property
    def over(self) -> bool:
        """True if there are as many solves as allowed."""
        return len(self.solved) >= self.settings.solves

    # the map --------------------------------------------------------------------------------------

    def look(self, values: FloatArray) -> tuple[Node, FloatArray]:
        """Return a node with its quick look, and the poses [N,n] of the arm on the way.

        Known ones are returned again.
        """
        key = values.tobytes()
        if key not in self._looks:
            cell = cell_with(self.cell, self.quantities, values)
            task = cell.stops, cell.limits, cell.segments, cell.cycle, cell.scene
            try:
                estimate, poses = rested_duration(cell.robot, *task)
                self._looks[key] = Node(values, estimate), poses
            except InputError as refusal:
                nowhere = np.zeros((0, cell.robot.joint_count))
                self._looks[key] = Node(values, np.nan, str(refusal)), nowhere
        return self._looks[key]

    def draw_map(self) -> None:
        """Look at the nodes of the map.

        Raises
        ------
        InputError
            No node is reachable, or obstacles forbid all that are.
        """
        self.nodes = [self.look(values)[0] for values in (self.start, *self.grid())]
        reachable = [node for node in self.nodes if not node.refusal]
        self.progress(f"map: {len(reachable)} of {len(self.nodes)} nodes have a motion")
        if reachable:
            return
        if self.cell.scene is not None:
            bare = replace(self, cell=replace(self.cell, scene=None))
            for node in self.nodes:
                if not bare.look(node.values)[0].refusal:
                    raise InputError(
                        f"obstacles forbid every one of {len(self.nodes)} placements within the "
                        f"bounds; at {self.text(node.values)}, for one, {node.refusal}"
                    )
        raise InputError(
            f"none of {len(self.nodes)} placements within the bounds reaches all stops; at "
            f"{self.text(self.nodes[0].values)}, for one, {self.nodes[0].refusal}"
        )

    def grid(self) -> list[FloatArray]:
        """Return the values of the nodes, evenly over the ranges."""
        count = len(self.quantities)
        if count <= 2:
            line = min(NODES_A_LINE, int(self.settings.nodes ** (1 / count)))
            shares = np.array(list(itertools.product(np.linspace(0.0, 1.0, line), repeat=count)))
        else:
            shares = quasi_random(self.settings.nodes, count, skip=1)
        return list(np.round(self.lower + self.size * shares, DECIMALS))

    def text(self, values: FloatArray) -> str:
        """Return values with names and units."""
        pairs = zip(self.quantities, values.tolist(), strict=True)
        return ", ".join(f"{q.name} = {v:.4g} {q.unit}".rstrip() for q, v in pairs)

    def hold_without_effect(self) -> None:
        """Keep the value of the given cell for each quantity without effect.

        It is varied alone from some nodes of the map: if neither the time from rest to rest nor the
        distances from obstacles on the way change, it has no effect.

        Raises
        ------
        InputError
            No quantity has an effect, or only the present value of one reaches all stops.
        """
        known = sorted(
            (node for node in self.nodes if np.isfinite(node.estimate)), key=lambda n: n.estimate
        )
        places = {0, len(known) // 2, len(known) - 1} if known else set()
        middles = [(known[k].values, self._signature(known[k].values)) for k in sorted(places)]
        reached = np.array([node.values for node in self.nodes if not node.refusal])
        held = np.zeros(len(self.quantities), dtype=bool)
        for k, quantity in enumerate(self.quantities):
            if np.all(reached[:, k] == quantity.start):
                why = self.look(self._with(reached[0], k, 0.85))[0].refusal
                if why:
                    raise InputError(
                        f"no value of {quantity.name} but the present one reaches all stops in a "
                        f"map of {len(self.nodes)} placements ({why}): leave it out, or give "
                        "smaller bounds"
                    )
            held[k] = bool(middles) and all(
                np.allclose(before, self._signature(self._with(v, k, share)), SAME, SAME)
                for (v, before), share in itertools.product(middles, (0.0, 0.5))
            )
        if held.all():
            names = " and ".join(quantity.name for quantity in self.quantities)
            raise InputError(
                f"{names}: without effect on this cell, which takes as long with every value"
            )
        self.held = held
        self.nodes = [
            replace(node, values=np.where(held, self.start, node.values)) for node in self.nodes
        ]

    def _with(self, values: FloatArray, index: int, share: float) -> FloatArray:
        moved = values.copy()
        moved[index] = self.lower[index] + share * self.size[index]
        return moved

    def _signature(self, values: FloatArray) -> tuple[float, float]:
        """Return estimate, s, and least clearance on the way, m; both -1 without a motion."""
        node, poses = self.look(values)
        if node.refusal:
            return -1.0, -1.0
        cell = cell_with(self.cell, self.quantities, values)
        if cell.scene is None:
            return node.estimate, 0.0
        pairs = guiding_pairs(cell.robot, cell.scene.without_parts_of(cell.robot))
        return node.estimate, float(clearances(cell.robot, pairs, poses).min())

    # solves ---------------------------------------------------------------------------------------

    def solve(self, values: FloatArray) -> Solved:
        """Return the certified motion of the cell with these values, rounded to 1e-6.

        Known ones are returned again.
        """
        values = values if np.array_equal(values, self.start) else np.round(values, DECIMALS)
        for solved in self.solved:
            if np.array_equal(solved.values, values):
                return solved
        before, most = deadline.worked(), PATIENCE * self._longest or np.inf
        with deadline.of_work(most):
            solved = solved_with(self.cell, self.quantities, values)
        if solved.cell is not None:
            self._longest = max(self._longest, deadline.worked() - before)
        self.solved.append(solved)
        outcome = solved.refusal or f"{solved.period:.6g} s"
        self.progress(f"solve {len(self.solved)}: {self.text(values)}: {outcome}")
        return solved

    def run(self) -> None:
        """Solve the start and the best nodes of the map, and follow the slopes from each.

        After that come nodes whose estimates, by the smallest ratio of a period to its estimate so
        far, may be better than the best.
        """
        self.solve(self.start)
        first = [self.solve(node.values) for node in self._promising(self.settings.starts)]
        for solved in sorted([self.solved[0], *first], key=lambda solved: solved.period):
            self.descend(solved)
        while not self.over:
            node = next(iter(self._promising(1, self._may_improve)), None)
            if node is None:
                return
            before, solved = self.best.period, self.solve(node.values)
            if solved.period < before * (1.0 + self.settings.radius):
                self.descend(solved)

    def _promising(
        self, count: int, allowed: Callable[[Node], bool] = lambda node: True
    ) -> list[Node]:
        """Return the best nodes that are apart from each other and from all that was solved."""
        chosen: list[Node] = []
        apart = self.settings.radius
        for node in sorted(self.nodes, key=lambda node: node.estimate):
            places = [solved.values for solved in self.solved] + [other.values for other in chosen]
            near = (np.abs((node.values - other) / self.size).max() for other in places)
            if not node.refusal and allowed(node) and min(near, default=np.inf) > apart:
                chosen.append(node)
            if len(chosen) == count or len(chosen) + len(self.solved) >= self.settings.solves:
                break
        return chosen

    def _may_improve(self, node: Node) -> bool:
        """Return True if a node may be better than the best."""
        ratios = [
            solved.period / other.estimate
            for solved, other in itertools.product(self.solved, self.nodes)
            if np.isfinite(solved.period)
            and np.isfinite(other.estimate)
            and np.array_equal(solved.values, other.values)
        ]
        gain = 1.0 - self.settings.gain
        return not ratios or node.estimate * min(ratios) < gain * self.best.period

    def descend(self, here: Solved) -> None:
        """Take steps along the slopes until none gains, or a better motion is near."""
        settings, count = self.settings, len(self.quantities)
        curvature, radius = np.zeros((count, count)), settings.radius
        slope = self.slope(here)
        while slope is not None and radius > settings.least_radius and not self.over:
            place = (here.values - self.lower) / self.size
            step, promise = _model_step(place, slope, curvature, radius)
            if promise < settings.gain * here.period:
                return
            other = self.solve(self.lower + self.size * np.clip(place + step, 0.0, 1.0))
            gained = here.period - other.period
            if gained >= 0.5 * promise:
                radius = min(2.0 * radius, 0.5)
            else:
                radius = 0.5 * min(radius, float(np.abs(step).max()))
            slope_there = self.slope(other) if np.isfinite(other.period) else None
            if slope_there is not None:
                curvature = _updated(curvature, step, slope_there - slope)
            if gained > 0.0:
                here, slope = other, slope_there
                if len(self.solved) > 1 and self._is_beside_better(here):
                    return

    def _is_beside_better(self, here: Solved) -> bool:
        """Return True if a better motion with nearly these values is known from another descent."""
        near = (
            np.abs((here.values - other.values) / self.size).max() < 0.5 * self.settings.radius
            for other in self.solved
            if other is not here and other.period < here.period
        )
        return any(near)

    def slope(self, solved: Solved) -> FloatArray | None:
        """Return the slopes [d] of the period by the shares of the ranges, s."""
        if solved.cell is None:
            return None
        by_unit = slopes(self.cell, self.quantities, solved.values, solved.cell.motion)
        return None if by_unit is None else np.nan_to_num(by_unit * self.size) * ~self.held


def solved_with(cell: CellFile, quantities: Sequence[Quantity], values: FloatArray) -> Solved:
    """Return the certified motion of a cell with other values of its quantities."""
    try:
        answer = cell_with(cell, quantities, values).solve()
    except InputError as refusal:
        return Solved(values, None, str(refusal))
    if not answer.motion.solved:
        return Solved(values, None, answer.motion.advice or answer.motion.status.sentence)
    if not answer.certificate.ok:
        return Solved(values, None, answer.certificate.outcome)
    return Solved(values, answer)


def _model_step(
    place: FloatArray, slope: FloatArray, curvature: FloatArray, radius: float
) -> tuple[FloatArray, float]:
    """Return the best step [d] of a quadratic model within a trust region, and its gain, s."""
    low, high = np.maximum(-radius, -place), np.minimum(radius, 1.0 - place)
    pace = 1.0 / max(float(np.linalg.norm(curvature, 2)), SAME)
    gains = []
    for step in (np.where(slope > 0.0, low, high * (slope < 0.0)), np.zeros(place.size)):
        for _ in range(MODEL_ITERATIONS):
            step = np.clip(step - pace * (slope + curvature @ step), low, high)
        gains.append((float(-slope @ step - 0.5 * step @ curvature @ step), step))
    gain, step = max(gains, key=lambda pair: pair[0])
    return step, gain


def _updated(curvature: FloatArray, step: FloatArray, change: FloatArray) -> FloatArray:
    """Return the symmetric rank-one update of a curvature; unchanged where it is not defined."""
    missed = change - curvature @ step
    along = float(missed @ step)
    if abs(along) <= SAME * float(np.linalg.norm(missed) * np.linalg.norm(step)):
        return curvature
    return curvature + np.outer(missed, missed) / along
