"""Forces and ties of MJCF files: read, or left out by name, against MuJoCo's inverse dynamics."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import batch, difference, refused
from microbot_ocp.robot import RobotFileWarning

mujoco = pytest.importorskip("mujoco")

GEOM = '<geom type="capsule" fromto="0 0 0 .3 .1 0" size=".04"/>'


def arm(
    *, option: str = "", body: str = "", joint: str = "", more: str = "", tail: str = "",
    kinds: tuple[str, ...] = ("hinge", "slide", "hinge"),
) -> str:  # fmt: skip
    """Joints a, b, c; attributes of body b and joint b, and elements beside the world's body."""
    text, end = f'<mujoco model="m">{option}<worldbody>', ""
    for name, kind, axis in zip("abc", kinds, ("0 1 0", "1 0 .2", "0 .3 1"), strict=True):
        at = f'{body}><joint name="{name}" {joint}' if name == "b" else f'><joint name="{name}"'
        text += f'<body name="{name}" pos=".3 0 .1" {at} type="{kind}" axis="{axis}"/>{GEOM}'
        end += "</body>"
    return f'{text}<site name="tool" pos=".3 0 0"/>{tail}{end}</worldbody>{more}</mujoco>'


def fixed(*coefs: tuple[str, float], name: str = "t", extra: str = "") -> str:
    joints = "".join(f'<joint joint="{joint}" coef="{value}"/>' for joint, value in coefs)
    return f'<fixed name="{name}" {extra}>{joints}</fixed>'


def tendon(extra: str) -> str:
    return f"<tendon>{fixed(('a', 1.0), ('b', -2.0), extra=extra)}</tendon>"


def loaded(folder: Path, text: str) -> tuple[mo.Robot, list[str]]:
    path = folder / "arm.xml"
    path.write_text(text)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        robot = mo.robot.load_mjcf(path, "tool")
    return robot, [str(w.message) for w in caught if w.category is RobotFileWarning]


LEFT_OUT = {
    "spring of a joint": ({"joint": 'stiffness="9" springref="10"'}, "'b'"),
    "cubic spring": ({"joint": 'stiffness="0 0 9"'}, "'b'"),
    "damping by the square": ({"joint": 'damping="1 3"'}, "'b'"),
    "spring of a tendon": ({"more": tendon('stiffness="30"')}, "'t'"),
    "damping of a tendon": ({"more": tendon('damping="3"')}, "'t'"),
    "friction of a tendon": ({"more": tendon('frictionloss="3"')}, "'t'"),
    "inertia of a tendon": ({"more": tendon('armature="3"')}, "'t'"),
    "range of a tendon": ({"more": tendon('range="-1 1" limited="true"')}, "'t'"),
    "gravity compensated": ({"body": 'gravcomp="1"'}, "'b'"),
    "water": ({"option": '<option density="1000"/>'}, "water"),
    "viscosity": ({"option": '<option viscosity="1"/>'}, "water"),
    "loop": (
        {
            "more": '<equality><connect name="loop" body1="c" body2="world" anchor="0 0 0"/>'
            "</equality>"
        },
        "'loop'",
    ),
    "weld": ({"more": '<equality><weld name="w" body1="c"/></equality>'}, "'w'"),
    "three joints": (
        {
            "more": f"<tendon>{fixed(('a', 1.0), ('b', 1.0), ('c', 1.0))}</tendon>"
            '<equality><tendon name="tie" tendon1="t"/></equality>'
        },
        "'tie'",
    ),
    "spring of an actuator": (
        {
            "more": '<actuator><general name="m" joint="a" gainprm="0" biastype="affine" '
            'biasprm="0 -90 -9"/></actuator>'
        },
        "'m'",
    ),
    "actuator of a tendon": (
        {"more": tendon("") + '<actuator><motor name="m" tendon="t" ctrlrange="-1 1"/></actuator>'},
        "'m'",
    ),
    "spatial tendon": (
        {
            "tail": '<site name="s1"/>',
            "more": '<tendon><spatial name="band" stiffness="50" springlength="0.1"><site '
            'site="s1"/><site site="s0"/></spatial></tendon>',
        },
        "'band'",
    ),
}


