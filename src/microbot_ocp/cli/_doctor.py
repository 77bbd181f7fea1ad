"""``doctor``: what is installed, and what of it works."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from importlib import metadata
from typing import TYPE_CHECKING, Any, NamedTuple

from microbot_ocp._base.table import Table
from microbot_ocp.cli._options import Json
from microbot_ocp.cli._output import answer
from microbot_ocp.cli._recordings import has_display

if TYPE_CHECKING:
    from rich.console import Console

PACKAGES = ("microbot_ocp", "casadi", "numpy", "matplotlib", "rerun-sdk", "rich", "typer")
OPTIONAL = {"xacro": "xacro files", "trimesh": "meshes of URDF files"}


class Finding(NamedTuple):
    """One thing looked at; ``needed`` things that are missing make the exit code 1."""

    part: str
    name: str
    ok: bool
    found: str
    needed: bool


def doctor(as_json: Json = False) -> int:
    """Check the installation.

    Versions, solvers, compiler, cache, viewer. Exit code 1 where something that every solve needs
    is missing.
    """
    findings = [*_versions(), *_solvers(), _compiler(), _cache(), *_viewer()]
    healthy = all(finding.ok for finding in findings if finding.needed)
    document = {"healthy": healthy, "findings": [finding._asdict() for finding in findings]}

    def text(console: Console) -> None:
        rows = [
            [f.part, f.name, "ok" if f.ok else ("MISSING" if f.needed else "missing"), f.found]
            for f in findings
        ]
        console.print(Table.of_text(["part", "name", "state", "found"], rows, left=4), "")
        ending = "Everything that a solve needs is there."
        console.print(ending if healthy else "Something that every solve needs is missing.")

    return answer(as_json, document, text, 0 if healthy else 1)


def _versions() -> list[Finding]:
    system = f"{platform.python_version()} on {platform.system()} {platform.machine()}"
    findings = [Finding("version", "Python", sys.version_info >= (3, 11), system, True)]
    for name in (*PACKAGES, *OPTIONAL):
        try:
            found, ok = metadata.version(name), True
        except metadata.PackageNotFoundError:
            found, ok = f"pip install {name}", False
        if name in OPTIONAL:
            found += f" ({OPTIONAL[name]})"
        findings.append(Finding("version", name, ok, found, name not in OPTIONAL))
    return findings


def _solvers() -> list[Finding]:
    import casadi as ca

    loaded: tuple[tuple[str, Any, str, bool], ...] = (
        ("ipopt", ca.has_nlpsol, "optimal control, inverse kinematics", True),
        ("fatrop", ca.has_nlpsol, "optimal control, the first look; IPOPT steps in", False),
        ("cvodes", ca.has_integrator, "certificates, simulation", True),
        ("idas", ca.has_integrator, "simulation", False),
    )
    return [Finding("solver", name, has(name), use, needed) for name, has, use, needed in loaded]


def _compiler() -> Finding:
    from microbot_ocp._base.codegen import compiler

    path = compiler()
    if path is None:
        found = "no cc, gcc or clang: CasADi's virtual machine runs instead, 4 to 20 times slower"
        return Finding("compiler", "C", False, found, False)
    try:
        lines = subprocess.run(
            [path, "--version"], capture_output=True, text=True, timeout=20, check=True
        ).stdout.splitlines()
    except (OSError, subprocess.SubprocessError) as problem:
        return Finding("compiler", "C", False, f"{path}: {problem}", False)
    return Finding("compiler", "C", True, f"{path}: {lines[0] if lines else ''}", False)


def _cache() -> Finding:
    from microbot_ocp._base.codegen import cache_folder

    folder = cache_folder()
    existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    writable = existing.is_dir() and os.access(existing, os.W_OK)
    return Finding("compiler", "cache", writable, str(folder), False)


def _viewer() -> list[Finding]:
    from microbot_ocp.views.live import find_viewer

    viewer, screen = find_viewer(), has_display()
    where = "a screen is there" if screen else "no DISPLAY or WAYLAND_DISPLAY: --open has no screen"
    return [
        Finding("viewer", "rerun", viewer is not None, viewer or "pip install rerun-sdk", False),
        Finding("viewer", "screen", screen, where, False),
    ]
