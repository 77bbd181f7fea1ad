"""References in docstrings, such as ``:func:`solve_ik```, as links of the API reference.

An extension of Griffe, which reads the docstrings for mkdocstrings.
"""

from __future__ import annotations

import re
from typing import Any

import griffe

ROLE = re.compile(r":(?:func|meth|class|data|attr|mod):`~?(?P<name>[\w.]+)`")


class References(griffe.Extension):
    """Turn Sphinx's roles into links; a name without a page stays a name."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite the docstring of one module, class, function or attribute."""
        if obj.docstring is None:
            return

        def link(found: re.Match[str]) -> str:
            name = found["name"]
            first, dot, rest = name.partition(".")
            try:
                target = obj.resolve(first) + dot + rest
            except griffe.NameResolutionError:
                target = name
            short = name.removeprefix("microbot_ocp.").rsplit(".", 1)[-1]
            return f'<autoref identifier="{target}" optional><code>{short}</code></autoref>'

        obj.docstring.value = ROLE.sub(link, obj.docstring.value)
