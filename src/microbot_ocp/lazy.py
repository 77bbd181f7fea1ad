"""Public names of a package, loaded when they are first asked for.

They stand in one place, the stub ``__init__.pyi`` beside the package's ``__init__.py``, from where
type checkers and editors know them, too. So ``import microbot_ocp`` does not load CasADi.
"""

from __future__ import annotations

import ast
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any


def load_on_demand(name: str) -> None:
    """Make the package of this name find the names of its stub.

    Parameters
    ----------
    name : str
        ``__name__`` in the package's ``__init__.py``.
    """
    package = sys.modules[name]
    homes = stub_homes(Path(str(package.__file__)).with_suffix(".pyi"))
    package.__dict__.update(__all__=sorted(homes), _homes=homes)
    package.__class__ = _LazyPackage


def stub_homes(stub: Path) -> dict[str, tuple[str, str]]:
    """Module and name there of every ``from module import name as public`` of a stub."""
    return {
        alias.asname: (statement.module or "", alias.name)
        for statement in ast.parse(stub.read_text("utf-8")).body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
        if alias.asname is not None
    }


class _LazyPackage(ModuleType):
    _homes: dict[str, tuple[str, str]]

    def __getattr__(self, name: str) -> Any:
        if name not in self._homes:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        module, own = self._homes[name]
        if module == self.__name__:
            value = import_module(f"{module}.{own}")
        else:
            value = getattr(import_module(module), own)
        self.__dict__[name] = value
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        # The import of a folder binds it here: a public function of its name comes first.
        home = self._homes.get(name)
        if isinstance(value, ModuleType) and home is not None and home[0] != self.__name__:
            return
        super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*self._homes, *(n for n in self.__dict__ if n.startswith("__"))})
