"""COCO's annotations as a source: pictures with keypoints, boxes and masks of people.

Files of other tools and of later hands differ from COCO's own. Ids are compared as numbers, whether they are written as
text or not. Annotations of no picture, of animals and of things are left out, and the source's ``warnings`` count them.
An annotation that can't be read is a row with its error, and the other people of its picture are fitted.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..body.keypoint_names import left_out_warning, skeleton_of_names
from ..body.skeletons import SKELETONS, Skeleton, skeleton
from ..errors import InputError, shown
from ..files.disk import file_sha256
from ..files.json_files import read_json
from ..inputs.annotated_sizes import PictureChange, find_size, match_sizes, outside_warning, stated_size
from ..inputs.keypoint_categories import KeypointCategory, common_category, number_of, read_categories
from ..inputs.keypoint_files import is_whole_body, parse_keypoints
from ..inputs.keypoint_shapes import file_names
from ..inputs.keypoints import LARGEST_COORDINATE, Keypoints2D
from ..inputs.part_labels import PhotoFile, read_orientation
from ..inputs.person import Box
from ..inputs.photo_files import PHOTO_SUFFIXES
from .picture_files import keypoint_box, read_relative
from .sources import ANNOTATIONS, FaultyPerson, KnownPerson, SourcePicture

_PLAIN = "coco17"  # skeleton of rows where no annotation tells another
_LARGEST_NUMBER = 2**63 - 1  # that a column holds
_NO_MASKS = f"{ANNOTATIONS}not everyone in the picture has a mask; masks are left out"


@dataclass(frozen=True)
class CocoAnnotation:
    """An annotation of a person.

    Attributes:
        entry: Entry of the annotation in the list annotations.
        image: Entry of its picture in the list images. It may state a size.
        form: Skeleton of the keypoints. If it is None, their number tells it.
    """

    entry: Mapping[str, Any]
    image: Mapping[str, Any]
    form: Skeleton | None = None

    @property
    def number(self) -> int | None:
        """Id of the annotation, if it is a number that a column holds; otherwise None."""
        number = number_of(self.entry.get("id"))
        return number if isinstance(number, int) and abs(number) <= _LARGEST_NUMBER else None

    @property
    def marked(self) -> bool:
        """True if a keypoint is visible."""
        given = self.entry.get("keypoints")
        if not isinstance(given, list):
            return given is not None
        if any(isinstance(row, list) for row in given):
            return any(any(row[:2]) and any(row[2:] or [1]) for row in given if isinstance(row, list))
        return any(given[2::3]) if len(given) % 3 == 0 else any(given)

    def keypoints(self, where: str) -> Keypoints2D:
        """Read the keypoints [px of the annotated picture]; an InputError begins with ``where``."""
        return parse_keypoints(self.entry, self.form, name=where)[0]


@dataclass(frozen=True)
class CocoPictures:
    """Pictures of a COCO file of annotations, with its people: keypoints, and masks where all have one.

    Attributes:
        folder: Folder of the pictures.
        annotations: Annotations of people, by the picture's file_name.
        digest: SHA-256 of the file.
        skeleton: Format of the keypoints that rows have, which is that of most annotations.
        warnings: Sentences about what was left out of the file.
    """

    folder: Path
    annotations: Mapping[str, Sequence[CocoAnnotation]]
    digest: str
    skeleton: str | Skeleton = _PLAIN
    warnings: tuple[str, ...] = ()
    finds: bool = False
    left_out: str = ""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The pictures' file_name, in alphabetical order."""
        return tuple(sorted(self.annotations))

    def photo(self, name: str) -> PhotoFile:
        """The file of a picture."""
        return self.folder / name

    def read(self, name: str) -> SourcePicture:
        """Read a picture, with those of its people who have keypoints.

        Raises:
            InputError: If it can't be read, or its size is not the annotated one, and no scale or turn explains that.
        """
        pixels = read_relative(self.folder, name)
        annotations = self.annotations[name]
        orientation = read_orientation(self.folder / name) if annotations else 1
        picture = _Picture(name, (pixels.shape[0], pixels.shape[1]), orientation)
        for annotation in annotations:
            picture.add(annotation)
        return picture.read(pixels)


