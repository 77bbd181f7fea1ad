"""How arcs are solved for, and when they count as solved."""

from __future__ import annotations

from dataclasses import dataclass

from microbot_ocp.ocp.transcription.schemes import Collocation


@dataclass(frozen=True)
class CutterSettings:
    """Phases that are made of arcs.

    Attributes
    ----------
    most_arcs : of a phase: a solution that chatters is not cut into pieces
    shortest : of the phase, that an arc may shrink to
    looser : of its range: a bound is by so much wider beside an arc on which an equation keeps it
    highest_order : of a limit of the states, whose derivative determines a control
    longest : times the duration of the whole phase that an arc may take
    """

    most_arcs: int = 12
    shortest: float = 1e-4
    looser: float = 1e-6
    highest_order: int = 3
    longest: float = 3.0

    @property
    def gone(self) -> float:
        """Of the phase: an arc that is no longer has shrunk to nothing."""
        return 2 * self.shortest


@dataclass(frozen=True)
class SwitchingTimeSettings:
    """The solves for switching times.

    Attributes
    ----------
    degree : of Radau collocation
    coarser : intervals of the mesh that an arc is read from, for one of its own
    least_intervals, most_intervals : of an arc at first: the order is high
    finest : intervals of an arc that is divided to keep a limit between its points
    costlier : ratio by which arcs may cost more than the solution that they are read from
    wrong_sign : of its largest: a multiplier of the wrong sign that is larger says that a switch is
        missing
    met : of its range: nearer to its limit a state is at it
    negligible, exceeded : of a limit: by more than the first it is exceeded between mesh points
        only where an arc gets no more intervals, by more than the second nowhere
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
    """Singular arcs by their own conditions.

    Attributes
    ----------
    least_intervals : of an arc at first
    rounds : of solves on finer meshes
    checked : times an arc at which signs and limits are looked at
    shortest : of the phase, that an arc may come to
    vanishing : of its largest value, that a switching function is where it must vanish
    violation : of their range or largest value: by which limits and signs may be missed
    at_end : of its range: a condition that is an inequality is met at the end
    agrees : of the cost, that it may differ by from that of the solution that is near
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
