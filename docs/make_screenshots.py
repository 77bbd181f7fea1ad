"""Make every kind of recording and its picture: ``docs/images/recordings/NAME.png``.

    python docs/make_screenshots.py [NAME ...] [--keep FOLDER]

It needs a Vulkan driver; without a graphics card that of the package mesa-vulkan-drivers, or
Chromium's, named by VK_ICD_FILENAMES=/usr/lib/chromium/vk_swiftshader_icd.json with its
libvulkan.so.1 on LD_LIBRARY_PATH.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from PIL import Image

from tools import palette

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "views" / "recording"))

from every_kind import KINDS
from headless_viewer import HeadlessViewer, missing_driver

TARGET = Path(__file__).resolve().parent / "images" / "recordings"
COLORS = 192  # of a picture's palette: a third of the size of a full one
# picture -> kind of recording, number of the moment at which it is drawn
PICTURES = {name: (name, 1) for name in KINDS} | {
    "comparison_progress": ("comparison", 2),
    "iterations_early": ("iterations", 1),
    "iterations": ("iterations", 2),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(KINDS))
    parser.add_argument("--keep", type=Path, help="folder to keep the recordings in")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(KINDS))
    if unknown:
        parser.error(f"NAME must be one of {', '.join(KINDS)}, not {unknown[0]!r}")
    reason = missing_driver()
    if reason:
        print(f"error: {reason}", file=sys.stderr)
        return 1
    TARGET.mkdir(parents=True, exist_ok=True)
    problems = []
    with tempfile.TemporaryDirectory() as folder:
        kept = arguments.keep or Path(folder)
        kept.mkdir(parents=True, exist_ok=True)
        for name in arguments.names or KINDS:
            kind = KINDS[name]
            recording = kind.make().save(kept / f"{name}.rrd")
            size = recording.stat().st_size / 1e6
            with HeadlessViewer() as viewer:
                viewer.open(recording)
                for drawn, number in _pictures(name):
                    moment = kind.moments[number]
                    viewer.seek(moment.timeline, **moment.as_argument())
                    path = TARGET / f"{drawn}.png"
                    palette.save(Image.fromarray(viewer.picture()), path, COLORS)
                    print(f"{path} ({path.stat().st_size / 1e3:.0f} kB; recording {size:.2f} MB)")
                problems += [f"{name}: {problem}" for problem in viewer.problems()]
    for problem in problems:
        print(f"error: {problem}", file=sys.stderr)
    return 1 if problems else 0


def _pictures(kind: str) -> list[tuple[str, int]]:
    """Return name and number of the moment of every picture of a kind."""
    return [(name, number) for name, (shown, number) in PICTURES.items() if shown == kind]


if __name__ == "__main__":
    sys.exit(main())
