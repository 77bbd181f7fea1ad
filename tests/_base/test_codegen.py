"""Compiled functions: equal to the virtual machine's, cached, and honest when there are none."""

from __future__ import annotations

import os
import platform
import shutil
import signal
import stat
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import microbot_ocp as mo
from helpers import any_robot, batch, difference, random_states, warned
from microbot_ocp import fast_call
from microbot_ocp._base import codegen, fast_calls
from microbot_ocp._base.codegen import compile_function, compile_functions, compile_recipe
from microbot_ocp.ocp.solvers import _ldl
from microbot_ocp.planning.free._flat_loops import WINDOWS

compiles = pytest.mark.skipif(not codegen.COMPILES, reason="no C code is compiled here")
needs_compiler = pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    chosen = tmp_path / "compiled"
    monkeypatch.setenv("MICROBOT_OCP_CACHE", str(chosen))
    return chosen


def doubled(name: str = "doubled", factor: float = 2.0) -> ca.Function:
    x = ca.SX.sym("x", 2)
    return ca.Function(name, [x], [factor * x], ["x"], ["y"])


def stub_compiler(path: Path, script: str) -> str:
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def forbid_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(command: list[str]) -> None:
        raise AssertionError(f"compiled again: {command}")

    monkeypatch.setattr(codegen, "_run", refuse)


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("name", ["microbot", "rrprp"])
@pytest.mark.parametrize(
    ("make", "arguments"),
    [
        (mo.forward_kinematics, 1),
        pytest.param(mo.jacobian, 1, marks=pytest.mark.thorough),
        pytest.param(mo.mass_matrix, 1, marks=pytest.mark.thorough),
        pytest.param(mo.bias_torque, 2, marks=pytest.mark.thorough),
        (mo.inverse_dynamics, 3),
    ],
)
def test_compiled_function_equals_the_virtual_machine(
    name: str, make: object, arguments: int
) -> None:
    robot = any_robot(name)
    states = random_states(robot, 50)[:arguments]
    plain = make(robot)  # type: ignore[operator]
    compiled = compile_function(plain)
    assert compiled.class_name() == "External"
    assert (compiled.name_in(), compiled.name_out()) == (plain.name_in(), plain.name_out())
    assert difference(batch(compiled, *states), batch(plain, *states)) < 1e-12


@needs_compiler
def test_compiled_argument_of_the_builders_compiles() -> None:
    robot = any_robot("rr")
    compiled = mo.inverse_dynamics(robot, compiled=True)
    assert compiled.class_name() == "External"
    assert compiled is mo.inverse_dynamics(robot, compiled=True)
    assert mo.inverse_dynamics(robot).class_name() != "External"


@needs_compiler
def test_second_compilation_takes_the_cached_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compile_function(doubled())
    (library,) = folder.glob("*.so")
    forbid_compiling(monkeypatch)
    again = compile_function(doubled())
    assert np.array(again([1.0, 2.0])).ravel().tolist() == [2.0, 4.0]
    assert list(folder.glob("*.so")) == [library]


@needs_compiler
def test_same_name_with_other_contents_is_another_file(folder: Path) -> None:
    twice, thrice = compile_function(doubled()), compile_function(doubled(factor=3.0))
    assert len(list(folder.glob("*.so"))) == 2
    assert np.array(twice([1.0, 1.0])).ravel().tolist() == [2.0, 2.0]
    assert np.array(thrice([1.0, 1.0])).ravel().tolist() == [3.0, 3.0]


@needs_compiler
def test_another_processor_does_not_take_the_cached_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compile_function(doubled())
    monkeypatch.setattr(codegen, "processor", lambda: "another one")
    compile_function(doubled())
    assert len(list(folder.glob("*.so"))) == 2


def test_processor_is_described_and_stays_the_same() -> None:
    codegen.processor.cache_clear()
    first = codegen.processor()
    codegen.processor.cache_clear()
    assert first == codegen.processor()
    assert len(first.split()) >= 2
    assert "MHz" not in first  # changes from moment to moment


