"""A digest of what an object holds: equal content gives equal digests, in every process.

Numbers count with all their bits and their type, arrays with their dtype and shape, functions with
their code and everything that it refers to, dataclasses with the fields that they compare. What
libraries hold counts by its name and the library's version.
"""

from __future__ import annotations

import copyreg
import dis
import functools
import hashlib
import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib.util import find_spec
from pathlib import Path
from types import (
    BuiltinFunctionType,
    CellType,
    CodeType,
    FunctionType,
    MappingProxyType,
    MethodType,
    ModuleType,
)
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.reading import content_of

PACKAGE = __name__.partition(".")[0]
_PLAIN = (type(None), str, bytes, complex, type(Ellipsis))  # whose repr tells them
_SYMBOLS = (ca.SX, ca.MX, ca.DM, ca.Sparsity)
_WRAPPERS = {
    MethodType: ("__func__", "__self__"),
    staticmethod: ("__func__",),
    classmethod: ("__func__",),
    property: ("fget", "fset", "fdel"),
    functools._lru_cache_wrapper: ("__wrapped__",),
}
# of functions and classes: how they are written, not what they do
_WRITTEN = ("__module__", "__doc__", "__dict__", "__weakref__", "__firstlineno__", "__qualname__")


def digest_of(**parts: Any) -> str:
    """Return the SHA-256 of what these parts hold, in hexadecimal digits.

    Raises
    ------
    InputError
        Something inside cannot be told from another of its kind: an open file, compiled code.
    """
    content = _Content()
    for name, part in parts.items():
        content.add(name, name)
        content.add(part, name)
    return content.hash.hexdigest()


