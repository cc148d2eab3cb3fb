"""Read a photo and its focal length, a label set and part labels.

Labels come as an image of ids, 8- or 16-bit, one channel, grayscale or palette (``.png``), or as an array (``.npy``):

* ids (H, W), whole numbers of any type;
* a network's probability maps (K, H, W) or (H, W, K), floats, with one channel per id of the label set;
* each person's ids alone (N, H, W), integers or booleans; in a set of one group, these are masks by instance. The type
  tells them from probabilities, because both may hold only 0 and 1.
"""

from __future__ import annotations

import errno
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..body.labels import BACKGROUND, IGNORE, LABEL_SETS, LabelSet, label_set
from ..errors import InputError, cause
from ..files.array_files import Header, read_npy
from ..files.disk import check_regular
from .photo_files import RAW_SUFFIXES, ending_of, foreign_format, is_heif

if TYPE_CHECKING:
    from PIL import Image

PhotoFile = str | Path | BytesIO  # file of a picture; messages call one in memory by its ``str``

# Largest photo or label image [px]: 134 megapixels, which fit in memory with all arrays that are made from them.
LARGEST_PICTURE = 2**27

# Endings of files that may hold several pictures of equal rank. In JPEG files, the pictures beside a phone's or a
# camera's own are smaller copies and depth maps.
_OF_SEVERAL = (".gif", ".png", ".apng", ".webp", ".tif", ".tiff", ".avif", ".avifs", ".heic", ".heif", ".hif")
_HEAD = 256  # bytes of a file that show its format
_DNG_VERSION = 50706  # TIFF tag of raw photos
_DEVELOPED = "it developed, such as to JPEG"

_FILM_DIAGONAL = math.hypot(36.0, 24.0)  # [mm]
_SHORTEST, _LONGEST = 4, 3000  # [mm], focal lengths of photos on 35 mm film; no lens has others
_CUT = 0.01  # change of the sides' ratio, above which a photo was cropped

_JPEG_END = b"\xff\xd9"  # not among the bytes of pixels

_MOST_MASKS = 16  # most masks of the largest pictures; smaller ones may have more

# 16-bit softmax outputs are off by 1e-3 in their sum.
_SUM_TOLERANCE = 1e-2

# A smaller probability is taken as 0. If 3 % were distributed over all classes, PA-MPJPE rose from 38.9 to 46.5 mm.
# Without the small probabilities it was 38.3 mm, and with only the likeliest labels 40.1 mm (people 200 to 215 of
# PartBench, "realistic").
_HAZE = 0.05


@dataclass(frozen=True)
class PartLabels:
    """Part labels of a picture.

    Attributes:
        label_set: Meaning of the group ids.
        groups: Group ids: 0 = background, 1 to G, 255 = ignore, shape (H, W), uint8.
        maps: Probabilities of background and groups, shape (G + 1, H, W), float32; None if the file had none. The rest
            to a sum of 1 is the probability of something that is ignored.
        instances: Group ids of each of N people alone, shape (N, H, W), uint8; None if the file had none. ``groups``
            are then those of all people, and ``person_labels`` returns one person's.

    Raises:
        InputError: If a shape or dtype is wrong, or a group id is not in the label set.
    """

    label_set: LabelSet
    groups: np.ndarray
    maps: np.ndarray | None = None
    instances: np.ndarray | None = None

    def __post_init__(self) -> None:
        groups, count = self.groups, self.label_set.num_groups
        if not isinstance(groups, np.ndarray) or groups.ndim != 2 or groups.dtype != np.uint8 or not groups.size:
            found = f"{groups.dtype} {groups.shape}" if isinstance(groups, np.ndarray) else type(groups).__name__
            raise InputError(f"groups: {found}; expected a picture of uint8 group ids (H, W)")
        # In bytes, 255 + 1 is 0, so one comparison checks all ids; most pictures hold no 255, and need no copy for it.
        if groups.max() > count and (groups + np.uint8(1)).max() > count + 1:
            strange = groups[(groups > count) & (groups != IGNORE)]
            raise InputError(f"groups: id {strange[0]}; expected 0 to {count} of {self.label_set.name}, or {IGNORE}")
        shape = (count + 1, *groups.shape)
        if self.maps is not None and (not isinstance(self.maps, np.ndarray) or self.maps.shape != shape):
            raise InputError(f"maps: shape {np.shape(self.maps)}; expected {shape}")
        masks = self.instances
        if masks is not None and (not isinstance(masks, np.ndarray) or masks.shape[1:] != groups.shape):
            raise InputError(f"instances: shape {np.shape(masks)}; expected (N, {groups.shape[0]}, {groups.shape[1]})")