@pytest.mark.parametrize("case", LEFT_OUT)
def test_forces_that_a_chain_has_not_are_left_out_by_name(case: str, tmp_path: Path) -> None:
    given, name = LEFT_OUT[case]
    text = arm(**given).replace("<worldbody>", '<worldbody><site name="s0" pos="0 .4 .2"/>')
    plain, silence = loaded(tmp_path, arm())
    robot, remarks = loaded(tmp_path, text)
    assert not silence
    (remark,) = remarks
    assert name in remark
    if "damping" not in given.get("joint", ""):
        assert robot == plain


HARMLESS = {
    "contacts": {"more": '<contact><exclude body1="a" body2="c"/></contact>'},
    "key": {"more": '<keyframe><key qpos="1 .1 1" qvel="1 1 1"/></keyframe>'},
    "margin": {"joint": 'margin="0.1" range="-.1 .1"'},
    "inactive": {"more": '<equality><weld body1="c" active="false"/></equality>'},
    "motor": {"more": '<actuator><position joint="b" kp="9" kv="2"/></actuator>'},
    "switched off": {
        "option": '<option><flag spring="disable"/></option>', "joint": 'stiffness="9"'
    },
    "beside": {
        "tail": '</body></body></body><body pos="3 0 0" gravcomp="1">'
        f'<joint name="z" stiffness="9"/>{GEOM}<body><body>'
    },
}  # fmt: skip


@pytest.mark.parametrize("case", HARMLESS)
def test_parts_that_the_arm_does_not_feel_are_not_remarked_on(case: str, tmp_path: Path) -> None:
    assert loaded(tmp_path, arm(**HARMLESS[case]))[1] == []


def test_inertia_and_damping_of_actuators_are_those_of_their_joint(tmp_path: Path) -> None:
    motor = '<actuator><motor joint="a" gear="3" armature=".2" damping=".4"/></actuator>'
    robot, remarks = loaded(tmp_path, arm(more=motor))
    assert not remarks  # MuJoCo has the same torques
    assert robot.links[0].armature == pytest.approx(9 * 0.2)
    assert robot.links[0].viscous_friction == pytest.approx(9 * 0.4)


def test_friction_and_damping_that_are_switched_off_are_off(tmp_path: Path) -> None:
    off = '<option><flag damper="disable" frictionloss="disable" limit="disable"/></option>'
    held = 'damping="3" frictionloss="2" range="-.1 .1"'
    robot, remarks = loaded(tmp_path, arm(option=off, joint=held))
    assert not remarks
    assert (robot.links[1].viscous_friction, robot.links[1].coulomb_friction) == (0.0, 0.0)
    assert np.isinf(robot.limits.q_max).all()


POLY = '<equality><joint joint1="{}" joint2="{}" polycoef="{}"/></equality>'
TIED = {
    "follower outside": (POLY.format("c", "a", "0.3 -1.5 0 0 0"), {"c": ("a", -1.5, 0.3)}),
    "follower inside": (POLY.format("a", "c", "-0.1 0.5 0 0 0"), {"a": ("c", 0.5, -0.1)}),
    "slide": (POLY.format("b", "a", "0.1 0.2 0 0 0"), {"b": ("a", 0.2, 0.1)}),
    "of followers": (
        POLY.format("b", "a", "0 2 0 0 0") + POLY.format("c", "b", "0.1 -1 0 0 0"),
        {"b": ("a", 2.0, 0.0), "c": ("a", -2.0, 0.1)},
    ),
    "tendon": (
        f"<tendon>{fixed(('a', 2.0), ('c', 4.0))}</tendon>"
        '<equality><tendon tendon1="t" polycoef="0.2 0 0 0 0"/></equality>',
        {"a": ("c", -2.0, 0.1)},
    ),
    "two tendons": (
        f"<tendon>{fixed(('a', 2.0))}{fixed(('c', 3.0), name='u')}</tendon>"
        '<equality><tendon tendon1="t" tendon2="u" polycoef="0.4 0.5 0 0 0"/></equality>',
        {"a": ("c", 0.75, 0.2)},
    ),
}


