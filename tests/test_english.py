"""Plain English: comments are sentences, docstrings begin with a verb or a noun."""

from __future__ import annotations

import ast
import io
import re
import tokenize
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
RULES = tomllib.loads((Path(__file__).parent / "english.toml").read_text())
MODULES = [
    path
    for top in ("src", "problems", "benchmarks")
    for path in sorted((ROOT / top).rglob("*.py"))
    if not any(path.is_relative_to(ROOT / name) for name in RULES["not_yet"])
]
Documented = ast.Module | ast.ClassDef | ast.FunctionDef
COMMENT = re.compile(
    r"#+\s*(of|what|which|where|whether|that|whose|those|these|as|else|in the place|by|from|for|not"
    r"|with|without|times|to|one that)\b",
    re.IGNORECASE,
)
# A noun phrase, which may have an article, begins with none of these.
NO_NOUN = re.compile(
    r"(what|whether|how|which|where|when|why|who|whose|give|do|does|that|those|these|this|such|its?|they"
    r"|their|them|then|of|by|in|into|with|without|as|from|for|to|so|not|if|because)\b",
    re.IGNORECASE,
)
ENTRY = re.compile(r"(?m)^(\*{0,2}\w[\w.*]*(?:, \*{0,2}\w[\w.*]*)*) : .+\n((?:[ ]{4,}.+\n?)+)")
VAGUE = re.compile(r"\b(the same|then|of these)\b", re.IGNORECASE)


def comments(text: str) -> Iterator[tuple[int, str]]:
    """Yield line and text of each comment; of consecutive whole lines only the first."""
    below = 0
    for token in comment_tokens(text):
        line, column = token.start
        alone = not token.line[:column].strip()
        if not (alone and line == below):
            yield line, token.string
        below = line + 1 if alone else 0


@cache
def comment_tokens(text: str) -> list[tokenize.TokenInfo]:
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [token for token in tokens if token.type == tokenize.COMMENT]


@cache
def tree_of(text: str) -> ast.Module:
    return ast.parse(text)


def docstrings(text: str) -> Iterator[tuple[Documented, str]]:
    """Yield each module, class and function that has a docstring, with the docstring."""
    for node in ast.walk(tree_of(text)):
        if isinstance(node, Documented) and (docstring := ast.get_docstring(node)):
            yield node, docstring


def begins_wrongly(node: Documented, docstring: str) -> bool:
    """Return True if a function's docstring begins with no verb, any other's with no noun."""
    decorators = " ".join(map(ast.unparse, getattr(node, "decorator_list", ())))
    if isinstance(node, ast.FunctionDef) and "property" not in decorators:
        return docstring.split()[0].rstrip(".,:;") not in RULES["verbs"].split()
    return bool(NO_NOUN.match(docstring))


def faults(text: str) -> Iterator[str]:
    """Yield each comment, first line and entry of a table that breaks a rule, with its line."""
    for line, comment in comments(text):
        if COMMENT.match(comment):
            yield f"{line}: {comment}"
    for node, docstring in docstrings(text):
        line = 1 if isinstance(node, ast.Module) else node.lineno
        if begins_wrongly(node, docstring):
            yield f"{line}: {docstring.splitlines()[0]}"
        for names, description in ENTRY.findall(docstring):
            if NO_NOUN.match(description.strip()) or VAGUE.search(description):
                yield f"{line}: {names} : {description.strip()}"


def too_often(text: str) -> bool:
    """Return True if "what" stands more than once, and more than once in 1,000 words."""
    words = re.findall(r"[a-z']+", text.lower())
    return words.count("what") > max(1, len(words) / 1000)


@pytest.mark.parametrize(
    "folder", sorted({path.parent for path in MODULES}), ids=lambda f: str(f.relative_to(ROOT))
)
def test_prose_is_sentences_and_names_its_nouns(folder: Path) -> None:
    modules = {path.name: path.read_text() for path in MODULES if path.parent == folder}
    texts = modules.values()
    assert [f"{name}:{fault}" for name, text in modules.items() for fault in faults(text)] == []
    prose = [docstring for text in texts for _, docstring in docstrings(text)]
    prose += [token.string for text in texts for token in comment_tokens(text)]
    assert not too_often("\n".join(prose))


@pytest.mark.parametrize("page", RULES["pages"])
def test_pages_name_their_nouns(page: str) -> None:
    assert not too_often((ROOT / page).read_text())


@pytest.mark.parametrize(
    "text",
    [
        "x = 1  # of the last step",
        "# which is odd\n# and more\n",
        'def f():\n    """The torque."""',
        'def f():\n    """Whether it moves."""',
        'class A:\n    """What moves."""',
        'class A:\n    """State.\n\n    q : float\n        The same as before.\n    """',
        'class A:\n    """State.\n\n    q : float\n        Its angle.\n    """',
    ],
)
def test_a_fault_is_found(text: str) -> None:
    assert len(list(faults(text))) == 1