@dataclass
class _Picture:
    """A picture's people, as far as they are read."""

    name: str
    size: tuple[int, int]
    orientation: int
    people: list[KnownPerson] = field(default_factory=list)
    faults: list[FaultyPerson] = field(default_factory=list)
    masks: list[np.ndarray | None] = field(default_factory=list)  # of ``people``
    others: list[np.ndarray] = field(default_factory=list)  # masks of those who have no keypoints
    unknown: bool = False  # someone else's mask is missing

    def add(self, annotation: CocoAnnotation) -> None:
        """Read an annotation; its faults are its person's, but an inexplicable size is the whole picture's."""
        stated = stated_size(annotation.image, self.name)
        if stated is None:
            found = find_size(annotation.entry, self.name) or find_size(annotation.image, self.name)
            stated = None if found is None else found.of(self.size, self.orientation)
        change = match_sizes(stated, self.size, self.orientation, self.name)
        where = f"{self.name}: annotation {annotation.entry.get('id')}"
        mask: np.ndarray | None = None
        try:
            mask = _mask(annotation.entry.get("segmentation"), change, self.orientation, f"{where}: segmentation")
            if annotation.marked:
                self.people.append(_annotated_person(annotation, change, where))
                self.masks.append(mask)
            elif mask is not None:
                self.others.append(mask)
        except InputError as error:
            if annotation.marked:
                self.faults.append(FaultyPerson(str(error), annotation.number))
                if mask is None:
                    self.unknown = True
                else:
                    self.others.append(mask)

    def read(self, pixels: np.ndarray) -> SourcePicture:
        """The picture with all who were read."""
        known = [mask for mask in self.masks if mask is not None]
        if known and (self.unknown or len(known) < len(self.masks)):
            known, self.people = [], [each.warned(_NO_MASKS) for each in self.people]
        owners = _owners([*known, *self.others], self.size) if known else None
        return SourcePicture(pixels, tuple(self.people), owners, faults=tuple(self.faults))


def open_coco(path: Path, folder: Path, keypoint_format: Skeleton | None = None) -> CocoPictures:
    """Open a file of annotations, with the folder of its pictures.

    Args:
        path: The file.
        folder: Folder of the pictures.
        keypoint_format: Format of all keypoints. If it is None, the names in the file's categories tell it, or the
            number of keypoints.

    Raises:
        InputError: If it can't be read or is none, two pictures have one id, or no annotation is of a person in one of
            its pictures.
    """
    data = read_json(path, "COCO's annotations")
    if isinstance(data, list) and data and all(isinstance(entry, Mapping) and "keypoints" in entry for entry in data):
        data = {"images": _named_images(data, path), "annotations": data}
    images = data.get("images") if isinstance(data, Mapping) else None
    entries = data.get("annotations") if isinstance(data, Mapping) else None
    if not isinstance(images, list) or not isinstance(entries, list):
        raise InputError(f"{path}: no lists images and annotations; expected COCO's annotations")
    categories = read_categories(data.get("categories"), str(path))
    first = next((entry["keypoints"] for entry in entries if isinstance(entry, Mapping) and "keypoints" in entry), None)
    names = None if keypoint_format is not None else file_names(data, first, str(path))
    named = None if names is None else skeleton_of_names(names, str(path))
    warning = None if names is None or named is None else left_out_warning(names, named)
    named_images = [_found_image(image, folder) for image in images]
    warnings = () if warning is None else (f"{path}: {warning}",)
    return _File(path, named_images, entries, categories, keypoint_format, named, warnings).open(folder)


def _found_image(image: Any, folder: Path) -> Any:
    """An image of the list images, with a file_name of this system where it is one of Windows."""
    name = image.get("file_name") if isinstance(image, Mapping) else None
    if not isinstance(name, str) or "\\" not in name or (folder / name).is_file():
        return image
    parts = [part for part in name.split("\\") if part not in ("", ".")]
    tails = ["/".join(parts[start:]) for start in range(len(parts))]
    there = next((tail for tail in tails if (folder / tail).is_file()), None)
    return {**image, "file_name": there or name.replace("\\", "/")}


def _named_images(results: Sequence[Mapping[str, Any]], path: Path) -> list[dict[str, Any]]:
    """Images of a list of results whose ``image_id`` are names of files, as AlphaPose writes them."""
    names = dict.fromkeys(str(entry.get("image_id")) for entry in results)
    if not all(name.lower().endswith(PHOTO_SUFFIXES) for name in names):
        raise InputError(
            f"{path}: a list of results, without the names of their pictures; expected COCO's annotations: an object "
            "with the lists images (id and file_name) and annotations, in which the results may stand"
        )
    return [{"id": name, "file_name": name} for name in names]


