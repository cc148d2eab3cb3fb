"""Files that hold many pictures: tar files as WebDataset writes them, and films."""

from __future__ import annotations

import posixpath
import tarfile
import threading
from collections import Counter, OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from ..errors import InputError, cause, install_command
from ..files.disk import check_regular
from ..inputs.films import check_pyav, is_film
from ..inputs.photo_files import ALONE, KEYPOINTS, PARTS, PHOTO_SUFFIXES, LeftOut, ending_of, is_hidden_name

TAR_SUFFIX = ".tar"
ENDINGS = ("", KEYPOINTS, PARTS)  # of a photo itself, and beside it

_BLOCK = tarfile.BLOCKSIZE
_XZ = b"\xfd7zXZ\0"
_COMPRESSED = (b"\x1f\x8b", b"BZh", _XZ, b"\x28\xb5\x2f\xfd")  # beginnings of gzip, bzip2, xz and zstd
_MOST_LINKS = 8  # that follow one another

Opened = TypeVar("Opened")


class NamedBytes(BytesIO):
    """A file in memory that messages call by its name."""

    def __init__(self, data: bytes, name: str) -> None:
        super().__init__(data)
        self.name = name

    def __repr__(self) -> str:
        """Name of the bytes, without the address in memory, so that errors of two runs are equal."""
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
        check_regular(path)
        with open(path, "rb") as file:
            file.seek(start)
            data = file.read(size)
    except OSError as error:
        raise InputError(f"{name}: {cause(error)}; expected a tar file") from error
    if len(data) < size:
        raise InputError(f"{name}: {len(data)} of {size} bytes; expected a whole tar file")
    return NamedBytes(data, name)


def index_tar(path: Path, left_out: LeftOut | None = None) -> TarPictures:
    """Find the pictures of a tar file, and what lies beside each by its name (``group_members``).

    Args:
        path: The file's.
        left_out: Counts members that are neither.

    Raises:
        InputError: If it can't be read from the disk.
    """
    faults: list[str] = []
    index = _Index()
    try:
        check_regular(path)
        with path.open("rb") as file:
            compressed = file.read(len(_XZ)).startswith(_COMPRESSED)
        if compressed:
            raise InputError(f"{path}: compressed; expected it without compression: members are read by their place")
        # Without compression: members are read by their place.
        with tarfile.open(path, "r:") as tar:
            for each in tar:
                index.add(each)
            end = tar.offset
        with path.open("rb") as file:  # tarfile takes a damaged header for the end
            file.seek(end)
            if file.read(_BLOCK) != bytes(_BLOCK):
                faults.append(f"{path}: no end after {end} bytes; expected a whole tar file")
    except OSError as error:
        raise InputError(f"{path}: {cause(error)}; expected a tar file") from error
    except (tarfile.TarError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        faults.append(f"{path}: {cause(error)}; expected a whole tar file")
    counted = LeftOut() if left_out is None else left_out
    samples = group_members(index.members(counted), counted)
    if not samples and not faults:
        faults.append(f"{path}: no pictures in it; expected some: {', '.join(PHOTO_SUFFIXES)}")
    return TarPictures(path, samples, faults[0] if faults else None)


@dataclass
class _Index:
    """Members of a tar file as they come, by their names; of two of one name the later counts, as for ``tar -x``."""

    files: dict[str, Member] = field(default_factory=dict)
    links: dict[str, str] = field(default_factory=dict)  # names of files, by the names of links to these
    sparse: list[str] = field(default_factory=list)
    earlier: list[str] = field(default_factory=list)

    def add(self, each: tarfile.TarInfo) -> None:
        """Take a member; folders and devices are none."""
        name = each.name
        if any(is_hidden_name(part) for part in name.split("/") if part not in ("", ".", "..")):
            return
        if each.islnk() or each.issym() or each.isfile():
            if name in self.files or name in self.links:
                self.earlier.append(name)
            self.files.pop(name, None)
            self.links.pop(name, None)
        if each.islnk():
            self.links[name] = each.linkname
        elif each.issym():
            self.links[name] = posixpath.join(posixpath.dirname(name), each.linkname)
        elif each.sparse is not None:  # not in one piece
            self.sparse.append(name)
        elif each.isfile():
            self.files[name] = Member(name, each.offset_data, each.size)

    def members(self, left_out: LeftOut) -> list[Member]:
        """Files by their names, also by those of links; what can't be read alone is counted."""
        places = {posixpath.normpath(name): member for name, member in self.files.items()}
        targets = {posixpath.normpath(name): posixpath.normpath(target) for name, target in self.links.items()}
        found = dict(self.files)
        for name, target in self.links.items():
            path = posixpath.normpath(target)
            for _ in range(_MOST_LINKS):
                path = targets.get(path, path)
            if path in places:
                found[name] = Member(name, places[path].start, places[path].size)
            else:
                left_out.add(name, "links to what is not in the tar file")
        for name in self.sparse:
            left_out.add(name, "sparse members of a tar file: pack them without -S")
        for name in self.earlier:
            left_out.add(name, "a later one of that name is in the tar file")
        return list(found.values())


def group_members(members: Sequence[Member], left_out: LeftOut) -> dict[str, dict[str, Member]]:
    """Photos among members, each with what lies beside it by its ending; the photo itself is "".

    Files beside ``shoot 2.0.jpg`` are ``shoot 2.0.keypoints.json`` and ``shoot 2.0.parts.png``. Where these are
    missing, and only one photo's name is the same up to its first point, also those of ``shoot 2``: WebDataset's rule,
    for ``7.image.jpg`` beside ``7.keypoints.json``.
    """
    photos: dict[str, Member] = {}
    beside: dict[tuple[str, str], Member] = {}  # by key and ending
    for member in members:
        ending = next((each for each in (KEYPOINTS, PARTS) if member.name.lower().endswith(f".{each}")), "")
        if ending:
            beside[member.name[: -len(ending) - 1], ending] = member
        elif ending_of(member.name) in PHOTO_SUFFIXES:
            photos[member.name] = member
        else:
            left_out.add(member.name)
    short = Counter(map(_short_key, photos))
    samples: dict[str, dict[str, Member]] = {}
    taken: set[tuple[str, str]] = set()
    for name, photo in photos.items():
        samples[name] = {"": photo}
        for ending in (KEYPOINTS, PARTS):
            own, common = (posixpath.splitext(name)[0], ending), (_short_key(name), ending)
            key = common if own not in beside and short[common[0]] == 1 else own
            if key in beside:
                samples[name][ending] = beside[key]
                taken.add(key)
    for _, ending in beside.keys() - taken:
        left_out.count(f".{ending}", ALONE)
    return samples


def _short_key(name: str) -> str:
    """A name up to the first point after its folders, WebDataset's key."""
    folder, slash, file = name.rpartition("/")
    return folder + slash + file.partition(".")[0]


def check_container(entry: str) -> bool:
    """True if a file's name is one of many pictures.

    Raises:
        InputError: If what reads it is not installed.
    """
    if is_film(entry):
        check_pyav(entry)
        return True
    return entry.lower().endswith(TAR_SUFFIX)


def check_webdataset(path: str | Path) -> None:
    """Raise an InputError, about a pattern of tar files, if webdataset is not installed."""
    if find_spec("webdataset") is None:
        raise InputError(f"{path}: a pattern, without webdataset; expected it: {install_command('dataset')}")


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
