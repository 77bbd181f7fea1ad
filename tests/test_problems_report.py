"""The tables and figures of the course report."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import microbot_ocp as mo
import report_figures
import report_tables

ERRATA = Path(__file__).parent.parent / "docs" / "errata.md"


def test_every_wrong_number_of_the_report_has_its_erratum_beside_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert report_tables.show(mo.load_robot("microbot"))
    printed = capsys.readouterr().out
    for part in ("1,", "2,", "3.1,", "3.2,", "4a,", "4b,", "5,", "6,"):
        assert f"\nPart {part}" in printed
    row = r"-0\.3147 +-0\.0305 +0\.9487.*\| +-0\.3147 +0\.0305 .*misprint"
    assert re.search(row, printed)
    assert re.search(r"v3 +-0\.9751 +-0\.3818 +1\.6000 +\| .* -1\.6000 +-1\.6: v4", printed)
    assert re.search(
        r"0\.1288 .*\| +-0\.7327 .*that of \(161\.57, -150\.81, -111\.38\) deg", printed
    )
    assert "Fig. 18" in printed
    assert "520.39   2058.59   1059.90" in printed


@pytest.mark.parametrize(
    ("name", "digit", "other"),
    [
        ("PRINTED_SOLUTIONS", "105.8439", "105.8449"),
        ("PRINTED_REACHED", "0.9399", "0.9389"),
        ("PRINTED_LINEAR", "4.1561", "4.1551"),
        ("PRINTED_ANGULAR", "0.5333", "-0.5333"),
    ],
)
def test_a_wrong_number_without_an_erratum_is_found(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    name: str,
    digit: str,
    other: str,
) -> None:
    text = getattr(report_tables, name)
    monkeypatch.setattr(report_tables, name, text.replace(digit, other, 1))
    assert not report_tables.show(mo.load_robot("microbot"))
    assert "DIFFERS" in capsys.readouterr().out


def test_the_page_of_errata_has_every_formula_of_the_tables() -> None:
    parts = re.split(r"(?m)^## Part ", ERRATA.read_text("utf-8"))[1:]
    rows = {part[:2].strip(", "): len(re.findall(r"(?m)^\|", part)) - 2 for part in parts}
    for part in ("4a", "4b", "5", "6"):
        assert rows[part] == len(report_tables.FORMULAS[part])


@pytest.mark.slow
def test_every_figure_of_the_report_is_drawn() -> None:
    drawn = report_figures.draw(mo.load_robot("microbot"))
    numbers = {int(name.split("_")[1]) for name in drawn}
    assert numbers == set(range(1, 24))
    assert len(drawn) == 24, "two figures of the report are number 18"
