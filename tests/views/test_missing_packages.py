"""Without matplotlib and Rerun all is solved, and a picture is refused in one line."""

import subprocess
import sys

import pytest

from helpers import tells

SCRIPT = """
import sys
sys.modules["{package}"] = None  # as if it were not installed
import microbot_ocp as mo
robot = mo.load_robot("planar_2r")
comparison = mo.compare(robot, [[0.0, 0.0], [0.6, 0.9]], ["cubic", "straight_path"])
assert comparison.solved, comparison.table()
comparison.save({folder!r}, ["csv", "json"])
motion = comparison.motions["cubic"]
print(comparison.table())
for ask in ({asks}):
    try:
        ask()
    except mo.InputError as problem:
        print("refused:", problem)
"""


@pytest.mark.parametrize(
    ("package", "asks", "parts"),
    [
        (
            "matplotlib",
            "lambda: comparison.plot(), lambda: mo.plots.motion, "
            f"lambda: motion.export({'a.gif'!r}, robot=robot)",
            ("matplotlib", "pip install matplotlib"),
        ),
        pytest.param(
            "rerun",
            "lambda: comparison.to_rerun('a.rrd'), lambda: motion.to_rerun(robot, 'a.rrd')",
            ("rerun", "pip install rerun-sdk"),
            marks=pytest.mark.thorough,
        ),
    ],
    ids=["matplotlib", "rerun"],
)
def test_all_but_pictures_works_without_it(package, asks, parts, tmp_path) -> None:
    script = SCRIPT.format(package=package, asks=asks, folder=str(tmp_path))
    run = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    refused = [text for text in run.stdout.splitlines() if text.startswith("refused:")]
    assert len(refused) == asks.count("lambda")
    for text in refused:
        tells(text, *parts)


def test_importing_the_package_loads_neither() -> None:
    check = "import sys, microbot_ocp; print({'matplotlib', 'rerun'} & set(sys.modules))"
    run = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "set()"
