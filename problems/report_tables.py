"""Numbers and formulas of the course report beside computed ones, each with its erratum.

A printed number is kept as text, so that its digits say how accurate it claims to be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

import course_report
import microbot_ocp as mo
from microbot_ocp.inverse_kinematics import elbow_arm_branches
from symbolic import symbolic_row, symbolic_velocities

# Part 1: the transforms from the base to frames 1 to 4.
PRINTED_POSES = """
-0.9487 -0.31615 0 0; 0.31615 -0.9487 0 0; 0 0 1 2; 0 0 0 1
-0.2589 0.9127 0.3161 0; 0.0863 -0.3041 0.9487 0; 0.9620 0.2730 0 2; 0 0 0 1
0.9443 -0.0916 0.3161 -0.7769; -0.3147 -0.0305 0.9487 0.2589; -0.0965 -0.9953 0 4.8861; 0 0 0 1
0.9443 -0.0916 0.3161 3.0003; -0.3147 0.0305 0.9487 -0.9999; -0.0965 -0.9953 0 4.4999; 0 0 0 1
"""
# Part 2: four solutions, deg, in the order of the report, and the transform of each to the tool.
PRINTED_SOLUTIONS = """
-18.4349 105.8439 -111.3819
-18.4349 -29.1863 111.3819
161.5651 74.1561 111.3819
161.5651 -150.8137 -111.3819
"""
PRINTED_REACHED = """
0.9443 0.0916 -0.3162 3.0; -0.3148 -0.0305 -0.9487 -1.0; -0.0965 0.9953 0 4.5; 0 0 0 1
0.1288 -0.9399 -0.3162 3.0; -0.0429 0.3133 -0.9487 -1.0; 0.9907 0.1358 0 4.5; 0 0 0 1
0.9443 -0.0916 0.3162 3.0; -0.3148 0.0305 0.9487 -1.0; -0.0965 -0.9953 0 4.5; 0 0 0 1
0.1288 0.9399 0.3162 3.0; -0.0429 -0.3133 0.9487 -1.0; 0.9907 -0.1358 0 4.5; 0 0 0 1
"""
# Part 3.2: angular and linear velocity of frames 1 to 4, each in its own frame, rad/s and m/s.
PRINTED_ANGULAR = (
    "0 0 0.6109; -0.2978 0.5333 0.3491; -0.3881 -0.4718 1.1345; -0.3881 -0.4718 1.1345"
)
PRINTED_LINEAR = "0 0 0; 0 0 0; -0.9751 -0.3818 1.6000; -0.9751 4.1561 0.2870"
PRINTED_TWIST = "-0.9751 4.1561 0.2870 -0.3881 -0.4718 1.1345"
POSITION = (3.0, -1.0, 4.5)  # m, the target of parts 1 and 2
ROUNDED = (161.57, 74.16, 111.38)  # deg, the angles that the matrices of part 1 belong to
LISTING = (-86.41, 22.886, -3.415)  # deg, in the program of part 1
THETA, RATE = (-18.43, -29.18, -111.38), (35.0, 20.0, 45.0)  # deg and deg/s, part 3.2

# part -> rows of (place, the report, right)
FORMULAS = {
    "3.1": (
        (
            "omega3",
            "qd1 + qd2 + qd3",
            "qd1 + qd2: frame 3 of Craig's example is fixed to link 2; v3 is not affected",
        ),
        ("v2", "its commas are lost", "[L1 s2 qd1, L1 c2 qd1, 0]"),
    ),
    "4a": (
        (
            "moment balance",
            "headed f_i again, one rotation doubled",
            "n_i = N_i + R n_i+1 + Pc_i x F_i + P_i+1 x R f_i+1",
        ),
        ("gravity", "vd0 = [0; g; 0], along the base's Y axis", "vd0 = [0; 0; g]"),
        ("code", "tdd2 = diff(td3)", "diff(td2); harmless: all joints move alike"),
        ("N2, N3", "omega and inertia of the link before", "their own; harmless: point masses"),
    ),
    "4b": (
        ("gravity", "g = 0, and 9.8 in part 4a", "equal, or the torques move the arm otherwise"),
        (
            "acceleration",
            "(tau - V - G) inv(M), M along the reference",
            "a linear solve M(q) qdd = tau - V - G at the integrated state",
        ),
        ("tau", "holds qdd itself", "M^-1 M qdd = qdd, so the torques are only plotted"),
        ("Euler", "steps as long as the elapsed time", "0.05 s"),
        ("derivatives", "`gradient` of a symbolic scalar", "d/dt"),
        ("start", "0.8 rad put in by hand", "q(0) = -45 deg = -0.785 rad, at rest"),
    ),
    "5": (
        (
            "cubic, a3",
            "[2 (q0 - qf) - (v0 + vf) T] / T^3",
            "[2 (q0 - qf) + (v0 + vf) T] / T^3; the code is right",
        ),
        (
            "LSPB, V",
            "qf - q0 - tb (v0 - vf) / (2 (tf - tb - t0))",
            "[qf - q0 - tb (v0 + vf)/2] / (tf - t0 - tb); the code is right",
        ),
        ("LSPB, blends", "up to t_h, and V t - t0", "up to t_b, and V (t - t0)"),
        (
            "via point",
            "no word of the acceleration",
            "it jumps at 2 s: cubic (-3.05, -0.44, 0.96), LSPB (-2.91, -1.16, 0.47) rad/s^2",
        ),
    ),
    "6": (
        (
            "feedback",
            "frozen at zero; q and qd integrate the reference",
            "tau = M (qdd_d + kv e' + kp e) + V + G at the measured state; no loop is closed",
        ),
        ("gain", "kp = 0.1 1/s^2", "settles in tens of seconds; kp = 100 in 1 s"),
        ("code", "ac3 = acceleration(2)", "acceleration(3)"),
        ("figures", "two are called Fig. 18", "18 (loop) and 18 (acceleration) here"),
    ),
}


class Row(NamedTuple):
    """A line of numbers: as printed, as computed, with an erratum or an explanation."""

    name: str
    printed: str
    computed: np.ndarray
    erratum: str = ""

    @property
    def agrees(self) -> bool:
        """True where no number is off by more than one unit of its last printed digit."""
        texts = self.printed.split()
        steps = [10.0 ** -len(text.partition(".")[2]) for text in texts]
        off = np.abs(np.array(texts, float) - self.computed)
        return bool((off <= np.array(steps)).all())

    def __str__(self) -> str:
        ours = (f"{value + 0.0:.4f}" for value in self.computed.round(4))
        sides = ("".join(f"{text:>10}" for text in side) for side in (self.printed.split(), ours))
        return f"  {self.name:8s}" + "   |".join(sides) + f"   {self.erratum}".rstrip()


def matrices(text: str) -> list[list[str]]:
    """Split printed matrices, one a line, into the text of their rows."""
    return [line.split("; ") for line in text.strip().splitlines()]


def pose(robot: mo.Robot, q_deg: Sequence[float], frame: int | None = None) -> np.ndarray:
    """Return the transform [4,4] from the base to a frame, by default the tool's."""
    function = (
        mo.forward_kinematics(robot) if frame is None else mo.forward_kinematics(robot, frame)
    )
    return np.array(function(np.radians(q_deg)))


