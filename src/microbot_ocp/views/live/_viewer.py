"""Process of the Rerun viewer on this machine: search, start and end."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.system import OWN_GROUP, end_group

LOOPBACK = "127.0.0.1"
START_TIMEOUT = 20.0  # s until the viewer listens, or answers
END_TIMEOUT = 0.4  # s before the viewer is killed; this process must end within 1 s
_started: set[subprocess.Popen[Any]] = set()


def viewer_environment() -> dict[str, str]:
    """Return an environment for a viewer without usage reports.

    Rerun sends no reports if ``CI`` is set and ``FORCE_RERUN_ANALYTICS`` is not.
    """
    environment = {"RUST_LOG": "error", **os.environ, "CI": "1"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    return environment


def find_viewer() -> str | None:
    """Return the path of the Rerun viewer in the folder of this Python, or else on the PATH."""
    return shutil.which("rerun", path=str(Path(sys.executable).parent)) or shutil.which("rerun")


def start_viewer(*options: str, ports: tuple[int, ...]) -> subprocess.Popen[Any]:
    """Start a viewer that listens on this machine only, and wait until it listens.

    Raises
    ------
    InputError
        The viewer is not installed, or does not listen.
    """
    viewer = find_viewer()
    if viewer is None:
        raise InputError("watching a solve needs the Rerun viewer: pip install rerun-sdk")
    process = subprocess.Popen(
        [viewer, "--bind", LOOPBACK, "--port", str(ports[0]), *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=viewer_environment(),
        **OWN_GROUP,
    )
    _started.add(process)
    try:
        _wait_for(process, ports)
    except BaseException:
        end_viewer(process)
        raise
    return process


def _wait_for(process: subprocess.Popen[Any], ports: tuple[int, ...]) -> None:
    deadline = time.monotonic() + START_TIMEOUT
    while not all(listens(LOOPBACK, port) for port in ports):
        if process.poll() is not None:
            raise InputError(f"the Rerun viewer ended at once with status {process.returncode}")
        if time.monotonic() > deadline:
            raise InputError(f"the Rerun viewer did not listen within {START_TIMEOUT:g} s")
        time.sleep(0.05)


def wait_for_viewer(command: list[str]) -> int:
    """Run a viewer until it is closed and return its status; it prints to standard error."""
    environment = viewer_environment()
    process = subprocess.Popen(command, stdout=sys.stderr, env=environment, **OWN_GROUP)
    _started.add(process)
    try:
        return process.wait()
    finally:
        end_viewer(process)


def end_viewer(process: subprocess.Popen[Any]) -> None:
    """End a viewer with its start script."""
    end_group(process, END_TIMEOUT)
    process.wait()
    _started.discard(process)


def keep_open(process: subprocess.Popen[Any]) -> None:
    """Keep a viewer running after the end of this process."""
    _started.discard(process)


def abandon() -> None:
    """Abort every viewer that is not kept open, before this process ends."""
    for process in list(_started):
        end_group(process)


def listens(host: str, port: int) -> bool:
    """Return whether a port is open."""
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def free_port() -> int:
    """Return a free port."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]
