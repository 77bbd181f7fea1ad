"""Files of a film: GIF by Pillow (installed with matplotlib) and MP4 by ffmpeg."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.needed import needed
from microbot_ocp._base.writing import whole_file
from microbot_ocp.motion import Motion
from microbot_ocp.robot import Robot
from microbot_ocp.scene import Scene
from microbot_ocp.tasks import Cell, Comparison, Progress, Step
from microbot_ocp.views._style import FRAME_RATE, LAST_FRAME, main_methods
from microbot_ocp.views.animation._film import Film
from microbot_ocp.views.recording import Recording, of_cell, of_comparison, of_motion

MOST_FRAMES = 3000  # largest number of frames of a film
DPI = {".gif": 100, ".mp4": 160}


def write_animation(
    recording: Recording,
    path: str | Path,
    rate: float | None = None,
    *,
    theme: str = "light",
    title: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write the arms of a recording as a film, seen from the recording's camera.

    Parameters
    ----------
    recording : Recording
        Recording by :func:`microbot_ocp.views.recording.of_motion`, ``of_cell``, ``of_comparison``
        or ``of_tracking``.
    path : str or Path
        ``.gif`` (800 x 450) or ``.mp4`` (1280 x 720; needs the extra ``export``).
    rate : float, optional
        Frame rate, Hz; default 25, at most 50 for a GIF, which counts hundredths of a second. The
        film plays in real time.
    theme : str
        "light" or "dark".
    title : str, optional
        Title; default the title of the recording.
    progress : callable, optional
        Called with a :class:`microbot_ocp.tasks.Step` before each frame.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        An unknown ending, a rate that is not above 0 or gives more than 3000 frames, no moving arm,
        imageio-ffmpeg missing.
    """
    target = Path(path)
    checks.one_of("ending of path", target.suffix, DPI)
    highest = 50.0 if target.suffix == ".gif" else 240.0
    rate = checks.number("rate", FRAME_RATE if rate is None else rate, "Hz", above=0.0)
    if rate > highest:
        raise InputError(f"rate must be at most {highest:g} Hz for {target.suffix}, not {rate:g}")
    film = Film(recording, theme, title, DPI[target.suffix])
    count = int(np.ceil(film.duration * rate)) + 1
    if count > MOST_FRAMES:
        raise InputError(f"rate must give at most {MOST_FRAMES} frames, not {count}")

    def drawn() -> Iterator[np.ndarray]:
        for k in range(count):
            if progress is not None:
                progress(Step(k, count, "write", f"frame {k + 1} of {count}"))
            yield film.frame(k / rate)

    frames = drawn()
    with whole_file(target) as partial:
        if target.suffix == ".gif":
            around = bool(film.still or film.around.parts)
            _write_gif(partial, frames, rate, colors=256 if around else 128)
        else:
            _write_mp4(partial, frames, rate)
    return target


def animate_motion(
    robot: Robot,
    motion: Motion,
    path: str | Path,
    rate: float | None = None,
    scene: Scene | None = None,
    **options: Any,
) -> Path:
    """Film one motion by :func:`write_animation`, with the obstacles of a scene."""
    return write_animation(of_motion(robot, motion, scene=scene), path, rate, **options)


def animate_cell(cell: Cell, path: str | Path, rate: float | None = None, **options: Any) -> Path:
    """Film a motion through stops by :func:`write_animation`, with tubes, parts and obstacles."""
    return write_animation(of_cell(cell), path, rate, **options)


def animate_comparison(
    comparison: Comparison,
    path: str | Path,
    rate: float | None = None,
    methods: Sequence[str] | None = None,
    **options: Any,
) -> Path:
    """Film some methods by :func:`write_animation`, by default the best and the reference."""
    methods = main_methods(comparison) if methods is None else methods
    for name in methods:
        checks.one_of("methods", name, comparison.motions)
    chosen = tuple(entry for entry in comparison.entries if entry.name in methods)
    recording = of_comparison(replace(comparison, entries=chosen))
    title = options.pop("title", None) or f"{comparison.robot.name}: the same task, the same limits"
    return write_animation(recording, path, rate, title=title, **options)


def _write_gif(path: Path, frames: Iterator[np.ndarray], rate: float, colors: int) -> None:
    pictures = [Image.fromarray(frame) for frame in frames]
    # One palette for all frames, from some of them: colours do not flicker and the file is small.
    some = pictures[:: max(1, len(pictures) // 6)]
    strip = Image.fromarray(np.vstack([np.asarray(picture) for picture in [*some, pictures[-1]]]))
    palette = _with_exactly(strip.quantize(colors, method=Image.Quantize.MEDIANCUT), strip)
    reduced = [p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    ends = np.rint(100.0 * np.arange(1, len(reduced) + 1) / rate).astype(int)
    durations = 10 * np.diff(ends, prepend=0)
    durations[-1] += int(1000 * LAST_FRAME)
    reduced[0].save(
        path, format="GIF", save_all=True, append_images=reduced[1:], duration=durations.tolist(),
        loop=0, optimize=False, disposal=1,
    )  # fmt: skip


def _with_exactly(reduced: Image.Image, picture: Image.Image) -> Image.Image:
    """Return a palette with the exact background colour, taken from a corner of the picture."""
    colors, corner = list(reduced.getpalette() or ()), (0, 0)
    place: Any = reduced.getpixel(corner)
    colors[3 * place : 3 * place + 3] = np.asarray(picture)[corner].tolist()
    reduced.putpalette(colors)
    return reduced


def _write_mp4(path: Path, frames: Iterator[np.ndarray], rate: float) -> None:
    ffmpeg = needed("imageio_ffmpeg", "this format needs", "export")
    last = next(frames)
    height, width, _ = last.shape
    writer = ffmpeg.write_frames(
        str(path), (width, height), fps=rate,
        codec="libx264", quality=8, macro_block_size=2,
        ffmpeg_log_level="error", output_params=["-f", "mp4", "-movflags", "+faststart"],
    )  # fmt: skip
    writer.send(None)
    try:
        writer.send(last)
        for last in frames:
            writer.send(last)
        for _ in range(int(LAST_FRAME * rate)):
            writer.send(last)
    finally:
        writer.close()
