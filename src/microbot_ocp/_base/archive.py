"""Archives of arrays, of motions and solutions: numpy's ``.npz`` with a JSON object ``metadata``.

Comparisons and sweeps are JSON documents. The readers do not trust a file: each member of an
archive must be a plain array of numbers, and its size in memory is tested before it is read.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base.argument_types import fits
from microbot_ocp._base.checks import InputError, shown
from microbot_ocp._base.reading import content_of
from microbot_ocp._base.writing import digest_of_document, write_whole

MOST_BYTES = 2_000_000_000  # largest size of all arrays of a file together
MOST_MEMBERS = 10_000
METADATA = "metadata"
DIGEST = "digest"  # digest of all other members; files of earlier versions have none
TEXTS = (METADATA, DIGEST, "joint_names")


def write_archive(
    path: str | Path, arrays: Mapping[str, Any], metadata: Mapping[str, Any], label: str
) -> Path:
    """Write an archive, whole or not at all; ``label`` names the user's metadata in a message.

    Raises
    ------
    InputError
        The metadata are no plain JSON values.
    """
    try:
        text = json.dumps(metadata)
    except (TypeError, ValueError, RecursionError) as problem:
        raise InputError(f"{label} must hold plain JSON values: {problem}") from None
    content: dict[str, Any] = {
        **{key: np.asarray(value) for key, value in arrays.items()},
        METADATA: np.array(text),
    }
    stream = io.BytesIO()
    content[DIGEST] = np.array(_digest(content))
    np.savez_compressed(stream, **content)
    return write_whole(path, stream.getvalue())


def read_archive(
    path: str | Path, label: str, newest: int
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return arrays and metadata of a file that :func:`write_archive` wrote.

    Parameters
    ----------
    path : path
    label : str
        Expected content, such as "motion".
    newest : int
        Newest readable ``schema`` of the metadata.

    Raises
    ------
    InputError
        The file is missing, not an archive, damaged, too large, or written by a newer version.
    """
    if not os.path.isfile(path):  # False for an impossible file name, too
        raise InputError(f"{path} is no file: give the path of a saved {label} (.npz)")
    try:
        arrays = arrays_in(Path(path))
        digest = str(arrays.pop(DIGEST, ""))
        changed = bool(digest) and digest != _digest(arrays)
        metadata = json.loads(str(arrays.pop(METADATA)))
        schema = metadata["schema"]
        if type(schema) is not int or schema < 1:
            raise ValueError("schema must be a whole number above 0")
    except Exception as problem:  # zipfile, zlib, ast and numpy raise many kinds of errors
        raise no_archive(path, label, problem) from None
    if schema > newest:
        raise InputError(
            f"{path} was written by a newer version (schema {shown(schema)}; "
            f"this one reads up to {newest})"
        )
    if changed:
        raise no_archive(path, label, ValueError("it was changed after it was saved"))
    return arrays, metadata


def no_archive(path: str | Path, label: str, problem: Exception) -> InputError:
    """Return the error for a file that is no saved ``label``."""
    # An OSError's text without the file's name.
    message = getattr(problem, "strerror", None) or str(problem)
    sentence = repr(problem) if isinstance(problem, KeyError) else message
    reason = " ".join(sentence.split()) or type(problem).__name__
    return InputError(f"{path} is not a saved {label}: {reason}")


def read_document(
    path: str | Path, label: str, kinds: Mapping[str, Any], seal: str = DIGEST
) -> dict[str, Any]:
    """Return a JSON document whose values under the keys of ``kinds`` have the given types.

    The key ``seal`` holds a digest of all other keys.

    Raises
    ------
    InputError
        The file is missing, no such document, damaged, or changed after it was saved.
    """
    try:
        document = json.loads(content_of(path))
        for key, kind in kinds.items():
            if not fits(document[key], kind):
                raise ValueError(f"its {key} is {shown(document[key])}")
        if document.get(seal) not in (None, digest_of_document(document, seal)):
            raise ValueError("it was changed after it was saved")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as problem:
        raise no_archive(path, label, problem) from None
    return document


def arrays_in(path: Path, wanted: Collection[str] | None = None) -> dict[str, np.ndarray]:
    """Return the plain arrays of a file, all or the wanted ones; damage raises various errors."""
    # The directory of the file has the sizes before anything is decompressed.
    with zipfile.ZipFile(path) as stored:
        names = stored.namelist()
        size = sum(member.file_size for member in stored.infolist())
    if size > MOST_BYTES or len(names) > MOST_MEMBERS:
        raise ValueError(f"it would take {size:.3g} bytes, {MOST_BYTES:,} are allowed")
    if len(set(names)) < len(names):
        raise ValueError("a name is there twice")
    with np.load(path, allow_pickle=False) as loaded:
        arrays = {name: loaded[name] for name in loaded.files if not wanted or name in wanted}
    for name, array in arrays.items():
        if array.dtype.kind not in ("U" if name in TEXTS else "biuf"):
            raise ValueError(f"{name} holds {array.dtype}, not numbers")
    return {name: array.astype(array.dtype.newbyteorder("=")) for name, array in arrays.items()}


def _digest(arrays: Mapping[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        digest.update(f"{name} {array.dtype.str} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
