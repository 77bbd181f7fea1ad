"""Figures 1 to 23 of the course report, drawn from the right formulas."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import course_report
import microbot_ocp as mo
from microbot_ocp.inverse_kinematics import elbow_arm_branches

POSITION = (3.0, -1.0, 4.5)  # m, the target of part 2
POSE = np.radians([45.0, 30.0, -45.0])  # shown in figure 1
INK, BLUE, ORANGE, GREY = "#222222", "#0072B2", "#D55E00", "#999999"
CAPTIONS = {
    "01": "The Microbot robot",
    "02": "Four different possible solutions",
    "03": '"Elbow up" and "elbow down" configurations',
    "04": "Torques against time",
    "05": "Acceleration of all joints",
    "06": "Velocity for all joints",
    "07": "Position for all joints",
    "08": "Acceleration for joints 1, 2 and 3",
    "09": "Velocity for joints 1, 2 and 3",
    "10": "Positions for joints 1, 2 and 3",
    "11": "Torques for joints 1, 2 and 3",
    **{f"1{j + 1}": f"Cubic segments of joint {j}" for j in (1, 2, 3)},
    **{f"1{j + 4}": f"Linear segments with parabolic blends of joint {j}" for j in (1, 2, 3)},
    "18_loop": "Manipulator control system",
    "18": "Given and tracked acceleration",
    "19": "Given and tracked velocity",
    "20": "Given and tracked position",
    **{f"2{j}": f"Given and tracked torque of joint {j}" for j in (1, 2, 3)},
}


def title(number: str) -> str:
    """Return a figure's number and caption as the report has them."""
    return f"Fig. {int(number[:2])}: {CAPTIONS[number]}"


def arm(robot: mo.Robot) -> dict[str, Any]:
    """Draw the arm with its lengths, its four solutions, and both elbows in the arm's plane."""
    axes = mo.plots.arms(robot, {"q = (45, 30, -45) deg": POSE}, title=title("01"))
    places = np.array([np.array(mo.forward_kinematics(robot, k)(POSE))[:3, 3] for k in (1, 3)])
    corners = np.vstack([np.zeros(3), places, np.array(mo.forward_kinematics(robot)(POSE))[:3, 3]])
    for name, (x, y, z) in zip(("h = 2 m", "e = 3 m", "f = 4 m"), middles(corners), strict=True):
        axes.text(x, y, z + 0.6, name, ha="right")
    branches = elbow_arm_branches(POSITION)
    poses = {f"solution {k}: {np.degrees(q).round(1)} deg": q for k, q in enumerate(branches, 1)}
    four = mo.plots.arms(robot, poses, target=POSITION, title=title("02"))
    return {"01": axes, "02": four, "03": elbows(branches[:2])}


def middles(corners: np.ndarray) -> np.ndarray:
    """Return the middles between consecutive points [n,d]."""
    return (corners[:-1] + corners[1:]) / 2


