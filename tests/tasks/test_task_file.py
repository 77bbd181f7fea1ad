"""Task files: the documented example, the units, and what an error tells."""

import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp._base.schema import Key, keys_of
from microbot_ocp.robot.files import _toml
from microbot_ocp.scene import _scene_file, with_arm_capsules
from microbot_ocp.scene._obstacles import KINDS
from microbot_ocp.sweeps import _study
from microbot_ocp.tasks import (
    OUTPUTS,
    _cell_file,
    _task_file,
    is_cell_file,
    read_cell,
    read_task,
)

ROOT = Path(__file__).parents[2]
DOCUMENT = ROOT / "docs" / "task_file.md"
VIA = "[via]\nq_deg = [[0, 0, 0], [-90, 90, 90]]\n"
TASK = f'schema = 1\nrobot = "microbot"\n{VIA}'


def example():
    return re.search(r"```toml\n(.*?)```", DOCUMENT.read_text("utf-8"), re.S).group(1)


def parse(text):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "task.toml"
        file.write_text(text, "utf-8")
        return read_task(file)


@pytest.mark.thorough
def test_the_example_of_the_document():
    assert (ROOT / "problems" / "report.toml").read_text("utf-8") == example()
    task = parse(example())
    assert task.robot == mo.load_robot("microbot")
    np.testing.assert_allclose(np.degrees(task.via_q[1]), [-8, 45, 30])
    np.testing.assert_allclose(np.degrees(task.via_qd[1]), [10, 40, 20])
    assert task.via_t.tolist() == [0, 2, 4]
    assert task.limits.tau_max.tolist() == [400, 500, 200]
    np.testing.assert_allclose(np.degrees(task.limits.q_max), 180)
    np.testing.assert_allclose(np.degrees(task.limits.q_min), -360)
    assert task.outputs == ("json", "csv", "motions")
    result = task.compare()
    assert [entry.name for entry in result.entries] == list(task.methods)
    assert result.solved
    assert result["time_optimal"].motion.duration == pytest.approx(1.923, abs=0.01)


def of_kinds(schemas):
    return [{"kind": Key(choices=schemas)}, *schemas.values()]


@pytest.mark.parametrize(
    ("page", "schemas"),
    [
        ("task_file.md", [_task_file.TASK, _task_file.VIA, _task_file.LIMITS, _task_file.SETTINGS]),
        ("task_file.md", [_task_file.CELL, _cell_file.STOP, _cell_file.CAPSULE]),
        ("task_file.md", of_kinds(_cell_file.FRONT)),
        ("task_file.md", [_cell_file.PAYLOAD, keys_of(mo.Circle), keys_of(mo.JointLine)]),
        ("how-to/robot_from_toml.md", [_toml.ROBOT, _toml.JOINT, _toml.PLACEMENT]),
        ("how-to/robot_from_toml.md", [_toml.ROTOR, _toml.SHAPE]),
        ("how-to/sweeps.md", [_study.STUDY, *of_kinds(_study.CASES), _study.RANGE]),
        ("how-to/obstacles.md", [_scene_file.SCENE, *map(_scene_file._schema, KINDS)]),
    ],
)
def test_the_document_names_every_key(page, schemas):
    text = (ROOT / "docs" / page).read_text("utf-8")
    words = {key for schema in schemas for key in schema}
    words |= {word for schema in schemas for key in schema.values() for word in key.choices}
    for word in words:
        assert re.search(rf"\b{word}\b", text), word
    if page == "task_file.md":
        for name in (*mo.tasks.METHODS, *OUTPUTS):
            assert f"`{name}`" in text


def test_what_is_not_given_is_left_to_the_robot_and_to_compare():
    task = parse(TASK)
    assert task.methods is None
    assert task.via_t is None
    assert task.via_qd is None
    assert task.outputs == OUTPUTS
    assert task.settings == {}
    assert task.limits.as_dict() == task.robot.limits.as_dict()


