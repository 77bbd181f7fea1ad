"""The order of the modules: who may import whom, read from the source, and what stays unloaded."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import NamedTuple, TypeGuard

import pytest

import microbot_ocp
import microbot_ocp.ocp
import microbot_ocp.planning
from helpers import refused

PACKAGE = Path(microbot_ocp.__file__).parent
ROOT = Path(__file__).resolve().parent.parent

# Every module or folder of the package has its place here; it may import those before it, and a
# folder its own modules. A new one must be placed.
ORDER = (
    "_base",
    "limits",
    "robot",
    "motion",
    "scene",
    "acceleration",
    "inverse_kinematics",
    "trajectories",
    "simulation",
    "ocp",
    "planning",
    "certificate",
    "execution",
    "tasks",
    "layout",
    "sweeps",
    "views",
    "cli",
    "__main__",
)
# The rooms inside of a folder, in their order.
INSIDE = {
    "ocp": (
        "problem",
        "transcription",
        "solution",
        "starts",
        "diagnosis",
        "verification",
        "mesh",
        "solvers",
        "arcs",
        "refinement",
        "search",
        "switching",
    ),
    "planning": ("task", "path", "timing", "free", "search"),
}
# These know fewer than all before them.
ONLY = {"ocp": {"_base"}}  # any CasADi dynamics, no robot
RIM = {
    "views",
    "cli",
    "__main__",
}  # imported by no other module: results find their views by a registry
HEAVY = {"matplotlib", "rerun", "rich", "typer"}


class Import(NamedTuple):
    origin: str  # file, from the package's folder
    family: str  # first part of the importing module's name
    target: str  # full name of what is imported
    when: str  # "load", "call" (inside a function) or "typing" (under TYPE_CHECKING: never run)

    @property
    def internal(self) -> str | None:
        """Family that is imported; None outside the package."""
        parts = self.target.split(".")
        return parts[1] if parts[0] == "microbot_ocp" and len(parts) > 1 else None


def families() -> set[str]:
    found = set()
    for path in PACKAGE.iterdir():
        if path.suffix == ".py" and path.stem != "__init__":
            found.add(path.stem)
        elif path.is_dir() and any(path.rglob("*.py")):
            found.add(path.name)
    return found


def is_type_checking(node: ast.AST) -> TypeGuard[ast.If]:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def walk(node: ast.AST, when: str = "load") -> Iterator[tuple[ast.AST, str]]:
    typing_only = node.body if is_type_checking(node) else []
    for child in ast.iter_child_nodes(node):
        inner = when
        if child in typing_only:
            inner = "typing"
        elif when == "load" and isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            inner = "call"
        if not isinstance(child, ast.expr):  # no expression imports
            yield child, inner
            yield from walk(child, inner)


def names(node: ast.AST, package: list[str]) -> list[str]:
    """Full names that one import statement asks for."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    base = (node.module or "").split(".") if node.module else []
    if node.level:
        base = package[: len(package) - node.level + 1] + base
    if base == ["microbot_ocp"]:
        return [f"microbot_ocp.{alias.name}" for alias in node.names]
    private = [alias.name for alias in node.names if alias.name.startswith("_")]
    return [".".join([*base, name]) for name in private] or [".".join(base)]


def imports_of(text: str, origin: Path) -> list[Import]:
    package = ["microbot_ocp", *origin.parent.parts]
    family = origin.parts[0].removesuffix(".py")
    return [
        Import(str(origin), family, name, when)
        for node, when in walk(ast.parse(text))
        for name in names(node, package)
    ]


@cache
def imports() -> list[Import]:
    return [
        found
        for path in sorted(PACKAGE.rglob("*.py"))
        if path != PACKAGE / "__init__.py"
        for found in imports_of(path.read_text("utf-8"), path.relative_to(PACKAGE))
    ]


def forbidden(found: Import) -> bool:
    family, target = found.family, found.internal
    if target is None or target == family:
        return False
    if target not in ORDER or family not in ORDER:
        return True  # a name of the package itself: modules import from modules
    before = set(ORDER[: ORDER.index(family)])
    return target not in ONLY.get(family, before)


def test_every_module_has_its_place() -> None:
    unplaced = families() - set(ORDER)
    assert not unplaced, f"place {sorted(unplaced)} in ORDER"


def test_imports_go_down_the_order_only() -> None:
    wrong = [f"{found.origin} imports {found.target}" for found in imports() if forbidden(found)]
    assert not wrong


def goes_up(found: Import) -> bool:
    """Whether a room inside of a folder imports one that comes after it."""
    order, parts = INSIDE.get(found.family, ()), Path(found.origin).parts
    target = found.target.split(".")
    if found.when == "typing" or target[:2] != ["microbot_ocp", found.family]:
        return False
    if len(parts) < 3 or len(target) < 3 or target[2] == parts[1] or target[2] not in order:
        return False
    return order.index(target[2]) > order.index(parts[1])


