"""A motion simulated again from its own torque, segment by segment.

Each segment starts at the motion's own state. It is driven by the torque that inverse dynamics ask
for the sampled accelerations, interpolated, and by what the stored torques differ from it. The
forward dynamics are integrated by Gauss-Legendre collocation, solved for all segments at once by
Picard's iteration, or by the simplified Newton iteration where friction makes them stiff, and what
is missed at the end is put down to a torque: the constant one that would cause it, by the mass
matrix. Where the mass matrix is all but singular torques do not determine the
acceleration, so the motion's own is integrated there and inverse dynamics say what torque it takes.

Theory: docs/theory/certificates.md, equations (2) and (3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import FloatArray
from microbot_ocp._base.growth import carry, transition_matrices
from microbot_ocp._base.status import Status
from microbot_ocp.certificate._certificate import ResimulationFigures
from microbot_ocp.motion import Motion, State, jump_gaps, mesh_of, nearest_samples, torque_along
from microbot_ocp.robot import Robot, forward_dynamics, mass_matrix
from microbot_ocp.simulation import interpolated, lagrange_weights


@dataclass(frozen=True)
class ResimulationSettings:
    """Settings of the simulation of a motion, segment by segment.

    Attributes
    ----------
    nodes : of a segment
    longest_segment : s
    shortest_segment : s; shorter ones only between breaks
    shortest_stiff : s, the same where the iteration does not converge
    most_segments : at first: those of motions beyond 500 s are longer
    most_tried : segments in all, halved ones among them: some 20 s of work
    rounds : of the iteration, before a segment is halved
    stiff : damping times the length of a segment, beyond which Picard's iteration is slow
    converged : relative change of the state
    resolved : of the torque that is judged: what may be left of the last Legendre coefficients
    neighbours : segments beside one that is divided
    wrong : times what is allowed: no finer segments will mend that
    known_state : rad (m) and rad/s (m/s): how well a motion's states are taken to be known
    near_singular : condition number of the mass matrix
    undetermined : s, the longest segment that is judged by inverse dynamics alone
    small_torque : of the largest: what the torque of a joint counts as, at least
    difference : of the differences that linearise the dynamics, rad (m) and rad/s (m/s)
    """

    nodes: int = 9
    longest_segment: float = 0.1
    shortest_segment: float = 2e-3
    shortest_stiff: float = 1e-5
    most_segments: int = 5_000
    most_tried: int = 200_000
    rounds: int = 16
    stiff: float = 0.5
    converged: float = 1e-13
    resolved: float = 0.03
    neighbours: tuple[int, ...] = (-2, -1, 1, 2)
    wrong: float = 100.0
    known_state: float = 1e-8
    near_singular: float = 1e6
    undetermined: float = 0.02
    small_torque: float = 1e-3
    difference: float = 1e-6


RESIMULATION = ResimulationSettings()


IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

_points, _weights = np.polynomial.legendre.leggauss(RESIMULATION.nodes)
_to_coefficients = np.linalg.inv(np.polynomial.legendre.legvander(_points, RESIMULATION.nodes - 1))
PLACES, WEIGHTS = 0.5 * (_points + 1.0), 0.5 * _weights
# Integrals from the start to each place, of the polynomial through the values at all of them.
INTEGRALS = 0.5 * np.column_stack(
    [
        np.polynomial.legendre.legval(_points, np.polynomial.legendre.legint(column, lbnd=-1))
        for column in _to_coefficients.T
    ]
)
TAIL = _to_coefficients[-2:]
MODES, _to_places = np.linalg.eig(INTEGRALS)
_to_modes = np.linalg.inv(_to_places)


@dataclass(frozen=True, eq=False, kw_only=True)
class Resimulation(ResimulationFigures):
    """What became of a motion, and what a certificate says of it in words alone.

    ``undetermined_besides`` counts the further directions that torques do not determine where they
    determine one least.
    """

    message: str = ""
    undetermined_besides: int = 0


class _Segments(NamedTuple):
    """Segments [K] that have been integrated."""

    start: FloatArray
    end: FloatArray
    defects: FloatArray  # [K,2n], of position and velocity
    torques: FloatArray  # [K,n], what would explain them
    unknown: FloatArray  # [K,n], what the samples leave open of the torque
    determined: BoolArray  # [K]

    def where(self, chosen: BoolArray | IntArray) -> _Segments:
        parts: Any = [column[chosen] for column in self]
        return _Segments(*parts)


class _Drive:
    """The torque of a motion as a function of time, from its samples."""

    def __init__(self, robot: Robot, motion: Motion) -> None:
        self.robot, self.motion = robot, motion
        excess = motion.tau - torque_along(robot, State(motion.q, motion.qd, motion.qdd))
        self.excess = excess if np.abs(excess).max() > 1e-9 * np.abs(motion.tau).max() else None
        breaks = np.array([0.0, motion.duration])
        if motion.breaks is not None and motion.breaks.size < motion.t.size:
            breaks = mesh_of(motion)
        pairs = motion.t[1:][jump_gaps(motion.t)]
        breaks = np.union1d(breaks, pairs[(pairs > breaks[0]) & (pairs < breaks[-1])])
        self.smooth = interpolated(motion, motion.qdd, breaks)
        first = nearest_samples(motion.t, breaks)
        self.missed = np.cumsum(_missed(motion, first), axis=0)

    def unknown(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return how uncertain the mean acceleration [K,n] from start to end [K] is."""
        both = np.stack([start, end])
        total = np.stack([np.interp(both, self.motion.t, column) for column in self.missed.T], -1)
        return (total[1] - total[0]) / (end - start)[:, None]

    def __call__(self, t: FloatArray, state: State) -> tuple[FloatArray, ...]:
        """Return accelerations, torques, and what the stored torques are too large [N,n]."""
        smooth = self.smooth(t)
        tau = torque_along(self.robot, State(state.q, state.qd, smooth))
        added = np.zeros_like(smooth)
        if self.excess is not None:
            columns = [np.interp(t, self.motion.t, column) for column in self.excess.T]
            added = np.column_stack(columns)
        return smooth, tau + added, added


