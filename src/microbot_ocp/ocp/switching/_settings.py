"""Settings of the solves in arcs and thresholds of their acceptance."""

from __future__ import annotations

from dataclasses import dataclass

from microbot_ocp.ocp.transcription.schemes import Collocation


@dataclass(frozen=True)
class CutterSettings:
    """Phases that are divided into arcs.

    Attributes
    ----------
    most_arcs : largest number of arcs in a phase; a chattering solution is not divided
    shortest : least length of an arc, as a fraction of the phase
    bound_margin : widening of a bound next to an arc on which an equation holds it, relative to its
        range
    highest_order : highest time derivative of a state limit that is searched for a control
    longest : largest length of an arc, as a multiple of the duration of the phase
    """

    most_arcs: int = 12
    shortest: float = 1e-4
    bound_margin: float = 1e-6
    highest_order: int = 3
    longest: float = 3.0

    @property
    def vanished(self) -> float:
        """Length, as a fraction of the phase, below which an arc counts as vanished."""
        return 2 * self.shortest


@dataclass(frozen=True)
class SwitchingTimeSettings:
    """Solves for switching times.

    Attributes
    ----------
    degree : degree of Radau collocation
    coarser : intervals of the detected arc per interval of the first mesh of the arc
    least_intervals, most_intervals : range of intervals of an arc on its first mesh
    finest : intervals of an arc above which excess between mesh points no longer refines it
    costlier : cost above that of the detected solution that is accepted, relative to that cost
    wrong_sign : magnitude above which a multiplier of the wrong sign indicates a missing switch,
        relative to its largest magnitude
    met : distance to a limit below which a state is at it, relative to its range
    negligible : relative excess between mesh points above which an arc is refined
    exceeded : relative excess between mesh points above which a solution is rejected
    """

    degree: int = 5
    coarser: int = 3
    least_intervals: int = 2
    most_intervals: int = 8
    finest: int = 64
    costlier: float = 1e-3
    wrong_sign: float = 1e-3
    met: float = 1e-5
    negligible: float = 1e-8
    exceeded: float = 1e-4


@dataclass(frozen=True)
class SingularSettings:
    """Singular arcs solved by optimality conditions.

    Attributes
    ----------
    least_intervals : least number of intervals of an arc on its first mesh
    rounds : number of solves, each on a finer mesh
    checked : number of times per arc at which signs and limits are checked
    shortest : least length of an arc, as a fraction of the phase
    vanishing : magnitude of a switching function that counts as zero, relative to its largest one
    violation : accepted violation of limits and signs, relative to the range or largest value
    at_end : distance to a bound below which an end condition is active, relative to its range
    agrees : accepted difference to the cost of the nearby solution, relative to that cost
    """

    least_intervals: int = 4
    rounds: int = 6
    checked: int = 200
    shortest: float = 1e-6
    vanishing: float = 1e-9
    violation: float = 1e-6
    at_end: float = 1e-6
    agrees: float = 1e-2


CUTTER = CutterSettings()
SWITCHING = SwitchingTimeSettings()
SINGULAR = SingularSettings()
HIGH_ORDER = Collocation("radau", SWITCHING.degree)
