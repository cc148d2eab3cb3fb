"""Pieces of a fit of films that are done, kept in a folder, so that a run that was ended goes on where it was."""

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
_FOLDER = ".partdr-film-"  # of ``result_sets``' own kind: what nobody goes on with is removed after a day


class FilmPieces:
    """Pieces of one fit of films.

    Args:
        near: Folder for the results; pieces lie in it, or in the nearest one above that exists.
        films: The films' files, and others that the result depends on.
        *how: All else that it depends on.
    """

    def __init__(self, near: Path, films: Sequence[Path], *how: object) -> None:
        there = next((path for path in (near, *near.absolute().parents) if path.is_dir()), Path())
        stats = [(str(film.resolve()), film.stat().st_size, film.stat().st_mtime_ns) for film in films]
        about = __version__, *stats, *map(repr, how)
        self.folder = there / f"{_FOLDER}{hashlib.sha256(repr(about).encode()).hexdigest()[:16]}"

    def piece(
        self, name: str, arrays: Sequence[str], make: Callable[[], dict[str, np.ndarray]]
    ) -> dict[str, np.ndarray]:
        """Arrays of a piece by their names, which are made unless they are there."""
        if (known := self.known(name, arrays)) is not None:
            return known
        made, path = make(), self._path(name)
        self.folder.mkdir(exist_ok=True)
        unfinished = path.with_suffix(".part.npz")
        np.savez(unfinished, **made)  # type: ignore[arg-type]
        os.replace(unfinished, path)
        return made

    def known(self, name: str, arrays: Sequence[str]) -> dict[str, np.ndarray] | None:
        """Arrays of a piece, if it is there."""
        path = self._path(name)
        if path.is_file():
            with suppress(InputError):  # the disk was full, for example
                return read_npz(path, arrays, expected="a piece of an unfinished run")
        return None

    def people(self, film: int, find: Callable[[], FilmPeople]) -> FilmPeople:
        """People of a film, who are looked for unless they were found."""
        return _people(self.piece(f"people{film}", _PEOPLE, lambda: _people_arrays(find())))

    def observations(
        self, film: int, networks: GivenNetworks, find: Callable[[], tuple[FilmPeople, FilmPredictions]]
    ) -> tuple[FilmPeople, FilmPredictions]:
        """People of a film, and observations of them by networks of others; both are looked for unless they were found."""

        def make() -> dict[str, np.ndarray]:
            people, observations = find()
            return _people_arrays(people) | observations.arrays()

        data = self.piece(f"observations{film}", (*_PEOPLE, *PREDICTION_ARRAYS), make)
        return _people(data), FilmPredictions.of_arrays(data, networks)

    def starts(self, find: Callable[[], Sequence[float]]) -> list[float]:
        """Times at which films show the first moment of all [s], which are looked for unless they were found."""
        found: list[float] = self.piece("moments", ("starts",), lambda: {"starts": np.array(find())})["starts"].tolist()
        return found

    def placed(self, films: Sequence[ObservedFilm], place: Callable[[], Sequence[ObservedFilm]]) -> list[ObservedFilm]:
        """Films whose cameras stand where they were placed, which is done unless it was."""

        def make() -> dict[str, np.ndarray]:
            views = [film.view for film in place()]
            turns, moves = zip(*((view.rotation, view.translation) for view in views), strict=True)
            return {"rotations": torch.stack(turns).numpy(), "translations": torch.stack(moves).numpy()}

        data = self.piece("cameras", ("rotations", "translations"), make)
        places = zip(films, data["rotations"], data["translations"], strict=True)
        return [film.standing(torch.from_numpy(turn), torch.from_numpy(move)) for film, turn, move in places]

    def remove(self) -> None:
        """Remove them all, when the result is written."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.npz"


def _people(data: Mapping[str, np.ndarray]) -> FilmPeople:
    starts = np.cumsum([0, *data["sizes"]])
    height, width = data["image_size"].tolist()
    whole = data["packed"].tobytes()
    packed = tuple(whole[start:stop] for start, stop in pairwise(starts))
    told = str(data["fault"]), tuple(data["warnings"].tolist()), tuple(data["cuts"].tolist())
    return FilmPeople((height, width), float(data["rate"]), data["times"], data["rows"], packed, *told)


def _people_arrays(people: FilmPeople) -> dict[str, Any]:
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