def part_1(robot: mo.Robot) -> Iterator[str | Row]:
    yield "Part 1, forward kinematics: transforms to the base, theta = (161.57, 74.16, 111.38) deg"
    for frame, printed in enumerate(matrices(PRINTED_POSES), 1):
        ours = pose(robot, ROUNDED, frame if frame < 4 else None)
        for i, text in enumerate(printed):
            erratum = "entry (2, 2) is +0.0305: a misprint" if (frame, i) == (3, 1) else ""
            if frame == 4 and i < 3:
                erratum = "as above" if i else "tool at (3, -1, 4.5) m: its angles are rounded"
            yield Row(f"frame {frame}" if not i else "", text, ours[i], erratum)
    yield Row("tool [m]", "3 -1 4.5", pose(robot, (161.5651, 74.1561, 111.3819))[:3, 3],
              "for (161.5651, 74.1561, 111.3819) deg")  # fmt: skip
    yield Row("listing", "3.0003 -0.9999 4.4999", pose(robot, LISTING)[:3, 3],
              f"its program has theta = {LISTING} deg, of another run")  # fmt: skip


def part_2(robot: mo.Robot) -> Iterator[str | Row]:
    yield "Part 2, inverse kinematics of (3, -1, 4.5) m: joint angles, deg, by the law of cosines"
    solutions = PRINTED_SOLUTIONS.strip().splitlines()
    ours = np.degrees(elbow_arm_branches(POSITION))
    for k, (text, q) in enumerate(zip(solutions, ours, strict=True), 1):
        yield Row(f"no. {k}", text, (q + 180.0) % 360.0 - 180.0)
    for k, (printed, q) in enumerate(zip(matrices(PRINTED_REACHED), ours, strict=True), 1):
        reached = pose(robot, q)
        for i, text in enumerate(printed):
            yield Row(f"tool {k}" if not i else "", text, reached[i])


