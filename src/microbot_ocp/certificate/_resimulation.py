"""Re-simulation of a motion from its own torque, segment by segment.

Each segment starts at the motion's own state. The driving torque is the inverse dynamics of the
interpolated accelerations, plus the interpolated difference between stored torques and inverse
dynamics. Gauss-Legendre collocation integrates the forward dynamics, solved for all segments at
once by Newton iteration with the damping of friction, which may make a segment stiff. The error at
the end of a segment is judged as the constant torque that would cause it, computed with the mass
matrix. If the mass matrix is nearly singular, torques do not determine the acceleration; there the
motion's own acceleration is integrated, and inverse dynamics judge it.

Theory: docs/theory/certificates.md, equations (2) and (3).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from microbot_ocp._base import deadline
from microbot_ocp._base.checks import ROUNDING, FloatArray
from microbot_ocp._base.growth import carry, transition_matrices
from microbot_ocp._base.status import Status
from microbot_ocp.certificate._certificate import ResimulationFigures
from microbot_ocp.motion import Motion, State, jump_gaps, mesh_of, nearest_samples, torque_along
from microbot_ocp.robot import Robot, forward_dynamics, mass_matrix
from microbot_ocp.simulation import interpolated, lagrange_weights

NODES = 9  # collocation nodes of a segment
NEAR_SINGULAR = 1e6  # condition number above which the mass matrix is nearly singular

IntArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

_points, _weights = np.polynomial.legendre.leggauss(NODES)
_to_coefficients = np.linalg.inv(np.polynomial.legendre.legvander(_points, NODES - 1))
PLACES, WEIGHTS = 0.5 * (_points + 1.0), 0.5 * _weights
# Row i integrates the interpolating polynomial from the start of the segment to node i.
INTEGRALS = 0.5 * np.column_stack(
    [
        np.polynomial.legendre.legval(_points, np.polynomial.legendre.legint(column, lbnd=-1))
        for column in _to_coefficients.T
    ]
)
# The last two Legendre coefficients of the nodal values measure the error of the interpolation.
TAIL = _to_coefficients[-2:]
# Eigenvectors of INTEGRALS decouple the Newton system into one n x n system per node.
MODES, _to_places = np.linalg.eig(INTEGRALS)
_to_modes = np.linalg.inv(_to_places)


@dataclass(frozen=True, eq=False, kw_only=True)
class Resimulation(ResimulationFigures):
    """Figures of a re-simulation and the parts that appear only in the certificate's text.

    ``undetermined_besides`` counts the undetermined directions besides the least determined one,
    at the pose where the mass matrix is nearest to singular.
    """

    message: str = ""
    undetermined_besides: int = 0


class _Segments(NamedTuple):
    """Integrated segments [K] with their defects."""

    start: FloatArray
    end: FloatArray
    defects: FloatArray  # errors of position and velocity at the end [K,2n]
    torques: FloatArray  # constant torques that would explain the defects [K,n]
    unknown: FloatArray  # torque uncertainty from the sampling of the motion [K,n]
    determined: BoolArray  # True if torques determine the acceleration [K]

    def where(self, chosen: BoolArray | IntArray) -> _Segments:
        parts: Any = [column[chosen] for column in self]
        return _Segments(*parts)


class _Drive:
    """Driving torque of a motion as a function of time, interpolated from its samples."""

    def __init__(self, robot: Robot, motion: Motion) -> None:
        self.robot, self.motion = robot, motion
        excess = motion.tau - torque_along(robot, State(motion.q, motion.qd, motion.qdd))
        self.excess = excess if np.abs(excess).max() > ROUNDING * np.abs(motion.tau).max() else None
        breaks = np.array([0.0, motion.duration])
        if motion.breaks is not None and motion.breaks.size < motion.t.size:
            breaks = mesh_of(motion)
        pairs = motion.t[1:][jump_gaps(motion.t)]
        breaks = np.union1d(breaks, pairs[(pairs > breaks[0]) & (pairs < breaks[-1])])
        self.smooth = interpolated(motion, motion.qdd, breaks)
        first = nearest_samples(motion.t, breaks)
        self.missed = np.cumsum(_acceleration_uncertainty(motion, first), axis=0)

    def unknown(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the uncertainty of the mean acceleration [K,n] between start and end [K]."""
        both = np.stack([start, end])
        total = np.stack([np.interp(both, self.motion.t, column) for column in self.missed.T], -1)
        return (total[1] - total[0]) / (end - start)[:, None]

    def __call__(self, t: FloatArray, state: State) -> tuple[FloatArray, ...]:
        """Return accelerations, torques, and the excess of the stored torques, each [N,n]."""
        smooth = self.smooth(t)
        tau = torque_along(self.robot, State(state.q, state.qd, smooth))
        added = np.zeros_like(smooth)
        if self.excess is not None:
            columns = [np.interp(t, self.motion.t, column) for column in self.excess.T]
            added = np.column_stack(columns)
        return smooth, tau + added, added


