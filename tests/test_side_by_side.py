"""The COPS robot arm of docs/side_by_side.md: what is shown is what runs."""

from __future__ import annotations

import ast
import runpy
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
FORMS = ROOT / "benchmarks" / "cops_arm"
BENCHMARK = runpy.run_path(str(FORMS / "__init__.py"))


@pytest.mark.thorough
def test_ours_is_short_has_no_indices_and_meets_the_published_time(
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = FORMS / "ours.py"
    assert BENCHMARK["code_lines"](path) < 30
    tree = ast.parse(path.read_text("utf-8"))
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Subscript)]
    solution = runpy.run_path(str(path))["solution"]
    assert solution.status.solved
    assert solution.duration == pytest.approx(BENCHMARK["PUBLISHED"], abs=1e-5)
    assert float(capsys.readouterr().out) == solution.duration


def test_the_page_shows_the_files_that_run() -> None:
    page = (ROOT / "docs" / "side_by_side.md").read_text("utf-8")
    for name in BENCHMARK["TITLES"]:
        assert f'--8<-- "benchmarks/cops_arm/{name}.py"' in page


def test_blank_lines_and_comments_are_no_code(tmp_path: Path) -> None:
    path = tmp_path / "form.py"
    path.write_text("# a comment\n\nx = (\n    1\n)  # another\n", "utf-8")
    assert BENCHMARK["code_lines"](path) == 3


def test_the_page_says_how_long_the_codes_are() -> None:
    page = (ROOT / "docs" / "side_by_side.md").read_text("utf-8")
    for name, title in BENCHMARK["TITLES"].items():
        row = next(line for line in page.splitlines() if line.startswith(f"| {title}"))
        assert row.split("|")[2].strip() == str(BENCHMARK["code_lines"](FORMS / f"{name}.py"))
