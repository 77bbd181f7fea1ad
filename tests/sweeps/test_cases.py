"""Cases by index: grids, draws, tables, and what is refused."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused
from microbot_ocp.sweeps import CaseSource, Study, read_study, repeat_case, task_of

ENDS = {"start_q": [0.0, 0.0, 0.0], "goal_q_deg": [90.0, 45.0, 45.0]}


def source(cases: mo.sweeps.Cases, robot: mo.Robot) -> CaseSource:
    return cases.of(robot)


def test_a_grid_has_every_combination(microbot: mo.Robot) -> None:
    cases = mo.sweeps.Cases.grid(
        **ENDS, payload=mo.Between(0.0, 2.0, 3), tau_max=mo.OneOf([[400, 500, 200], [40, 50, 20]])
    )
    found = source(cases, microbot)
    rows = found.rows(0, found.count)
    assert found.count == 6
    assert found.varying == ("payload", "tau_max")
    assert rows[:, found.columns.index("payload")].tolist() == [0, 0, 1, 1, 2, 2]
    assert rows[:, found.columns.index("tau_max_3")].tolist() == [200, 20] * 3
    assert np.allclose(found.values(rows[0])["goal_q"], np.radians(ENDS["goal_q_deg"]))
    assert np.array_equal(found.rows(2, 5), rows[2:5])


def test_draws_do_not_depend_on_how_they_are_cut(microbot: mo.Robot) -> None:
    cases = mo.sweeps.Cases.random(
        100, seed=3, start_q=mo.Between(-1, [1, 2, -1]), goal_position=[3, -1, 4.5],
        payload=mo.OneOf([0, 1]),
    )  # fmt: skip
    found = source(cases, microbot)
    rows = found.rows(0, 100)
    parts = [r for _, _, r in found.chunks(7, skipped={1})]
    assert np.array_equal(np.vstack(parts), np.delete(rows, range(7, 14), axis=0))
    assert rows[:, 0].min() < -0.9
    assert rows[:, 0].max() > 0.9
    assert set(rows[:, 2]) == {-1.0}
    assert abs(rows[:, -1].mean() - 0.5) < 0.05
    other = source(mo.sweeps.Cases.random(100, seed=4, **cases.quantities), microbot)
    assert not np.array_equal(other.rows(0, 100), rows)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_table_is_read(microbot: mo.Robot, tmp_path: Path, ending: str) -> None:
    columns = {f"goal_q_deg_{k}": np.arange(4.0) * k for k in (1, 2, 3)} | {"qd_max": np.ones(4)}
    path = tmp_path / f"cases.{ending}"
    if ending == "csv":
        lines = [
            ",".join(columns),
            *(",".join(map(str, r)) for r in zip(*columns.values(), strict=True)),
        ]
        path.write_text("\n".join(lines))
    else:
        import pyarrow
        import pyarrow.parquet

        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    found = source(mo.sweeps.Cases.table(path, start_q=[0, 0, 0]), microbot)
    assert found.count == 4
    assert found.varying == ("goal_q",)
    values = found.values(found.rows(3, 4)[0])
    assert np.allclose(np.degrees(values["goal_q"]), [3, 6, 9])
    task = task_of(microbot, found.poses, values)
    assert task.robot.limits.qd_max.tolist() == [1, 1, 1]


@pytest.mark.parametrize("several", [mo.OneOf([0, 1]), mo.Between(0, 1)])
def test_beside_a_table_all_is_constant(microbot: mo.Robot, several: object) -> None:
    columns = {f"goal_q_{k}": [0.0, 1.0] for k in (1, 2, 3)}
    cases = mo.sweeps.Cases.table(columns, start_q=[0, 0, 0], payload=several)
    with refused("payload", "table", type(several).__name__):
        cases.of(microbot)


def test_values_become_robots_and_poses(microbot: mo.Robot) -> None:
    cases = mo.sweeps.Cases.grid(
        start_position=[3, -1, 4.5], via1_q=[0.1, 0.2, 0.3], goal_position=[3, 1, 4.5],
        masses=[1, 2, 3], gravity=[0, 0, -1.6], viscous_friction=0.5, tool_speed_max=2.0, payload=1,
    )  # fmt: skip
    found = source(cases, microbot)
    task = task_of(microbot, found.poses, found.values(found.rows(0, 1)[0]))
    assert [link.mass for link in task.robot.links] == [1, 2, 3]
    assert [link.viscous_friction for link in task.robot.links] == [0.5] * 3
    assert task.robot.gravity.tolist() == [0, 0, -1.6]
    assert [limit.key for limit in task.robot.limits.also] == ["tool_speed"]
    assert task.payload == 1.0
    place = np.array(mo.forward_kinematics(microbot)(task.via_q[0]))[:3, 3]
    assert np.allclose(place, [3, -1, 4.5], atol=1e-6)
    assert task.via_q[1].tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"payloat": 1}, ("payloat", "'payload'", "start_, goal_", "masses")),
        ({"gravity": [0, 0]}, ("gravity", "3 numbers", "[0, 0]")),
        ({"gravity_deg": [0, 0, 1]}, ("gravity_deg", "'gravity'", "masses")),
        ({"payload": mo.Between(0, 1, 3)}, ("payload", "steps", "grids")),
        ({"payload": mo.Between(2, 1)}, ("payload", "lower", "upper", "Between(lower=2, upper=1")),
        ({"payload": mo.OneOf([])}, ("payload", "values", "OneOf(values=[])")),
        ({"goal_q": [0, 0, 0]}, ("goal_q or goal_q",)),
        ({"via2_q": [0, 0, 0]}, ("via1_q or via1_position", "missing")),
        ({"start_position": [0, 0, 0]}, ("start", "twice", "start_q", "start_position")),
        ({"payload": "heavy"}, ("payload", "array of numbers", "'heavy'")),
    ],
)
def test_bad_quantities_are_refused(
    microbot: mo.Robot, change: dict, said: tuple[str, ...]
) -> None:
    with refused(*said):
        mo.sweeps.Cases.random(4, **ENDS | change).of(microbot)


def test_what_fails_its_certificate_is_done_thoroughly(microbot: mo.Robot) -> None:
    """On 20 points reachability exceeds the torque of the elbow by 2 % between them."""
    cases = mo.sweeps.Cases.grid(start_q=[-0.1, 1.2, -1.0], goal_q=[0.8, 1.9, 0.5], payload=1.0)
    row, _ = repeat_case(Study(microbot, cases, ["cubic_path"], {"grid": 20}), 0)
    assert row["cubic_path_status"] == "solved"
    assert row["cubic_path_certified"]
    finer, _ = repeat_case(Study(microbot, cases, ["cubic_path"]), 0)
    assert row["cubic_path_duration"] == pytest.approx(finer["cubic_path_duration"], rel=5e-3)


STUDY = """
schema = 1
robot = "microbot"
methods = ["cubic", "lspb"]
time_limit = 5.0
[cases]
kind = "random"
count = 8
seed = 2
[quantities]
start_q = [0, 0, 0]
goal_q_deg = { from = [-90, -90, -90], to = [90, 90, 90] }
payload = { one_of = [0, 2] }
[settings]
mesh = 20
"""


def study_of(text: str) -> Study:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "study.toml"
        file.write_text(text)
        return read_study(file)


def test_a_study_file_is_read() -> None:
    study = study_of(STUDY)
    assert study.source.count == 8
    assert list(study.methods) == ["cubic", "lspb"]
    assert study.settings["mesh"] == 20
    assert study.digest == study_of(STUDY + "\n# the same").digest
    assert study.digest != study_of(STUDY.replace("seed = 2", "seed = 3")).digest


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("schema = 1", "schema = 2", ("schema", "1", "not 2")),
        ("methods =", "method =", ("'method'", "'methods'", "schema", "time_limit")),
        ('"lspb"', '"spline"', ("methods", "cubic_textbook, cubic,", "lspb,", "'spline'")),
        ('kind = "random"', 'kind = "sobol"', ("cases.kind", "random, grid, table", "'sobol'")),
        ("count = 8", "", ("cases.count", "missing")),
        ("count = 8", "count = 0", ("cases.count", "1", "not 0")),
        (
            'kind = "random"',
            'kind = "grid"',
            ("'count'", "[cases]", "'grid'"),
        ),
        (
            "from = [-90",
            "form = [-90",
            ("'form'", "quantities.goal_q_deg", "'from'", "from, to, steps"),
        ),
        ("start_q =", "seed = 3\nstart_q =", ("seed", "quantity", "start_, goal_")),
        ("mesh = 20", "mesh = 2", ("settings.mesh", "4 intervals", "not 2")),
        ("mesh = 20", "mash = 2", ("'mash'", "[settings]", "'mesh'")),
        ("time_limit = 5.0", "time_limit = 0", ("time_limit", "0 s", "not 0")),
        ('robot = "microbot"', "robot = 3", ("robot", "microbot, panda", ".toml", "not 3")),
        ("[cases]", "[cases", ("valid TOML", "line 6, column 7")),
    ],
)
def test_bad_study_files_are_refused(old: str, new: str, said: tuple[str, ...]) -> None:
    with refused("study.toml: ", *said):
        study_of(STUDY.replace(old, new, 1))
