"""Where a recording goes: a thin layer over Rerun, and the file that is whole or absent."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from microbot_ocp._base.checks import FloatArray
from microbot_ocp.views.recording import _paths as entities

APPLICATION = "microbot_ocp"
Times = Mapping[str, FloatArray]  # values [N] by timeline: s on TIME, whole numbers elsewhere


@dataclass(frozen=True)
class Writer:
    """Writes to a stream, and raises where Rerun would only warn."""

    stream: rr.RecordingStream

    def static(
        self, path: str, *what: rr.AsComponents | Iterable[rr.DescribedComponentBatch]
    ) -> None:
        """Log what never changes."""
        self.stream.log(path, *what, static=True, strict=True)

    def columns(self, path: str, times: Times, columns: Iterable[rr.ComponentColumn]) -> None:
        """Log a row for every time, in one call."""
        indexes = [_time_column(timeline, values) for timeline, values in times.items()]
        self.stream.send_columns(path, indexes=indexes, columns=columns, strict=True)

    def layout(self, blueprint: rrb.Blueprint) -> None:
        """Send a layout that was not known at the start."""
        self.stream.send_blueprint(blueprint)


def _time_column(timeline: str, values: FloatArray) -> rr.TimeColumn:
    if timeline == entities.TIME:
        return rr.TimeColumn(timeline, duration=values)
    return rr.TimeColumn(timeline, sequence=np.asarray(values, dtype=np.int64))


@contextmanager
def file_writer(
    path: str | Path, blueprint: rrb.Blueprint | None = None, application: str = APPLICATION
) -> Iterator[Writer]:
    """Writer of a file with its layout inside; the file appears when all is written.

    A viewer keeps one layout for each ``application``.
    """
    target = Path(path)
    partial = target.with_name(target.name + ".part")
    stream = rr.RecordingStream(application)
    try:
        stream.save(partial, default_blueprint=blueprint)
        yield Writer(stream)
        stream.flush()
    except BaseException:
        stream.disconnect()
        partial.unlink(missing_ok=True)
        raise
    stream.disconnect()  # writes the footer, without which the file is not valid
    partial.replace(target)
