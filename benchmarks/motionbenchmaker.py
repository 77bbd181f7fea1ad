"""MotionBenchMaker under torque limits: published planning problems with a proof of every limit.

    python -m benchmarks motionbenchmaker --data FOLDER [--robot panda --family box --count 20]

FOLDER holds ``panda`` and ``ur5`` as ``resources`` of github.com/KavrakiLab/vamp does (Apache-2.0):
URDF, SRDF, meshes and, unpacked from ``problems.tar.bz2``, the folders
``problems/FAMILY_ROBOT`` with ``scene0001.yaml`` and ``request0001.yaml`` (C. Chamzas et al.,
MotionBenchMaker, IEEE Robotics and Automation Letters 7, 2022). ``--out FILE`` keeps a line of JSON
for every problem and goes on where that file ends; a figure is drawn beside it. ``--jobs 2`` solves
on dask, ``--client tcp://HOST:8786`` on the workers of a running scheduler. Any other arm and any
family of MoveIt scenes and requests may lie in FOLDER under such names; the limits are those of the
URDF.

Panda: identified dynamics and the maker's limits of the packaged robot, torque rates among them,
with the maker's figures of its hand. UR5: masses and inertias of its URDF (ur_description of
ROS-Industrial, Robotiq's gripper and sensor with them), torques of the URDF (UR's maximum joint
torques), 180 degrees a second; no torque rates are published.

The usual chain is RRT-Connect, shortcuts, parabolas at corners and the best timing by toppra, which
keeps torques, speeds and accelerations at its grid points, but no torque rates or dry friction.
A further column is the first path of our search, timed by our reachability under torques with
friction, but without torque rates. ``--page FILE`` writes all tables
at the end of a page; docs/motionbenchmaker.md has parts of them.
``--conditions curobo curobo-torque`` solves the Panda's problems under the limits of cuRobo's
benchmark, with tool poses as goals and without the chain, and compares the motion times with those
that are published (benchmarks/curobo.py); ``makers-poses`` solves them under the makers' limits.
The original meshes are checked by pinocchio and coal against the original boxes and cylinders, at
places along the motion, without our capsules.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import statistics
import warnings
from collections.abc import Iterable
from contextlib import nullcontext
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import toppra
from matplotlib.figure import Figure

import microbot_ocp as mo
from benchmarks import curobo
from benchmarks.scenes import read
from external.toppra_timing import PolynomialPath, even_grid, toppra_problem
from microbot_ocp._base import deadline
from microbot_ocp.scene import Surroundings, detour
from microbot_ocp.views.plots import styled

ROBOTS = ("panda", "ur5")
CAPSULES = {"ur5": 3}  # capsules per link with which most starts and goals are free; others 2
DEVELOPING = ("box", "table_pick", "bookshelf_small", "bookshelf_tall")
IN_TIME = 60.0  # processor time above which a task does not count as solved, s
MARKS = "<!-- made by benchmarks motionbenchmaker -->\n", "<!-- end of the tables -->\n"
POSES, DISTANCES = 500, 50  # poses of a motion with a check of meshes, and with their distances
# Mass, centre of mass and inertia of the Franka hand with closed fingers, in the flange, summed in
# github.com/frankaemika/franka_description, end_effectors/franka_hand/inertials.yaml, commit
# 0b5034b.
HAND = (
    0.7126,
    [0.00771, 0.00776, 0.0256],
    [[0.001298, -0.000791, 1.3e-5], [-0.000791, 0.001298, 1.3e-5], [1.3e-5, 1.3e-5, 0.001765]],
)


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks motionbenchmaker", description=__doc__
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--robot", nargs="*", default=ROBOTS)
    parser.add_argument("--family", nargs="*", default=DEVELOPING)
    parser.add_argument(
        "--conditions", choices=curobo.CONDITIONS, nargs="*", default=curobo.CONDITIONS[:1]
    )
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--limit", type=float, default=IN_TIME, help="s of processor time")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--client", help="address of a dask scheduler")
    parser.add_argument("--out", type=Path, default=Path("out/motionbenchmaker.jsonl"))
    parser.add_argument("--page", type=Path, help="Markdown to write the tables into")
    options = parser.parse_args(arguments)
    for robot, family in itertools.product(options.robot, options.family):
        place = options.data / robot / "problems" / f"{family}_{robot}"
        if not place.is_dir():
            parser.error(f"--data, --robot and --family need the folder {place}")
    rows = [{"conditions": "makers", **row} for row in read(options.out)]
    done = {(row["robot"], row["family"], row["number"], row["conditions"]) for row in rows}
    numbers = range(options.first, options.first + options.count)
    cases = itertools.product(numbers, options.family, options.conditions, options.robot)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    todo = [
        (options.data, robot, family, number, conditions, options.limit)
        for number, family, conditions, robot in cases
        if (robot, family, number, conditions) not in done
        and (robot == "panda" or conditions in curobo.OWN)
    ]
    for row in _rows(todo, options.jobs, options.client):
        rows.append(row)
        print(line(row), flush=True)
        with options.out.open("a") as file:
            file.write(json.dumps(row) + "\n")
    print(report(rows))
    draw(rows, options.out.with_suffix(".png"))
    if options.page:
        publish(rows, options.page)


def publish(rows: list[dict[str, Any]], page: Path) -> None:
    """Write the tables into a page, and the figure into its images."""
    rows = sorted(rows, key=lambda row: (row["robot"], row["family"], row["number"]))
    before, _, rest = page.read_text("utf-8").partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    page.write_text(f"{before}{MARKS[0]}\n{report(rows)}\n\n{MARKS[1]}{after}", "utf-8")
    draw(rows, page.parent / "images" / f"{page.stem}.png")


def _rows(cases: list[tuple[Any, ...]], jobs: int, address: str | None) -> Any:
    """Yield the rows of cases in the order in which they finish."""
    if (jobs == 1 and address is None) or not cases:
        yield from (measured(*case) for case in cases)
        return
    from distributed import Client, LocalCluster, as_completed

    local = {"threads_per_worker": 1, "dashboard_address": None}
    with (
        nullcontext(address) if address else LocalCluster(jobs, **local) as cluster,
        Client(cluster) as client,
    ):
        futures = client.map(lambda case: measured(*case), cases, pure=False)
        yield from (future.result() for future in as_completed(futures))


@lru_cache
def arm(folder: Path, name: str) -> mo.Robot:
    """Load an arm with capsules, a published model's dynamics and the manufacturer's limits."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", mo.robot.RobotFileWarning)
        robot = mo.robot.load_urdf(folder / name / f"{name}.urdf")
    if name == "panda":
        packaged = mo.load_robot(name)
        zero, links = np.zeros(robot.joint_count), []
        for frame, link in enumerate(packaged.links, start=1):
            theirs, ours = (
                np.array(mo.forward_kinematics(r, frame=frame)(zero)) for r in (packaged, robot)
            )
            turn, shift = np.hsplit(np.linalg.solve(ours, theirs)[:3], [3])
            center = turn @ link.center_of_mass + shift[:, 0]
            inertia = turn @ link.inertia @ turn.T
            links.append(replace(link, center_of_mass=center, inertia=(inertia + inertia.T) / 2))
        robot = robot.with_links(links).with_limits(packaged.limits).with_payload(*HAND)
    elif name == "ur5":
        robot = robot.with_limits(qd_max=np.pi)
    return robot.with_capsules(mo.fit_capsules(robot, most=CAPSULES.get(name, 2)))


