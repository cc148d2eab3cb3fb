"""Fit of one film, or of several films that were taken at the same time. Each window of frames is one scene.

A person's shape is found first, from frames spread over the whole film. Then windows do not depend on one another, so a
film may have any length. Shots are fitted separately: no window reaches over a cut, and people are not matched between
shots.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from ..body.landmarks import annotated
from ..body.rotations import nearest_rotation
from ..body.skeletons import skeleton
from ..body.stature import tall_warning
from ..cameras import Perspective
from ..errors import check_type
from ..inputs.scene import PersonShape, Scene, SceneObservation, View
from ..interop.ahead import made_ahead
from ..models.anny import anny
from ..models.measuring import statures
from ..models.model import DetailedModel
from ..models.registration import Registered, ungrown
from ..networks.detection.film_people import FilmPeople, kept_size, shots_between
from ..networks.detection.person import SKELETON
from ..solve.confidence.model import probabilities
from ..solve.confidence.motions import MotionConfidence, motion_warning
from ..solve.confidence.scenes import SceneConfidence, judge_scene
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
from .rig_warnings import distant_rays, unmatched_films
from .same_people import Track, check_films, match_people

_COMPARED = 16  # largest number of frames in which a person's keypoints are compared with the body's
# Largest mean distance between keypoints and a body [person's size in the picture]. Shaded people and real photos ended
# at 0.01 to 0.05. Two people who were taken for one ended at 0.07 to 0.11.
_MOST_OFF = 0.06


@dataclass(frozen=True)
class Motion:
    """Motion of a person through a film.

    Attributes:
        model: The detailed model.
        frames: Indices of the film's frames, rising, shape (T,), int64. They include frames in between without the
            person.
        shape: Shape of the person.
        rotations: Local rotation of each joint, shape (T, J, 3, 3).
        translation: Position of the root joint in the world [m], shape (T, 3).
        confidence: Confidence in the body in each frame. It is None if it is not known, as in files of older versions.
    """

    model: DetailedModel
    frames: np.ndarray
    shape: PersonShape
    rotations: torch.Tensor
    translation: torch.Tensor
    confidence: MotionConfidence | None = None

    def bodies(self, rows: slice | np.ndarray = slice(None)) -> Registered:
        """Detailed bodies in the world.

        Args:
            rows: Frames for which bodies are made. All bodies of a long film need much memory.
        """
        rotations = self.rotations[rows]
        values = self.shape.values.expand(len(rotations), -1)
        return ungrown(self.model, values, rotations, self.translation[rows], {})


@dataclass(frozen=True)
class FilmFit:
    """Bodies of the people of a film, or of several.

    Attributes:
        films: Films that were fitted. The world of a single film is the frame of its camera.
        tracks: Tracks in the films, by the index of the person.
        motions: Motions by the index of the person.
        warnings: Warnings about films, cameras and people, a sentence each. They call the films films[0] and so on.
    """

    films: tuple[ObservedFilm, ...]
    tracks: dict[int, tuple[Track, ...]]
    motions: dict[int, Motion]
    warnings: tuple[str, ...] = ()

    @property
    def people(self) -> FilmPeople:
        """People in the first film."""
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
        """Frames of each shot. Shots were fitted separately."""
        return film_shots(self.films)

    def rows(self, person: int, film: int = 0) -> np.ndarray:
        """Rows of a person in the ``FilmPeople`` of a film, in the order of frames."""
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
    """Fits detailed bodies to the people of films: one shape for each person, a pose for each frame, smooth in time.

    Args:
        films: One film, such as ``[ObservedFilm.of(find_film_people("walk.mp4"))]``, or several films. Several must be
            matched frame by frame by ``match_films``, and their cameras must share a world.
        person: Index of the only person to fit, 0 is the one seen most and largest. Pixels of the other people are
            still left out. If it is None, everyone is fitted.
        options: Options for windows and for their fits. The default is ``SceneOptions.film()``.
        model: Detailed model on the device, float32. The default is Anny.
        device: Device to run on, "cpu" or a CUDA device.
        progress: Function that is called with (stage name, steps done, all steps).
        pieces: Finished pieces of an earlier run of the same fit, to which this run adds its own. If it is None,
            nothing is kept.

    Raises:
        InputError: If there is no film, ``person`` is not among the people found, frames of films differ in their
            times, or a stature is given for several people or several cameras.
        TypeError: If an argument has another type.

    Examples:
        >>> from warp_partdr import ObservedFilm, find_film_people, fit_film
        >>> motion = fit_film([ObservedFilm.of(find_film_people("walk.mp4"))])
        >>> person = motion.motions[0]
        >>> person.rotations.shape, person.translation.shape  # frames, joints; position of the root joint [m]
        (torch.Size([3, 104, 3, 3]), torch.Size([3, 3]))
    """
    check_films(films)
    check_type("options", options, SceneOptions | None, "such as SceneOptions.film()")
    options = options or SceneOptions.film()
    model = model or anny(device)
    warnings = [f"films[{index}]: {warning}" for index, film in enumerate(films) for warning in film.warnings]
    films, unit_warnings = in_metres(films)
    everyone = dict(enumerate(match_people(films)))
    warnings += [*unit_warnings, *unmatched_films(films, everyone.values()), *distant_rays(films, everyone)]
    if person is not None:
        everyone = {person: everyone[person_index(person, len(everyone))]}
    check_stature_owner(options.stature, len(everyone))
    options.check_known_stature(len(everyone), len(films))  # before the network spends time
    film = _Films(tuple(films), everyone)
    report = progress or (lambda name, done, total: None)
    observations = FilmObservations(film.views, film.observations, device)
    parts = list(film.windows(options))
    sizes = [kept_size(each.people.image_size) for each in films]

    def fit_or_load(
        name: str, scene: Scene, scene_options: SceneOptions, observe: Callable[[], Sequence[ObservedBody]]
    ) -> _Bodies:
        def fit() -> dict[str, np.ndarray]:
            observed_bodies = observe()
            found = fit_scene(scene, options=scene_options, model=model, device=device, observed_bodies=observed_bodies)
            return _Bodies.of(found, judge_scene(found, observed_bodies, sizes)).arrays()

        return _Bodies.of_arrays(fit() if pieces is None else pieces.piece(name, _BODY_ARRAYS, fit))

    def scenes() -> Iterator[tuple[list[int], Scene, list[ObservedBody]]]:
        for index, part in enumerate(parts):
            people, scene = film.scene(part, shapes)
            observations.forget(part.start)
            done = pieces is not None and pieces.known(f"window{index}", _BODY_ARRAYS) is not None
            yield people, scene, [] if done else observations.of(scene, people, part)

    shapes: dict[int, PersonShape] = {}
    if len(parts) > 1:
        shape_options = replace(options, smoothing=0.0)  # because the frames are far from one another
        for index, each in enumerate(everyone):
            report("shapes", index, len(everyone))
            frames, scene = film.most_confident(each, options.shape_frames)
            observe = partial(observations.of, scene, [each], frames)
            shapes[each] = fit_or_load(f"shape{each}", scene, shape_options, observe).shapes[0]
    blends = {each: _Blend() for each in everyone}
    # On the CPU, the network predicts the next window while this one is refined. On a GPU, work is done in one order
    # anyway, and CUDA graphs must be captured alone.
    ahead = made_ahead(scenes()) if torch.device(device).type == "cpu" else scenes()
    report("motions", 0, len(parts))
    for index, (part, (people, scene, observed_bodies)) in enumerate(zip(parts, ahead, strict=True)):
        bodies = fit_or_load(f"window{index}", scene, options, partial(list, observed_bodies))
        for row, each in enumerate(people):
            blends[each].add(part, bodies, row)
        report("motions", index + 1, len(parts))
    motions = {each: blends[each].motion(model, film.span(each)) for each in everyone}
    found = FilmFit(film.films, everyone, motions)
    if options.stature is None:
        warnings += find_tall_people(found)
    warnings += [*find_impossible_people(found), *find_distant_keypoints(found), *find_unsure_people(found)]
    return replace(found, warnings=tuple(warnings))


def find_impossible_people(fit: FilmFit) -> list[str]:
    """Warnings about impossible people in films of several cameras; they show that cameras are wrong."""
    if len(fit.films) == 1:
        return []
    eyes = torch.stack([film.view.eye for film in fit.films])
    heights = {person: float(statures(each.model, each.shape.values[None])) for person, each in fit.motions.items()}
    distances = {
        person: float((motion.translation.cpu()[:, None] - eyes).norm(dim=-1).mean(0).max())
        for person, motion in fit.motions.items()
    }
    return impossible_people(heights, distances)


def find_tall_people(fit: FilmFit) -> list[str]:
    """Warnings about people in a film of one camera who are taller than hardly anybody is: their size is a guess."""
    if len(fit.films) > 1:
        return []
    return [
        warning
        for person, motion in fit.motions.items()
        for warning in tall_warning(f"person{person}", float(statures(motion.model, motion.shape.values[None])))
    ]


def find_distant_keypoints(fit: FilmFit) -> list[str]:
    """Warnings about people whose bodies end far from their keypoints in a film."""
    found: list[str] = []
    several = ", in films that were taken at the same time by these cameras" if len(fit.films) > 1 else ""
    for person, motion in fit.motions.items():
        model = motion.model
        names = annotated(skeleton(SKELETON).landmarks, model.landmark_names)
        known = [column for column, name in enumerate(names) if name in model.landmark_names]  # SMPL lacks some
        compared = [names[column] for column in known]
        for index, film in enumerate(fit.films):
            rows = fit.rows(person, index)
            if not len(rows):
                continue
            some = rows[np.linspace(0, len(rows) - 1, _COMPARED).round().astype(int)]
            bodies = motion.bodies(np.searchsorted(motion.frames, some["frames"])).detailed
            points = film.view.camera.project(film.view.to_camera(model.landmarks(bodies, compared).cpu()))[..., :2]
            keypoints = some["keypoints"][:, known]
            off = np.linalg.norm(points.numpy() - keypoints[..., :2], axis=-1)
            sizes = (some["boxes"][:, 2:] - some["boxes"][:, :2]).max(1, keepdims=True).clip(1.0)
            confidence = keypoints[..., 2]
            share = float((confidence * off / sizes).sum() / max(confidence.sum(), 1e-9))
            if not share < _MOST_OFF:
                far = f"films[{index}]: person{person} ends {100 * share:.1f} % of the person's size from BlazePose's"
                found.append(f"{far} keypoints; expected at most {100 * _MOST_OFF:.0f} %{several}")
    return found


def find_unsure_people(fit: FilmFit) -> list[str]:
    """Warnings about people whose bodies are likely wrong for some time, a sentence for each person."""
    found: list[str] = []
    for person, motion in fit.motions.items():
        if motion.confidence is not None:
            warning = motion_warning(f"person{person}", motion.confidence, fit.times[motion.frames])
            found += [] if warning is None else [warning]
    return found


def _rows_of(films: Sequence[ObservedFilm], tracks: Sequence[Track], film: int) -> np.ndarray:
    """Rows of a person in a film, in the order of frames."""
    own = [track for each, track in tracks if each == film]
    rows = films[film].people.rows
    return rows[np.isin(rows["tracks"], own)]


@dataclass(frozen=True)
class _Films:
    """Films from which scenes are made.

    Attributes:
        films: Films that are matched frame by frame.
        tracks: Tracks by the index of the person.
    """

    films: tuple[ObservedFilm, ...]
    tracks: Mapping[int, tuple[Track, ...]]

    def span(self, person: int) -> range:
        """Frames from the first one that shows a person to the last one."""
        frames = np.concatenate([rows["frames"] for _, rows in self._rows(person)])
        return range(int(frames.min()), int(frames.max()) + 1)

    def windows(self, options: SceneOptions) -> Iterable[range]:
        """Windows of frames within shots. They begin and end with a frame that shows somebody."""
        everywhere = np.concatenate([rows["frames"] for person in self.tracks for _, rows in self._rows(person)])
        for shot in film_shots(self.films):
            frames = everywhere[(everywhere >= shot.start) & (everywhere < shot.stop)]
            if not len(frames):
                continue
            for window in windows(int(frames.min()), int(frames.max()) + 1, options.window, options.overlap):
                inside = frames[(frames >= window.start) & (frames < window.stop)]
                if len(inside):
                    yield range(int(inside.min()), int(inside.max()) + 1)

    def scene(self, window: range, shapes: Mapping[int, PersonShape]) -> tuple[list[int], Scene]:
        """Makes the scene of a window.

        Args:
            window: Frames of the window.
            shapes: Known shapes by the index of the person in the films.

        Returns:
            Index in the films of each person of the scene, and the scene.
        """
        inside: dict[int, list[tuple[int, np.ndarray]]] = {}
        for person in self.tracks:
            for view, rows in self._rows(person):
                own = rows[(rows["frames"] >= window.start) & (rows["frames"] < window.stop)]
                if len(own):
                    inside.setdefault(person, []).append((view, own))
        people = list(inside)
        known = {people.index(person): shape for person, shape in shapes.items() if person in inside}
        observations: list[SceneObservation] = []
        for index, views in enumerate(inside.values()):
            for view, rows in views:
                for observation in self.films[view].observations(rows, index, view):
                    observations.append(replace(observation, frame=observation.frame - window.start))
        times = uneven_times(self.films, window)
        return people, Scene(self.views, observations, self.films[0].people.rate, known, times=times)

    def observations(self, person: int, view: int, frames: range) -> list[SceneObservation]:
        """Observations of a person in a view, for a range of frames."""
        rows = _rows_of(self.films, self.tracks[person], view)
        inside = rows[(rows["frames"] >= frames.start) & (rows["frames"] < frames.stop)]
        return list(self.films[view].observations(inside, person, view))

    def most_confident(self, person: int, count: int) -> tuple[list[int], Scene]:
        """Makes the scene of a person in ``count`` frames: the most confident ones of as many parts of the films.

        Returns:
            Indices of the frames in the films, and the scene.
        """
        span = self.span(person)
        confidence = np.zeros(len(span))
        for _, rows in self._rows(person):
            np.add.at(confidence, rows["frames"] - span.start, rows["keypoints"][..., 2].sum(1))
        parts = np.array_split(np.flatnonzero(confidence) + span.start, min(count, int((confidence > 0).sum())))
        best = [int(part[confidence[part - span.start].argmax()]) for part in parts]
        observations = [
            replace(observation, frame=best.index(observation.frame))
            for view, rows in self._rows(person)
            for observation in self.films[view].observations(rows[np.isin(rows["frames"], best)], 0, view)
        ]
        return best, Scene(self.views, observations, self._mean_rate(span) * len(best) / len(span))

    def _mean_rate(self, span: range) -> float:
        """Mean frame rate of a span [frames/s]."""
        times = uneven_times(self.films, span)
        if times is None or len(span) == 1:
            return self.films[0].people.rate
        return (len(span) - 1) / float(times[-1])

    def _rows(self, person: int) -> Iterator[tuple[int, np.ndarray]]:
        """Views that show a person, with the rows there."""
        for view in sorted({view for view, _ in self.tracks[person]}):
            yield view, _rows_of(self.films, self.tracks[person], view)

    @property
    def views(self) -> list[View]:
        """Views for the pixels of the observations."""
        return [film.small_view for film in self.films]


_BODY_ARRAYS = "values", "clothes", "rotations", "translation", "log_odds", "limb_log_odds", "sights"


@dataclass(frozen=True)
class _Bodies:
    """Bodies of a scene with P people in T frames, in arrays that are small enough to be kept in a file.

    Attributes:
        values: Shape values, shape (P, S).
        clothes: Thicknesses of clothes [m], shape (P, 8).
        rotations: Local rotation of each joint, shape (P, T, J, 3, 3).
        translation: Position of the root joint in the world [m], shape (P, T, 3).
        log_odds: Logarithm of the odds that each body is right, as in ``SceneConfidence``, shape (P, T).
        limb_log_odds: Logarithm of the odds of each limb, likewise, shape (P, T, 5).
        sights: Index of the sight of each limb, likewise, shape (P, T, 5).
    """

    values: np.ndarray
    clothes: np.ndarray
    rotations: np.ndarray
    translation: np.ndarray
    log_odds: np.ndarray
    limb_log_odds: np.ndarray
    sights: np.ndarray

    @classmethod
    def of(cls, fit: SceneFit, confidence: SceneConfidence) -> _Bodies:
        """Collects the bodies of a fit, and the confidence in them."""
        size = fit.scene.num_people, fit.scene.num_frames
        return cls(
            values=fit.bodies.shape.unflatten(0, size)[:, 0].cpu().numpy(),
            clothes=fit.clothes.cpu().numpy(),
            rotations=fit.bodies.rotations.unflatten(0, size).cpu().numpy(),
            translation=fit.bodies.translation.unflatten(0, size).cpu().numpy(),
            log_odds=confidence.bodies,
            limb_log_odds=confidence.limbs,
            sights=confidence.sights,
        )

    @classmethod
    def of_arrays(cls, arrays: Mapping[str, np.ndarray]) -> _Bodies:
        """Bodies from the arrays of a file, by their names."""
        return cls(
            values=arrays["values"],
            clothes=arrays["clothes"],
            rotations=arrays["rotations"],
            translation=arrays["translation"],
            log_odds=arrays["log_odds"],
            limb_log_odds=arrays["limb_log_odds"],
            sights=arrays["sights"],
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """Arrays for a file, by the names in ``_BODY_ARRAYS``."""
        return {name: getattr(self, name) for name in _BODY_ARRAYS}

    @property
    def shapes(self) -> list[PersonShape]:
        """Shapes of the people, with their clothes."""
        pairs = zip(self.values, self.clothes, strict=True)
        return [PersonShape(torch.from_numpy(values), torch.from_numpy(clothes)) for values, clothes in pairs]


@dataclass(frozen=True)
class _BlendedFrame:
    """Weighted sums over the windows that share a frame of a person.

    Attributes:
        weight: Sum of the weights.
        rotations: Sum of the local rotations, shape (J, 3, 3).
        translation: Sum of the positions of the root joint [m], shape (3,).
        log_odds: Sum of the logarithms of odds of the body, then of its limbs, shape (6,).
        heaviest: Largest weight of a window.
        sights: Sights of the limbs in the window with that weight, shape (5,).
    """

    weight: float
    rotations: torch.Tensor
    translation: torch.Tensor
    log_odds: np.ndarray
    heaviest: float
    sights: np.ndarray

    @classmethod
    def of(cls, bodies: _Bodies, person: int, row: int, weight: float) -> _BlendedFrame:
        """Sums of one window."""
        log_odds = np.array([bodies.log_odds[person, row], *bodies.limb_log_odds[person, row]])
        return cls(
            weight=weight,
            rotations=weight * torch.from_numpy(bodies.rotations[person, row]),
            translation=weight * torch.from_numpy(bodies.translation[person, row]),
            log_odds=weight * log_odds,
            heaviest=weight,
            sights=bodies.sights[person, row],
        )

    def plus(self, other: _BlendedFrame) -> _BlendedFrame:
        """Sums over the windows of both."""
        heavier = self if self.heaviest >= other.heaviest else other
        return _BlendedFrame(
            weight=self.weight + other.weight,
            rotations=self.rotations + other.rotations,
            translation=self.translation + other.translation,
            log_odds=self.log_odds + other.log_odds,
            heaviest=heavier.heaviest,
            sights=heavier.sights,
        )


class _Blend:
    """Weighted mean of a person's poses from windows that share frames. A window has most weight in its middle.

    The logarithms of the odds that the poses are right have the same weights.
    """

    def __init__(self) -> None:
        self._frames: dict[int, _BlendedFrame] = {}
        self._shape: PersonShape | None = None

    def add(self, window: range, bodies: _Bodies, person: int) -> None:
        """Adds the poses of a person in a window."""
        self._shape = bodies.shapes[person]
        for row, frame in enumerate(window):
            weight = float(min(frame - window.start, window.stop - 1 - frame) + 1)
            own = _BlendedFrame.of(bodies, person, row, weight)
            self._frames[frame] = self._frames[frame].plus(own) if frame in self._frames else own

    def motion(self, model: DetailedModel, span: range) -> Motion:
        """Motion of the person in the frames of a span."""
        assert self._shape is not None
        frames = [frame for frame in sorted(self._frames) if frame in span]
        blended = [self._frames[frame] for frame in frames]
        weights = torch.tensor([each.weight for each in blended])
        rotations = torch.stack([each.rotations for each in blended])
        translations = torch.stack([each.translation for each in blended])
        odds = probabilities(np.stack([each.log_odds / each.weight for each in blended]))
        like = model.rest_vertices
        return Motion(
            model,
            np.array(frames),
            PersonShape(self._shape.values.to(like), self._shape.clothes.to(like)),
            nearest_rotation(rotations).to(like),
            (translations / weights[:, None]).to(like),
            MotionConfidence(odds[:, 0], odds[:, 1:], np.stack([each.sights for each in blended])),
        )


def film_shots(films: Sequence[ObservedFilm]) -> list[range]:
    """Frames of each shot of matched films. A cut counts if all films have it."""
    cuts = set.intersection(*(set(film.people.cuts) for film in films))
    return shots_between(sorted(cuts), max(len(film.people.times) for film in films))


def windows(start: int, stop: int, length: int, overlap: int) -> list[range]:
    """Windows of equal length that cover the frames from ``start`` to ``stop``.

    Args:
        start: First frame.
        stop: Frame after the last one.
        length: Largest length of a window.
        overlap: Least number of frames that a window shares with the one before.
    """
    if stop - start <= length:
        return [range(start, stop)]
    count = -(-(stop - start - overlap) // (length - overlap))
    length = -(-(stop - start + (count - 1) * overlap) // count)
    firsts = [start + round(index * (stop - start - length) / (count - 1)) for index in range(count)]
    return [range(first, first + length) for first in firsts]
