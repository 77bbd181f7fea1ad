"""Rerun viewer in a notebook.

The viewer is a program of 67 MB that runs in the browser. By default Rerun downloads it from its
server; here a small server on the loopback interface provides it from the installed package, so
that no network is needed. If the browser is on another machine (JupyterHub, Colab), set the
environment variable ``RERUN_NOTEBOOK_ASSET`` of Rerun to ``inline`` or to an address before Python
starts; it takes precedence.
"""

from __future__ import annotations

import os
import threading
from functools import lru_cache, partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.tasks import Comparison

ASSET = "RERUN_NOTEBOOK_ASSET"
MISSING = (
    "The embedded viewer needs the extra 'notebook': pip install 'microbot_ocp[notebook]'. "
    "A recording in a file (to_rerun) opens without it: microbot-ocp replay FILE.rrd --open"
)


def show(
    what: Comparison | Motion,
    robot: Robot | None = None,
    *,
    width: int | str = "auto",
    height: int = 620,
) -> Any:
    """Show a comparison or a motion in a Rerun viewer inside a notebook.

    Parameters
    ----------
    what : Comparison or Motion
    robot : Robot, optional
        Robot of a motion, with the limits to draw.
    width : int or "auto"
        Width in pixels; "auto" is the width of the cell.
    height : int
        Height in pixels.

    Returns
    -------
    rerun.notebook.Viewer or None
        Viewer, displayed as the last line of a cell. Without the extra ``notebook`` it is None, and
        a line tells how to install the extra.

    Raises
    ------
    InputError
        An argument that is neither a comparison nor a motion with its robot.
    """
    if isinstance(what, Motion) and not isinstance(robot, Robot):
        raise InputError("show needs the robot of a motion: show(motion, robot)")
    if not isinstance(what, Comparison | Motion):
        raise InputError(f"show takes a Comparison or a Motion, not {type(what).__name__}")
    if find_spec("rerun_notebook") is None:
        print(MISSING)
        return None
    import rerun as rr
    import rerun_notebook
    from rerun.notebook import Viewer

    from microbot_ocp.views.recording import Writer, of_comparison, of_motion

    recording = of_comparison(what) if isinstance(what, Comparison) else of_motion(robot, what)  # type: ignore[arg-type]
    if not os.environ.get(ASSET):  # Rerun reads the variable only at its import
        address = f"{_local_server(Path(rerun_notebook.__file__).parent / 'static')}/widget.js"
        rerun_notebook.ASSET_ENV = rerun_notebook.Viewer._esm = address
    stream = rr.RecordingStream(recording.application)
    viewer = Viewer(
        width=width,  # type: ignore[arg-type]
        height=height,
        recording=stream,
        blueprint=recording.blueprint(),
        use_global_recording=False,
        theme="dark",  # the colours of recordings are chosen for it
    )
    recording.write(Writer(stream))
    stream.flush()
    return viewer


class _AssetHandler(SimpleHTTPRequestHandler):
    """Request handler for the viewer's files, which a page from another port may load."""

    extensions_map = {".js": "text/javascript", ".wasm": "application/wasm"}  # noqa: RUF012

    def end_headers(self) -> None:
        self.send_header("Access-Control-Allow-Origin", "*")
        super().end_headers()

    def log_message(self, format: str, *args: Any) -> None:
        """Ignore the message, which a notebook would show."""


@lru_cache(maxsize=1)
def _local_server(folder: Path) -> str:
    """Start a server of the viewer's files on this machine and return its address."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_AssetHandler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{server.server_address[1]}"
