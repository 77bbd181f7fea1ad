"""Shared parts of the scripts: command-line options, and exit code 2 with one line on bad input."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np

import microbot_ocp as mo


def parser(text: str | None, out: str = "") -> argparse.ArgumentParser:
    """Build the options of a script from its docstring; ``out`` adds --out and --robot."""
    made = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    if out:
        made.add_argument("--out", type=Path, default=Path(out), help="folder to write into")
        made.add_argument(
            "--robot", default="microbot", help="packaged 3-joint robot or .toml file"
        )
    return made


def numbers(name: str, text: str, size: int | None = None) -> np.ndarray:
    """Read finite numbers from a list separated by commas."""
    try:
        found = np.array([float(entry) for entry in text.split(",")])
    except ValueError:
        raise mo.InputError(f"{name} must be numbers with commas between, not {text!r}") from None
    if (size and found.size != size) or not np.isfinite(found).all():
        raise mo.InputError(f"{name} must be {size or 'all'} finite numbers, not {text}")
    return found


def run(main: Callable[[argparse.Namespace], None], arguments: argparse.ArgumentParser) -> NoReturn:
    """Call ``main`` with the arguments of the command line, and end the program."""
    # argparse takes a list that begins with a minus sign for an option; a leading space prevents it
    given = [" " + word if re.match(r"-[\d.]", word) else word for word in sys.argv[1:]]
    try:
        main(arguments.parse_args(given))
        sys.stdout.flush()
    except BrokenPipeError:  # a reader such as head has closed the pipe
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (mo.InputError, OSError, EOFError, KeyboardInterrupt) as problem:
        print(f"error: {str(problem) or 'interrupted'}", file=sys.stderr)
        sys.exit(2)
    sys.exit(0)
