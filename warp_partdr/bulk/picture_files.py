"""Pictures in files, with keypoints and part labels beside them: photos, WebDataset's tar files, and films.

Beside ``a/7.jpg`` may lie ``a/7.keypoints.json``, everyone's keypoints in any form of ``inputs.keypoint_files``, and
``a/7.parts.png``, part labels, whose ids ``labels.json`` in the source's folder explains. In tar files the same names
do. Who has no keypoints is found.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..body.labels import LabelSet, label_set
from ..body.skeletons import Skeleton
from ..errors import InputError, cause
from ..files.json_files import parse_json
from ..inputs.films import FilmFrames, is_film
from ..inputs.keypoint_files import parse_keypoints, read_keypoints
from ..inputs.keypoints import Keypoints2D
from ..inputs.part_labels import (
    PartLabels,
    PhotoFile,
    ScannedPhoto,
    check_sizes,
    photo_warnings,
    read_parts,
    read_photo,
)
from ..inputs.person import Box
from ..inputs.photo_files import KEYPOINTS, PARTS, LeftOut
from ..networks.detection.person import SKELETON
from .containers import (
    ENDINGS,
    Latest,
    NamedBytes,
    TarPictures,
    check_container,
    index_tar,
    read_member,
)
from .outages import is_passing
from .sources import KnownPerson, SourcePicture

Beside = tuple[str, str, int]  # a photo's name, and ending and size of a file beside it


@dataclass(frozen=True)
class PictureFiles:
    """Photos, frames of films, and photos of tar files, in a folder.

    Attributes:
        folder: Folder that the names are relative to.
        names: Names of the pictures: "a/7.jpg", "film.mp4#0" and so on, "a.tar#7.jpg". A picture that is only in part
            there has its own name, too, and reading it tells why.
        containers: Films and tar files among them.
        skeleton: Format of the first keypoints. Without any, it is that of people who are found.
        digest: SHA-256 of names and sizes of the files beside photos, and of the label set. It is None without such
            files.
        labels: Label set that tells what the ids of part labels mean.
        left_out: Line that counts files which are no photos, by their endings and reasons. It is "" without any.
        keypoint_format: Format of all keypoints, as the user says. If it is None, the files tell it.
        spans: Start and size of each photo in a tar file and of the files beside it, by ``ENDINGS``, -1 where there is
            none, shape (number of names, 3, 2). Whoever has a copy need not read the tar files' headers.
    """

    folder: Path
    names: tuple[str, ...]
    containers: frozenset[str] = frozenset()
    skeleton: str | Skeleton = SKELETON
    digest: str | None = None
    labels: LabelSet | None = None
    keypoint_format: Skeleton | None = None
    finds: bool = True
    left_out: str = ""
    warnings: tuple[str, ...] = ()
    spans: np.ndarray = field(default_factory=lambda: np.zeros((0, len(ENDINGS), 2), dtype=np.int64), compare=False)
    _films: Latest[FilmFrames] = field(default_factory=lambda: Latest(FilmFrames), compare=False)

    @cached_property
    def _rows(self) -> dict[str, int]:
        return {name: row for row, name in enumerate(self.names)}

    def photo(self, name: str) -> PhotoFile:
        """The file of a photo; films have none."""
        container, _ = self._split(name)
        if container is None:
            return self.folder / name
        if is_film(container):
            raise InputError(f"{name}: of a film, without EXIF data; expected --focal PX or --fov")
        photo = self._member(container, name, "")
        if photo is None:
            raise InputError(f"{name}: not there; expected it in {self.folder / container}")
        return photo

    def read(self, name: str) -> SourcePicture:
        """Read a picture, and what lies beside it."""
        container, inside = self._split(name)
        try:
            if container is not None and not inside:  # a file that is not whole
                path = self.folder / container
                opened = self._films.open(path) if is_film(container) else index_tar(path)
                raise InputError(opened.fault or f"{name}: changed meanwhile; expected the same file")
            if container is not None and is_film(container):
                return SourcePicture(self._films.open(self.folder / container).read(int(inside)))
            photo, keypoints = self.photo(name), None if self.digest is None else self.beside(name, KEYPOINTS)
            if keypoints is None:
                pixels = read_photo(photo)
                parts = self._read_labels(name, (pixels.shape[0], pixels.shape[1]))
                return SourcePicture(pixels, parts=parts, warnings=photo_warnings(photo))
            scanned = ScannedPhoto.of(photo)
            people = tuple(map(_known, self.read_keypoints(keypoints, scanned)))
            parts = self._read_labels(name, scanned.size)
            return SourcePicture(scanned, people, parts=parts, warnings=photo_warnings(photo))
        except InputError as error:  # messages are the same wherever the folder is
            message = str(error).replace(str(self.folder / (container or name)), container or name)
            beside = str(self.folder / "_")[:-1]  # how names of files beside it begin
            raise InputError(message.removeprefix(beside)) from error

    def beside(self, name: str, ending: str) -> PhotoFile | None:
        """The file of an ending beside a photo; None without."""
        container, _ = self._split(name)
        if container is not None:
            return None if is_film(container) else self._member(container, name, ending)
        path = (self.folder / name).with_suffix(f".{ending}")
        return path if _size(path) is not None else None

    def read_keypoints(self, file: PhotoFile, photo: ScannedPhoto | None = None) -> list[Keypoints2D]:
        """Everyone's keypoints of a file, which may be in memory, and lies beside a photo."""
        size = None if photo is None else photo.size
        beside = photo.file if photo is not None and isinstance(photo.file, Path) else None
        if not isinstance(file, NamedBytes):
            return read_keypoints(str(file), self.keypoint_format, photo=beside, size=size)
        try:
            text = file.read().decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise InputError(f"{file}: not JSON ({error}); expected keypoints in JSON") from error
        data = parse_json(text, str(file), "keypoints in JSON")
        orientation = None
        if photo is not None and isinstance(photo.file, NamedBytes):
            beside, orientation = Path(photo.file.name.rpartition("#")[2]), photo.orientation
        return parse_keypoints(
            data, self.keypoint_format, name=str(file), photo=beside, size=size, orientation=orientation
        )

    def _member(self, container: str, name: str, ending: str) -> NamedBytes | None:
        """A photo of a tar file, or a file beside it; None if there is none."""
        row = self._rows.get(name)
        start, size = (-1, -1) if row is None else self.spans[row, ENDINGS.index(ending)].tolist()
        shown_name = f"{name}: {ending}" if ending else name
        return None if start < 0 else read_member(os.path.join(self.folder, container), start, size, shown_name)

    def _read_labels(self, name: str, size: tuple[int, int]) -> PartLabels | None:
        file = None if self.labels is None else self.beside(name, PARTS)
        if file is None or self.labels is None:
            return None
        read = read_parts(file, self.labels)
        check_sizes(photo=size, parts=(read.groups.shape[0], read.groups.shape[1]))
        return read

    def _split(self, name: str) -> tuple[str | None, str]:
        """The film or tar file of a picture, and its name in there."""
        if name in self.containers:
            return name, ""
        container, _, inside = name.rpartition("#")
        return (container, inside) if container in self.containers else (None, name)


