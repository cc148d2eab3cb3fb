"""Files of detailed bodies that are written only when asked for: USD by ``usd-core``, FBX by Blender."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..clothing.registration import Registered
from ..errors import InputError
from .blender import check_blender, save_fbx
from .skinned_files import Poses
from .usd_files import check_usd, save_usd

_Save = Callable[[Registered, Path, Poses | None], None]
# By the files' endings: the check, whose message begins with its argument, and the writer.
FURTHER: Mapping[str, tuple[Callable[[str], object], _Save]] = {
    "usda": (check_usd, save_usd),
    "usdz": (check_usd, save_usd),
    "fbx": (check_blender, save_fbx),
}
FURTHER_FILES = tuple(f"detailed.{kind}" for kind in FURTHER)


def check_formats(option: str, formats: Sequence[str]) -> None:
    """Raise an InputError, which begins with ``option``, if one is unknown or what writes it is missing."""
    for name in formats:
        if name not in FURTHER:
            raise InputError(f"{option}: {name!r}; expected of {', '.join(FURTHER)}")
        FURTHER[name][0](f"{option}: {name}")


def save_further(registered: Registered, stem: Path, formats: Sequence[str], poses: Poses | None = None) -> list[str]:
    """Write the first body, or its motion, as ``stem`` with each ending; returns the files' names."""
    paths = [stem.with_name(f"{stem.name}.{kind}") for kind in formats]
    for kind, path in zip(formats, paths, strict=True):
        FURTHER[kind][1](registered, path, poses)
    return [path.name for path in paths]