@cache
def surface_of(path: str, *scale: float) -> Any:
    """Return the triangles of a mesh file for coal, read by trimesh; cached.

    coal's own reader joins wrong corners where a file has several materials.
    """
    import coal
    import trimesh

    mesh = trimesh.load(path, force="mesh", process=False)
    places, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for place in np.asarray(mesh.vertices) * scale:
        places.append(place)
    for corners in np.asarray(mesh.faces).tolist():
        triangles.append(coal.Triangle(*corners))
    surface = coal.BVHModelOBBRSS()
    surface.beginModel(len(mesh.faces), len(mesh.vertices))
    surface.addSubModel(places, triangles)
    surface.endModel()
    return surface


class Meshes:
    """Original meshes of an arm among the original boxes and cylinders."""

    def __init__(self, folder: Path, robot: mo.Robot, name: str, scene: mo.Scene) -> None:
        import coal

        text = (folder / name / f"{name}.urdf").read_text()
        text = re.sub(
            r'filename="(package://)?meshes', f'filename="{folder.absolute() / name}/meshes', text
        )
        self.model = pin.buildModelFromXML(text)
        self.geometry = pin.buildGeomFromUrdfString(self.model, text, pin.GeometryType.COLLISION)
        self.geometry.addAllCollisionPairs()
        pin.removeCollisionPairs(self.model, self.geometry, str(folder / name / f"{name}.srdf"))
        for body in self.geometry.geometryObjects:
            if Path(body.meshPath).is_file():
                body.geometry = surface_of(body.meshPath, *np.ravel(body.meshScale).tolist())
        moving = [k for k, g in enumerate(self.geometry.geometryObjects) if g.parentJoint]
        for obstacle in scene.obstacles:
            if isinstance(obstacle, mo.Box):
                shape, place = coal.Box(*obstacle.size), pin.SE3(obstacle.pose)
            elif isinstance(obstacle, mo.Cylinder):
                shape = coal.Cylinder(obstacle.radius, obstacle.length)
                place = pin.SE3(obstacle.pose)
            elif isinstance(obstacle, mo.Sphere):
                shape, place = coal.Sphere(obstacle.radius), pin.SE3(np.eye(3), obstacle.center)
            else:
                raise TypeError(f"{obstacle.name}: {type(obstacle).__name__} is not checked here")
            placed = pin.GeometryObject(obstacle.name, 0, 0, place, shape)
            index = self.geometry.addGeometryObject(placed)
            for link in moving:
                self.geometry.addCollisionPair(pin.CollisionPair(link, index))
        self.data, self.found = self.model.createData(), pin.GeometryData(self.geometry)
        self.places = [self.model.joints[self.model.getJointId(j)].idx_q for j in robot.joint_names]

    def free(self, poses: np.ndarray) -> bool:
        """Return True if nothing touches in poses [N,n]."""
        return not any(
            pin.computeCollisions(
                self.model, self.data, self.geometry, self.found, self._q(q), True
            )
            for q in poses
        )

    def apart(self, poses: np.ndarray) -> float:
        """Return the least distance of all pairs in poses [N,n], m."""
        least = np.inf
        for q in poses:
            pin.computeDistances(self.model, self.data, self.geometry, self.found, self._q(q))
            least = min(least, *(result.min_distance for result in self.found.distanceResults))
        return least

    def _q(self, pose: np.ndarray) -> np.ndarray:
        q = pin.neutral(self.model)
        q[self.places] = pose
        return q


