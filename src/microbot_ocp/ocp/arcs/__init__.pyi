"""Public names, loaded on first use."""

from ._detector import (
    Activity as Activity,
    ArcPlan as ArcPlan,
    PlannedArc as PlannedArc,
    Sample as Sample,
    Signature as Signature,
    Switch as Switch,
    control_activities as control_activities,
    find_switches as find_switches,
    joined as joined,
    jumping as jumping,
    merged as merged,
    mixed_limits as mixed_limits,
    plan_of as plan_of,
)
from ._mesh_points import (
    hold as hold,
    move_to_switches as move_to_switches,
)
