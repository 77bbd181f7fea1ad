"""CasADi functions compiled to C and cached on disk; on failure CasADi's virtual machine runs.

The cache is ``$MICROBOT_OCP_CACHE``, by default a folder in the user's cache. The name of a file is
a hash of the C text, the compiler, its flags and the processor, so neither a changed robot nor
another machine with the same folder loads wrong code. A fallback to the virtual machine raises the
warning :class:`NotCompiled`.

A library is loaded only if its digest agrees with the file ``.sha256`` beside it (0.6 ms a
megabyte); otherwise it is compiled again. If the folder belongs to another user or others may write
to it, a private folder is used instead, with the warning :class:`PrivateCache`.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import json
import os
import platform
import shutil
import stat
import subprocess
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import casadi as ca

from microbot_ocp._base import deadline, interpreter
from microbot_ocp._base.checks import shortened, warn_user
from microbot_ocp._base.reading import content_of
from microbot_ocp._base.system import COMPILES, OWN_GROUP, end_group
from microbot_ocp._base.writing import digest, temporary_path, whole_file

FLAGS = ("-fno-math-errno", "-shared", "-fPIC")
# Flags for sums in any order; -ffast-math would flush small numbers to zero process-wide.
ANY_ORDER = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math")
# Recursive Newton-Euler gains nothing with 3 joints and 6 % with 7; derivatives with 7 joints run
# in a third of the time (fused multiply-add). The key of the cache therefore has the processor.
NATIVE = "-march=native"
# Libraries of a wheel run on x86-64 processors with the instruction sets below, or on 64-bit ARM.
WHEEL_FOLDER = Path(__file__).parents[1] / "compiled"
WHEEL_FLAGS = {"x86_64": ("-mavx2", "-mbmi2", "-mfma"), "aarch64": (), "arm64": ()}
NEEDED_INSTRUCTIONS = {"x86_64": {"avx2", "bmi2", "fma"}}


# The compile time of a derivative, one long block, grows faster than its length. The Panda's
# second derivative of a stage has 11,000 operations; it compiles in 1.6 s under -O1 and in 0.4 s
# under -O0, which runs 3 times slower than -O1 and still 5 times faster than CasADi's virtual
# machine. Torque rates (30,000 operations) take 7 s and 1 s. Only -O2 fuses multiplications and
# additions: -O1 and -O0 give equal bits.
SIZES = ((4_000, "-O2"), (30_000, "-O1"), (float("inf"), "-O0"))


COMPILE_TIMEOUT = 120.0  # s; a slower compiler is killed with its children


class PrivateCache(UserWarning):
    """The cache folder is unsafe or unusable, so another one is used."""


class NotCompiled(UserWarning):
    """CasADi's virtual machine replaces a compiled function, or MUMPS a compiled linear solver."""


@lru_cache(maxsize=1)
def compiler() -> str | None:
    """Return the path of the C compiler: ``$CC``, cc, gcc or clang; None without one."""
    for name in (os.environ.get("CC"), "cc", "gcc", "clang") if COMPILES else ():
        path = shutil.which(name) if name else None
        if path:
            return path
    return None


@lru_cache(maxsize=1)
def processor() -> str:
    """Return the identity of the processor: machine, model and instruction sets."""
    parts = [platform.system(), platform.machine(), platform.processor()]
    with contextlib.suppress(OSError, UnicodeDecodeError):
        lines = Path("/proc/cpuinfo").read_text("utf-8").split("\n\n")[0].splitlines()
        wanted = ("model name", "flags", "Features", "CPU part")
        parts += [line for line in lines if line.startswith(wanted)]
    return "\n".join(parts)


def cache_folder() -> Path:
    """Return the folder of compiled functions."""
    chosen = os.environ.get("MICROBOT_OCP_CACHE")
    if chosen:
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(base or Path.home() / ".cache") / "microbot_ocp"
    except RuntimeError:  # HOME is not set and the system does not know the user
        return _private_folder()


