"""A Rerun viewer without a screen: opens a recording, moves its time cursor, takes pictures.

It draws by Vulkan, in software where there is no graphics card (Debian and Ubuntu: the package
mesa-vulkan-drivers), and listens on 127.0.0.1 only.
"""

from __future__ import annotations

import ctypes.util
import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rerun_cli
from PIL import Image
from rerun.experimental import ViewerClient

DRIVERS = [Path(folder, "vulkan", "icd.d") for folder in ("/usr/share", "/etc", "/usr/local/share")]
ADVICE = "no Vulkan driver to draw with: apt install mesa-vulkan-drivers libvulkan1"
QUIET = ("Software rasterizer", "running in Docker")  # warnings that say nothing of a recording
SETTLED = 3  # equal pictures in a row
START_NOTES = 6.0  # s after the start until its notes are gone


def missing_driver() -> str | None:
    """What is missing on this machine, with what helps; None where pictures can be drawn."""
    if not sys.platform.startswith("linux") or "VK_ICD_FILENAMES" in os.environ:
        return None
    found = ctypes.util.find_library("vulkan") and any(
        list(folder.glob("*.json")) for folder in DRIVERS
    )
    return None if found else ADVICE


class HeadlessViewer:
    """A viewer of its own, with a home of its own, that ends with the ``with`` block."""

    def __init__(self, width: int = 1600, height: int = 1000) -> None:
        self._home = tempfile.mkdtemp(prefix="viewer_")
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        command = [str(Path(rerun_cli.__file__).parent / "rerun"), "--headless"]
        command += ["--bind", "127.0.0.1", "--port", str(port), "--renderer", "vulkan"]
        command += ["--window-size", f"{width}x{height}", "--hide-welcome-screen"]
        self._log = open(Path(self._home, "log"), "w+")  # noqa: SIM115
        self._process = subprocess.Popen(
            command,
            env=_environment(self._home),
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        self._started = time.monotonic()
        try:
            self._client = self._connected(f"rerun+http://127.0.0.1:{port}/proxy")
        except BaseException:
            self.close()
            raise

    def _connected(self, address: str, patience: float = 120.0) -> ViewerClient:
        while time.monotonic() - self._started < patience:
            if self._process.poll() is not None:
                break
            try:
                client = ViewerClient.connect(address)
                client.get_state()
            except Exception:  # it does not listen yet
                time.sleep(0.2)
            else:
                return client
        self._log.seek(0)
        raise RuntimeError(f"the viewer did not start: {self._log.read()[-2000:]}")

    def open(self, path: Path, patience: float = 120.0) -> None:
        """Open a recording and pause it."""
        before = self._client.get_state().active_recording
        self._client.open(str(path.resolve()))
        start = time.monotonic()
        while time.monotonic() - start < patience:
            state = self._client.get_state()
            if state.active_recording not in (None, before) and not state.loading:
                self._client.set_time(play_state="paused")
                return
            time.sleep(0.1)
        raise TimeoutError(f"{path} was not loaded within {patience:g} s")

    def seek(self, timeline: str, **value: Any) -> None:
        """Put the time cursor to ``duration=`` s or ``sequence=`` of a timeline."""
        self._client.set_time(timeline, play_state="paused", **value)

    def picture(
        self,
        view_class: str | None = None,
        until: Callable[[np.ndarray], bool] = lambda _: True,
        patience: float = 30.0,
    ) -> np.ndarray:
        """The window [height, width, 3], or its first view of a class such as "3D", once still.

        Data are fetched when they are needed, so a picture may be still and lack some: it is taken
        again until ``until`` agrees with it or the patience (s) ends.
        """
        end = time.monotonic() + patience
        last, same = b"", 0
        while True:
            png = self._client.take_screenshot(*self._view(view_class))
            same = same + 1 if png == last else 1
            last = png
            picture = np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))
            notes = view_class is None and time.monotonic() - self._started < START_NOTES
            if (same >= SETTLED and not notes and until(picture)) or time.monotonic() > end:
                return picture
            time.sleep(0.05)

    def _view(self, view_class: str | None) -> list[Any]:
        if view_class is None:
            return []
        views = self._client.get_state().views
        return [next(v.view_id for v in views if v.view_class == view_class and v.visible)]

    def problems(self) -> list[str]:
        """What the viewer complains of."""
        views = self._client.get_state().views
        found = [f"{view.name}: {r.summary}" for view in views for r in view.reports]
        for entry in self._client.get_logs():
            expected = any(text in entry.message for text in QUIET)
            if entry.level in ("ERROR", "WARN") and not expected:
                found.append(f"{entry.target}: {entry.message}")
        return found

    def close(self) -> None:
        """End the viewer and remove its home."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGTERM)
            try:
                self._process.wait(5)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._log.close()
        shutil.rmtree(self._home, ignore_errors=True)

    def __enter__(self) -> HeadlessViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _environment(home: str) -> dict[str, str]:
    """No screen, no settings from other times, no analytics, the software driver if there is one.

    With the software driver pictures are the same everywhere.
    """
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    kept = {key: value for key, value in os.environ.items() if key not in screens}
    homes = dict.fromkeys(("HOME", "XDG_DATA_HOME", "XDG_CONFIG_HOME", "XDG_RUNTIME_DIR"), home)
    software = [str(path) for folder in DRIVERS for path in folder.glob("lvp_icd*.json")]
    driver = {"VK_ICD_FILENAMES": software[0]} if software else {}
    return {**driver, **kept, **homes, "RERUN_ANALYTICS": "0", "NO_COLOR": "1"}
