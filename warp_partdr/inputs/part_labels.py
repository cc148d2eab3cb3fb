"""Read a photo and its focal length, a label set and part labels.

Labels come as an image of ids, 8- or 16-bit, one channel, grayscale or palette (``.png``), or as an array (``.npy``):

* ids (H, W), whole numbers of any type;
* a network's probability maps (K, H, W) or (H, W, K), floats, with one channel per id of the label set;
* each person's ids alone (N, H, W), integers or booleans: in a set of one group, masks by instance. The type tells them
  from probabilities, for both may hold nothing but 0 and 1.
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
from typing import TYPE_CHECKING, Any

import numpy as np

from ..body.labels import BACKGROUND, IGNORE, LABEL_SETS, LabelSet, label_set
from ..errors import InputError, cause
from ..files.array_files import Header, read_npy
from ..files.disk import check_regular
from .photo_files import RAW_SUFFIXES, ending_of, foreign_format, is_heif

if TYPE_CHECKING:
    from PIL import Image

PhotoFile = str | Path | BytesIO  # of a picture; one in memory is called ``str`` of it in messages

# [px], of a photo or label image: 134 megapixels, which fit in memory with all that is made of them.
LARGEST_PICTURE = 2**27

# Of files that may hold several pictures of equal rank. Those beside a phone's or camera's own, in JPEG, are smaller
# copies and depth maps.
_OF_SEVERAL = (".gif", ".png", ".apng", ".webp", ".tif", ".tiff", ".avif", ".avifs", ".heic", ".heif", ".hif")
_HEAD = 256  # bytes of a file that tell its format
_DNG_VERSION = 50706  # tag of TIFF that a raw photo has
_DEVELOPED = "it developed, such as to JPEG"

_FILM_DIAGONAL = math.hypot(36.0, 24.0)  # [mm]
_SHORTEST, _LONGEST = 4, 3000  # [mm], focal lengths of photos on 35 mm film; others are none that lenses have
_CUT = 0.01  # change of the sides' ratio that says a photo was cut

_JPEG_END = b"\xff\xd9"  # not among the bytes of pixels

_MOST_MASKS = 16  # of the largest pictures; of smaller ones more

# 16-bit softmax outputs are off by 1e-3 in their sum.
_SUM_TOLERANCE = 1e-2

# Probability that is none. Where 3 % were spread over all classes, PA-MPJPE rose from 38.9 to 46.5 mm, and without the
# small ones it was 38.3 mm; the likeliest labels alone gave 40.1 mm (people 200 to 215 of PartBench, "realistic").
_HAZE = 0.05


@dataclass(frozen=True)
class PartLabels:
    """Part labels of a picture.

    Attributes:
        label_set: What the groups are.
        groups: Group ids: 0 = background, 1 to G, 255 = ignore, shape (H, W), uint8.
        maps: Probabilities of background and groups, shape (G + 1, H, W), float32, where the file had such; what is
            missing to a sum of 1 is the probability of something to be ignored.
        instances: Group ids of each of N people alone, shape (N, H, W), uint8, where the file had such; ``groups`` are
            then anybody's, and ``person_labels`` picks one person's.
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
        # In bytes 255 + 1 is 0: one look tells that no id is strange.
        if (groups + np.uint8(1)).max() > count + 1:
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
    """Read the part labels of the options --parts and --labels; None without.

    Without ``labels``, the name or JSON file of a set, ``labels.json`` beside the file describes the ids.

    Raises:
        InputError: If there is no label set, a label set of no file, or one of them is wrong.
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
    """Read a picture, turned upright by its EXIF data, shape (H, W, 3), uint8; of several in a file, the first.

    Pillow reads it, HEIC with pillow-heif (the extra "heic"), whatever the file's ending is.

    Raises:
        InputError: If the file can't be read, or the picture is larger than 2**27 pixels.
    """
    from PIL import Image, ImageOps

    with _opened(path, "a picture") as image:
        ImageOps.exif_transpose(image, in_place=True)
        upright = image
        if upright.mode.startswith("I"):  # 16-bit gray, of which PIL would make all but the darkest white
            upright = Image.fromarray((np.asarray(upright) >> 8).clip(0, 255).astype(np.uint8))
        return np.array(upright if upright.mode == "RGB" else upright.convert("RGB"))


def photo_warnings(path: PhotoFile) -> tuple[str, ...]:
    """A sentence if there are several pictures in a photo's file, such as in an animated GIF; else none."""
    if ending_of(str(path)) not in _OF_SEVERAL:
        return ()
    try:
        with _opened(path, "a picture") as image:
            count = int(getattr(image, "n_frames", 1))
    except InputError:  # which reading it tells
        return ()
    return (f"{count} pictures in the file; the first is taken",) if count > 1 else ()


