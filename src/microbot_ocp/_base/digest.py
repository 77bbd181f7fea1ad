"""Digests of the content of objects: equal content gives equal digests, in every process.

The digest is taken from a pickle. Functions enter it with their code and every object that the
code refers to, dataclasses with the fields that they compare, arrays with their bytes, and members
of libraries with their name and the library's version.
"""

from __future__ import annotations

import dis
import functools
import hashlib
import io
import pickle
import sys
import types
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.reading import content_of

PACKAGE = __name__.partition(".")[0]
_SYMBOLS = (ca.SX, ca.MX, ca.DM, ca.Sparsity)
_WRAPPERS = {
    types.MethodType: ("__func__", "__self__"),
    staticmethod: ("__func__",),
    classmethod: ("__func__",),
    property: ("fget", "fset", "fdel"),
    functools._lru_cache_wrapper: ("__wrapped__",),
}
# A class's spelling, its place and its text, does not change its behaviour.
_WRITTEN = ("__module__", "__doc__", "__dict__", "__weakref__", "__firstlineno__", "__qualname__")


def digest_of(**parts: Any) -> str:
    """Return the SHA-256 of the content of some parts, in hexadecimal digits.

    Raises
    ------
    InputError
        A part contains an object whose content cannot be compared: an open file, compiled code.
    """
    shared: dict[int, tuple[int, Any]] = {}
    whole = [(name, _digest(part, name, shared, ())) for name, part in parts.items()]
    return hashlib.sha256(repr(whole).encode()).hexdigest()


def _digest(value: Any, name: str, shared: dict[int, tuple[int, Any]], around: Any) -> str:
    """Return the digest of a value; messages call the value ``name``.

    ``shared`` numbers the functions, classes and modules, each of which is written once; ``around``
    lists the identities of the objects that contain the value.
    """
    if id(value) in around:
        return f"around {around.index(id(value))}"
    stream = io.BytesIO()
    try:
        _Content(stream, name, shared, (*around, id(value))).dump(value)
    except InputError:
        raise
    except Exception:  # a __reduce__ or __eq__ of the user's may raise anything
        raise InputError(
            f"{name} holds {shown(value)}, whose content cannot be read: whether it is the same "
            "again cannot be told"
        ) from None
    return hashlib.sha256(stream.getbuffer()).hexdigest()


