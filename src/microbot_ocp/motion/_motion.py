"""Motions as dense samples of position, velocity, acceleration and torque.

Between two samples a motion is the quintic that agrees with q, qd and qdd at both. A piecewise
polynomial up to degree five is therefore represented exactly if its breaks are samples. A jump of
the acceleration has two samples 1 microsecond apart, the earlier one just before the jump.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import factorial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from microbot_ocp._base import checks
from microbot_ocp._base.archive import no_archive, read_archive, write_archive
from microbot_ocp._base.checks import ROUNDING, FloatArray, InputError
from microbot_ocp._base.foreign_words import HintingOfArms
from microbot_ocp._base.outcome import SOLVED, Outcome
from microbot_ocp._base.schema import refuse_toml
from microbot_ocp._base.showing import DrawnAxes, GivenAxes, view_for
from microbot_ocp._base.status import Status
from microbot_ocp.limits import MotionSamples, StateHistory
from microbot_ocp.motion._export import export
from microbot_ocp.motion._polynomial import PiecewisePolynomial, State, quintic_between
from microbot_ocp.motion._sampling import (
    JUMP_GAP,
    JUMP_SHARE,
    dense_times,
    history_of,
    jump_gaps,
    numbered,
)
from microbot_ocp.motion._sensitivities import Sensitivities, sensitivities_of
from microbot_ocp.robot import Robot

SAMPLE_STEP = 1e-3  # longest step between the samples of a new motion, s
MOST_HALVINGS = 5  # halvings of a step to resolve the torque

SCHEMA = 1  # version of the files
ARRAYS = ("t", "q", "qd", "qdd", "tau", "breaks")


@dataclass(frozen=True)
class Mark:
    """A named instant of a motion: the passage of a via point, the start of a phase."""

    time: float
    name: str


@dataclass(frozen=True, eq=False)
class Motion(HintingOfArms):
    """A sampled motion of a robot.

    Parameters
    ----------
    t : array_like [N]
        Strictly increasing times from 0, s.
    q, qd, qdd, tau : array_like [N,n]
        Joint positions (rad or m), velocities, accelerations and torques (N m or N).
    label : str
        Short name, used in tables and legends.
    breaks : array_like [K], optional
        Times at which the acceleration or its slope may jump, both ends included; a subset of
        ``t``, by default all of it.
    marks : sequence of Mark
        Named instants.
    provenance : mapping
        Origin of the motion: method, solver, versions. Plain JSON values.
    remark : str
        Sentence for the reader of a table.
    outcome : Outcome
        Ending of the search that made the motion; solved if there was none.

    Raises
    ------
    InputError
        Wrong shapes, times that do not increase, or values that are not finite.
    """

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray
    label: str = "motion"
    breaks: FloatArray | None = None
    marks: tuple[Mark, ...] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    remark: str = ""
    outcome: Outcome = SOLVED

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "t", checks.times("t", self.t, from_zero=True))
        put(self, "q", checks.array("q", self.q, (self.t.size, None), "rad"))
        for name, unit in (("qd", "rad/s"), ("qdd", "rad/s^2"), ("tau", "N m")):
            put(self, name, checks.array(name, getattr(self, name), self.q.shape, unit))
        breaks = self.t if self.breaks is None else checks.array("breaks", self.breaks, (None,))
        ends = breaks[[0, -1]] if breaks.size > 1 else np.array([np.nan, np.nan])
        if not np.allclose(ends, (0.0, self.t[-1]), rtol=ROUNDING) or np.any(np.diff(breaks) <= 0):
            raise InputError(
                f"breaks must be strictly increasing times from 0 to {self.t[-1]:g} s, not "
                f"{breaks.tolist()}"
            )
        put(self, "breaks", breaks)
        put(self, "marks", tuple(self.marks))

    @property
    def duration(self) -> float:
        """Duration, s."""
        return float(self.t[-1])

    def __repr__(self) -> str:
        size = f"{self.duration:.4g} s, {self.joint_count} joints"
        return f"<Motion {self.label!r}: {size}, {self.status}>"

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()

    @property
    def joint_count(self) -> int:
        """Number of joints n."""
        return self.q.shape[1]

    @property
    def status(self) -> Status:
        """Status of the solver that made the motion."""
        return self.outcome.status

    @property
    def solved(self) -> bool:
        """False if the solver did not converge; :attr:`advice` has details."""
        return self.status.solved

    @property
    def advice(self) -> str:
        """Remarks on the ending of the search, one sentence per line."""
        return self.outcome.text

    @property
    def note(self) -> str:
        """Remark, or the reason why the motion is no solution."""
        return self.remark if self.solved else f"not solved: {self.advice}"

    def ended(self, outcome: Outcome, **provenance: Any) -> Motion:
        """Return the motion with another outcome, and further entries in its provenance."""
        return replace(self, outcome=outcome, provenance={**self.provenance, **provenance})

    @classmethod
    def from_polynomial(
        cls,
        robot: Robot,
        polynomial: PiecewisePolynomial,
        *,
        label: str = "motion",
        marks: Sequence[Mark] = (),
        provenance: Mapping[str, Any] | None = None,
        remark: str = "",
        step: float = SAMPLE_STEP,
        jumps_at: Sequence[float] = (),
    ) -> Motion:
        """Return samples of a piecewise polynomial (degree up to five) with its inverse dynamics.

        The samples are at most ``step`` seconds apart, and closer where torques change fast; every
        break is a sample. ``jumps_at`` are breaks at which other data than the acceleration jump.
        """
        degree = polynomial.coefficients.shape[1] - 1
        if degree > 5:
            raise InputError(f"polynomial must be of degree at most 5, not {degree}")
        step = checks.number("step", step, "s", above=0.0)
        velocity = polynomial.derivative()
        acceleration = velocity.derivative()
        breaks = polynomial.breaks
        before = acceleration(breaks, from_left=True)[1:-1]
        after = acceleration(breaks)[1:-1]
        size = 1.0 + np.abs(acceleration.coefficients[:, 0]).max()
        jumps = np.abs(after - before).max(axis=1) > ROUNDING * size
        jumps |= np.isin(breaks[1:-1], jumps_at)

        def state_at(t: FloatArray) -> State:
            return State(polynomial(t), velocity(t), acceleration(t))

        # A torque that is not resolved between two samples adds their midpoint.
        least, places = _steps_to_tell(acceleration), breaks
        for _ in range(MOST_HALVINGS):
            t = sample_times(places, breaks[1:-1][jumps], step, least)
            motion = cls.from_state(
                robot,
                t,
                state_at(t),
                label=label,
                breaks=breaks,
                marks=marks,
                provenance=provenance,
                remark=remark,
            )
            middle = unresolved(robot, t, state_at, motion.tau)
            if not middle.size:
                break
            places = np.union1d(places, middle)
        return motion

    @classmethod
    def from_state(
        cls,
        robot: Robot,
        t: ArrayLike,
        state: State,
        *,
        label: str,
        breaks: ArrayLike | None = None,
        marks: Sequence[Mark] = (),
        provenance: Mapping[str, Any] | None = None,
        remark: str = "",
    ) -> Motion:
        """Return the motion through given states, with the torques of inverse dynamics."""
        times, tau = np.asarray(t, dtype=float), torque_along(robot, state)
        ends = None if breaks is None else np.asarray(breaks, dtype=float)
        names = {"robot": robot.name, "robot_digest": robot.chain_digest}
        about = tuple(marks), {**names, **(provenance or {})}, remark
        return cls(times, *state, tau, label, ends, *about)

    def stretched(self, robot: Robot, factor: float) -> Motion:
        """Return the motion slowed down by ``factor``, with the torques of inverse dynamics.

        The result has no sensitivities, as other limits are active in it.

        Parameters
        ----------
        robot : Robot
            Arm that moves.
        factor : float
            Factor of the times, above 0. Velocities are divided by it, accelerations by its
            square.

        Raises
        ------
        InputError
            The factor is not above 0.
        """
        factor = checks.number("factor", factor, above=0.0)
        state = State(self.q, self.qd / factor, self.qdd / factor**2)
        return replace(
            self,
            t=factor * self.t,
            **state._asdict(),
            tau=torque_along(robot, state),
            breaks=None if self.breaks is None else factor * self.breaks,
            marks=tuple(Mark(factor * mark.time, mark.name) for mark in self.marks),
            provenance={k: v for k, v in self.provenance.items() if k != "multipliers"},
        )

    def sample(self, t: ArrayLike) -> State:
        """Return position, velocity and acceleration at times t [N] within [0, duration].

        Raises
        ------
        InputError
            A time is outside of the motion or not finite.
        """
        times, i = self._pieces_at(t)
        return State(*_derivatives(self._coefficients(i), times - self.t[i], 2))

    def samples(self, t: ArrayLike) -> MotionSamples:
        """Return position and its first three derivatives at times t [N], as :meth:`sample`.

        The jerk excludes jumps of the acceleration: next to a jump it is the one-sided value.
        """
        times, i = self._pieces_at(t)
        jumping = jump_gaps(self.t)[i]
        # Starts of the jumps' gaps, which continue the intervals before them.
        ends = self.t[i[jumping]]
        times, i = np.append(times, ends), np.append(i, i[jumping] - 1)
        every = _derivatives(self._coefficients(i), times - self.t[i], 3)
        q, qd, qdd, qddd = (each[: jumping.size] for each in every)
        qddd[jumping] = every[3][jumping.size :]
        return MotionSamples(q, qd, qdd, qddd)

    def _pieces_at(self, t: ArrayLike) -> tuple[FloatArray, np.ndarray]:
        """Return checked times [N] within the motion, and the indices of their intervals."""
        times = checks.array("t", np.atleast_1d(np.asarray(t)), (None,), "s")
        slack = ROUNDING * max(1.0, self.duration)
        outside = times[(times < -slack) | (times > self.duration + slack)]
        if outside.size:
            raise InputError(
                f"t must be within the motion, 0 to {self.duration:g} s, not {outside[0]:g} s"
            )
        return times, np.searchsorted(self.t[1:-1], times, side="right")

    def _coefficients(self, i: np.ndarray) -> FloatArray:
        """Return coefficients [6,n,N] of the quintics in intervals i, lowest power first."""
        if i.size < self.t.size - 1:
            return np.moveaxis(pieces_of(self, i), 0, 2)
        return _every_piece(self).take(i, axis=2)

    def history(self, *, cycle: bool = False) -> StateHistory:
        """Return the data to verify limits: the state on a dense grid, and the jumps.

        The grid has at least 20 points in each interval between breaks (5 if there are thousands
        of intervals), steps of at most 0.25 ms, and both sides of each break.
        An arm at rest at an end of the motion is held there, so a start with an acceleration is a
        jump. In a ``cycle`` a motion with moving ends continues at its start.
        """
        return history_of(self, dense_times(self)[0], cycle)

    def resample(self, rate: float, robot: Robot | None = None) -> Motion:
        """Return the motion on a grid of ``rate`` hertz, its end included.

        Torques are those of the inverse dynamics of ``robot``, plus the interpolated difference of
        the motion's own torques to them, for example of a load. Without a robot the torques
        themselves are interpolated, with an error of some thousandths where they are curved.
        """
        rate = checks.number("rate", rate, "Hz", above=0.0)
        checks.size("the number of samples", self.duration * rate, checks.MOST_GIVEN)
        count = max(1, int(np.ceil(self.duration * rate - 0.5)))
        t = np.append(np.arange(count) / rate, self.duration)
        state, beside = self.sample(t), self.tau
        tau = np.zeros_like(state.q)
        if robot is not None and robot.has_dynamics:
            tau, state_here = torque_along(robot, state), State(self.q, self.qd, self.qdd)
            beside = self.tau - torque_along(robot, state_here) if self.tau.any() else self.tau
        tau += np.column_stack([np.interp(t, self.t, column) for column in beside.T])
        return replace(self, t=t, **state._asdict(), tau=tau, breaks=None)

    def sensitivities(
        self, robot: Robot, mass: float = 0.0, center_of_mass: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Sensitivities:
        """Return derivatives of the duration with respect to limits, payload and via points.

        The motion must come from :func:`microbot_ocp.time_optimal` or a prepared solver, through
        via points. The derivatives follow from the multipliers of its solve and hold while the set
        of active limits does not change.

        Parameters
        ----------
        robot : Robot
            Robot without the payload, under the limits that the motion was planned with.
        mass : float
            Mass of the payload, kg.
        center_of_mass : array_like [3]
            Center of mass of the payload in the tool frame, m.

        Returns
        -------
        Sensitivities

        Raises
        ------
        InputError
            The motion has no multipliers, or the robot has other joints.

        Examples
        --------
        >>> import numpy as np
        >>> import microbot_ocp as mo
        >>> robot = mo.load_robot("microbot")
        >>> motion = mo.time_optimal(robot, np.radians([[0, 0, 0], [-90, 90, 90]]))
        >>> found = motion.sensitivities(robot)
        >>> bool(found.upper["tau"][2] < 0.0)
        True
        """
        return sensitivities_of(self, robot, mass, center_of_mass)

    def plot(self, robot: Robot, axes: GivenAxes | None = None, **options: Any) -> DrawnAxes:
        """Return position, velocity and torque over time: :func:`microbot_ocp.plots.motion`."""
        return view_for(self, "plot")(robot, self, axes, **options)

    def to_rerun(self, robot: Robot, path: str | Path, scene: Any = None) -> Path:
        """Write a Rerun recording (``.rrd``) of the robot on this motion, under its limits.

        With a :class:`~microbot_ocp.Scene` it shows the obstacles and the nearest points, too.
        """
        return view_for(self, "rerun")(robot, self, scene=scene).save(path)

    def export(
        self,
        path: str | Path,
        rate: float | None = None,
        robot: Robot | None = None,
        theme: str = "light",
        scene: Any = None,
        profile: Any = None,
        via_q: Any = None,
        segments: Any = None,
        cycle: bool = False,
    ) -> Path:
        """Write the motion for another program, or as a film, in the format of the path's suffix.

        Parameters
        ----------
        path : str or Path
            Format: ``.csv`` with heads and units; ``.json``, a ``trajectory_msgs/JointTrajectory``
            of ROS for MoveIt and ros2_control; ``.mat`` for MATLAB (needs scipy); ``.parquet``
            (needs pyarrow); ``.xml``, keyframes of a MuJoCo model; ``.gif`` or ``.mp4``, a film of
            the arm with ``rate`` and ``theme`` of ``write_animation``, which needs ``robot``.
            :meth:`load` reads only files of :meth:`save`.
        rate : float, optional
            Samples a second, Hz; the last step to the end may be shorter. A controller needs a
            ``profile`` instead. Default the motion's own samples.
        robot : Robot, optional
            Robot with names and units of the joints; without it they are numbered and revolute.
        theme : str
            Theme of a film.
        scene : Scene, optional
            Obstacles that a film shows, with the line between the nearest points, or from which
            the executed motion keeps clear.
        profile : str or Profile, optional
            Profile of the controller that plays the file: rows at its rate, from rest to rest,
            slowed down until the executed motion keeps every limit, as by
            :func:`microbot_ocp.execution.commanded`, with the controller's quantities only. Marks
            of a ROS message are in a file ``.marks.json`` beside it. Needs ``robot``.
        via_q, segments, cycle
            Stops of the motion for a profile, as in :func:`microbot_ocp.certify`.

        Returns
        -------
        Path
            Path of the file.

        Raises
        ------
        InputError
            Unknown suffix, a rate that is not above 0, a robot with other joints, a missing
            package, more than three million numbers in a text file or 20 million in another, or a
            profile that does not accept the motion.

        Examples
        --------
        >>> import tempfile
        >>> import microbot_ocp as mo
        >>> robot = mo.load_robot("microbot")
        >>> shape = mo.cubic([[0, 0, 0], [1, 1, 1]], [0, 1])
        >>> motion = mo.Motion.from_polynomial(robot, shape, label="cubic")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     text = motion.export(f"{folder}/cubic.csv", rate=100.0, robot=robot).read_text()
        >>> text[:33]
        't [s],q waist [rad],q shoulder [r'
        """
        if profile is not None:
            stops = {"via_q": via_q, "segments": segments, "cycle": cycle}
            make = view_for(self, "execution")
            return make(self, path, profile, rate, robot, scene=scene, **stops)
        if via_q is not None or segments is not None or cycle:
            raise InputError("via_q, segments, cycle: only a profile needs the stops")
        return export(self, path, rate, robot, theme, scene)

    def save(self, path: str | Path) -> Path:
        """Write one ``.npz``: arrays t, q, qd, qdd, tau, breaks and a JSON string ``metadata``."""
        arrays = {name: getattr(self, name) for name in ARRAYS}
        metadata = {
            "schema": SCHEMA,
            "label": self.label,
            "remark": self.remark,
            "duration": self.duration,
            "units": "s, rad (m), rad/s, rad/s^2, N m (N)",
            "marks": [[mark.time, mark.name] for mark in self.marks],
            "provenance": dict(self.provenance),
            "outcome": self.outcome.as_dict(),
        }
        return write_archive(path, arrays, metadata, "provenance")

    @classmethod
    def load(cls, path: str | Path) -> Motion:
        """Return a motion that :meth:`save` wrote.

        Raises
        ------
        InputError
            The file is missing, holds no motion, or was written by a newer version.
        """
        refuse_toml(path, "saved motion")
        arrays, metadata = read_archive(path, "motion", SCHEMA)
        try:
            return cls(
                **{name: arrays[name] for name in ARRAYS},
                label=metadata["label"],
                marks=tuple(Mark(float(time), str(name)) for time, name in metadata["marks"]),
                provenance=metadata["provenance"],
                remark=metadata["remark"],
                outcome=Outcome.read(metadata["outcome"]),
            )
        except (LookupError, TypeError, ValueError, OverflowError) as problem:
            raise no_archive(path, "motion", problem) from None


def other_arm(robot: Robot, motion: Motion) -> str:
    """Return a note if a motion was made for another arm; empty otherwise."""
    name, digest = (motion.provenance.get(key) for key in ("robot", "robot_digest"))
    if name is None or digest == robot.chain_digest or (digest is None and name == robot.name):
        return ""
    besides = "" if name != robot.name else " with other rows, base or tool"
    return f"this motion names robot {name!r}{besides or f', not {robot.name!r}'}"


def torque_along(robot: Robot, state: State) -> FloatArray:
    """Return inverse dynamics [N,n] of states [N,n]; zero for a robot without masses."""
    q = checks.array("q", state.q, (None, robot.joint_count))
    if not robot.has_dynamics:
        return np.zeros_like(q)
    return robot.torques_along(q, state.qd, state.qdd)["tau"]


def _steps_to_tell(acceleration: PiecewisePolynomial) -> int:
    """Return the number of steps in an interval from whose samples the acceleration follows.

    The number is the degree of the acceleration, without terms of rounding, and at least 1.
    """
    terms = np.abs(acceleration.coefficients).max(axis=2)
    terms = terms * np.diff(acceleration.breaks)[:, None] ** np.arange(terms.shape[1])
    present = (terms > ROUNDING * terms.max()).any(axis=0)
    return max(1, int(np.flatnonzero(present)[-1:].sum()))


TORQUE_EXCESS = 0.05  # excess over the torques at both neighbouring samples, by the largest torque
MOST_RESOLVED = 200_000  # samples above which the torque between them is not evaluated


def unresolved(
    robot: Robot,
    t: FloatArray,
    state_at: Callable[[FloatArray], State],
    tau: FloatArray | None = None,
) -> FloatArray:
    """Return midpoints between samples at which a torque is far outside of its values at both.

    ``tau`` holds the torques at the samples, if known. The result is empty for a robot without
    masses; gaps of jumps are left out.
    """
    if not robot.has_dynamics or t.size > MOST_RESOLVED:
        return t[:0]
    middle = 0.5 * (t[1:] + t[:-1])
    tau = torque_along(robot, state_at(t)) if tau is None else tau
    between = torque_along(robot, state_at(middle))
    low, high = np.minimum(tau[:-1], tau[1:]), np.maximum(tau[:-1], tau[1:])
    outside = (np.maximum(between - high, low - between) - (high - low)).max(axis=1)
    return middle[(outside > TORQUE_EXCESS * np.abs(tau).max()) & ~jump_gaps(t)]


def sample_times(breaks: FloatArray, jumps: FloatArray, step: float, least: int = 1) -> FloatArray:
    """Return times from the first to the last break, all breaks included, at most ``step`` apart.

    An interval has at least ``least`` steps, so that its samples determine the acceleration. Long
    motions have longer steps (:func:`checks.longest_step`). Every time in ``jumps`` is preceded by
    a sample 1 microsecond before it, or less in short intervals.
    """
    breaks = np.asarray(breaks, dtype=float)
    step = max(step, checks.longest_step(float(breaks[-1] - breaks[0]), checks.MOST_SAMPLES))
    start, length = breaks[:-1], np.diff(breaks)
    count = np.maximum(least, np.ceil(length / step - ROUNDING)).astype(int)
    # The first interval gets an inner sample, so that a break is never mistaken for the side of a
    # jump: breaks that equal all samples would look like the default.
    count[0] = max(count[0], 2 if length[0] > 6 * JUMP_GAP else 1)
    jumping = np.isin(breaks[1:], jumps)
    gap = np.minimum(JUMP_GAP, 0.5 * JUMP_SHARE * length / count)
    last = breaks[1:] - np.where(jumping, gap, 0.0)
    i, k = numbered(count + jumping)
    return np.append(start[i] + k / count[i] * (last - start)[i], breaks[-1])


@lru_cache(maxsize=1)  # several methods evaluate one motion
def _every_piece(motion: Motion) -> FloatArray:
    return np.ascontiguousarray(np.moveaxis(pieces_of(motion), 0, 2))


def _derivatives(c: FloatArray, x: FloatArray, order: int) -> list[FloatArray]:
    """Return polynomials of x [N] and their derivatives up to an order, each [N,n].

    Horner's scheme overwrites the coefficients c [6,n,N], lowest power first.
    """
    terms = [c[5], *np.zeros((order, *c[5].shape))]
    for k in range(4, -1, -1):
        for higher in range(min(order, 5 - k), 0, -1):
            terms[higher] *= x
            terms[higher] += terms[higher - 1]
        terms[0] *= x
        terms[0] += c[k]
    return [factorial(k) * term.T for k, term in enumerate(terms)]


def polynomial_of(motion: Motion) -> PiecewisePolynomial:
    """Return the positions of a motion as the piecewise polynomial between its samples.

    The piece before a jump reaches to the jump: the short gap before it is no piece of its own.
    """
    pieces = ~jump_gaps(motion.t)
    breaks = np.append(motion.t[:-1][pieces], motion.t[-1])
    return PiecewisePolynomial(breaks, pieces_of(motion)[pieces])


# Rounding of positions in the acceleration of a quintic, times h^-2.
LAST_DIGITS = 360 * np.finfo(float).eps
ROUNDING_ALLOWED = 1e-6  # rounding error of an acceleration, relative to the largest one


def pieces_of(motion: Motion, i: np.ndarray | None = None) -> FloatArray:
    """Return coefficients [N-1,6,n] of the polynomials between samples, lowest power first.

    ``i`` selects some of the intervals.
    """
    first = np.arange(motion.t.size - 1) if i is None else i
    h = motion.t[first + 1] - motion.t[first]
    start, end = (State(motion.q[k], motion.qd[k], motion.qdd[k]) for k in (first, first + 1))
    c = quintic_between(start, end, h)
    # In short intervals rounding dominates the difference of positions: velocities and
    # accelerations determine the polynomial, in still shorter ones accelerations alone.
    least = ROUNDING_ALLOWED * np.abs(motion.qdd).max(initial=0.0)
    short = LAST_DIGITS * np.abs(start.q).max(axis=1, initial=0.0) > h**2 * least
    if short.any():
        step, change = h[short, None], (end.qdd - start.qdd)[short]
        gained = (end.qd - start.qd)[short] - step * start.qdd[short]
        precise = LAST_DIGITS * np.abs(start.qd[short]).max(axis=1) <= h[short] * least
        gained = np.where(precise[:, None], gained, 0.5 * step * change)
        c[short, 3] = (gained / step - change / 3.0) / step
        c[short, 4] = (change / 4.0 - 0.5 * gained / step) / step**2
        c[short, 5] = 0.0
    # Inside of a jump's gap the earlier acceleration continues.
    c[jump_gaps(motion.t, first), 3:] = 0.0
    return c
