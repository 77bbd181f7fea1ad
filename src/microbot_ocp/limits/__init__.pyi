"""Public names, loaded on first use."""

from ._family import (
    LimitFamily as LimitFamily,
    LimitValues as LimitValues,
    Member as Member,
    MotionSamples as MotionSamples,
    not_judged as not_judged,
)
from ._history import (
    JUMP_TIME as JUMP_TIME,
    LimitHistory as LimitHistory,
    Peak as Peak,
    Spell as Spell,
    StateHistory as StateHistory,
    jumps_between as jumps_between,
    jumps_of as jumps_of,
    largest_jump as largest_jump,
    largest_use as largest_use,
    limit_history as limit_history,
    orders_of as orders_of,
    samples_of as samples_of,
)
from ._joint_limits import (
    JOINT_QUANTITIES as JOINT_QUANTITIES,
    JointLimits as JointLimits,
    LimitArgument as LimitArgument,
    LimitChanges as LimitChanges,
    Limits as Limits,
    quantity_name as quantity_name,
    with_reserve as with_reserve,
)
from ._limit import (
    MEMBER_KEYS as MEMBER_KEYS,
    MEMBERS as MEMBERS,
    Limit as Limit,
    changes_by_name as changes_by_name,
    limits_from_table as limits_from_table,
    limits_to_table as limits_to_table,
    power as power,
    rms_torque as rms_torque,
    tool_acceleration as tool_acceleration,
    tool_jerk as tool_jerk,
    tool_speed as tool_speed,
    total_power as total_power,
)
from ._use import (
    AT_LIMIT as AT_LIMIT,
    LIMIT_TOLERANCE as LIMIT_TOLERANCE,
    ROUNDING as ROUNDING,
    use_of as use_of,
)
