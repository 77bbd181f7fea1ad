"""Write commands and options between the marks of ``docs/cli.md``, as the program declares them.

python docs/make_commands.py
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path

from typer.models import ArgumentInfo

from microbot_ocp.cli._declaration import LIMITS, Command, Kind
from microbot_ocp.cli._program import COMMANDS

PAGE = Path(__file__).resolve().parent / "cli.md"
MARKS = "<!-- made by docs/make_commands.py -->\n", "<!-- end of what is made -->\n"


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


def table(kinds: Iterable[Kind]) -> str:
    """List the options of some parameters."""
    return "\n| option | |\n|---|---|\n" + "".join(rows(kinds))


def section(name: str, command: Command) -> Iterator[str]:
    """Say of a command what it says of itself, and its options but for the limits."""
    kinds = command.kinds
    words = [str(kind.metavar) for kind in kinds.values() if kind.positional]
    words = ["ROBOT", *words] if "robot" in kinds and not words else words
    yield f"\n### `{' '.join([name, *words])}`\n\n{command.help}\n\n"
    yield f"```console\n$ {command.example}\n```\n"
    listed = {key: kind for key, kind in kinds.items() if not isinstance(kind, type(LIMITS))}
    yield table(listed.values())
    if len(listed) < len(kinds):
        yield "\nAnd the [limits](#limits).\n"


def commands_text() -> str:
    """Write everything between the marks."""
    commands = declared()
    text = "".join(part for item in commands.items() for part in section(*item))
    intro = "Of `compare` and `time-optimal`; those not given are the robot's own."
    return f"{text}\n### Limits\n\n{intro}\n{table([LIMITS])}\n"


def updated(page: str) -> str:
    """Return a page with the commands between its marks."""
    before, _, rest = page.partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    return "".join([before, MARKS[0], commands_text(), MARKS[1], after])


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text("utf-8")), "utf-8")
