"""CasADi functions compiled to C, cached on disk; CasADi's virtual machine where that fails.

The cache is ``$MICROBOT_OCP_CACHE``, by default a folder in the user's cache. The name of a file is
a hash of the C text, the compiler, its flags and the processor, so neither a changed robot nor
another machine that shares the folder loads the wrong code. Falling back to the virtual machine
raises the warning :class:`NotCompiled`.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import casadi as ca

FLAGS = ("-fno-math-errno", "-shared", "-fPIC")
# Measured for recursive Newton-Euler: no gain with 3 joints, 6 % with 7; for its derivatives with
# 7 joints a third of the time (fused multiply-add). Hence the processor in the key of the cache.
NATIVE = "-march=native"


# Operations up to which an optimisation pays for its compile time.
SIZES = ((4_000, "-O2"), (20_000, "-O1"), (float("inf"), "-O0"))


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


@lru_cache(maxsize=1)
def processor() -> str:
    """Identity of the processor: machine, model and instruction sets."""
    parts = [platform.system(), platform.machine(), platform.processor()]
    with contextlib.suppress(OSError, UnicodeDecodeError):
        lines = Path("/proc/cpuinfo").read_text("utf-8").split("\n\n")[0].splitlines()
        wanted = ("model name", "flags", "Features", "CPU part")
        parts += [line for line in lines if line.startswith(wanted)]
    return "\n".join(parts)


def cache_folder() -> Path:
    """Folder that keeps the compiled functions."""
    chosen = os.environ.get("MICROBOT_OCP_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "microbot_ocp"


def maybe_compiled(function: ca.Function, wanted: bool) -> ca.Function:
    """``function`` compiled if ``wanted``, else as it is."""
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
    return compile_functions([function])[0]


def compile_functions(
    functions: Sequence[ca.Function], *, optimization: str | None = None
) -> tuple[ca.Function, ...]:
    """Compile several functions into one library; on any failure warn and return them as they are.

    Parameters
    ----------
    functions : sequence of casadi.Function
    optimization : str, optional
        "-O0" to "-O3"; default by size, see :func:`optimization_for`.
    """
    given = tuple(functions)
    names = ", ".join(function.name() for function in given)
    cc = compiler()
    if cc is None:
        problem = "no C compiler was found"
    else:
        try:
            library = str(_build(given, cc, optimization or optimization_for(given)))
            return tuple(ca.external(function.name(), library) for function in given)
        except (OSError, subprocess.SubprocessError, RuntimeError) as failure:
            problem = str(failure)
    warnings.warn(
        f"not compiled: {names} ({problem}); CasADi's virtual machine runs instead",
        NotCompiled,
        stacklevel=3,
    )
    return given


def optimization_for(functions: Sequence[ca.Function]) -> str:
    """Compiler option for functions of this size.

    A compiler takes more than linear time for the one long block that a large derivative is:
    a UR5e's stage kernels (86,000 operations) took 23 s with -O1 and 4 s with -O0, and run 5 times
    slower then, still 5 times faster than CasADi's virtual machine.
    """
    size = sum(function.n_instructions() for function in functions if not function.is_a("External"))
    return next(option for limit, option in SIZES if size <= limit)


def _build(functions: Sequence[ca.Function], cc: str, optimization: str) -> Path:
    stem = functions[0].name()
    generator = ca.CodeGenerator(f"{stem}.c", {"with_header": False})
    for function in functions:
        generator.add(function)
    return build_library(generator.dump(), stem, cc, optimization)


def build_library(
    source: str,
    stem: str,
    cc: str,
    optimization: str,
    *,
    include: Sequence[str] = (),
    suffix: str = ".so",
    serves: str = "",
) -> Path:
    """Compile C text into a shared library, or find it in the cache.

    Parameters
    ----------
    source, stem : C text, and the start of the library's name
    cc, optimization : compiler, and "-O0" to "-O3"
    include : folders of headers
    suffix : end of the library's name
    serves : what else the library depends on, for the key of the cache

    Raises
    ------
    OSError, subprocess.SubprocessError, RuntimeError
        The folder cannot be written, or the compiler failed or took too long.
    """
    flags = (optimization, *FLAGS)
    identity = repr((source, cc, flags, NATIVE, processor(), serves))
    key = hashlib.sha256(identity.encode()).hexdigest()[:24]
    folder = cache_folder()
    library = folder / f"{stem}_{key}{suffix}"
    if library.exists():
        return library
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as work:
        text = Path(work) / "function.c"
        text.write_text(source)
        made = Path(work) / "function.so"
        headers = [f"-I{header}" for header in include]
        rest = [*flags, *headers, str(text), "-o", str(made), "-lm"]
        done = _run([cc, NATIVE, *rest])
        if done.returncode:  # a compiler that does not know the flag
            done = _run([cc, *rest])
        if done.returncode:
            said = " ".join(done.stderr.split())[-300:]
            raise RuntimeError(f"{cc} ended with status {done.returncode}: {said}")
        made.replace(library)  # atomic: a second process never loads half a file
    return library


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
