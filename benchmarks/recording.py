"""Recording of five motions of a 7R arm at 1 kHz: ours against logging step by step.

The peer logs as a plain script would: at every sample the pose of every link and of the tool, and
the position, velocity and torque of every joint; 29 entities per motion. Ours logs all of that from
the same samples, and also trails, torque arcs, arrows, lanes, marks, limits and a second timeline.
A further row has the default density of recordings, 200 Hz.
"""

from __future__ import annotations

import subprocess
import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import rerun as rr
import rerun_cli

import microbot_ocp as mo
from benchmarks.measure import Benchmark, timed
from microbot_ocp.views import _scene as scene
from microbot_ocp.views.recording import of_comparison, quaternions

SECONDS = 2.0  # promised time of our recording, s
DURATION = 3.0  # duration of each motion, s
MOTIONS = 5


@cache
def five_motions() -> mo.Comparison:
    """Build quintics of the packaged Panda between random poses, sampled at 1 kHz."""
    robot = mo.load_robot("panda")
    rng = np.random.default_rng(0)
    low, high = robot.limits.bounds("q")
    via = 0.5 * (low + high) + 0.25 * (high - low) * rng.uniform(-1, 1, (MOTIONS + 1, 7))
    entries = []
    for k in range(MOTIONS):
        shape = mo.quintic(via[k : k + 2], [0.0, DURATION])
        motion = mo.Motion.from_polynomial(robot, shape, label=f"motion {k + 1}", step=1e-3)
        entry = mo.tasks.Entry(f"motion_{k + 1}", motion.label, motion, None, "solved", "",
                         np.nan, np.nan, np.nan, {})  # fmt: skip
        entries.append(entry)
    return mo.Comparison(robot, via[:1], robot.limits, tuple(entries), "motion_1")


def ours(path: Path, rate: float) -> None:
    """Write our whole recording."""
    of_comparison(five_motions(), rate).save(path)


def step_by_step(path: Path) -> None:
    """Write poses and curves only, one call per value."""
    robot = five_motions().robot
    stream = rr.RecordingStream("step by step")
    stream.save(path)
    for name, motion in five_motions().motions.items():
        poses = scene.link_poses(robot, motion.q)
        turns = [quaternions(poses[:, k, :3, :3]) for k in range(1, 9)]
        for i, t in enumerate(motion.t):
            stream.set_time("sim_time", duration=t)
            for k, turn in enumerate(turns, start=1):
                pose = rr.Transform3D(translation=poses[i, k, :3, 3], quaternion=turn[i])
                stream.log(f"world/{name}/link_{k}", pose)
            for quantity in scene.QUANTITIES:
                for joint, value in zip(
                    robot.joint_names, getattr(motion, quantity)[i], strict=True
                ):
                    stream.log(f"plots/{quantity}/{joint}/{name}", rr.Scalars(value))
    stream.flush()
    stream.disconnect()


def run(repetitions: int = 0) -> None:
    """Print time, size, and validity of each file."""
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: Path(folder, f"{name}.rrd") for name in ("peer", "full", "default")}
        ways = {
            "ours, 1 kHz": timed("f(path, 1000.0)", f=ours, path=paths["full"]),
            "ours, 200 Hz": timed("f(path, 200.0)", f=ours, path=paths["default"]),
        }
        Benchmark(
            f"Recording of {MOTIONS} motions of {DURATION:g} s, 7R, at 1 kHz; goal {SECONDS:g} s",
            ("step by step", timed("f(path)", f=step_by_step, path=paths["peer"])),
            ways,
        ).run(repetitions or 3)
        rerun = Path(rerun_cli.__file__).parent / "rerun"
        for name, path in paths.items():
            command = [rerun, "rrd", "verify", path]
            valid = subprocess.run(command, capture_output=True, check=False).returncode == 0
            size = path.stat().st_size / 1e6
            print(f"  {name:8s} {size:6.1f} MB, {'valid' if valid else 'NOT VALID'}")