@pytest.mark.parametrize("folder", INSIDE)
def test_rooms_inside_of_a_folder_have_their_order(folder: str) -> None:
    rooms = {path.parent.name for path in (PACKAGE / folder).glob("*/*.py")}
    assert rooms - {"schemes"} == set(INSIDE[folder])
    assert not {f"{found.origin} imports {found.target}" for found in imports() if goes_up(found)}


LEFT = {"ocp/solvers/_plugins.py"}  # takes LazyFunctions from ocp/transcription/_assembly.py


def goes_behind_a_face(found: Import) -> bool:
    """Whether a module imports from the private module of a folder that it is not in."""
    target = found.target.split(".")
    if target[0] != "microbot_ocp" or target[1:2] == ["_base"]:
        return False
    public = next((i for i, part in enumerate(target) if part.startswith("_")), len(target))
    inside = Path(found.origin).parent.parts[: public - 1] == tuple(target[1:public])
    return public < len(target) and not inside


def test_rooms_are_entered_by_their_faces() -> None:
    wrong = {(i.origin, i.target) for i in imports() if goes_behind_a_face(i)}
    assert {origin for origin, _ in wrong} == LEFT, wrong


@pytest.mark.parametrize(
    ("origin", "text", "refused"),
    [
        ("scene/_contact.py", "from microbot_ocp.robot._capsules import LinkHull", True),
        ("scene/_contact.py", "from microbot_ocp.robot import _capsules", True),
        ("scene/_contact.py", "def f():\n    from ..robot._capsules import LinkHull", True),
        ("scene/_contact.py", "import microbot_ocp.robot._capsules", True),
        ("scene/_contact.py", "from microbot_ocp.robot import LinkHull", False),
        ("scene/_contact.py", "from microbot_ocp.scene._pairs import Pair", False),
        ("scene/_contact.py", "from microbot_ocp._base import _anything", False),
        ("views/recording/_sweep.py", "from microbot_ocp.views._eye import Eye", False),
        ("views/recording/_sweep.py", "from microbot_ocp.views.tables._results import sweep", True),
        ("views/_studio.py", "from microbot_ocp.views.tables._results import sweep", True),
    ],
)
def test_the_rule_for_faces_itself(origin: str, text: str, refused: bool) -> None:
    assert any(goes_behind_a_face(found) for found in imports_of(text, Path(origin))) == refused


def test_views_and_cli_are_named_by_nobody_else() -> None:
    outside = [
        path
        for path in PACKAGE.rglob("*.py*")
        if path.suffix in (".py", ".pyi")
        and path.relative_to(PACKAGE).parts[0].removesuffix(".py") not in RIM
    ]
    face = {PACKAGE / "__init__.py", PACKAGE / "__init__.pyi"}  # where everything comes together
    assert face < set(outside)
    named = re.compile(r"microbot_ocp\.(views|cli)\b")
    wrong = [str(path) for path in set(outside) - face if named.search(path.read_text("utf-8"))]
    assert not wrong


def needs_drawing(found: Import) -> bool:
    heavy = found.target.split(".")[0] in HEAVY
    return heavy and found.when != "typing" and found.family not in RIM


def test_drawing_libraries_are_imported_by_the_rim_only() -> None:
    wrong = [
        f"{found.origin} imports {found.target}" for found in imports() if needs_drawing(found)
    ]
    assert not wrong


@pytest.mark.parametrize(
    ("origin", "text", "refused"),
    [
        ("robot/_model.py", "from microbot_ocp._base.checks import InputError", False),
        ("robot/_model.py", "from microbot_ocp._base import checks", False),
        ("robot/_model.py", "from . import motion", False),
        ("robot/_model.py", "from .. import motion", True),
        ("robot/_model.py", "def f():\n    from microbot_ocp.motion import Motion", True),
        ("ocp/solution/_solution.py", "from microbot_ocp.robot import Robot", True),
        ("ocp/solution/_solution.py", "from ...robot import energy", True),
        ("ocp/solution/_solution.py", "from ..problem import Phase", False),
        ("motion/_motion.py", "import microbot_ocp.tasks", True),
        ("motion/_motion.py", "from microbot_ocp import Motion", True),
        ("tasks/_comparison.py", "import microbot_ocp.views.plots", True),
        ("tasks/_comparison.py", "def f():\n    from microbot_ocp.views import plots", True),
        ("trajectories/_cubic.py", "if True:\n    from microbot_ocp.ocp import problem", True),
        ("cli/_app.py", "from microbot_ocp.views import tables", False),
        ("views/plots/_page.py", "from microbot_ocp import cli", True),
        ("motion/_motion.py", "import numpy", False),
    ],
)
def test_the_rule_itself(origin: str, text: str, refused: bool) -> None:
    assert any(forbidden(found) for found in imports_of(text, Path(origin))) == refused


