"""The Rerun viewer as a process of this machine: found, started, ended."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from microbot_ocp._base.checks import InputError

LOOPBACK = "127.0.0.1"
START_TIMEOUT = 20.0  # s
END_TIMEOUT = 0.4  # s, then the viewer is killed; the process itself has to end within 1 s
_started: set[subprocess.Popen[bytes]] = set()


def viewer_environment() -> dict[str, str]:
    """Return the environment of a viewer: it reports its use to nobody.

    Rerun sends nothing where ``CI`` is set, unless ``FORCE_RERUN_ANALYTICS`` is.
    """
    environment = {"RUST_LOG": "error", **os.environ, "CI": "1"}
    environment.pop("FORCE_RERUN_ANALYTICS", None)
    return environment


def find_viewer() -> str | None:
    """Return the path of the Rerun viewer: of this Python's folder, or else on the PATH."""
    return shutil.which("rerun", path=str(Path(sys.executable).parent)) or shutil.which("rerun")


def start_viewer(*options: str, ports: tuple[int, ...]) -> subprocess.Popen[bytes]:
    """Start a viewer that listens on this machine only, and wait until it does.

    Raises
    ------
    InputError
        There is no viewer, or it does not listen.
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
        start_new_session=True,  # Ctrl-C is for the solve; and a group can be ended as a whole
    )
    _started.add(process)
    try:
        _wait_for(process, ports)
    except BaseException:
        end_viewer(process)
        raise
    return process


def _wait_for(process: subprocess.Popen[bytes], ports: tuple[int, ...]) -> None:
    deadline = time.monotonic() + START_TIMEOUT
    while not all(listens(LOOPBACK, port) for port in ports):
        if process.poll() is not None:
            raise InputError(f"the Rerun viewer ended at once with status {process.returncode}")
        if time.monotonic() > deadline:
            raise InputError(f"the Rerun viewer did not listen within {START_TIMEOUT:g} s")
        time.sleep(0.05)


def wait_for_viewer(command: list[str]) -> int:
    """Run a viewer until it is closed; return its status. Its output goes to standard error."""
    environment = viewer_environment()
    process = subprocess.Popen(command, stdout=sys.stderr, env=environment, start_new_session=True)
    _started.add(process)
    try:
        return process.wait()
    finally:
        end_viewer(process)


def end_viewer(process: subprocess.Popen[bytes]) -> None:
    """End the script that starts a viewer and the viewer itself."""
    with suppress(ProcessLookupError):  # when all of the group are gone
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()
        deadline = time.monotonic() + END_TIMEOUT
        while time.monotonic() < deadline:
            os.killpg(process.pid, 0)
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    _started.discard(process)


def keep_open(process: subprocess.Popen[bytes]) -> None:
    """Let a viewer outlive this process."""
    _started.discard(process)


def abandon() -> None:
    """Kill every viewer that is not to stay open: the process is about to end."""
    for process in list(_started):
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)


def listens(host: str, port: int) -> bool:
    """Return whether a port is open."""
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def free_port() -> int:
    """Return a port that is free at the moment."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]
