"""The one writer of files: each is whole or absent, even if the process dies or the disk is full.

A file is written under a temporary name in its folder, flushed to the disk and renamed.
Temporary names are hidden, differ between writers, and end in ``.part``; the next writer in the
folder removes those of killed processes, except on Windows.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import re
import secrets
import shutil
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from microbot_ocp._base.checks import InputError, sentence
from microbot_ocp._base.reading import opened
from microbot_ocp._base.system import alive

# The name is .NAME.HOST.PID.RANDOM.microbot.part: at most 200 bytes; file systems allow 255.
_LEFTOVER = re.compile(r"\..*\.(?P<host>[\w-]+)\.(?P<pid>\d+)\.[0-9a-f]{12}\.microbot\.part")
_DIRECT = re.compile(r"/dev/(stdout|stderr|fd/.*)|/proc/.*")
_open: set[str] = set()  # temporary paths in use by this process


FILES = (  # file name suffixes, which no folder has
    *(".csv", ".json", ".mat", ".npz", ".parquet", ".toml", ".txt", ".xlsx", ".xml", ".yaml"),
    *(".gif", ".html", ".jpg", ".mp4", ".pdf", ".png", ".rrd", ".svg", ".tex"),
)


class NotWritten(OSError, InputError):
    """A file could not be written; the message has its path and the reason."""

    def __init__(self, path: str | Path, reason: str) -> None:
        super().__init__(sentence(f"{path} was not written: {reason}"))
        self.path, self.reason = str(path), sentence(reason)


@contextlib.contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path to write to, which replaces ``path`` when the block ends.

    The target of a symbolic link is replaced, the link stays. Devices and pipes are written
    directly. The file gets the permissions of a new file.

    Raises
    ------
    NotWritten
        The file, its folder or the disk does not permit writing. An old file at ``path`` is
        unchanged, and no temporary file is left.
    """
    target = check_writable(path)
    with _explained(path):
        if _is_direct(path):
            yield target
            return
        with temporary_path(target) as partial:
            yield partial
            sync(partial)
            os.replace(partial, target)
        sync(target.parent)


def check_writable(path: str | Path) -> Path:
    """Return the target of ``path``, links followed; raise NotWritten if it is not writable."""
    with _explained(path):
        if _is_direct(path):
            return Path(path)
        target = Path(os.path.realpath(path))
        if target.is_dir():
            raise NotWritten(path, "it is a folder")
        if not target.parent.is_dir():
            raise NotWritten(path, "its folder does not exist")
        if not os.access(target if target.exists() else target.parent, os.W_OK):
            raise NotWritten(path, "permission denied")
        return target


def made_folder(path: str | Path) -> Path:
    """Return a folder, created with its parents if necessary.

    Raises
    ------
    NotWritten
        The folder cannot be created.
    InputError
        The path has the suffix of a file.
    """
    if Path(path).suffix.lower() in FILES and not Path(path).exists():
        advice = "a figure is written by plot().savefig(path)"
        raise InputError(f"{str(path)!r} must be a folder, not a file; {advice}")
    with _explained(path):
        Path(path).mkdir(parents=True, exist_ok=True)
    return Path(path)


def write_whole(path: str | Path, content: str | bytes) -> Path:
    """Write text (UTF-8, line ends unchanged) or bytes by :func:`whole_file`; return the path.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_whole(f"{folder}/a.txt", "text").read_text()
    'text'
    """
    with whole_file(path) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)
    return Path(path)


@contextlib.contextmanager
def temporary_path(target: Path) -> Iterator[Path]:
    """Yield a new path beside ``target``; it is removed when the block ends."""
    remove_leftovers(target.parent)
    shown = os.fsencode(target.name)[:80].decode(errors="ignore")
    label = f".{shown}.{_host()}.{os.getpid()}.{secrets.token_hex(6)}.microbot.part"
    partial = target.parent / label
    _open.add(str(partial))
    try:
        yield partial
    finally:
        _remove(partial)
        _open.discard(str(partial))


def remove_leftovers(folder: Path) -> None:
    """Remove the temporary files of killed writers of this machine from a folder."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            leftover = _LEFTOVER.fullmatch(entry.name)
            if leftover is None or leftover["host"] != _host() or entry.path in _open:
                continue
            pid = int(leftover["pid"])
            if pid == os.getpid() or not alive(pid):
                _remove(Path(entry.path))


def abandon() -> None:
    """Remove every temporary file before the process ends."""
    for path in list(_open):
        _remove(Path(path))


def sync(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    # Some file systems cannot flush folders.
    with contextlib.suppress(OSError) if path.is_dir() else contextlib.nullcontext():
        _fsync(path)


def digest(path: Path) -> str:
    """Return the SHA-256 of a file's content, in hexadecimal digits."""
    with opened(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def digest_of_document(document: Mapping[str, Any], but: str) -> str:
    """Return the SHA-256 of a document of plain values without its key ``but``."""
    rest = {key: value for key, value in document.items() if key != but}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def _fsync(path: Path) -> None:
    # Windows flushes no file that is open for reading alone, and opens no folder.
    handle = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextlib.contextmanager
def _explained(path: str | Path) -> Iterator[None]:
    try:
        yield
    except NotWritten:
        raise
    except (OSError, UnicodeEncodeError) as problem:
        reason = getattr(problem, "strerror", None) or str(problem) or type(problem).__name__
        raise NotWritten(path, reason[:1].lower() + reason[1:]) from None
    except ValueError as problem:
        if "null" not in str(problem):  # a NUL character in the path
            raise
        raise NotWritten(path, str(problem)) from None


def _is_direct(path: str | Path) -> bool:
    try:
        mode = os.stat(path).st_mode
    except OSError:
        return False
    if stat.S_ISDIR(mode):
        return False
    return not stat.S_ISREG(mode) or bool(_DIRECT.fullmatch(os.path.abspath(path)))


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def _host() -> str:
    return re.sub(r"[^\w-]", "-", platform.node(), flags=re.ASCII)[:40] or "-"
