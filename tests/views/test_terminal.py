"""Progress on a terminal and in a pipe."""

import io
import re

from rich.console import Console

from microbot_ocp.ocp.solution import Iteration
from microbot_ocp.tasks import Step
from microbot_ocp.views.live import show_progress, spoken_progress

LONG = "cubic's path, best timing: ipopt 5: cost 2.02256, infeasibility 1.0e-08, and much more"


def shown(terminal, *events):
    """Lines that a console of 80 columns got for some events."""
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=terminal, width=80, color_system=None)
    with show_progress(console) as progress:
        for event in events:
            progress(event)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", stream.getvalue())
    return text.replace("\r", "\n").splitlines()


def test_the_bar_and_the_time_stay_whole_beside_a_long_text():
    lines = shown(True, Step(1, 4, "solve", LONG))
    bars = [line for line in lines if re.search(r" \d:\d\d:\d\d -:--:-- *$", line)]
    assert bars
    assert all(len(line) == len(bars[0]) <= 80 for line in bars)
    assert len(bars[0].split(" ", 1)[1].rstrip().removesuffix(" 0:00:00 -:--:--")) >= 20
    (text,) = {line for line in lines if "ipopt" in line}
    assert text.startswith("  solve: cubic's path, best timing: ipopt 5: cost 2.02256")
    assert len(text) <= 80


def test_a_pipe_gets_every_step_as_a_line_and_no_iteration():
    assert shown(False, Step(1, 4, "solve", LONG), "refined") == [
        f"solve   {LONG}",
        "solve   refined",
    ]


def test_long_work_speaks_now_and_then_where_there_is_no_terminal(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("microbot_ocp.views.live._terminal.time.monotonic", lambda: clock[0])
    lines = []
    progress = spoken_progress(lines.append)
    for second in range(100):
        clock[0] = float(second)
        progress(Step(second, 100, "solve", f"best so far {second}"))
    assert lines == [
        "30 s: solve: best so far 30",
        "60 s: solve: best so far 60",
        "90 s: solve: best so far 90",
    ]
    lines.clear()
    for second, text in ((110, "mesh 20: 1.793 s, solved"), (120, "search 2: no path")):
        clock[0] = float(second)
        progress(text)
    assert lines == ["120 s: solve: search 2: no path; so far: mesh 20: 1.793 s, solved"]
    clock[0] = 160.0
    progress(object.__new__(Iteration))
    assert lines[1:] == ["160 s: solve: search 2: no path; so far: mesh 20: 1.793 s, solved"]
