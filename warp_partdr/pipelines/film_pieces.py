"""Finished pieces of a fit of films. They are kept in a folder, so that a stopped run can continue where it was."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .. import __version__
from ..errors import InputError
from ..files.array_files import read_npz
from ..networks.detection.film_people import FilmPeople
from ..networks.predictors.film_predictions import PREDICTION_ARRAYS, FilmPredictions, GivenNetworks
from .observed_film import ObservedFilm

_PEOPLE = "image_size", "rate", "times", "rows", "packed", "sizes", "fault", "warnings", "cuts"
_FOLDER = ".partdr-film-"  # ``result_sets`` removes such folders after a day, if no run continues


class FilmPieces:
    """Finished pieces of one fit of films.

    Args:
        near: Folder for the results. Pieces are kept in it, or in the nearest folder above that exists.
        files: Films, and other files that the result depends on.
        *options: Everything else that the result depends on.
    """

    def __init__(self, near: Path, files: Sequence[Path], *options: object) -> None:
        parent = next((path for path in (near, *near.absolute().parents) if path.is_dir()), Path())
        stats = [(str(file.resolve()), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
        key = __version__, *stats, *map(repr, options)
        self.folder = parent / f"{_FOLDER}{hashlib.sha256(repr(key).encode()).hexdigest()[:16]}"

    def piece(
        self, name: str, arrays: Sequence[str], make: Callable[[], dict[str, np.ndarray]]
    ) -> dict[str, np.ndarray]:
        """Returns a piece, and makes it first if it is not there.

        Args:
            name: Name of the piece.
            arrays: Names of its arrays.
            make: Function that returns the arrays by their names.
        """
        if (known := self.known(name, arrays)) is not None:
            return known
        made = make()
        path = self._path(name)
        self.folder.mkdir(exist_ok=True)
        unfinished = path.with_suffix(".part.npz")
        np.savez(unfinished, **made)  # type: ignore[arg-type]
        os.replace(unfinished, path)
        return made

    def known(self, name: str, arrays: Sequence[str]) -> dict[str, np.ndarray] | None:
        """Returns the arrays of a piece, or None if it is not there."""
        path = self._path(name)
        if path.is_file():
            with suppress(InputError):  # the disk was full, for example
                return read_npz(path, arrays, expected="a piece of an unfinished run")
        return None

    def people(self, film: int, find: Callable[[], FilmPeople]) -> FilmPeople:
        """Returns the people of a film, and finds them first if they are not there."""
        return _people(self.piece(f"people{film}", _PEOPLE, lambda: _people_arrays(find())))

    def predictions(
        self, film: int, networks: GivenNetworks, find: Callable[[], tuple[FilmPeople, FilmPredictions]]
    ) -> tuple[FilmPeople, FilmPredictions]:
        """Returns a film's people and the predictions of given networks, and finds both first if they are not there."""

        def make() -> dict[str, np.ndarray]:
            people, predictions = find()
            return _people_arrays(people) | predictions.arrays()

        data = self.piece(f"predictions{film}", (*_PEOPLE, *PREDICTION_ARRAYS), make)
        return _people(data), FilmPredictions.of_arrays(data, networks)

    def starts(self, find: Callable[[], Sequence[float]]) -> list[float]:
        """Returns the times at which films show the first common instant [s], and finds them if they are not there."""
        data = self.piece("alignment", ("starts",), lambda: {"starts": np.array(find())})
        found: list[float] = data["starts"].tolist()
        return found

    def placed(self, films: Sequence[ObservedFilm], place: Callable[[], Sequence[ObservedFilm]]) -> list[ObservedFilm]:
        """Returns films with placed cameras, and places them first if their poses are not there."""

        def make() -> dict[str, np.ndarray]:
            views = [film.view for film in place()]
            rotations = torch.stack([view.rotation for view in views])
            translations = torch.stack([view.translation for view in views])
            return {"rotations": rotations.numpy(), "translations": translations.numpy()}

        data = self.piece("cameras", ("rotations", "translations"), make)
        return [
            film.standing(torch.from_numpy(rotation), torch.from_numpy(translation))
            for film, rotation, translation in zip(films, data["rotations"], data["translations"], strict=True)
        ]

    def remove(self) -> None:
        """Removes all pieces, when the result is written."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, name: str) -> Path:
        """File of a piece."""
        return self.folder / f"{name}.npz"


def _people(data: Mapping[str, np.ndarray]) -> FilmPeople:
    """People from their arrays."""
    starts = np.cumsum([0, *data["sizes"]])
    height, width = data["image_size"].tolist()
    whole = data["packed"].tobytes()
    return FilmPeople(
        image_size=(height, width),
        rate=float(data["rate"]),
        times=data["times"],
        rows=data["rows"],
        packed=tuple(whole[start:stop] for start, stop in pairwise(starts)),
        fault=str(data["fault"]),
        warnings=tuple(data["warnings"].tolist()),
        cuts=tuple(data["cuts"].tolist()),
    )


def _people_arrays(people: FilmPeople) -> dict[str, Any]:
    """Arrays of people, by the names in ``_PEOPLE``."""
    return {
        "image_size": np.array(people.image_size),
        "rate": np.array(people.rate),
        "times": people.times,
        "rows": people.rows,
        "packed": np.frombuffer(b"".join(people.packed), np.uint8),
        "sizes": np.array([len(each) for each in people.packed], np.int64),
        "fault": np.array(people.fault),
        "warnings": np.array(people.warnings, dtype=str),
        "cuts": np.array(people.cuts, np.int64),
    }
