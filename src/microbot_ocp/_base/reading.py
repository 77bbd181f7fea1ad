"""The one reader of files, which refuses pipes (they may never end), devices and huge files."""

from __future__ import annotations

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError
from microbot_ocp._base.needed import needed

MOST_BYTES = 500_000_000  # largest file that is read into memory
DEEPEST = 200  # deepest nesting of elements or tables; a robot file has about six


def opened(path: str | Path) -> BufferedReader:
    """Return a regular file, open for reading.

    Raises
    ------
    OSError
        The path is not readable or no regular file; ``strerror`` is set.
    """
    mode = os.stat(path).st_mode
    if not stat.S_ISREG(mode):
        kind = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
        raise OSError(errno.EINVAL, f"it is {kind}", str(path))
    return open(path, "rb")


def content_of(path: str | Path) -> bytes:
    """Return the bytes of a regular file.

    Raises
    ------
    OSError
        Errors of :func:`opened`; the file has more than :data:`MOST_BYTES`.
    """
    with opened(path) as stream:
        large = os.fstat(stream.fileno()).st_size > MOST_BYTES
        content = b"" if large else stream.read(MOST_BYTES + 1)  # files in /proc report no size
    if large or len(content) > MOST_BYTES:
        raise OSError(errno.EFBIG, f"it has more than {MOST_BYTES:,} bytes", str(path))
    return content


def bytes_of(path: str | Path, label: str) -> bytes:
    """Return the bytes of a regular file; ``label``, such as "task file", names it in messages.

    Raises
    ------
    InputError
    """
    try:
        return content_of(path)
    except (OSError, ValueError) as problem:  # ValueError: a NUL character in the path
        reason = getattr(problem, "strerror", None) or problem
        raise InputError(f"{label} {str(path)!r} cannot be read: {reason}") from None


def yaml_of(path: str | Path, label: str) -> Any:
    """Return the content of a YAML file; needs PyYAML, of the extra ``export``.

    Raises
    ------
    InputError
    """
    text = text_of(path, label)
    yaml = needed("yaml", "a YAML file needs PyYAML, the package", "export")
    try:
        return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, ValueError, RecursionError) as problem:
        raise InputError(f"it is no YAML: {' '.join(str(problem).split())}") from None


def text_of(path: str | Path, label: str) -> str:
    """Return the text of a file as :func:`bytes_of`, without the byte order mark of some editors.

    Raises
    ------
    InputError
    """
    try:
        return bytes_of(path, label).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{label} {str(path)!r} cannot be read: it is not text") from None
