"""Fit of a film: windows of frames, each a scene; what two of them share passes from one to the other.

A person's shape is found first, from frames spread over the whole film. With it windows know nothing of one another, so
a film may be of any length.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import torch

from ..body.rotations import nearest_rotation
from ..cameras import Perspective, zoomed
from ..clothing.anny import anny
from ..clothing.model import DetailedModel
from ..clothing.registration import Registered, ungrown
from ..detection.film_people import FilmPeople, kept_size, row_keypoints
from ..errors import check_type
from ..fit.fitting import Progress
from ..fit.photo import mask_labels, person_place
from .film_pieces import FilmPieces
from .fitting import SceneFit, fit_scene
from .options import SceneOptions
from .scene import PersonShape, Scene, Sight, View


@dataclass(frozen=True)
class Motion:
    """Motion of a person through a film.

    Attributes:
        model: The detailed model.
        frames: Of the film, in order, shape (T,), int64; also those between in which the person is not seen.
        shape: The person's.
        rotations: Local rotation of each joint, shape (T, J, 3, 3).
        translation: Position of the root joint in the camera frame [m], shape (T, 3).
    """

    model: DetailedModel
    frames: np.ndarray
    shape: PersonShape
    rotations: torch.Tensor
    translation: torch.Tensor

    def bodies(self, rows: slice = slice(None)) -> Registered:
        """Detailed bodies of some of the frames in the camera frame; all of a long film's take memory."""
        rotations = self.rotations[rows]
        values = self.shape.values.expand(len(rotations), -1)
        return ungrown(self.model, values, rotations, self.translation[rows], {})


@dataclass(frozen=True)
class FilmFit:
    """Bodies of the people of a film.

    Attributes:
        people: Who was seen.
        camera: The film's, in its pixels; it stands still, and the world is its frame.
        motions: By person.
    """

    people: FilmPeople
    camera: Perspective
    motions: dict[int, Motion]


def fit_film(
    people: FilmPeople,
    *,
    camera: Perspective | None = None,
    person: int | None = None,
    options: SceneOptions | None = None,
    model: DetailedModel | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    pieces: FilmPieces | None = None,
) -> FilmFit:
    """Fit detailed bodies to the people of a film: one shape each, a pose a frame, smooth in time.

    Args:
        people: Of ``find_film_people``.
        camera: The film's; default: one whose focal length is the picture's diagonal.
        person: This one alone, 0 = the most and largest seen; the others' pixels are still known to be theirs.
        options: Of windows, and of their fits; default: ``SceneOptions.film()``.
        model: On the device, float32; default Anny.
        device: "cpu" or a CUDA device.
        progress: Called with (stage name, steps done, steps in all).
        pieces: What an earlier run of the same fit has done already, and where this one keeps what it does.

    Raises:
        InputError: If there are not so many people.
        TypeError: If an argument is of another type.
    """
    check_type("people", people, FilmPeople, "of find_film_people")
    check_type("camera", camera, Perspective | None, "such as Perspective.of_picture(size, focal=1500)")
    options, model = options or SceneOptions.film(), model or anny(device)
    camera = camera or Perspective.of_picture(people.image_size, focal=math.hypot(*people.image_size))
    everyone = range(people.num_people) if person is None else [person_place(person, people.num_people)]
    film = _Film(people, camera, tuple(everyone))
    tell = progress or (lambda name, done, total: None)

    def kept(name: str, scene: Scene, chosen: SceneOptions) -> _Bodies:
        def fit() -> dict[str, np.ndarray]:
            return vars(_Bodies.of(fit_scene(scene, options=chosen, model=model, device=device)))

        names = [field.name for field in fields(_Bodies)]
        return _Bodies(**(fit() if pieces is None else pieces.piece(name, names, fit)))

    parts = list(film.windows(options))
    shapes: dict[int, PersonShape] = {}
    if len(parts) > 1:
        apart = replace(options, smoothing=0.0)  # frames that are far from one another
        for place, track in enumerate(film.tracks):
            tell("shapes", place, len(film.tracks))
            scene = film.surest(track, options.shape_frames)
            shapes[track] = kept(f"shape{track}", scene, apart).shapes[0]
    found = {track: _Blend() for track in film.tracks}
    for place, part in enumerate(parts):
        tell("motions", place, len(parts))
        tracks, scene = film.scene(part, shapes)
        window = kept(f"window{place}", scene, options)
        for person, track in enumerate(tracks):
            found[track].add(part, window, person)
    tell("motions", len(parts), len(parts))
    return FilmFit(people, camera, {track: found[track].motion(model, film.span(track)) for track in film.tracks})