_ON_ITS_SIDE = (5, 6, 7, 8)  # EXIF's orientations in which width and height change places


def read_labelled_parts(parts: Path | None, labels: str | None) -> PartLabels | None:
    """Read the part labels that the options --parts and --labels give; None without --parts.

    Args:
        parts: File of the labels.
        labels: Name or JSON file of the label set; None: ``labels.json`` beside the file describes the ids.

    Raises:
        InputError: If there is a file without a label set, a label set without a file, or if one of them is wrong.
    """
    if parts is None:
        if labels is not None:
            raise InputError(f"--labels: {labels}, without part labels; expected --parts with it")
        return None
    if labels is not None:
        return read_parts(parts, label_set(labels))
    beside = parts.with_name("labels.json")
    if not beside.is_file():
        raise InputError(
            f"--labels: missing; expected what the ids of {parts} mean: one of {', '.join(LABEL_SETS)}, or a JSON file"
        )
    return read_parts(parts, label_set(beside))


def read_photo(path: PhotoFile) -> np.ndarray:
    """Read a picture, RGB, turned upright by its EXIF data, shape (H, W, 3), uint8; the first one of several in a file.

    Pillow reads it, and for HEIC pillow-heif (the extra "heic"), whatever the file's ending is.

    Raises:
        InputError: If the file can't be read, or the picture is larger than 2**27 pixels.

    Examples:
        >>> from warp_partdr import read_photo
        >>> photo = read_photo("photo.png")
        >>> photo.shape, photo.dtype
        ((512, 384, 3), dtype('uint8'))
    """
    from PIL import Image, ImageOps

    with _opened(path, "a picture") as image:
        ImageOps.exif_transpose(image, in_place=True)
        upright = image
        if upright.mode.startswith("I"):  # 16-bit gray, which PIL would turn to white, except for the darkest
            upright = Image.fromarray((np.asarray(upright) >> 8).clip(0, 255).astype(np.uint8))
        return np.array(upright if upright.mode == "RGB" else upright.convert("RGB"))


def photo_warnings(path: PhotoFile) -> tuple[str, ...]:
    """Warning if a photo's file holds several pictures, as an animated GIF does; else none."""
    if ending_of(str(path)) not in _OF_SEVERAL:
        return ()
    try:
        with _opened(path, "a picture") as image:
            count = int(getattr(image, "n_frames", 1))
    except InputError:  # reading the photo raises it, too
        return ()
    return (f"{count} pictures in the file; the first is taken",) if count > 1 else ()


class ScannedPhoto(NamedTuple):
    """Photo that was looked through, but not kept.

    Attributes:
        file: File of the photo.
        size: Size (H, W) [px] that ``read_photo`` would give it.
        orientation: Orientation in its EXIF data, as ``read_orientation`` returns it.
    """

    file: PhotoFile
    size: tuple[int, int]
    orientation: int

    @classmethod
    def of(cls, path: PhotoFile) -> ScannedPhoto:
        """Check that a picture's file is complete.

        A JPEG with an end marker is not decoded, which takes a twentieth of the time or less.

        Raises:
            InputError: If the file can't be read, or is cut off.
        """
        from PIL import ExifTags

        with _opened(path, "a picture") as image:
            width, height = image.size
            orientation = _orientation(image)
            # The search begins where PIL has stopped, at the pixels: an embedded small picture before them has an end.
            if image.format != "JPEG" or _JPEG_END not in image.fp.read():  # type: ignore[attr-defined]  # of all files
                image.draft("L", (1, 1))
                image.load()
            turned = image.getexif().get(ExifTags.Base.Orientation) in _ON_ITS_SIDE
            return cls(path, (width, height) if turned else (height, width), orientation)


def scan_photo(path: PhotoFile) -> tuple[int, int]:
    """Check that a picture's file is complete, and return the size (H, W) [px] that ``read_photo`` would give it.

    Raises:
        InputError: If the file can't be read, or is cut off.
    """
    return ScannedPhoto.of(path).size


