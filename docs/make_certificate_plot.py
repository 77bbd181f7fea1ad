"""Draw what a certificate looks at: ``docs/images/certificate.png``.

First, the torque of a motion whose limit is kept at every point of a mesh and not between them.
Then the shoulder of an arm that holds 0.5 kg more than the motion's torques were made for,
integrated from the motion's own state again and again. And why not once over the whole time.

    python docs/make_certificate_plot.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import microbot_ocp as mo

TARGET = Path(__file__).resolve().parent / "images" / "certificate.png"
BLUE, RED, GREY = "#0072B2", "#D55E00", "#666666"
SEGMENT = 0.2  # s; certificates take 0.1 s at most
PAYLOAD = 0.5  # kg
NUDGE = 1e-6  # rad
SHOULDER = 1


def figure() -> Figure:
    """The three panels."""
    robot = mo.load_robot("microbot")
    shape = mo.quintic(np.radians([[0, 0, 0], [-90, 90, 90]]), [0.0, 2.0])
    motion = mo.Motion.from_polynomial(robot, shape, label="quintic")
    page = Figure(figsize=(13.0, 4.2), layout="constrained")
    FigureCanvasAgg(page)
    left, right, last = page.subplots(1, 3)

    torque = motion.tau[:, SHOULDER]
    mesh = np.linspace(0.0, motion.t[-1], 8)
    seen = np.interp(mesh, motion.t, torque)
    limit = seen.max()
    left.plot(motion.t, torque, color=BLUE, label="torque, dense grid")
    left.plot(mesh, seen, "o", color=BLUE, label="points of a mesh")
    left.axhline(limit, color=GREY, linestyle="--", label="limit")
    left.fill_between(motion.t, limit, torque, where=torque > limit, color=RED, label="violation")
    left.set(title="Limits between the points", xlabel="time [s]", ylabel="shoulder torque [N m]")
    left.legend(frameon=False)

    plant = robot.with_payload(PAYLOAD)
    right.axhline(0.0, color=BLUE, label="motion")
    for start in np.arange(0.0, motion.t[-1] - 1e-9, SEGMENT):
        part = (motion.t >= start - 1e-9) & (motion.t <= start + SEGMENT + 1e-9)
        t, tau = motion.t[part], motion.tau[part]
        run = mo.simulate(plant, tau, q0=motion.q[part][0], qd0=motion.qd[part][0], t=t)
        label = f"with {PAYLOAD} kg more" if start == 0.0 else None
        missed = np.degrees(run.q - motion.q[part])[:, SHOULDER]
        right.plot(t, missed, color=RED, label=label)
        right.plot(t[0], 0.0, "o", color=RED, markersize=4)
    right.set(
        title="Re-simulation by segments",
        xlabel="time [s]",
        ylabel="shoulder, off the motion [deg]",
    )
    right.legend(frameon=False, loc="upper left")

    raised = mo.quintic(np.radians([[0, 60, 0], [-90, 100, 20]]), [0.0, 3.0])
    motion = mo.Motion.from_polynomial(robot, raised, label="quintic")
    run = mo.simulate(robot, motion.tau, q0=motion.q[0] + NUDGE, qd0=motion.qd[0], t=motion.t)
    last.semilogy(run.t, np.abs(run.q - motion.q).max(axis=1), color=RED)
    last.set(
        title=f"A right motion, once, {1e6 * NUDGE:g} µrad off at first",
        xlabel="time [s]",
        ylabel="largest joint, off the motion [rad]",
    )
    return page


if __name__ == "__main__":
    figure().savefig(TARGET, dpi=110)
    print(TARGET)