def _private_folder() -> Path:
    """Return the fallback cache folder, in the folder for temporary files."""
    user = os.geteuid() if COMPILES else ""  # on Windows the folder is the user's own
    return Path(tempfile.gettempdir()) / f"microbot_ocp-{user}"


def usable_folder() -> Path:
    """Return the cache folder, created if necessary; a private one if it is not safe.

    Warns
    -----
    PrivateCache
        Once for each folder.

    Raises
    ------
    OSError
        Neither folder can be used, or no code is compiled on this system.
    """
    if not COMPILES:
        raise OSError("no code is compiled on Windows")
    folder = cache_folder()
    if problem := _folder_problem(folder):
        unused, folder = folder, _private_folder()
        if other := _folder_problem(folder):
            raise OSError(f"cache folders {unused}: {problem}; {folder}: {other}")
        _say_once(f"the cache folder {unused} is not used: {problem}; {folder} is")
    return folder


@lru_cache(maxsize=64)
def _say_once(sentence: str) -> None:
    warn_user(sentence, PrivateCache)


def _folder_problem(folder: Path) -> str:
    """Return the reason why a folder cannot be used; empty if it can."""
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode):
            return "it is no folder of its own"
        if not os.access(folder, os.W_OK | os.X_OK):
            return "permission denied"
    except (OSError, ValueError) as problem:
        return getattr(problem, "strerror", None) or str(problem)
    if status.st_uid != os.geteuid():
        return "it belongs to another user"
    return "others may write to it" if status.st_mode & 0o022 else ""


def _is_whole(path: Path) -> bool:
    """Return True if a file of the cache agrees with its digest."""
    with contextlib.suppress(OSError):
        return content_of(_beside(path)) == digest(path).encode()
    return False


def _keep(path: Path, content: bytes) -> None:
    """Write a file into the cache, and its digest beside it."""
    seal = hashlib.sha256(content).hexdigest().encode()
    for place, data in ((path, content), (_beside(path), seal)):
        with whole_file(place) as partial:
            partial.write_bytes(data)
            partial.chmod(0o700)  # the user's umask may permit a group to write


def _beside(path: Path) -> Path:
    return path.with_name(f"{path.name}.sha256")


_interpreted: ContextVar[bool] = ContextVar("interpreted", default=False)


@contextlib.contextmanager
def interpreted() -> Iterator[None]:
    """Run functions created inside of the context on CasADi's virtual machine, without a warning.

    Sweeps use thousands of robots once each: compilation would take longer than their evaluation,
    and each would leave a library in the cache.
    """
    token = _interpreted.set(True)
    try:
        yield
    finally:
        _interpreted.reset(token)


def compiles(wanted: bool = True) -> bool:
    """Return True if functions are to be compiled: wanted, and not prevented or impossible."""
    return wanted and not _interpreted.get() and compiler() is not None


def compile_function(function: ca.Function) -> ca.Function:
    """Compile a CasADi function to C and load it; on failure warn and return it unchanged.

    Parameters
    ----------
    function : casadi.Function
        CasADi function; the compiled one has equal inputs, outputs and names.

    Returns
    -------
    casadi.Function
        Function that runs 4 (3 joints) to 20 (7 joints) times as fast. It cannot be expanded or
        inlined and has no derivatives; optimal-control problems use the original function.

    Warns
    -----
    NotCompiled
        There is no compiler, or it failed.
    """
    (compiled,) = compile_functions([function])
    if compiled is not function:
        ORIGINS[compiled.__hash__()] = compiled, function
    return compiled


# Compiled function and its original, both kept alive.
ORIGINS: dict[int, tuple[ca.Function, ca.Function]] = {}


def compile_functions(functions: Sequence[ca.Function]) -> tuple[ca.Function, ...]:
    """Compile several functions; on failure warn and return them unchanged.

    Large functions get libraries of their own, which are compiled in parallel.
    """
    libraries = None if _interpreted.get() else _compiled(functions)
    return tuple(functions if libraries is None else libraries)


