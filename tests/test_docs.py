"""The documentation: built strictly, complete, true, and loading nothing from elsewhere."""

from __future__ import annotations

import inspect
import os
import re
import subprocess
import sys
import tomllib
from contextlib import nullcontext
from importlib import import_module
from importlib.util import find_spec
from operator import attrgetter
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
import sockets

import blocks
import colab
import formulas
import links
import make_import_diagram
import make_which_function
import microbot_ocp
from test_imports import ORDER

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
HOW_TO = [path for path in sorted((DOCS / "how-to").glob("*.md")) if path.stem != "index"]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
COURSE = [DOCS / "course" / f"{name}.md" for name in ("kinematics", "jacobian", "dynamics")]
RUN = [DOCS / "tutorial.md", *COURSE, *HOW_TO]


def build(folder: Path, site: Path, trace: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Build the site of ``folder``; --quiet would keep warnings from being counted."""
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    command = command if trace is None else sockets.tracing(trace, command)
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, env=quiet
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built site; a warning of the builder is an error."""
    folder = tmp_path_factory.mktemp("site")
    trace = folder.parent / "docs.trace" if sockets.can_trace() else None
    done = build(ROOT, folder, trace)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    return folder


# the site -----------------------------------------------------------------------------------------


@pytest.mark.pages
def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    assert links.loaded_from_elsewhere(site) == []
    # the theme would fetch a drawing library for these
    assert not [page for page in site.rglob("*.html") if 'class="mermaid"' in page.read_text()]


@pytest.mark.pages
@pytest.mark.skipif(not sockets.can_trace(), reason=sockets.WHY_NOT)
def test_building_asks_no_other_machine(site: Path) -> None:
    assert sockets.reached(site.parent / "docs.trace") == set()


@pytest.mark.pages
def test_every_link_and_anchor_inside_leads_somewhere(site: Path) -> None:
    assert links.broken(site) == []


@pytest.mark.pages
def test_addresses_outside_are_well_formed(site: Path) -> None:
    assert links.malformed(links.addresses_outside(site)) == []


@pytest.mark.pages
def test_every_page_is_in_the_site(site: Path) -> None:
    pages = {path.relative_to(DOCS).with_suffix(".html") for path in DOCS.rglob("*.md")}
    built = {path.relative_to(site) for path in site.rglob("*.html")}
    renamed = {p.with_name("index.html") if p.stem == "README" else p for p in pages}
    assert built == renamed | {Path("404.html")}


def is_module(name: str) -> bool:
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:  # its parent is none
        return False


def home(path: str) -> str:
    """Where the object behind a dotted name is defined; of a constant the name itself."""
    parts = path.split(".")
    # a function may have the name of its module
    count = max(i for i in range(1, len(parts)) if is_module(".".join(parts[:i])))
    *owner, name = parts[count:]
    module = import_module(".".join(parts[:count]))
    holder = attrgetter(".".join(owner))(module) if owner else module
    if name in getattr(holder, "__annotations__", {}):  # of instances alone
        return path
    found = getattr(holder, name)
    if inspect.isclass(found) or (inspect.isroutine(found) and hasattr(found, "__qualname__")):
        return f"{found.__module__}.{found.__qualname__}"
    return path


def members(package: ModuleType) -> list[object]:
    return [getattr(package, name) for name in package.__all__]


@pytest.mark.pages
def test_every_public_name_is_in_the_api_reference(site: Path) -> None:
    pages = [links.Page.of(path.read_text("utf-8")) for path in (site / "api").glob("*.html")]
    anchors = set().union(*(page.anchors for page in pages))
    documented = {home(anchor) for anchor in anchors if anchor.startswith("microbot_ocp.")}
    packages = [microbot_ocp, microbot_ocp.limits, microbot_ocp.ocp]
    public = {
        f"{package.__name__}.{name}"
        for package in packages
        for name in package.__all__
        if not inspect.ismodule(getattr(package, name))
    }
    missing = {path for path in public if home(path) not in documented}
    assert not missing, f"place {sorted(missing)} on a page of docs/api"


@pytest.mark.pages
def test_references_of_docstrings_became_links(site: Path) -> None:
    for page in (site / "api").glob("*.html"):
        text = page.read_text("utf-8")
        for role in (":func:", ":class:", ":meth:", ":mod:", ":data:"):
            assert role not in text, page.name


# what the pages say -------------------------------------------------------------------------------


@pytest.mark.pages
@pytest.mark.parametrize("page", RUN, ids=lambda page: page.stem)
def test_the_code_of_a_page_runs_and_prints_what_it_says(page: Path, tmp_path: Path) -> None:
    assert blocks.run_page(page, tmp_path) > 0


README = [
    b for b in blocks.blocks((ROOT / "README.md").read_text("utf-8")) if b.language == "python"
]


@pytest.mark.pages
@pytest.mark.parametrize("block", README, ids=lambda block: f"line {block.line}")
def test_a_block_of_the_readme_runs_when_it_is_pasted_alone(
    block: blocks.Block, tmp_path: Path
) -> None:
    with blocks.working_in(tmp_path):
        blocks.run_block(block, ROOT / "README.md", {"__name__": "__main__"})


def test_the_page_of_functions_is_that_of_its_table() -> None:
    assert make_which_function.PAGE.read_text("utf-8") == make_which_function.page()
    assert make_which_function.PICTURE.read_text("utf-8") == make_which_function.svg()
    for calls in make_which_function.CALLS.values():
        for call in filter(None, calls):
            name = make_which_function.name(call)
            assert attrgetter(name.replace("robot.", "Robot."))(microbot_ocp), call


def test_the_readme_fits_a_screen_or_two() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").split()) <= 800


def test_the_readme_begins_with_commands_that_need_python_alone() -> None:
    first = re.search(r"```\w*\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.DOTALL)
    assert first
    commands = [line.split("#")[0].strip() for line in first[1].splitlines()]
    assert commands == ["make demo", "make test"]
    recipes = (ROOT / "Makefile").read_text("utf-8")
    assert all(re.search(rf"^{name.split()[1]}:", recipes, re.MULTILINE) for name in commands)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_extras_that_a_page_names_exist(page: Path) -> None:
    """In ``pip install`` with brackets, and in the README's table."""
    text = page.read_text("utf-8")
    named = re.findall(r"(?:\.|microbot_ocp|wheel)\[([a-z, ]+)\]", text)
    if table := re.search(r"\| extra \|.*?\n\n", text, re.DOTALL):
        cells = re.findall(r"^\|([^|]*)\|", table[0], re.MULTILINE)
        named += re.findall(r"`(\w+)`", " ".join(cells))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    split = {name.strip() for names in named for name in names.split(",")}
    assert split - set(project["optional-dependencies"]) == set()


def test_every_module_has_its_room_on_the_architecture_page() -> None:
    table = (DOCS / "architecture.md").read_text("utf-8")
    missing = [name for name in ORDER if not re.search(rf"^\|[^|]*`{name}/?`", table, re.MULTILINE)]
    assert not missing, f"place {missing} in docs/architecture.md"


def test_files_that_the_readme_links_to_exist() -> None:
    text = (ROOT / "README.md").read_text("utf-8")
    local = [link for link in re.findall(r"\]\(([^)#]+)[^)]*\)", text) if not links.outside(link)]
    assert local
    assert [link for link in local if not (ROOT / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_files_that_a_page_names_exist(page: Path) -> None:
    """Those in backticks that end in .py, .pyi or a slash, from the root or from the package."""
    named = re.findall(r"`([\w./-]+(?:\.pyi?|/))`", page.read_text("utf-8"))
    package = ROOT / "src" / "microbot_ocp"
    homes = [ROOT, DOCS, package, package / "ocp", package / "planning"]
    assert [name for name in named if not any((home / name).exists() for home in homes)] == []


@pytest.mark.pages
def test_the_import_diagram_is_that_of_the_source() -> None:
    drawn = make_import_diagram.svg(make_import_diagram.loaded())
    assert make_import_diagram.TARGET.read_text("utf-8") == drawn, "run docs/make_import_diagram.py"


# the tools themselves -----------------------------------------------------------------------------


def test_a_page_that_leads_nowhere_fails_the_build(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text("[nowhere](no_such_page.md)", "utf-8")
    (tmp_path / "mkdocs.yml").write_text("site_name: a site", "utf-8")
    done = build(tmp_path, tmp_path / "site")
    assert done.returncode != 0
    assert "no_such_page.md" in done.stderr


PAGE = """
```toml title="a.toml"
x = 1
```

```python
print(open("a.toml").read())
```

```text
{}
```

<!-- not run: there is no such module -->

```python
import no_such_module
```

1. In a list:

    ```python
    y = 2
    ```
"""


def test_blocks_share_a_folder_and_print_what_the_page_says(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE.format("x = ..."), "utf-8")
    assert blocks.run_page(page, tmp_path) == 2
    page.write_text(PAGE.format("x = 2"), "utf-8")
    with pytest.raises(blocks.Different, match="line 6"):
        blocks.run_page(page, tmp_path)


@pytest.mark.parametrize(
    ("printed", "page", "same"),
    [
        ("x = 0.124 m", "x = 0.123 m", True),
        ("x = 0.125 m", "x = 0.123 m", False),
        ("-4e-09 2.", "-3e-09 2.", True),
        ("-5e-09 2.", "-3e-09 2.", False),
        ("12 intervals", "11 intervals", False),
        ("0.1 0.2", "0.1", False),
    ],
)
def test_the_last_digit_of_a_page_may_differ_by_one(printed: str, page: str, same: bool) -> None:
    assert (blocks.rounded_alike(printed, page) == page) == same


@pytest.mark.parametrize(("command", "fails"), [("robots", False), ("show no_such_robot", True)])
def test_commands_of_a_page_are_run(tmp_path: Path, command: str, fails: bool) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"```console\n$ microbot-ocp {command}  # a remark\n```\n", "utf-8")
    with pytest.raises(blocks.Different, match="no_such") if fails else nullcontext():
        blocks.run_page(page, tmp_path)


@pytest.mark.parametrize(
    ("text", "loads", "link"),
    [
        ('<script src="https://a.org/x.js"></script>', 1, None),
        ('<link rel="stylesheet" href="https://a.org/x.css">', 1, None),
        ('<link rel="canonical" href="https://a.org/">', 0, None),
        ('<p style="background: url(https://a.org/x.png)">', 1, None),
        ("<style>@import 'https://a.org/x.css';</style>", 1, None),
        ('<a href="https://a.org/">a</a>', 0, None),
        ('<a href="other.html">a</a>', 0, "page.html: other.html"),
        ('<a href="#there">a</a>', 0, "page.html: #there"),
        ('<a href="page.html#here">a</a><p id="here">', 0, None),
        ('<img src="no.png">', 0, "page.html: no.png"),
    ],
)
def test_the_link_checker_itself(tmp_path: Path, text: str, loads: int, link: str | None) -> None:
    (tmp_path / "page.html").write_text(text, "utf-8")
    assert len(links.loaded_from_elsewhere(tmp_path)) == loads
    assert links.broken(tmp_path) == ([link] if link else [])


@pytest.mark.parametrize(
    ("address", "good"),
    [
        ("https://web.casadi.org/docs/", True),
        ("http://web.casadi.org", False),
        ("https://casadi", False),
        ("https://a.org/a b", False),
    ],
)
def test_the_check_of_addresses_itself(address: str, good: bool) -> None:
    assert links.malformed({address: {"page.html"}}) == ([] if good else [address])


def test_notebooks_open_in_colab_where_the_repository_has_an_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = (DOCS / colab.PAGE).read_text("utf-8")
    page = SimpleNamespace(file=SimpleNamespace(src_uri=colab.PAGE))
    monkeypatch.delenv("MICROBOT_OCP_REPOSITORY", raising=False)
    assert colab.on_page_markdown(text, page) == text
    monkeypatch.setenv("MICROBOT_OCP_REPOSITORY", "somebody/arms")
    linked = re.findall(
        r"/github/somebody/arms/blob/main/(\S+?)\)", colab.on_page_markdown(text, page)
    )
    assert linked == [f"notebooks/{p.name}" for p in sorted((ROOT / "notebooks").glob("*.ipynb"))]
    assert all((ROOT / path).is_file() for path in linked)


def test_formulas_become_mathml() -> None:
    page = r'<p>a <span class="arithmatex">\(x &lt; \dot q\)</span></p>'
    made = formulas.on_page_content(page)
    assert "<math" in made
    assert "arithmatex" not in made
    assert r'aria-label="x &lt; \dot q"' in made


@pytest.mark.parametrize("tex", [r"\nosuchcommand x", r"\begin{aligned} a & b \end{aligned}"])
def test_tex_that_is_not_known_is_an_error(tex: str) -> None:
    with pytest.raises(formulas.UnknownCommand):
        formulas.mathml(tex, block=True)
