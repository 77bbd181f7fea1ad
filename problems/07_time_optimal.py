"""Beyond the report: its three poses in the least time, beside every textbook motion.

All methods have the limits of the arm. The comparison is saved as a report, tables, figures,
motions and a recording, which `microbot-ocp replay` plays.

example: python problems/07_time_optimal.py --out out/07
"""

from __future__ import annotations

import argparse

import microbot_ocp as mo
import script
from course_report import VIA_Q, VIA_QD, VIA_T


def main(arguments: argparse.Namespace) -> None:
    robot = mo.load_robot(arguments.robot)
    comparison = mo.compare(robot, VIA_Q, via_t=VIA_T, via_qd=VIA_QD)
    print(comparison.table())
    fastest = comparison["time_optimal"]
    print(f"\n{fastest.title}: {fastest.certificate.verdict}")
    written = comparison.save(arguments.out)
    print(f"{len(written)} files in {arguments.out}; microbot-ocp replay "
          f"{arguments.out / 'comparison.rrd'} --open plays the recording")  # fmt: skip


if __name__ == "__main__":
    script.run(main, script.parser(__doc__, "out/07"))