def test_prismatic_joints_are_in_metres_under_degrees_too():
    rows = "[[0, 0, 0.5, 0, 0, 0], [90, 0, 0.7, 0, 0, 0]]"
    task = parse(f'schema = 1\nrobot = "stanford"\n[via]\nq_deg = {rows}\n')
    np.testing.assert_allclose(task.via_q[1], [np.pi / 2, 0, 0.7, 0, 0, 0])


def test_a_robot_file_is_sought_beside_the_task(tmp_path):
    mo.save_robot(mo.load_robot("microbot"), tmp_path / "arm.toml")
    (tmp_path / "task.toml").write_text(TASK.replace("microbot", "arm.toml"))
    assert read_task(tmp_path / "task.toml").robot == mo.load_robot("microbot")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("schema = 1 2", ["valid TOML", "line 1, column 12"]),
        (TASK.replace("schema = 1\n", ""), ["schema", "schema = 1", "missing"]),
        (TASK.replace("schema = 1", "schema = 2"), ["schema", "1", "not 2"]),
        (TASK.replace("schema = 1", "schema = true"), ["schema", "1", "not True"]),
        ("schema = 1\n" + VIA, ["robot", ".toml", "microbot", "missing"]),
        (TASK.replace('"microbot"', "7"), ["robot", ".toml", "not 7"]),
        (TASK.replace("microbot", "robbie"), ["robot", ".toml", "robbie"]),
        (TASK.replace("microbot", "none.toml"), ["robot file", "none.toml", "read"]),
        ('method = ["cubic"]\n' + TASK, ["'method'", "'methods'", "outputs"]),
        ('schema = 1\nrobot = "microbot"\n[[stops]]\nq = [0]', ["'stops'", "'stop'", "segment"]),
        ('methods = "cubic"\n' + TASK, ["methods", "list", "'cubic'"]),
        ('methods = ["cubc"]\n' + TASK, ["methods", "'cubc'", "'cubic'", "lspb"]),
        ('methods = ["cubic", "cubic"]\n' + TASK, ["methods", "different", "['cubic', 'cubic']"]),
        ('methods = ["cubic_report"]\n' + TASK, ["cubic_report", "via.t"]),
        ('outputs = ["svg"]\n' + TASK, ["outputs", "'svg'", "figures"]),
        ('schema = 1\nrobot = "microbot"', ["[via]", "missing"]),
        ('schema = 1\nrobot = "microbot"\nvia = 3', ["via", "table", "not 3"]),
        ('schema = 1\nrobot = "microbot"\n[via]\nt = [0, 1]', ["via.q", "missing"]),
        (TASK + "q = [[0, 0, 0], [1, 1, 1]]", ["via.q", "twice", "q or q_deg"]),
        (TASK.replace("[-90, 90, 90]", "[1, 2]"), ["via.q_deg", "waist", "row 2", "[1, 2]"]),
        (TASK.replace("[-90, 90, 90]", '[1, 2, "3"]'), ["via.q_deg", "numbers", "'3'"]),
        (TASK.replace("[-90, 90, 90]", "[1, 2, nan]"), ["via.q_deg", "finite", "[1, 2] is nan"]),
        (
            TASK.replace("[[0, 0, 0], [-90, 90, 90]]", "[0, 0, 0]"),
            ["via.q_deg", "rows", "[0, 0, 0]"],
        ),
        (TASK.replace(", [-90, 90, 90]", ""), ["via.q", "2 rows", "not 1"]),
        (TASK + "t = [0, 1, 2]", ["via.t", "[2]", "[3]"]),
        (TASK + "t = [1, 2]", ["via.t", "increasing", "0, s", "[1.0, 2.0]"]),
        (TASK + "qd = [[0, 0, 0]]", ["via.qd", "via.t"]),
        (TASK + "qd = [[0, 0, 0], [0, 0, 0]]", ["via.qd", "via.t"]),
        (TASK + "speed = 3", ["'speed'", "[via]"]),
        (TASK + "[limits]\ntau_mx = 3", ["'tau_mx'", "[limits]", "'tau_max'"]),
        (TASK + "[limits]\ntau_max = [1, 2]", ["limits.tau_max", "shoulder", "[1, 2]"]),
        (TASK + '[limits]\ntau_max = "1"', ["limits.tau_max", "numbers", "'1'"]),
        (TASK + "[limits]\ntau_max = nan", ["limits.tau_max", "numbers", "nan"]),
        (TASK + "[limits]\ntau_max = -1", ["limits.tau_max", "joint 1", "0 N m", "-1"]),
        (TASK + "[limits]\nqd_max = 1\nqd_max_deg = 1", ["limits.qd_max", "both", "qd_max_deg"]),
        (
            TASK + "[limits]\nq_min = 1\nq_max = -1",
            ["limits.q_min", "joint 1", "q_max", "-1 rad", "not 1"],
        ),
        (TASK + "[settings]\nmesh = 2", ["settings.mesh", "4 intervals", "not 2"]),
        (TASK + "[settings]\nmesh = 40.5", ["settings.mesh", "whole", "40.5"]),
        (TASK + "[settings]\ncompiled = 1", ["settings.compiled", "true or false", "not 1"]),
        (TASK + "[settings]\nblend = 0.7", ["settings.blend", "0.5", "0.7"]),
        (TASK + "[settings]\ngrid = 1", ["settings.grid", "10 points", "not 1"]),
        (TASK + "[settings]\nmash = 1", ["'mash'", "[settings]", "'mesh'"]),
        ("tip = 3\n" + TASK, ["tip", "text", "not 3"]),
    ],
)
def test_an_error_names_file_key_value_and_what_is_allowed(text, words):
    with refused("task.toml: ", *words) as caught:
        parse(text)
    assert "\n" not in str(caught.value)


