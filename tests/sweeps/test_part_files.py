"""Files in the folder of a sweep: what is not of its cases is not believed."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, warned
from microbot_ocp.sweeps import Study, repeat_case
from microbot_ocp.sweeps._sweep import opened

COUNT = 4


def written(folder: Path, last: float = 0.3) -> mo.sweeps.Sweep:
    """A sweep of four cases, each in a file of its own."""
    cases = mo.sweeps.Cases.grid(
        start_q=[0, 0], goal_q=[1, 0.5], payload=mo.OneOf([0, 0.1, 0.2, last])
    )
    study = Study(mo.load_robot("planar_2r"), cases, ["cubic"])
    results = opened(study, folder)
    for case in range(COUNT):
        results._write(case, [repeat_case(study, case)])
    return results


@pytest.fixture(scope="module")
def sweeps(tmp_path_factory: pytest.TempPathFactory) -> tuple[mo.sweeps.Sweep, mo.sweeps.Sweep]:
    folder = tmp_path_factory.mktemp("sweeps")
    return written(folder / "own"), written(folder / "other", last=0.25)


@pytest.fixture
def folder(sweeps: tuple[mo.sweeps.Sweep, mo.sweeps.Sweep], tmp_path: Path) -> Path:
    return shutil.copytree(sweeps[0].folder, tmp_path / "copy")


def part(folder: Path, number: int) -> Path:
    return folder / "cases" / f"part-{number:08d}.parquet"


@pytest.mark.parametrize("number", [COUNT, 99_999_999])
def test_a_copy_under_another_number_is_left_out(folder: Path, number: int) -> None:
    shutil.copy(part(folder, 0), part(folder, number))
    results = mo.load_sweep(folder)
    assert results.done == COUNT
    assert results.finished
    with warned("cases", f"part-{number:08d}.parquet"):
        assert results.read(["case"])["case"].tolist() == list(range(COUNT))


def test_a_copy_in_the_place_of_other_cases_is_left_out(folder: Path) -> None:
    shutil.copy(part(folder, 0), part(folder, 1))
    results = mo.load_sweep(folder)
    assert results.done == COUNT - 1
    with warned("cases", "part-00000001.parquet"):
        assert results.read(["case"])["case"].tolist() == [0, 2, 3]


def test_a_file_of_another_sweep_is_left_out_and_its_cases_done_again(
    sweeps: tuple[mo.sweeps.Sweep, mo.sweeps.Sweep], folder: Path
) -> None:
    shutil.copy(part(sweeps[1].folder, 3), part(folder, 3))
    results = mo.load_sweep(folder)
    assert results.done == COUNT - 1
    with warned("cases", "part-00000003.parquet"):
        assert results.summary().done == COUNT - 1
    assert written(folder).done == COUNT


def rewritten(path: Path, **columns: Any) -> None:
    import pyarrow
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(path)
    for name, values in columns.items():
        column = pyarrow.array(values)
        table = table.set_column(table.column_names.index(name), name, column)
    pyarrow.parquet.write_table(table, path)


def test_text_in_a_column_of_numbers_is_said(folder: Path) -> None:
    rewritten(part(folder, 2), cubic_duration=["long"])
    results = mo.load_sweep(folder)
    assert results.done == COUNT - 1
    for reader in (results.summary, results.table, lambda: results.savings("cubic")):
        with refused("damaged", "part-00000002.parquet", "columns"):
            reader()


def test_a_status_that_is_none_is_said(folder: Path) -> None:
    rewritten(part(folder, 2), status=["fine"])
    with refused("status", "case 2", "solved", "size limit", "'fine'"):
        mo.load_sweep(folder).summary()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
@pytest.mark.parametrize(
    ("kind", "reason"), [("pipe", "pipe"), ("folder", "folder"), ("nothing", "0 bytes")]
)
def test_what_is_no_file_is_said(folder: Path, kind: str, reason: str) -> None:
    path = part(folder, 2)
    path.unlink()
    {"pipe": os.mkfifo, "folder": Path.mkdir, "nothing": Path.touch}[kind](path)
    results = mo.load_sweep(folder)
    assert results.done == COUNT - 1
    with refused("damaged", reason):
        results.read(["case"])


@pytest.mark.thorough
def test_a_long_time_limit_is_none(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    cases = mo.sweeps.Cases.grid(start_q=[0, 0], goal_q=[1, 0.5])
    results = mo.sweep(
        mo.load_robot("planar_2r"), cases, ["cubic"], out=tmp_path, workers=1, time_limit=1e10
    )
    assert np.isfinite(results.read(["cubic_duration"])["cubic_duration"]).all()
