"""Run every notebook and draw it as a reader sees it, whole, into ``docs/images/notebooks``.

A widget cannot live in a picture: its own picture stands in its place. Needs the extra ``notebook``
and Chromium.

    python docs/make_notebook_pictures.py [01 04]
"""

from __future__ import annotations

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

sys.path.insert(0, str(Path(__file__).resolve().parent / "tools"))

from formulas import mathml

DOCS = Path(__file__).resolve().parent
NOTEBOOKS = DOCS.parent / "notebooks"
TARGET = DOCS / "images" / "notebooks"
WIDGET = "application/vnd.jupyter.widget-view+json"
VIEWER = "<p><em>Here stands the Rerun viewer, in a notebook that runs.</em></p>"
FORMULA = re.compile(r"\$\$(?P<block>.+?)\$\$|(?<!\\)\$(?P<inline>[^$]+?)\$", re.DOTALL)
WIDTH, HEIGHT = 1000, 9000  # pixels; what is not used is cut off
COLORS = 256


def run(path: Path) -> NotebookNode:
    """The notebook with its outputs; formulas as MathML, widgets as pictures."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "problems").symlink_to(DOCS.parent / "problems")
        work = Path(folder) / "notebooks"
        work.mkdir()
        resources = {"metadata": {"path": str(work)}}
        NotebookClient(notebook, timeout=300, kernel_name="python3", resources=resources).execute()
    notebook.metadata.pop("widgets", None)
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            cell.source = FORMULA.sub(_formula, cell.source)
        else:
            cell.outputs = [out for out in map(_still, cell.outputs) if out is not None]
    return notebook


def _formula(found: re.Match[str]) -> str:
    block = found["block"] is not None
    element = mathml((found["block"] or found["inline"]).strip(), block=block)
    return f'\n<div style="text-align:center">{element}</div>\n' if block else element


def _still(output: NotebookNode) -> NotebookNode | None:
    """An output without widgets; None where nothing is left."""
    data = output.get("data", {})
    if WIDGET not in data:
        return output
    del data[WIDGET]
    if "image/png" not in data:
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
    kept.quantize(COLORS, Image.Quantize.MAXCOVERAGE).save(target, optimize=True)


def main() -> None:
    wanted = sys.argv[1:]
    TARGET.mkdir(parents=True, exist_ok=True)
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        number = path.stem[:2]
        if wanted and number not in wanted:
            continue
        with tempfile.TemporaryDirectory() as folder:
            page = Path(folder) / "page.html"
            page.write_text(html(run(path)), "utf-8")
            picture(page, TARGET / f"{number}.png")
        print(TARGET / f"{number}.png")


if __name__ == "__main__":
    main()
