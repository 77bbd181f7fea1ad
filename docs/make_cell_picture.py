"""Draw four frames of a film of a pick-and-place cycle: ``docs/images/cell.png``.

python docs/make_cell_picture.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from microbot_ocp.tasks import read_cell
from microbot_ocp.views.animation import Film
from microbot_ocp.views.recording import of_cell
from tools import palette

TARGET = Path(__file__).resolve().parent / "images" / "cell.png"
CELL = """
schema = 1
robot = "microbot"
cycle = true

[[stop]]
name = "pick"
position = [3.5, -2.0, 2.0]
payload = { mass = 3.0, shape = { start = [0.25, -0.3, 0], end = [0.25, 0.3, 0], radius = 0.25 } }
dwell = 0.2

[[stop]]
name = "place"
position = [3.5, 2.0, 2.0]
payload = 0
dwell = 0.2

[settings]
mesh = 20

[scene]
clearance = 0.02

[[scene.obstacle]]
name = "wall"
kind = "box"
size = [3.0, 0.2, 3.0]
center = [4.5, 0.0, 1.5]
"""
SHARES = (0.0, 0.3, 0.5, 0.85)  # of the period


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cell.toml"
        path.write_text(CELL)
        cell = read_cell(path).solve()
    film = Film(of_cell(cell), title="microbot: a cycle over a wall")
    frames = [film.frame(share * cell.motion.duration) for share in SHARES]
    rows = [np.hstack(frames[:2]), np.hstack(frames[2:])]
    palette.save(Image.fromarray(np.vstack(rows)), TARGET, 256)
    print(TARGET, f"{cell.motion.duration:.4f} s", cell.certificate.ok, cell.certificate.clearance)


if __name__ == "__main__":
    main()
