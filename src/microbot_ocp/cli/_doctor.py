"""``doctor``: a check of the installed packages, solvers, compiler and viewer."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from typing import NamedTuple

from microbot_ocp._base.table import Table
from microbot_ocp.cli._declaration import command
from microbot_ocp.cli._report import Answer, has_display, nearest

PACKAGES = ("microbot_ocp", "casadi", "numpy", "matplotlib", "rerun-sdk", "rich", "typer")
EXTRAS = {  # the use of each extra
    "urdf": "xacro files, meshes of URDF files",
    "mjcf": "MuJoCo's files",
    "descriptions": "robots by the names of robot_descriptions",
    "cell": "obstacles, orders of many stops",
    "arms": "files of the arms of problems/12_shelf.py",
    "export": ".mat, .parquet, .mp4",
    "notebook": "Jupyter",
    "studio": "a page with sliders",
    "scale": "studies on all processors",
}


class Finding(NamedTuple):
    """Result for one item; a missing item that is ``needed`` sets the exit code to 1."""

    part: str
    name: str
    ok: bool
    found: str
    needed: bool = False


@command()
def doctor() -> Answer:
    """Check the installation.

    It lists versions, solvers, compiler, cache and viewer. Exit code 1 if a part that every solve
    needs is missing.

    Examples
    --------
    $ microbot-ocp doctor
    """
    findings = [*_versions(), *_solvers(), *_compiler(), *_viewer()]
    healthy = all(finding.ok for finding in findings if finding.needed)
    rows = [
        [f.part, f.name, "ok" if f.ok else ("MISSING" if f.needed else "missing"), f.found]
        for f in findings
    ]
    ending = "Every part that a solve needs is installed."
    blocks = [
        Table.of_text(["part", "name", "state", "found"], rows, left=4),
        ending if healthy else "A part that every solve needs is missing.",
    ]
    document = {"healthy": healthy, "findings": [finding._asdict() for finding in findings]}
    return Answer(document, blocks, solved=healthy)


def _versions() -> Iterator[Finding]:
    system = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    yield Finding("version", "Python", sys.version_info >= (3, 11), system, needed=True)
    for name in PACKAGES:
        version = _version(name)
        yield Finding("version", name, bool(version), version or f"pip install {name}", needed=True)
    lines = metadata.requires("microbot_ocp") or [] if _version("microbot_ocp") else []
    for extra, use in EXTRAS.items():
        required = [name for line in lines if (name := _name_in(line, extra))]
        missing = [name for name in required if not _version(name)]
        text = f"pip install 'microbot_ocp[{extra}]' for {use}" if missing else use
        yield Finding("extra", extra, not missing, text)


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return ""


def _name_in(requirement: str, extra: str) -> str:
    """Return the package of a requirement such as "coal>=3; extra == 'cell'".

    The result is empty if the requirement belongs to another extra.
    """
    named = re.fullmatch(rf"([\w.-]+).*;.*extra == ['\"]{extra}['\"]", requirement)
    return named[1] if named else ""


def _solvers() -> Iterator[Finding]:
    import casadi as ca

    from microbot_ocp.ocp.solvers import linear_solver_library

    for name, has, needed, use in (
        ("ipopt", ca.has_nlpsol, True, "optimal control, inverse kinematics"),
        ("fatrop", ca.has_nlpsol, False, "optimal control, where IPOPT fails"),
        ("cvodes", ca.has_integrator, True, "certificates, simulation"),
        ("idas", ca.has_integrator, False, "simulation"),
    ):
        yield Finding("solver", name, has(name), use, needed)
    for name, use in (
        ("ldl", "linear equations of motions with states, by CasADi's AMD"),
        ("band", "linear equations of free motions"),
    ):
        built = linear_solver_library(name) is not None
        yield Finding("solver", name, built, use if built else f"{use}: MUMPS instead, slower")


def _compiler() -> Iterator[Finding]:
    from microbot_ocp._base.codegen import cache_folder, compiler

    path, ok = compiler(), False
    text = "no cc, gcc or clang: CasADi's virtual machine runs functions of a robot, slower"
    if path is not None:
        try:
            version = subprocess.check_output([path, "--version"], text=True, timeout=20)
            text, ok = f"{path}: {version.partition(os.linesep)[0]}", True
        except (OSError, subprocess.SubprocessError) as problem:
            text = f"{path}: {problem}"
    yield Finding("compiler", "C", ok, text)
    existing = nearest(folder := cache_folder())
    writable = existing.is_dir() and os.access(existing, os.W_OK)
    yield Finding("compiler", "cache", writable, str(folder))


def _viewer() -> Iterator[Finding]:
    from microbot_ocp.views.live import find_viewer

    path, screen = find_viewer(), has_display()
    yield Finding("viewer", "rerun", path is not None, path or "pip install rerun-sdk")
    text = "a screen is there" if screen else "no DISPLAY or WAYLAND_DISPLAY: --open has no screen"
    yield Finding("viewer", "screen", screen, text)
