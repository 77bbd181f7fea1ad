"""Live streams of iterates to a Rerun viewer on this machine.

All data stay on the loopback interface: a started viewer listens on 127.0.0.1 only, and the address
of an open viewer must be on this machine. The page of Rerun's web viewer loads a font, news and
examples from the internet and reports its use. Therefore a copy of the page is served with a
content security policy that forbids these requests.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import quote, urlsplit
from urllib.request import ProxyHandler, build_opener

import rerun as rr

from microbot_ocp._base.checks import InputError
from microbot_ocp.views.live import _viewer as viewer
from microbot_ocp.views.recording import APPLICATION, IterationRecorder, Writer

LOCAL_NAMES = (viewer.LOOPBACK, "localhost", "::1")


@contextmanager
def connected(address: str) -> Iterator[IterationRecorder]:
    """Yield a progress function that streams to an open viewer.

    Parameters
    ----------
    address : str
        Address "HOST:PORT" or "rerun+http://HOST:PORT/proxy" on this machine.

    Raises
    ------
    InputError
        The address is malformed or on another machine, or no viewer listens there.
    """
    host, port = parse_address(address)
    if not viewer.listens(host, port):
        raise InputError(
            f"no viewer listens at {host}:{port}: start one with "
            f"CI=1 rerun --bind {host} (CI=1 turns off usage reports)"
        )
    stream = rr.RecordingStream(APPLICATION)
    stream.connect_grpc(_url(host, port))
    recorder = IterationRecorder(Writer(stream))
    try:
        yield recorder
        recorder.finish()
        stream.flush()
    finally:
        stream.disconnect()


@contextmanager
def spawned() -> Iterator[IterationRecorder]:
    """Yield a progress function that streams to a new viewer.

    The viewer needs a screen and stays open.
    """
    port = viewer.free_port()
    options = "--new", "--expect-data-soon", "--hide-welcome-screen"
    viewer.keep_open(viewer.start_viewer(*options, ports=(port,)))
    with connected(f"{viewer.LOOPBACK}:{port}") as recorder:
        yield recorder


@contextmanager
def served(announce: Callable[[str], object]) -> Iterator[IterationRecorder]:
    """Yield a progress function that streams to a browser on this machine.

    The server runs until the block ends. ``announce`` gets the address to open.
    """
    with server(announce) as address, connected(address) as recorder:
        yield recorder


@contextmanager
def server(announce: Callable[[str], object]) -> Iterator[str]:
    """Serve the viewer to a browser on this machine until the block ends.

    It yields the address for :func:`connected`. ``announce`` gets the address for the browser, with
    the dark theme that suits the colours of recordings.
    """
    port, page = viewer.free_port(), viewer.free_port()
    process = viewer.start_viewer("--serve-web", "--web-viewer-port", str(page), ports=(port, page))
    try:
        source, data = (f"http://{viewer.LOOPBACK}:{number}" for number in (page, port))
        with local_page(source, data) as address:
            announce(f"{address}/?theme=dark&url={quote(_url(viewer.LOOPBACK, port), safe='')}")
            yield f"{viewer.LOOPBACK}:{port}"
    finally:
        viewer.end_viewer(process)


def parse_address(address: str) -> tuple[str, int]:
    """Return host and port of an address on this machine.

    Raises
    ------
    InputError
        The address is malformed, or on another machine.
    """
    parts = urlsplit(address if "://" in address else f"rerun+http://{address}/proxy")
    with suppress(ValueError):
        if parts.hostname in LOCAL_NAMES and parts.port is not None:
            return parts.hostname, parts.port
    raise InputError(
        f"the address of a viewer must be HOST:PORT with one of {', '.join(LOCAL_NAMES)}, "
        f"such as {viewer.LOOPBACK}:9876, not {address!r}"
    )


def _url(host: str, port: int) -> str:
    return f"rerun+http://{f'[{host}]' if ':' in host else host}:{port}/proxy"


DIRECT = build_opener(ProxyHandler({}))  # no proxy: the source is on this machine
PRECONNECT = re.compile(rb'<link rel="preconnect"[^>]*>')  # policies do not cover preconnect


@contextmanager
def local_page(source: str, data: str) -> Iterator[str]:
    """Yield the address of a copy of the page at ``source``, until the block ends.

    The page may load from the copy and from ``data`` only. ``source`` and ``data`` are addresses
    such as "http://127.0.0.1:9090".
    """
    server = ThreadingHTTPServer((viewer.LOOPBACK, 0), partial(_PageCopyHandler, source, data))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://{viewer.LOOPBACK}:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


class _PageCopyHandler(BaseHTTPRequestHandler):
    """Request handler with the answers of the source and a content security policy."""

    def __init__(self, source: str, data: str, *arguments: Any) -> None:
        self.source = source
        self.policy = (
            "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
            "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
            f"worker-src 'self' blob:; connect-src 'self' {data}"
        )
        super().__init__(*arguments)

    def do_GET(self) -> None:
        try:
            answer = DIRECT.open(self.source + self.path, timeout=viewer.START_TIMEOUT)
        except OSError as problem:  # an HTTPError has the code of the source
            self.send_error(getattr(problem, "code", 502))
            return
        with answer:
            kind, body = answer.headers.get("Content-Type", "text/plain"), answer.read()
        if kind.startswith("text/html"):
            body = PRECONNECT.sub(b"", body)
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", self.policy)
        self.end_headers()
        with suppress(ConnectionError):  # the browser may have closed the page
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Ignore the message, because the terminal shows the progress of the solver."""
