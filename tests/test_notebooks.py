"""Notebooks as a reader runs them: from top to bottom, in a new kernel, without a complaint."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient
from traitlets.config import Config

pytestmark = pytest.mark.slow

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
WORDS_A_MINUTE = 180
SECONDS_A_LINE_OF_CODE = 3.0
WIDGET = "application/vnd.jupyter.widget-view+json"

# what the text says of an output, the cell, and how the output must read for that
SAID = {
    "01_robot_and_kinematics": (
        ("A point in reach has up to four answers", "branches", r"(?:.* solved .*\n){4}"),
        ("Each start leads to the branch nearest to it", "program", r"(?:.*Solve_Succeeded\n){4}"),
        ("A point out of reach has no answer", "beyond", r"target is missed by 0\.2"),
    ),
    "02_dynamics": (
        ("$M_{33} = 2 \\cdot 4^2 = 32$", "form", r"M33 = 32\n"),
        ("$G_3 = 2 \\cdot 9.8 \\cdot 4\\,", "form", r"G3 = 78\.4 cos\(q2 \+ q3\)"),
        ("each takes it as it is", "integrators", r"(?:\w+ +\de-(?:09|1\d) rad.*\n){4}"),
        ("no finite torque gives a finite acceleration", "condition", r"90 deg.*e\+[23]\d"),
    ),
    "03_baselines_and_control": (
        ("how far each is off", "integrators", r"(?:\w+ +\de-(?:0[89]|1\d) rad, solved\n){4}"),
        ("leaves a\nquarter of the error", "errors", r"0\.71\d\d deg\n.*0\.18\d\d deg"),
    ),
    "05_your_own_robot": (("= 17.66$ N m", "gravity", r"17\.66"),),
    "06_your_own_problem": (
        ("The two costs differ by 2 %", "schemes", r"cost 59\.0.*\n.*cost 57\.9"),
        ("With at most 6.5 N the pole does not come up", "why", "No trajectory within all limits"),
        ("The force can help alone, by 1.3 N at most", "why", r"relaxed by 1\.3\d* N"),
        ("take 7.9 N, and it is solved", "enough", "^solved"),
    ),
}


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


def outputs(notebook: nbformat.NotebookNode) -> list[nbformat.NotebookNode]:
    return [out for cell in notebook.cells for out in cell.get("outputs", [])]


def said_by(cell: nbformat.NotebookNode) -> list[str]:
    return [
        out.get("text", "") + out.get("data", {}).get("text/plain", "")
        for out in cell.get("outputs", [])
    ]


def pictures(notebook: nbformat.NotebookNode) -> list[str]:
    """Name the cells that show a picture."""
    shown = [cell for cell in notebook.cells if "image/png" in str(cell.get("outputs", ""))]
    return [cell.id for cell in shown]


def outputs_are_as_the_text_says(path: Path, notebook: nbformat.NotebookNode) -> None:
    prose = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    shown = {cell.id: "".join(said_by(cell)) for cell in notebook.cells}
    for sentence, cell, pattern in SAID.get(path.stem, ()):
        assert sentence in prose
        assert re.search(pattern, shown[cell]), f"{sentence!r}, but {cell} shows {shown[cell]!r}"


def test_there_are_notebooks() -> None:
    assert [path.name[:3] for path in NOTEBOOKS] == [
        f"{i:02d}_" for i in range(1, 1 + len(NOTEBOOKS))
    ]
    assert NOTEBOOKS


@pytest.mark.pages
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs_from_clean(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    folder = tmp_path / "notebooks"
    (tmp_path / "problems").symlink_to(NOTEBOOKS[0].parent.parent / "problems")
    folder.mkdir()
    notebook = read(path)
    with tempfile.TemporaryDirectory(prefix="k") as sockets:  # a socket's path must be short
        # files in place of ports: two kernels that start at once cannot take the same one
        ipc = {"KernelManager": {"transport": "ipc", "ip": f"{sockets}/k"}}
        client = NotebookClient(
            notebook,
            timeout=120,
            startup_timeout=60,
            kernel_name="python3",
            resources={"metadata": {"path": str(folder)}},
            config=Config(ipc),
        )
        client.execute()  # raises with the traceback of the cell that fails
    complaints = [out.text for out in outputs(notebook) if out.get("name") == "stderr"]
    assert not complaints
    assert not list(folder.iterdir()), "a notebook leaves nothing behind"
    assert pictures(notebook), "a notebook shows at least one picture"
    assert pictures(notebook) == pictures(read(path)), "python docs/make_notebooks.py runs them"
    outputs_are_as_the_text_says(path, notebook)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_outputs_are_stored_small_and_in_order(path: Path) -> None:
    notebook = read(path)
    nbformat.validate(notebook)
    assert path.stat().st_size < 150e3
    for out in outputs(notebook):
        assert out.output_type in ("display_data", "execute_result", "stream")
        assert out.get("name") != "stderr"
        assert WIDGET not in out.get("data", {})
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    outputs_are_as_the_text_says(path, notebook)
    assert not any(cell.metadata for cell in notebook.cells)
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    assert notebook.metadata.language_info == {"name": "python"}
    names = [cell.id for cell in notebook.cells]
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z][a-z_]*", name) for name in names), "words, which stay"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_is_read_in_five_minutes_and_ends_with_exercises(path: Path) -> None:
    cells = read(path).cells
    prose = [cell.source for cell in cells if cell.cell_type == "markdown"]
    words = sum(len(re.sub(r"\$\$.*?\$\$", "", text, flags=re.DOTALL).split()) for text in prose)
    lines = sum(len(cell.source.splitlines()) for cell in cells if cell.cell_type == "code")
    assert words / WORDS_A_MINUTE + lines * SECONDS_A_LINE_OF_CODE / 60 < 5.0
    assert prose[0].startswith(f"# {path.stem[:2]} ")
    assert prose[-1].startswith("## Exercises")
    assert len(re.findall(r"(?m)^\d\. ", prose[-1])) in (2, 3)