class _Content:
    """A hash that parts are added to, and the objects that it has met."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self._shared: dict[int, tuple[int, Any]] = {}  # functions, classes, modules: each once
        self._inside: list[int] = []  # containers around what is added

    def add(self, value: Any, name: str) -> None:
        """Add a value; ``name`` is what to call it where it cannot be."""
        if isinstance(value, Enum):
            self._many(type(value).__name__, (type(value), value.name), name)
        elif isinstance(value, float):
            self._put("float", value.hex())
        elif isinstance(value, int):
            self._put(type(value).__name__, hex(value))
        elif isinstance(value, _PLAIN):
            self._put(type(value).__name__, repr(value))
        elif type(value) is np.ndarray or isinstance(value, np.generic):
            self._array(np.asarray(value), name)
        elif isinstance(value, (FunctionType, type, ModuleType)):
            self._once(value, name)
        elif isinstance(value, CodeType):
            self._code(value, name)
        elif isinstance(value, (set, frozenset)):
            self._put("set", "".join(sorted(digest_of(**{name: entry}) for entry in value)))
        elif isinstance(value, (ca.Function, *_SYMBOLS)):
            self._casadi(value, name)
        elif isinstance(value, BuiltinFunctionType) and isinstance(value.__self__, ModuleType):
            self._once(value.__self__, name)
            self._put("function", value.__qualname__)
        elif id(value) in self._inside:
            self._put("around", str(len(self._inside) - self._inside.index(id(value))))
        else:
            self._inside.append(id(value))
            self._container(value, name)
            self._inside.pop()

    def _put(self, kind: str, content: str | bytes = b"") -> None:
        content = content.encode() if isinstance(content, str) else content
        self.hash.update(f"{kind} {len(content)} ".encode() + content)

    def _many(self, kind: str, values: Iterable[Any], name: str) -> None:
        entries = list(values)
        self._put(kind, str(len(entries)))
        for entry in entries:
            self.add(entry, name)

    def _array(self, array: np.ndarray, name: str) -> None:
        self._put("array", f"{array.dtype.str} {array.shape}")
        if array.dtype.hasobject:
            self._many("objects", array.ravel().tolist(), name)
        else:
            self._put("numbers", array.tobytes())

    def _container(self, value: Any, name: str) -> None:
        if isinstance(value, (list, tuple)):
            self.add(type(value), name)
            self._many("list", value, name)
        elif isinstance(value, (dict, MappingProxyType)):
            self._named("mapping", value, name)
        elif is_dataclass(value):
            self.add(type(value), name)
            counted = [item.name for item in fields(value) if item.compare]
            self._named("fields", {key: getattr(value, key) for key in counted}, name)
        elif inside := _WRAPPERS.get(type(value)):
            self._many(type(value).__name__, (getattr(value, key) for key in inside), name)
        else:
            self._state(value, name)

    def _named(self, kind: str, values: Mapping[Any, Any], name: str) -> None:
        self._put(kind, str(len(values)))
        for key, value in values.items():
            self.add(key, name)
            self.add(value, f"{name}.{key}" if isinstance(key, str) else name)

    def _state(self, value: Any, name: str) -> None:
        """Add any other object: what a copy of it would be made of."""
        reduced = copyreg.dispatch_table.get(type(value))
        try:
            parts: Any = reduced(value) if reduced else value.__reduce_ex__(4)
        except Exception:  # anyone's code
            raise _indistinct(value, name) from None
        if not isinstance(parts, str):
            arguments, state, entries, items = (*parts, None, None, None, None)[1:5]
            self.add(parts[0], name)
            self._many("state", (arguments, state, list(entries or ()), dict(items or ())), name)
        elif _in_library(home := getattr(value, "__module__", None) or type(value).__module__):
            self._put("global", f"{home} {parts}")
        else:
            raise _indistinct(value, name)

    def _casadi(self, value: Any, name: str) -> None:
        try:
            function = value if isinstance(value, ca.Function) else _function_of(value)
            parts = (function, *(function.find_function(part) for part in function.get_function()))
            kinds = {part.class_name() for part in parts}
            content = function.serialize()
        except RuntimeError:
            raise _indistinct(value, name) from None
        if kinds & {"External", "CallbackInternal"}:  # what a library or Python evaluates
            raise _indistinct(value, name)
        self._put("casadi", content)

    def _once(self, value: Any, name: str) -> None:
        """Add a function, class or module: once, then by its number."""
        if id(value) in self._shared:
            self._put("again", str(self._shared[id(value)][0]))
            return
        self._shared[id(value)] = len(self._shared), value
        home = value.__name__ if isinstance(value, ModuleType) else value.__module__
        if _in_library(home):
            version = getattr(sys.modules.get(home.partition(".")[0]), "__version__", "")
            self._put("library", f"{home} {getattr(value, '__qualname__', '')} {version}")
        elif isinstance(value, FunctionType):
            self._function(value, name)
        elif isinstance(value, type):
            members = {k: v for k, v in sorted(vars(value).items()) if k not in _WRITTEN}
            self._many("class", (value.__qualname__, value.__bases__), name)
            self._named("members", {k: v for k, v in members.items() if "_abc_" not in k}, name)
        else:
            self._module(home, name)

    def _function(self, function: FunctionType, name: str) -> None:
        self.add(function.__code__, name)
        self._named("defaults", function.__kwdefaults__ or {}, name)
        self._many("defaults", function.__defaults__ or (), name)
        used, imported = _references(function.__code__)
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        filled = {key: cell.cell_contents for key, cell in cells if cell != CellType()}
        self._named("cells", filled, name)
        module_names = function.__globals__
        self._named(
            "globals", {key: module_names[key] for key in used if key in module_names}, name
        )
        for module in imported:
            self._module(module, name)

    def _code(self, code: CodeType, name: str) -> None:
        self._put("code", code.co_code + code.co_exceptiontable)
        counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
        names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        self._many("code", (*counts, *names, *code.co_consts), name)

    def _module(self, module: str, name: str) -> None:
        """Add a module by its name, and by its text where it is the user's own."""
        self._put("module", module)
        path = None if _in_library(module) else _file_of(module)
        if path is not None:
            try:
                self._put("text", content_of(path))
            except OSError:
                raise _indistinct(module, name) from None
        for key, inner in sorted(vars(sys.modules.get(module, object)).items() if path else ()):
            if isinstance(inner, ModuleType) and not key.startswith("__"):
                self._once(inner, f"{name}.{key}")


def _function_of(expression: Any) -> ca.Function:
    if isinstance(expression, (ca.DM, ca.Sparsity)):
        return ca.Function("f", [], [ca.DM(expression)])
    return ca.Function("f", ca.symvar(expression), [expression])


def _indistinct(value: Any, name: str) -> InputError:
    return InputError(
        f"{name} holds {shown(value)}, whose content cannot be read: whether it is the same "
        "again cannot be told"
    )


def _references(code: CodeType) -> tuple[list[str], list[str]]:
    """Return global names that a code uses, and modules that it imports."""
    used, imported, left = set[str](), set[str](), [code]
    while left:
        inner = left.pop()
        left += [entry for entry in inner.co_consts if isinstance(entry, CodeType)]
        for step in dis.get_instructions(inner):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                used.add(step.argval)
            elif step.opname == "IMPORT_NAME":
                imported.add(step.argval)
    return sorted(used), sorted(imported)


def _file_of(module: str) -> Path | None:
    try:
        spec = find_spec(module) if module else None
    except (ImportError, ValueError):  # relative, or __main__
        return None
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


@functools.cache
def _in_library(module: str | None) -> bool:
    """Give whether a module is Python's, ours or installed, and so told by its name and version."""
    top = str(module).partition(".")[0]
    if top == PACKAGE or top in sys.stdlib_module_names:
        return True
    path = None if top == "__main__" else _file_of(top)
    return path is not None and bool({"site-packages", "dist-packages"} & set(path.parts))
