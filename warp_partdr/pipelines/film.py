"""Fit of a film, or of several of one moment: windows of frames, each a scene, and what they share passes on.

A person's shape is found first, from frames spread over the whole film. With it windows know nothing of one another, so
a film may be of any length. Shots are fitted apart: no window reaches over a cut, and nobody is the same on both sides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial

import numpy as np
import torch

from ..body.landmarks import annotated
from ..body.rotations import nearest_rotation
from ..body.skeletons import skeleton
from ..cameras import Perspective
from ..errors import check_type
from ..inputs.scene import PersonShape, Scene, SceneObservation, View
from ..interop.ahead import made_ahead
from ..models.anny import anny
from ..models.measuring import statures
from ..models.model import DetailedModel
from ..models.registration import Registered, ungrown
from ..networks.detection.film_people import FilmPeople, shots_between
from ..networks.detection.person import SKELETON
from ..solve.ellipsoids.stages import Progress
from ..solve.mesh.observed_body import ObservedBody
from ..solve.scene.fitting import SceneFit, fit_scene
from ..solve.scene.impossible import impossible_people
from ..solve.scene.options import SceneOptions
from .camera_units import in_metres
from .film_observations import FilmObservations
from .film_pieces import FilmPieces
from .matched_times import shared_times, uneven_times
from .observed_film import ObservedFilm
from .photo import check_stature_owner, person_index
from .rig_faults import missing_rays, unmatched_films
from .same_people import Track, check_films, match_people

_COMPARED = 16  # frames of a person in a film, at most, whose keypoints are compared with the body's
# Mean distance [person's size in the picture]. Shaded people and real photos ended at 0.01 to 0.05, two people who were
# taken for one at 0.07 to 0.11.
_MOST_OFF = 0.06


@dataclass(frozen=True)
class Motion:
    """Motion of a person through a film.

    Attributes:
        model: The detailed model.
        frames: Of the film, in order, shape (T,), int64; also those between in which the person is not seen.
        shape: The person's.
        rotations: Local rotation of each joint, shape (T, J, 3, 3).
        translation: Position of the root joint in the world [m], shape (T, 3).
    """

    model: DetailedModel
    frames: np.ndarray
    shape: PersonShape
    rotations: torch.Tensor
    translation: torch.Tensor

    def bodies(self, rows: slice | np.ndarray = slice(None)) -> Registered:
        """Detailed bodies of some of the frames in the world; all of a long film's take memory."""
        rotations = self.rotations[rows]
        values = self.shape.values.expand(len(rotations), -1)
        return ungrown(self.model, values, rotations, self.translation[rows], {})


@dataclass(frozen=True)
class FilmFit:
    """Bodies of the people of a film, or of several.

    Attributes:
        films: The films; of one, the world is its camera's frame.
        tracks: Of each person, who it is in which film.
        motions: By person.
        warnings: Faults of films and cameras, a sentence each, in which films are films[0] and so on.
    """

    films: tuple[ObservedFilm, ...]
    tracks: dict[int, tuple[Track, ...]]
    motions: dict[int, Motion]
    warnings: tuple[str, ...] = ()

    @property
    def people(self) -> FilmPeople:
        """People who were seen in the first film."""
        return self.films[0].people

    @property
    def camera(self) -> Perspective:
        """Camera of the first film, in its pixels."""
        return self.films[0].view.camera

    @property
    def times(self) -> np.ndarray:
        """Times of the longest film's frames since its first one [s], shape (F,)."""
        return shared_times(self.films)

    @property
    def shots(self) -> list[range]:
        """Frames of each shot, which were fitted apart."""
        return film_shots(self.films)

    def rows(self, person: int, film: int = 0) -> np.ndarray:
        """Rows of ``FilmPeople`` of a person in a film, frame by frame."""
        return _rows_of(self.films, self.tracks[person], film)


