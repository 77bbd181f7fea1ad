"""Draw the function for each input and goal, and write the same as a table.

Between the marks of ``docs/which_function.md``, and as ``docs/images/which_function.svg``.

    python docs/make_which_function.py
"""

from __future__ import annotations

from html import escape
from pathlib import Path

DOCS = Path(__file__).resolve().parent
PAGE, PICTURE = DOCS / "which_function.md", DOCS / "images" / "which_function.svg"
MARKS = "<!-- made by docs/make_which_function.py -->\n", "<!-- end of the table -->\n"
WANTED = ("a model, joints", "the fastest", "to compare", "a given path", "obstacles", "to check")
CALLS = {  # each input has one call for each goal
    "a DH table": ["Robot.from_dh(alpha, a, d)"],
    "URDF, MJCF, a name": ["load_robot(source)"],
    "joint poses": [
        "",
        "time_optimal(robot, via_q)",
        "compare(robot, via_q)",
        "time_optimal_path(robot, mo.straight_path(via_q))",
        "time_optimal(robot, via_q, scene=scene)",
    ],
    "tool poses": [
        "solve_ik_all(robot, position)",
        "time_optimal(robot, stops)",
        "",
        "time_optimal(robot, stops, segments=[mo.Line()])",
        "time_optimal(robot, stops, scene=scene)",
    ],
    "a path": [
        "",
        "time_optimal_path(robot, path)",
        "planning.phase_plane(robot, path)",
        "planning.time_path(robot, path)",
    ],
    "a scene": ["fit_capsules(robot)", "", "", "", "load_scene(source)"],
    "a motion": [
        "",
        "shortest_duration(robot, motion)",
        "track(robot, motion, controller)",
        "",
        "clearance(robot, motion, scene)",
        "certify(robot, motion)",
    ],
    "a log, a CSV file": ["", "", "", "", "", "check(robot, file, profile)"],
    "torques": ["simulate(robot, tau, q0, qd0, t)"],
    "other loads, limits": [
        "robot.with_payload(mass)",
        "TimeOptimalSolver(robot, via_q)",
        "sweep(robot, cases, out=folder)",
    ],
    "your own dynamics": [
        "ocp.OptimalControlProblem(name)",
        "ocp.solve(problem)",
        "",
        "",
        "",
        "ocp.verify(problem, solution)",
    ],
}
LEFT, WIDE, HIGH, TOP = 168, 192, 42, 46  # px
STYLE = """
text { font: 13px sans-serif; fill: #222 } .call { font: 12px monospace }
.head { font-weight: bold } rect { fill: #e8f1f8; stroke: #0072b2 }
.page { fill: #fff; stroke: none }
@media (prefers-color-scheme: dark) {
text { fill: #eee } rect { fill: #16324a } .page { fill: #1e2129 } }
"""


def name(call: str) -> str:
    return call.partition("(")[0]


def svg() -> str:
    width, height = LEFT + WIDE * len(WANTED), TOP + HIGH * len(CALLS) + 8
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">',
        "<title>Function to call for each input (rows) and goal (columns)</title>",
        f"<style>{STYLE}</style>",
        f'<rect class="page" width="{width}" height="{height}"/>',
        '<text class="head" x="8" y="28">input, goal</text>',
    ]
    for column, wanted in enumerate(WANTED):
        x = LEFT + WIDE * column + WIDE / 2
        lines.append(f'<text class="head" x="{x}" y="28" text-anchor="middle">{wanted}</text>')
    for row, (given, calls) in enumerate(CALLS.items()):
        y = TOP + HIGH * row
        lines.append(f'<text x="8" y="{y + 24}">{escape(given)}</text>')
        for column, call in enumerate(calls):
            if call:
                x = LEFT + WIDE * column
                box = f'x="{x + 3}" y="{y + 4}" width="{WIDE - 6}" height="{HIGH - 8}" rx="5"'
                at = f'x="{x + WIDE / 2}" y="{y + 25}" text-anchor="middle"'
                lines += [f"<rect {box}/>", f'<text class="call" {at}>{escape(name(call))}</text>']
    return "\n".join([*lines, "</svg>\n"])


def table() -> str:
    rows = ["| input | goal | call |", "|---|---|---|"]
    for given, calls in CALLS.items():
        for wanted, call in zip(WANTED, calls, strict=False):
            if call:
                prefix = "" if call.startswith(("ocp.", "robot.")) else "mo."
                rows.append(f"| {given} | {wanted} | `{prefix}{call}` |")
    return "\n".join(rows) + "\n"


def page() -> str:
    before, _, rest = PAGE.read_text("utf-8").partition(MARKS[0])
    return f"{before}{MARKS[0]}\n{table()}\n{MARKS[1]}{rest.partition(MARKS[1])[2]}"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
    PICTURE.write_text(svg(), "utf-8")