def read_focal(path: PhotoFile) -> float:
    """Read the focal length [px] from a photo's EXIF data, which state it for 35 mm film; the diagonals are compared.

    Raises:
        InputError: If the file can't be read, does not state a focal length, or was cropped afterwards.
    """
    from PIL import ExifTags

    with _opened(path, "a picture") as image:
        exif = image.getexif().get_ifd(ExifTags.IFD.Exif)
        focal = _number(exif.get(ExifTags.Base.FocalLengthIn35mmFilm))
        taken = _number(exif.get(ExifTags.Base.ExifImageWidth)), _number(exif.get(ExifTags.Base.ExifImageHeight))
        size = image.size
    if not focal > 0:
        raise InputError(f"{path}: no focal length in its EXIF data; expected the one on 35 mm film")
    if not _SHORTEST <= focal <= _LONGEST:
        raise InputError(f"{path}: {focal:g} mm on 35 mm film in its EXIF data; expected {_SHORTEST} to {_LONGEST}")
    if all(taken) and abs(min(size) / max(size) - min(taken) / max(taken)) > _CUT:
        raise InputError(
            f"{path}: {size[0]:g}x{size[1]:g}, but {taken[0]:g}x{taken[1]:g} in its EXIF data; expected a photo that "
            "was not cut"
        )
    return focal / _FILM_DIAGONAL * math.hypot(*size)


def exif_focal_length(path: PhotoFile) -> float | None:
    """Focal length [px] as ``read_focal`` finds it; None if EXIF data do not state it."""
    try:
        return read_focal(path)
    except InputError:
        return None


def read_orientation(path: PhotoFile) -> int:
    """Read the orientation in a picture's EXIF data, 1 to 8, by which ``read_photo`` turns it; 1: it is stored upright.

    Raises:
        InputError: If the file can't be read.
    """
    with _opened(path, "a picture") as image:
        return _orientation(image)


def _orientation(image: Image.Image) -> int:
    """Orientation in an opened picture's EXIF data, 1 to 8."""
    from PIL import ExifTags
    from PIL.Image import Image as AnyImage

    # PNG's own getexif would decode all pixels, because EXIF data may follow them, although no program does that.
    orientation = AnyImage.getexif(image).get(ExifTags.Base.Orientation)
    return orientation if isinstance(orientation, int) and 1 <= orientation <= 8 else 1


def _number(value: Any) -> float:
    """Number in EXIF data, which may hold anything; 0 if it is no number."""
    try:
        return float(value)
    except (TypeError, ValueError, ArithmeticError):
        return 0.0