def fit_film(
    films: Sequence[ObservedFilm],
    *,
    person: int | None = None,
    options: SceneOptions | None = None,
    model: DetailedModel | None = None,
    device: torch.device | str = "cpu",
    progress: Progress | None = None,
    pieces: FilmPieces | None = None,
) -> FilmFit:
    """Fit detailed bodies to the people of films: one shape each, a pose a frame, smooth in time.

    Args:
        films: One, such as ``[ObservedFilm.of(find_film_people("walk.mp4"))]``, or several of the same moments, frame by
            frame as of ``match_films``, whose cameras share a world.
        person: This one alone, 0 = the most and largest seen; the others' pixels are still known to be theirs.
        options: Of windows, and of their fits; default: ``SceneOptions.film()``.
        model: On the device, float32; default Anny.
        device: "cpu" or a CUDA device.
        progress: Called with (stage name, steps done, steps in all).
        pieces: What an earlier run of the same fit has done already, and where this one keeps what it does.

    Raises:
        InputError: If there is no film, or not so many people, frames of films differ in their times, or a stature is
            of several people or before several cameras.
        TypeError: If an argument is of another type.
    """
    check_films(films)
    check_type("options", options, SceneOptions | None, "such as SceneOptions.film()")
    options, model = options or SceneOptions.film(), model or anny(device)
    warnings = [f"films[{place}]: {told}" for place, film in enumerate(films) for told in film.warnings]
    films, told = in_metres(films)
    everyone = dict(enumerate(match_people(films)))
    warnings += [*told, *unmatched_films(films, everyone.values()), *missing_rays(films, everyone)]
    if person is not None:
        everyone = {person: everyone[person_index(person, len(everyone))]}
    check_stature_owner(options.stature, len(everyone))
    options.check_known_stature(len(everyone), len(films))  # before the network looks
    film = _Films(tuple(films), everyone)
    tell = progress or (lambda name, done, total: None)
    observed_bodies = FilmObservations(film.views, film.observations, device)
    parts = list(film.windows(options))

    def kept(name: str, scene: Scene, chosen: SceneOptions, observed: Callable[[], Sequence[ObservedBody]]) -> _Bodies:
        def fit() -> dict[str, np.ndarray]:
            return vars(
                _Bodies.of(fit_scene(scene, options=chosen, model=model, device=device, observed_bodies=observed()))
            )

        return _Bodies(**(fit() if pieces is None else pieces.piece(name, _BODIES, fit)))

    def scenes() -> Iterator[tuple[list[int], Scene, list[ObservedBody]]]:
        for place, part in enumerate(parts):
            numbers, scene = film.scene(part, shapes)
            observed_bodies.forget(part.start)
            done = pieces is not None and pieces.known(f"window{place}", _BODIES) is not None
            yield numbers, scene, [] if done else observed_bodies.of(scene, numbers, part)

    shapes: dict[int, PersonShape] = {}
    if len(parts) > 1:
        apart = replace(options, smoothing=0.0)  # frames that are far from one another
        for place, number in enumerate(everyone):
            tell("shapes", place, len(everyone))
            frames, scene = film.surest(number, options.shape_frames)
            observed = partial(observed_bodies.of, scene, [number], frames)
            shapes[number] = kept(f"shape{number}", scene, apart, observed).shapes[0]
    found = {number: _Blend() for number in everyone}
    # On the CPU the network looks at the next window's frames while this one's bodies are refined; a device has its own
    # order of work, and graphs are captured there alone.
    ahead = made_ahead(scenes()) if torch.device(device).type == "cpu" else scenes()
    tell("motions", 0, len(parts))
    for place, (part, (numbers, scene, seen)) in enumerate(zip(parts, ahead, strict=True)):
        window = kept(f"window{place}", scene, options, partial(list, seen))
        for row, number in enumerate(numbers):
            found[number].add(part, window, row)
        tell("motions", place + 1, len(parts))
    motions = {number: found[number].motion(model, film.span(number)) for number in everyone}
    fit = FilmFit(film.films, everyone, motions)
    return replace(fit, warnings=(*warnings, *find_impossible(fit), *find_misfits(fit)))