@dataclass(frozen=True)
class _Film:
    """Film whose scenes are wanted."""

    people: FilmPeople
    camera: Perspective
    tracks: tuple[int, ...]

    def span(self, track: int) -> range:
        """Frames from the first in which a person is seen to the last."""
        frames = self.people.of(track)["frames"]
        return range(int(frames[0]), int(frames[-1]) + 1)

    def windows(self, options: SceneOptions) -> Iterable[range]:
        """Frames that are fitted together; those in which nobody is seen are left out."""
        seen = self._rows()["frames"]
        for window in windows(int(seen.min()), int(seen.max()) + 1, options.window, options.overlap):
            inside = seen[(seen >= window.start) & (seen < window.stop)]
            if len(inside):
                yield range(int(inside.min()), int(inside.max()) + 1)

    def scene(self, window: range, shapes: Mapping[int, PersonShape]) -> tuple[list[int], Scene]:
        """People of some frames, and the scene of them."""
        rows = self._rows()
        rows = rows[(rows["frames"] >= window.start) & (rows["frames"] < window.stop)]
        tracks = np.unique(rows["tracks"]).tolist()
        sights = [self._sight(row, tracks.index(row["tracks"]), int(row["frames"]) - window.start) for row in rows]
        known = {tracks.index(track): shape for track, shape in shapes.items() if track in tracks}
        return tracks, Scene([self._view()], sights, self.people.rate, known)

    def surest(self, track: int, count: int) -> Scene:
        """A person in so many frames, spread over the film, those where the keypoints are surest."""
        rows = self.people.of(track)
        groups = np.array_split(rows, min(count, len(rows)))
        best = [group[group["keypoints"][..., 2].sum(1).argmax()] for group in groups]
        return Scene([self._view()], [self._sight(row, 0, place) for place, row in enumerate(best)])

    def _rows(self) -> np.ndarray:
        return self.people.rows[np.isin(self.people.rows["tracks"], self.tracks)]

    def _view(self) -> View:
        size = kept_size(self.people.image_size)
        camera = zoomed(self.camera, self._zoom(), size)
        assert isinstance(camera, Perspective)
        return View(camera)

    def _zoom(self) -> float:
        return kept_size(self.people.image_size)[1] / self.people.image_size[1]

    def _sight(self, row: np.ndarray, person: int, frame: int) -> Sight:
        full = row_keypoints(row)
        keypoints = replace(full, points=full.points * np.float32(self._zoom()))
        parts = mask_labels(self.people.owners(int(row["frames"])).astype(np.int32), int(row["places"]))
        return Sight(keypoints, parts, person, frame)


@dataclass(frozen=True)
class _Bodies:
    """Bodies of a scene of P people in T frames, small enough to be kept.

    Attributes:
        values: Shape values, shape (P, S).
        clothes: Thicknesses [m], shape (P, 8).
        rotations: Local rotation of each joint, shape (P, T, J, 3, 3).
        translation: Position of the root joint in the camera frame [m], shape (P, T, 3).
    """

    values: np.ndarray
    clothes: np.ndarray
    rotations: np.ndarray
    translation: np.ndarray

    @classmethod
    def of(cls, fit: SceneFit) -> _Bodies:
        """Those of a fit."""
        people = fit.scene.num_people, fit.scene.num_frames
        rotations, translation = (
            each.unflatten(0, people).cpu().numpy() for each in (fit.bodies.rotations, fit.bodies.translation)
        )
        values = fit.bodies.shape.unflatten(0, people)[:, 0].cpu().numpy()
        return cls(values, fit.clothes.cpu().numpy(), rotations, translation)

    @property
    def shapes(self) -> list[PersonShape]:
        """Of the people."""
        pairs = zip(self.values, self.clothes, strict=True)
        return [PersonShape(torch.from_numpy(values), torch.from_numpy(clothes)) for values, clothes in pairs]


class _Blend:
    """Poses of a person, of windows that share frames: each has most to say in its middle."""

    def __init__(self) -> None:
        self._sums: dict[int, tuple[float, torch.Tensor, torch.Tensor]] = {}
        self._shape: PersonShape | None = None

    def add(self, window: range, bodies: _Bodies, person: int) -> None:
        """Take a window's poses of a person."""
        self._shape = bodies.shapes[person]
        for row, frame in enumerate(window):
            share = float(min(frame - window.start, window.stop - 1 - frame) + 1)
            rotations, translation = (
                share * torch.from_numpy(each[person, row]) for each in (bodies.rotations, bodies.translation)
            )
            if frame in self._sums:
                before = self._sums[frame]
                share, rotations, translation = share + before[0], rotations + before[1], translation + before[2]
            self._sums[frame] = share, rotations, translation

    def motion(self, model: DetailedModel, span: range) -> Motion:
        """The motion in the frames of a span."""
        assert self._shape is not None
        frames = [frame for frame in sorted(self._sums) if frame in span]
        shares, rotations, translations = zip(*(self._sums[frame] for frame in frames), strict=True)
        like = model.rest_vertices
        return Motion(
            model,
            np.array(frames),
            PersonShape(self._shape.values.to(like), self._shape.clothes.to(like)),
            nearest_rotation(torch.stack(rotations)).to(like),
            (torch.stack(translations) / torch.tensor(shares)[:, None]).to(like),
        )


def windows(start: int, stop: int, length: int, overlap: int) -> list[range]:
    """Windows of so many frames, each sharing at least ``overlap`` with the one before; the last ends at ``stop``."""
    if stop - start <= length:
        return [range(start, stop)]
    firsts = [*range(start, stop - length, length - overlap), stop - length]
    return [range(first, first + length) for first in firsts]
