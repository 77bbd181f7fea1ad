"""Tables of the course report, with an erratum beside each wrong number, and all of its figures.

Parts 1 to 6 are printed one after the other: left as the report has them, right as computed here.
Figures 1 to 23 keep their numbers; where the report is wrong, they show both.

example: python problems/report.py --out out/report
"""

from __future__ import annotations

import argparse

import microbot_ocp as mo
import report_figures
import report_tables
import script


def main(arguments: argparse.Namespace) -> None:
    robot = mo.load_robot("microbot")
    explained = report_tables.show(robot)
    written = mo.plots.save(report_figures.draw(robot), arguments.out)
    print(f"\nfigures 1 to 23: {len(written)} files in {arguments.out}")
    if not explained:
        raise mo.InputError("a printed number differs from the computed one and has no erratum")


if __name__ == "__main__":
    options = script.parser(__doc__)
    options.add_argument(
        "--out", type=script.Path, default=script.Path("out/report"), help="folder"
    )
    script.run(main, options)
