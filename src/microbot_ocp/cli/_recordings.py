"""The recordings that commands write with ``--rerun`` and show with ``--open``."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from microbot_ocp._base.checks import InputError, shortened
from microbot_ocp._base.reading import opened
from microbot_ocp.cli._options import writable

Save = Callable[[Path], object]  # writes a recording to a path


def check_recording(rerun: Path | None, open_viewer: bool) -> None:
    """Refuse a recording that could not be written or shown, before any work is done."""
    writable(rerun, ".rrd", "--rerun")
    if open_viewer:
        check_viewer("--open")


def check_is_recording(path: Path) -> None:
    """Refuse a file that Rerun would not read."""
    from rerun.chunk import RrdReader

    try:
        opened(path).close()  # refuses a pipe, on which it would wait
        RrdReader(path)
    except Exception as problem:  # it raises whatever happens to go wrong inside
        reason = getattr(problem, "strerror", None) or " ".join(str(problem).split())
        raise InputError(
            f"{shortened(str(path), 130)} is no recording: {shortened(reason, 120)}"
        ) from None


def open_recording(save: Save, rerun: Path | None) -> None:
    """Show the recording that was written, or a temporary one, until the viewer is closed."""
    from microbot_ocp.views.live import LOOPBACK, wait_for_viewer

    with tempfile.TemporaryDirectory(prefix="microbot_ocp_") as folder:
        path = rerun
        if path is None:
            path = Path(folder) / "recording.rrd"
            save(path)
        # a new viewer each time: one that is open already may listen on every interface
        command = [check_viewer("--open"), "--bind", LOOPBACK, "--new", str(path)]
        status = wait_for_viewer(command)
    if status:
        raise InputError(f"the Rerun viewer ended with status {status}")


def has_display() -> bool:
    """Whether there is a screen to open a window on."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_viewer(option: str, screen: bool = True) -> str:
    """Path of the Rerun viewer; refuse an option that lacks it, or the screen that it needs."""
    from microbot_ocp.views.live import find_viewer

    viewer = find_viewer()
    if viewer is None:
        raise InputError(f"{option} needs the Rerun viewer: pip install rerun-sdk")
    if screen and not has_display():
        raise InputError(
            f"{option} needs a screen (DISPLAY or WAYLAND_DISPLAY); write the recording with "
            "--rerun FILE.rrd, or of a solve --rerun-iterations FILE.rrd, and open it where there "
            "is one"
        )
    return viewer