def compile_recipe(
    recipe: bytes | str, make: Callable[[], Sequence[ca.Function]], *, columns: bool = False
) -> tuple[ca.Function, ...]:
    """Return the compiled functions of a recipe, from the cache if it has them.

    Parameters
    ----------
    recipe : bytes or str
        Identity of the functions, besides the source of this package.
    make : callable
        Function that constructs the functions, which takes most of the time if the cache has the
        compiled code.
    columns : bool
        True for functions of many columns at once, which are interpreted in blocks if possible.
    """
    if _interpreted.get():
        return tuple(make())
    identity = repr((recipe, columns, package(), compiler(), FLAGS, NATIVE, SIZES, processor()))
    name = f"recipe_{hashlib.sha256(identity.encode()).hexdigest()[:24]}.json"
    with contextlib.suppress(OSError, ValueError, TypeError, RuntimeError):
        note = usable_folder() / name
        libraries = json.loads(note.read_bytes()) if _is_whole(note) else []
        if libraries and all(_is_whole(note.with_name(library)) for library, _ in libraries):
            return tuple(_external(name, note.parent / library) for library, name in libraries)
    given = tuple(make())
    compiled = _compiled(given, columns)
    if compiled is None:
        return given
    with contextlib.suppress(OSError):
        entries = [[path.name, function.name()] for function, path in compiled.items()]
        _keep(usable_folder() / name, json.dumps(entries).encode())
    return tuple(compiled)


@lru_cache(maxsize=1)
def package() -> str:
    """Return the digest of the source of this package and the version of CasADi."""
    digest = hashlib.sha256(ca.CasadiMeta.version().encode())
    folder = Path(__file__).parent.parent
    for path in sorted([*folder.rglob("*.py"), *folder.rglob("*.c")]):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _compiled(
    given: Sequence[ca.Function], columns: bool = False
) -> dict[ca.Function, Path] | None:
    """Return each compiled function with its library; on failure warn and return None."""
    deadline.check()
    names, cc = [function.name() for function in given], compiler()
    if cc is None:
        problem = "no C compiler was found"
    elif deadline.over():  # the C text alone takes long, too
        problem = "the time limit was over"
    else:
        try:
            text = interpreter.c_text(given) if columns else None
            if text is None:
                library_of = dict(_libraries(given, cc))
            else:
                library = build_library(text, interpreter.NAME, cc, "-O1", objects=[_loops(cc)])
                library_of = dict.fromkeys(names, library)
            return {_external(name, library_of[name]): library_of[name] for name in names}
        except (OSError, subprocess.SubprocessError, RuntimeError) as failure:
            problem = shortened(str(failure), 160)
    message = f"not compiled: {shortened(', '.join(names), 60)} ({problem})"
    warnings.warn(f"{message}; CasADi's virtual machine runs instead", NotCompiled, stacklevel=4)
    return None


def _loops(cc: str) -> Path:
    """Return the compiled interpreter, which is linked to the tables of functions."""
    flags = (*interpreter.FLAGS, "-c")
    return build_library(
        interpreter.interpreter_text(), "loops", cc, "-O3", further=flags, suffix=".o"
    )


def _libraries(given: Sequence[ca.Function], cc: str) -> Iterator[tuple[str, Path]]:
    """Yield name and library of every function; large ones are compiled in parallel."""
    small = [f for f in given if _operations(f) <= SIZES[0][0]]
    large = [[f] for f in given if _operations(f) > SIZES[0][0]]
    groups = large + ([small] if small else [])
    sources = [c_source(group) for group in groups]
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        jobs = []
        for group, source in zip(groups, sources, strict=True):
            size = sum(map(_operations, group))
            option = next(option for limit, option in SIZES if size <= limit)
            run = copy_context().run  # the context carries the time limit
            jobs.append(pool.submit(run, build_library, source, group[0].name(), cc, option))
        try:
            libraries = [job.result() for job in jobs]
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            abandon()
            raise
    for group, library in zip(groups, libraries, strict=True):
        yield from ((function.name(), library) for function in group)


