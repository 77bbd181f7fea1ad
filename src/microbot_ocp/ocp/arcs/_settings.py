"""What counts as a switch and as an arc."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DetectorSettings:
    """When a control or limit counts as active, and what happens within a few intervals.

    Attributes
    ----------
    at_bound : of a control's range: nearer to a bound it is at it
    at_end_of_ramp : the same of a continuous control, whose ramp ends where it is worth so little
        that a barrier keeps it farther away
    at_state_limit : of a state's range along the phase: nearer to a limit at both ends of an
        interval, it is active there
    at_mixed_limit : of its range: nearer to a limit that depends on controls it is active
    smeared : intervals over which a mesh may smear what happens at once
    negligible : of an interval: what is shorter is none
    """

    at_bound: float = 1e-3
    at_end_of_ramp: float = 1e-2
    at_state_limit: float = 3e-3
    at_mixed_limit: float = 2e-3
    smeared: int = 3
    negligible: float = 0.05


@dataclass(frozen=True)
class MeshPointSettings:
    """Mesh points at junctions and switches.

    Attributes
    ----------
    bracket : of the interval next to a switch: how near to it points are added
    ramp : of a ramp's length, that is left to each side of the switch
    """

    bracket: float = 0.1
    ramp: float = 0.125


DETECTOR = DetectorSettings()
MESH_POINTS = MeshPointSettings()