def _missed(motion: Motion, first: IntArray) -> FloatArray:
    """Return integral [N,n] over the interval before each sample of how uncertain the acceleration
    is.

    That is how far the samples at its ends are from the cubics through their four neighbours: all
    of a jump that the samples do not mark, and next to nothing where they are dense. The first and
    the last samples have neighbours on one side only, where a cubic says little: they are as
    uncertain as the next that have them on both.
    """
    t, count = motion.t, motion.t.size
    missed = np.zeros_like(motion.qdd)
    if count < 5:
        return missed
    stencil = np.arange(2, count - 2)[:, None] + RESIMULATION.neighbours
    weights = lagrange_weights(t[2:-2], t[stencil])
    guess = (weights[:, :, None] * motion.qdd[stencil]).sum(axis=1)
    missed[2:-2] = 2.0 * np.abs(guess - motion.qdd[2:-2])
    # the stencils of the outermost intervals reach six samples in
    missed[:2], missed[-2:] = missed[2:6].max(axis=0), missed[-6:-2].max(axis=0)
    edges = first[1:-1, None] + np.arange(-3, 3)  # no cubic goes across a break
    missed[np.clip(edges, 0, count - 1)] = 0.0
    missed[1:] = np.maximum(missed[1:], missed[:-1]) * np.diff(t)[:, None]
    return missed


