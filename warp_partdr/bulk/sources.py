"""Sources of pictures by the thousand: a folder, a list of files, a COCO file of annotations.

A source has names, in an order that is the same in each run, and reads one picture by its name, in any thread.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..detection.person import SKELETON
from ..errors import InputError, cause, shown
from ..files.disk import file_sha256
from ..files.json_files import read_json
from ..inputs.keypoint_files import parse_keypoints
from ..inputs.keypoints import Keypoints2D
from ..inputs.part_labels import PHOTO_SUFFIXES, read_photo
from ..inputs.person import Box


@dataclass(frozen=True)
class KnownPerson:
    """A person of a picture, as annotated or as found.

    Attributes:
        keypoints: In pixels of the picture.
        score: Confidence that there is a person.
        box: Left, top, right, bottom [px].
        annotation: Number of the annotation; None of people who were found.
    """

    keypoints: Keypoints2D
    score: float
    box: Box
    annotation: int | None = None


@dataclass(frozen=True)
class SourcePicture:
    """A picture, and its people if they are known.

    Attributes:
        pixels: RGB, shape (H, W, 3), uint8.
        people: None: they are to be found.
        owners: Whom each pixel shows, 1 for the first of ``people``, 0 for nobody, shape (H, W), int32; None: unknown.
    """

    pixels: np.ndarray
    people: tuple[KnownPerson, ...] | None = None
    owners: np.ndarray | None = None


class PictureSource(Protocol):
    """Pictures by name."""

    @property
    def names(self) -> Sequence[str]:
        """Names of all pictures, each once, in their order."""

    @property
    def skeleton(self) -> str:
        """Format of the keypoints of all people."""

    @property
    def digest(self) -> str | None:
        """SHA-256 of what people are known from; None where they are found."""

    def path(self, name: str) -> Path:
        """The file of a picture, for its EXIF data."""

    def read(self, name: str) -> SourcePicture:
        """Read a picture.

        Raises:
            InputError: If it can't be read.
        """


@dataclass(frozen=True)
class PictureFiles:
    """Photos in files, whose people are to be found; a name is the path from ``folder`` on."""

    folder: Path
    names: tuple[str, ...]
    skeleton: str = SKELETON
    digest: str | None = None

    def path(self, name: str) -> Path:
        """The file of a photo."""
        return self.folder / name

    def read(self, name: str) -> SourcePicture:
        """Read a photo."""
        return SourcePicture(_read(self.folder, name))


@dataclass(frozen=True)
class CocoPictures:
    """Pictures of a COCO file of annotations, with its people: keypoints, and masks where they are polygons."""

    folder: Path
    entries: Mapping[str, Sequence[Mapping[str, Any]]]  # annotations by the picture's file_name
    digest: str
    skeleton: str = "coco17"

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The pictures' file_name, in alphabetical order."""
        return tuple(sorted(self.entries))

    def path(self, name: str) -> Path:
        """The file of a picture."""
        return self.folder / name

    def read(self, name: str) -> SourcePicture:
        """Read a picture, with those of its people who have keypoints."""
        pixels = _read(self.folder, name)
        people: list[KnownPerson] = []
        masks: list[np.ndarray | None] = []
        for entry in self.entries[name]:
            where = f"{name}: annotation {entry.get('id')}"
            given = entry.get("keypoints")
            if not isinstance(given, list) or not any(given[2::3]):
                continue
            keypoints = parse_keypoints({"keypoints": given}, self.skeleton, name=where)[0]
            mask = _mask(entry.get("segmentation"), (pixels.shape[0], pixels.shape[1]), where)
            masks.append(mask)
            number = entry.get("id")
            people.append(
                KnownPerson(
                    keypoints,
                    float(entry.get("score", 1.0)),
                    _box(entry.get("bbox"), keypoints, where),
                    number if type(number) is int else None,
                )
            )
        return SourcePicture(pixels, tuple(people), _owners(masks, (pixels.shape[0], pixels.shape[1])))