def _external(name: str, library: Path) -> ca.Function:
    in_blocks = library.name.startswith(interpreter.NAME)
    try:
        return (interpreter.ManyColumns if in_blocks else ca.external)(name, str(library))
    except RuntimeError:  # the compiler's output is no library
        library.unlink(missing_ok=True)
        raise


def _operations(function: ca.Function) -> int:
    """Return the number of operations of a function and all functions that it calls."""
    inner = (function, *function.find_functions())
    return sum(k.n_instructions() for k in inner if k.is_a("SXFunction"))


def c_source(functions: Sequence[ca.Function]) -> str:
    """Return the C text of functions."""
    generator = ca.CodeGenerator(f"{functions[0].name()}.c", {"with_header": False})
    for function in functions:
        generator.add(function)
    # Static functions that call no C library can be inlined by the compiler.
    text = generator.dump().replace("\ncasadi_real casadi_", "\nstatic casadi_real casadi_")
    for name, sign in (("fmin", "<"), ("fmax", ">")):
        text = text.replace(f"return {name}(x, y);", f"return x {sign} y || y != y ? x : y;")
    return text


def build_library(
    source: str | Callable[[], str],
    stem: str,
    cc: str,
    optimization: str,
    *,
    further: Sequence[str] = (),
    objects: Sequence[Path] = (),
    suffix: str = ".so",
    serves: str = "",
    recipe: str = "",
    make: bool = True,
) -> Path:
    """Return a shared library of C text, from the cache or newly compiled.

    Parameters
    ----------
    source : str or callable
        C text, or a function that returns it.
    stem : str
        Start of the library's name.
    cc, optimization : str
        Compiler, and "-O0" to "-O3".
    further : sequence of str
        More flags of the compiler.
    objects : sequence of Path
        Compiled text from the cache that is linked to the library.
    suffix : str
        End of the library's name.
    serves : str
        Other dependencies of the library, for the key of the cache.
    recipe : str
        Identity of the text, which replaces the text in the key.
    make : bool
        False to forbid compilation.

    Raises
    ------
    OSError, subprocess.SubprocessError, RuntimeError
        The folder is not writable, the compiler failed or took too long, or ``make`` is False and
        the cache does not have the library.
    """
    flags = (optimization, *FLAGS, *further)
    identity = repr(
        (recipe or source, cc, flags, NATIVE, processor(), serves, [path.name for path in objects])
    )
    key = hashlib.sha256(identity.encode()).hexdigest()[:24]
    folder = usable_folder()
    library = folder / f"{stem}_{key}{suffix}"
    if _is_whole(library):
        return library
    if not make:
        raise FileNotFoundError(library)
    with temporary_path(folder / stem) as work:
        work.mkdir(mode=0o700)
        text = source if isinstance(source, str) else source()
        # A compiler that rejects the flag of the processor gets a second call without it.
        compiled = _compiled_text(work, text, cc, [(NATIVE,), ()], (*flags, *map(str, objects)))
        content = content_of(compiled)
    # The folder is gone before the library is whole: nobody compiles again, nobody would remove it.
    _keep(library, content)
    return library


def _compiled_text(
    work: Path, text: str, cc: str, of_processor: Sequence[Sequence[str]], rest: Sequence[str]
) -> Path:
    """Return the library of C text, compiled in a folder; flags of the processor are alternatives.

    Raises
    ------
    subprocess.SubprocessError, RuntimeError
        The compiler took too long, or failed with all of the alternatives.
    """
    source, library, messages = work / "function.c", work / "function.so", work / "messages"
    source.write_text(text, "utf-8")
    status = 0
    for flags in of_processor:
        # Libraries follow the text that needs them.
        command = [cc, *flags, str(source), *rest, "-o", str(library), "-lm"]
        status = _run(command, messages)
        if not status:
            return library
    ending = " ".join(messages.read_bytes().decode(errors="replace").split())
    raise RuntimeError(f"{cc} ended with status {status}: {shortened(ending, 100)}")


