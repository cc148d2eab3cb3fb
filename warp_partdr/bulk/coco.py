"""COCO's annotations as a source: pictures with keypoints, boxes and masks of people."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import InputError, shown
from ..files.disk import file_sha256
from ..files.json_files import read_json
from ..inputs.keypoint_files import parse_keypoints
from ..inputs.keypoints import Keypoints2D
from ..inputs.part_labels import PhotoFile
from ..inputs.person import Box
from .picture_files import keypoint_box, read_relative
from .sources import KnownPerson, SourcePicture


@dataclass(frozen=True)
class CocoPictures:
    """Pictures of a COCO file of annotations, with its people: keypoints, and masks where all have one."""

    folder: Path
    entries: Mapping[str, Sequence[Mapping[str, Any]]]  # annotations by the picture's file_name
    digest: str
    skeleton: str = "coco17"
    finds: bool = False

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The pictures' file_name, in alphabetical order."""
        return tuple(sorted(self.entries))

    def photo(self, name: str) -> PhotoFile:
        """The file of a picture."""
        return self.folder / name

    def read(self, name: str) -> SourcePicture:
        """Read a picture, with those of its people who have keypoints."""
        pixels = read_relative(self.folder, name)
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


def open_coco(path: Path, folder: Path) -> CocoPictures:
    """Open a file of annotations, with the folder of its pictures.

    Raises:
        InputError: If it can't be read, or is none.
    """
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
        return keypoint_box(keypoints)
    try:
        left, top, width, height = map(float, given)
    except (TypeError, ValueError):
        raise InputError(f"{where}: bbox: {shown(given)}; expected four numbers") from None
    return left, top, left + width, top + height


def _mask(given: Any, size: tuple[int, int], where: str) -> np.ndarray | None:
    """A mask of COCO's polygons or run lengths, shape (H, W), bool; None without."""
    if isinstance(given, Mapping):
        return decode_runs(given, size, f"{where}: segmentation")
    if not isinstance(given, list) or not given:
        return None
    from PIL import Image, ImageDraw

    image = Image.new("1", size[::-1])
    for polygon in given:
        if not isinstance(polygon, list) or len(polygon) < 6 or len(polygon) % 2:
            raise InputError(f"{where}: segmentation: {shown(polygon)}; expected polygons x, y, x, y, ...")
        ImageDraw.Draw(image).polygon([float(number) for number in polygon], fill=1)
    return np.asarray(image, dtype=bool)


def decode_runs(given: Mapping[str, Any], size: tuple[int, int], where: str) -> np.ndarray:
    """A mask of COCO's run lengths: turns of nothing and mask, down the columns, as numbers or as text.

    Own, for it is short and lengths of files by others are checked; pycocotools writes what they say.

    Args:
        given: With "size" and "counts".
        size: (H, W) of the picture.
        where: Begins messages.

    Returns:
        Shape (H, W), bool.

    Raises:
        InputError: If it is no such mask of this size.
    """
    if given.get("size") != [*size]:
        raise InputError(f"{where}: size {shown(given.get('size'))}; expected the picture's, {[*size]}")
    counts = given.get("counts")
    runs = _text_runs(counts) if isinstance(counts, str) else counts
    if (
        not isinstance(runs, list)
        or not all(type(run) is int and run >= 0 for run in runs)
        or sum(runs) != math.prod(size)
    ):
        raise InputError(f"{where}: counts: {shown(counts)}; expected run lengths of {math.prod(size)} pixels in all")
    return np.repeat(np.arange(len(runs)) % 2 == 1, runs).reshape(size[::-1]).T


def _text_runs(text: str) -> list[int]:
    """Run lengths as COCO packs them: five bits a letter, lowest first; the fourth on are less the one before last."""
    runs: list[int] = []
    value = shift = 0
    for letter in text:
        code = ord(letter) - 48
        value |= (code & 31) << shift
        shift += 5
        if not code & 32:  # the last of this number
            value -= (code & 16) << shift - 4  # its sign
            runs.append(value + (runs[-2] if len(runs) > 2 else 0))
            value = shift = 0
    return runs


def _owners(masks: Sequence[np.ndarray | None], size: tuple[int, int]) -> torch.Tensor | None:
    """Whom each pixel shows; where masks overlap, the smaller is before the larger. None if a mask is missing."""
    known = [mask for mask in masks if mask is not None]
    if not known or len(known) < len(masks):
        return None
    owners = np.zeros(size, dtype=np.int32)
    for index in sorted(range(len(known)), key=lambda index: -int(known[index].sum())):
        owners[known[index]] = index + 1
    return torch.from_numpy(owners)