def find_impossible(fit: FilmFit) -> list[str]:
    """Warnings of people before several cameras who are no people."""
    if len(fit.films) == 1:
        return []
    eyes = torch.stack([film.view.eye for film in fit.films])
    tall = {person: float(statures(each.model, each.shape.values[None])) for person, each in fit.motions.items()}
    far = {
        person: float((motion.translation.cpu()[:, None] - eyes).norm(dim=-1).mean(0).max())
        for person, motion in fit.motions.items()
    }
    return impossible_people(tall, far)


def find_misfits(fit: FilmFit) -> list[str]:
    """Warnings of people who end far from their keypoints in a film, which is called films[0] and so on."""
    found: list[str] = []
    several = ", of films of the same moments whose cameras stand so" if len(fit.films) > 1 else ""
    for person, motion in fit.motions.items():
        model = motion.model
        names = annotated(skeleton(SKELETON).landmarks, model.landmark_names)
        for place, seen in enumerate(fit.films):
            rows = fit.rows(person, place)
            if not len(rows):
                continue
            some = rows[np.linspace(0, len(rows) - 1, _COMPARED).round().astype(int)]
            bodies = motion.bodies(np.searchsorted(motion.frames, some["frames"])).detailed
            points = seen.view.camera.project(seen.view.to_camera(model.landmarks(bodies, names).cpu()))[..., :2]
            off = np.linalg.norm(points.numpy() - some["keypoints"][..., :2], axis=-1)
            sizes = (some["boxes"][:, 2:] - some["boxes"][:, :2]).max(1, keepdims=True).clip(1.0)
            votes = some["keypoints"][..., 2]
            share = float((votes * off / sizes).sum() / max(votes.sum(), 1e-9))
            if not share < _MOST_OFF:
                far = f"films[{place}]: person{person} ends {100 * share:.1f} % of the person's size from BlazePose's"
                found.append(f"{far} keypoints; expected at most {100 * _MOST_OFF:.0f} %{several}")
    return found


def _rows_of(films: Sequence[ObservedFilm], tracks: Sequence[Track], film: int) -> np.ndarray:
    mine = [track for each, track in tracks if each == film]
    rows = films[film].people.rows
    return rows[np.isin(rows["tracks"], mine)]


@dataclass(frozen=True)
class _Films:
    """Films whose scenes are wanted.

    Attributes:
        films: Of the same moments.
        tracks: By person.
    """

    films: tuple[ObservedFilm, ...]
    tracks: Mapping[int, tuple[Track, ...]]

    def span(self, person: int) -> range:
        """Frames from the first in which a person is seen to the last."""
        frames = np.concatenate([rows["frames"] for _, rows in self._rows(person)])
        return range(int(frames.min()), int(frames.max()) + 1)

    def windows(self, options: SceneOptions) -> Iterable[range]:
        """Frames that are fitted together, of one shot; those in which nobody is seen are left out."""
        everywhere = np.concatenate([rows["frames"] for person in self.tracks for _, rows in self._rows(person)])
        for shot in film_shots(self.films):
            seen = everywhere[(everywhere >= shot.start) & (everywhere < shot.stop)]
            if not len(seen):
                continue
            for window in windows(int(seen.min()), int(seen.max()) + 1, options.window, options.overlap):
                inside = seen[(seen >= window.start) & (seen < window.stop)]
                if len(inside):
                    yield range(int(inside.min()), int(inside.max()) + 1)

    def scene(self, window: range, shapes: Mapping[int, PersonShape]) -> tuple[list[int], Scene]:
        """People of some frames, and the scene of them."""
        there: dict[int, list[tuple[int, np.ndarray]]] = {}
        for person in self.tracks:
            for view, rows in self._rows(person):
                inside = rows[(rows["frames"] >= window.start) & (rows["frames"] < window.stop)]
                if len(inside):
                    there.setdefault(person, []).append((view, inside))
        people = list(there)
        known = {people.index(person): shape for person, shape in shapes.items() if person in there}
        observations = [
            replace(observation, frame=observation.frame - window.start)
            for person, seen in there.items()
            for view, rows in seen
            for observation in self.films[view].observations(rows, people.index(person), view)
        ]
        return people, Scene(
            self.views, observations, self.films[0].people.rate, known, times=uneven_times(self.films, window)
        )

    def observations(self, person: int, view: int, frames: range) -> list[SceneObservation]:
        """Sights of a person in a view."""
        rows = _rows_of(self.films, self.tracks[person], view)
        inside = rows[(rows["frames"] >= frames.start) & (rows["frames"] < frames.stop)]
        return list(self.films[view].observations(inside, person, view))

    def surest(self, person: int, count: int) -> tuple[list[int], Scene]:
        """A person in so many frames, spread over the films, those where the keypoints are surest; and these frames."""
        span = self.span(person)
        sure = np.zeros(len(span))
        for _, rows in self._rows(person):
            np.add.at(sure, rows["frames"] - span.start, rows["keypoints"][..., 2].sum(1))
        groups = np.array_split(np.flatnonzero(sure) + span.start, min(count, int((sure > 0).sum())))
        best = [int(group[sure[group - span.start].argmax()]) for group in groups]
        observations = [
            replace(observation, frame=best.index(observation.frame))
            for view, rows in self._rows(person)
            for observation in self.films[view].observations(rows[np.isin(rows["frames"], best)], 0, view)
        ]
        return best, Scene(self.views, observations, self._mean_rate(span) * len(best) / len(span))

    def _mean_rate(self, span: range) -> float:
        """Frames a second in a span."""
        times = uneven_times(self.films, span)
        if times is None or len(span) == 1:
            return self.films[0].people.rate
        return (len(span) - 1) / float(times[-1])

    def _rows(self, person: int) -> Iterator[tuple[int, np.ndarray]]:
        """Views that see a person, and the rows there."""
        for view in sorted({view for view, _ in self.tracks[person]}):
            yield view, _rows_of(self.films, self.tracks[person], view)

    @property
    def views(self) -> list[View]:
        """Cameras."""
        return [film.small_view for film in self.films]


