"""Sweeps on a real scheduler with two workers: the same rows whatever ends on the way."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.legend import Legend

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp.cli import main
from microbot_ocp.sweeps import TIMES, Study, SweepStopped, repeat_case, run_study

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

EXIT, HANG, BROKEN = 1.0, 1.5, 2.0  # payloads, kg
PAYLOADS = [0.0, 0.1, 0.2, BROKEN, HANG, 0.3, EXIT, 0.4]
GOOD = [case for case, payload in enumerate(PAYLOADS) if payload < 1.0]
COUNT = len(PAYLOADS)
EARLY = 2  # cases that are done before the client is killed


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with (
        dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None,
            scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
            silence_logs=50,
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as made,
    ):  # fmt: skip
        yield made


def slow_method() -> Callable[..., mo.Motion]:
    """A method that takes a while, or worse; made here, so that it is sent by value."""

    def slow(robot: mo.Robot, via_q: np.ndarray) -> mo.Motion:
        import os
        import time

        from microbot_ocp.motion import Motion
        from microbot_ocp.trajectories import cubic

        load = robot.links[-1].mass - 2.0
        if load == EXIT:
            os._exit(1)
        if load == BROKEN:
            raise TypeError("a fault of the method")
        time.sleep(60.0 if load == HANG else 0.1)
        return Motion.from_polynomial(robot, cubic(via_q, [0.0, 2.0]), label="slow")

    return slow


def study(**more: Any) -> Study:
    cases = mo.sweeps.Cases.grid(
        start_q=[0, 0, 0], goal_q=[1, 0.5, 0.5], payload=mo.OneOf(PAYLOADS)
    )  # fmt: skip
    methods = {"cubic": None, "slow": slow_method()}
    return Study(
        mo.load_robot("microbot"), cases, **{"methods": methods, "time_limit": 3.0, **more}
    )


SCRIPT = """
import sys
sys.path.insert(0, {tests!r})
from sweeps.test_sweep import run_study, study
run_study(study(), {out!r}, client={address!r})
"""


@dataclass
class Disturbed:
    """A sweep whose client was killed, then one of its workers, and what was seen meanwhile."""

    results: mo.sweeps.Sweep
    before: int
    stamps: dict[Path, int]
    killed: list[int]
    said: list[str]


@pytest.fixture(scope="module")
def disturbed(client: Any, tmp_path_factory: pytest.TempPathFactory) -> Disturbed:
    tests, out = str(Path(__file__).parent.parent), tmp_path_factory.mktemp("disturbed") / "out"
    script = SCRIPT.format(tests=tests, out=str(out), address=client.cluster.scheduler_address)
    process = subprocess.Popen([sys.executable, "-c", script])
    while len(list(out.glob("cases/part-*"))) < EARLY:
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait()
    before = mo.load_sweep(out).done
    stamps = {path: path.stat().st_mtime_ns for path in out.glob("cases/part-*")}
    killed: list[int] = []
    said: list[str] = []

    def kill_one(step: Any) -> None:
        said.append(step.text)
        if not killed and step.done > before:
            killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[0], signal.SIGKILL)

    results = run_study(study(), out, client=client, progress=kill_one)
    return Disturbed(results, before, stamps, killed, said)


def same_as_a_plain_loop(results: mo.sweeps.Sweep, cases: list[int]) -> bool:
    """Whether rows are those of cases done here one after the other, times aside."""
    asked, read = study(), results.read()
    rows = [repeat_case(asked, case)[0] for case in cases]
    return read["case"].tolist() == list(range(COUNT)) and all(
        read[name][case] == value
        for case, row in zip(cases, rows, strict=True)
        for name, value in row.items()
        if not TIMES.fullmatch(name)
    )


def test_kills_of_the_client_and_of_a_worker_change_nothing(disturbed: Disturbed) -> None:
    results = disturbed.results
    assert EARLY <= disturbed.before < COUNT - 1
    assert disturbed.killed
    assert results.finished
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in disturbed.stamps.items())
    assert same_as_a_plain_loop(results, GOOD)
    read = results.read()
    assert (read["slow_at_tau_elbow"][GOOD] <= 1).all()
    assert read["slow_certified"][GOOD].all()


def test_progress_has_rate_and_time_left(disturbed: Disturbed) -> None:
    assert any("a second" in text and "left" in text for text in disturbed.said)
    tells(disturbed.said[-1], f"{COUNT} of {COUNT} cases")
    tells(disturbed.said[-1], "3 without")


def test_poisoned_cases_end(disturbed: Disturbed) -> None:
    read = disturbed.results.read(["status", "cubic_status", "payload", "reason"])
    by_payload = dict(zip(read["payload"], read["status"], strict=True))
    ends = {BROKEN: "failed", EXIT: "killed worker", HANG: "time limit"}
    assert by_payload == dict.fromkeys(PAYLOADS, "solved") | ends
    of_cubic = dict(zip(read["payload"], read["cubic_status"], strict=True))
    assert of_cubic == by_payload | {BROKEN: "solved"}
    tells(read["reason"][PAYLOADS.index(BROKEN)], "fault", "method")
    summary = disturbed.results.summary()
    assert summary.solved == {"cubic": len(GOOD) + 1, "slow": len(GOOD)}
    assert sorted(failure.case for failure in summary.failures) == [3, 4, 6]


def test_another_study_is_refused(disturbed: Disturbed, client: Any) -> None:
    with refused("another study", f"{COUNT} cases", str(disturbed.results.folder)):
        run_study(study(time_limit=1.0), disturbed.results.folder, client=client)


def test_a_broken_file_is_done_again(disturbed: Disturbed, client: Any, tmp_path: Path) -> None:
    folder = shutil.copytree(disturbed.results.folder, tmp_path / "copy")
    short, flipped = sorted((folder / "cases").glob("part-*"))[:2]
    short.write_bytes(short.read_bytes()[:-9])
    content = bytearray(flipped.read_bytes())
    content[content.index(b"solved")] ^= 1
    flipped.write_bytes(content)
    with refused("damaged", str(folder)):
        mo.load_sweep(folder).read()
    said: list[str] = []
    results = run_study(
        study(), folder, client=client, progress=lambda step: said.append(step.text)
    )
    assert same_as_a_plain_loop(results, [0, 1])
    tells(said[0], f"{COUNT - 2} of {COUNT} cases", "3 without")
    about = folder / "study.json"
    about.write_text(about.read_text().replace(f'"count": {COUNT}', f'"count": {COUNT + 1}'))
    with refused("study.json", "changed"):
        mo.load_sweep(folder)


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

        # This client gives a lost scheduler up sooner than the client of an address does.
        with (
            distributed.Client(address, timeout="1s", set_as_default=False) as client,
            refused(str(tmp_path), error=SweepStopped),
        ):
            run_study(study(), tmp_path, client=client, progress=end)


def test_results_show_themselves(disturbed: Disturbed, capsys: pytest.CaptureFixture[str]) -> None:
    folder = disturbed.results.folder
    assert main(["sweep", "--summary", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["solved"]["slow"] == len(GOOD)
    tells(str(disturbed.results.table()), f"{COUNT} of {COUNT}", "microbot")
    for kind in ("atlas", "limits", "quantities", "failures"):
        assert (folder / "summary" / f"{kind}.png").stat().st_size > 10_000
    assert (folder / "summary" / "atlas.rrd").stat().st_size > 1_000


def test_a_hexagon_has_the_colour_of_a_limit() -> None:
    sample = mo.load_sweep(Path(__file__).parents[2] / "problems" / "microbot_study")
    panel = sample.plot(kind="limits").flat[0]
    panel.figure.canvas.draw()
    (legend,) = panel.figure.findobj(Legend)
    named = [patch.get_facecolor() for patch in legend.get_patches()]
    drawn = [tuple(color) for color in panel.collections[0].get_facecolors()]
    assert set(drawn) == set(named)
    assert len(named) == len(set(named)) == 6
    assert max(named, key=drawn.count) == named[-1]  # the torque of the elbow
