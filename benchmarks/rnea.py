"""Inverse dynamics from Python: ours, compiled, against ``pinocchio.rnea``; frax for comparison."""

from __future__ import annotations

import os
import re
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import microbot_ocp as mo
from benchmarks.measure import Benchmark, timed
from external.pinocchio_model import pinocchio_model
from microbot_ocp._base.fast_calls import buffered_call, table_call

GOAL = 5.0
CALLS = 20_000
BATCH = 1_000
NOTHING = (
    '<inertial><origin xyz="0 0 0"/><mass value="1e-14"/>'
    '<inertia ixx="1e-14" iyy="1e-14" izz="1e-14" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def seven_joints(seed: int = 7) -> mo.Robot:
    """Build a 7R arm with full inertias."""
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


def frax_calls(robot: mo.Robot) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return frax's inverse dynamics of one state and of a batch, compiled in double precision."""
    os.environ.setdefault("JAX_ENABLE_X64", "1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # frax warns about settings of the environment
        import frax
        import jax
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        mo.save_robot(robot, path)
        # frax needs mass properties of every link; those of base and tool have no effect.
        text = re.sub(
            r'<link name="([^"]+)" />', rf'<link name="\1">{NOTHING}</link>', path.read_text()
        )
        path.write_text(text)
        theirs = frax.Robot(str(path))
    upward = np.append(-robot.gravity, np.zeros(3))

    def torque(q: Any, qd: Any, qdd: Any) -> Any:
        return theirs.rnea(q, qd, qdd, upward, None)

    one, many = jax.jit(torque), jax.jit(jax.vmap(torque))
    return (
        lambda *state: one(*state).block_until_ready(),
        lambda *states: many(*states).block_until_ready(),
    )


def compare(robot: mo.Robot, repetitions: int) -> None:
    """Time one state from Python, and a batch of states."""
    count = robot.joint_count
    states = np.random.default_rng(0).uniform(-2, 2, (3, BATCH, count))
    state = [np.ascontiguousarray(rows[0]) for rows in states]
    model = pinocchio_model(robot)
    data = model.createData()
    compiled = mo.inverse_dynamics(robot, compiled=True)
    fast = mo.fast_call(mo.inverse_dynamics(robot))
    theirs = np.array([pin.rnea(model, data, *rows) for rows in states.transpose(1, 0, 2)])
    np.testing.assert_allclose(fast(*states), theirs, rtol=1e-9, atol=1e-8)
    frax_one, frax_batch = frax_calls(robot)
    np.testing.assert_allclose(frax_batch(*states), theirs, rtol=1e-9, atol=1e-8)
    q, qd, qdd = state
    names = {"rnea": pin.rnea, "model": model, "data": data, "q": q, "qd": qd, "qdd": qdd}
    # Bound memory: the caller writes the state in place and reads tau.
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
            "inverse_dynamics(robot)(q, qd, qdd)": timed(
                "make(robot)(q, qd, qdd)",
                CALLS // 50,
                make=mo.inverse_dynamics,
                robot=robot,
                **names,
            ),
            "frax.Robot.rnea, jitted": timed("f(q, qd, qdd)", CALLS // 50, f=frax_one, **names),
        },
        {"fast_call(f)": GOAL},
    ).run(repetitions)

    def one_by_one() -> np.ndarray:
        return np.array([pin.rnea(model, data, *rows) for rows in zip(*states, strict=True)])

    columns = [np.asfortranarray(rows.T) for rows in states]
    table = table_call(mo.inverse_dynamics(robot))
    mapped = buffered_call(mo.inverse_dynamics(robot).map(BATCH))
    Benchmark(
        f"Inverse dynamics of {BATCH} states, {robot.name}",
        ("pinocchio.rnea, one by one", timed("call()", 20, call=one_by_one)),
        {
            "fast_call(f)": timed("f(*states)", 200, f=fast, states=states),
            "table_call(f)": timed("f(*states)", 200, f=table, states=states),
            "buffered_call(f.map(n))": timed("f(*columns)", 20, f=mapped, columns=columns),
            "f, a CasADi map": timed("f(*columns)", 20, f=compiled, columns=columns),
            "frax.Robot.rnea, mapped": timed("f(*states)", 20, f=frax_batch, states=states),
        },
    ).run(repetitions)


def run(repetitions: int = 0) -> None:
    """Time the Microbot and, for the scaling, seven joints."""
    for robot in (mo.load_robot("microbot"), seven_joints()):
        compare(robot, repetitions or 15)