@dataclass(frozen=True)
class _File:
    """The lists of a COCO file."""

    path: Path
    images: Sequence[Any]
    entries: Sequence[Any]
    categories: Mapping[int | str, KeypointCategory]
    form: Skeleton | None  # of all, as the user says
    named: Skeleton | None = None  # by names at the file's top
    warnings: tuple[str, ...] = ()

    def open(self, folder: Path) -> CocoPictures:
        """Give each annotation its picture and its skeleton, and count what is left out."""
        warnings = list(self.warnings)
        named = self._named(warnings)
        pictures = self._pictures(named)
        by_category = {number_of(number): category for number, category in self.categories.items()}
        annotations: dict[str, list[CocoAnnotation]] = {image["file_name"]: [] for image in named}
        orphans: list[Any] = []
        refused: list[KeypointCategory] = []
        used: dict[str, None] = {}  # warnings of the categories that people are of
        for entry in self.entries:
            image = pictures.get(number_of(entry.get("image_id"))) if isinstance(entry, Mapping) else None
            if image is None:
                orphans.append(entry)
                continue
            category = by_category.get(number_of(entry.get("category_id"))) or self._common_category
            if category is not None and category.refusal is not None and (self.form is None or category.animals):
                refused.append(category)
                continue
            if category is not None and category.warning is not None and self.form is None:
                used[f"{self.path}: {category.warning}"] = None
            form = self.form or (None if category is None else category.skeleton) or self.named
            if self.form is None and is_whole_body(entry, form):
                form = SKELETONS["wholebody133"]
            annotations[image["file_name"]].append(CocoAnnotation(entry, image, form))
        people = list(chain.from_iterable(annotations.values()))
        if self.entries and not people:
            raise InputError(_why_refused(refused[0]) if refused else f"{self.path}: {_told_orphan(orphans[0])}")
        if orphans:
            warnings.append(f"{self.path}: {self._count(len(orphans))} left out, first {_told_orphan(orphans[0])}")
        if refused:
            warnings.append(f"{_why_refused(refused[0])}; {self._count(len(refused))} of such categories left out")
        marked = [each for each in people if each.marked]
        if len(marked) < len(people):
            warnings.append(f"{self.path}: {self._count(len(people) - len(marked))} without visible keypoints left out")
        main = _main_skeleton(marked)
        others = sum(each.form is not None and each.form.landmarks != skeleton(main).landmarks for each in marked)
        if others:
            reason = f"have other keypoints than most; the column keypoints holds what {skeleton(main).name} has"
            warnings.append(f"{self.path}: {self._count(others)} {reason}")
        return CocoPictures(folder, annotations, file_sha256(self.path), main, (*used, *warnings))

    def _named(self, warnings: list[str]) -> list[Mapping[str, Any]]:
        """Images that have a name."""
        named = [image for image in self.images if _is_named(image)]
        nameless = [image for image in self.images if not _is_named(image)]
        if nameless:
            fault = f"{shown(nameless[0])}; expected id and file_name"
            if not named:
                raise InputError(f"{self.path}: images: {fault}")
            warnings.append(f"{self.path}: {len(nameless)} of {len(self.images)} images left out, first {fault}")
        return named

    def _pictures(self, named: Iterable[Mapping[str, Any]]) -> dict[int | str | None, Mapping[str, Any]]:
        """Images by their ids, and by their names, which stand in some tools' ``image_id``."""
        by_id: dict[int | str | None, Mapping[str, Any]] = {}
        by_name: dict[int | str | None, Mapping[str, Any]] = {}
        for image in named:
            by_name.setdefault(image["file_name"], image)
            number = number_of(image.get("id"))
            if number is None:
                continue
            same = by_id.setdefault(number, image)
            if same["file_name"] != image["file_name"]:
                fault = f"id {shown(image['id'])} is of {shown(same['file_name'])} and of {shown(image['file_name'])}"
                raise InputError(f"{self.path}: images: {fault}; expected one picture an id")
        return by_name | by_id

    @cached_property
    def _common_category(self) -> KeypointCategory | None:
        """Category of annotations that name none of the file's."""
        return common_category(self.categories.values())

    def _count(self, count: int) -> str:
        return f"{count} of {len(self.entries)} annotations"


def _is_named(image: Any) -> bool:
    name = image.get("file_name") if isinstance(image, Mapping) else None
    return isinstance(name, str) and name != ""


def _told_orphan(entry: Any) -> str:
    return f"annotations: {shown(entry)}; expected the image_id of one of the images"


def _why_refused(category: KeypointCategory) -> str:
    return str(category.refusal)


def _main_skeleton(marked: Sequence[CocoAnnotation]) -> str | Skeleton:
    """Skeleton of most annotations, as their keypoints have it."""
    for form, _ in Counter(each.form for each in marked).most_common():
        for annotation in marked:
            if annotation.form == form:
                with suppress(InputError):  # a row will tell
                    return annotation.keypoints("").skeleton
    return _PLAIN


