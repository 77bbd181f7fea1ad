"""Public names, loaded on first use."""

from ._comparison import (
    comparison_rows as comparison_rows,
    comparison_table as comparison_table,
    narrow_table as narrow_table,
    write_csv as write_csv,
    write_json as write_json,
)
from ._terminal import (
    front_blocks as front_blocks,
    in_degrees as in_degrees,
    joint_units as joint_units,
    number as number,
    point_text as point_text,
    pose_text as pose_text,
    robot_blocks as robot_blocks,
    solutions_table as solutions_table,
    span as span,
    use_blocks as use_blocks,
)
