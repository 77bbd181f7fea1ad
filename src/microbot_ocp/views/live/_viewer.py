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
END_TIMEOUT = 5.0  # s


def find_viewer() -> str | None:
    """Path of the Rerun viewer: of this Python's folder, or else on the PATH."""
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
        env={"RUST_LOG": "error", **os.environ},
        start_new_session=True,  # Ctrl-C is for the solve; and a group can be ended as a whole
    )
    deadline = time.monotonic() + START_TIMEOUT
    while not all(listens(LOOPBACK, port) for port in ports):
        if process.poll() is not None:
            raise InputError(f"the Rerun viewer ended at once with status {process.returncode}")
        if time.monotonic() > deadline:
            end_viewer(process)
            raise InputError(f"the Rerun viewer did not listen within {START_TIMEOUT:g} s")
        time.sleep(0.05)
    return process


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


def listens(host: str, port: int) -> bool:
    """Whether a port is open."""
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def free_port() -> int:
    """A port that is free at the moment."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]