def part_3(robot: mo.Robot) -> Iterator[str | Row]:
    yield "Part 3.1, Craig's example 5.3: velocities of each frame in its own, computed"
    rows = [symbolic_row(0, 0, 0, joint=1), symbolic_row(0, "L1", 0, joint=2)]
    rows.append(symbolic_row(0, "L2", 0))
    for i, (v, omega) in enumerate(symbolic_velocities(rows, ["qd1", "qd2", None]), 1):
        angular, linear = (", ".join(map(str, entries)) for entries in (omega, v))
        yield f"  omega{i} = [{angular}]   v{i} = [{linear}]"
    yield from formulas("3.1")
    yield f"Part 3.2, the Microbot at {THETA} deg with {RATE} deg/s"
    misplaced = "that of (161.57, -150.81, -111.38) deg: solution 4 of part 2"
    for i, text in enumerate(matrices(PRINTED_REACHED)[3]):
        erratum = ("as above" if i else misplaced) if i < 3 else ""
        yield Row("" if i else "frame 4", text, pose(robot, THETA)[i], erratum)
    q, qd = np.radians(THETA), np.radians(RATE)
    linear, angular = (np.array(velocity) for velocity in mo.velocity_propagation(robot)(q, qd))
    for name, ours, printed in (("omega", angular, PRINTED_ANGULAR), ("v", linear, PRINTED_LINEAR)):
        for i, text in enumerate(printed.split("; ")):
            erratum = "-1.6: v4, as printed, follows from it" if (name, i) == ("v", 2) else ""
            yield Row(f"{name}{i + 1}", text, ours[:, i], erratum)
    twist = np.array(mo.jacobian(robot)(q) @ qd).ravel()
    yield Row("twist", PRINTED_TWIST, np.concatenate([linear[:, 3], angular[:, 3]]),
              "no frame is named: it is the tool's")  # fmt: skip
    yield "  in the base frame: " + " ".join(f"{value:.4f}" for value in twist)


def part_4(robot: mo.Robot) -> Iterator[str | Row]:
    yield "Part 4a, inverse dynamics: curves without numbers (Fig. 4 to 7)"
    for name, gravity in course_report.GRAVITY.items():
        moved = mo.simulation.motion_from_formula(
            robot.with_gravity(gravity), course_report.motion, course_report.DURATION, label=name
        )
        peak = np.abs(moved.resample(1 / course_report.STEP).tau).max(axis=0)
        yield f"  peak |tau| [N m], gravity {name:24s}" + "".join(f"{x:10.2f}" for x in peak)
    yield from formulas("4a")
    yield "Part 4b, forward dynamics: curves without numbers (Fig. 8 to 11)"
    given = mo.simulation.motion_from_formula(
        robot, course_report.motion, course_report.DURATION, label="given"
    )
    ends = {
        "its loop": course_report.code_euler(given)[-1],
        "Euler's method, 0.05 s": course_report.euler(robot, given, course_report.STEP)[-1],
    }
    for name, q in ends.items():
        off = np.degrees(q - given.q[-1])
        yield f"  error of q at 2 s [deg], {name:24s}" + "".join(f"{x:12.2f}" for x in off)
    yield from formulas("4b")


def part_5(robot: mo.Robot) -> Iterator[str | Row]:
    yield "Part 5, trajectories: curves without numbers (Fig. 12 to 17)"
    shapes = {
        "cubic": mo.cubic(course_report.VIA_Q, course_report.VIA_T, course_report.VIA_QD),
        "LSPB": mo.lspb(
            course_report.VIA_Q, course_report.VIA_T, course_report.BLEND, course_report.VIA_QD
        ),
    }
    for name, shape in shapes.items():
        moved = mo.Motion.from_polynomial(robot, shape, label=name)
        for unit, values in (("|tau| [N m]", moved.tau), ("|qd| [rad/s]", moved.qd)):
            peak = np.abs(values).max(axis=0)
            yield f"  peak {name:6s} {unit:14s}" + "".join(f"{x:10.3f}" for x in peak)
    yield from formulas("5")


def part_6(robot: mo.Robot) -> Iterator[str | Row]:
    yield "Part 6, partitioned control: curves without numbers (Fig. 18 to 23)"
    for kp in (0.1, 100.0):
        law, start = mo.ComputedTorque(kp), np.zeros(3)
        run = mo.track(
            robot,
            course_report.motion,
            law,
            q0=start,
            duration=course_report.DURATION,
            saturation=False,
        )
        error = np.degrees(run.error[[0, -1], 0])
        yield f"  kp = {kp:5g} 1/s^2: error {error[0]:.0f} deg at 0 s, {error[1]:.2g} deg at 2 s"
    yield from formulas("6")


def formulas(part: str) -> Iterator[str]:
    """Yield the formulas of a part that are wrong, each with the right one."""
    for place, printed, right in FORMULAS[part]:
        yield f"  {place}\n    report: {printed}\n    right:  {right}"


def show(robot: mo.Robot) -> bool:
    """Print every table; return True where each wrong number has an erratum."""
    explained = True
    print("left of the line the report's number, right of it the computed one, then the erratum")
    for part in (part_1, part_2, part_3, part_4, part_5, part_6):
        for entry in part(robot):
            if isinstance(entry, str):
                title = not entry.startswith(" ")
                print(f"\n{entry}" if title else entry)
                continue
            unknown = not entry.agrees and not entry.erratum
            explained = explained and not unknown
            print(f"{entry}   DIFFERS" if unknown else entry)
    return explained