def test_an_error_of_the_task_names_the_file_too():
    with refused("task.toml: via point 2", "position limits", "'waist'", "-900 deg", "360 deg"):
        parse(TASK.replace("-90", "-900")).compare()


def test_a_file_that_cannot_be_read(tmp_path):
    with refused("none.toml", "file"):
        read_task(tmp_path / "none.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with refused("binary.toml", "text"):
        read_task(tmp_path / "binary.toml")


CELL = """
schema = 1
robot = "microbot"
cycle = true
[[stop]]
name = "pick"
q_deg = [0, 20, 10]
payload = {{ mass = 2.0, center_of_mass = [0.1, 0.0, 0.0] }}
dwell = 0.1
[[stop]]
name = "place"
position = [3.0, 1.5, 4.0]
rpy_deg = [0, 90, 0]
free_turn = "x"
tolerance = 0.05
payload = 0
{more}
[settings]
mesh = 20
"""


def cell(tmp_path, more=""):
    file = tmp_path / "cell.toml"
    file.write_text(CELL.format(more=more))
    return read_cell(file)


def test_a_file_and_python_state_the_same_stops(tmp_path):
    found = cell(tmp_path, '[[segment]]\nafter = "place"\nkind = "line"\ntolerance = 0.01')
    turned = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    place = mo.Stop(
        position=[3.0, 1.5, 4.0],
        orientation=found.stops[1].orientation,
        free_turn="x",
        tolerance=0.05,
        payload=0.0,
        name="place",
    )
    assert np.allclose(found.stops[1].orientation, turned)
    payload = mo.Payload(2.0, [0.1, 0.0, 0.0])
    pick = mo.Stop(q=np.radians([0, 20, 10]), payload=payload, dwell=0.1, name="pick")
    assert found.stops == (pick, place)
    assert found.segments == (None, mo.Line(tolerance=0.01))
    assert (found.cycle, found.settings.mesh, is_cell_file(tmp_path / "cell.toml")) == (
        True,
        20,
        True,
    )


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("veloctiy = 'any'", ("'veloctiy'", "'place'", "'velocity'")),
        ("q = [0, 0, 0]", ("stop 'place'", "q", "position")),
        (
            "[[stop]]\ntolerance_deg = 5\nposition = [3, 0, 4]",
            ("stop 'stop 3'", "tolerance_deg", "m"),
        ),
        (
            "[[stop]]\nposition = [3, 0, 4]\nrpy = [180, 0, 0]",
            ("stop 'stop 3'", "rad", "[180.0, 0.0, 0.0]", "rpy_deg"),
        ),
        (
            "[[stop]]\nq = [0, 0, 0]\n[stop.payload]\ncenter_of_mass = [0, 0, 1]",
            ("mass", "payload", "'stop 3'", "missing"),
        ),
        ('[[segment]]\nafter = "pick"\nkind = "line"\n' * 2, ("two segments", "'pick'")),
        ('[[segment]]\nkind = "line"', ("after", "segment", "missing", "pick, place")),
        (
            '[[segment]]\nafter = "plce"\nkind = "line"',
            ("after", "pick, place", "'plce'", "'place'"),
        ),
        (
            '[[segment]]\nafter = "pick"\nkind = "curve"',
            ("kind", "'pick'", "line, circle", "'curve'"),
        ),
        ('[front]\nkind = "time"', ("kind", "[front]", "effort, torque", "'time'")),
        (
            '[front]\nkind = "torque"\nslacks = [1]',
            ("'slacks'", "[front]", "'torque'"),
        ),
        ('[[capsule]]\nlink = "fist"', ("capsule 1", "start", "missing")),
        (
            '[[capsule]]\nlink = "fist"\nstart = [0, 0, 0]\nend = [1, 0, 0]\nradius = 0.1',
            ("capsule 1", "link", "base, waist, shoulder", "'fist'"),
        ),
        (
            '[[segment]]\nafter = "pick"\nkind = "circle"',
            ("through", "'pick'", "missing"),
        ),
    ],
)
def test_what_is_wrong_in_a_cell_is_said(tmp_path, more, said):
    with refused("cell.toml: ", *said):
        cell(tmp_path, more)