def open_source(path: Path, images: Path | None = None) -> PictureFiles | CocoPictures:
    """Open a folder of photos, a list of files (.txt), or a COCO file of annotations (.json).

    Args:
        path: A folder is searched with all folders in it. A list has a path a line, from the list's folder on.
        images: Folder of a COCO file's pictures; default: the file's own.

    Raises:
        InputError: If there is no such thing, or no picture in it.
    """
    if images is not None and (path.is_dir() or path.suffix.lower() != ".json"):
        raise InputError(f"--images: {images}, with {path}; expected a COCO file of annotations with it")
    source: PictureFiles | CocoPictures
    if path.is_dir():
        files = (file for file in path.rglob("*") if file.suffix.lower() in PHOTO_SUFFIXES and file.is_file())
        parts = (file.relative_to(path) for file in files)
        names = sorted(name.as_posix() for name in parts if not any(part.startswith(".") for part in name.parts))
        source, expected = PictureFiles(path, tuple(names)), f"some: {', '.join(PHOTO_SUFFIXES)}"
    elif path.suffix.lower() == ".json":
        source, expected = _open_coco(path, images or path.parent), "some in the list images"
    elif path.suffix.lower() == ".txt":
        source, expected = PictureFiles(path.parent, _read_list(path)), "the path of one a line"
    else:
        expected = "a folder of photos, a list of them (.txt), or COCO's annotations (.json)"
        raise InputError(f"{path}: {'a file' if path.exists() else 'No such file or folder'}; expected {expected}")
    _check_names(source, path, expected)
    return source


def _read_list(path: Path) -> tuple[str, ...]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {cause(error)}; expected a list of files, one a line") from error
    return tuple(line.strip() for line in lines if line.strip())


def _check_names(source: PictureSource, path: Path, expected: str) -> None:
    """Raise an InputError unless there are pictures, each once."""
    if not source.names:
        raise InputError(f"{path}: no pictures in it; expected {expected}")
    name, count = Counter(source.names).most_common(1)[0]
    if count > 1:
        raise InputError(f"{path}: {name} twice; expected each picture once")


def _read(folder: Path, name: str) -> np.ndarray:
    """A photo; of a fault, the message is the same wherever the folder is."""
    path = folder / name
    try:
        return read_photo(path)
    except InputError as error:
        raise InputError(str(error).replace(str(path), name)) from error


def _open_coco(path: Path, folder: Path) -> CocoPictures:
    data = read_json(path, "COCO's annotations")
    images = data.get("images") if isinstance(data, Mapping) else None
    annotations = data.get("annotations") if isinstance(data, Mapping) else None
    if not isinstance(images, list) or not isinstance(annotations, list):
        raise InputError(f"{path}: no lists images and annotations; expected COCO's annotations")
    names: dict[Any, str] = {}
    for image in images:
        if not isinstance(image, Mapping) or not isinstance(image.get("file_name"), str):
            raise InputError(f"{path}: images: {shown(image)}; expected id and file_name")
        names[image.get("id")] = image["file_name"]
    entries: dict[str, list[Mapping[str, Any]]] = {name: [] for name in names.values()}
    if len(entries) < len(images):
        raise InputError(f"{path}: images: an id or file_name twice; expected each once")
    for entry in annotations:
        if not isinstance(entry, Mapping) or entry.get("image_id") not in names:
            raise InputError(f"{path}: annotations: {shown(entry)}; expected the image_id of one of the images")
        entries[names[entry["image_id"]]].append(entry)
    return CocoPictures(folder, entries, file_sha256(path))


def _box(given: Any, keypoints: Keypoints2D, where: str) -> Box:
    """COCO's left, top, width and height as edges; without, those of the keypoints."""
    if given is None:
        points = keypoints.points[keypoints.visible]
        left, top, right, bottom = (float(edge) for edge in (*points.min(axis=0), *points.max(axis=0)))
        return left, top, right, bottom
    try:
        left, top, width, height = map(float, given)
    except (TypeError, ValueError):
        raise InputError(f"{where}: bbox: {shown(given)}; expected four numbers") from None
    return left, top, left + width, top + height


def _mask(given: Any, size: tuple[int, int], where: str) -> np.ndarray | None:
    """A mask of COCO's polygons, shape (H, W), bool; None of others, which are run lengths."""
    if not isinstance(given, list) or not given:
        return None
    from PIL import Image, ImageDraw

    image = Image.new("1", size[::-1])
    for polygon in given:
        if not isinstance(polygon, list) or len(polygon) < 6 or len(polygon) % 2:
            raise InputError(f"{where}: segmentation: {shown(polygon)}; expected polygons x, y, x, y, ...")
        ImageDraw.Draw(image).polygon([float(number) for number in polygon], fill=1)
    return np.asarray(image, dtype=bool)


def _owners(masks: Sequence[np.ndarray | None], size: tuple[int, int]) -> np.ndarray | None:
    """Whom each pixel shows; where masks overlap, the smaller is before the larger. None if a mask is missing."""
    known = [mask for mask in masks if mask is not None]
    if not known or len(known) < len(masks):
        return None
    owners = np.zeros(size, dtype=np.int32)
    for index in sorted(range(len(known)), key=lambda index: -int(known[index].sum())):
        owners[known[index]] = index + 1
    return owners
