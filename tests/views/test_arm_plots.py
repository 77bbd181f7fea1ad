import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.views.arm_plots import arms_figure


def test_every_arm_ends_where_forward_kinematics_puts_its_tool():
    robot = mo.load_robot("microbot")
    poses = {"out": [0.0, 0.0, 0.0], "up": [0.3, 1.0, -0.4]}
    axes = arms_figure(robot, poses, target=[7.0, 0.0, 2.0]).axes[0]
    *arms, target = axes.lines
    assert [line.get_label() for line in arms] == list(poses)
    for line, q in zip(arms, poses.values(), strict=True):
        tool = mo.forward_kinematics(robot)(q).full()[:3, 3]
        assert np.array(line.get_data_3d())[:, -1] == pytest.approx(tool)
    assert np.ravel(target.get_data_3d()).tolist() == [7.0, 0.0, 2.0]


def test_a_notebook_shows_a_figure_by_itself():
    figure = arms_figure(mo.load_robot("planar_2r"), {"q": [0.1, 0.2]})
    assert figure._repr_png_().startswith(b"\x89PNG")  # pyright: ignore


@pytest.mark.parametrize("poses", [{}, {"q": [0.0, 0.0]}, {"q": [0.0, np.nan, 0.0]}])
def test_bad_poses_are_refused(poses):
    with pytest.raises(mo.InputError, match="pose"):
        arms_figure(mo.load_robot("microbot"), poses)