def test_a_file_changes_the_capsules_of_one_link(tmp_path):
    row = "start = [0.1, 0.0, 0.0]\nend = [1.0, 0.0, 0.0]\nradius = 0.3"
    found = cell(tmp_path, f'[[capsule]]\nlink = "elbow"\n{row}').robot
    usual = with_arm_capsules(mo.load_robot("microbot")).capsules
    assert [frame for frame, _ in found.capsules] == [frame for frame, _ in usual]
    assert [c.radius for frame, c in found.capsules if frame == 3] == [0.3]
    before = [c.radius for frame, c in usual if frame != 3]
    assert [c.radius for frame, c in found.capsules if frame != 3] == before


@pytest.mark.thorough
def test_a_front_among_obstacles_from_a_file(tmp_path):
    (tmp_path / "cell.toml").write_text(
        """
schema = 1
robot = "planar_2r"
outputs = ["json", "motion"]
[[stop]]
q_deg = [-30, 20]
[[stop]]
q_deg = [60, -40]
[front]
kind = "torque"
shares = [0.8]
[settings]
mesh = 8
starts = 1
[scene]
obstacle = [{ name = "post", kind = "sphere", center = [0.85, 0.1, 0.0], radius = 0.08 }]
"""
    )
    task = read_cell(tmp_path / "cell.toml")
    settings = replace(task.settings, compiled=False, limit_tolerance=0.002)
    found = replace(task, settings=settings).solve()
    assert found.front is not None
    first, second = found.front.points
    assert first.motion.solved
    assert second.motion.solved
    assert second.duration > first.duration
    assert second.peak_torque < 0.83
    for point in (first, second):
        assert point.certificate.clearance is not None
        assert point.certificate.clearance.proved
    names = {path.name for path in found.save(tmp_path / "out", task.outputs)}
    assert names == {"cell.json", "motion.npz", "motion_2.npz"}
