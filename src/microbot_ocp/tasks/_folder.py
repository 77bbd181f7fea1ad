"""Folder of a saved comparison: files of one run with their digests in ``comparison.json``."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.reading import content_of
from microbot_ocp._base.system import locked
from microbot_ocp._base.writing import NotWritten, digest, digest_of_document, sync

INDEX = "comparison.json"
NAME = re.compile(r"\w[\w .+-]{0,99}", re.ASCII)  # method names, which are also file names
_LISTED = re.compile(rf"(motions/)?{NAME.pattern}", re.ASCII)


def swap_in(staged: Path, target: Path, index: bool, motions: bool) -> list[Path]:
    """Move a run's files from one folder into another, ``comparison.json`` last.

    Until ``comparison.json`` is in place, :func:`check_run` refuses the folder. Files of the
    earlier run that the new run does not have are removed, unless they were changed.

    Parameters
    ----------
    staged : Path
        Source folder on the disk of ``target``, always with ``comparison.json`` and the motions.
    target : Path
        Destination folder.
    index, motions : bool
        True to move ``comparison.json`` and the motions, too. An existing ``comparison.json`` of
        the run is updated in any case.

    Returns
    -------
    list of Path
        Moved files, in the destination folder.

    Raises
    ------
    NotWritten
        A file cannot be moved.
    """
    document = json.loads((staged / INDEX).read_text("utf-8"))
    files = sorted(p for p in staged.rglob("*") if p.is_file() and p != staged / INDEX)
    digests = {path.relative_to(staged).as_posix(): digest(path) for path in files}
    new = [name for name in digests if motions or not name.startswith("motions/")]
    with locked(target):
        old = _read(target / INDEX)
        same = _without_files(old) == _without_files(document)
        earlier = _listed(old)
        listed = {
            n: value for n, value in digests.items() if n in new or _has_digest(target / n, value)
        }
        document["files"] = {**earlier, **listed} if same else listed
        document["digest"] = digest_of_document(document, "digest")
        text = json.dumps(document, indent=2, ensure_ascii=False)
        (staged / INDEX).write_text(text + "\n", "utf-8")
        sync(staged / INDEX)
        for name in new:
            _move(staged / name, target / name)
        if index or same:
            # The index is moved last and after a sync, so that it never lists missing files.
            for folder in (target / "motions", target):
                if folder.is_dir():
                    sync(folder)
            _move(staged / INDEX, target / INDEX)
        if index and not same:
            for name in earlier.keys() - listed:
                if _has_digest(target / name, earlier[name]):
                    (target / name).unlink(missing_ok=True)
        sync(target)
    return [target / name for name in (*new, *([INDEX] if index else []))]


def _move(staged: Path, place: Path) -> None:
    try:
        place.parent.mkdir(exist_ok=True)
        os.replace(staged, place)
    except OSError as problem:
        raise NotWritten(place, problem.strerror or str(problem)) from None


def check_run(folder: Path, document: Mapping[str, Any]) -> None:
    """Reject a folder whose files differ from the list in its ``comparison.json``.

    Raises
    ------
    InputError
        A file is damaged, missing or from another run.
    """
    listed = document.get("files", {})
    if not isinstance(listed, Mapping) or not all(map(_LISTED.fullmatch, listed)):
        raise InputError(f"{folder / INDEX} lists files that no comparison has: {shown(listed)}")
    for name, value in listed.items():
        path = folder / name
        if path.is_file() and digest(path) != value:
            raise InputError(
                f"{path} is damaged or from another run than {INDEX}: save the comparison again"
            )
        if not path.is_file() and name.startswith("motions/"):
            raise InputError(f"{path} is missing: save the comparison again")
    for row in document["entries"]:
        path = folder / "motions" / f"{row['name']}.npz"
        if path.exists() and f"motions/{row['name']}.npz" not in listed:
            raise InputError(f"{path} is from another run than {INDEX}: save the comparison again")


def _without_files(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document without its list of files and its digest."""
    return {key: value for key, value in document.items() if key not in ("files", "digest")}


def _read(path: Path) -> dict[str, Any]:
    """Read a document; return an empty one if the file is missing or damaged."""
    with contextlib.suppress(OSError, ValueError, RecursionError):
        document = json.loads(content_of(path))
        return document if isinstance(document, dict) else {}
    return {}


def _listed(document: Mapping[str, Any]) -> dict[str, str]:
    files = document.get("files")
    listed = files.items() if isinstance(files, Mapping) else ()
    return {name: str(value) for name, value in listed if _LISTED.fullmatch(name)}


def _has_digest(path: Path, value: str) -> bool:
    with contextlib.suppress(OSError):
        return digest(path) == value
    return False
