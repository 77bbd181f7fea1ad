"""The fastest motion with its switching times as unknowns, exact to the integrator.

On the mesh of a free motion the acceleration is linear between points; that of the fastest motion
jumps. The arcs of the mesh solution become phases, and
:func:`microbot_ocp.ocp.solve_switching_times` solves for the times between them: on an arc the same
limit is active throughout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.limits import LIMIT_TOLERANCE, LimitFamily
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial, State, quintic_between
from microbot_ocp.ocp import (
    SolverSettings,
    SwitchingTimes,
    Transcription,
    solve,
    solve_switching_times,
)
from microbot_ocp.ocp.refinement import WORSE
from microbot_ocp.ocp.solution import StepProgress
from microbot_ocp.ocp.transcription import Collocation, Guess
from microbot_ocp.planning.free._problem import excess_along, free_problem
from microbot_ocp.planning.task import derivatives_for
from microbot_ocp.robot import Robot

MESH = 60  # number of intervals per phase of the search for arcs
SCHEME = Collocation("radau", 3)
SETTINGS = SolverSettings("ipopt", tolerance=1e-8, initial_barrier=1e-4)
PIECES = 4  # number of quintics per interval of an arc


def in_arcs(
    family: LimitFamily,
    held: Robot,
    motion: Motion,
    guesses: Mapping[str, Guess],
    progress: StepProgress,
) -> Motion:
    """Return the fastest motion with exact switching times, or the given one with their record.

    Parameters
    ----------
    family : LimitFamily
    held : Robot
        Robot of the program, with locked joints held.
    motion : Motion
        Motion on a mesh; the result if its arcs are not those of an optimum.
    guesses : mapping
        Values of the motion by phase.
    progress : callable
    """
    marks = motion.marks
    via = motion.sample([mark.time for mark in marks]).q
    # The mesh solution gives the order of the arcs; their times become unknowns.
    exact = _solved(held, via, guesses, progress)
    record = {**exact.as_dict(), "duration": exact.cost}
    with_record = replace(motion, provenance={**motion.provenance, "switching_times": record})
    if not exact.solved or exact.cost > motion.duration * (1 + WORSE):
        return with_record
    shape = _polynomial_of(exact)
    excess = float(excess_along(family, shape).max())
    record["excess"] = excess
    if excess > LIMIT_TOLERANCE:
        record["advice"] = (
            f"A limit is exceeded by {100 * excess:.2g} % between the points. {exact.advice}"
        )
        return with_record
    ends = np.cumsum([0.0, *map(exact.duration, exact.pieces)]).tolist()
    return Motion.from_polynomial(
        family.robot,
        shape,
        label=motion.label,
        marks=[Mark(end, mark.name) for end, mark in zip(ends, marks, strict=True)],
        provenance={
            **motion.provenance,
            "method": "free time-optimal motion, one phase an arc",
            "excess": excess,
            "gap": exact.gap.total,
            "intervals": [len(names) for names in exact.pieces.values()],
            "phase_durations": list(map(exact.duration, exact.pieces)),
            "smoothing": 0.0,
            "switching_times": record,
            "on_a_mesh": motion.duration,
        },
        remark=f"{len(exact.junctions)} switching times are unknowns; {motion.remark}",
    ).ended(motion.outcome)


def _solved(
    robot: Robot, via: FloatArray, guesses: Mapping[str, Guess], progress: StepProgress
) -> SwitchingTimes:
    problem = free_problem(robot, via, jumps=True)
    transcribe = partial(Transcription, derivatives=derivatives_for(robot))
    first = solve(transcribe(problem, scheme=SCHEME), MESH, guesses, SETTINGS)
    progress(f"with accelerations that jump: {first.duration:.6f} s, {first.status}")
    return solve_switching_times(problem, first, progress=progress, transcribe=transcribe)


def _polynomial_of(exact: SwitchingTimes) -> PiecewisePolynomial:
    """Return the motion as quintics that match its positions, velocities and accelerations."""
    breaks, pieces, start = [np.zeros(1)], [], 0.0
    places = np.linspace(0.0, 1.0, PIECES + 1)
    for names in exact.pieces.values():
        for name in names:
            phase = exact.solution[name]
            layout = phase.layout
            assert layout is not None
            assert phase.stages is not None
            count = phase.mesh.size - 1
            # Collocation of degree 3 is interpolated inside of its intervals, so several quintics
            # follow it closely.
            k = np.repeat(np.arange(count), places.size)
            values = layout.interpolated(phase.stages, k, np.tile(places, count))
            state = [values[key].reshape(count, places.size, -1) for key in State._fields]
            ends = [
                State(*(table[:, part].reshape(count * PIECES, -1) for table in state))
                for part in (slice(None, -1), slice(1, None))
            ]
            steps = np.repeat(np.diff(phase.t) / PIECES, PIECES)
            pieces.append(quintic_between(ends[0], ends[1], steps))
            breaks.append(start + np.cumsum(steps))
            # The sum of many steps differs from the duration by rounding: the last break is the end
            # itself.
            start += phase.duration
            breaks[-1][-1] = start
    return PiecewisePolynomial(np.concatenate(breaks), np.concatenate(pieces))
