"""One look for each method, wherever it is drawn; nothing heavy is imported unasked."""

import subprocess
import sys
from dataclasses import replace

import pytest

from microbot_ocp.views.plots._style import FIXED, entry_styles, failure_sentence, highlighted_name


def test_known_methods_keep_their_colour(comparison):
    styles = entry_styles(comparison)
    fewer = entry_styles(replace(comparison, entries=comparison.entries[1:]))
    for name in fewer:
        assert fewer[name] == styles[name]
        assert styles[name].color == FIXED[name][0]


def test_unknown_methods_get_distinct_looks(comparison):
    entries = tuple(replace(comparison.entries[0], name=f"mine {i}") for i in range(4))
    styles = entry_styles(replace(comparison, entries=entries))
    assert len({(style.color, style.linestyle) for style in styles.values()}) == 4
    assert not {style.color for style in styles.values()} & {color for color, _ in FIXED.values()}


def test_highlighted(comparison):
    assert highlighted_name(comparison) == "time_optimal"
    first_two = replace(comparison, entries=comparison.entries[:2])
    assert highlighted_name(first_two) == "cubic"
    assert highlighted_name(replace(comparison, entries=comparison.entries[3:])) is None


def test_failure_in_words(comparison):
    sentence = failure_sentence(comparison.entries[3])
    assert sentence == "lspb: not solved: infeasible: the blends overlap at the second via point"


def test_rgba(comparison):
    assert entry_styles(comparison)["cubic_report"].rgba(110) == (0, 0x72, 0xB2, 110)


@pytest.mark.parametrize("heavy", ["matplotlib", "rerun"])
def test_package_import_is_light(heavy):
    code = f"import sys, microbot_ocp; raise SystemExit('{heavy}' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