def scan_photo(path: PhotoFile) -> tuple[int, int]:
    """Look through a picture to its end, and give the (H, W) that ``read_photo`` would, or its error if it is cut off.

    JPEG with a mark of its end is not decoded, which takes a twentieth of the time or less.
    """
    from PIL import ExifTags

    with _opened(path, "a picture") as image:
        width, height = image.size
        # Before its pixels, where PIL has stopped, there may be the end of a small picture.
        if image.format != "JPEG" or _JPEG_END not in image.fp.read():  # type: ignore[attr-defined]  # of all files
            image.draft("L", (1, 1))
            image.load()
        turned = image.getexif().get(ExifTags.Base.Orientation) in _ON_ITS_SIDE
        return (width, height) if turned else (height, width)


def read_focal(path: PhotoFile) -> float:
    """Focal length [px] from a photo's EXIF data, which say what it would be on 35 mm film; by the diagonal.

    Raises:
        InputError: If the file can't be read, does not say it, or was cut since.
    """
    from PIL import ExifTags

    with _opened(path, "a picture") as image:
        said = image.getexif().get_ifd(ExifTags.IFD.Exif)
        tags = ExifTags.Base.FocalLengthIn35mmFilm, ExifTags.Base.ExifImageWidth, ExifTags.Base.ExifImageHeight
        focal, *was = (_number(said.get(tag)) for tag in tags)
        size = image.size
    if not focal > 0:
        raise InputError(f"{path}: no focal length in its EXIF data; expected the one on 35 mm film")
    if not _SHORTEST <= focal <= _LONGEST:
        told = f"{focal:g} mm on 35 mm film in its EXIF data"
        raise InputError(f"{path}: {told}; expected {_SHORTEST} to {_LONGEST}")
    if all(was) and abs(min(size) / max(size) - min(was) / max(was)) > _CUT:
        now, then = (f"{width:g}x{height:g}" for width, height in (size, was))
        raise InputError(f"{path}: {now}, but {then} in its EXIF data; expected a photo that was not cut")
    return focal / _FILM_DIAGONAL * math.hypot(*size)


def told_focal(path: PhotoFile) -> float | None:
    """Focal length [px] as of ``read_focal``; None where EXIF data do not tell it."""
    try:
        return read_focal(path)
    except InputError:
        return None


def read_orientation(path: PhotoFile) -> int:
    """Orientation in a picture's EXIF data, 1 to 8, by which ``read_photo`` turns it; 1: it is stored upright.

    Raises:
        InputError: If the file can't be read.
    """
    from PIL import ExifTags, Image

    with _opened(path, "a picture") as image:
        # PNG's own getexif would decode all pixels, for these data may stand behind them, where nobody puts them.
        told = Image.Image.getexif(image).get(ExifTags.Base.Orientation)
    return told if isinstance(told, int) and 1 <= told <= 8 else 1


def _number(value: Any) -> float:
    """A number of EXIF data, which may be anything; 0 if it is none."""
    try:
        return float(value)
    except (TypeError, ValueError, ArithmeticError):
        return 0.0


@contextmanager
def _opened(path: PhotoFile, expected: str) -> Iterator[Image.Image]:
    """Open a picture of which only the header is read yet; whatever goes wrong with it becomes an InputError."""
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
    except Exception as error:  # of many kinds: each of Pillow's formats has its own for a damaged file
        raise InputError(f"{path}: {cause(error)}; expected {expected}") from error


