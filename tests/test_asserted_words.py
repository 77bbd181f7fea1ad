"""Tests ask a message for kinds, names, numbers and units: its sentences stay free."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).resolve().parent
FILES = sorted(TESTS.rglob("*.py"))
UNIT = r"(?:m|mm|cm|um|s|ms|us|min|rad|deg|kg|g|N|Nm|W|J|Hz|A|K|Pa|bytes?)\b"
WORD = rf"(?!{UNIT})(?:[Aa]|[A-Za-z][a-z]+(?:['-][a-z]+)*)"
SENTENCE = re.compile(rf"(?<![\w.\\-]){WORD}(?:[^\w\s]*\s+[(]?{WORD}){{3}}(?![\w(/-])")
QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"|`[^`]*`")


def texts(node: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and text of each literal in an expression, each value in it as a digit."""
    if isinstance(node, ast.JoinedStr):
        parts = [v.value if isinstance(v, ast.Constant) else "0" for v in node.values]
        yield node.lineno, "".join(map(str, parts))
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.lineno, node.value
    else:
        for child in ast.iter_child_nodes(node):
            yield from texts(child)


def asserted(tree: ast.AST) -> Iterator[ast.expr]:
    """Yield each expression that a message is asked for."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            if ast.unparse(node.func).split(".")[-1] in ("refused", "tells", "warned"):
                yield from node.args
            yield from (keyword.value for keyword in node.keywords if keyword.arg == "match")
        elif isinstance(node, ast.Assert):
            for part in ast.walk(node.test):
                if isinstance(part, ast.Compare) and isinstance(part.ops[0], ast.In | ast.NotIn):
                    yield part.left


def tables(function: ast.AST) -> Iterator[tuple[list[str], ast.expr]]:
    """Yield the names that a table of a test feeds, with the table."""
    for node in ast.walk(function):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("parametrize"):
            names = " ".join(text for _, text in texts(node.args[0])).replace(",", " ").split()
            yield names, node.args[1]
        elif isinstance(node, ast.For | ast.comprehension):
            yield [n.id for n in ast.walk(node.target) if isinstance(n, ast.Name)], node.iter
        elif isinstance(node, ast.Assign) and isinstance(node.value, ast.Subscript):
            targets = ast.walk(node.targets[0])
            yield [n.id for n in targets if isinstance(n, ast.Name)], node.value.value


def column(table: ast.expr, index: int, width: int) -> Iterator[ast.expr]:
    """Yield the expressions in one column of a table."""
    for node in ast.walk(table):
        row = node.args if isinstance(node, ast.Call) else getattr(node, "elts", [])
        if len(row) == width > 1:
            yield row[index]
        elif width == 1:
            yield from row


def sentences(text: str) -> Iterator[str]:
    """Yield each text of a test module that asserts four plain words in a row, with its line."""
    tree = ast.parse(text)
    constants = {
        ast.unparse(node.target if isinstance(node, ast.AnnAssign) else node.targets[0]): node.value
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value
    }
    found: list[ast.AST] = list(asserted(tree))
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            used = {
                n.id for a in asserted(function) for n in ast.walk(a) if isinstance(n, ast.Name)
            }
            for names, table in tables(function):
                rows = constants.get(ast.unparse(table), table)
                for index, name in enumerate(names):
                    found += column(rows, index, len(names)) if name in used else []
    for line, said in sorted({row for node in found for row in texts(node)}):
        if SENTENCE.search(QUOTED.sub("0", said)):
            yield f"{line}: {said}"


@pytest.mark.parametrize(
    "folder", sorted({path.parent for path in FILES}), ids=lambda f: str(f.relative_to(TESTS))
)
def test_no_sentence_of_a_message_is_asserted(folder: Path) -> None:
    modules = [path for path in FILES if path.parent == folder]
    assert [f"{p.name}:{said}" for p in modules for said in sentences(p.read_text())] == []


@pytest.mark.parametrize(
    ("code", "count"),
    [
        ("with pytest.raises(E, match='mass must be finite'): pass", 1),
        ("with refused('joint 1', f'speed of joint {k} must be finite'): pass", 0),
        ("with refused('joint 1', f'{k}: speed must be finite'): pass", 1),
        ("with warned('no C compiler', '0.5 s'): pass", 0),
        ("tells(text, 'a mass of 3 kg of `the tool of the arm`', '1 rad at 2 s')", 0),
        ("assert 'velocity of the elbow' in verdict", 1),
        ("assert 'first_guess must be given' in verdict", 0),
        ("def f():\n for x, s in (1, 'x'), (2, 'mass must be finite'): tells(x, s)", 1),
        (
            "A = [(1, 'mass must be finite')]\n@parametrize('x, s', A)\ndef f(x, s): tells(x, s)",
            1,
        ),
        ("A = {1: (2, 'mass must be finite')}\ndef f(k): _, s = A[k]; tells('', s)", 1),
        ("@parametrize('x', ['a b', 'to be or not'])\ndef f(x): assert x", 0),
    ],
)
def test_a_sentence_is_found(code: str, count: int) -> None:
    assert len(list(sentences(code))) == count
