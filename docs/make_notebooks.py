"""Run every notebook and keep what it shows in it; draw the fourth into ``docs/images/notebooks``.

A widget cannot live in a file: its own picture stands in its place. Needs the extra ``notebook``
and Chromium.

    python docs/make_notebooks.py [01 04]
"""

from __future__ import annotations

import base64
import copy
import io
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import nbformat
import numpy as np
from nbclient import NotebookClient
from nbconvert import HTMLExporter
from nbformat import NotebookNode
from PIL import Image

from tools import palette

sys.path.insert(0, str(Path(__file__).resolve().parent / "tools"))

from formulas import mathml

DOCS = Path(__file__).resolve().parent
NOTEBOOKS = DOCS.parent / "notebooks"
TARGET = DOCS / "images" / "notebooks"
WIDGET = "application/vnd.jupyter.widget-view+json"
VIEWER = "<p><em>Here stands the Rerun viewer, in a notebook that runs.</em></p>"
FORMULA = re.compile(r"\$\$(?P<block>.+?)\$\$|(?<!\\)\$(?P<inline>[^$]+?)\$", re.DOTALL)
WIDTH, HEIGHT = 1000, 9000  # pixels; what is not used is cut off
COLORS, STORED_COLORS = 256, 64
DRAWN = "04"


def run(path: Path) -> NotebookNode:
    """The notebook with its outputs, widgets as pictures, pictures with few colours."""
    notebook = nbformat.read(path, as_version=4)
    metadata = copy.deepcopy(notebook.metadata)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "problems").symlink_to(DOCS.parent / "problems")
        work = Path(folder) / "notebooks"
        work.mkdir()
        options = {"kernel_name": "python3", "record_timing": False, "timeout": 300}
        resources = {"metadata": {"path": str(work)}}
        NotebookClient(notebook, resources=resources, **options).execute()
    notebook.metadata = metadata
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs = [out for out in map(_still, cell.outputs) if out is not None]
    return notebook


def with_formulas(notebook: NotebookNode) -> NotebookNode:
    """A copy whose formulas are MathML."""
    shown = copy.deepcopy(notebook)
    for cell in shown.cells:
        if cell.cell_type == "markdown":
            cell.source = FORMULA.sub(_formula, cell.source)
    return shown


def _formula(found: re.Match[str]) -> str:
    block = found["block"] is not None
    element = mathml((found["block"] or found["inline"]).strip(), block=block)
    return f'\n<div style="text-align:center">{element}</div>\n' if block else element


def _still(output: NotebookNode) -> NotebookNode | None:
    """An output without widgets; None where nothing is left."""
    data = output.get("data", {})
    is_widget = data.pop(WIDGET, None) is not None
    if "image/png" in data:
        image = Image.open(io.BytesIO(base64.b64decode(data["image/png"]))).convert("RGB")
        small = io.BytesIO()
        palette.save(image, small, STORED_COLORS)
        data["image/png"] = base64.b64encode(small.getvalue()).decode()
    elif is_widget:
        if not str(data.get("text/plain", "")).startswith("VBox"):
            return None
        data["text/html"] = VIEWER
    return output


def html(notebook: NotebookNode) -> str:
    """The page as a notebook server shows it, with nothing to fetch."""
    exporter = HTMLExporter(exclude_input_prompt=True, exclude_output_prompt=True)
    exporter.require_js_url = exporter.mathjax_url = exporter.jquery_url = ""
    return exporter.from_notebook_node(notebook)[0]


def picture(page: Path, target: Path) -> None:
    """Screenshot of a page, cut to its height, with few colours."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        sys.exit("error: chromium is needed to draw the notebooks")
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        command = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        command += ["--disable-background-networking", f"--user-data-dir={folder}/profile"]
        command += [f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={shot}", page.as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=120)
        image = Image.open(io.BytesIO(shot.read_bytes())).convert("RGB")
    pixels = np.asarray(image)
    used = np.flatnonzero((pixels != pixels[-1, -1]).any(axis=(1, 2)))
    kept = image.crop((0, 0, image.width, min(image.height, int(used[-1]) + 30)))
    palette.save(kept, target, COLORS)


def main() -> None:
    wanted = sys.argv[1:]
    TARGET.mkdir(parents=True, exist_ok=True)
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        number = path.stem[:2]
        if wanted and number not in wanted:
            continue
        notebook = run(path)
        nbformat.write(notebook, path)
        print(f"{path} ({path.stat().st_size / 1e3:.0f} kB)")
        if number == DRAWN:
            with tempfile.TemporaryDirectory() as folder:
                page = Path(folder) / "page.html"
                page.write_text(html(with_formulas(notebook)), "utf-8")
                picture(page, TARGET / f"{number}.png")


if __name__ == "__main__":
    main()