NEIGHBOURS = (-2, -1, 1, 2)  # offsets of the samples through which a cubic predicts a sample


def _acceleration_uncertainty(motion: Motion, first: IntArray) -> FloatArray:
    """Return the acceleration uncertainty, integrated over the interval before each sample [N,n].

    A sample's uncertainty is twice its distance from the cubic through its four neighbours, and
    the larger one of both ends counts for an interval. A jump that the samples do not mark counts
    in full; dense samples of a smooth motion give almost zero. The outermost samples have
    neighbours on one side only, where a cubic predicts poorly; they get the uncertainty of the
    nearest samples with neighbours on both.
    """
    t, count = motion.t, motion.t.size
    missed = np.zeros_like(motion.qdd)
    if count < 5:
        return missed
    stencil = np.arange(2, count - 2)[:, None] + NEIGHBOURS
    weights = lagrange_weights(t[2:-2], t[stencil])
    guess = (weights[:, :, None] * motion.qdd[stencil]).sum(axis=1)
    missed[2:-2] = 2.0 * np.abs(guess - motion.qdd[2:-2])
    # The stencils of the outermost intervals reach six samples into the motion.
    missed[:2], missed[-2:] = missed[2:6].max(axis=0), missed[-6:-2].max(axis=0)
    edges = first[1:-1, None] + np.arange(-3, 3)  # no cubic may extend across a break
    missed[np.clip(edges, 0, count - 1)] = 0.0
    missed[1:] = np.maximum(missed[1:], missed[:-1]) * np.diff(t)[:, None]
    return missed


LONGEST_SEGMENT = 0.1  # s
SHORTEST_SEGMENT = 2e-3  # s, of segments that converge; breaks may be nearer
SHORTEST_STIFF = 1e-5  # s, of segments that do not converge
MOST_SEGMENTS = 5_000  # initial segments; they are longer in motions beyond 500 s
MOST_TRIED = 200_000  # segments, halved ones included; about 20 s of work


def resimulate(robot: Robot, motion: Motion, tolerance: float, first: float = 0.0) -> Resimulation:
    """Simulate a motion again and judge its defects.

    ``tolerance`` is the allowed relative torque error, ``first`` the start time, s.
    """
    mesh, drive = mesh_of(motion), _Drive(robot, motion)
    size = torque_sizes(robot, motion)
    # Initial segments are equal; an edge moves to a mesh point nearer than half a segment.
    count = int(np.ceil(motion.duration / LONGEST_SEGMENT))
    edges = np.linspace(0.0, motion.duration, min(count, MOST_SEGMENTS) + 1)
    nearest = mesh[nearest_samples(mesh, edges)]
    near = np.abs(nearest - edges) < 0.5 * edges[1]
    edges = np.unique(np.where(near, nearest, edges))
    todo = np.column_stack([edges[:-1], edges[1:]])
    done, stuck = [], 0
    left = tried = 0
    while todo.size and not left:
        low = np.searchsorted(mesh, todo[:, 0] + ROUNDING, side="right")
        # A segment is divided until it is finished, or holds no break and has its least length.
        inner = low < np.searchsorted(mesh, todo[:, 1] - ROUNDING, side="left")
        segments, good, converged = _integrated(drive, size * tolerance, todo, inner)
        shortest = np.where(converged, SHORTEST_SEGMENT, SHORTEST_STIFF)
        small = ~inner & (np.diff(todo)[:, 0] <= shortest)
        stuck += int((small & ~good & ~converged).sum())
        done.append(segments.where(good | small))
        todo = todo[~(good | small)]
        cut = todo.mean(axis=1)
        # A segment with breaks inside is cut at the break nearest to its middle, others are halved.
        for k in np.flatnonzero(inner[~(good | small)]):
            inside = mesh[(mesh > todo[k, 0] + ROUNDING) & (mesh < todo[k, 1] - ROUNDING)]
            cut[k] = inside[np.abs(inside - cut[k]).argmin()]
        todo = np.vstack([np.column_stack([todo[:, 0], cut]), np.column_stack([cut, todo[:, 1]])])
        tried += good.size
        if deadline.over() or tried + len(todo) > MOST_TRIED:
            left = int((~(good | small)).sum())
            done.append(segments.where(~(good | small)))
    every = _Segments(*(np.concatenate(column) for column in zip(*done, strict=True)))
    every = every.where(np.argsort(every.start))
    judged = _figures_of(drive, every, size, tolerance, stuck, first)
    if not left:
        return judged
    over = deadline.over()
    why = "the time limit was over" if over else f"{tried} segments were tried"
    status = Status.TIME_LIMIT if over else Status.INTEGRATION_FAILED
    message = f"{why}, {left} of {judged.segments} segments are not resolved"
    return replace(judged, resimulation_status=status, message=message)


