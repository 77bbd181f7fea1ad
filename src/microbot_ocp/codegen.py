"""CasADi functions compiled to C, cached on disk; without a compiler the virtual machine, and a word.

The cache lives in ``$MICROBOT_OCP_CACHE``, else in the user's cache folder; a file's name is the
hash of the C text, the compiler and its flags, so a changed robot never meets stale code.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
import warnings
from functools import lru_cache
from pathlib import Path

import casadi as ca

FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-shared", "-fPIC")


class NotCompiled(UserWarning):
    """A compiled function was asked for, but CasADi's virtual machine runs instead."""


@lru_cache(maxsize=1)
def compiler() -> str | None:
    """Path of the C compiler: ``$CC``, else cc, gcc or clang; None where there is none."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang"):
        path = shutil.which(name) if name else None
        if path:
            return path
    return None


def cache_folder() -> Path:
    """Folder that keeps the compiled functions."""
    chosen = os.environ.get("MICROBOT_OCP_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "microbot_ocp"


def maybe_compiled(function: ca.Function, wanted: bool) -> ca.Function:
    """``function`` itself, or its compiled twin if ``wanted``."""
    return compile_function(function) if wanted else function


def compile_function(function: ca.Function) -> ca.Function:
    """Compile a CasADi function to C and load it; on any failure warn and return it as it is.

    Parameters
    ----------
    function : casadi.Function
        Its inputs, outputs and their names stay the same.

    Returns
    -------
    casadi.Function
        Runs 4 (3 joints) to 20 (7 joints) times as fast, but cannot be expanded or inlined.

    Warns
    -----
    NotCompiled
        No compiler, or it failed.
    """
    cc = compiler()
    if cc is None:
        warnings.warn(
            f"no C compiler found: {function.name()} runs in CasADi's virtual machine",
            NotCompiled,
            stacklevel=3,
        )
        return function
    try:
        library = _build(function, cc)
        return ca.external(function.name(), str(library))
    except (OSError, subprocess.SubprocessError, RuntimeError) as problem:
        warnings.warn(
            f"{function.name()} was not compiled ({problem}); it runs in CasADi's virtual machine",
            NotCompiled,
            stacklevel=3,
        )
        return function


def _build(function: ca.Function, cc: str) -> Path:
    generator = ca.CodeGenerator(f"{function.name()}.c", {"with_header": False})
    generator.add(function)
    source = generator.dump()
    key = hashlib.sha256(repr((source, cc, FLAGS)).encode()).hexdigest()[:24]
    folder = cache_folder()
    library = folder / f"{function.name()}_{key}.so"
    if library.exists():
        return library
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        text = Path(work) / "function.c"
        text.write_text(source)
        made = Path(work) / "function.so"
        subprocess.run(
            [cc, *FLAGS, str(text), "-o", str(made), "-lm"],
            check=True,
            capture_output=True,
            timeout=120,
        )
        made.replace(library)  # atomic: a second process never loads half a file
    return library
