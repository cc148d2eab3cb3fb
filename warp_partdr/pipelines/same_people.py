"""Matching of people between films that were taken at the same time: rays through one person's keypoints meet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..body.skeletons import skeleton
from ..errors import InputError, check_each
from ..networks.detection.film_people import areas
from ..networks.detection.person import SKELETON
from .matched_times import check_matched
from .observed_film import ObservedFilm

_FRAMES = 32  # largest number of common frames in which two tracks are compared
_CONFIDENT = 0.5  # least confidence of keypoints that are compared
_LEAST = 24  # least number of pairs of rays for a comparison
_APART = 0.15  # [m], median distance of rays above which they belong to two people
_LIMBS = (("shoulder", "hip"), ("hip", "knee"), ("knee", "ankle"))
LENGTHS = (0.5, 2.0)  # [m], least and largest length of trunk, thigh and shin together, of children and adults

Track = tuple[int, int]  # index of a film, and index of a person in it


def check_films(films: Sequence[ObservedFilm]) -> None:
    """Checks that films are matched frame by frame.

    Raises:
        InputError: If there is no film, or frames with the same index have different times.
        TypeError: If a film has another type.
    """
    check_each_film(films)
    check_matched(films)


def check_each_film(films: Sequence[ObservedFilm]) -> None:
    """Checks the type of films.

    Raises:
        InputError: If there is no film.
        TypeError: If a film has another type.
    """
    check_each("films", films, ObservedFilm, "such as ObservedFilm.of(find_film_people('walk.mp4'))")
    if not films:
        raise InputError("films: none; expected at least one")


def match_people(films: Sequence[ObservedFilm]) -> list[tuple[Track, ...]]:
    """Matches people between films.

    Two tracks of different films belong to one person if the rays through their keypoints meet, and limbs have
    plausible lengths there. The tracks that fit best are matched first. Two tracks of one film can only belong to one
    person if they are never in the same frame.

    Args:
        films: Films that are matched frame by frame.

    Returns:
        Tracks of each person. The people who are largest in the pictures come first.
    """
    tracks = [(index, track) for index, film in enumerate(films) for track in range(film.people.num_people)]
    rows = {each: films[each[0]].people.of(each[1]) for each in tracks}
    costs: list[tuple[float, Track, Track]] = []
    for one, other in combinations(tracks, 2):
        if one[0] != other[0]:
            cost = ray_distance(films[one[0]], rows[one], films[other[0]], rows[other])
            if cost < _APART:
                costs.append((cost, one, other))
    people: dict[Track, tuple[Track, ...]] = {each: (each,) for each in tracks}
    for _, one, other in sorted(costs):
        both = (*people[one], *people[other])
        if people[one] is not people[other] and not _at_once(both, rows):
            people |= dict.fromkeys(both, tuple(sorted(both)))
    everyone = list(dict.fromkeys(people.values()))
    shares = [
        sum(areas(rows[each]["boxes"]).sum() / np.prod(films[each[0]].people.image_size) for each in person)
        for person in everyone
    ]
    return [everyone[index] for index in np.argsort([-share for share in shares], kind="stable")]


def ray_distance(one: ObservedFilm, rows: np.ndarray, other: ObservedFilm, other_rows: np.ndarray) -> float:
    """Median distance of two tracks' rays where they come nearest [m]. It is infinite if no body can be there.

    Args:
        one: A film.
        rows: Rows of a person in it, with the fields ``SEEN``.
        other: Another film.
        other_rows: Rows of a person in the other film.
    """
    found = meeting(one, rows, other, other_rows)
    return found.distance if np.isnan(found.size) or LENGTHS[0] <= found.size <= LENGTHS[1] else np.inf


@dataclass(frozen=True)
class Meeting:
    """Meeting of two tracks' rays, in the unit of the cameras' positions.

    Attributes:
        distance: Median distance where rays come nearest. It is infinite if that is behind a camera, or if too few rays
            can be compared.
        size: Median length of trunk, thigh and shin together there. It is NaN if they are not visible.
        compared: False if too few keypoints are visible in both films at once.
    """

    distance: float
    size: float
    compared: bool = True


def meeting(one: ObservedFilm, rows: np.ndarray, other: ObservedFilm, other_rows: np.ndarray) -> Meeting:
    """Finds the meeting of two tracks' rays. The arguments are those of ``ray_distance``."""
    both, indices, other_indices = np.intersect1d(rows["frames"], other_rows["frames"], return_indices=True)
    some: np.ndarray = np.unique(np.linspace(0, len(both) - 1, _FRAMES).round().astype(int)) if len(both) else both
    keypoints = rows["keypoints"][indices[some]]
    other_keypoints = other_rows["keypoints"][other_indices[some]]
    confident = (keypoints[..., 2] >= _CONFIDENT) & (other_keypoints[..., 2] >= _CONFIDENT)
    if confident.sum() < _LEAST:
        return Meeting(np.inf, np.nan, compared=False)
    start, rays = _rays(one, keypoints[..., :2])
    other_start, other_rays = _rays(other, other_keypoints[..., :2])
    normal = np.cross(rays, other_rays)
    between = other_start - start
    length = np.linalg.norm(normal, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(normal @ between) / length
        depth = (np.cross(between, other_rays) * normal).sum(-1) / length**2
        other_depth = (np.cross(between, rays) * normal).sum(-1) / length**2
    in_front = (depth > 0) & (other_depth > 0)
    points = 0.5 * (start + depth[..., None] * rays + other_start + other_depth[..., None] * other_rays)
    distance = float(np.median(np.where(in_front, apart, np.inf)[confident]))
    return Meeting(distance, _limbs(np.where((confident & in_front)[..., None], points, np.nan)))


def _rays(film: ObservedFilm, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position of the camera in the world, shape (3,), and directions of pixels (..., 2), shape (..., 3)."""
    view = film.view
    rotation = view.rotation.double().numpy()
    translation = view.translation.double().numpy()
    focal = view.camera.focal[0].double().numpy()
    centre = view.camera.centre[0].double().numpy()
    across = (points - centre) / focal
    rays = np.concatenate([across, np.ones_like(across[..., :1])], axis=-1)
    return -translation @ rotation, (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ rotation


def _limbs(points: np.ndarray) -> float:
    """Median length of trunk, thigh and shin together, from points (T, 33, 3). It is NaN if they are not visible."""
    names = skeleton(SKELETON).landmarks
    total = 0.0
    for pair in _LIMBS:
        ends = [[points[:, names.index(f"{side}_{name}")] for name in pair] for side in ("left", "right")]
        lengths = np.concatenate([np.linalg.norm(start - end, axis=-1) for start, end in ends])
        lengths = lengths[np.isfinite(lengths)]
        total += float(np.median(lengths)) if len(lengths) else np.nan
    return total


def _at_once(tracks: Sequence[Track], rows: dict[Track, np.ndarray]) -> bool:
    """True if two of the tracks are in the same frame of one film."""
    return any(
        one[0] == other[0] and len(np.intersect1d(rows[one]["frames"], rows[other]["frames"]))
        for one, other in combinations(tracks, 2)
    )
