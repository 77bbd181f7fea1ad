"""A page served again: the same bytes, and a policy that keeps the browser on this machine."""

import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from urllib.error import HTTPError
from urllib.request import ProxyHandler, build_opener

import pytest

from helpers import refused
from microbot_ocp.views.live import local_page

DATA = "http://127.0.0.1:9876"
OPENER = build_opener(ProxyHandler({}))


@pytest.fixture
def source(tmp_path):
    """Address of a server of two files."""
    (tmp_path / "index.html").write_text(
        '<link rel="preconnect" href="https://example.org" /><p>the page</p>'
    )
    (tmp_path / "viewer.wasm").write_bytes(b"\0asm")
    server = ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()


def test_the_copy_is_the_page_with_a_policy(source):
    with local_page(source, DATA) as address:
        with OPENER.open(f"{address}/?theme=dark") as answer:
            assert answer.read() == b"<p>the page</p>"
            rules = dict(
                rule.split(maxsplit=1)
                for rule in answer.headers["Content-Security-Policy"].split("; ")
            )
        with OPENER.open(f"{address}/viewer.wasm") as answer:
            assert answer.headers["Content-Type"] == "application/wasm"
            assert answer.read() == b"\0asm"
    assert rules["connect-src"] == f"'self' {DATA}"
    assert rules["default-src"] == "'self'"
    assert not any("//" in rule for name, rule in rules.items() if name != "connect-src")
    with refused("refused", error=OSError):
        OPENER.open(address)


def test_what_the_source_lacks_the_copy_lacks(source):
    with local_page(source, DATA) as address, refused("404", error=HTTPError):
        OPENER.open(f"{address}/none.js")


def test_a_source_that_does_not_answer():
    with local_page("http://127.0.0.1:9", DATA) as address, refused("502", error=HTTPError):
        OPENER.open(address)
