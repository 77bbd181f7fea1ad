"""Result types of a certificate: plain data without computation."""

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
    """Largest residuals with which a solution still passes.

    Attributes
    ----------
    cost : error of the cost as given, relative to the sum of the magnitudes of its terms
    gap : cost above the local optimum, relative to the size of the cost; half of the negative
        curvature allowed
    state_error : sum of the defects of the re-simulation, relative to the largest magnitude of the
        state; also the error of the re-integrated cost, relative to its size
    excess : excess over a limit between mesh points, relative to the limit
    feasibility : violation of a row or bound of the scaled program
    stationarity, complementarity, sign : residuals of the scaled program, divided by
        ``max(100, mean of |multipliers|) / 100`` (Waechter and Biegler, 2006, equation 6)
    """

    cost: float = 1e-6
    gap: float = 1e-5
    state_error: float = 1e-3
    excess: float = 1e-3
    feasibility: float = 1e-6
    stationarity: float = 1e-5
    complementarity: float = stationarity
    sign: float = stationarity


@dataclass(frozen=True)
class CostCheck:
    """The cost evaluated again from its declared expressions.

    Attributes
    ----------
    given : cost stored in the solution
    recomputed : cost by the quadrature of the scheme
    integrated : cost with the running costs integrated along the dynamics, each interval from its
        own mesh state; NaN if the integrator failed
    size : sum of the magnitudes of the terms of the cost
    """

    given: float
    recomputed: float
    integrated: float
    size: float

    @property
    def error(self) -> float:
        """Difference of the given to the recomputed cost, relative to its size."""
        return abs(self.given - self.recomputed) / self.size

    @property
    def integration_error(self) -> float:
        """Relative difference of quadrature and integral; 0 if there is no integral."""
        error = abs(self.recomputed - self.integrated) / self.size
        return error if error == error else 0.0


@dataclass(frozen=True)
class ResimulationCheck:
    """A phase integrated again with the solution's own control, each interval from its own state.

    The defect of an interval is the integrated state at its end minus the next mesh state. An
    unstable system amplifies small defects over a whole phase; the amplification is reported, not
    judged.

    Attributes
    ----------
    phase : str
    status : Status
        SOLVED, or FAILED if the integrator failed.
    failure : str
        Message of the integrator; empty if it succeeded.
    error : judged error, relative to the largest magnitude of the state: the smaller of the sum of
        the defects and ``open_loop_error``
    local_error : largest defect, relative to the largest magnitude of the state
    open_loop_error : first-order error of one integration from the first state, relative to the
        largest magnitude of the state
    amplification : largest norm of a transition matrix from a mesh point to the end of the phase,
        states relative to their magnitudes: growth of an error, to first order
    state, component : state with the largest defect
    time : time of that mesh point, s
    value, wanted, unit : integrated state and mesh state there
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
    phase, name, component : identity of the limited quantity
    kind : "state", "control", "algebraic", "constraint", "end constraint", "duration" or "table"
        (the argument at which a table is read)
    time : time at which the quantity is nearest to its limit, or farthest beyond it, s
    value, limit, unit : value and limit at that time
    excess : amount beyond the limit, in ``unit``; 0 if the limit is kept
    relative : excess divided by half the range, or by the limit if there is only one
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
    """Largest residual of one optimality condition.

    Attributes
    ----------
    scaled : residual in the scaled program
    value : residual in ``unit``
    unit : str
    where : name of the variable or row
    """

    scaled: float
    value: float
    unit: str
    where: str


@dataclass(frozen=True)
class Optimality:
    """Karush-Kuhn-Tucker conditions at the solution.

    Attributes
    ----------
    stationarity : ``grad f + J' lam_g + lam_x``, which is zero at an optimum
    feasibility : violation of a row or bound
    complementarity : product of multiplier and distance to the bound
    sign : multiplier of a bound that does not exist
    computed_bounds : False if the solver returned the multipliers of the bounds, True if they were
        computed from the stationarity, which proves nothing for bounded variables in this case
    gap : estimate of the cost above the nearby local optimum, in the unit of the cost
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
    least : least curvature of the Lagrangian along directions that keep the active limits, if
        negative: twice the relative change of the cost where variables change by their scales in
        the root mean square; 0 at a minimum
    direction : direction of least curvature in the scaled variables; None at a minimum
    """

    least: float
    direction: FloatArray | None

    @property
    def minimum(self) -> bool:
        """True if the point is a minimum of second order."""
        return self.direction is None


@dataclass(frozen=True, eq=False)
class Costates:
    """Derivatives of the optimal cost with respect to the states of a phase.

    Attributes
    ----------
    phase : str
    t : times of the mesh points [N+1], s
    values : costates by state name [N+1, size], just before the mesh points (just after the
        first): the costate jumps at a mesh point where a bound of the state is active
    after : costates by state name [N, size], just after the mesh points
    point_t : times of the collocation points [M], s
    point_values : costates by state name [M, size] at the collocation points
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
    t : midpoints of the intervals [N], s
    values : averages over the intervals [N]: derivative of the discrete Lagrangian with respect to
        the length of the interval. If a control switches inside an interval, the averages on its
        two sides differ in proportion to the length of the interval
    mean : average over the phase
    drift : largest deviation from the mean
    autonomous : True if the expressions of the phase do not depend on time, so that H is constant
    expected : mean required by the transversality condition of the duration; None if the duration
        is fixed, is at a bound, or appears in expressions other than end costs
    duration_price : derivative of the optimal cost with respect to the duration; 0 if it is free
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
    """An interval of time during which a limit is active.

    Attributes
    ----------
    phase, kind, name, component : identity of the limited quantity
    side : "lower" or "upper"
    start, end : times since the start of the phase, s
    price : decrease of the cost if the limit is relaxed by one unit during the arc
    unit : unit of the limited quantity
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
    """Verdict on a solution, and the results of every check.

    Attributes
    ----------
    problem : name of the problem
    ok : True if every check passed
    verdict : verdict in words
    cost : recomputed cost
    resimulations : one check per phase
    limits : one entry per component of every bound and path constraint
    optimality : Optimality
    curvature : second-order condition; None if other checks failed
    costates, hamiltonians : one entry per phase
    arcs : intervals during which a limit is active
    thresholds : largest residuals that pass
    wall_time : wall time of the verification, s
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
        """Return the costates of a phase by its name."""
        return next(c for c in self.costates if c.phase == phase)

    def hamiltonian(self, phase: str) -> Hamiltonian:
        """Return the Hamiltonian of a phase by its name."""
        return next(h for h in self.hamiltonians if h.phase == phase)

    @property
    def worst_limit(self) -> OCPLimitUse | None:
        """The limit with the largest relative excess; None if all limits are kept."""
        worst = max(self.limits, key=lambda use: use.relative, default=None)
        return worst if worst is not None and worst.excess > 0 else None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON; infinite values and NaN become None."""
        return plain(self)