@contextmanager
def _opened(path: PhotoFile, expected: str) -> Iterator[Image.Image]:
    """Open a picture, whose pixels are read later; any fault until then becomes an InputError."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # PIL's, of large pictures and odd metadata
            with _open_image(path) as image:
                _check_pixels(path, image.width * image.height)
                yield image
    except InputError:
        raise
    except Image.DecompressionBombError as error:
        _check_pixels(path, 2 * (Image.MAX_IMAGE_PIXELS or 0) + 1)
        raise InputError(f"{path}: {cause(error)}; expected {expected}") from error
    except Exception as error:  # each of Pillow's formats raises its own kind of error for a damaged file
        raise InputError(f"{path}: {cause(error)}; expected {expected}") from error


def _open_image(path: PhotoFile) -> Image.Image:
    """Open a picture with Pillow, which gets its HEIF plugin at the first HEIF picture.

    Raises:
        InputError: If its format is known, but can't be read here.
    """
    from PIL import Image, UnidentifiedImageError

    if not isinstance(path, BytesIO):
        check_regular(path)
    if ending_of(str(path)) in RAW_SUFFIXES:  # Pillow would read the thumbnail in it
        raise InputError(f"{path}: a raw photo; expected {_DEVELOPED}")
    try:
        image: Image.Image = Image.open(path)
    except UnidentifiedImageError as error:
        head = _head(path)
        if is_heif(head) and find_spec("pillow_heif") is not None:
            from pillow_heif import register_heif_opener

            register_heif_opener()
            return Image.open(path)
        if (known := foreign_format(head)) is None:
            raise
        message = f"{path}: {known.name}; expected {known.expected}"
        if not head and not isinstance(path, BytesIO):  # maybe it is still being copied
            raise InputError(message) from OSError(errno.ENODATA, "an empty file")
        raise InputError(message) from (ModuleNotFoundError(known.library) if known.library else error)
    if image.format == "TIFF" and _DNG_VERSION in image.tag_v2:  # type: ignore[attr-defined]  # of TIFF
        image.close()
        raise InputError(f"{path}: a raw photo; expected {_DEVELOPED}")
    return image


def _head(path: PhotoFile) -> bytes:
    if isinstance(path, BytesIO):
        return path.getvalue()[:_HEAD]
    with open(path, "rb") as file:
        return file.read(_HEAD)


def _check_pixels(path: PhotoFile, pixels: int) -> None:
    if pixels > LARGEST_PICTURE:
        raise InputError(f"{path}: more than {LARGEST_PICTURE / 1e6:.0f} megapixels; expected a smaller picture")


def check_sizes(**sizes: tuple[int, int] | None) -> None:
    """Check that all sizes (H, W) are equal; None is skipped.

    Raises:
        InputError: If they are not: ``photo: 640x480; parts: 320x240; expected one size`` (width x height).

    Example::

        check_sizes(photo=photo.shape[:2], parts=groups.shape)
    """
    known = {name: size for name, size in sizes.items() if size is not None}
    if len(set(known.values())) > 1:
        shown = "; ".join(f"{name}: {width}x{height}" for name, (height, width) in known.items())
        raise InputError(f"{shown}; expected one size")


def read_parts(path: PhotoFile, labels: LabelSet | str | Path) -> PartLabels:
    """Read part labels from a ``.png`` or ``.npy`` file: ids of a label set, each person's ids, or probabilities.

    The module's docstring lists the shapes and types of arrays.

    Args:
        path: File of the labels.
        labels: Label set of the ids, its name, or its JSON file.

    Raises:
        InputError: If the label set or the file can't be read, or if the file is no label image, has more than 2**27
            pixels or ids outside the set, shows nobody, or shows a single part although the set has several groups.

    Examples:
        >>> from warp_partdr import read_parts
        >>> parts = read_parts("parts.png", "cdcl14")
        >>> parts.groups.shape, parts.groups.dtype
        ((512, 384), dtype('uint8'))
        >>> parts.label_set.group_names[:3]
        ('head', 'torso', 'right_upper_arm')
    """
    labels = label_set(labels)
    suffix = ".png" if isinstance(path, BytesIO) else Path(path).suffix.lower()
    if suffix == ".png":
        return _png_parts(path, labels)
    if suffix == ".npy" and not isinstance(path, BytesIO):
        return _npy_parts(path, labels)
    raise InputError(f"{path}: {suffix or 'no suffix'}; expected .png or .npy part labels")


def _png_parts(path: PhotoFile, labels: LabelSet) -> PartLabels:
    """Labels of a PNG's ids. Of bytes, only the part about the people is looked at, for most of it is background."""
    with _opened(path, "a PNG of part labels") as image:
        if image.mode not in ("1", "L", "P", "I", "I;16", "I;16B"):
            raise InputError(f"{path}: {image.mode} picture; expected one channel of label ids (grayscale or palette)")
        if image.mode not in ("L", "P") or labels.id_groups[0] != BACKGROUND:
            array = np.asarray(image)
            groups = _groups(array if array.dtype == np.uint8 else array.astype(np.int32), labels, str(path))
            return _with_content(PartLabels(labels, groups), groups, str(path))
        image.load()
        left, top, right, bottom = image.getbbox() or (0, 0, 1, 1)
        own = _groups(np.asarray(image.crop((left, top, right, bottom))), labels, str(path))
        groups = np.full((image.height, image.width), BACKGROUND, dtype=np.uint8)
        groups[top:bottom, left:right] = own
        return _with_content(PartLabels(labels, groups), own, str(path))


def _npy_parts(path: str | Path, labels: LabelSet) -> PartLabels:
    """Labels of an array's file, by its shape and type."""
    array = _read_npy(path, len(labels.channel_ids))
    if not array.size:
        raise InputError(f"{path}: shape {array.shape}; expected pixels")
    if array.ndim == 3 and array.dtype.kind == "f":
        parts = _from_probabilities(array, labels, str(path))
    elif array.ndim == 3:
        parts = _from_instances(array, labels, str(path))
    elif array.ndim == 2:
        parts = PartLabels(labels, _groups(array, labels, str(path)))
    else:
        raise InputError(f"{path}: shape {array.shape}; expected (H, W), (N, H, W) masks, or (K, H, W) probabilities")
    return _with_content(parts, parts.groups, str(path))


