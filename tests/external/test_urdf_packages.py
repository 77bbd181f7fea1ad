"""Every URDF file of three packages is read, its chains as pinocchio has them.

A chain of every fifth file; thorough tests take five, evenly spread, of all of them, and
``urdf_packages.py`` compares every one.
"""

from __future__ import annotations

import pytest

import microbot_ocp as mo

pytest.importorskip("pinocchio")
from external.urdf_packages import QUANTITIES, File, chains, files
from helpers import refused, sampled, tells

pytestmark = pytest.mark.slow

FILES = files()
MOVING = [file for file in FILES if file.joint_count]
RELATIVE = 1e-9

if not FILES:
    pytest.skip("no package with URDF files is installed", allow_module_level=True)


@pytest.mark.filterwarnings("ignore::microbot_ocp.robot.RobotFileWarning")
@pytest.mark.parametrize("most", [1, pytest.param(5, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("file", sampled(MOVING, 5), ids=lambda f: f.label)
def test_a_chain_is_the_one_of_pinocchio(file: File, most: int) -> None:
    done = list(chains(file, most))
    assert done
    for chain in done:
        for quantity, value in zip(QUANTITIES, chain.differences, strict=True):
            assert not value > RELATIVE, f"{quantity} of {chain.tip}"  # NaN: no masses
        assert all(file.path.name in text for text in chain.warnings)


@pytest.mark.filterwarnings("ignore::microbot_ocp.robot.RobotFileWarning")
@pytest.mark.parametrize("file", [f for f in FILES if not f.joint_count], ids=lambda f: f.label)
def test_what_has_no_moving_joint_is_refused_for_that(file: File) -> None:
    reason = "valid XML" if file.path.read_text() == "hello\n" else "no moving joint"
    with refused(file.path.name, reason):
        mo.robot.load_urdf(file.path)


@pytest.mark.filterwarnings("ignore::microbot_ocp.robot.RobotFileWarning")
@pytest.mark.parametrize("file", sampled(MOVING, 5), ids=lambda f: f.label)
def test_without_tip_a_file_is_one_arm_or_its_tips_are_listed(file: File) -> None:
    refusal = ""
    try:
        robot = mo.robot.load_urdf(file.path)
    except mo.InputError as problem:
        refusal = str(problem)
    else:
        assert robot.joint_count > 1
    if refusal:
        tells(refusal, file.path.name, "branches", "tip")
        assert len(file.tips) > 1
        assert any(repr(tip) in refusal for tip in file.tips)


@pytest.mark.filterwarnings("ignore::microbot_ocp.robot.RobotFileWarning")
@pytest.mark.parametrize("file", sampled(MOVING, 5), ids=lambda f: f.label)
def test_no_limit_of_a_file_leaves_no_room(file: File) -> None:
    limits = mo.robot.load_urdf(file.path, file.tips[0]).limits
    assert all((limits.bounds(key)[1] > 0).all() for key in ("qd", "qdd", "tau"))
