"""What a certificate says, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from microbot_ocp._base import checks
from microbot_ocp._base.checks import FloatArray, plain
from microbot_ocp._base.showing import view_for
from microbot_ocp._base.status import Status
from microbot_ocp.ocp.solution import Gap


@dataclass(frozen=True)
class Thresholds:
    """What still passes.

    Attributes
    ----------
    cost : of the cost given, relative to the sum of the sizes of its parts
    gap : to the local optimum, likewise; half of a negative curvature, too
    state_error : defects of the re-simulation, summed up, relative to the state's largest
        magnitude; of the cost
        integrated again
    excess : of a limit between mesh points, relative to the limit
    feasibility : violation of a row or bound of the scaled program
    stationarity, complementarity, sign : of the scaled program, divided by
        ``max(100, mean of |multipliers|) / 100`` (Waechter and Biegler, 2006, equation 6)
    """

    cost: float = 1e-6
    gap: float = 1e-5
    state_error: float = 1e-3
    excess: float = 1e-3
    feasibility: float = 1e-6
    stationarity: float = 1e-5
    complementarity: float = 1e-5
    sign: float = 1e-5


@dataclass(frozen=True)
class CostCheck:
    """The cost evaluated again from its declared expressions.

    Attributes
    ----------
    given : what the solution says
    recomputed : by the quadrature of the scheme
    integrated : running costs integrated over every interval with the dynamics, from its own mesh
        state; not a number where the integrator stopped
    size : sum of the sizes of what the cost is added up from
    """

    given: float
    recomputed: float
    integrated: float
    size: float

    @property
    def error(self) -> float:
        """Difference of what is given, relative."""
        return abs(self.given - self.recomputed) / self.size

    @property
    def integration_error(self) -> float:
        """Difference of the quadrature to the integral, relative; 0 where there is none."""
        error = abs(self.recomputed - self.integrated) / self.size
        return error if error == error else 0.0


@dataclass(frozen=True)
class ResimulationCheck:
    """A phase integrated again with the solution's own control, each interval from its own state.

    What an interval misses is its defect. Integrated over the whole phase, an unstable system would
    make much of small defects, so that is told and not judged.

    Attributes
    ----------
    phase : str
    status : Status
        SOLVED, or FAILED where the integrator stopped.
    failure : str
        Why it stopped.
    error : what is judged: the defects, carried along by the dynamics but not amplified (their sum
        or ``open_loop_error``, whichever is smaller), relative to the largest magnitude of the
        state
    local_error : the largest defect, relative to the same
    open_loop_error : what one integration from the first state on would miss, to first order
    amplification : how far an error may have grown at the end of the phase, to first order: largest
        norm of the transition matrices to the end, of the states relative to their magnitudes
    state, component, time, value, wanted, unit : where the largest defect is, and both values
    """

    phase: str
    status: Status
    failure: str
    error: float
    local_error: float
    open_loop_error: float
    amplification: float
    state: str
    component: int
    time: float
    value: float
    wanted: float
    unit: str


@dataclass(frozen=True)
class OCPLimitUse:
    """Worst point of one bound or path constraint of a phase, on a dense grid.

    Attributes
    ----------
    phase, name, component : which
    kind : "state", "control", "algebraic", "constraint", "end constraint", "duration"
        or "table", of which it is the argument
    time, value, limit, unit : where it is nearest to (or farthest beyond) its limit
    excess : by how much the limit is exceeded, in the unit; 0 where it is kept
    relative : the excess divided by half the range, or by the limit where there is only one
    """

    phase: str
    name: str
    component: int
    kind: str
    time: float
    value: float
    limit: float
    unit: str
    excess: float
    relative: float


@dataclass(frozen=True)
class Residual:
    """One residual: its size in the scaled program, and in the unit of what it belongs to.

    Attributes
    ----------
    scaled : float
    value : in ``unit``
    unit : str
    where : the variable or row in words
    """

    scaled: float
    value: float
    unit: str
    where: str


@dataclass(frozen=True)
class Optimality:
    """Conditions of Karush, Kuhn and Tucker at the solution.

    Attributes
    ----------
    stationarity : ``grad f + J' lam_g + lam_x``, which is zero at an optimum
    feasibility : violation of a row or bound
    complementarity : multiplier times distance to its bound
    sign : multiplier that pushes towards a bound that is not there
    computed_bounds : whether the multipliers of the bounds are those of the solver (False), or were
        computed from the stationarity (True), which then says nothing of bounded variables
    gap : how much the cost may be above that of the local optimum beside it, in its unit
    """

    stationarity: Residual
    feasibility: Residual
    complementarity: Residual
    sign: Residual
    computed_bounds: bool
    gap: Gap


@dataclass(frozen=True, eq=False)
class Curvature:
    """The second-order condition at a solution.

    Attributes
    ----------
    least : least curvature of the Lagrangian along what keeps the limits that act, where it is
        negative: twice what the cost changes by, relative to it, where variables change by their
        scales in the mean; 0 at a minimum
    direction : the change of the scaled variables that it belongs to; None at a minimum
    """

    least: float
    direction: FloatArray | None

    @property
    def minimum(self) -> bool:
        """Whether the point is a minimum of second order."""
        return self.direction is None


@dataclass(frozen=True, eq=False)
class Costates:
    """Derivatives of the optimal cost with respect to the states of a phase.

    Attributes
    ----------
    phase : str
    t : times of the mesh points [N+1], s
    values : by the name of the state [N+1, size], just before the mesh point (after it at the
        first): where a bound of the state acts at a mesh point, the costate jumps there
    after : by the name of the state [N, size], just after the mesh points
    point_t, point_values : times [M] and values [M, size] at the collocation points
    """

    phase: str
    t: FloatArray
    values: Mapping[str, FloatArray]
    after: Mapping[str, FloatArray]
    point_t: FloatArray
    point_values: Mapping[str, FloatArray]

    def __getitem__(self, name: str) -> FloatArray:
        return checks.by_name("the costates", self.values, name)


@dataclass(frozen=True, eq=False)
class Hamiltonian:
    """``H = L + costate' f`` along a phase, averaged over every interval.

    Attributes
    ----------
    phase : str
    t : middles of the intervals [N], s
    values : averages over the intervals [N], as the derivative of the discrete Lagrangian with
        respect to the length of the interval. Where a control switches inside an interval the
        averages differ on its two sides, by a share of its length
    mean : over the phase
    drift : largest difference to the mean
    autonomous : whether the phase's expressions are free of the time, so that H should be constant
    expected : what its mean should be, by the transversality of the duration; None where the
        duration is fixed or at a bound, or appears in other expressions than end costs
    duration_price : derivative of the optimal cost with respect to the duration, 0 where it is free
    """

    phase: str
    t: FloatArray
    values: FloatArray
    mean: float
    drift: float
    autonomous: bool
    expected: float | None
    duration_price: float


@dataclass(frozen=True)
class Arc:
    """A stretch of time during which a limit acts.

    Attributes
    ----------
    phase, kind, name, component : which limit
    side : "lower" or "upper"
    start, end : s since the start of the phase
    price : what it would bring to relax the limit by one unit during the arc (cost per unit)
    unit : str
    """

    phase: str
    kind: str
    name: str
    component: int
    side: str
    start: float
    end: float
    price: float
    unit: str


@dataclass(frozen=True, eq=False)
class OCPCertificate:
    """What was checked of a solution, and the verdict.

    Attributes
    ----------
    problem : name of the problem
    ok : whether every check passed
    verdict : the result in words
    cost : the cost evaluated again
    resimulations : one check a phase
    limits : one entry for every component of every bound and path constraint
    optimality : Optimality
    curvature : of the second order; None where other checks failed
    costates, hamiltonians : one entry a phase
    arcs : which limit acts when
    thresholds : what still passes
    wall_time : what the certificate took, s
    """

    problem: str
    ok: bool
    verdict: str
    cost: CostCheck
    resimulations: tuple[ResimulationCheck, ...]
    limits: tuple[OCPLimitUse, ...]
    optimality: Optimality
    curvature: Curvature | None
    costates: tuple[Costates, ...]
    hamiltonians: tuple[Hamiltonian, ...]
    arcs: tuple[Arc, ...]
    thresholds: Thresholds
    wall_time: float

    def __repr__(self) -> str:
        return f"<OCPCertificate of {self.problem!r}: {'passed' if self.ok else 'FAILED'}>"

    def _repr_html_(self) -> str:
        return view_for(self, "table")(self)._repr_html_()

    def costate(self, phase: str) -> Costates:
        """Return costates of a phase by its name."""
        return next(c for c in self.costates if c.phase == phase)

    def hamiltonian(self, phase: str) -> Hamiltonian:
        """Return the Hamiltonian of a phase by its name."""
        return next(h for h in self.hamiltonians if h.phase == phase)

    @property
    def worst_limit(self) -> OCPLimitUse | None:
        """The limit that is exceeded most, relative; None where all are kept."""
        worst = max(self.limits, key=lambda use: use.relative, default=None)
        return worst if worst is not None and worst.excess > 0 else None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; what is not finite becomes None."""
        return plain(self)