def _read_npy(path: str | Path, channels: int) -> np.ndarray:
    def check(header: Header) -> None:
        shape, dtype = header
        if dtype.kind not in "biuf":
            raise InputError(f"{path}: {dtype}; expected integers, bool, or floats")
        if len(shape) == 3 and dtype.kind != "f":
            _check_pixels(path, max(math.prod(shape[1:]), math.prod(shape) // _MOST_MASKS))
        else:
            _check_pixels(path, math.prod(shape) // (channels if len(shape) == 3 else 1))

    return read_npy(path, expected="a .npy array of part labels", check=check)


def _groups(ids: np.ndarray, labels: LabelSet, where: str) -> np.ndarray:
    """Convert an array of ids, which some programs save as floats, to group ids."""
    if ids.dtype.kind == "f":
        strange = ids[~np.isfinite(ids) | (ids != np.rint(ids))]
        if strange.size:
            raise InputError(
                f"{where}: {ids.dtype}, {strange[0]:g} among them; expected whole numbers, the labels' ids"
            )
        wide = ids.astype(np.promote_types(ids.dtype, np.float32), copy=False)
        ids = np.clip(wide, -1e9, 1e9).astype(np.int64)
    try:
        return labels.to_groups(ids)
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def _from_instances(array: np.ndarray, labels: LabelSet, where: str) -> PartLabels:
    instances = np.stack([_groups(layer, labels, where) for layer in array])
    groups = instances[0].copy()
    for layer in instances[1:]:
        np.copyto(groups, layer, where=((groups == BACKGROUND) | (groups == IGNORE)) & (layer != BACKGROUND))
    return PartLabels(labels, groups, instances=instances)


def _from_probabilities(array: np.ndarray, labels: LabelSet, where: str) -> PartLabels:
    channels = len(labels.channel_ids)
    if array.shape[0] != channels and array.shape[2] == channels:
        array = array.transpose(2, 0, 1)
    if array.shape[0] != channels:
        raise InputError(
            f"{where}: shape {array.shape}; expected ({channels}, H, W) or (H, W, {channels}), "
            f"one map per id of {labels.name}; or masks (N, H, W), as integers or bool"
        )
    array = array.astype(np.float32)
    low, high = float(array.min()), float(array.max())  # NaN if there is one.
    if not (low >= 0.0 and high <= 1.0 + _SUM_TOLERANCE):
        raise InputError(f"{where}: values from {low:g} to {high:g}; expected probabilities, 0 to 1")
    totals = array.sum(axis=0)
    if np.abs(totals - 1.0).max() > _SUM_TOLERANCE:
        raise InputError(
            f"{where}: class probabilities add up to {totals.min():g} to {totals.max():g}; expected 1 at each pixel"
        )
    return parts_from_maps(without_haze(labels.to_group_maps(array)), labels)


def without_haze(maps: np.ndarray) -> np.ndarray:
    """Set small probabilities of background and groups, (G + 1, H, W), to 0: a network gives each class a little.

    The rest to 1, which is ignored, becomes 0, too, if it is small. The others grow until all add up to 1 again.
    """
    ignored = 1.0 - maps.sum(axis=0)
    ignored[ignored < _HAZE] = 0.0
    clear = np.where(maps < _HAZE, 0.0, maps)
    clear /= (clear.sum(axis=0) + ignored).clip(min=_HAZE)
    return clear


def parts_from_maps(maps: np.ndarray, labels: LabelSet) -> PartLabels:
    """Make labels from probabilities of background and groups, (G + 1, H, W); the rest to 1 is ignored."""
    ignored = 1.0 - maps.sum(axis=0)
    groups = maps.argmax(axis=0).astype(np.uint8)
    groups[ignored > maps.max(axis=0)] = IGNORE
    return PartLabels(labels, groups, maps)


def _with_content(parts: PartLabels, shown: np.ndarray, where: str) -> PartLabels:
    """Labels, after a check of the part of them that may show people.

    Raises:
        InputError: If labels show nobody, or only one part: a silhouette, which is likely a mistake.
    """
    pixels = shown.tobytes()  # searching bytes takes a hundredth of the time of an array
    groups = list(islice((group for group in range(1, parts.label_set.num_groups + 1) if group in pixels), 2))
    if not groups:
        raise InputError(
            f"{where}: empty, no pixel of a body part; expected a person in the labels of {parts.label_set.name}"
        )
    if len(groups) == 1 and parts.label_set.num_groups > 1 and IGNORE not in pixels:
        name = parts.label_set.group_names[groups[0] - 1]
        raise InputError(
            f"{where}: one part only ({name}); expected several of {parts.label_set.name}, or the label set full1"
        )
    return parts