def elbows(branches: np.ndarray) -> Figure:
    """Draw both elbows in the plane of the arm."""
    figure, axes = blank((6.0, 5.0), title("03"))
    for q, color, name in zip(branches, (ORANGE, BLUE), ("elbow up", "elbow down"), strict=True):
        angles = np.cumsum(q[1:])
        steps = np.array([3.0, 4.0])[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        corners = np.cumsum(np.vstack([[0.0, 2.0], steps]), axis=0)
        axes.plot(*corners.T, "o-", color=color, linewidth=3, label=name)
        for length, place in zip(("e", "f"), middles(corners), strict=True):
            axes.annotate(length, place, (6, 4), textcoords="offset points", color=color)
    axes.plot([0, 0], [0, 2], color=GREY, linewidth=5, label="waist, h = 2 m")
    axes.set(xlabel="distance from the waist's axis [m]", ylabel="height [m]", aspect="equal")
    axes.legend(frameon=False)
    return figure


def given_motion(robot: mo.Robot, motion: mo.Motion) -> dict[str, Any]:
    """Draw the motion of part 4a, and its torques with gravity along both axes."""
    along_y = robot.with_gravity(course_report.GRAVITY["along Y (report's code)"])
    other = mo.simulation.motion_from_formula(
        along_y,
        course_report.motion,
        course_report.DURATION,
        label="gravity along Y, as in the report's code",
    )
    both = [mo.plots.Curve.of(motion, "gravity along Z, right"), mo.plots.Curve.of(other)]
    drawn = {"04": mo.plots.curves(robot, both, ["tau"], title=title("04"))}
    given = [mo.plots.Curve.of(motion, "waist, shoulder and elbow alike")]
    for number, quantity in (("05", "qdd"), ("06", "qd"), ("07", "q")):
        drawn[number] = mo.plots.curves(robot, given, [quantity], joints=[0], title=title(number))
    return drawn


def forward(robot: mo.Robot, motion: mo.Motion) -> dict[str, Any]:
    """Draw the motion that its torques cause, by CVODES and by the report's loop."""
    run = mo.simulate(robot, motion, integrator="cvodes")
    loop = mo.plots.Curve(
        "the report's Euler loop", course_report.grid(), {"q": course_report.code_euler(motion)}
    )
    curves = [mo.plots.Curve.of(motion, "given"), mo.plots.Curve.of(run, "CVODES"), loop]
    drawn = {}
    for number, quantity in (("08", "qdd"), ("09", "qd"), ("10", "q"), ("11", "tau")):
        shown = [curve for curve in curves if quantity in curve.values]
        drawn[number] = mo.plots.curves(
            robot, shown, [quantity], title=title(number), base=True, bounds={"q": 300.0},
        )  # fmt: skip
    return drawn


def trajectories(robot: mo.Robot) -> dict[str, Any]:
    """Draw cubic segments and LSPB, a figure a joint."""
    shapes = (
        ("cubic", mo.cubic(course_report.VIA_Q, course_report.VIA_T, course_report.VIA_QD)),
        (
            "LSPB",
            mo.lspb(
                course_report.VIA_Q, course_report.VIA_T, course_report.BLEND, course_report.VIA_QD
            ),
        ),
    )
    drawn, via = {}, (course_report.VIA_T, course_report.VIA_Q)
    for k, (name, shape) in enumerate(shapes):
        curve = mo.plots.Curve.of(mo.Motion.from_polynomial(robot, shape, label=name))
        for joint in range(3):
            number = str(12 + 3 * k + joint)
            drawn[number] = mo.plots.curves(
                robot, [curve], ["q", "qd", "qdd"], joints=[joint], via=via, title=title(number)
            )
    return drawn


def tracked(robot: mo.Robot, motion: mo.Motion) -> dict[str, Any]:
    """Draw the arm under partitioned control from a start at rest at q = 0."""
    curves = [mo.plots.Curve.of(motion, "given")]
    for kp, note in ((100.0, ""), (0.1, ", the report's")):
        run = mo.track(
            robot, course_report.motion, mo.ComputedTorque(kp), q0=np.zeros(3),
            duration=course_report.DURATION, saturation=False,
        )  # fmt: skip
        curves.append(mo.plots.Curve.of(run, f"tracked, kp = {kp:g}{note}"))
    panels = {"18": ("qdd", None), "19": ("qd", None), "20": ("q", None)}
    panels |= {f"2{joint + 1}": ("tau", [joint]) for joint in range(3)}
    return {"18_loop": control_loop()} | {
        number: mo.plots.curves(
            robot, curves, [quantity], joints=joints, base=True, title=title(number)
        )
        for number, (quantity, joints) in panels.items()
    }  # fmt: skip


def control_loop() -> Figure:
    """Draw the block diagram of partitioned control, with the loop closed at the measured state."""
    figure, axes = blank((8.5, 3.2), title("18_loop"))
    axes.set(xlim=(0, 17), ylim=(0, 6))
    axes.axis("off")
    boxes = {
        (1.4, 3.0): "trajectory\n$q_d, \\dot q_d, \\ddot q_d$",
        (5.2, 3.0): "$k_p e + k_v \\dot e$\n$k_v = 2\\sqrt{k_p}$",
        (9.3, 3.0): "$M(q)$",
        (15.2, 3.0): "arm",
        (12.2, 0.9): "$V(q, \\dot q) + G(q)$",
    }
    for (x, y), text in boxes.items():
        style = {"boxstyle": "round,pad=0.45", "facecolor": "white", "edgecolor": BLUE}
        axes.text(x, y, text, ha="center", va="center", bbox=style)
    circle = {"boxstyle": "circle,pad=0.25", "facecolor": "white", "edgecolor": INK}
    for x in (3.2, 7.6, 12.2):
        axes.text(x, 3.0, "+", ha="center", va="center", bbox=circle)
    lines = (
        ((2.5, 3.0), (2.9, 3.0)), ((3.5, 3.0), (4.05, 3.0)), ((6.35, 3.0), (7.25, 3.0)),
        ((7.95, 3.0), (8.7, 3.0)), ((9.9, 3.0), (11.85, 3.0)), ((12.55, 3.0), (14.6, 3.0)),
        ((12.2, 1.5), (12.2, 2.6)),
        ((1.4, 3.9), (1.4, 5.2), (7.6, 5.2), (7.6, 3.4)),
        ((15.2, 2.5), (15.2, 0.9), (13.75, 0.9)), ((10.65, 0.9), (3.2, 0.9), (3.2, 2.6)),
    )  # fmt: skip
    for corners in lines:
        axes.plot(*np.array(corners).T, color=INK, linewidth=1)
        axes.annotate("", corners[-1], corners[-2], arrowprops={"arrowstyle": "->", "color": INK})
    notes = {(4.5, 5.35): "$\\ddot q_d$", (3.5, 2.2): "$-$", (13.5, 3.15): "$\\tau$",
             (7.0, 1.05): "measured $q, \\dot q$", (3.75, 3.2): "$e$"}  # fmt: skip
    for (x, y), text in notes.items():
        axes.text(x, y, text, ha="center")
    return figure


def blank(size: tuple[float, float], text: str) -> tuple[Figure, Axes]:
    """Return an empty figure of a size, in inches, with a title."""
    figure = Figure(figsize=size, layout="constrained")
    figure.suptitle(text, fontweight="bold")
    return figure, figure.subplots()


def draw(robot: mo.Robot) -> Mapping[str, Any]:
    """Draw every figure, by its number."""
    motion = mo.simulation.motion_from_formula(
        robot, course_report.motion, course_report.DURATION, label="given"
    )
    drawn = arm(robot) | trajectories(robot)
    parts: tuple[Callable[..., dict[str, Any]], ...] = (given_motion, forward, tracked)
    for part in parts:
        drawn |= part(robot, motion)
    return {f"figure_{number}": drawn[number] for number in CAPTIONS}
