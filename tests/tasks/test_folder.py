import json

import numpy as np
import pytest

import microbot_ocp as mo
from helpers import refused, tells
from microbot_ocp import NotWritten

VIA = np.radians([[0, 0, 0], [-90, 90, 90]])
OUTPUTS = ("json", "csv", "motions")


@pytest.fixture(scope="module")
def runs():
    robot = mo.load_robot("microbot")
    return [
        mo.compare(robot, VIA, methods, limits=mo.Limits(qd_max=speed))
        for methods, speed in ((["cubic", "lspb"], 1.0), (["cubic"], 0.5))
    ]


def refusal(folder, **changes):
    path = folder / "comparison.json"
    if changes:
        document = {**json.loads(path.read_text()), **changes}
        if "digest" not in changes:  # as one who changes a file on purpose
            document.pop("digest", None)
        path.write_text(json.dumps(document))
    with pytest.raises(mo.InputError) as caught:
        mo.load_comparison(folder)
    assert len(str(caught.value)) < 400
    return str(caught.value)


def test_a_second_run_replaces_the_first_wholly(runs, tmp_path):
    first, second = runs
    first.save(tmp_path, OUTPUTS)
    (tmp_path / "notes.txt").write_text("mine")
    assert set(mo.load_comparison(tmp_path).motions) == {"cubic", "lspb"}
    second.save(tmp_path, OUTPUTS)
    assert set(mo.load_comparison(tmp_path).motions) == {"cubic"}
    found = sorted(path.name for path in tmp_path.rglob("*"))
    assert found == ["comparison.csv", "comparison.json", "cubic.npz", "motions", "notes.txt"]


def test_files_of_two_runs_are_refused(runs, tmp_path):
    first, second = runs
    first.save(tmp_path, OUTPUTS)
    second.save(tmp_path, ["csv"])
    tells(refusal(tmp_path), "comparison.csv", "another run", "comparison.json")
    first.save(tmp_path, ["csv"])
    assert mo.load_comparison(tmp_path)
    second.save(tmp_path, ["motions"])
    tells(refusal(tmp_path), "cubic.npz", "another run", "comparison.json")
    second.save(tmp_path, ["json"])
    assert list(mo.load_comparison(tmp_path).motions) == ["cubic"]


def test_outputs_of_one_run_may_be_saved_one_by_one(runs, tmp_path):
    for output in ("motions", "json", "csv", "motions", "json"):
        runs[0].save(tmp_path, [output])
    assert set(mo.load_comparison(tmp_path).motions) == {"cubic", "lspb"}


def test_damage_is_found(runs, tmp_path):
    runs[0].save(tmp_path, OUTPUTS)
    path = tmp_path / "motions" / "lspb.npz"
    content = path.read_bytes()
    path.unlink()
    tells(refusal(tmp_path), "lspb.npz", "missing")
    path.write_bytes(content[:-1] + b"\0\0")
    tells(refusal(tmp_path), "lspb.npz", "comparison.json")


def test_a_changed_file_is_refused(runs, tmp_path):
    runs[0].save(tmp_path, OUTPUTS)
    document = json.loads((tmp_path / "comparison.json").read_text())
    entries = [{**row, "solve_time": 0.0} for row in document["entries"]]
    change = {"entries": entries, "digest": document["digest"]}
    tells(refusal(tmp_path, **change), "comparison.json", "changed")


def test_impossible_files_are_refused(runs, tmp_path):
    runs[0].save(tmp_path, OUTPUTS)
    document = json.loads((tmp_path / "comparison.json").read_text())
    limits, entries = document["limits"], document["entries"]
    limits["q_min"] = [5.0, 5.0, 5.0]
    tells(refusal(tmp_path, limits=limits), "via point 1", "'waist'", "286.479 deg")
    limits["q_min"] = [None, None, None]
    backwards = {**limits, "qd_max": [-1.0, 1.0, 1.0]}
    tells(refusal(tmp_path, limits=backwards), "qd_max", "joint 1", "[-1, -1] rad/s")
    tells(
        refusal(tmp_path, limits={**limits, "tau_max": ["much", 1, 1]}),
        "tau_max",
        "numbers",
        "['much', 1, 1]",
    )
    tells(refusal(tmp_path, limits=limits, schema=2), "comparison.json", "schema", "not 2")
    tells(refusal(tmp_path, schema=None), "comparison.json", "schema", "not None")
    evil = [{**entries[0], "name": "../../cubic"}]
    tells(refusal(tmp_path, schema=1, entries=evil), "different names", "['../../cubic']")
    twice = [entries[0], entries[0]]
    tells(refusal(tmp_path, entries=twice), "different names", "['cubic', 'cubic']")
    tells(
        refusal(tmp_path, entries=entries, files={"../x": "1"}),
        "comparison.json",
        "files",
        "{'../x': '1'}",
    )
    (tmp_path / "comparison.json").write_text("[" * 50_000)
    tells(refusal(tmp_path), "comparison.json", "saved comparison")


def test_a_folder_that_cannot_be_written_keeps_what_it_has(runs, tmp_path, monkeypatch):
    runs[0].save(tmp_path, OUTPUTS)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    import microbot_ocp._base.writing as writing

    def full(path):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writing, "_fsync", full)
    with refused("comparison.json", "space", error=NotWritten) as caught:
        runs[1].save(tmp_path, OUTPUTS)
    assert ".part" not in str(caught.value)
    monkeypatch.undo()
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
