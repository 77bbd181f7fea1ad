"""Packaged robots, one TOML file each, and the readers and writers of robot files."""

from microbot_ocp.robots.library import load_robot, packaged_robots
from microbot_ocp.robots.toml_file import write_toml
from microbot_ocp.robots.urdf_reader import read_urdf
from microbot_ocp.robots.urdf_writer import write_urdf

__all__ = ["load_robot", "packaged_robots", "read_urdf", "write_toml", "write_urdf"]
