"""The program: its commands in order, and how an ending becomes an exit code.

0 is success, 1 a task without a solution or a result that was not written, 2 bad input (one line on
standard error), 70 a fault of this program, 128 and its number a signal (130 Ctrl-C).
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from microbot_ocp._base.checks import InputError, shortened
from microbot_ocp._base.writing import NotWritten
from microbot_ocp.cli import _interrupt as interrupt
from microbot_ocp.cli._commands import PROGRAM, SETTINGS, Commands, example

NOT_WRITTEN = 1
BAD_INPUT = 2
FAULT = 70
CONTROL = re.compile(r"\x1b(?!\[[0-9;]*m)|[\x00-\x08\x0b-\x1a\x1c-\x1f\x7f-\x9f]")
TRACEBACK = "MICROBOT_OCP_TRACEBACK"  # environment variable that asks for Python's own report

app = typer.Typer(
    cls=Commands,
    epilog=example("compare microbot --via-deg '0,0,0 -8,45,30 -90,90,90'"),
    **SETTINGS,
)


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"{PROGRAM} {version('microbot_ocp')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    _: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Time-optimal and textbook motions of serial manipulators, compared under the same limits.

    ROBOT is a name from `microbot-ocp robots` or the path of a .toml or .urdf file.
    Every command takes --json. Exit codes: 0 done, 1 not solved, 2 bad input.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Default those of the process.

    Returns
    -------
    int
        Exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):  # a stream that was replaced
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    command = typer.main.get_command(app)
    given = None if arguments is None else list(arguments)
    try:
        code = command.main(args=given, prog_name=PROGRAM, standalone_mode=False)
        sys.stdout.flush()
    except NotWritten as problem:
        return _refuse(str(problem), NOT_WRITTEN)
    except InputError as problem:
        return _refuse(str(problem))
    except typer.TyperException as problem:
        return _refuse(_lowered(problem.format_message()))
    except KeyboardInterrupt:
        return interrupt.exit_code()
    except OSError as problem:
        where = f"{problem.filename}: " if problem.filename is not None else _no_folder()
        return _refuse(f"{where}{_lowered(problem.strerror or str(problem))}")
    except Exception as problem:
        if interrupt.pressed():  # CasADi turned it into another error
            return interrupt.exit_code()
        return _fault(problem)
    except SystemExit as ending:  # raised by the completion scripts
        return ending.code if isinstance(ending.code, int) else 0
    return interrupt.exit_code() if interrupt.pressed() else int(code or 0)


def run() -> int:
    """The program as :func:`~microbot_ocp.cli.entry` runs it."""
    warnings.showwarning = _tell
    with contextlib.suppress(AttributeError, OSError, ValueError):  # a stream that was replaced
        stream = io.BufferedWriter(_Output(sys.stdout.fileno(), "w", closefd=False))
        sys.stdout = _Text(
            stream, sys.stdout.encoding, line_buffering=bool(sys.stdout.line_buffering)
        )
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    if hasattr(signal, "SIGXFSZ"):
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # a file too large is an error like others
    return main()


class _Output(io.FileIO):
    """Standard output, of which an error says that it is one of it."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as problem:
            reason = _lowered(problem.strerror or str(problem))
            raise NotWritten("standard output", reason) from None


class _Text(io.TextIOWrapper):
    """Standard output without what names in files might tell a terminal to do."""

    def write(self, text: str) -> int:
        return super().write(printable(text))


def printable(text: str) -> str:
    r"""Text without control characters, but for ends of lines, tabulators and colours.

    >>> printable("a\x1b[2Jb\x1b[31mc\a")
    'a[2Jb\x1b[31mc'
    """
    return CONTROL.sub("", text)


def _no_folder() -> str:
    """What an error without the name of a file is about: the current folder, if it is gone."""
    try:
        os.getcwd()
    except OSError:
        return "the current folder: "
    return ""


def _fault(problem: Exception) -> int:
    """One line on an error that nobody foresaw."""
    if os.environ.get(TRACEBACK):
        raise problem
    what = f"{type(problem).__name__}: {problem}" if str(problem) else type(problem).__name__
    if isinstance(problem, MemoryError | RecursionError):
        return _refuse(f"the task is too large: {what}")
    _say(
        f"error: a fault of this program, please report it: {shortened(what, 200)} "
        f"({TRACEBACK}=1 shows where)"
    )
    return FAULT


def _tell(message: Warning | str, *_: object, **__: object) -> None:
    """Say a warning on one line, without the place in the program that it comes from."""
    _say(f"warning: {' '.join(str(message).split())}")


def _refuse(sentence: str, code: int = BAD_INPUT) -> int:
    _say(f"error: {shortened(sentence, 290)}")
    return code


def _say(line: str) -> None:
    """Print on standard error, if anything can be: the exit code stays what it is."""
    with contextlib.suppress(OSError, ValueError):
        print(printable(line), file=sys.stderr, flush=True)


def _lowered(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:].rstrip(".")
