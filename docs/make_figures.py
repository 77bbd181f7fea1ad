"""Draw the figures of the documentation again, into ``docs/images``.

Figures of a page are what the page's own code writes; the others have their own scripts. Pictures
of recordings need a Vulkan driver, that of a notebook needs Chromium: they are drawn with --all,
which runs the notebooks, too.

    python docs/make_figures.py [--all]
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent / "tools"))

from blocks import run_page

DOCS = Path(__file__).resolve().parent
IMAGES = DOCS / "images"
# page -> what its code writes -> name of the figure
WRITTEN = {
    "how-to/path_timing.md": {"phase_plane.png": "phase_plane.png"},
    "tutorial.md": {
        "out/comparison.png": "tutorial_comparison.png",
        "out/paths.png": "tutorial_paths.png",
    },
    "course/kinematics.md": {"branches.png": "course/branches.png"},
    "course/jacobian.md": {"ellipses.png": "course/ellipses.png"},
    "course/dynamics.md": {"there_and_back.png": "course/there_and_back.png"},
    "course/trajectories.md": {"shapes.png": "course/shapes.png"},
    "course/control.md": {"gains.png": "course/gains.png"},
    "course/time_optimal.md": {"use.png": "course/use.png"},
}
SCRIPTS = (
    "make_order_plot.py",
    "make_certificate_plot.py",
    "make_cell_picture.py",
    "make_import_diagram.py",
)
VIEWERS = ("make_screenshots.py", "make_notebooks.py")


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the figures of the documentation again.")
    parser.add_argument("--all", action="store_true", help="recordings and notebooks, too")
    scripts = (*SCRIPTS, *VIEWERS) if parser.parse_args().all else SCRIPTS
    for page, figures in WRITTEN.items():
        with tempfile.TemporaryDirectory() as folder:
            run_page(DOCS / page, Path(folder))
            for written, name in figures.items():
                shutil.copyfile(Path(folder) / written, IMAGES / name)
                print(IMAGES / name)
    with tempfile.TemporaryDirectory() as folder:
        program = [sys.executable, "-m", "microbot_ocp.cli"]
        subprocess.run([*program, "demo", "--out", folder], check=True)
        shutil.copyfile(Path(folder) / "comparison.png", IMAGES / "comparison.png")
    for script in scripts:
        subprocess.run([sys.executable, str(DOCS / script)], check=True)


if __name__ == "__main__":
    main()
