"""Program of the command line: list of commands, errors, exit codes.

A command's module is loaded when the command is called. The list of commands reads names and
docstrings from the source, so that ``--help`` does not wait for CasADi.
"""

from __future__ import annotations

import ast
import contextlib
import io
import os
import re
import signal
import sys
import warnings
from collections.abc import Sequence
from enum import IntEnum
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from microbot_ocp._base import checks
from microbot_ocp._base.checks import InputError
from microbot_ocp._base.schema import suggestion
from microbot_ocp._base.system import signals
from microbot_ocp._base.writing import NotWritten
from microbot_ocp.cli import _process as process

PROGRAM = "microbot-ocp"
COMMANDS = {  # module of each command
    "demo": "_motions",
    **dict.fromkeys(("robots", "show", "limits", "fk", "ik"), "_robots"),
    **dict.fromkeys(("simulate", "compare", "time-optimal", "solve"), "_motions"),
    "design": "_design",
    **dict.fromkeys(("check", "studio"), "_motions"),
    **dict.fromkeys(("sweep", "replay", "export"), "_files"),
    "doctor": "_doctor",
}
CONTROL = re.compile(r"\x1b(?!\[[0-9;]*m)|[\x00-\x08\x0b-\x1a\x1c-\x1f\x7f-\x9f]")
TRACEBACK = "MICROBOT_OCP_TRACEBACK"  # environment variable: print Python's traceback of a fault
# Help is plain text, because rich would double the time of --help.
SETTINGS: dict[str, Any] = {
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


class ExitCode(IntEnum):
    """Exit code of the program; after a signal 128 plus its number (130 after Ctrl-C)."""

    DONE = 0
    NOT_SOLVED = 1  # no solution, or a result that could not be written
    BAD_INPUT = 2  # reported in one line on standard error
    FAULT = 70  # a fault of this program


class Commands(TyperGroup):
    """Group of all commands, in the order of ``COMMANDS``."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: ProgramCommand(name) for name in COMMANDS}

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command of the first word; refuse an unknown command with a suggestion."""
        if args and args[0] not in self.commands and not args[0].startswith("-"):
            raise InputError(f"no command {args[0]!r}{suggestion(args[0], self.commands)}")
        return super().resolve_command(ctx, args)


class ProgramCommand(TyperCommand):
    """Command with its name and docstring; its module is loaded when it is called."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.module, self.function = COMMANDS[name], name.replace("-", "_")
        del self.help  # the property below replaces it: reading docstrings takes time

    @cached_property
    def help(self) -> str:  # type: ignore[override]
        """Docstring for the list of commands."""
        return _docstrings(self.module)[self.function]

    @cached_property
    def loaded(self) -> Any:
        """Loaded command with its options."""
        module = import_module(f"microbot_ocp.cli.{self.module}")
        declaration = getattr(module, self.function)
        single = typer.Typer(add_completion=False, **SETTINGS)
        epilog = f"\b\nExample:\n  {declaration.example}"
        single.command(self.name, help=declaration.help, epilog=epilog)(declaration.callback)
        return typer.main.get_command(single)

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        """Return the context of the loaded command, which runs in place of this one."""
        return self.loaded.make_context(info_name, args, parent=parent, **extra)


@cache
def _docstrings(module: str) -> dict[str, str]:
    """Read the docstrings of the functions of a module without loading it."""
    nodes = ast.parse((Path(__file__).parent / f"{module}.py").read_text("utf-8")).body
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef)]
    return {node.name: ast.get_docstring(node) or "" for node in functions}


app = typer.Typer(
    cls=Commands,
    epilog=f"\b\nExample:\n  {PROGRAM} compare microbot --via-deg '0,0,0 -8,45,30 -90,90,90'",
    **SETTINGS,
)


def _print_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version

        typer.echo(f"{PROGRAM} {version('microbot_ocp')}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    _: bool = typer.Option(
        False,
        "--version",
        callback=_print_version,
        is_eager=True,
        help="Print the version and exit.",
    ),
) -> None:
    """Compare time-optimal and textbook motions of serial manipulators under the same limits.

    ROBOT is a name from `microbot-ocp robots` or a .toml, .urdf, .xacro or MuJoCo .xml file.
    Every command takes --json. Exit codes: 0 done, 1 not solved, 2 bad input.
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    arguments : sequence of str, optional
        Words of the command line; default those of the process.

    Returns
    -------
    int
        Exit code.
    """
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError, ValueError):  # a test may replace the stream
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    words = None if arguments is None else list(arguments)
    try:
        code = typer.main.get_command(app).main(words, PROGRAM, standalone_mode=False)
        sys.stdout.flush()
    except SystemExit as ending:  # raised by the completion scripts
        return ending.code if isinstance(ending.code, int) else ExitCode.DONE
    except KeyboardInterrupt:
        return process.exit_code()
    except Exception as problem:
        return _refuse(problem)
    return process.exit_code() if process.pressed() else int(code or ExitCode.DONE)


def run() -> int:
    """Run the program as :func:`~microbot_ocp.cli.entry` does."""
    warnings.showwarning = _print_warning
    with contextlib.suppress(AttributeError, OSError, ValueError):  # a replaced standard output
        stream: Any = sys.stdout.buffer
        if isinstance(stream.raw, io.FileIO):  # a console of Windows takes text alone
            stream = io.BufferedWriter(_Output(sys.stdout.fileno(), "w", closefd=False))
        by_line = bool(sys.stdout.line_buffering)
        sys.stdout = _Text(stream, sys.stdout.encoding, line_buffering=by_line)
    for number in signals("SIGPIPE"):
        signal.signal(number, signal.SIG_DFL)
    for number in signals("SIGXFSZ"):
        signal.signal(number, signal.SIG_IGN)  # a file above the size limit raises OSError
    return main()


class _Output(io.FileIO):
    """Standard output whose errors name it."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError as problem:
            reason = _lowered(problem.strerror or str(problem))
            raise NotWritten("standard output", reason) from None


class _Text(io.TextIOWrapper):
    """Standard output without control characters, which names in a file may contain."""

    def write(self, text: str) -> int:
        return super().write(printable(text))


def printable(text: str) -> str:
    r"""Return the text without control characters, except line ends, tabs and colours.

    >>> printable("a\x1b[2Jb\x1b[31mc\a")
    'a[2Jb\x1b[31mc'
    """
    return CONTROL.sub("", text)


def _refuse(problem: Exception) -> int:
    """Print an error in one line; return the exit code."""
    failed = isinstance(problem, NotWritten | process.NotDone)
    code = ExitCode.NOT_SOLVED if failed else ExitCode.BAD_INPUT
    if isinstance(problem, InputError | process.NotDone):
        sentence = str(problem)
    elif isinstance(problem, typer.TyperException):
        sentence = _lowered(problem.format_message())
        if re.search(r"argument\(s\)|: -[\d.]", sentence):  # numbers separated by blanks
            name = re.search(r"\(([^() ]+)[^()]*\)$", sentence)
            if name and getattr(getattr(problem, "ctx", None), "info_name", "") == "robots":
                advice = f"to show one robot: {PROGRAM} show {name[1]}"
            else:
                advice = "separate numbers by commas: 3,-1,4.5, quote points: '0,0 1,1'"
            sentence += f"; {advice}"
    elif isinstance(problem, OSError):
        reason = _lowered(problem.strerror or str(problem))
        sentence = f"{problem.filename}: {reason}" if problem.filename else _no_folder() + reason
    elif process.pressed():  # CasADi turned the KeyboardInterrupt into another error
        return process.exit_code()
    elif os.environ.get(TRACEBACK):
        raise problem
    else:
        kind = type(problem).__name__
        reason = f"{kind}: {problem}" if str(problem) else kind
        if isinstance(problem, MemoryError | RecursionError):
            sentence = f"the task is too large: {reason}"
        else:
            code = ExitCode.FAULT
            reason = f"{reason} ({TRACEBACK}=1 prints the traceback)"
            sentence = f"a fault of this program, please report it: {reason}"
    _print_error(f"error: {checks.sentence(sentence)}")
    return code


def _no_folder() -> str:
    """Return "the current folder: " if the current folder was deleted, else an empty text."""
    try:
        os.getcwd()
    except OSError:
        return "the current folder: "
    return ""


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning on one line, without its line in the source."""
    _print_error(f"warning: {' '.join(str(message).split())}")


def _print_error(line: str) -> None:
    """Print on standard error; if that fails, the exit code is not changed."""
    with contextlib.suppress(OSError, ValueError):
        print(printable(line), file=process.messages(), flush=True)


def _lowered(sentence: str) -> str:
    return sentence[:1].lower() + sentence[1:].rstrip(".")