class NoCompiler(RuntimeError):
    """There is no C compiler."""


@dataclass(frozen=True)
class CommonLibrary:
    """A library that is the same for all robots, so that a wheel may have it.

    Attributes
    ----------
    stem : str
        Start of the library's name.
    text : str
        C text.
    flags : tuple of str
        Optimization and further flags of the compiler.
    """

    stem: str
    text: str
    flags: tuple[str, ...]

    @cached_property
    def _name(self) -> str:
        identity = repr((self.text, self.flags, WHEEL_FLAGS))
        return f"{self.stem}_{hashlib.sha256(identity.encode()).hexdigest()[:12]}.so"

    @property
    def wheel_path(self) -> Path:
        """Path of the wheel's library. Text or flags that differ from the wheel's change it."""
        return WHEEL_FOLDER / self._name

    def path(self) -> Path:
        """Return the library: from the wheel, from the cache, or newly compiled.

        It is also used inside of :func:`interpreted`, since it serves all robots.

        Raises
        ------
        OSError, subprocess.SubprocessError, RuntimeError
            Errors of :func:`build_library`, or :class:`NoCompiler`. A compiler that failed is not
            asked again.
        """
        key = (self.wheel_path, compiler())
        found = _found.get(key)
        if found is None or (isinstance(found, Path) and not found.exists()):
            found = self._search()
        if not deadline.over():  # compilation may succeed another time
            _found[key] = found
        if isinstance(found, Exception):
            raise found
        return found

    def _search(self) -> Path | Exception:
        needed = NEEDED_INSTRUCTIONS.get(platform.machine(), set())
        if self.wheel_path.exists() and needed <= {*processor().split()}:
            with contextlib.suppress(OSError):  # an older C library than the wheel's
                ctypes.CDLL(str(self.wheel_path))
                return self.wheel_path
        cc = compiler()
        if cc is None:
            return NoCompiler("no C compiler was found")
        try:
            return build_library(self.text, self.stem, cc, self.flags[0], further=self.flags[1:])
        except (OSError, subprocess.SubprocessError, RuntimeError) as problem:
            return problem

    def compile_for_wheel(self, folder: Path) -> Path:
        """Compile the library for all processors of this kind of machine.

        Raises
        ------
        OSError, subprocess.SubprocessError, RuntimeError
            There is no compiler, none for this kind of machine, or the compiler failed.
        """
        cc, of_machine = compiler(), WHEEL_FLAGS.get(platform.machine())
        if cc is None or of_machine is None:
            raise RuntimeError("no C compiler was found, or no flags for this machine")
        compiled = _compiled_text(folder, self.text, cc, [of_machine], (*self.flags, *FLAGS))
        return compiled.rename(folder / self._name)


# Libraries that all robots share, by path in a wheel and compiler, or why there is none.
_found: dict[tuple[Path, str | None], Path | Exception] = {}


_running: set[subprocess.Popen[Any]] = set()


def _run(command: list[str], messages: Path) -> int:
    """Run a compiler in its own process group and return its exit status.

    Its messages go to a file: a pipe would stay open in processes that it leaves behind.

    Raises
    ------
    RuntimeError
        The compiler took too long or was killed.
    """
    if deadline.over():
        raise RuntimeError("the time limit was over")
    seconds = min(COMPILE_TIMEOUT, deadline.left())
    with (
        messages.open("wb") as stream,
        subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, **OWN_GROUP
        ) as process,
    ):
        _running.add(process)
        try:
            status = process.wait(seconds)
        except subprocess.TimeoutExpired:
            raise RuntimeError(f"{command[0]}: it was ended after {seconds:.3g} s") from None
        finally:
            end_group(process)  # kills the remaining processes of the group, too
            _running.discard(process)
    if status < 0:
        raise RuntimeError(f"{command[0]}: it was ended by signal {-status}")
    return status


def abandon() -> None:
    """Kill every compiler before the process ends."""
    for process in list(_running):
        end_group(process)
