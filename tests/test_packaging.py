"""What the wheel carries, and that its pure Python says so."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
import yaml

import microbot_ocp as mo

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "src" / "microbot_ocp"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "-w", str(folder)]
    done = subprocess.run([*command, str(ROOT)], capture_output=True, text=True, check=False)
    if done.returncode and "hatchling" in done.stderr and "No matching distribution" in done.stderr:
        pytest.skip("the build backend, hatchling, cannot be reached from here")
    assert done.returncode == 0, done.stderr
    (made,) = folder.glob("*.whl")
    return zipfile.ZipFile(made)


@pytest.mark.thorough
def test_wheel_carries_every_source_and_data_file(wheel: zipfile.ZipFile) -> None:
    wanted = {
        path.relative_to(PACKAGE.parent).as_posix()
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    carried = {name for name in wheel.namelist() if name.startswith("microbot_ocp/")}
    assert carried == wanted
    assert {"microbot_ocp/py.typed", "microbot_ocp/robot/packaged/microbot.toml"} <= carried


@pytest.mark.thorough
def test_wheel_carries_nothing_else_but_its_licence_and_metadata(wheel: zipfile.ZipFile) -> None:
    rest = [name for name in wheel.namelist() if not name.startswith("microbot_ocp/")]
    assert all(name.startswith("microbot_ocp-") and ".dist-info/" in name for name in rest)
    assert any(name.endswith("/licenses/LICENSE") for name in rest)


def test_the_recipe_of_conda_needs_what_the_wheel_needs() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text())
    listed = [f"python{project['requires-python']}", *project["dependencies"]]
    needed = [name.replace("matplotlib", "matplotlib-base").replace(">=", " >=") for name in listed]
    assert recipe["requirements"]["run"] == needed
    assert recipe["build"]["python"]["entry_points"] == [
        f"{name} = {target}" for name, target in project["scripts"].items()
    ]
    assert recipe["about"]["summary"] == project["description"]


@pytest.mark.thorough
def test_metadata_names_what_it_needs(wheel: zipfile.ZipFile) -> None:
    (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
    metadata = Parser().parsestr(wheel.read(name).decode())
    assert metadata["Name"] == "microbot_ocp"
    assert metadata["Requires-Python"] == ">=3.11"
    assert re.fullmatch(r"\d+\.\d+\.\d+(\.dev\d+(\+g[0-9a-f]+.*)?)?", metadata["Version"])
    needed = {
        line.split(";")[0].split(">")[0].strip()
        for line in metadata.get_all("Requires-Dist", [])
        if "extra" not in line
    }
    assert needed == {"casadi", "lazy-loader", "numpy", "matplotlib", "rerun-sdk", "rich", "typer"}
    assert Path(wheel.filename or "").name.endswith("-py3-none-any.whl")


@pytest.mark.thorough
def test_the_demo_runs_from_the_wheel(wheel: zipfile.ZipFile, tmp_path: Path) -> None:
    """In an environment without the source: only what others have made is taken from here."""
    home = tmp_path / "environment"
    venv.create(home, symlinks=True)
    python = home / "bin" / "python"
    paths = sysconfig.get_path("purelib", "venv", {"base": str(home)})
    Path(paths, "others.pth").write_text(sysconfig.get_path("purelib"))
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps"]
    subprocess.run([*install, "--quiet", "--ignore-installed", str(wheel.filename)], check=True)
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "MICROBOT"))}
    command = [home / "bin" / "microbot-ocp", "demo", "--mesh", "20"]
    where = subprocess.run(
        [python, "-c", "import microbot_ocp; print(microbot_ocp.__file__)"],
        capture_output=True, text=True, cwd=tmp_path, env=clean, check=True,
    )  # fmt: skip
    assert Path(where.stdout.strip()).is_relative_to(home)
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=clean)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert all(any(line.startswith(m.title) for line in lines) for m in mo.tasks.METHODS.values())
    out = tmp_path / "microbot-demo"
    names = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    assert lines[-1] == f"written: {len(names)} files in {out.name}"
    expected = {"comparison.json", "comparison.csv", "comparison.rrd", "report.pdf", "report.html"}
    expected |= {f"{name}.{kind}" for name in ("comparison", "paths") for kind in ("png", "pdf")}
    assert names == expected | {f"motions/{name}.npz" for name in mo.tasks.METHODS}
