"""The best place for the base of a UR5e that moves 1 kg from one tool pose to another and returns.

The base may move by 0.2 m in x and y. The script prints the period before and after with the worth
of each coordinate, and writes the map, the motions and Rerun recordings of both.

example: python problems/13_layout.py --out out/13
"""

from __future__ import annotations

import argparse
import time

import numpy as np

import microbot_ocp as mo
import script
from microbot_ocp.planning import TimeOptimalSettings
from microbot_ocp.tasks import CellFile

REACH = 0.2  # m, to both sides


def cell() -> CellFile:
    """Return the cell: a pick and a place with the tool down."""
    robot, down = mo.load_robot("ur5e"), mo.robot.rotation_of([np.pi, 0.0, 0.0])
    stops = (
        mo.Stop(position=[0.55, -0.35, 0.2], orientation=down, payload=1.0, name="pick"),
        mo.Stop(position=[0.35, 0.45, 0.4], orientation=down, payload=0.0, name="place"),
    )
    settings = TimeOptimalSettings(starts=2)
    return CellFile("UR5e", robot, stops, robot.limits, cycle=True, settings=settings)


def main(arguments: argparse.Namespace) -> None:
    task, bounds = cell(), dict.fromkeys(("base.x", "base.y"), (-REACH, REACH))
    begin = time.process_time()
    found = mo.design(None, task, ("base.x", "base.y"), bounds)
    print(found.table())
    print(
        f"{time.process_time() - begin:.0f} s of processor time, {found.after.certificate.outcome}"
    )
    arguments.out.mkdir(parents=True, exist_ok=True)
    found.plot().savefig(arguments.out / "map.png")
    found.to_rerun(arguments.out)
    for name, answer in (("before", found.before), ("after", found.after)):
        if answer is not None:
            answer.motion.save(arguments.out / f"{name}.npz")


if __name__ == "__main__":
    parser = script.parser(__doc__)
    parser.add_argument("--out", type=script.Path, default=script.Path("out/13"), help="folder")
    script.run(main, parser)
