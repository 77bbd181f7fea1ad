"""Rerun recordings: one entity tree, one layout; ``docs/recordings.md`` describes both.

A kind of recording is a function in :mod:`~microbot_ocp.views.recording.kinds` that makes a
:class:`Recording`, which is saved to a file or sent to a stream.
"""

from microbot_ocp.views.recording.kinds import (
    of_branches,
    of_comparison,
    of_motion,
    of_tracking,
)
from microbot_ocp.views.recording.recording import Recording
from microbot_ocp.views.recording.solution import SolutionRecording, of_solution
from microbot_ocp.views.recording.writer import Writer, file_writer

__all__ = [
    "Recording",
    "SolutionRecording",
    "Writer",
    "file_writer",
    "of_branches",
    "of_comparison",
    "of_motion",
    "of_solution",
    "of_tracking",
]
