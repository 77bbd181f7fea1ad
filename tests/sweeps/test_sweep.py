"""Sweeps on a real scheduler with two workers: the same rows whatever ends on the way."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import microbot_ocp as mo
from microbot_ocp.sweeps import TIMES, Study, SweepStopped, repeat_case, run_study

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

COUNT = 12
EXIT, HANG, BROKEN = 1.0, 1.5, 2.0  # payloads, kg


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
        silence_logs=50,
    ) as made:  # fmt: skip
        yield made


@pytest.fixture(scope="module")
def client(cluster: Any) -> Iterator[Any]:
    with distributed.Client(cluster, set_as_default=False) as made:
        yield made


def slow_method() -> Callable[..., mo.Motion]:
    """A method that takes a while; made here, so that it is sent by value."""

    def slow(robot: mo.Robot, via_q: np.ndarray) -> mo.Motion:
        import time

        from microbot_ocp.motion import Motion
        from microbot_ocp.trajectories import cubic

        time.sleep(0.1)
        return Motion.from_polynomial(robot, cubic(via_q, [0.0, 0.4]), label="slow")

    return slow


def poison_method() -> Callable[..., mo.Motion]:
    def poison(robot: mo.Robot, via_q: np.ndarray) -> mo.Motion:
        import os
        import time

        load = robot.links[-1].mass - 2.0
        if load == 1.0:
            os._exit(1)
        if load == 1.5:
            time.sleep(60)
        raise TypeError("a fault of the method") if load == 2.0 else ValueError("nothing")

    return poison


def study(count: int = COUNT, **more: Any) -> Study:
    cases = mo.Cases.random(
        count,
        seed=1,
        start_q=mo.Between(-0.5, [0.5, 0.5, 0.5]),
        goal_q=mo.Between([1, 0.5, 0.5], 1.5),
        payload=mo.Between(0, 1),
    )
    methods = {"cubic": None, "slow": slow_method()}
    return Study(mo.load_robot("microbot"), cases, **{"methods": methods, **more})


def same(one: mo.Sweep, other: mo.Sweep) -> bool:
    """Whether two data sets agree in every row, times aside."""
    first, second = one.read(), other.read()
    names = [name for name in first if not TIMES.fullmatch(name)]
    assert first.keys() == second.keys()
    return all(
        np.array_equal(first[n], second[n], equal_nan=first[n].dtype.kind == "f") for n in names
    )


@pytest.fixture(scope="module")
def undisturbed(client: Any, tmp_path_factory: pytest.TempPathFactory) -> mo.Sweep:
    said: list[str] = []
    found = run_study(
        study(), tmp_path_factory.mktemp("whole"), client=client,
        progress=lambda step: said.append(step.text),
    )  # fmt: skip
    assert any("a second" in text and "left" in text for text in said)
    assert said[-1].startswith(f"{COUNT} of {COUNT} cases")
    return found


def test_rows_are_those_of_a_plain_loop(undisturbed: mo.Sweep) -> None:
    asked, read = study(), undisturbed.read()
    assert undisturbed.finished
    assert read["case"].tolist() == list(range(COUNT))
    assert set(read["status"]) == {"solved"}
    for case in (0, 7, COUNT - 1):
        row, _ = repeat_case(asked, case)
        for name, value in row.items():
            if not TIMES.fullmatch(name):
                assert read[name][case] == value, name
    assert (read["cubic_at_tau_elbow"] <= 1).all()
    assert read["cubic_certified"].all()


def test_a_killed_worker_changes_nothing(
    client: Any, undisturbed: mo.Sweep, tmp_path: Path
) -> None:
    killed: list[int] = []

    def kill_one(step: Any) -> None:
        pids = [w["id"] for w in client.cluster.scheduler_info["workers"].values()]
        if not killed and pids and step.done >= 3:
            process = client.run(os.getpid)
            killed.append(next(iter(process.values())))
            os.kill(killed[0], signal.SIGKILL)

    found = run_study(study(), tmp_path, client=client, progress=kill_one)
    assert killed
    assert same(found, undisturbed)


SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
from sweeps.test_sweep import run_study, study
run_study(study(), {out!r}, client={address!r})
"""


def test_a_killed_client_continues(
    cluster: Any, client: Any, undisturbed: mo.Sweep, tmp_path: Path
) -> None:
    tests, out = str(Path(__file__).parent.parent), tmp_path / "out"
    script = SCRIPT.format(tests=tests, out=str(out), address=cluster.scheduler_address)
    process = subprocess.Popen([sys.executable, "-c", script])
    parts = out / "cases"
    while len(list(parts.glob("part-*"))) < 3:
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    before = mo.load_sweep(out)
    assert 3 <= before.done < COUNT
    stamps = {path: path.stat().st_mtime_ns for path in parts.glob("part-*")}
    found = run_study(study(), out, client=client)
    assert same(found, undisturbed)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())


def test_poisoned_cases_end(client: Any, tmp_path: Path) -> None:
    cases = mo.Cases.grid(
        start_q=[0, 0, 0], goal_q=[1, 0.5, 0.5], payload=mo.OneOf([0.0, EXIT, HANG, BROKEN])
    )
    methods = {"poison": poison_method(), "cubic": None}
    asked = Study(mo.load_robot("microbot"), cases, methods, time_limit=2.0)
    found = run_study(asked, tmp_path, client=client)
    read = found.read(["status", "reason", "cubic_status"])
    assert read["status"].tolist() == ["failed", "killed worker", "time limit", "failed"]
    assert read["cubic_status"].tolist() == ["solved", "killed worker", "time limit", "solved"]
    assert "fault of the method" in read["reason"][3]
    summary = found.summary()
    assert summary.solved == {"poison": 0, "cubic": 2}
    assert [failure.case for failure in summary.failures] == [0, 1, 2, 3]


def test_another_study_is_refused(undisturbed: mo.Sweep, client: Any) -> None:
    with pytest.raises(mo.InputError, match="holds another study"):
        run_study(study(time_limit=1.0), undisturbed.folder, client=client)


def test_a_broken_file_is_done_again(undisturbed: mo.Sweep, client: Any, tmp_path: Path) -> None:
    found = run_study(study(4), tmp_path, client=client)
    part = next((tmp_path / "cases").glob("part-*"))
    part.write_bytes(part.read_bytes()[:-9])
    again = run_study(study(4), tmp_path, client=client)
    assert again.finished
    assert found.read(["case"])["case"].tolist() == [0, 1, 2, 3]


def test_a_scheduler_that_ends_is_said(tmp_path: Path) -> None:
    code = (
        "import asyncio, distributed\n"
        "async def main():\n"
        "    async with distributed.Scheduler(host='127.0.0.1', port=0, dashboard=False) as s:\n"
        "        print(s.address, flush=True)\n"
        "        await s.finished()\n"
        "asyncio.run(main())"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        address = process.stdout.readline().strip()

        def end(_: Any) -> None:
            process.kill()

        with pytest.raises(SweepStopped, match="the same command continues"):
            run_study(study(4), tmp_path, client=address, progress=end)


def test_results_show_themselves(undisturbed: mo.Sweep, tmp_path: Path) -> None:
    table = str(undisturbed.table())
    assert "12 of 12 cases on microbot" in table
    for kind in ("atlas", "limits", "quantities", "failures"):
        path = undisturbed.plot(kind=kind).savefig(tmp_path / f"{kind}.png")
        assert path.stat().st_size > 10_000
    assert undisturbed.to_rerun(tmp_path / "atlas.rrd").stat().st_size > 1_000