def measured(
    folder: Path, name: str, family: str, number: int, conditions: str, limit: float
) -> dict[str, Any]:
    """Solve one problem, under the makers' limits by the usual chain as well; return the row."""
    own = arm(folder, name)
    robot = curobo.under(own, conditions)
    place = folder / name / "problems" / f"{family}_{name}"
    scene = mo.load_scene(place / f"scene{number:04d}.yaml")
    via = mo.scene.load_request(place / f"request{number:04d}.yaml", robot)
    meshes = Meshes(folder, robot, name, scene)
    row: dict[str, Any] = {"robot": name, "family": family, "number": number}
    row["conditions"] = conditions
    row["ends_free_by_meshes"] = meshes.free(via)
    makers = conditions == "makers"
    row["chain"] = chain(robot, scene, via) if makers else None
    task = via if makers else curobo.pose_goal(robot, via)
    watch = curobo.Stopwatch()
    try:
        with deadline.of_work(limit):
            motion = mo.time_optimal(robot, task, scene=scene, progress=None if makers else watch)
    except mo.InputError as problem:
        return row | {"outcome": "refused", "why": str(problem), "processor": watch.spent}
    spent = watch.spent
    certificate = mo.certify(robot, motion, via_q=task, scene=scene)
    clearance = motion.provenance["clearance"]
    good = motion.solved and certificate.ok and clearance["proved"]
    known = certificate.ok and clearance["proved"]
    samples = motion.sample(np.linspace(0.0, motion.duration, POSES))
    q = samples.q
    return row | {
        "outcome": "solved" if good else "known motion" if known else "not certified",
        "status": str(motion.status),
        "why": "" if good else motion.advice,
        "duration": motion.duration,
        "path": min((p["duration"] for p in motion.provenance.get("paths", ())), default=None),
        "stages": {
            "planning": motion.provenance.get("planning_time", 0.0) if makers else watch.planning,
            **{entry.strategy: entry.seconds for entry in motion.outcome.ledger or ()},
            "all": motion.provenance.get("wall_time", spent),
        },
        "first": motion.provenance.get("first_certified"),
        "processor": spent,
        "clearance": clearance["at_least"],
        "verdict": certificate.verdict,
        "free_by_meshes": meshes.free(q),
        "clearance_of_meshes": meshes.apart(q[:: POSES // DISTANCES]),
        **curobo.torques(own, conditions, samples),
    }


def chain(robot: mo.Robot, scene: mo.Scene, via: np.ndarray) -> float | None:
    """Return the duration of the usual chain, s; None without a path or a timing of it."""
    around = Surroundings(robot.with_limits(taud_max=np.inf), scene)
    if not all(map(around.is_free, via)):
        return None
    path = detour(around, *via, seed=0, number=0).path
    if path is None:
        return None
    task = toppra_problem(robot, path, even_grid(path, 500))
    limits = [*task.constraints]
    bounds = np.column_stack(robot.limits.bounds("qdd"))
    if np.isfinite(bounds).all():
        limits.append(toppra.constraint.JointAccelerationConstraint(bounds))
    whole = toppra.algorithm.TOPPRA(
        limits,
        PolynomialPath(path),
        gridpoints=even_grid(path, 500),
        solver_wrapper="seidel",
        parametrizer="ParametrizeConstAccel",
    )
    trajectory = whole.compute_trajectory(0.0, 0.0)
    return None if trajectory is None else float(trajectory.duration)


def line(row: dict[str, Any]) -> str:
    head = f"{name_of(row):5s} {row['family']:16s} {row['number']:3d} {row['outcome']}"
    if "duration" not in row:
        return f"{head}: {row['why']}"
    first, usual = (f"{row[k]:.3f} s" if row[k] else "none" for k in ("first", "chain"))
    free = "free" if row["free_by_meshes"] else "IN CONTACT"
    return (
        f"{head}: {row['duration']:.3f} s, chain {usual}, first {first}, all "
        f"{row['processor']:.1f} s of processor time, {1e3 * row['clearance']:.2f} mm, "
        f"meshes {free}"
    )


def report(rows: list[dict[str, Any]]) -> str:
    """Return Markdown tables of the record: results, unsolved problems, shares of the time."""
    results = [curobo.comparison, curobo.families] if compared(rows) else [table]
    return "\n\n".join(part(rows) for part in (*results, unsolved, stages))


def compared(rows: list[dict[str, Any]]) -> bool:
    """Return True if a record holds problems under the conditions of others."""
    return any(row["conditions"] != "makers" for row in rows)


def name_of(row: dict[str, Any]) -> str:
    """Return the name of the arm and of the conditions that others set."""
    makers = row["conditions"] == "makers"
    return row["robot"] if makers else f"{row['robot']} {row['conditions']}"


def median(values: Iterable[float | None], text: str) -> str:
    given = [value for value in values if value is not None]
    return text.format(statistics.median(given)) if given else "-"


def unsolved(rows: list[dict[str, Any]]) -> str:
    """Return the problems that were not solved and certified in time, by reason."""
    numbers: dict[tuple[str, str], dict[str, list[str]]] = {}
    for row in rows:
        in_time = row.get("processor", 0.0) <= IN_TIME
        if row["outcome"] == "refused" or (row["outcome"] == "solved" and in_time):
            continue
        why = re.split(r" at \d|[.:]", row["why"])[0] or f"more than {IN_TIME:g} s"
        group = numbers.setdefault((name_of(row), why), {})
        group.setdefault(row["family"], []).append(str(row["number"]))
    lines = [
        f"- {robot}, {why}: "
        + "; ".join(f"{family} {', '.join(which)}" for family, which in group.items())
        for (robot, why), group in numbers.items()
    ]
    return "\n".join(lines) or "All that were tried are solved and certified."


def stages(rows: list[dict[str, Any]]) -> str:
    """Return the table of the times of all stages: medians by robot, s, as Markdown."""
    names = dict.fromkeys(name for row in rows for name in row.get("stages", ()))
    lines = ["| robot | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for robot in dict.fromkeys(map(name_of, rows)):
        given = [row["stages"] for row in rows if name_of(row) == robot and "stages" in row]
        times = (median((own.get(name, 0.0) for own in given), "{:.2f}") for name in names)
        lines.append(f"| {robot} | " + " | ".join(times) + " |")
    return "\n".join(lines)


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of counts and medians by robot and family, as Markdown."""
    lines = [
        "| robot | family | problems | refused, free by meshes | solved and certified | duration, "
        "s | saved against the chain, % | against its path, % | processor time to the first, s | "
        "to the last, s | meshes in contact |",
        "|---" * 11 + "|",
    ]
    for robot, family in dict.fromkeys((row["robot"], row["family"]) for row in rows):
        group = [r for r in rows if (r["robot"], r["family"]) == (robot, family)]
        tried = [r for r in group if "duration" in r]
        solved = [r for r in tried if r["outcome"] == "solved" and r["processor"] <= IN_TIME]
        refused = sum(r["ends_free_by_meshes"] for r in group) - sum(
            r["ends_free_by_meshes"] for r in tried
        )
        saved = [100 * (1 - r["duration"] / r["chain"]) if r["chain"] else None for r in solved]
        beyond = [100 * (1 - r["duration"] / r["path"]) for r in solved if r["path"]]
        lines.append(
            f"| {robot} | {family} | {len(group)} | {refused} | {len(solved)} of {len(tried)} | "
            f"{median([r['duration'] for r in solved], '{:.3f}')} | "
            f"{median(saved, '{:.1f}')} | {median(beyond, '{:.1f}')} | "
            f"{median([r['first'] for r in tried], '{:.1f}')} | "
            f"{median([r['processor'] for r in tried], '{:.1f}')} | "
            f"{sum(not r['free_by_meshes'] for r in solved)} |"
        )
    return "\n".join(lines)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw durations against the chain's, and the share of certified motions over time."""
    if any(row["conditions"] in curobo.TITLES for row in rows):
        curobo.draw(rows, path)
        return
    with styled():
        figure = Figure((7.2, 3.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        for robot in dict.fromkeys(row["robot"] for row in rows):
            own = [r for r in rows if r["robot"] == robot and r.get("duration")]
            pairs = [
                (r["chain"], r["duration"]) for r in own if r["chain"] and r["outcome"] == "solved"
            ]
            left.scatter(*zip(*pairs, strict=True), s=12, label=robot) if pairs else None
            times = sorted(r["first"] for r in own if r["first"])
            shares = 100 * np.arange(1, len(times) + 1) / max(len(own), 1)
            right.step(times, shares, where="post", label=robot)
        most = max([r["chain"] for r in rows if r["chain"]], default=1.0)
        left.plot([0, most], [0, most], color="grey", linewidth=0.8)
        left.set(xlabel="usual chain [s]", ylabel="solved and certified [s]")
        first = "processor time to the first certified motion [s]"
        right.set(xlabel=first, ylabel="problems [%]", xscale="log")
        right.xaxis.set_major_formatter("{x:g}")
        right.xaxis.set_minor_formatter("")
        right.legend()
        figure.savefig(path)
