"""Run ``docs/gallery.md`` and keep its pictures: ``docs/images/gallery``.

python docs/make_gallery.py
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from tools import palette

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS / "tools"))

from blocks import run_page  # noqa: E402

TARGET = DOCS / "images" / "gallery"
WIDTH, COLORS = 1000, 256  # pixels, of the palette


def main() -> int:
    TARGET.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        run_page(DOCS / "gallery.md", Path(folder))
        for written in sorted(Path(folder).glob("*.png")):
            with Image.open(written) as picture:
                height = round(picture.height * WIDTH / picture.width)
                small = picture.convert("RGB").resize((WIDTH, height), Image.Resampling.LANCZOS)
            path = TARGET / written.name
            palette.save(small, path, COLORS)
            print(f"{path} ({path.stat().st_size / 1e3:.0f} kB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