SMALL_TORQUE = 1e-3  # smallest torque scale of a joint, relative to the largest of all joints


def torque_sizes(robot: Robot, motion: Motion) -> FloatArray:
    """Return the torque scale of each joint [n], N m (N): its largest torque along the motion.

    The scale is at least a thousandth of the largest of all joints, and at least the torque that
    would stop the motion within its duration.
    """
    peaks = np.abs(torque_along(robot, State(motion.q, motion.qd, motion.qdd))).max(axis=0)
    some = np.linspace(0, motion.t.size - 1, min(100, motion.t.size)).astype(int)
    momenta = np.einsum("kij,kj->ki", _mass_matrices(robot, motion.q[some]), motion.qd[some])
    peaks = np.maximum(peaks, np.abs(momenta).max(axis=0) / motion.duration)
    return np.maximum(peaks, max(SMALL_TORQUE * float(peaks.max()), ROUNDING))


MOST_ITERATIONS = 16  # iterations before a segment is halved
CONVERGED_CHANGE = 1e-13  # relative change of the state at which the iteration ends
KNOWN_STATE = 1e-8  # accuracy of the motion's own states, rad (m) and rad/s (m/s)
LONGEST_UNDETERMINED = 0.02  # largest length of a segment that inverse dynamics judge alone, s
FINAL_DEFECT = 100.0  # factor on the tolerance above which no shorter segments are tried


