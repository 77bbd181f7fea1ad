"""How a search, a solve or a run ended: one type for the whole package."""

from __future__ import annotations

from enum import StrEnum


class Status(StrEnum):
    """How something that may fail ended. The value is what tables print; see :attr:`sentence`.

    Results carry it as ``status``, have ``solved`` for the one good ending, and ``advice`` for what
    is known of the single case.

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
        "Converged to a local optimum. Of many starts one or hardly any led to it and the "
        "others to dearer ones, so there may well be a cheaper one: give a guess near what is "
        "meant.",
    )
    SADDLE = (
        "saddle point",
        "Converged to a point that is stationary but no minimum, and no solve from there went "
        "below it: give a guess that is less symmetric.",
    )
    OUTSIDE_TABLE = (
        "outside of a table",
        "Converged where a table is read outside of its grid, which extrapolates it: bound what it "
        "is read at, or give it more points.",
    )
    # refinement
    NOT_ACCEPTED = (
        "finer mesh not accepted",
        "A finer mesh was not solved, or only at a higher cost: the last accepted solution is "
        "returned.",
    )
    NO_PROGRESS = (
        "no progress",
        "The accuracy is not reached, and the last finer meshes came no nearer: ask for less of "
        "what is missed.",
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
        "The process that did it ended without an answer, more than once: too little memory, or "
        "a fault of a library.",
    )

    sentence: str
    """What it means, and what to try."""

    def __new__(cls, value: str, sentence: str) -> Status:
        """Return a member of this value."""
        member = str.__new__(cls, value)
        member._value_, member.sentence = value, sentence
        return member

    @property
    def solved(self) -> bool:
        """Whether it ended well."""
        return self is Status.SOLVED
