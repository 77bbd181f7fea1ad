"""One hand-made comparison: three solved motions of the packaged arm, one failure."""

import numpy as np
import pytest

from microbot_ocp import Status
from microbot_ocp.certificate import Certificate, LimitCheck
from microbot_ocp.limits import quantity_name
from microbot_ocp.motion import Mark, Motion, PiecewisePolynomial
from microbot_ocp.robot.files import load_robot
from microbot_ocp.tasks import Comparison, Entry

VIA_Q = np.radians([[0.0, 0.0, 0.0], [-8.0, 45.0, 30.0], [-90.0, 90.0, 90.0]])


def cubic_motion(robot, times, via_qd, label, via_q=VIA_Q):
    """Cubics through the via points at ``times`` with given velocities there."""
    times = np.asarray(times, dtype=float)
    h = np.diff(times)[:, None]
    q0, q1, v0, v1 = via_q[:-1], via_q[1:], via_qd[:-1], via_qd[1:]
    c2 = 3 * (q1 - q0) / h**2 - (2 * v0 + v1) / h
    c3 = -2 * (q1 - q0) / h**3 + (v0 + v1) / h**2
    polynomial = PiecewisePolynomial(times, np.stack([q0, v0, c2, c3], axis=1))
    marks = [Mark(float(time), f"via {k + 1}") for k, time in enumerate(times)]
    return Motion.from_polynomial(robot, polynomial, label=label, marks=marks)


def certificate_of(robot, limits, motion, label):
    """Certificate from the samples themselves: enough to show, no proof."""
    checks = []
    for quantity in ("q", "qd", "tau"):
        values = getattr(motion, quantity)
        _, upper = limits.bounds(quantity)
        share = np.where(np.isfinite(upper), np.abs(values / upper), np.nan)
        worst = np.unravel_index(np.nanargmax(share), share.shape)
        checks.append(
            LimitCheck(
                quantity=quantity,
                name=quantity_name(quantity),
                labels=robot.joint_names,
                utilisation=np.nanmax(share, axis=0),
                violation=max(0.0, float(share[worst]) - 1.0),
                joint=robot.joint_names[worst[1]],
                time=float(motion.t[worst[0]]),
                value=float(values[worst]),
                limit=float(upper[worst[1]] * np.sign(values[worst])),
                unit=robot.unit(quantity, int(worst[1])),
            )
        )
    excess = max(check.violation for check in checks)
    return Certificate(
        label=label,
        ok=excess < 1e-3,
        verdict="every limit holds" if excess < 1e-3 else f"a limit is broken by {excess:.1%}",
        limit_checks=tuple(checks),
        final_position_error=3e-9,
        final_velocity_error=4e-8,
        resimulation_status=Status.SOLVED,
        grid_step=1e-3,
        grid_ratio=10.0,
        condition_peak=412.0,
        condition_time=0.4,
        saturated_fraction=0.31,
    )


def solved(robot, limits, name, title, motion, note=""):
    squares = (motion.tau**2).sum(axis=1)
    power = np.abs(motion.tau * motion.qd).sum(axis=1)
    return Entry(
        name=name,
        title=title,
        motion=motion,
        certificate=certificate_of(robot, limits, motion, name),
        status="solved",
        note=note,
        solve_time=0.0123,
        torque_squared=float(np.trapezoid(squares, motion.t)),
        work=float(np.trapezoid(power, motion.t)),
        details={},
    )


def failed(name, title, status, note):
    return Entry(name, title, None, None, status, note, 0.4, np.nan, np.nan, {})


def make_comparison():
    robot = load_robot("microbot")
    limits = robot.limits
    still = np.zeros((3, 3))
    through = np.array([[0, 0, 0], [-0.9, 1.1, 1.3], [0, 0, 0]], dtype=float)
    entries = (
        solved(
            robot,
            limits,
            "cubic_report",
            "cubic, as in the report",
            cubic_motion(robot, [0, 1.6, 3.4], still, "cubic_report"),
            "stops at the via point",
        ),
        solved(
            robot,
            limits,
            "cubic",
            "cubic, scaled",
            cubic_motion(robot, [0, 1.2, 2.6], 0.6 * through, "cubic"),
        ),
        solved(
            robot,
            limits,
            "time_optimal",
            "time-optimal, free",
            cubic_motion(robot, [0, 0.7, 1.5], 1.1 * through, "time_optimal"),
            "a stand-in: too fast for the waist",
        ),
        failed("lspb", "LSPB, scaled", "infeasible", "the blends overlap at the second via point"),
    )
    return Comparison(robot, VIA_Q, limits, entries, "cubic_report")


@pytest.fixture(scope="session")
def comparison():
    return make_comparison()


@pytest.fixture(scope="session")
def solved_entry():
    """Function (robot, limits, name, title, motion) -> Entry."""
    return solved