@dataclass(frozen=True)
class _Bodies:
    """Bodies of a scene of P people in T frames, small enough to be kept.

    Attributes:
        values: Shape values, shape (P, S).
        clothes: Thicknesses [m], shape (P, 8).
        rotations: Local rotation of each joint, shape (P, T, J, 3, 3).
        translation: Position of the root joint in the world [m], shape (P, T, 3).
    """

    values: np.ndarray
    clothes: np.ndarray
    rotations: np.ndarray
    translation: np.ndarray

    @classmethod
    def of(cls, fit: SceneFit) -> _Bodies:
        """Collect the bodies of a fit."""
        people = fit.scene.num_people, fit.scene.num_frames
        rotations, translation = (
            each.unflatten(0, people).cpu().numpy() for each in (fit.bodies.rotations, fit.bodies.translation)
        )
        values = fit.bodies.shape.unflatten(0, people)[:, 0].cpu().numpy()
        return cls(values, fit.clothes.cpu().numpy(), rotations, translation)

    @property
    def shapes(self) -> list[PersonShape]:
        """Shapes of the people, with their clothes."""
        pairs = zip(self.values, self.clothes, strict=True)
        return [PersonShape(torch.from_numpy(values), torch.from_numpy(clothes)) for values, clothes in pairs]


_BODIES = tuple(field.name for field in fields(_Bodies))


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


def film_shots(films: Sequence[ObservedFilm]) -> list[range]:
    """Frames of each shot of films of the same moments; where only some of them have a cut, the others go on."""
    cuts = set.intersection(*(set(film.people.cuts) for film in films))
    return shots_between(sorted(cuts), max(len(film.people.times) for film in films))


def windows(start: int, stop: int, length: int, overlap: int) -> list[range]:
    """Windows of one length, ``length`` frames at most, that share at least ``overlap`` with the one before."""
    if stop - start <= length:
        return [range(start, stop)]
    count = -(-(stop - start - overlap) // (length - overlap))
    length = -(-(stop - start + (count - 1) * overlap) // count)
    firsts = [start + round(place * (stop - start - length) / (count - 1)) for place in range(count)]
    return [range(first, first + length) for first in firsts]
