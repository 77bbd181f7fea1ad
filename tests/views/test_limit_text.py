"""One text for a quantity at its limit in figures, tables and recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.planning.path import PathLimit
from microbot_ocp.views._scene import limit_text, limit_title
from microbot_ocp.views.plots._phase_plane import limit_name
from microbot_ocp.views.recording import of_motion
from microbot_ocp.views.tables._results import motion as motion_table
from views.test_curves import legend_texts


@pytest.mark.parametrize(
    ("side", "exceeded", "text"),
    [
        (1, False, "torque of elbow at its upper limit"),
        (-1, False, "torque of elbow at its lower limit"),
        (0, False, "torque of elbow at its limit"),
        (-1, True, "torque of elbow beyond its lower limit"),
    ],
)
def test_text_of_a_limit(side: int, exceeded: bool, text: str) -> None:
    assert limit_text("torque of elbow", side, exceeded) == text


def test_recordings_and_figures_say_the_same(microbot: mo.Robot) -> None:
    limited = microbot.with_limits(qd_max=0.6, tau_max=[400.0, 500.0, 300.0])
    shape = mo.cubic([[0, 0, 0], [-0.5, 1.0, 0.8]], [0.0, 1.0])
    motion = mo.Motion.from_polynomial(limited, shape, label="cubic")
    spells = of_motion(limited, motion).spells["motion"]
    lanes = {spell.text.replace("beyond", "at") for spell in spells}
    assert len(lanes) > 1
    chart = legend_texts(mo.plots.saturation({"cubic": motion}, robot=limited).figure)
    assert {text for text in lanes if "torque" in text} <= set(chart)
    for spell in spells:
        limit = PathLimit("tau" if "torque" in spell.text else "qd", spell.joint, spell.side)
        _, _, place = spell.text.partition(" its ")
        assert limit_name(limited, limit) == f"{spell.title} at its {place}"


@pytest.mark.parametrize(
    ("column", "title"),
    [
        ("tau_elbow", "torque of elbow"),
        ("taud_elbow", "torque rate of elbow"),
        ("qd_joint_1", "velocity of joint 1"),
        ("qddd_left_arm_j2", "jerk of left-arm/j2"),
        ("tool_speed", "tool speed"),
    ],
)
def test_title_of_a_column_of_a_sweep(column: str, title: str) -> None:
    assert limit_title(column, ["elbow", "joint 1", "left-arm/j2"]) == title


def test_a_table_of_a_motion_names_the_joints_of_a_known_robot(microbot: mo.Robot) -> None:
    shape = mo.cubic([[0, 0, 0], [-0.5, 1.0, 0.8]], [0.0, 1.0])
    motion = mo.Motion.from_polynomial(microbot, shape, label="cubic")
    named = replace(motion, provenance={"robot": "microbot"})
    assert [row[0] for row in motion_table(named).rows] == ["waist", "shoulder", "elbow"]
    for unknown in ({}, {"robot": "panda"}, {"robot": "mine"}, {"robot": None}):
        rows = motion_table(replace(motion, provenance=unknown)).rows
        np.testing.assert_array_equal([row[0] for row in rows], [1, 2, 3])
