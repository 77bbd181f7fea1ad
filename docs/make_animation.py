"""Make the moving picture of ``README.md``: ``docs/images/time_optimal.gif``, and a dark one.

    python docs/make_animation.py

The task is that of ``make demo``: the report's three poses; the ghost is the cubic with the best
times and via velocities, the solid arm takes the free time-optimal motion.
"""

from __future__ import annotations

import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent / "problems"))

import course_report  # noqa: E402
import microbot_ocp as mo  # noqa: E402

MOST = 3_000_000  # bytes


def main() -> int:
    robot = mo.load_robot("microbot")
    comparison = mo.compare(
        robot,
        course_report.VIA_Q,
        ["cubic", "lspb", "time_optimal"],
        via_t=course_report.VIA_T,
        via_qd=course_report.VIA_QD,
        mesh=200,
    )
    large = 0
    for theme, name in (("light", "time_optimal.gif"), ("dark", "time_optimal_dark.gif")):
        path = comparison.export(DOCS / "images" / name, theme=theme)
        size = path.stat().st_size
        large += size > MOST
        print(f"{path} ({size / 1e6:.2f} MB)")
    return 1 if large or not comparison.solved else 0


if __name__ == "__main__":
    sys.exit(main())
