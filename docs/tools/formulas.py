"""Formulas of the pages as MathML, written when the site is built: nothing is loaded to show them.

A hook of MkDocs. ``pymdownx.arithmatex`` leaves TeX in elements of class ``arithmatex``; here it
becomes MathML, which browsers draw themselves. TeX that the converter does not know is an error.
"""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert

FORMULA = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<tex>.*?)\\[)\]]</(?P=tag)>', re.DOTALL
)
# A command or environment that was not understood is left in the MathML as text.
UNKNOWN = re.compile(r"\\[A-Za-z]+|&")
TAG = re.compile(r"<[^>]*>")


class UnknownCommand(ValueError):
    """TeX that cannot be converted."""


def mathml(tex: str, *, block: bool) -> str:
    """One formula as a ``<math>`` element; the TeX stays in it for those who copy or read aloud.

    Raises
    ------
    UnknownCommand
        A command that the converter does not know.

    Examples
    --------
    >>> mathml("x^2", block=False)[:50]
    '<math xmlns="http://www.w3.org/1998/Math/MathML" d'
    """
    element = convert(tex, display="block" if block else "inline")
    shown = html.unescape(TAG.sub("", element))
    unknown = UNKNOWN.search(shown)
    if unknown:
        raise UnknownCommand(f"{unknown[0]} in the formula {tex}")
    label = html.escape(" ".join(tex.split()), quote=True)
    return element.replace("<math ", f'<math aria-label="{label}" ', 1)


def on_page_content(content: str, **_: object) -> str:
    """Replace the formulas of one page (called by MkDocs)."""

    def replacement(found: re.Match[str]) -> str:
        block = found["tag"] == "div"
        element = mathml(html.unescape(found["tex"]).strip(), block=block)
        return f'<div class="formula">{element}</div>' if block else element

    return FORMULA.sub(replacement, content)
