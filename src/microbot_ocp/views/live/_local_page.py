"""A page of a server on this machine, served again so that the browser asks no other machine.

The viewer's own page loads a font, asks for news and examples, and reports its use, all of it on
the internet. A content security policy makes the browser refuse that.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.error import HTTPError
from urllib.request import ProxyHandler, build_opener

TIMEOUT = 20.0  # s
DIRECT = build_opener(ProxyHandler({}))  # the source is on this machine, whatever proxy there is
PRECONNECT = re.compile(rb'<link rel="preconnect"[^>]*>')  # which no policy forbids


@contextmanager
def local_page(source: str, data: str) -> Iterator[str]:
    """Yield the address of a copy of the page at ``source``, as long as the block lasts.

    Scripts and files come from the copy, data from ``data`` as well; nothing from elsewhere.
    Both are addresses such as "http://127.0.0.1:9090".
    """
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Copy, source, data))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()


class _Copy(BaseHTTPRequestHandler):
    """Answers as the source does, with a policy."""

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
            answer = DIRECT.open(self.source + self.path, timeout=TIMEOUT)
        except HTTPError as refusal:
            self.send_error(refusal.code)
            return
        except OSError:
            self.send_error(502)
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
        with suppress(ConnectionError):  # the page was closed
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing: the terminal shows the solve's progress."""
