"""Links that open the notebooks in Colab, in a site whose repository has an address.

A hook of MkDocs. The workflow sets ``MICROBOT_OCP_REPOSITORY`` to OWNER/NAME; without it, as in a
site that is opened from the disk, there are no links.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
PAGE = "exercises.md"


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Add the links below the page's first paragraph."""
    repository = os.environ.get("MICROBOT_OCP_REPOSITORY")
    if page.file.src_uri != PAGE or not repository:
        return markdown
    address = f"https://colab.research.google.com/github/{repository}/blob/main/notebooks"
    shown = ", ".join(
        f"[{p.stem[:2]}]({address}/{p.name})" for p in sorted(NOTEBOOKS.glob("*.ipynb"))
    )
    first = "begin with a cell `%pip install 'microbot_ocp[notebook]'`"
    title, paragraph, rest = markdown.split("\n\n", 2)
    return "\n\n".join([title, paragraph, f"Open in Colab: {shown}; {first}.", rest])