def _open_image(path: PhotoFile) -> Image.Image:
    """Open a picture by Pillow, which learns HEIF when the first one comes.

    Raises:
        InputError: If it is of a format that is known, but can't be read here.
    """
    from PIL import Image, UnidentifiedImageError

    if not isinstance(path, BytesIO):
        check_regular(path)
    if ending_of(str(path)) in RAW_SUFFIXES:  # in which Pillow finds a thumbnail
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
        told = f"{path}: {known.name}; expected {known.expected}"
        if not head and not isinstance(path, BytesIO):  # maybe it is still being copied
            raise InputError(told) from OSError(errno.ENODATA, "an empty file")
        raise InputError(told) from (ModuleNotFoundError(known.library) if known.library else error)
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
    """Raise unless all (H, W) are one: ``check_sizes(photo=photo.shape[:2], parts=groups.shape)``; None is skipped.

    Raises:
        InputError: ``photo: 640x480; parts: 320x240; expected one size`` (width x height).
    """
    known = {name: size for name, size in sizes.items() if size is not None}
    if len(set(known.values())) > 1:
        shown = "; ".join(f"{name}: {width}x{height}" for name, (height, width) in known.items())
        raise InputError(f"{shown}; expected one size")


def read_parts(path: PhotoFile, labels: LabelSet | str | Path) -> PartLabels:
    """Read part labels, ids of a label set, each person's or their probabilities, from a ``.png`` or ``.npy`` file.

    Args:
        path: The file.
        labels: What the ids mean, or what ``label_set`` takes.

    Raises:
        InputError: If the label set or the file can't be read, or this is no label image, has more than 2**27 pixels or
            ids outside the set, shows nobody, or, in a set of several groups, a single part.
    """
    labels = label_set(labels)
    suffix = ".png" if isinstance(path, BytesIO) else Path(path).suffix.lower()
    if suffix == ".png" or isinstance(path, BytesIO):
        array = _read_png(path)
    elif suffix == ".npy":
        array = _read_npy(path, len(labels.channel_ids))
    else:
        raise InputError(f"{path}: {suffix or 'no suffix'}; expected .png or .npy part labels")
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
    _check_content(parts, str(path))
    return parts


def _read_png(path: PhotoFile) -> np.ndarray:
    with _opened(path, "a PNG of part labels") as image:
        if image.mode not in ("1", "L", "P", "I", "I;16", "I;16B"):
            raise InputError(f"{path}: {image.mode} picture; expected one channel of label ids (grayscale or palette)")
        array = np.asarray(image)
        return array if array.dtype == np.uint8 else array.astype(np.int32)


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
    """Group ids of an array of ids, which many save as floats."""
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
    """Probabilities of background and groups, (G + 1, H, W), without those that a network spreads thinly over all.

    The same goes for what is ignored, the rest to 1. The others grow until all add up to 1 again.
    """
    ignored = 1.0 - maps.sum(axis=0)
    ignored[ignored < _HAZE] = 0.0
    clear = np.where(maps < _HAZE, 0.0, maps)
    clear /= (clear.sum(axis=0) + ignored).clip(min=_HAZE)
    return clear


def parts_from_maps(maps: np.ndarray, labels: LabelSet) -> PartLabels:
    """Labels from probabilities of background and groups, (G + 1, H, W); the rest to 1 is of what is ignored."""
    ignored = 1.0 - maps.sum(axis=0)
    groups = maps.argmax(axis=0).astype(np.uint8)
    groups[ignored > maps.max(axis=0)] = IGNORE
    return PartLabels(labels, groups, maps)


def _check_content(parts: PartLabels, where: str) -> None:
    """Refuse labels that show nobody, or one part only: no more than a silhouette, and likely a mistake."""
    there = parts.groups.tobytes()  # which is looked through in a hundredth of the time of an index
    shown = list(islice((group for group in range(1, parts.label_set.num_groups + 1) if group in there), 2))
    if not shown:
        raise InputError(
            f"{where}: empty, no pixel of a body part; expected a person in the labels of {parts.label_set.name}"
        )
    if len(shown) == 1 and parts.label_set.num_groups > 1 and IGNORE not in there:
        name = parts.label_set.group_names[shown[0] - 1]
        raise InputError(
            f"{where}: one part only ({name}); expected several of {parts.label_set.name}, or the label set full1"
        )
