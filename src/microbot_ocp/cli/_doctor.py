"""``doctor``: what is installed, and what of it works."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from typing import NamedTuple

from microbot_ocp._base.table import Table
from microbot_ocp.cli._declaration import command
from microbot_ocp.cli._report import Answer, has_display, nearest

PACKAGES = {  # and what those are for that are not needed
    **dict.fromkeys(
        ("microbot_ocp", "casadi", "numpy", "matplotlib", "rerun-sdk", "rich", "typer"), ""
    ),
    "xacro": "xacro files",
    "trimesh": "meshes of URDF files",
}


class Finding(NamedTuple):
    """One thing looked at; ``needed`` things that are missing make the exit code 1."""

    part: str
    name: str
    ok: bool
    found: str
    needed: bool = False


@command()
def doctor() -> Answer:
    """Check the installation.

    Versions, solvers, compiler, cache, viewer. Exit code 1 where something that every solve needs
    is missing.

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
    ending = "Everything that a solve needs is there."
    blocks = [
        Table.of_text(["part", "name", "state", "found"], rows, left=4),
        ending if healthy else "Something that every solve needs is missing.",
    ]
    document = {"healthy": healthy, "findings": [finding._asdict() for finding in findings]}
    return Answer(document, blocks, solved=healthy)


def _versions() -> Iterator[Finding]:
    system = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    yield Finding("version", "Python", sys.version_info >= (3, 11), system, needed=True)
    for name, use in PACKAGES.items():
        try:
            text, ok = metadata.version(name), True
        except metadata.PackageNotFoundError:
            text, ok = f"pip install {name}", False
        yield Finding("version", name, ok, f"{text} ({use})" if use else text, needed=not use)


def _solvers() -> Iterator[Finding]:
    import casadi as ca

    use = "optimal control, inverse kinematics"
    yield Finding("solver", "ipopt", ca.has_nlpsol("ipopt"), use, needed=True)
    use = "optimal control, the first look; IPOPT steps in"
    yield Finding("solver", "fatrop", ca.has_nlpsol("fatrop"), use)
    use = "certificates, simulation"
    yield Finding("solver", "cvodes", ca.has_integrator("cvodes"), use, needed=True)
    yield Finding("solver", "idas", ca.has_integrator("idas"), "simulation")


def _compiler() -> Iterator[Finding]:
    from microbot_ocp._base.codegen import cache_folder, compiler

    path, ok = compiler(), False
    text = "no cc, gcc or clang: CasADi's virtual machine runs instead, 4 to 20 times slower"
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