def _annotated_person(annotation: CocoAnnotation, change: PictureChange, where: str) -> KnownPerson:
    """A person whose keypoints and box are those of the picture that is read."""
    keypoints = change.keypoints(annotation.keypoints(where))
    outside = outside_warning(keypoints, change.picture)
    if outside is not None:
        keypoints = replace(keypoints, warnings=(*keypoints.warnings, outside))
    box = _box(annotation.entry.get("bbox"), where)
    return KnownPerson(
        keypoints,
        _score(annotation.entry.get("score"), where),
        keypoint_box(keypoints) if box is None else change.box(box),
        annotation.number,
        () if change.warning is None else (f"{ANNOTATIONS}{change.warning}",),
    )


def _score(given: Any, where: str) -> float:
    """Confidence of a result; 1 of annotations, which have none."""
    if given is None:
        return 1.0
    if isinstance(given, bool) or not isinstance(given, int | float) or not abs(given) <= _LARGEST_NUMBER:
        raise InputError(f"{where}: score: {shown(given)}; expected a number")
    return float(given)


def _box(given: Any, where: str) -> Box | None:
    """COCO's left, top, width and height as edges; None without a box, or with one of no size."""
    if given is None or given == []:
        return None
    try:
        left, top, width, height = map(float, given)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: bbox: {shown(given)}; expected four numbers") from None
    if not all(abs(edge) <= LARGEST_COORDINATE for edge in (left, top, width, height)):
        raise InputError(f"{where}: bbox: {shown(given)}; expected pixels, up to {LARGEST_COORDINATE:g}")
    return (left, top, left + width, top + height) if min(width, height) > 0 else None


def _mask(given: Any, change: PictureChange, orientation: int, where: str) -> np.ndarray | None:
    """A mask of the picture that is read, of COCO's polygons or run lengths, shape (H, W), bool; None without."""
    if isinstance(given, Mapping):
        return _mask_of_runs(given, change.picture, orientation, where)
    if not isinstance(given, list) or not given:
        return None
    from PIL import Image, ImageDraw

    image = Image.new("1", change.picture[::-1])
    for polygon in given if isinstance(given[0], list) else [given]:
        if not isinstance(polygon, list) or len(polygon) < 6 or len(polygon) % 2 or not all(map(_is_place, polygon)):
            raise InputError(f"{where}: {shown(polygon)}; expected polygons x, y, x, y, ...")
        points = change.points(np.array(polygon, dtype=np.float64).reshape(-1, 2))
        ImageDraw.Draw(image).polygon(points.ravel().tolist(), fill=1)
    return np.asarray(image, dtype=bool)


def _is_place(number: Any) -> bool:
    return isinstance(number, int | float) and not isinstance(number, bool) and abs(number) <= LARGEST_COORDINATE


def _mask_of_runs(given: Mapping[str, Any], size: tuple[int, int], orientation: int, where: str) -> np.ndarray:
    """A mask of run lengths, which state a size of their own."""
    own = given.get("size")
    expected = f"size {shown(own)}; expected the picture's, {[*size]}"
    if not isinstance(own, list) or len(own) != 2 or not all(type(side) is int and side > 0 for side in own):
        raise InputError(f"{where}: {expected}")
    try:
        change = match_sizes((own[0], own[1]), size, orientation, where)
    except InputError:
        raise InputError(f"{where}: {expected}") from None
    return change.mask(decode_runs(given, change.annotated, where))


def decode_runs(given: Mapping[str, Any], size: tuple[int, int], where: str) -> np.ndarray:
    """A mask of COCO's run lengths: turns of nothing and mask, down the columns, as numbers or as text.

    Own, for it is short and lengths of files by others are checked; pycocotools writes what they say.

    Args:
        given: Mapping with "size" and "counts".
        size: Height and width (H, W) of the picture [px].
        where: Beginning of messages, such as the file's name.

    Returns:
        Mask, shape (H, W), bool.

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


def _owners(masks: Sequence[np.ndarray], size: tuple[int, int]) -> torch.Tensor:
    """Number of the person that each pixel shows, from 1 on; 0: nobody.

    Where masks overlap, the smaller one is in front.
    """
    owners = np.zeros(size, dtype=np.int32)
    for index in sorted(range(len(masks)), key=lambda index: -int(masks[index].sum())):
        owners[masks[index]] = index + 1
    return torch.from_numpy(owners)
