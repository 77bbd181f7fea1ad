"""The code of a page, run block by block from an empty folder, its output compared.

Python blocks run in one namespace, in the order of the page. A ``text`` block right after one is
what it prints, with ``...`` for what may differ; the last digit of a number may differ by one, as
it does between machines. Other blocks with a ``title`` are files that
they need. Lines ``$ microbot-ocp ...`` of a ``console`` block are run, too. A block that cannot run
stands after ``<!-- not run: why -->``.

    python docs/tools/blocks.py docs/tutorial.md
"""

from __future__ import annotations

import argparse
import contextlib
import doctest
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from itertools import zip_longest
from pathlib import Path

FENCE = re.compile(
    r"^(?P<indent>[ ]*)```(?P<language>\w+)(?P<rest>[^\n]*)\n(?P<body>.*?)^(?P=indent)```[ ]*$",
    re.MULTILINE | re.DOTALL,
)
TITLE = re.compile(r'title="([^"]+)"')
NOT_RUN = re.compile(r"<!-- not run: [^>]+ -->\s*$")
COMPARE = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
NUMBER = re.compile(r"[+-]?\d+\.\d*(?:e[+-]?\d+)?|[+-]?\d+e[+-]?\d+")  # integers are exact


@dataclass(frozen=True)
class Block:
    """A fenced block of a page.

    Attributes
    ----------
    language : what stands behind the fence
    text : the code
    line : where it begins in the page, from 1
    title : file name of a block that is a file; empty for the others
    output : what it prints; None where the page does not say
    run : whether it can be run
    """

    language: str
    text: str
    line: int
    title: str
    output: str | None
    run: bool


class Different(AssertionError):
    """A block printed something else than the page says, or a command failed."""


def blocks(page: str) -> list[Block]:
    """The blocks of a page, in their order."""
    fences = list(FENCE.finditer(page))
    found = []
    for here, after in zip_longest(fences, fences[1:]):
        shown = None
        if after and after["language"] == "text" and not page[here.end() : after.start()].strip():
            shown = _text(after)
        title = TITLE.search(here["rest"])
        found.append(
            Block(
                language=here["language"],
                text=_text(here),
                line=page.count("\n", 0, here.start()) + 1,
                title=title[1] if title else "",
                output=shown,
                run=NOT_RUN.search(page, 0, here.start()) is None,
            )
        )
    return found


def _text(fence: re.Match[str]) -> str:
    """Body of a fence, without the indentation of the list that it stands in."""
    lines = fence["body"].splitlines(keepends=True)
    return "".join(line.removeprefix(fence["indent"]) for line in lines)


def run_page(path: Path, folder: Path) -> int:
    """Run the blocks of a page in ``folder`` and count the Python blocks that ran.

    Raises
    ------
    Different
        A block prints something else than the page says, or a command fails.
    Exception
        Whatever a block raises.
    """
    namespace: dict[str, object] = {"__name__": "__main__"}
    count = 0
    with working_in(folder):
        for block in blocks(path.read_text("utf-8")):
            if not block.run:
                continue
            if block.title:
                Path(block.title).write_text(block.text, "utf-8")
            elif block.language == "python":
                run_block(block, path, namespace)
                count += 1
            elif block.language == "console":
                run_commands(block, path)
    return count


def run_block(block: Block, path: Path, namespace: dict[str, object]) -> None:
    """Run one Python block and compare what it prints."""
    # the lines of a traceback are those of the page
    code = compile("\n" * block.line + block.text, str(path), "exec")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(code, namespace)
    if block.output is None:
        return
    checker, example = doctest.OutputChecker(), doctest.Example(block.text, block.output)
    found = rounded_alike(printed.getvalue(), block.output)
    if not checker.check_output(block.output, found, COMPARE):
        difference = checker.output_difference(example, found, COMPARE)
        raise Different(f"{path}, line {block.line}\n{difference}")


def rounded_alike(printed: str, page: str) -> str:
    """Return what was printed with the page's numbers that differ by one in the last digit."""
    numbers, wanted = list(NUMBER.finditer(printed)), NUMBER.findall(page)
    if len(numbers) != len(wanted):
        return printed
    text, end = "", 0
    for number, want in zip(numbers, wanted, strict=True):
        digit = Decimal((0, (1,), int(Decimal(want).as_tuple().exponent)))
        alike = abs(Decimal(number[0]) - Decimal(want)) <= digit
        text += printed[end : number.start()] + (want if alike else number[0])
        end = number.end()
    return text + printed[end:]


def run_commands(block: Block, path: Path) -> None:
    """Run the commands of this program in a console block."""
    for line in block.text.splitlines():
        program, *words = shlex.split(line.removeprefix("$ "), comments=True) or [""]
        if program != "microbot-ocp":
            continue
        command = [sys.executable, "-m", "microbot_ocp.cli", *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise Different(f"{path}, line {block.line}: {line} ends with {done.stderr}")


@contextlib.contextmanager
def working_in(folder: Path) -> Iterator[None]:
    """``folder`` as the working directory, and the former one afterwards."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def main() -> int:
    parser = argparse.ArgumentParser(description="Run the code of pages and compare its output.")
    parser.add_argument("pages", nargs="+", type=Path)
    for page in parser.parse_args().pages:
        begin = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            try:
                count = run_page(page.resolve(), Path(folder))
            except Different as difference:
                print(difference, file=sys.stderr)
                return 1
        print(f"{page}: {count} blocks, {time.perf_counter() - begin:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
