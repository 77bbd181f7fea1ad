"""Pictures with few colours."""

from __future__ import annotations

from pathlib import Path
from typing import IO

from PIL import Image


def save(picture: Image.Image, target: Path | IO[bytes], colors: int) -> None:
    """Save as PNG with so many colours: of thin curves, too, none takes another's."""
    few = picture.quantize(colors, Image.Quantize.MAXCOVERAGE, kmeans=5)
    few.save(target, "PNG", optimize=True)
