"""Write commands and options between the marks of ``docs/cli.md``, as the program declares them.

python docs/make_commands.py
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path

from typer.models import ArgumentInfo

from microbot_ocp.cli._declaration import LIMITS, Command, Kind
from microbot_ocp.cli._program import COMMANDS

PAGE = Path(__file__).resolve().parent / "cli.md"
MARKS = "<!-- made by docs/make_commands.py -->\n", "<!-- end of what is made -->\n"

SHARED = 2  # commands that have an option: then it is listed once


def declared() -> dict[str, Command]:
    """Return every command of the program by its name."""
    return {
        name: getattr(import_module(f"microbot_ocp.cli.{module}"), name.replace("-", "_"))
        for name, module in COMMANDS.items()
    }


def rows(kinds: Iterable[Kind]) -> Iterator[str]:
    """Yield a row for every option of some parameters."""
    for kind in kinds:
        for option in kind.options():
            name, text = f"--{option.name.replace('_', '-')}", str(option.default.help)
            if isinstance(option.default, ArgumentInfo):
                name = ""
            word = option.default.metavar or ""
            if option.default.show_default and option.default.default is not False:
                text += f" Default {option.default.default}."
            yield f"| `{f'{name} {word}'.strip()}` | {text.replace('|', chr(92) + '|')} |\n"


def table(lines: Iterable[str]) -> str:
    """List rows of options."""
    return "\n| option | |\n|---|---|\n" + "".join(lines)


def own_rows(command: Command) -> list[str]:
    """Return the rows of a command but for the limits."""
    kinds = command.kinds.values()
    return list(rows(kind for kind in kinds if not isinstance(kind, type(LIMITS))))


def section(name: str, command: Command, shared: Iterable[str]) -> Iterator[str]:
    """Say of a command what it says of itself, and the options that are its own."""
    kinds = command.kinds
    words = [str(kind.metavar) for kind in kinds.values() if kind.positional]
    words = ["ROBOT", *words] if "robot" in kinds and not words else words
    yield f"\n### `{' '.join([name, *words])}`\n\n{command.help}\n\n"
    yield f"```console\n$ {command.example}\n```\n"
    listed = own_rows(command)
    if own := [row for row in listed if row not in shared]:
        yield table(own)
    others = [row.split("|")[1].split()[0].strip("`") for row in listed if row in shared]
    limits = " and the [limits](#limits)" if "limits" in kinds else ""
    if others:
        named = ", ".join(f"`{option}`" for option in others)
        yield f"\n[Shared](#shared-options): {named}{limits}.\n"


def commands_text() -> str:
    """Write everything between the marks."""
    commands = declared()
    counts = Counter(
        row for command in commands.values() for row in dict.fromkeys(own_rows(command))
    )
    shared = [row for row in counts if counts[row] >= SHARED]
    text = "".join(part for item in commands.items() for part in section(*item, shared))
    intro = "Of `compare` and `time-optimal`; those not given are the robot's own."
    text += f"\n### Shared options\n{table(shared)}"
    names = [f"`{row.split('|')[1].split()[0].strip('`')}`" for row in rows([LIMITS])]
    return f"{text}\n### Limits\n\n{intro}\n\n{', '.join(names)}\n\n"


def updated(page: str) -> str:
    """Return a page with the commands between its marks."""
    before, _, rest = page.partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    return "".join([before, MARKS[0], commands_text(), MARKS[1], after])


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text("utf-8")), "utf-8")
