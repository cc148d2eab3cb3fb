"""Files on the disk: their kind, their SHA-256, and that they are there for good."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

_OPEN_PIPES = ("/dev/fd/", "/dev/stdin", "/proc/self/fd/")  # a shell's "<(command)" and "|", which have a writer
_KINDS = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


def check_regular(path: str | Path) -> None:
    """Raise an OSError if a path is of a pipe, a socket or a device, which a reader would wait for, maybe for ever.

    A pipe that a shell opened for this process, such as ``<(command)``, may be read. Folders are left to whoever opens
    them.

    Raises:
        OSError: If the path is of such a kind, or there is nothing.
    """
    mode = os.stat(path).st_mode
    kind = _KINDS.get(stat.S_IFMT(mode))
    if kind is None or (stat.S_ISFIFO(mode) and str(path).startswith(_OPEN_PIPES)):
        return
    raise OSError(f"{kind}, no regular file")


def file_sha256(path: Path) -> str:
    """SHA-256 of a file.

    Raises:
        OSError: If it can't be read.
    """
    check_regular(path)
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def sync(path: Path) -> None:
    """Wait until a file, or a folder's entries, are on the disk.

    Raises:
        OSError: If it can't be opened; only POSIX opens folders.
    """
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
