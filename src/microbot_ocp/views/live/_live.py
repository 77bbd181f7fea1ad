"""A solve watched while it runs: a viewer on this machine gets every iterate.

Everything stays on the loopback interface: a viewer that is started listens on 127.0.0.1 only, and
one that is connected to must be on this machine.
"""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from urllib.parse import quote, urlsplit

import rerun as rr

from microbot_ocp._base.checks import InputError
from microbot_ocp.views.live._local_page import local_page
from microbot_ocp.views.recording import APPLICATION, IterationRecorder, Writer

LOOPBACK = "127.0.0.1"
LOCAL_NAMES = (LOOPBACK, "localhost", "::1")
PATIENCE = 20.0  # s, for a viewer to start
FAREWELL = 5.0  # s, for it to end


@contextmanager
def connected(address: str, every: int = 1) -> Iterator[IterationRecorder]:
    """A progress function that streams to a viewer that listens already.

    Parameters
    ----------
    address : str
        "HOST:PORT" or "rerun+http://HOST:PORT/proxy" of this machine.
    every : int
        Of so many iterations one is drawn, and the last of every solve.

    Raises
    ------
    InputError
        The address is none, is not of this machine, or nobody listens there.
    """
    host, port = parse_address(address)
    if not _listens(host, port):
        raise InputError(f"no viewer listens at {host}:{port}: start one with rerun --bind {host}")
    stream = rr.RecordingStream(APPLICATION)
    stream.connect_grpc(_url(host, port))
    recorder = IterationRecorder(Writer(stream), every)
    try:
        yield recorder
        recorder.finish()
        stream.flush()
    finally:
        stream.disconnect()


@contextmanager
def spawned(every: int = 1) -> Iterator[IterationRecorder]:
    """The same to a viewer that is started for it and stays open; it needs a screen."""
    port = _free_port()
    command = [viewer(), "--bind", LOOPBACK, "--port", str(port), "--new", "--expect-data-soon"]
    _start([*command, "--hide-welcome-screen"], port)
    with connected(f"{LOOPBACK}:{port}", every) as recorder:
        yield recorder


@contextmanager
def served(tell: Callable[[str], object], every: int = 1) -> Iterator[IterationRecorder]:
    """The same for a browser on this machine; ``tell`` gets the address to open.

    The server lives until the block ends.
    """
    with server(tell) as address, connected(address, every) as recorder:
        yield recorder


@contextmanager
def server(tell: Callable[[str], object]) -> Iterator[str]:
    """Address to connect to of a server for a browser on this machine, as long as the block lasts.

    ``tell`` gets the address that the browser should open. Its theme is dark, which the recordings'
    colours are made for.
    """
    port, page = _free_port(), _free_port()
    command = [viewer(), "--serve-web", "--bind", LOOPBACK, "--port", str(port)]
    process = _start([*command, "--web-viewer-port", str(page)], port, page)
    try:
        source, data = (f"http://{LOOPBACK}:{number}" for number in (page, port))
        with local_page(source, data) as address:
            tell(f"{address}/?theme=dark&url={quote(_url(LOOPBACK, port), safe='')}")
            yield f"{LOOPBACK}:{port}"
    finally:
        _end(process)


def parse_address(address: str) -> tuple[str, int]:
    """Host and port of an address on this machine."""
    known = urlsplit(address if "://" in address else f"rerun+http://{address}/proxy")
    with suppress(ValueError):
        if known.hostname in LOCAL_NAMES and known.port is not None:
            return known.hostname, known.port
    raise InputError(
        f"the address of a viewer must be HOST:PORT with one of {', '.join(LOCAL_NAMES)}, "
        f"such as {LOOPBACK}:9876, not {address!r}"
    )


def viewer() -> str:
    """Path of the Rerun viewer: the one of this Python, else one on the path."""
    found = shutil.which("rerun", path=str(Path(sys.executable).parent)) or shutil.which("rerun")
    if found is None:
        raise InputError("watching a solve needs the Rerun viewer: pip install rerun-sdk")
    return found


def _url(host: str, port: int) -> str:
    return f"rerun+http://{f'[{host}]' if ':' in host else host}:{port}/proxy"


def _start(command: list[str], *ports: int) -> subprocess.Popen[bytes]:
    """Start a viewer and wait until it listens."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={"RUST_LOG": "error", **os.environ},
        start_new_session=True,  # Ctrl-C is for the solve; and a group can be ended as a whole
    )
    deadline = time.monotonic() + PATIENCE
    while not all(_listens(LOOPBACK, port) for port in ports):
        if process.poll() is not None:
            raise InputError(f"the Rerun viewer ended at once with status {process.returncode}")
        if time.monotonic() > deadline:
            _end(process)
            raise InputError(f"the Rerun viewer did not listen within {PATIENCE:g} s")
        time.sleep(0.05)
    return process


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a viewer: the script that starts it and the program itself."""
    with suppress(ProcessLookupError):  # when all of the group are gone
        os.killpg(process.pid, signal.SIGTERM)
        process.wait()
        deadline = time.monotonic() + FAREWELL
        while time.monotonic() < deadline:
            os.killpg(process.pid, 0)
            time.sleep(0.02)
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _listens(host: str, port: int) -> bool:
    with suppress(OSError), socket.create_connection((host, port), timeout=1.0):
        return True
    return False


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]
