"""Endings of a search, solve or run: one type for the whole package."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """Ending of a computation that may fail. Tables print the value; see :attr:`sentence`.

    A result has it as ``status``, is ``solved`` only if the status is SOLVED, and adds ``advice``
    about the individual case.

    Examples
    --------
    >>> Status.SOLVED.solved, str(Status.ITERATION_LIMIT), Status("solved") is Status.SOLVED
    (True, 'iteration limit', True)
    """

    SOLVED = "solved", "Converged to the requested accuracy."
    # solvers
    ITERATION_LIMIT = (
        "iteration limit",
        "Stopped at the iteration limit: give a better guess, a coarser mesh first, or more "
        "iterations.",
    )
    TIME_LIMIT = "time limit", "Stopped at the time limit: the best so far is returned."
    INFEASIBLE = (
        "infeasible",
        "Converged to a point that violates constraints: look for limits that contradict each "
        "other or an end that cannot be reached.",
    )
    INTERRUPTED = "interrupted", "Interrupted: the last iterate or accepted solution is returned."
    FAILED = "failed", "The solver broke down: check scales and guess, try the other solver."
    GAP_LEFT = (
        "gap left",
        "Converged, but the cost may be lower by more than the gap asked for: check scales and "
        "guess, or allow a larger gap.",
    )
    TOO_COARSE = (
        "mesh too coarse",
        "Converged on a mesh on which the dynamics or limits are not met between its points: "
        "give more intervals, or leave the mesh out.",
    )
    LOCAL_OPTIMUM = (
        "local optimum",
        "Converged to a local optimum. Hardly any of many starts led to it and the others to "
        "higher costs, so a lower cost may exist: give a guess near the expected solution.",
    )
    SADDLE = (
        "saddle point",
        "Converged to a stationary point that is no minimum, and no solve from there reached a "
        "lower cost: give a guess that is less symmetric.",
    )
    OUTSIDE_TABLE = (
        "outside of a table",
        "Converged where a table is extrapolated outside of its grid: bound the table's argument, "
        "or extend the grid.",
    )
    # refinement
    NOT_ACCEPTED = (
        "finer mesh not accepted",
        "A finer mesh was not solved, or only at a higher cost: the last accepted solution is "
        "returned.",
    )
    NO_PROGRESS = (
        "no progress",
        "The accuracy is not reached, and the last finer meshes came no nearer: loosen the "
        "tolerance that is missed.",
    )
    ROUND_LIMIT = "round limit", "The accuracy is not reached within the allowed number of rounds."
    SIZE_LIMIT = "size limit", "The accuracy is not reached within the allowed number of intervals."
    # motions
    LIMITS_EXCEEDED = (
        "limits exceeded",
        "The solver converged on its mesh, but limits are exceeded between the mesh points: "
        "give a finer mesh.",
    )
    NOT_POSSIBLE = "not possible", "The method cannot do this task."
    NOT_FOUND = (
        "not found",
        "No way was found in the time, which does not prove that there is none: give more time, "
        "or another seed.",
    )
    # inverse kinematics
    ORIENTATION_MISSED = (
        "orientation missed",
        "The tool reaches the position, but no start found the orientation there as well; this "
        "is the least angle found.",
    )
    OUT_OF_REACH = (
        "out of reach",
        "No start reached the target, even without joint limits; this is the nearest pose found.",
    )
    LIMITS = (
        "limits prevent it",
        "The target can be reached, but not within the joint limits; this is the nearest pose "
        "found within them.",
    )
    NOT_CONVERGED = (
        "not converged",
        "Neither the target nor a nearest pose was found; this is the best iterate.",
    )
    # simulation
    UNBOUNDED = "unbounded", "The motion grows without bound."
    SINGULAR = (
        "singular",
        "The mass matrix is singular on the way: no torque determines the motion.",
    )
    INTEGRATION_FAILED = "integration failed", "The integrator stopped before the end."
    TOLERANCE_NOT_MET = (
        "tolerance not met",
        "The integrator arrived, but shorter steps still change the result by more than the "
        "tolerance.",
    )
    # sweeps
    KILLED_WORKER = (
        "killed worker",
        "The worker process ended without an answer, more than once: too little memory, or "
        "a crash in a library.",
    )

    sentence: str
    """Meaning of the status, and a remedy."""

    def __new__(cls, value: str, sentence: str) -> Status:
        """Return the member of this value."""
        member = str.__new__(cls, value)
        member._value_, member.sentence = value, sentence
        return member

    @property
    def solved(self) -> bool:
        """True only for SOLVED."""
        return self is Status.SOLVED