def resimulate(robot: Robot, motion: Motion, tolerance: float, first: float = 0.0) -> Resimulation:
    """Simulate a motion again; ``tolerance`` of the torque, relative, is what will be judged.

    It begins at ``first``, s.
    """
    mesh, drive = mesh_of(motion), _Drive(robot, motion)
    size = torque_sizes(robot, motion)
    count = int(np.ceil(motion.duration / RESIMULATION.longest_segment))
    edges = np.linspace(0.0, motion.duration, min(count, RESIMULATION.most_segments) + 1)
    nearest = mesh[nearest_samples(mesh, edges)]
    near = np.abs(nearest - edges) < 0.5 * edges[1]
    edges = np.unique(np.where(near, nearest, edges))
    todo = np.column_stack([edges[:-1], edges[1:]])
    done, stuck = [], 0
    left = tried = 0
    while todo.size and not left:
        low = np.searchsorted(mesh, todo[:, 0] + 1e-9, side="right")
        inner = low < np.searchsorted(mesh, todo[:, 1] - 1e-9, side="left")
        segments, good, converged = _integrated(drive, size * tolerance, todo, inner)
        shortest = np.where(converged, RESIMULATION.shortest_segment, RESIMULATION.shortest_stiff)
        small = ~inner & (np.diff(todo)[:, 0] <= shortest)
        stuck += int((small & ~good & ~converged).sum())
        done.append(segments.where(good | small))
        todo = todo[~(good | small)]
        cut = todo.mean(axis=1)
        for k in np.flatnonzero(inner[~(good | small)]):
            inside = mesh[(mesh > todo[k, 0] + 1e-9) & (mesh < todo[k, 1] - 1e-9)]
            cut[k] = inside[np.abs(inside - cut[k]).argmin()]
        todo = np.vstack([np.column_stack([todo[:, 0], cut]), np.column_stack([cut, todo[:, 1]])])
        tried += good.size
        if deadline.over() or tried + len(todo) > RESIMULATION.most_tried:
            left = int((~(good | small)).sum())
            done.append(segments.where(~(good | small)))
    every = _Segments(*(np.concatenate(column) for column in zip(*done, strict=True)))
    every = every.where(np.argsort(every.start))
    judged = _judged(drive, every, size, tolerance, stuck, first)
    if not left:
        return judged
    over = deadline.over()
    why = "the time limit was over" if over else f"{tried} segments were tried"
    status = Status.TIME_LIMIT if over else Status.INTEGRATION_FAILED
    message = f"{why}, {left} of {judged.segments} segments are not resolved"
    return replace(judged, resimulation_status=status, message=message)


def torque_sizes(robot: Robot, motion: Motion) -> FloatArray:
    """Return what errors of the torques [n] are relative to: the largest of each joint, N m (N).

    At least a thousandth of the largest of all, and what would stop the motion in its duration.
    """
    peaks = np.abs(torque_along(robot, State(motion.q, motion.qd, motion.qdd))).max(axis=0)
    some = np.linspace(0, motion.t.size - 1, min(100, motion.t.size)).astype(int)
    momenta = np.einsum("kij,kj->ki", _mass_matrices(robot, motion.q[some]), motion.qd[some])
    peaks = np.maximum(peaks, np.abs(momenta).max(axis=0) / motion.duration)
    return np.maximum(peaks, max(RESIMULATION.small_torque * float(peaks.max()), 1e-9))


