"""Textbook and time-optimal motions of the Microbot through the report's via points, compared.

Part 5 of the course report drives the arm through three poses in 2 s + 2 s by cubic segments and by
LSPB. Here every method has the same torque and velocity limits and takes its own shortest time.

    python problems/07_time_optimal_comparison.py --out out/demo
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from rich.console import Console

import microbot_ocp as mo
import report
from microbot_ocp.views.live import show_progress


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder to write into")
    parser.add_argument("--robot", default="microbot", help="packaged robot or .toml file")
    parser.add_argument("--mesh", type=int, default=200, help="intervals a phase")
    arguments = parser.parse_args()
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 150)
    begin = time.perf_counter()
    try:
        robot = mo.load_robot(arguments.robot)
        with show_progress(console) as progress:
            comparison = mo.compare(
                robot,
                report.VIA_Q,
                via_t=report.VIA_T,
                via_qd=report.VIA_QD,
                mesh=arguments.mesh,
                progress=progress,
            )
            progress("writing figures, tables and recording")
            written = comparison.save(arguments.out)
    except mo.InputError as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    console.print(comparison.table())
    console.print(f"{len(written)} files in {arguments.out}, {time.perf_counter() - begin:.1f} s")
    return 0 if comparison.solved else 1


if __name__ == "__main__":
    sys.exit(main())
