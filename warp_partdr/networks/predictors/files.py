"""Folders of checkpoints: the user's own, the local cache of the Hub, or, where it is asked for, a download.

Only JSON and safetensors are read: no pickles, and no code of a checkpoint.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from ...errors import InputError, cause, shown
from ...files.json_files import read_json

Say = Callable[[str], None]

DOWNLOAD = "hf:"  # begins a name that may be downloaded
_CONFIG, _WEIGHTS, _SHARDS = "config.json", "model.safetensors", "model.safetensors.index.json"
_INPUTS = ("processor_config.json", "preprocessor_config.json")
_FILES = (_CONFIG, _WEIGHTS, _SHARDS, "model-*.safetensors", *_INPUTS)
_LARGEST_INPUT = 4096  # [px]
_LEVELS = 255.0  # of a colour


class PictureInput(NamedTuple):
    """Form in which a network takes pictures.

    Attributes:
        size: Height and width (H, W) of the pictures [px].
        mean: Mean of each colour, which is subtracted. Colours are from 0 to 1.
        deviation: Standard deviation of each colour, by which the difference is divided.
        longest: Greatest length of the longer side, for whole pictures that keep their shape [px]. The shorter side
            then has that of ``size``. If it is None, the file says nothing of this.
    """

    size: tuple[int, int]
    mean: tuple[float, float, float]
    deviation: tuple[float, float, float]
    longest: int | None = None


def find_checkpoint(name: str, say: Say) -> Path:
    """Folder of a checkpoint.

    Args:
        name: A folder, a name of the Hub that is in the local cache, or ``hf:`` and a name, which may be downloaded.
        say: Function that is told what is downloaded, before it is.

    Raises:
        InputError: If it is none of these, or has no configuration or no safetensors.
    """
    folder = Path(name).expanduser()
    if not folder.is_dir():
        folder = _downloaded(name, say) if name.startswith(DOWNLOAD) else _cached(name)
    if not (folder / _CONFIG).is_file():
        raise InputError(f"{name}: no {_CONFIG}; expected a checkpoint of transformers")
    if not weight_files(folder):
        raise InputError(f"{name}: no {_WEIGHTS}; expected weights as safetensors (pickles are not read)")
    return folder


def weight_files(folder: Path) -> list[Path]:
    """Files of a checkpoint's weights, one or, of a large one, several."""
    if (folder / _WEIGHTS).is_file():
        return [folder / _WEIGHTS]
    return sorted(folder.glob("model-*.safetensors")) if (folder / _SHARDS).is_file() else []


def _cached(name: str) -> Path:
    from huggingface_hub import snapshot_download

    expected = f"a folder, or {DOWNLOAD}ORG/NAME, which may be downloaded"
    if name.startswith((".", "/", "~")):
        raise InputError(f"{name}: no such folder; expected {expected}")
    try:
        return Path(snapshot_download(name, local_files_only=True))
    except Exception as error:  # of the name, of the cache
        raise InputError(f"{name}: no such folder, and not in the Hub's local cache; expected {expected}") from error


def _downloaded(name: str, say: Say) -> Path:
    from huggingface_hub import snapshot_download

    repository = name.removeprefix(DOWNLOAD)
    try:
        files = snapshot_download(repository, allow_patterns=list(_FILES), dry_run=True)
        size = sum(file.file_size or 0 for file in files if file.will_download)
        if size:
            say(f"downloading {repository}: {_megabytes(size)} to the Hub's local cache")
        return Path(snapshot_download(repository, allow_patterns=list(_FILES)))
    except Exception as error:  # of the connection, the name, a licence to be accepted first
        with suppress(Exception):  # an older download serves where there is no connection
            return Path(snapshot_download(repository, local_files_only=True))
        raise InputError(f"{name}: {cause(error)}; expected a checkpoint that can be downloaded") from error


def describe(name: str, kind: str, parameters: int, folder: Path) -> str:
    """Line on a network: its name, class and size."""
    size = sum(path.stat().st_size for path in weight_files(folder))
    return f"{name}: {kind}, {parameters / 1e6:.3g} million parameters, {_megabytes(size)}"


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.3g} MB" if size < 1e9 else f"{size / 1e9:.3g} GB"


def read_input(folder: Path, name: str) -> PictureInput:
    """Form of pictures that a checkpoint's image processor makes.

    Its resizing and cutting are not: a person's crop has the final size at once.

    Raises:
        InputError: If no file says it, or one says something else.
    """
    files = [folder / each for each in _INPUTS if (folder / each).is_file()]
    if not files:
        raise InputError(f"{name}: no {_INPUTS[1]}; expected one, with the size and colours of its pictures")
    read = [read_json(path, "an image processor's settings") for path in files]
    objects = [data for data in read if isinstance(data, Mapping)]
    nested = [data["image_processor"] for data in objects if isinstance(data.get("image_processor"), Mapping)]
    data: Mapping[str, Any] = (nested or objects or [{}])[-1]
    try:
        return _picture_input(data)
    except (TypeError, ValueError, KeyError) as error:
        raise InputError(f"{files[-1]}: {cause(error)}") from error


def _picture_input(data: Mapping[str, Any]) -> PictureInput:
    size = _size(data.get("crop_size") if data.get("do_center_crop") else data.get("size"))
    scale = _LEVELS * float(data.get("rescale_factor", 1 / _LEVELS)) if data.get("do_rescale", True) else _LEVELS
    normalised = data.get("do_normalize", True)
    mean, deviation = (
        tuple(float(value) / scale for value in (data[key] if normalised else [default] * 3))
        for key, default in (("image_mean", 0.0), ("image_std", 1.0))
    )
    if len(mean) != 3 or len(deviation) != 3 or not min(deviation) > 0:
        raise ValueError(
            f"image_mean, image_std: {len(mean)} and {len(deviation)} numbers; expected 3 colours, above 0"
        )
    return PictureInput(size, mean, deviation, _longest(data))


def _longest(data: Mapping[str, Any]) -> int | None:
    """Most that a longer side may have, of an image processor that keeps a picture's shape."""
    given = data.get("size")
    side = (
        given.get("longest_edge") if isinstance(given, Mapping) and "shortest_edge" in given else data.get("max_size")
    )
    if side is None or (isinstance(given, Mapping) and "height" in given):
        return None
    if not _is_side(side):
        raise ValueError(f"longest_edge: {shown(side)}; expected from 1 to {_LARGEST_INPUT}")
    return int(side)


def _size(given: Any) -> tuple[int, int]:
    """Size (H, W) of an image processor's size, which has several forms; a side alone is a square's."""
    sides: Any = given
    if isinstance(given, Mapping):
        side = next((given[key] for key in ("shortest_edge", "longest_edge") if key in given), None)
        sides = (given.get("height", side), given.get("width", side))
    elif isinstance(given, int):
        sides = (given, given)
    if not (isinstance(sides, tuple | list) and len(sides) == 2 and all(_is_side(side) for side in sides)):
        raise ValueError(f"size: {shown(given)}; expected height and width, from 1 to {_LARGEST_INPUT}")
    return sides[0], sides[1]


def _is_side(value: Any) -> bool:
    return type(value) is int and 1 <= value <= _LARGEST_INPUT