@needs_compiler
def test_several_functions_share_one_library(folder: Path) -> None:
    one, other = compile_functions([doubled("one"), doubled("other", 5.0)])
    assert len(list(folder.glob("*.so"))) == 1
    assert np.array(one([1.0, 1.0])).ravel().tolist() == [2.0, 2.0]
    assert np.array(other([1.0, 1.0])).ravel().tolist() == [5.0, 5.0]


@needs_compiler
def test_large_functions_have_libraries_of_their_own(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(codegen, "SIZES", ((3, "-O2"), (float("inf"), "-O0")))
    made = compile_functions([doubled("one"), doubled("other", 5.0)])
    assert len(list(folder.glob("*.so"))) == 2
    assert [float(f([1.0, 1.0])[0]) for f in made] == [2.0, 5.0]


@needs_compiler
def test_a_recipe_is_followed_once(folder: Path) -> None:
    (first,) = compile_recipe("twice", lambda: [doubled()])

    def again() -> list[ca.Function]:
        raise AssertionError("made again")

    (second,) = compile_recipe("twice", again)
    assert float(first([1.0, 1.0])[0]) == float(second([1.0, 1.0])[0]) == 2.0
    (note,) = folder.glob("recipe_*.json")
    for damage in ("[", '[["lost.so", "doubled"]]', "{}", "[3]"):
        codegen._keep(note, damage.encode())
        assert float(compile_recipe("twice", lambda: [doubled()])[0]([1.0, 1.0])[0]) == 2.0
    (other,) = compile_recipe("thrice", lambda: [doubled(factor=3.0)])
    assert float(other([1.0, 1.0])[0]) == 3.0


def test_without_a_compiler_the_function_itself_comes_back_with_a_warning(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(codegen, "compiler", lambda: None)
    plain = doubled()
    with warned("doubled", "no C compiler", category=mo.NotCompiled):
        result = compile_function(plain)
    assert result is plain
    assert not folder.exists()


@compiles
def test_compiler_is_looked_for_by_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    own = stub_compiler(tmp_path / "own-cc", "exit 0")
    find = codegen.compiler.__wrapped__
    monkeypatch.setenv("CC", own)
    assert find() == own
    monkeypatch.delenv("CC")
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}" if name == "clang" else None)
    assert find() == "/bin/clang"
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert find() is None


@compiles
def test_failing_compiler_is_quoted_in_the_warning(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = stub_compiler(tmp_path / "broken-cc", "echo out of paper >&2; exit 3")
    monkeypatch.setattr(codegen, "compiler", lambda: broken)
    plain = doubled()
    with warned("doubled", "broken-cc", "status 3", "out of paper", category=mo.NotCompiled):
        assert compile_function(plain) is plain
    assert list(folder.iterdir()) == []


@needs_compiler
def test_compiler_that_does_not_know_the_processor_flag_still_compiles(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = codegen.compiler()
    script = f'case " $* " in *march=native*) exit 1;; esac; exec {real} "$@"'
    monkeypatch.setattr(codegen, "compiler", lambda: stub_compiler(tmp_path / "old-cc", script))
    assert compile_function(doubled()).class_name() == "External"


@needs_compiler
def test_what_is_no_library_is_warned_about(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = folder / "broken.so"
    folder.mkdir()
    broken.write_bytes(b"not a library")
    monkeypatch.setattr(codegen, "build_library", lambda *arguments: broken)
    with warned("doubled", "broken.so", category=mo.NotCompiled):
        compile_function(doubled())
    assert not broken.exists()


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The system's folder for temporary files."""
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(codegen.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    codegen._say_once.cache_clear()
    return tmp_path / "tmp"


def unsafe_file(folder: Path, tmp_path: Path) -> None:
    folder.write_text("a file where the folder should be")


def unsafe_link(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    folder.symlink_to(tmp_path / "elsewhere")


def unsafe_mode(folder: Path, tmp_path: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)


@needs_compiler
@pytest.mark.parametrize("spoil", [unsafe_file, unsafe_link, unsafe_mode])
def test_a_folder_that_is_not_safe_is_not_used_and_that_is_said_once(
    folder: Path, temporary: Path, tmp_path: Path, spoil: Callable[[Path, Path], None]
) -> None:
    spoil(folder, tmp_path)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert all(
            compile_function(doubled(name)).class_name() == "External" for name in ("one", "two")
        )
    (warning,) = said
    assert str(folder) in str(warning.message)
    assert len(list(temporary.glob("microbot_ocp-*/*.so"))) == 2
    assert not list((tmp_path / "elsewhere").glob("*"))


def damaged(kind: str, library: Path, rng: np.random.Generator) -> None:
    content = bytearray(library.read_bytes())
    if kind == "truncated":
        content = content[: rng.integers(len(content))]
    elif kind == "flipped":
        content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    elif kind == "lengthened":
        content += b"\0"
    library.unlink()  # as it may be mapped
    library.write_bytes(content)


@needs_compiler
@pytest.mark.parametrize("kind", ["truncated", "flipped", "lengthened"])
def test_a_damaged_library_is_not_loaded_but_made_again(folder: Path, kind: str) -> None:
    compile_function(doubled())
    (library,) = folder.glob("*.so")
    rng = np.random.default_rng()
    for _ in range(max(1, int(os.environ.get("MICROBOT_OCP_KILLS", "2")) // 3)):  # of three kinds
        damaged(kind, library, rng)
        assert not codegen._is_whole(library)
        again = compile_function(doubled())
        assert again.class_name() == "External"
        assert np.array(again([1.0, 2.0])).ravel().tolist() == [2.0, 4.0]
        assert codegen._is_whole(library)


@needs_compiler
def test_a_damaged_extension_module_is_made_again(folder: Path) -> None:
    x = ca.SX.sym("x", 2)
    for _ in range(2):
        twice = fast_call(ca.Function("twice", [x], [2 * x]))
        assert twice([1.0, 2.0]).tolist() == [2.0, 4.0]
        (library,) = [path for path in folder.glob("fast_*") if path.suffix == ".so"]
        damaged("truncated", library, np.random.default_rng())


@compiles
def test_a_compiler_that_hangs_is_ended_with_its_children(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = f"sleep 60 & echo $! > {tmp_path}/child; wait"
    monkeypatch.setattr(codegen, "compiler", lambda: stub_compiler(tmp_path / "slow-cc", script))
    monkeypatch.setattr(codegen, "COMPILE_TIMEOUT", 0.5)
    with warned("doubled", "slow-cc", "0.5 s", category=mo.NotCompiled):
        compile_function(doubled())
    wait_for_the_end_of(tmp_path / "child")
    assert list(folder.iterdir()) == []


def wait_for_the_end_of(child: Path) -> None:
    place = Path("/proc") / child.read_text().strip()
    deadline = time.monotonic() + 5
    while place.exists() and "(sleep) Z" not in (place / "stat").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@needs_compiler
def test_what_a_compiler_leaves_is_not_waited_for_and_ends(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = f'sleep 60 & echo $! > {tmp_path}/child; exec {codegen.compiler()} "$@"'
    leaving = stub_compiler(tmp_path / "leaving-cc", script)
    monkeypatch.setattr(codegen, "compiler", lambda: leaving)
    begin = time.monotonic()
    assert compile_function(doubled()).class_name() == "External"
    assert time.monotonic() - begin < 30
    wait_for_the_end_of(tmp_path / "child")


@needs_compiler
def test_a_killed_compile_leaves_nothing_to_the_next(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, slow = codegen.compiler(), stub_compiler(tmp_path / "slow-cc", "sleep 60")
    monkeypatch.setattr(codegen, "compiler", lambda: slow)
    child = os.fork()
    if not child:
        compile_function(doubled())
        os._exit(1)
    while not folder.is_dir() or not list(folder.glob(".*/function.c")):
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    assert len(list(folder.iterdir())) == 1
    monkeypatch.setattr(codegen, "compiler", lambda: real)
    compile_function(doubled())
    assert sorted(path.suffix for path in folder.iterdir()) == [".sha256", ".so"]


@compiles
def test_a_compiler_may_say_what_is_no_text(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rude = stub_compiler(tmp_path / "rude-cc", r"printf '\377\376 no' >&2; exit 1")
    monkeypatch.setattr(codegen, "compiler", lambda: rude)
    with warned("doubled", "rude-cc", "status 1", category=mo.NotCompiled):
        compile_function(doubled())


@compiles
def test_a_user_without_a_home(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("MICROBOT_OCP_CACHE")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", unknown)
    assert codegen.cache_folder().parent == temporary
    assert codegen.usable_folder().is_dir()


def test_cache_folder_follows_the_environment(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("MICROBOT_OCP_CACHE", str(tmp_path / "mine"))
    assert codegen.cache_folder() == tmp_path / "mine"
    monkeypatch.delenv("MICROBOT_OCP_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert codegen.cache_folder() == tmp_path / "xdg" / "microbot_ocp"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert codegen.cache_folder() == Path.home() / ".cache" / "microbot_ocp"


def common_libraries() -> list[codegen.CommonLibrary]:
    return [*_ldl.LIBRARIES.values(), WINDOWS, *map(fast_calls.rows_library, (True, False))]


@pytest.fixture
def wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The libraries of a wheel, on a machine without a compiler."""
    folder = tmp_path / "wheel"
    folder.mkdir()
    monkeypatch.setattr(codegen, "WHEEL_FOLDER", folder)
    monkeypatch.setattr(codegen, "_found", {})
    monkeypatch.setattr(_ldl, "_known", {})
    for library in common_libraries():
        library.compile_for_wheel(folder)
    for module in (codegen, _ldl):
        monkeypatch.setattr(module, "compiler", lambda: None)
    fast_calls._interpreter.cache_clear()
    yield folder
    fast_calls._interpreter.cache_clear()


needed = codegen.NEEDED_INSTRUCTIONS.get(platform.machine(), set())
runs_wheels = pytest.mark.skipif(
    platform.machine() not in codegen.WHEEL_FLAGS or not needed <= {*codegen.processor().split()},
    reason="wheels have no libraries for this machine",
)


@needs_compiler
@runs_wheels
def test_without_a_compiler_the_libraries_of_a_wheel_serve(wheel: Path, monkeypatch):
    def without_amd():
        raise AttributeError("amd_l_order")

    assert [library.path().parent for library in common_libraries()] == [wheel] * 5
    with warnings.catch_warnings():
        warnings.simplefilter("error", codegen.NotCompiled)
        assert _ldl.linear_solver_library(_ldl.BAND) == _ldl.LIBRARIES[_ldl.BAND].path()
        table = fast_calls.rows_in_place(doubled("of_the_wheel", 2.5))(3)
    table.inputs[0][:] = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]
    with warned("MUMPS", "ldl", "amd_l_order", category=codegen.NotCompiled):
        monkeypatch.setattr(_ldl, "_amd_ordering", without_amd)
        assert _ldl.linear_solver_library(_ldl.NAME) is None
    table.run()
    assert table.outputs[0].tolist() == [[2.5, 5.0], [7.5, 10.0], [12.5, 15.0]]


@needs_compiler
@runs_wheels
@pytest.mark.parametrize("why", ["another text", "another processor", "another system"])
def test_a_library_that_does_not_fit_is_not_loaded(wheel: Path, monkeypatch, why: str):
    library = WINDOWS
    if why == "another text":
        library = replace(WINDOWS, text=f"{WINDOWS.text}\n")
    elif why == "another system":
        library.wheel_path.write_text("for another system")
    else:
        monkeypatch.setitem(codegen.NEEDED_INSTRUCTIONS, platform.machine(), {"no such set"})
    with pytest.raises(RuntimeError, match="no C compiler"):
        library.path()


def test_a_compiler_that_fails_is_asked_once_for_a_common_library(monkeypatch):
    asked = []

    def fails(*_, **__):
        asked.append(1)
        raise RuntimeError("it ended with status 1")

    monkeypatch.setattr(codegen, "_found", {})
    monkeypatch.setattr(codegen, "compiler", lambda: "/bin/false")
    monkeypatch.setattr(codegen, "build_library", fails)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="status 1"):
            replace(WINDOWS, text="int unlike;").path()
    assert len(asked) == 1


@needs_compiler
def test_common_libraries_serve_where_functions_are_interpreted():
    with codegen.interpreted():
        assert all(library.path().exists() for library in common_libraries())
