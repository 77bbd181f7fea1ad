"""The commands of the program, each loaded when it is called.

A list of them needs their names and first lines only, which are read from the source: so ``--help``
does not wait for CasADi.
"""

from __future__ import annotations

import ast
from collections.abc import Sequence
from difflib import get_close_matches
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from microbot_ocp._base.checks import InputError

PROGRAM = "microbot-ocp"
# Help is plain text: drawing it with rich would take as long as everything else together.
SETTINGS: dict[str, Any] = {
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


class Entry(NamedTuple):
    """Where a command is, and how it is called for example."""

    module: str
    function: str
    example: str


COMMANDS = {
    "robots": Entry("_robots", "robots", "robots"),
    "show": Entry("_robots", "show", "show panda"),
    "fk": Entry("_poses", "fk", "fk microbot --q-deg 0,45,30"),
    "ik": Entry("_poses", "ik", "ik microbot --position 3,-1,4.5"),
    "simulate": Entry(
        "_simulation", "simulate", "simulate microbot --q-deg 0,30,20 --out fall.npz"
    ),
    "compare": Entry(
        "_tasks", "compare", "compare microbot --via-deg '0,0,0 -8,45,30 -90,90,90' --out out"
    ),
    "time-optimal": Entry(
        "_tasks", "time_optimal", "time-optimal microbot --via-deg '0,0,0 -90,90,90' --qd-max 2"
    ),
    "solve": Entry("_tasks", "solve", "solve task.toml --out out"),
    "sweep": Entry("_sweep", "sweep", "sweep study.toml --out results --workers 2"),
    "replay": Entry("_replay", "replay", "replay best.npz --rerun best.rrd"),
    "export": Entry("_export", "export", "export best.npz best.csv --rate 100"),
    "doctor": Entry("_doctor", "doctor", "doctor"),
}


def example(command: str) -> str:
    """End of a help text."""
    return f"\b\nExample:\n  {PROGRAM} {command}"


class Commands(TyperGroup):
    """All commands, in the order of the table."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = {name: Command(name, entry) for name, entry in COMMANDS.items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command of the first word; an unknown one is refused with those that are allowed."""
        if args and args[0] not in self.commands and not args[0].startswith("-"):
            near = get_close_matches(args[0], self.commands, 1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise InputError(f"no command {args[0]!r}; {hint}allowed: {', '.join(self.commands)}")
        return super().resolve_command(ctx, args)


class Command(TyperCommand):
    """A command with its name and docstring; its module is loaded when it is called."""

    def __init__(self, name: str, entry: Entry) -> None:
        super().__init__(name)
        self.entry = entry
        del self.help  # for the property below: reading all of them takes a tenth of a second

    @cached_property
    def help(self) -> str:  # type: ignore[override]
        """The docstring, which a list of the commands shows."""
        source = (Path(__file__).parent / f"{self.entry.module}.py").read_text("utf-8")
        found: Sequence[ast.FunctionDef] = [
            node
            for node in ast.parse(source).body
            if isinstance(node, ast.FunctionDef) and node.name == self.entry.function
        ]
        return ast.get_docstring(found[0]) or ""

    @cached_property
    def whole(self) -> Any:
        """The command with its options."""
        function = getattr(
            import_module(f"microbot_ocp.cli.{self.entry.module}"), self.entry.function
        )
        alone = typer.Typer(add_completion=False, **SETTINGS)
        alone.command(self.name, epilog=example(self.entry.example))(function)
        return typer.main.get_command(alone)

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        """The context of the whole command: from here on it stands for this one."""
        return self.whole.make_context(info_name, args, parent=parent, **extra)