@pytest.mark.parametrize("case", TIED)
@pytest.mark.parametrize("reference", ["", 'ref="0.15"'])
def test_ties_with_a_factor_are_followed(case: str, reference: str, tmp_path: Path) -> None:
    text, mimic = TIED[case]
    robot, remarks = loaded(tmp_path, arm(more=text, joint=reference))
    assert not remarks  # MuJoCo has the same torques, and no force of the tie
    if not reference:
        assert robot.mimic.keys() == mimic.keys()
        for name, (driver, *numbers) in mimic.items():
            assert robot.mimic[name][0] == driver
            assert robot.mimic[name][1:] == pytest.approx(numbers)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    states = np.random.default_rng(1).uniform(-1, 1, (3, 10, robot.joint_count))
    matrix, tau, places = robot.transmission, [], []
    for q, qd, qdd in zip(*states, strict=True):
        data.qpos[:] = robot.chain_positions(q)
        data.qvel[:], data.qacc[:] = matrix @ qd, matrix @ qdd
        mujoco.mj_inverse(model, data)
        violated = data.efc_pos[: data.ne]
        assert np.abs(violated).max() < 1e-14
        tau.append(matrix.T @ data.qfrc_inverse)
        places.append(data.site("tool").xpos.copy())
    ours = batch(mo.inverse_dynamics(robot), *states).reshape(states[0].shape)
    assert difference(ours, np.array(tau)) < 1e-11
    poses = batch(mo.forward_kinematics(robot), states[0])
    assert difference(poses[:, :3, 3], np.array(places)) < 1e-12


def test_a_joint_that_is_tied_alone_stands_still(tmp_path: Path) -> None:
    tie = '<equality><joint joint1="b" polycoef="0.2 0 0 0 0"/></equality>'
    robot, remarks = loaded(tmp_path, arm(more=tie, joint='ref="0.1"'))
    assert not remarks
    assert robot.joint_names == ("a", "c")
    free, _ = loaded(tmp_path, arm(joint='ref="0.1"'))
    ours = np.array(mo.forward_kinematics(robot)([0.3, -0.4]))
    theirs = np.array(mo.forward_kinematics(free)([0.3, 0.3, -0.4]))
    assert difference(ours, theirs) < 1e-12


def test_actuators_of_joints_that_follow_act_on_the_one_that_they_follow(tmp_path: Path) -> None:
    motors = '<actuator><motor joint="c" ctrlrange="-4 6"/><motor joint="a" ctrlrange="-1 1"/>'
    motors += "</actuator>"
    robot, _ = loaded(tmp_path, arm(more=TIED["follower outside"][0] + motors))
    assert robot.joint_names == ("a", "b")
    assert (robot.limits.tau_min[0], robot.limits.tau_max[0]) == (-1 - 9, 1 + 6)
    assert np.isinf(robot.limits.tau_max[1])


@pytest.mark.parametrize(
    "tie",
    [
        POLY.format("c", "a", "0 1 0.5 0 0"),
        POLY.format("a", "c", "0 0 0 0 1"),
        f"<tendon>{fixed(('a', 2.0), ('c', 4.0))}{fixed(('b', 1.0), name='u')}</tendon>"
        '<equality><tendon tendon1="t" tendon2="u" polycoef="0 1 0 2 0"/></equality>',
    ],
)
def test_ties_that_are_not_linear_are_refused(tie: str, tmp_path: Path) -> None:
    with refused("arm.xml", "polynomial", "1:"):
        loaded(tmp_path, arm(more=tie))
