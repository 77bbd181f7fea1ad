"""Write the table of commands between the marks of ``docs/cli.md``, as the program declares them.

python docs/make_commands.py
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from microbot_ocp.cli._declaration import Command
from microbot_ocp.cli._program import COMMANDS

PAGE = Path(__file__).resolve().parent / "cli.md"
MARKS = "<!-- made by docs/make_commands.py -->\n", "<!-- end of what is made -->\n"


def declared() -> dict[str, Command]:
    """Return every command of the program by its name."""
    return {
        name: getattr(import_module(f"microbot_ocp.cli.{module}"), name.replace("-", "_"))
        for name, module in COMMANDS.items()
    }


def rows() -> Iterator[str]:
    """Yield a row for every command: its name, what it does, a call of it."""
    yield "| command | what it does | such as |\n|---|---|---|\n"
    for name, command in declared().items():
        what = command.help.partition("\n\n")[0].replace("|", "\\|")
        yield f"| `{name}` | {what} | `{command.example}` |\n"


def updated(page: str) -> str:
    """Return a page with the commands between its marks."""
    before, _, rest = page.partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    return "".join([before, MARKS[0], "\n", *rows(), "\n", MARKS[1], after])


if __name__ == "__main__":
    PAGE.write_text(updated(PAGE.read_text("utf-8")), "utf-8")
