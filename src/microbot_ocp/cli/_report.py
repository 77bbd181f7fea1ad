"""Report of a command: progress, files, text or JSON, and recordings in a viewer."""

from __future__ import annotations

import json
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from microbot_ocp._base.checks import InputError, plain, sentence
from microbot_ocp._base.table import Table
from microbot_ocp._base.writing import NotWritten, check_writable
from microbot_ocp.cli import _process as process

if TYPE_CHECKING:
    from rich.console import Console

Progress = Callable[[Any], None]  # takes a step, an iteration or a sentence
Save = Callable[[Path], object]  # writes to a path; may return the list of written files
Block = str | Table | Sequence[Table]


@dataclass(frozen=True)
class Answer:
    """Result of a command.

    Attributes
    ----------
    document : document of ``--json``
    blocks : text and tables for people; the first table of a sequence that fits is printed
    lines : text below the blocks, never wrapped
    solved, certified : True if the exit code is 0
    save : function that writes the file or folder of ``--out``
    record : recording for ``--rerun`` and ``--open``, or the function that writes it
    files : further files, each with the function that writes it
    verbatim : text printed unchanged, for a pipe into a file
    """

    document: Mapping[str, Any]
    blocks: Sequence[Block] = ()
    lines: Sequence[str] = ()
    solved: bool = True
    certified: bool = True
    save: Save | None = None
    record: Save | Path | None = None
    files: Mapping[Path, Save] | None = None
    verbatim: str = ""


@dataclass
class Report:
    """Options that commands share.

    Attributes
    ----------
    out : FILE
        Write the motion to this .npz file.
    rerun : FILE
        Write a Rerun recording (.rrd) to this file.
    open
        Open the Rerun viewer, bound to 127.0.0.1; wait for it.
    rerun_iterations : FILE
        Write a recording of the solvers' iterations (.rrd) to this file.
    live
        Watch the solvers in a Rerun viewer, bound to 127.0.0.1.
    live_serve
        Watch the solvers in a browser on this machine; Ctrl-C ends the server.
    live_connect : HOST:PORT
        Watch the solvers in a viewer that is already open.
    allow_uncertified
        Return exit code 0 although a certificate is refused.
    json
        Print one JSON document.
    """

    out: Path | None = None
    rerun: Path | None = None
    open: bool = False
    rerun_iterations: Path | None = None
    live: bool = False
    live_serve: bool = False
    live_connect: str | None = None
    allow_uncertified: bool = False
    json: bool = False
    written: list[str] = field(default_factory=list, init=False)
    missing: list[dict[str, str]] = field(default_factory=list, init=False)

    def check(self, endings: Sequence[str]) -> None:
        """Reject outputs that cannot be written or shown, before any work is done."""
        check_output("--out", self.out, endings)
        check_output("--rerun", self.rerun, [".rrd"])
        check_output("--rerun-iterations", self.rerun_iterations, [".rrd"])
        if self.live + self.live_serve + (self.live_connect is not None) > 1:
            raise InputError("give one of --live, --live-serve and --live-connect")
        for option in ("open", "live", "live_serve"):
            if getattr(self, option):
                viewer(f"--{option.replace('_', '-')}", screen=option != "live_serve")
        if self.live_connect is not None:
            from microbot_ocp.views.live import parse_address

            parse_address(self.live_connect)

    def give(self, find: Callable[..., Answer], *, long: bool) -> int:
        """Compute the answer, write its files, print and show it; return the exit code.

        A long computation gets a function that shows its progress.
        """
        with ExitStack() as browser:
            with self._progress(browser) if long else nullcontext() as progress:
                answer = find(progress=progress) if long else find()
                named = [(self.out, answer.save), (self.rerun, answer.record)]
                for path, save in [*named, *(answer.files or {}).items()]:
                    if path is not None and callable(save):
                        self._save(path, save)
            code = self._print(answer)
            if self.open and answer.record is not None:
                _show_recording(answer.record, self.rerun)
            if self.live_serve:
                say("Ctrl-C ends the server")
                with suppress(KeyboardInterrupt):
                    while True:
                        time.sleep(1.0)
        return code

    def _save(self, path: Path, save: Save) -> None:
        """Call ``save`` with the path; a failure is reported and the answer is still printed."""
        try:
            files = save(path)
        except NotWritten as problem:
            self.missing.append({"file": problem.path, "reason": problem.reason})
        except Exception as problem:
            process.check()
            reason = str(problem) or type(problem).__name__
            self.missing.append({"file": str(path), "reason": sentence(reason)})
        else:
            self.written += map(str, files) if isinstance(files, list) else [str(path)]

    @contextmanager
    def _progress(self, browser: ExitStack) -> Iterator[Progress]:
        """Pass every step to the bar on a terminal, a viewer and a recording; check for Ctrl-C."""
        with ExitStack() as stack:
            watchers: list[Progress] = [lambda _: process.check()]
            from microbot_ocp.views import live

            if sys.stderr.isatty():
                watchers.append(stack.enter_context(live.show_progress(make_console(sys.stderr))))
            else:
                watchers.append(live.spoken_progress(say))
            if self.rerun_iterations is not None:
                from microbot_ocp.views.recording import record_iterations

                recording = record_iterations(self.rerun_iterations)
                watchers.append(recording.__enter__())
                stack.push(partial(self._end_recording, recording))
            if self.live or self.live_serve or self.live_connect is not None:
                address = self.live_connect
                if self.live_serve:
                    address = browser.enter_context(live.server(lambda page: say(f"open {page}")))
                watching = live.spawned() if address is None else live.connected(address)
                watchers.append(stack.enter_context(watching))

            def forward(step: Any) -> None:
                for watcher in watchers:
                    watcher(step)

            yield forward

    def _end_recording(self, recording: AbstractContextManager[Any], *problem: Any) -> None:
        if problem[0] is not None:
            recording.__exit__(*problem)
        elif self.rerun_iterations is not None:
            self._save(self.rerun_iterations, lambda _: recording.__exit__(None, None, None))

    def _print(self, answer: Answer) -> int:
        """Print the document as JSON, or its text for people; return the exit code."""
        process.check()
        document = answer.document
        if answer.save or answer.record or answer.files is not None:
            document = {**document, "written": self.written, "not_written": self.missing}
        if self.json:
            utf8 = (sys.stdout.encoding or "").lower().replace("-", "") == "utf8"
            print(json.dumps(plain(document), indent=2, ensure_ascii=not utf8, allow_nan=False))
        else:
            console = make_console(sys.stdout)
            console.file.write(answer.verbatim)
            for place, block in enumerate(answer.blocks):
                _print_block(console, block, last=place == len(answer.blocks) - 1)
            if answer.verbatim:
                console = make_console(sys.stderr)
            for line in (*answer.lines, *self._files()):
                console.print(line, soft_wrap=True)
        good = answer.solved and (answer.certified or self.allow_uncertified)
        return int(not good or bool(self.missing))

    def _files(self) -> Iterator[str]:
        """Yield a line per written file (or their count in a folder) and per failed file."""
        inside = [p for p in self.written if self.out and Path(p).is_relative_to(self.out)]
        if len(inside) > 1:
            yield f"written: {len(inside)} files in {self.out}"
        yield from (f"written: {p}" for p in self.written if len(inside) < 2 or p not in inside)
        yield from (f"not written: {file['file']}: {file['reason']}" for file in self.missing)


