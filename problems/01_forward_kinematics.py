"""Forward kinematics of any modified-DH table, in numbers or in symbols.

Part 1 of the course report. Without arguments the script asks for the table row by row; if its
input is not a terminal, it uses the report's table.

    python problems/01_forward_kinematics.py --alpha-deg 0,90,0,0 --a 0,0,3,4 --d 2,0,0,0 \
        --theta-deg 161.5651,74.1561,111.3819,0
    python problems/01_forward_kinematics.py --symbolic --alpha-deg 0,90,0,0 --a 0,0,e,f \
        --d h,0,0,0 --theta-deg x,x,x,0
"""

from __future__ import annotations

import argparse
import re
import sys

import numpy as np

import microbot_ocp as mo
import script
from symbolic import Matrix, matrix_text, product, symbolic_row

COLUMNS = {"alpha_deg": "twist, deg", "a": "length, m", "d": "offset, m", "theta_deg": "angle, deg"}
REPORT = ["0,90,0,0", "0,0,3,4", "2,0,0,0", "161.5651,74.1561,111.3819,0"]


def entries(name: str, text: str, names_allowed: bool) -> list[float | str]:
    found: list[float | str] = []
    for entry in text.split(","):
        try:
            found.append(float(entry))
        except ValueError:
            if not (names_allowed and name != "alpha_deg" and entry.strip().isidentifier()):
                raise mo.InputError(f"{name} must be numbers, not {entry!r}") from None
            found.append(entry.strip())
        if isinstance(found[-1], float) and not np.isfinite(found[-1]):
            raise mo.InputError(f"{name} must be finite, not {entry}")
    return found


def ask() -> list[str]:
    print("One row a line: alpha (deg), a (m), d (m), theta (deg); an empty line ends the table.")
    rows = []
    while line := input(f"row {len(rows) + 1}: ").strip():
        rows.append(re.split(r"[,\s]+", line))
        if len(rows[-1]) != 4:
            raise mo.InputError(f"row {len(rows)} must have 4 entries, not {len(rows[-1])}")
    return [",".join(column) for column in zip(*rows, strict=True)] or REPORT


def columns(arguments: argparse.Namespace) -> list[str]:
    """Return the four columns of the table as texts."""
    texts = [getattr(arguments, name) for name in COLUMNS]
    if not any(texts):
        texts = ask() if sys.stdin.isatty() and not arguments.symbolic else list(REPORT)
        if arguments.symbolic:
            texts[3] = "x,x,x,0"
    elif arguments.symbolic and texts[3] is None and texts[0]:
        texts[3] = ",".join("x" * len(texts[0].split(",")))
    if not all(texts):
        raise mo.InputError("give all of --alpha-deg, --a, --d and --theta-deg")
    return texts


def main(arguments: argparse.Namespace) -> None:
    texts = columns(arguments)
    table = [entries(n, t, arguments.symbolic) for n, t in zip(COLUMNS, texts, strict=True)]
    if len({len(column) for column in table}) > 1:
        raise mo.InputError(f"columns differ in length: {[len(column) for column in table]}")
    print("  i   alpha(i-1) [deg]   a(i-1) [m]   d(i) [m]   theta(i) [deg]")
    for i, row in enumerate(zip(*table, strict=True), 1):
        print(f"  {i}   {row[0]!s:>16}   {row[1]!s:>10}   {row[2]!s:>8}   {row[3]!s:>14}")
    show_symbols(table) if arguments.symbolic else show_numbers(table)
    if texts == REPORT:
        print("report: entry (2,2) of frame 3 in base is printed as -0.0305; its sign is wrong")


def show_symbols(table: list[list[float | str]]) -> None:
    whole = None
    for i, (alpha, a, d, theta) in enumerate(zip(*table, strict=True), 1):
        if isinstance(theta, str):
            row = symbolic_row(np.radians(alpha), a, d, joint=i)
        else:
            row = symbolic_row(np.radians(alpha), a, d, np.radians(theta))
        whole = row if whole is None else product(whole, row)
        show(i, row, whole)


def show_numbers(table: list[list[float | str]]) -> None:
    robot = mo.Robot.from_dh(np.radians(table[0]), table[1], table[2])
    q, before = np.radians(table[3]), np.eye(4)
    for i in range(1, len(q) + 1):
        pose = np.array(mo.forward_kinematics(robot, i)(q))
        show(i, np.linalg.solve(before, pose), pose)
        before = pose
    print("\ntool: Px = {:.4f}  Py = {:.4f}  Pz = {:.4f} m".format(*before[:3, 3]))


def show(i: int, row: Matrix | np.ndarray, whole: Matrix | np.ndarray) -> None:
    print(f"\nframe {i} in frame {i - 1}\n{matrix_text(row)}")
    if i > 1:
        print(f"\nframe {i} in base\n{matrix_text(whole)}")


if __name__ == "__main__":
    options = script.parser(__doc__)
    for column, meaning in COLUMNS.items():
        options.add_argument(
            f"--{column.replace('_', '-')}", help=f"{meaning}, one a row: 0,90,..."
        )
    options.add_argument("--symbolic", action="store_true", help="names for a, d and the angles")
    script.run(main, options)
