"""Files of motions: numpy's ``.npz`` with the arrays and a JSON string ``metadata``."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from microbot_ocp._base.checks import FloatArray, InputError
from microbot_ocp._base.writing import write_whole

SCHEMA = 1
ARRAYS = ("t", "q", "qd", "qdd", "tau", "breaks")
# zipfile, zlib, tokenize and numpy raise a dozen kinds on what is damaged or something else.
_BROKEN = Exception


def write(path: Path, arrays: Mapping[str, FloatArray], metadata: Mapping[str, Any]) -> Path:
    """Write the file, whole or not at all."""
    try:
        text = json.dumps({"schema": SCHEMA, **metadata})
    except TypeError as problem:
        raise InputError(f"provenance must hold plain JSON values: {problem}") from None
    contents: dict[str, Any] = {**arrays, "metadata": text}
    stream = io.BytesIO()
    np.savez_compressed(stream, **contents)
    return write_whole(path, stream.getvalue())


def read(path: Path) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Arrays and metadata of a file that :func:`write` wrote.

    Raises
    ------
    InputError
        No such file, not a motion, or written by a newer version.
    """
    if not os.path.isfile(path):  # False of what cannot be a name of a file, too
        raise InputError(f"{path} is no file: give the path of a saved motion (.npz)")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in ARRAYS}
            metadata = json.loads(str(stored["metadata"]))
        schema = int(metadata["schema"])
    except _BROKEN as problem:
        raise InputError(f"{path} is not a saved motion: {problem}") from None
    if schema > SCHEMA:
        raise InputError(
            f"{path} was written by a newer version (schema {schema}; this one reads up to "
            f"{SCHEMA})"
        )
    return arrays, metadata