def _integrated(
    drive: _Drive, allowed: FloatArray, spans: FloatArray, inner: BoolArray
) -> tuple[_Segments, BoolArray, BoolArray]:
    """Return segments [K] integrated, which are accurate, or as wrong as can be told, and which
    converged.

    Where torques do not determine the motion there is no iteration to converge. Of those with
    breaks inside, ``inner`` [K], it is not begun where the torque jumps. Stored torques that differ
    from inverse dynamics by more than is ``allowed`` [n] are wrong whatever comes of them, as are
    samples that contradict each other: shorter segments tell no more. Where the iteration does not
    converge the motion is judged by its samples and by that difference.
    """
    robot, motion = drive.robot, drive.motion
    count, begin, h = robot.joint_count, spans[:, 0], np.diff(spans)[:, 0]
    h1 = h[:, None, None]
    t = (begin[:, None] + h[:, None] * PLACES).ravel()
    shape = (h.size, RESIMULATION.nodes, count)
    flat = motion.sample(t)
    qdd, tau, added = (part.reshape(shape) for part in drive(t, flat))
    sampled = flat.q.reshape(shape), flat.qd.reshape(shape), qdd
    q, qd, qdd = (part.copy() for part in sampled)
    wrong = (np.abs(added) > allowed).any(axis=(1, 2))
    matrices = _mass_matrices(robot, flat.q)
    regular: BoolArray = np.less(_condition(matrices), RESIMULATION.near_singular)
    determined: BoolArray = np.logical_and.reduce(regular.reshape(shape[:2]), axis=1)
    first, last = motion.sample(begin), motion.sample(spans[:, 1])
    q0, qd0 = first.q[:, None], first.qd[:, None]
    converged = ~determined
    inertia = matrices.reshape(h.size, RESIMULATION.nodes, count, count)[:, RESIMULATION.nodes // 2]
    open_ = determined & ~(inner & _rough(inertia, qdd, allowed))
    stiff, modes = _stiff_modes(robot, flat, tau, h)
    for _ in range(RESIMULATION.rounds):
        if not open_.any() or deadline.over():
            break
        qdd[open_] = _accelerations(robot, q[open_], qd[open_], tau[open_])
        with np.errstate(over="ignore", invalid="ignore"):
            speed = qd0[open_] + h1[open_] * (INTEGRALS @ qdd[open_])
            both = open_ & stiff
            change = modes[both[stiff]] @ (_to_modes @ (speed - qd[open_])[both[open_]])[..., None]
            speed[both[open_]] = qd[both] + (_to_places @ change[..., 0]).real
            place = q0[open_] + h1[open_] * (INTEGRALS @ speed)
            change = np.maximum(
                np.abs(place - q[open_]).max(axis=(1, 2)),
                np.abs(speed - qd[open_]).max(axis=(1, 2)) * np.minimum(1.0, h[open_]),
            )
            size = 1.0 + np.abs(place).max(axis=(1, 2))
        q[open_], qd[open_] = place, speed
        which = np.flatnonzero(open_)
        converged[which[change <= RESIMULATION.converged * size]] = True
        open_[which[~(change > RESIMULATION.converged * size) | ~np.isfinite(change)]] = False
    good = converged & (determined | (h < RESIMULATION.undetermined))
    q[~converged], qd[~converged], qdd[~converged] = (part[~converged] for part in sampled)
    with np.errstate(over="ignore", invalid="ignore"):
        # Elsewhere the motion's own velocity and acceleration are integrated.
        end_speed = qd0[:, 0] + h[:, None] * (WEIGHTS @ qdd)
        end_place = q0[:, 0] + h[:, None] * (WEIGHTS @ qd)
        defects = np.hstack([end_place - last.q, end_speed - last.qd])
        beyond = np.sign(defects) * np.maximum(0.0, np.abs(defects) - RESIMULATION.known_state)
        by_place = np.abs(np.einsum("kij,kj->ki", inertia, beyond[:, :count]))
        by_speed = np.abs(np.einsum("kij,kj->ki", inertia, beyond[:, count:]))
        torques = np.maximum(2.0 * by_place / h[:, None] ** 2, by_speed / h[:, None])
        torques[~determined] += np.abs(added[~determined]).max(axis=1)
        alone = wrong & ~converged  # over a jump the integrals say nothing
        torques[alone] = np.abs(added[alone]).max(axis=1)
        unknown = np.einsum("kij,kj->ki", np.abs(inertia), drive.unknown(begin, spans[:, 1]))
        resolved = ~_rough(inertia, qdd, allowed)
        far = (torques > RESIMULATION.wrong * (allowed + unknown)).any(axis=1)
        good &= resolved | far
        good &= ~(inner & (torques > allowed).any(axis=1))
        good |= wrong | (far & resolved & ~inner)
    return _Segments(begin, spans[:, 1], defects, torques, unknown, determined), good, converged


def _rough(inertia: FloatArray, qdd: FloatArray, allowed: FloatArray) -> BoolArray:
    """Tell in which segments [K] the nodes do not resolve the accelerations [K,NODES,n]."""
    tail = np.abs(np.einsum("an,knj->kaj", TAIL, qdd)).max(axis=1)
    torque = np.abs(np.einsum("kij,kj->ki", inertia, tail))
    return np.logical_or.reduce(torque > RESIMULATION.resolved * allowed, axis=1)


def _stiff_modes(
    robot: Robot, state: State, tau: FloatArray, h: FloatArray
) -> tuple[BoolArray, NDArray[Any]]:
    """Return which segments [K] friction makes stiff, and for those the inverses of Newton's
    iteration.

    The derivative of the acceleration by the velocity is taken in the middle of each; the inverses
    [stiff, NODES, n, n] are for the eigenvectors of the collocation's integrals.
    """
    middle = slice(RESIMULATION.nodes // 2, None, RESIMULATION.nodes)
    torque = tau[:, RESIMULATION.nodes // 2]
    slopes = _slopes(robot, state.q[middle], state.qd[middle], torque, (0.0, 1.0))
    slopes *= h[:, None, None]
    stiff: BoolArray = np.abs(slopes).max(axis=(1, 2)) > RESIMULATION.stiff
    matrices = np.eye(robot.joint_count) - MODES[:, None, None] * slopes[stiff, None]
    return stiff, np.linalg.inv(matrices)


def _judged(
    drive: _Drive, every: _Segments, size: FloatArray, tolerance: float, stuck: int, first: float
) -> Resimulation:
    robot, motion, count = drive.robot, drive.motion, drive.robot.joint_count
    share = np.nan_to_num(every.torques / (size + every.unknown / tolerance), nan=np.inf)
    k, joint = np.unravel_index(int(share.argmax()), share.shape)
    lengths = every.end - every.start
    middle = motion.sample(0.5 * (every.start + every.end))
    slopes = _linearised(robot, middle)
    slopes[~every.determined] = 0.0
    carried = carry(np.nan_to_num(every.defects), transition_matrices(slopes, lengths))
    along = np.abs(carried.errors[:, :count]).max(axis=1)
    worst = int(along.argmax())
    direction, besides = None, 0
    if not every.determined.all():
        matrices = _mass_matrices(robot, middle.q[~every.determined])
        values, vectors = np.linalg.eigh(matrices)
        largest = values[:, -1]  # zero where links have no mass at all
        ratio = np.divide(values[:, 0], largest, out=0.0 * largest, where=largest > 0.0)
        least = int(ratio.argmin())
        direction = vectors[least, :, 0]
        direction = direction * np.sign(direction[np.abs(direction).argmax()])
        besides = int((values[least, 1:] * RESIMULATION.near_singular <= values[least, -1]).sum())
    message = f"it did not converge on {stuck} of {lengths.size} segments" if stuck else ""
    return Resimulation(
        resimulation_status=Status.INTEGRATION_FAILED if stuck else Status.SOLVED,
        message=message,
        segments=lengths.size,
        defect=float(share[k, joint]),
        defect_joint=robot.joint_names[joint],
        defect_time=first + float(every.end[k]),
        position_defect=float(np.nan_to_num(np.abs(every.defects[:, :count]), nan=np.inf).max()),
        amplification=carried.amplification,
        undetermined_direction=direction,
        undetermined_besides=besides,
        undetermined_fraction=float(lengths[~every.determined].sum() / motion.duration),
        final_position_error=float(along[-1]),
        final_velocity_error=float(np.abs(carried.errors[-1, count:]).max()),
        path_position_error=float(along[worst]),
        path_error_time=first + float(every.end[worst]),
    )


def _linearised(robot: Robot, state: State) -> FloatArray:
    """Return the derivative [K,2n,2n] of velocity and acceleration by position and velocity."""
    tau, count = torque_along(robot, state), robot.joint_count
    slopes = np.zeros((len(tau), 2 * count, 2 * count))
    slopes[:, :count, count:] = np.eye(count)
    slopes[:, count:, :count] = _slopes(robot, state.q, state.qd, tau, (1.0, 0.0))
    slopes[:, count:, count:] = _slopes(robot, state.q, state.qd, tau, (0.0, 1.0))
    return slopes


def _slopes(
    robot: Robot, q: FloatArray, qd: FloatArray, tau: FloatArray, by: tuple[float, float]
) -> FloatArray:
    """Return derivative [K,n,n] of the acceleration by the position, or by the velocity, as ``by``
    says.

    By differences; zero where the mass matrix is singular.
    """
    base = _accelerations(robot, q, qd, tau)
    with np.errstate(over="ignore", invalid="ignore"):
        changes = [
            _accelerations(robot, q + by[0] * step, qd + by[1] * step, tau) - base
            for step in RESIMULATION.difference * np.eye(robot.joint_count)
        ]
        return np.nan_to_num(np.stack(changes, axis=2) / RESIMULATION.difference)


def _accelerations(robot: Robot, q: FloatArray, qd: FloatArray, tau: FloatArray) -> FloatArray:
    """Return the forward dynamics [...,n]."""
    rows = [np.reshape(part, (-1, robot.joint_count)).T for part in (q, qd, tau)]
    return forward_dynamics(robot)(*rows).full().T.reshape(np.shape(q))


def _mass_matrices(robot: Robot, q: FloatArray) -> FloatArray:
    """Return mass matrices [K,n,n] at positions [K,n]."""
    count = robot.joint_count
    return mass_matrix(robot)(q.T).full().reshape(count, -1, count).transpose(1, 0, 2)


def _condition(matrices: FloatArray) -> FloatArray:
    """Return condition numbers [K], in the 2-norm; infinite where not positive definite."""
    values = np.linalg.eigvalsh(matrices)
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = values[:, -1] / values[:, 0]
    return np.where(values[:, 0] > 0, condition, np.inf)
