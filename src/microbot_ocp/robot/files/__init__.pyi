"""Public names, loaded on first use."""

from ._library import (
    is_robot_name as is_robot_name,
    load_robot as load_robot,
    packaged_robots as packaged_robots,
    robot_text as robot_text,
    save_robot as save_robot,
)
from ._mjcf import (
    load_mjcf as load_mjcf,
)
from ._toml import (
    parse_robot as parse_robot,
    robot_to_toml as robot_to_toml,
)
from ._urdf_reader import (
    load_urdf as load_urdf,
    parse_urdf as parse_urdf,
    read_urdf_shapes as read_urdf_shapes,
)
from ._urdf_writer import (
    robot_to_urdf as robot_to_urdf,
)
from ._xml import (
    RobotFileWarning as RobotFileWarning,
)
