"""Files that hold many pictures: tar files as WebDataset writes them, and films."""

from __future__ import annotations

import tarfile
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from ..errors import InputError, cause, install_command
from ..inputs.films import check_pyav, is_film
from ..inputs.part_labels import PHOTO_SUFFIXES

TAR_SUFFIX = ".tar"
KEYPOINTS, PARTS = "keypoints.json", "parts.png"  # endings of files that lie beside a photo, after its key and a point
ENDINGS = ("", KEYPOINTS, PARTS)  # of a photo itself, and beside it

_BLOCK = tarfile.BLOCKSIZE

Opened = TypeVar("Opened")


class NamedBytes(BytesIO):
    """A file in memory that messages call by its name."""

    def __init__(self, data: bytes, name: str) -> None:
        super().__init__(data)
        self.name = name

    def __repr__(self) -> str:
        """Its name, without the address in memory, so that errors of two runs are equal."""
        return self.name


@dataclass(frozen=True)
class Member:
    """One file in a tar file: its name there, and where its bytes are."""

    name: str
    start: int
    size: int


@dataclass(frozen=True)
class TarPictures:
    """Pictures of a tar file, with what lies beside them.

    Attributes:
        path: The file's.
        samples: Members beside each photo by their endings, by the photo's name; the photo itself is "".
        fault: Why there may be more in the file; None if all was read.
    """

    path: Path
    samples: dict[str, dict[str, Member]]
    fault: str | None

    def spans(self) -> np.ndarray:
        """Start and size of each photo and of what lies beside it, by ``ENDINGS``, -1 without, shape (N, 3, 2)."""
        missing = Member("", -1, -1)
        found = [
            [(member.start, member.size) for member in (files.get(ending, missing) for ending in ENDINGS)]
            for files in self.samples.values()
        ]
        return np.array(found, dtype=np.int64).reshape(-1, len(ENDINGS), 2)


def read_member(path: str, start: int, size: int, name: str) -> NamedBytes:
    """The bytes of a file in a tar file, which messages call by a name.

    Raises:
        InputError: If it can't be read.
    """
    try:
        with open(path, "rb") as file:
            file.seek(start)
            data = file.read(size)
    except OSError as error:
        raise InputError(f"{name}: {cause(error)}; expected a tar file") from error
    if len(data) < size:
        raise InputError(f"{name}: {len(data)} of {size} bytes; expected a whole tar file")
    return NamedBytes(data, name)


def index_tar(path: Path) -> TarPictures:
    """Find the pictures of a tar file; samples are told apart by the rules of the webdataset library.

    Raises:
        InputError: If the library is not installed, or this is no tar file.
    """
    check_webdataset(path)
    from webdataset.tariterators import group_by_keys

    faults: list[str] = []

    def noted(error: Exception) -> bool:
        faults.append(f"{path}: {str(error.args[0] if error.args else error).split(' in tar')[0]}; expected each once")
        return True

    def members() -> Iterator[dict[str, Any]]:
        try:
            # Without compression: members are read by their place.
            with tarfile.open(path, "r:") as tar:
                for each in tar:
                    if each.isfile():
                        yield {
                            "fname": each.name,
                            "data": Member(each.name, each.offset_data, each.size),
                            "__url__": "",
                        }
                end = tar.offset
        except (tarfile.TarError, OSError, ValueError) as error:
            faults.append(f"{path}: {cause(error)}; expected a whole tar file")
            return
        with path.open("rb") as file:  # tarfile takes a damaged header for the end
            file.seek(end)
            if file.read(_BLOCK) != bytes(_BLOCK):
                faults.append(f"{path}: no end after {end} bytes; expected a whole tar file")

    samples: dict[str, dict[str, Member]] = {}
    for sample in group_by_keys(members(), handler=noted):
        beside = {ending: sample[ending] for ending in (KEYPOINTS, PARTS) if ending in sample}
        for ending, member in sample.items():
            if f".{ending}" in PHOTO_SUFFIXES:
                samples[member.name] = {"": member, **beside}
    if not samples and not faults:
        faults.append(f"{path}: no pictures in it; expected some: {', '.join(PHOTO_SUFFIXES)}")
    return TarPictures(path, samples, faults[0] if faults else None)


def check_container(entry: str) -> bool:
    """True if a file's name is one of many pictures.

    Raises:
        InputError: If what reads it is not installed.
    """
    if is_film(entry):
        check_pyav(entry)
        return True
    if entry.lower().endswith(TAR_SUFFIX):
        check_webdataset(entry)
        return True
    return False


def check_webdataset(path: str | Path) -> None:
    """Raise an InputError, about a tar file, if webdataset is not installed."""
    if find_spec("webdataset") is None:
        raise InputError(f"{path}: a tar file, without webdataset; expected it: {install_command('dataset')}")


@dataclass
class Latest(Generic[Opened]):
    """The few files opened last, each once whatever thread asks; copies to other processes begin anew."""

    opener: Callable[[Path], Opened]
    most: int = 2
    _lock: Any = field(default_factory=threading.Lock)
    _opened: OrderedDict[Path, Opened] = field(default_factory=OrderedDict)

    def open(self, path: Path) -> Opened:
        """The opened file."""
        with self._lock:
            if path not in self._opened:
                self._opened[path] = self.opener(path)
                if len(self._opened) > self.most:
                    self._opened.popitem(last=False)
            self._opened.move_to_end(path)
            return self._opened[path]

    def __reduce__(self) -> tuple[Any, ...]:
        """Leave out what is open."""
        return Latest, (self.opener, self.most)
