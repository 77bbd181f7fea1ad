"""Inverse dynamics from Python: ours, compiled, against ``pinocchio.rnea``."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import microbot_ocp as mo
from benchmarks.measure import Benchmark, timed
from external.pinocchio_model import pinocchio_model

GOAL = 5.0
CALLS = 20_000
BATCH = 1_000


def seven_joints(seed: int = 7) -> mo.Robot:
    """A 7R arm with full inertias."""
    random = np.random.default_rng(seed)
    links = []
    for _ in range(7):
        spread = random.normal(size=(3, 3))
        second_moment = 0.1 * spread @ spread.T + 0.01 * np.eye(3)
        inertia = np.trace(second_moment) * np.eye(3) - second_moment
        links.append(mo.Link(random.uniform(0.5, 5.0), random.uniform(-0.5, 0.5, 3), inertia))
    return mo.Robot.from_dh(
        alpha=random.uniform(-np.pi, np.pi, 7),
        a=random.uniform(-0.5, 0.5, 7),
        d=random.uniform(-0.5, 0.5, 7),
        links=links,
        name="random 7R",
    )


def compare(robot: mo.Robot, repetitions: int) -> None:
    """One state from Python, then a batch of them."""
    count = robot.joint_count
    states = np.random.default_rng(0).uniform(-2, 2, (3, BATCH, count))
    state = [np.ascontiguousarray(rows[0]) for rows in states]
    model = pinocchio_model(robot)
    data = model.createData()
    compiled = mo.inverse_dynamics(robot, compiled=True)
    fast = mo.fast_call(mo.inverse_dynamics(robot))
    theirs = np.array([pin.rnea(model, data, *rows) for rows in states.transpose(1, 0, 2)])
    np.testing.assert_allclose(fast(*states), theirs, rtol=1e-9, atol=1e-8)
    q, qd, qdd = state
    names = {"rnea": pin.rnea, "model": model, "data": data, "q": q, "qd": qd, "qdd": qdd}
    # memory bound once: the caller writes the state in place and reads tau
    buffer, run_in_place = compiled.buffer()
    tau = np.zeros(count)
    for i, array in enumerate(state):
        buffer.set_arg(i, memoryview(array))
    buffer.set_res(0, memoryview(tau))

    Benchmark(
        f"One inverse dynamics call, {robot.name}",
        (
            "pinocchio.rnea(model, data, q, qd, qdd)",
            timed("rnea(model, data, q, qd, qdd)", CALLS, **names),
        ),
        {
            "fast_call(f)": timed("f(q, qd, qdd)", CALLS, f=fast, **names),
            "f.buffer(), state written in place": timed("run()", CALLS, run=run_in_place),
            "f, a CasADi call": timed("f(q, qd, qdd)", CALLS // 50, f=compiled, **names),
        },
        {"fast_call(f)": GOAL},
    ).run(repetitions)

    def one_by_one() -> np.ndarray:
        return np.array([pin.rnea(model, data, *rows) for rows in zip(*states, strict=True)])

    columns = [np.asfortranarray(rows.T) for rows in states]
    Benchmark(
        f"Inverse dynamics of {BATCH} states, {robot.name}",
        ("pinocchio.rnea, one by one", timed("call()", 20, call=one_by_one)),
        {
            "fast_call(f)": timed("f(*states)", 200, f=fast, states=states),
            "f, a CasADi map": timed("f(*columns)", 20, f=compiled, columns=columns),
        },
    ).run(repetitions)


def run(repetitions: int = 0) -> None:
    """The Microbot and, to see how it scales, seven joints."""
    for robot in (mo.load_robot("microbot"), seven_joints()):
        compare(robot, repetitions or 15)