def open_files(
    folder: Path,
    entries: Iterable[str],
    labels: str | None,
    keypoint_format: Skeleton | None = None,
    left_out: LeftOut | None = None,
) -> PictureFiles:
    """Open photos, films and tar files by their paths from a folder on.

    Args:
        folder: Folder of the source.
        entries: Paths in the order in which their pictures are to come.
        labels: Name or JSON file of the label set of part labels. If it is None, it is ``labels.json`` in the folder.
        keypoint_format: Format of all keypoints. If it is None, the files tell it.
        left_out: Files of the folder that are none of these.

    Raises:
        InputError: If a library that is needed is not installed, the label set of part labels is unknown, there are no
            part labels or keypoints of which something is said, or the disk does not give a film or tar file.
    """
    left_out = left_out or LeftOut()
    names: list[str] = []
    containers: list[str] = []
    beside: list[Beside] = []
    spans: dict[int, np.ndarray] = {}  # by the number of a tar file's first photo
    listings: dict[Path, dict[str, int]] = {}
    for entry in entries:
        path = folder / entry
        if not check_container(entry):
            names.append(entry)
            given = listings.get(path.parent)
            if given is None:
                given = listings[path.parent] = _beside(path.parent)
            sizes = {ending: given.get(f"{path.stem}.{ending}") for ending in (KEYPOINTS, PARTS)}
            beside += ((entry, ending, size) for ending, size in sizes.items() if size is not None)
            continue
        containers.append(entry)
        try:
            opened = FilmFrames(path) if is_film(entry) else index_tar(path, left_out)
        except InputError as error:
            # Its pictures would be missing for good; but a link to nothing must not stop the others.
            if is_passing(error) and not isinstance(error.__cause__, FileNotFoundError):
                raise
            names.append(entry)
            continue
        if isinstance(opened, TarPictures):
            spans[len(names)] = opened.spans()
            names += (f"{entry}#{photo}" for photo in opened.samples)
            for photo, members in opened.samples.items():
                beside += ((f"{entry}#{photo}", end, member.size) for end, member in members.items() if end)
        else:
            names += (f"{entry}#{index}" for index in range(len(opened)))
        if opened.fault is not None:
            names.append(entry)
    every = np.full((len(names) if spans else 0, len(ENDINGS), 2), -1, dtype=np.int64)
    for first, each in spans.items():
        every[first : first + len(each)] = each
    source = PictureFiles(
        folder,
        tuple(names),
        frozenset(containers),
        keypoint_format=keypoint_format,
        left_out=str(left_out),
        spans=every,
    )
    if keypoint_format is not None and not any(ending == KEYPOINTS for _, ending, _ in beside):
        raise InputError(f"--format: {keypoint_format.name}, without keypoints; expected N.{KEYPOINTS} beside N.jpg")
    return _with_labels(source, beside, labels) if beside or labels is not None else source


