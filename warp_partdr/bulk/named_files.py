"""Photos and films that a user names, alone or by their folder, with the names of their results."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError, printable
from ..inputs.films import FILM_SUFFIXES, check_pyav, film_facts, is_film
from ..inputs.photo_files import PHOTO_SUFFIXES, LeftOut, is_hidden_name, photos_among


@dataclass(frozen=True)
class NamedFile:
    """A photo or a film.

    Attributes:
        path: The file.
        name: Name of its results.
    """

    path: Path
    name: str

    @property
    def is_film(self) -> bool:
        """True for a film."""
        return is_film(self.path)

    @property
    def shown(self) -> str:
        """The file's name as reports have it."""
        return printable(self.path.name)


def named_files(paths: Sequence[Path], left_out: LeftOut) -> list[NamedFile]:
    """Photos and films, those of folders by name; two of one name are told apart by their endings.

    Args:
        paths: Photos, films, and folders of them.
        left_out: Counts files in folders that are neither.

    Raises:
        InputError: If a path is not there, a folder has no photo or film, or two folders have files of one name.
    """
    files: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            there = _pictures(path, left_out)
            if not there:
                told = f"no photos or films in it{f' ({left_out})' if left_out else ''}"
                raise InputError(f"{path}: {told}; expected some: {', '.join(PHOTO_SUFFIXES)}, .mp4 ...")
            files |= dict.fromkeys(there)
        elif os.path.lexists(path):  # a pipe, too, which reading it tells
            files[path] = None
        else:
            raise InputError(f"{path}: No such file or folder; expected a photo, a film, or a folder of them")
    stems = Counter(path.stem for path in files)
    named = [NamedFile(path, printable(path.stem if stems[path.stem] == 1 else path.name)) for path in files]
    for name, count in Counter(file.name for file in named).items():
        if count > 1:
            raise InputError(f"{name}: in two of the folders; expected different names, or one folder at a time")
    return named


def _pictures(folder: Path, left_out: LeftOut) -> list[Path]:
    """Photos and films in a folder, but not in folders in it."""
    names: list[str] = []
    for each in sorted(folder.iterdir()):
        if not each.is_dir():
            names.append(each.name)
        elif not is_hidden_name(each.name):
            left_out.count("folder", "folders are not searched")
    return [folder / name for name in photos_among(names, left_out, FILM_SUFFIXES)]


def count_pictures(files: Iterable[NamedFile]) -> int | None:
    """Number of photos and frames in all files; None where a film does not tell.

    Raises:
        InputError: If there is a film, and PyAV is not installed.
    """
    total = 0
    for file in files:
        if not file.is_film:
            total += 1
            continue
        check_pyav(file.path)
        try:
            frames = film_facts(file.path).frames
        except InputError:
            continue  # told when its turn comes
        if not frames:
            return None
        total += frames
    return total
