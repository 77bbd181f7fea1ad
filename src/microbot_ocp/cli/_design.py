"""``design``: where to mount an arm, how to turn its tool, where to put stops."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import microbot_ocp as mo
from microbot_ocp._base.checks import InputError
from microbot_ocp.cli._declaration import FILE, REQUIRED, Kind, command
from microbot_ocp.cli._report import Answer, Progress
from microbot_ocp.layout import DesignSettings

QUANTITIES = Kind(
    metavar="NAMES",
    name="free",
    text="Free quantities, each with bounds in m or rad if wanted: base.x=-0.2:0.2,base.yaw.",
    default=REQUIRED,
    words="names, each with =LOWER:UPPER if wanted",
)


@command(writes=("",), solves=True)
def design(
    file: Annotated[Path, FILE],
    free: Annotated[str, QUANTITIES],
    progress: Progress,
    solves: int = DesignSettings.solves,
) -> Answer:
    """Find the layout of a cell with the least period.

    Free are base.x, base.y, base.z, base.yaw, tool.yaw, stops.NAME.x (y, z, yaw) and the factors
    "gear ratio.JOINT". The result is never slower than the given cell. Exit code 1 if the motion is
    not certified.

    Parameters
    ----------
    file : FILE
        Task of stops in TOML (docs/task_file.md has the keys).
    solves : N
        Whole solves at most.
    out : FOLDER
        Folder for the cell with the new numbers, the map, and recordings of before and after.

    Examples
    --------
    $ microbot-ocp design cell.toml --free base.x,base.y --out out
    """
    names, bounds = _parsed(free)
    settings = DesignSettings(solves=solves)
    found = mo.design(None, file, names, bounds, settings=settings, progress=progress)

    def save(folder: Path) -> list[Path]:
        folder.mkdir(parents=True, exist_ok=True)
        cell, picture = found.save(folder / file.name), found.plot().savefig(folder / "map.png")
        return [cell, picture, *found.to_rerun(folder)]

    certified = found.after.certificate.ok
    return Answer(found.as_dict(), [found.table()], certified=certified, save=save)


def _parsed(words: str) -> tuple[list[str], dict[str, tuple[float, float]]]:
    """Return names and bounds out of ``base.x=-0.2:0.2,base.y``."""
    names, bounds = [], {}
    for word in words.split(","):
        name, equals, ends = (part.strip() for part in word.partition("="))
        names.append(name)
        if equals:
            try:
                low, high = map(float, ends.split(":"))
            except ValueError:
                raise InputError(
                    f"bounds of {name} in --free must be LOWER:UPPER, not {ends!r}"
                ) from None
            bounds[name] = (low, high)
    return names, bounds