def say(line: str) -> None:
    """Print a line for people on standard error, also with ``--json``."""
    print(line, file=process.messages(), flush=True)


def _print_block(console: Console, block: Block, *, last: bool) -> None:
    if isinstance(block, str):
        console.print(block)
        return
    tables = [block] if isinstance(block, Table) else block
    bodies = [str(replace(table, notes=(), title="")).splitlines() for table in tables]
    widths = [max(map(len, body)) for body in bodies]
    fitting = [t for t, width in zip(tables, widths, strict=True) if width <= console.width]
    console.print((*fitting, tables[-1])[0], *([] if last else [""]))


def make_console(stream: Any) -> Console:
    """Return a console on a stream; in a pipe it has 120 columns, and no colours."""
    from rich.console import Console

    sized = stream.isatty() or "COLUMNS" in os.environ
    return Console(
        file=stream,
        width=None if sized else 120,
        color_system=None if os.environ.get("NO_COLOR") else "auto",
        highlight=False,
        markup=False,
        emoji=False,
    )


def check_output(option: str, path: Path | None, endings: Sequence[str]) -> None:
    """Reject a path that cannot be written: a file of these endings, or a folder for ""."""
    if path is None:
        return
    folder = nearest(path) if "" in endings else None
    if folder is None and path.suffix not in endings:
        raise InputError(f"{option} must end in {' or '.join(endings)}, not {str(path)!r}")
    if folder is not None and path.is_symlink() and not path.exists():
        raise InputError(f"{option} is a broken link: {str(path)!r}")
    if folder is not None and not folder.is_dir():
        raise InputError(f"{option} must be a folder, but {str(folder)!r} is a file")
    try:
        if folder is None:
            check_writable(path)
        else:  # permissions do not show a read-only disk or /proc, so write a file
            tempfile.TemporaryDirectory(dir=folder).cleanup()
    except OSError as problem:
        reason = getattr(problem, "reason", (problem.strerror or type(problem).__name__).lower())
        raise InputError(f"{option} cannot be written to {str(path)!r}: {reason}") from None


def nearest(path: Path) -> Path:
    """Return the path itself, or the nearest folder above it that exists."""
    return next(p for p in (path, *path.absolute().parents) if p.exists())


def _show_recording(record: Save | Path, rerun: Path | None) -> None:
    """Show the written recording, or a temporary one, until the viewer is closed."""
    from microbot_ocp.views.live import LOOPBACK, wait_for_viewer

    with tempfile.TemporaryDirectory(prefix="microbot_ocp_") as folder:
        path = rerun or (record if isinstance(record, Path) else Path(folder) / "recording.rrd")
        if rerun is None and not isinstance(record, Path):
            record(path)
        # A new viewer each time: an open viewer may listen on every network interface.
        status = wait_for_viewer([viewer("--open"), "--bind", LOOPBACK, "--new", str(path)])
    if status:
        raise InputError(f"the Rerun viewer ended with status {status}")


def has_display() -> bool:
    """Return whether a screen is available."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def viewer(option: str, screen: bool = True) -> str:
    """Return the path of the Rerun viewer; refuse the option without viewer or screen."""
    from microbot_ocp.views.live import find_viewer

    path = find_viewer()
    if path is None:
        raise InputError(f"{option} needs the Rerun viewer: pip install rerun-sdk")
    if screen and not has_display():
        raise InputError(
            f"{option} needs a screen (DISPLAY or WAYLAND_DISPLAY); write the recording with "
            "--rerun FILE.rrd, or the iterations of a solver with --rerun-iterations FILE.rrd, and "
            "open it on a machine with a screen"
        )
    return path
