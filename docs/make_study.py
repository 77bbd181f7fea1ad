"""Pictures of the study of 10,000 cases for docs/microbot_study.md, and a sample for the notebook.

    microbot-ocp sweep problems/microbot_study.toml --out out/microbot_study
    python docs/make_study.py out/microbot_study

The sample is the first cases of the study as they are, in single precision and without the times of
the solves, so that it is light.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import matplotlib as mpl
import pyarrow as pa
import pyarrow.parquet as pq

import microbot_ocp as mo

ROOT = Path(__file__).parent.parent
IMAGES = ROOT / "docs" / "images"
SAMPLE = ROOT / "problems" / "microbot_study"
COUNT = 1000
LEFT_OUT = ("_deg_1", "_deg_2", "_deg_3", "_solve_time", "seed", "version")


def draw(results: mo.sweeps.Sweep, *kinds: str) -> None:
    """Pictures of these kinds, as small PNG files."""
    mpl.rcParams["savefig.dpi"] = 90
    for kind in kinds:
        figure = results.plot(kind=kind).flat[0].figure
        figure.savefig(IMAGES / f"microbot_study_{kind}.png")


def keep_sample(results: mo.sweeps.Sweep) -> None:
    """The first cases as a data set of its own."""
    names = [(name, kind) for name, kind in results.about["columns"] if not name.endswith(LEFT_OUT)]
    read = results.read([name for name, _ in names])
    assert (read["case"][:COUNT] == range(COUNT)).all(), "the first cases are not all there"
    columns = {
        name: pa.array(read[name][:COUNT]).cast(pa.float32())
        if kind == "float"
        else pa.array(read[name][:COUNT])
        for name, kind in names
    }
    shutil.rmtree(SAMPLE, ignore_errors=True)
    (SAMPLE / "cases").mkdir(parents=True)
    pq.write_table(
        pa.table(columns), SAMPLE / "cases" / "part-00000000.parquet", compression="zstd"
    )
    about = {**results.about, "count": COUNT, "chunk": COUNT, "columns": names}
    about["quantities"] = dict(results.about["quantities"])
    (SAMPLE / "study.json").write_text(json.dumps(about, indent=2) + "\n", "utf-8")


if __name__ == "__main__":
    study = mo.load_sweep(sys.argv[1])
    draw(study, "atlas", "quantities")
    keep_sample(study)
    draw(mo.load_sweep(SAMPLE), "limits")
    print(study.table())
    for failure in study.summary().failures:
        print(f"{failure.count:6,} {failure.status}: {failure.reason} (case {failure.case})")