def _integrated(
    drive: _Drive, allowed: FloatArray, spans: FloatArray, inner: BoolArray
) -> tuple[_Segments, BoolArray, BoolArray]:
    """Integrate segments [K]; return them with masks of the finished and the converged segments.

    A segment is finished if it is resolved, or if its defect is certainly beyond the tolerance.
    Shorter segments would not change the verdict on stored torques that differ from inverse
    dynamics by more than ``allowed`` [n], nor on samples that contradict each other. Segments whose
    torques do not determine the motion need no iteration. Segments with breaks inside (``inner``
    [K]) are not iterated if the torque jumps. A segment that does not converge keeps the motion's
    samples, and its stored torques are judged instead.
    """
    robot, motion = drive.robot, drive.motion
    count, begin, h = robot.joint_count, spans[:, 0], np.diff(spans)[:, 0]
    h1 = h[:, None, None]
    t = (begin[:, None] + h[:, None] * PLACES).ravel()
    shape = (h.size, NODES, count)
    flat = motion.sample(t)
    qdd, tau, added = (part.reshape(shape) for part in drive(t, flat))
    sampled = flat.q.reshape(shape), flat.qd.reshape(shape), qdd
    q, qd, qdd = (part.copy() for part in sampled)
    wrong = (np.abs(added) > allowed).any(axis=(1, 2))
    matrices = _mass_matrices(robot, flat.q)
    regular: BoolArray = np.less(_condition(matrices), NEAR_SINGULAR)
    determined: BoolArray = np.logical_and.reduce(regular.reshape(shape[:2]), axis=1)
    first, last = motion.sample(begin), motion.sample(spans[:, 1])
    q0, qd0 = first.q[:, None], first.qd[:, None]
    converged = ~determined
    inertia = matrices.reshape(h.size, NODES, count, count)[:, NODES // 2]
    open_ = determined & ~(inner & _rough(inertia, qdd, allowed))
    modes = _newton_modes(robot, flat, tau, h)
    # Collocation of equation (2) on all open segments, A = INTEGRALS: qd = qd0 + h A qdd(q, qd) and
    # q = q0 + h A qd. Segments leave the iteration as they converge or diverge.
    for _ in range(MOST_ITERATIONS):
        if not open_.any() or deadline.over():
            break
        qdd[open_] = _accelerations(robot, q[open_], qd[open_], tau[open_])
        with np.errstate(over="ignore", invalid="ignore"):
            # Newton with the damping slope D: (I - A x hD) change = residual.
            residual = qd0[open_] + h1[open_] * (INTEGRALS @ qdd[open_]) - qd[open_]
            change = modes[open_] @ (_to_modes @ residual)[..., None]
            speed = qd[open_] + (_to_places @ change[..., 0]).real
            place = q0[open_] + h1[open_] * (INTEGRALS @ speed)
            # An error of the velocity counts by the position error that it causes in the segment.
            change = np.maximum(
                np.abs(place - q[open_]).max(axis=(1, 2)),
                np.abs(speed - qd[open_]).max(axis=(1, 2)) * np.minimum(1.0, h[open_]),
            )
            size = 1.0 + np.abs(place).max(axis=(1, 2))
        q[open_], qd[open_] = place, speed
        which = np.flatnonzero(open_)
        converged[which[change <= CONVERGED_CHANGE * size]] = True
        open_[which[~(change > CONVERGED_CHANGE * size) | ~np.isfinite(change)]] = False
    good = converged & (determined | (h < LONGEST_UNDETERMINED))
    q[~converged], qd[~converged], qdd[~converged] = (part[~converged] for part in sampled)
    with np.errstate(over="ignore", invalid="ignore"):
        # Segments that did not converge integrate the motion's own velocity and acceleration.
        end_speed = qd0[:, 0] + h[:, None] * (WEIGHTS @ qdd)
        end_place = q0[:, 0] + h[:, None] * (WEIGHTS @ qd)
        defects = np.hstack([end_place - last.q, end_speed - last.qd])
        # Equation (3): a constant torque max(|M dqd| / h, 2 |M dq| / h^2) explains the part of the
        # defect beyond the accuracy of the motion's states.
        beyond = np.sign(defects) * np.maximum(0.0, np.abs(defects) - KNOWN_STATE)
        by_place = np.abs(np.einsum("kij,kj->ki", inertia, beyond[:, :count]))
        by_speed = np.abs(np.einsum("kij,kj->ki", inertia, beyond[:, count:]))
        torques = np.maximum(2.0 * by_place / h[:, None] ** 2, by_speed / h[:, None])
        torques[~determined] += np.abs(added[~determined]).max(axis=1)
        alone = wrong & ~converged  # across a jump the quadrature has no accuracy
        torques[alone] = np.abs(added[alone]).max(axis=1)
        unknown = np.einsum("kij,kj->ki", np.abs(inertia), drive.unknown(begin, spans[:, 1]))
        resolved = ~_rough(inertia, qdd, allowed)
        far = (torques > FINAL_DEFECT * (allowed + unknown)).any(axis=1)
        good &= resolved | far
        # Breaks inside a segment are harmless only if its defect is allowed; otherwise it is cut.
        good &= ~(inner & (torques > allowed).any(axis=1))
        good |= wrong | (far & resolved & ~inner)
    return _Segments(begin, spans[:, 1], defects, torques, unknown, determined), good, converged


RESOLVED_TAIL = 0.03  # torque of the last two Legendre coefficients, relative to the tolerance


def _rough(inertia: FloatArray, qdd: FloatArray, allowed: FloatArray) -> BoolArray:
    """Return a mask of segments [K] whose nodes do not resolve the accelerations [K,NODES,n]."""
    tail = np.abs(np.einsum("an,knj->kaj", TAIL, qdd)).max(axis=1)
    torque = np.abs(np.einsum("kij,kj->ki", inertia, tail))
    return np.logical_or.reduce(torque > RESOLVED_TAIL * allowed, axis=1)


def _newton_modes(robot: Robot, state: State, tau: FloatArray, h: FloatArray) -> NDArray[Any]:
    """Return the inverses [K,NODES,n,n] of Newton's matrices for the eigenvectors of ``INTEGRALS``.

    The derivative of the acceleration by the velocity is evaluated at the middle of each segment.
    """
    middle = slice(NODES // 2, None, NODES)
    torque = tau[:, NODES // 2]
    slopes = _slopes(robot, state.q[middle], state.qd[middle], torque, (0.0, 1.0))
    slopes *= h[:, None, None]
    return np.linalg.inv(np.eye(robot.joint_count) - MODES[:, None, None] * slopes[:, None])


def _figures_of(
    drive: _Drive, every: _Segments, size: FloatArray, tolerance: float, stuck: int, first: float
) -> Resimulation:
    robot, motion, count = drive.robot, drive.motion, drive.robot.joint_count
    # A defect within the sampling uncertainty is no error: the scale includes the uncertainty.
    share = np.nan_to_num(every.torques / (size + every.unknown / tolerance), nan=np.inf)
    k, joint = np.unravel_index(int(share.argmax()), share.shape)
    lengths = every.end - every.start
    middle = motion.sample(0.5 * (every.start + every.end))
    # Open-loop error to first order: e_k+1 = Phi_k e_k + defect_k, reported but not judged.
    slopes = _linearised(robot, middle)
    slopes[~every.determined] = 0.0
    carried = carry(np.nan_to_num(every.defects), transition_matrices(slopes, lengths))
    along = np.abs(carried.errors[:, :count]).max(axis=1)
    worst = int(along.argmax())
    direction, besides = None, 0
    if not every.determined.all():
        matrices = _mass_matrices(robot, middle.q[~every.determined])
        values, vectors = np.linalg.eigh(matrices)
        largest = values[:, -1]  # zero if no link has mass
        ratio = np.divide(values[:, 0], largest, out=0.0 * largest, where=largest > 0.0)
        least = int(ratio.argmin())
        direction = vectors[least, :, 0]
        direction = direction * np.sign(direction[np.abs(direction).argmax()])
        besides = int((values[least, 1:] * NEAR_SINGULAR <= values[least, -1]).sum())
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
    """Return derivatives [K,2n,2n] of velocity and acceleration by position and velocity."""
    tau, count = torque_along(robot, state), robot.joint_count
    slopes = np.zeros((len(tau), 2 * count, 2 * count))
    slopes[:, :count, count:] = np.eye(count)
    slopes[:, count:, :count] = _slopes(robot, state.q, state.qd, tau, (1.0, 0.0))
    slopes[:, count:, count:] = _slopes(robot, state.q, state.qd, tau, (0.0, 1.0))
    return slopes


def _slopes(
    robot: Robot, q: FloatArray, qd: FloatArray, tau: FloatArray, by: tuple[float, float]
) -> FloatArray:
    """Return derivatives [K,n,n] of the acceleration along ``by``, by forward differences.

    ``by`` is (1, 0) for the derivative by the position and (0, 1) for the derivative by the
    velocity. Entries are zero where the mass matrix is singular.
    """
    base, size = _accelerations(robot, q, qd, tau), np.sqrt(np.finfo(float).eps)
    with np.errstate(over="ignore", invalid="ignore"):
        changes = [
            _accelerations(robot, q + by[0] * step, qd + by[1] * step, tau) - base
            for step in size * np.eye(robot.joint_count)
        ]
        return np.nan_to_num(np.stack(changes, axis=2) / size)


def _accelerations(robot: Robot, q: FloatArray, qd: FloatArray, tau: FloatArray) -> FloatArray:
    """Return the accelerations of the forward dynamics [...,n]."""
    rows = [np.reshape(part, (-1, robot.joint_count)).T for part in (q, qd, tau)]
    return forward_dynamics(robot)(*rows).full().T.reshape(np.shape(q))


def _mass_matrices(robot: Robot, q: FloatArray) -> FloatArray:
    """Return the mass matrices [K,n,n] at positions [K,n]."""
    count = robot.joint_count
    return mass_matrix(robot)(q.T).full().reshape(count, -1, count).transpose(1, 0, 2)


def _condition(matrices: FloatArray) -> FloatArray:
    """Return the condition numbers [K] in the 2-norm; infinite if not positive definite."""
    values = np.linalg.eigvalsh(matrices)
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = values[:, -1] / values[:, 0]
    return np.where(values[:, 0] > 0, condition, np.inf)