@pytest.mark.parametrize(
    ("origin", "text", "refused"),
    [
        ("tasks/_comparison.py", "import matplotlib.figure", True),
        ("tasks/_comparison.py", "def f():\n    from rich.table import Table", True),
        ("tasks/_comparison.py", "if TYPE_CHECKING:\n    from rich.table import Table", False),
        ("tasks/_comparison.py", "if TYPE_CHECKING:\n    pass\nelse:\n    import rerun", True),
        ("views/plots/_page.py", "import matplotlib", False),
    ],
)
def test_the_rule_for_drawing_libraries_itself(origin: str, text: str, refused: bool) -> None:
    assert any(needs_drawing(found) for found in imports_of(text, Path(origin))) == refused


def test_importing_the_package_leaves_drawing_libraries_unloaded() -> None:
    code = f"import sys, microbot_ocp; print(*({HEAVY!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_importing_the_package_leaves_numbers_unloaded() -> None:
    code = "import sys, microbot_ocp; print(*({'casadi', 'numpy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


PACKAGES = (microbot_ocp, microbot_ocp.ocp)


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there_and_documented(package: ModuleType) -> None:
    assert len(set(package.__all__)) == len(package.__all__)
    assert set(package.__all__) <= set(dir(package))
    for name in package.__all__:
        assert getattr(package, name).__doc__, name


def test_planning_shows_users_no_helpers() -> None:
    pages = "\n".join(page.read_text("utf-8") for page in (ROOT / "docs/api").glob("*.md"))
    documented = re.findall(r"^::: microbot_ocp\.(?:\w+\.)?(\w+)", pages, re.MULTILINE)
    shown = set(dir(microbot_ocp.planning))
    assert shown - set(microbot_ocp.__all__) - set(documented) == {"MotionIteration"}


def test_every_name_of_the_contents_is_public() -> None:
    text = microbot_ocp.ocp.__doc__ or ""
    mentioned = set(re.findall(r":(?:class|func|data):`(\w+)`", text))
    assert mentioned <= set(microbot_ocp.ocp.__all__)
    assert len(mentioned) > 20


def test_the_stub_holds_nothing_but_public_names() -> None:
    stub = PACKAGE / "__init__.pyi"
    tree = ast.parse(stub.read_text("utf-8"))
    aliases = [a for s in tree.body if isinstance(s, ast.ImportFrom) for a in s.names]
    assert all(a.asname == a.name for a in aliases)  # else a type checker takes it for private
    assert set(microbot_ocp.__all__) == {a.name for a in aliases}
    assert [type(s) for s in tree.body[1:]] == [ast.ImportFrom] * len(tree.body[1:])


def test_a_function_comes_before_the_folder_of_its_name() -> None:
    code = (
        "import microbot_ocp.planning.timing._path_timing, microbot_ocp as mo\n"
        "assert callable(mo.time_optimal)\n"
        "import microbot_ocp.planning.search._time_optimal\n"
        "assert callable(mo.time_optimal)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@cache
def public_homes() -> set[tuple[str, str]]:
    """Private module and name of everything that the stub of some folder makes public."""
    found = set()
    for stub in PACKAGE.rglob("__init__.pyi"):
        package = ["microbot_ocp", *stub.parent.relative_to(PACKAGE).parts]
        for node in ast.parse(stub.read_text("utf-8")).body:
            if isinstance(node, ast.ImportFrom):
                modules = [name for name in names(node, package) if "._" in name]
                found |= {(module, alias.name) for module in modules for alias in node.names}
    return found


def taken_from_behind(text: str) -> list[str]:
    """Names that a text imports from a private module although a public folder has them."""
    public = public_homes()
    return [
        f"{node.module}.{alias.name}"
        for node, _ in walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if (node.module, alias.name) in public
    ]


@pytest.mark.parametrize("folder", ["tests", "problems", "benchmarks", "docs"])
def test_public_names_are_imported_from_public_folders(folder: str) -> None:
    files = sorted((ROOT / folder).rglob("*.py"))
    assert files
    wrong = {str(file): found for file in files if (found := taken_from_behind(file.read_text()))}
    assert not wrong


def test_the_rule_for_public_names_itself() -> None:
    assert taken_from_behind("from microbot_ocp.motion._motion import Motion, _quintic") == [
        "microbot_ocp.motion._motion.Motion"
    ]
    assert taken_from_behind("def f():\n    from microbot_ocp._base.checks import InputError")
    assert not taken_from_behind("from microbot_ocp.motion import Motion")


def test_a_name_that_is_not_there() -> None:
    with refused("microbot_ocp", "'nothing'", error=AttributeError):
        _ = microbot_ocp.nothing