def _with_labels(source: PictureFiles, beside: Sequence[Beside], labels: str | None) -> PictureFiles:
    """A source with the format of its keypoints, and what its part labels mean."""
    known = None
    if any(ending == PARTS for _, ending, _ in beside):
        file = source.folder / "labels.json"
        if labels is None and not file.is_file():
            raise InputError(f"--labels: missing; expected what the ids of *.{PARTS} mean, or {file}")
        known = label_set(file if labels is None else labels)
    elif labels is not None:
        raise InputError(f"--labels: {labels}, without part labels; expected N.{PARTS} beside N.jpg")
    form: str | Skeleton = SKELETON
    for name, ending, _ in beside:
        if ending == KEYPOINTS:
            with suppress(InputError):  # a row will tell
                given = source.beside(name, KEYPOINTS)
                assert given is not None
                form = source.read_keypoints(given)[0].skeleton
                break
    digest = hashlib.sha256()
    for each in beside:
        digest.update(json.dumps(each).encode())
    if known is not None:
        digest.update(json.dumps([dict(known.ids), dict(known.groups)], sort_keys=True).encode())
    return replace(source, skeleton=form, digest=digest.hexdigest(), labels=known)


def _beside(folder: Path) -> dict[str, int]:
    """Sizes of the files in a folder that lie beside photos, by name."""
    try:
        with os.scandir(folder) as entries:
            names = [each.name for each in entries if each.name.endswith((KEYPOINTS, PARTS))]
    except OSError:
        return {}  # reading a photo tells
    sizes = {name: _size(folder / name) for name in names}
    return {name: size for name, size in sizes.items() if size is not None}


def _size(path: Path) -> int | None:
    """Bytes of a file; -1 of a link to nothing, which reading tells; None if there is none.

    Raises:
        InputError: If the disk does not say.
    """
    try:
        return path.stat().st_size
    except (FileNotFoundError, NotADirectoryError):
        return -1 if path.is_symlink() else None
    except OSError as error:
        raise InputError(f"{path}: {cause(error)}; expected a file that can be read") from error


def _known(keypoints: Keypoints2D) -> KnownPerson:
    return KnownPerson(keypoints, 1.0, keypoint_box(keypoints))


def keypoint_box(keypoints: Keypoints2D) -> Box:
    """Left, top, right and bottom of visible keypoints."""
    points = keypoints.points[keypoints.visible]
    (left, top), (right, bottom) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return left, top, right, bottom


def read_relative(folder: Path, name: str) -> np.ndarray:
    """A photo; of a fault, the message is the same wherever the folder is."""
    path = folder / name
    try:
        return read_photo(path)
    except InputError as error:
        raise InputError(str(error).replace(str(path), name)) from error
