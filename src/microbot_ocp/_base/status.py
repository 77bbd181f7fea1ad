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

    SOLVED = "solved"
    # solvers
    ITERATION_LIMIT = "iteration limit"
    TIME_LIMIT = "time limit"
    INFEASIBLE = "infeasible"
    INTERRUPTED = "interrupted"
    FAILED = "failed"
    GAP_LEFT = "gap left"
    TOO_COARSE = "mesh too coarse"
    LOCAL_OPTIMUM = "local optimum"
    SADDLE = "saddle point"
    # refinement
    NOT_ACCEPTED = "finer mesh not accepted"
    NO_PROGRESS = "no progress"
    ROUND_LIMIT = "round limit"
    SIZE_LIMIT = "size limit"
    # motions
    LIMITS_EXCEEDED = "limits exceeded"
    NOT_POSSIBLE = "not possible"
    NOT_FOUND = "not found"
    # inverse kinematics
    ORIENTATION_MISSED = "orientation missed"
    OUT_OF_REACH = "out of reach"
    LIMITS = "limits prevent it"
    NOT_CONVERGED = "not converged"
    # simulation
    UNBOUNDED = "unbounded"
    SINGULAR = "singular"
    INTEGRATION_FAILED = "integration failed"
    TOLERANCE_NOT_MET = "tolerance not met"
    # sweeps
    KILLED_WORKER = "killed worker"

    @classmethod
    def _missing_(cls, value: object) -> Status | None:
        """The status whose name is given, as some files hold it: "iteration_limit"."""
        return cls.__members__.get(str(value).upper())

    @property
    def solved(self) -> bool:
        """Whether it ended well."""
        return self is Status.SOLVED

    @property
    def sentence(self) -> str:
        """What it means, and what to try."""
        return _SENTENCES[self]


_SENTENCES = {
    Status.SOLVED: "Converged to the requested accuracy.",
    Status.ITERATION_LIMIT: (
        "Stopped at the iteration limit: give a better guess, a coarser mesh first, or more "
        "iterations."
    ),
    Status.TIME_LIMIT: "Stopped at the time limit: the best so far is returned.",
    Status.INFEASIBLE: (
        "Converged to a point that violates constraints: look for limits that contradict each "
        "other or an end that cannot be reached; explain names them."
    ),
    Status.INTERRUPTED: "Interrupted: the last iterate or accepted solution is returned.",
    Status.FAILED: "The solver broke down: check scales and guess, try the other solver.",
    Status.GAP_LEFT: (
        "Converged, but the cost may be lower by more than the gap asked for: check scales and "
        "guess, or allow a larger gap."
    ),
    Status.TOO_COARSE: (
        "Converged on a mesh on which the dynamics or limits are not met between its points: give "
        "more intervals, or leave the mesh out."
    ),
    Status.LOCAL_OPTIMUM: (
        "Converged to a local optimum. Of many starts one or hardly any led to it and the others "
        "to dearer ones, so there may well be a cheaper one: give a guess near what is meant."
    ),
    Status.SADDLE: (
        "Converged to a point that is stationary but no minimum, and no solve from there went "
        "below it: give a guess that is less symmetric."
    ),
    Status.NOT_ACCEPTED: (
        "A finer mesh was not solved, or only at a higher cost: the last accepted solution is "
        "returned."
    ),
    Status.NO_PROGRESS: (
        "The accuracy is not reached, and the last finer meshes came no nearer: ask for "
        "less of what is missed."
    ),
    Status.ROUND_LIMIT: "The accuracy is not reached within the allowed number of rounds.",
    Status.SIZE_LIMIT: "The accuracy is not reached within the allowed number of intervals.",
    Status.LIMITS_EXCEEDED: (
        "The solver converged on its mesh, but limits are exceeded between the mesh points: give "
        "a finer mesh."
    ),
    Status.NOT_POSSIBLE: "The method cannot do this task.",
    Status.NOT_FOUND: (
        "No way was found in the time, which does not prove that there is none: give more time, or "
        "another seed."
    ),
    Status.ORIENTATION_MISSED: (
        "The tool reaches the position, but no start found the orientation there as well; this "
        "is the least angle found."
    ),
    Status.OUT_OF_REACH: (
        "No start reached the target, even without joint limits; this is the nearest pose found."
    ),
    Status.LIMITS: (
        "The target can be reached, but not within the joint limits; this is the nearest pose "
        "found within them."
    ),
    Status.NOT_CONVERGED: (
        "Neither the target nor a nearest pose was found; this is the best iterate."
    ),
    Status.UNBOUNDED: "The motion grows without bound.",
    Status.SINGULAR: "The mass matrix is singular on the way: no torque determines the motion.",
    Status.INTEGRATION_FAILED: "The integrator stopped before the end.",
    Status.TOLERANCE_NOT_MET: (
        "The integrator arrived, but shorter steps still change the result by more than the "
        "tolerance."
    ),
    Status.KILLED_WORKER: (
        "The process that did it ended without an answer, more than once: too little memory, or a "
        "fault of a library."
    ),
}
