"""Packaged robots, one TOML file each, and the readers of robot files."""

from microbot_ocp.robots.toml_file import load_robot, packaged_robots

__all__ = ["load_robot", "packaged_robots"]
