"""The one reader of files: no pipe, which may never end, no device, nothing huge."""

from __future__ import annotations

import errno
import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError

MOST_BYTES = 500_000_000  # that are taken into memory at once
DEEPEST = 200  # elements or tables in each other; a robot file has about six


def opened(path: str | Path) -> BufferedReader:
    """Return a plain file, open.

    Raises
    ------
    OSError
        With ``strerror`` set, also where it is something else than a file.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    stream = open(handle, "rb")  # noqa: SIM115
    try:
        mode = os.fstat(handle).st_mode
        if not stat.S_ISREG(mode):
            what = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device"
            raise OSError(errno.EINVAL, f"it is {what}", str(path))
    except BaseException:
        stream.close()
        raise
    return stream


def content_of(path: str | Path) -> bytes:
    """Return the bytes of a plain file.

    Raises
    ------
    OSError
        As :func:`opened`, and for more than :data:`MOST_BYTES`.
    """
    with opened(path) as stream:
        large = os.fstat(stream.fileno()).st_size > MOST_BYTES
        content = b"" if large else stream.read(MOST_BYTES + 1)  # files of /proc tell no size
    if large or len(content) > MOST_BYTES:
        raise OSError(errno.EFBIG, f"it has more than {MOST_BYTES:,} bytes", str(path))
    return content


def bytes_of(path: str | Path, what: str) -> bytes:
    """Return the bytes of a plain file; ``what`` it is, such as "task file", begins the message.

    Raises
    ------
    InputError
    """
    try:
        return content_of(path)
    except (OSError, ValueError) as problem:  # a NUL character in the path
        reason = getattr(problem, "strerror", None) or problem
        raise InputError(f"{what} {str(path)!r} cannot be read: {reason}") from None


def yaml_of(path: str | Path, what: str) -> Any:
    """Return what a YAML file holds; needs PyYAML, of the extra ``export``.

    Raises
    ------
    InputError
    """
    text = text_of(path, what)
    try:
        import yaml
    except ImportError:
        raise InputError("a YAML file needs PyYAML: pip install 'microbot_ocp[export]'") from None
    try:
        return yaml.load(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except (yaml.YAMLError, ValueError, RecursionError) as problem:
        raise InputError(f"it is no YAML: {' '.join(str(problem).split())}") from None


def text_of(path: str | Path, what: str) -> str:
    """Give the text of a plain file, as :func:`bytes_of`; editors may put a byte order mark first.

    Raises
    ------
    InputError
    """
    try:
        return bytes_of(path, what).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{what} {str(path)!r} cannot be read: it is not text") from None
