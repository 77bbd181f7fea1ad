import numpy as np
import pytest
from matplotlib.figure import Figure

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.views.plots import arms


def test_every_arm_ends_where_forward_kinematics_puts_its_tool():
    robot = mo.load_robot("microbot")
    poses = {"out": [0.0, 0.0, 0.0], "up": [0.3, 1.0, -0.4]}
    axes = arms(robot, poses, target=[7.0, 0.0, 2.0])
    *drawn, target = axes.lines
    assert [line.get_label() for line in drawn] == list(poses)
    for line, q in zip(drawn, poses.values(), strict=True):
        tool = mo.forward_kinematics(robot)(q).full()[:3, 3]
        assert np.array(line.get_data_3d())[:, -1] == pytest.approx(tool)
    assert np.ravel(target.get_data_3d()).tolist() == [7.0, 0.0, 2.0]


def test_a_notebook_shows_a_figure_by_itself():
    axes = arms(mo.load_robot("planar_2r"), {"q": [0.1, 0.2]})
    assert axes._repr_png_().startswith(b"\x89PNG")  # pyright: ignore


@pytest.mark.parametrize(
    ("poses", "said"),
    [
        ({}, ("poses", "one")),
        ({"q": [0.0, 0.0]}, ("pose 'q'", "shape [3]", "[2]")),
        ({"q": [0.0, np.nan, 0.0]}, ("pose 'q'", "finite", "[1] is nan rad")),
    ],
)
def test_bad_poses_are_refused(poses, said):
    with refused(*said):
        arms(mo.load_robot("microbot"), poses)


def test_flat_axes_are_refused():
    with refused("axes", "3d"):
        arms(mo.load_robot("planar_2r"), {"q": [0.1, 0.2]}, Figure().subplots())