class _Content(pickle.Pickler):
    """A pickler whose output serves for a digest alone."""

    def __init__(self, stream: io.BytesIO, name: str, shared: Any, around: Any) -> None:
        super().__init__(stream, 5)
        self.fast = True  # equal objects give equal digests, whether or not they are one object
        self.name, self.shared, self.around = name, shared, around

    def persistent_id(self, value: Any) -> Any:
        """Return the entry of a value in the pickle; None leaves the value to pickle."""
        if isinstance(value, types.FunctionType | type | types.ModuleType):
            return self._once(value)
        if isinstance(value, types.CodeType):
            counts = (value.co_argcount, value.co_posonlyargcount, value.co_kwonlyargcount)
            names = (value.co_names, value.co_varnames, value.co_freevars, value.co_cellvars)
            code = value.co_code + value.co_exceptiontable
            return "code", code, value.co_flags, *counts, *names, *value.co_consts
        if type(value) in (dict, types.MappingProxyType):
            return "mapping", self._named(value)
        if isinstance(value, set | frozenset):
            return "set", sorted(digest_of(**{self.name: entry}) for entry in value)
        if type(value) is np.ndarray and not value.dtype.hasobject:
            return "array", value.dtype.str, value.shape, value.tobytes()
        if isinstance(value, (ca.Function, *_SYMBOLS)):
            return "casadi", _casadi_text(value)
        if is_dataclass(value):
            counted = {f.name: getattr(value, f.name) for f in fields(value) if f.compare}
            return type(value), self._named(counted)
        if inside := _WRAPPERS.get(type(value)):
            return [type(value).__name__, *(getattr(value, key) for key in inside)]
        home = getattr(value, "__self__", None)
        if isinstance(value, types.BuiltinFunctionType) and isinstance(home, types.ModuleType):
            return self._once(home), value.__qualname__
        return None

    def _named(self, values: Mapping[Any, Any]) -> list[tuple[Any, str]]:
        names = [f"{self.name}.{key}" if isinstance(key, str) else self.name for key in values]
        pairs = zip(values.items(), names, strict=True)
        return [
            (key, _digest(entry, name, self.shared, self.around)) for (key, entry), name in pairs
        ]

    def _once(self, value: Any) -> Any:
        """Return the content of a function, class or module, at later visits its number alone."""
        if id(value) in self.shared:
            return "again", self.shared[id(value)][0]
        self.shared[id(value)] = len(self.shared), value
        home = value.__name__ if isinstance(value, types.ModuleType) else value.__module__
        if _in_library(home):
            version = getattr(sys.modules.get(home.partition(".")[0]), "__version__", "")
            return "library", home, getattr(value, "__qualname__", ""), version
        if isinstance(value, types.ModuleType):
            return self._module(home)
        if isinstance(value, types.FunctionType):
            return self._function(value)
        members = {k: v for k, v in sorted(vars(value).items()) if k not in _WRITTEN}
        members = {k: v for k, v in members.items() if "_abc_" not in k}
        return "class", value.__qualname__, value.__bases__, self._named(members)

    def _function(self, function: types.FunctionType) -> Any:
        used, imported = _references(function.__code__)
        cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
        every = function.__globals__
        named = {
            **{key: cell.cell_contents for key, cell in cells if cell != types.CellType()},
            **{key: every[key] for key in used if key in every},
        }
        defaults = function.__defaults__, function.__kwdefaults__
        modules = [self._module(module) for module in imported]
        return function.__code__, defaults, self._named(named), modules

    def _module(self, module: str) -> Any:
        """Return the name of a module, with its text if it is the user's own."""
        path = None if _in_library(module) else _file_of(module)
        if path is None:
            return "module", module
        members = sorted(vars(sys.modules.get(module, object)).items())
        inner = {
            k: v for k, v in members if isinstance(v, types.ModuleType) and not k.startswith("__")
        }
        return "module", module, content_of(path), self._named(inner)


def _casadi_text(value: Any) -> str:
    """Return the serialization of a function or expression of CasADi."""
    if isinstance(value, (ca.DM, ca.Sparsity)):
        value = ca.Function("f", [], [ca.DM(value)])
    elif not isinstance(value, ca.Function):
        value = ca.Function("f", ca.symvar(value), [value])
    parts = (value, *(value.find_function(part) for part in value.get_function()))
    if {part.class_name() for part in parts} & {"External", "CallbackInternal"}:
        raise ValueError("it is evaluated by a library or by Python")
    return value.serialize()


def _references(code: types.CodeType) -> tuple[list[str], list[str]]:
    """Return the global names that a code object reads, and the modules that it imports."""
    used, imported, left = set[str](), set[str](), [code]
    while left:
        inner = left.pop()
        left += [entry for entry in inner.co_consts if isinstance(entry, types.CodeType)]
        for step in dis.get_instructions(inner):
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                used.add(step.argval)
            elif step.opname == "IMPORT_NAME":
                imported.add(step.argval)
    return sorted(used), sorted(imported)


def _file_of(module: str) -> Path | None:
    try:
        spec = find_spec(module) if module else None
    except (ImportError, ValueError):  # a relative name, or __main__
        return None
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


@functools.cache
def _in_library(module: str | None) -> bool:
    """Return True for a module of Python, of this package or of an installed library."""
    top = str(module).partition(".")[0]
    if top == PACKAGE or top in sys.stdlib_module_names:
        return True
    path = None if top == "__main__" else _file_of(top)
    return path is not None and bool({"site-packages", "dist-packages"} & set(path.parts))
