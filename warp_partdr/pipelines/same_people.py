"""Matching of people between films that were taken at the same time: rays of one person's keypoints meet."""

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

_FRAMES = 32  # that two tracks have in common and are compared in, at most
_SURE = 0.5  # confidence of keypoints that are compared, at least
_LEAST = 24  # pairs of rays that tell anything
_APART = 0.15  # [m], median distance of rays, above which it is two people
_LIMBS = (("shoulder", "hip"), ("hip", "knee"), ("knee", "ankle"))
LENGTHS = (0.5, 2.0)  # [m] together, of children and adults: what meets elsewhere is no body

Track = tuple[int, int]  # film, and number of a person in it


def check_films(films: Sequence[ObservedFilm]) -> None:
    """Raise an InputError if there are no films or they have different clocks, or a TypeError if they are none."""
    check_each_film(films)
    check_matched(films)


def check_each_film(films: Sequence[ObservedFilm]) -> None:
    """Raise an InputError if there are no films, or a TypeError if they are none."""
    check_each("films", films, ObservedFilm, "such as ObservedFilm.of(find_film_people('walk.mp4'))")
    if not films:
        raise InputError("films: none; expected at least one")


def match_people(films: Sequence[ObservedFilm]) -> list[tuple[Track, ...]]:
    """Tracks of each person, largest in the pictures first.

    Tracks of two films are one person's if the rays through their keypoints meet, and limbs have lengths there; those
    that fit best come first. Two tracks of one film are of one person only if they are never there at once.

    Args:
        films: Of the same moments frame by frame.
    """
    tracks = [(film, track) for film, seen in enumerate(films) for track in range(seen.people.num_people)]
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
    return [everyone[place] for place in np.argsort([-share for share in shares], kind="stable")]


def ray_distance(one: ObservedFilm, rows: np.ndarray, other: ObservedFilm, others: np.ndarray) -> float:
    """Median distance of two tracks' rays where they come nearest [m]; infinite where no body can be.

    Args:
        one: A film.
        rows: A person's there, of fields ``SEEN``.
        other: Another film.
        others: A person's there.
    """
    found = meeting(one, rows, other, others)
    return found.distance if np.isnan(found.size) or LENGTHS[0] <= found.size <= LENGTHS[1] else np.inf


@dataclass(frozen=True)
class Meeting:
    """Two tracks' rays, in the unit in which the cameras stand.

    Attributes:
        distance: Median where they come nearest; infinite if they do so behind a camera, or too few can be compared.
        size: Median length of trunk, thigh and shin together there; NaN where they are not seen.
        compared: False if too few keypoints are seen in both at once.
    """

    distance: float
    size: float
    compared: bool = True


def meeting(one: ObservedFilm, rows: np.ndarray, other: ObservedFilm, others: np.ndarray) -> Meeting:
    """Meeting of two tracks' rays; arguments as of ``ray_distance``."""
    both, places, other_places = np.intersect1d(rows["frames"], others["frames"], return_indices=True)
    some: np.ndarray = np.unique(np.linspace(0, len(both) - 1, _FRAMES).round().astype(int)) if len(both) else both
    seen, facing = rows["keypoints"][places[some]], others["keypoints"][other_places[some]]
    sure = (seen[..., 2] >= _SURE) & (facing[..., 2] >= _SURE)
    if sure.sum() < _LEAST:
        return Meeting(np.inf, np.nan, compared=False)
    (start, rays), (end, back) = (
        _rays(film, each[..., :2]) for film, each in zip((one, other), (seen, facing), strict=True)
    )
    normal, between = np.cross(rays, back), end - start
    length = np.linalg.norm(normal, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(normal @ between) / length
        along = np.cross(between, back), np.cross(between, rays)
        depth, facing_depth = ((each * normal).sum(-1) / length**2 for each in along)
    before = (depth > 0) & (facing_depth > 0)
    points = 0.5 * (start + depth[..., None] * rays + end + facing_depth[..., None] * back)
    distance = float(np.median(np.where(before, apart, np.inf)[sure]))
    return Meeting(distance, _limbs(np.where((sure & before)[..., None], points, np.nan)))


def _rays(film: ObservedFilm, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Place of the camera in the world, shape (3,), and directions of pixels (..., 2), shape (..., 3)."""
    view = film.view
    turn, move = view.rotation.double().numpy(), view.translation.double().numpy()
    focal, centre = (each[0].double().numpy() for each in (view.camera.focal, view.camera.centre))
    across = (points - centre) / focal
    rays = np.concatenate([across, np.ones_like(across[..., :1])], axis=-1)
    return -move @ turn, (rays / np.linalg.norm(rays, axis=-1, keepdims=True)) @ turn


def _limbs(points: np.ndarray) -> float:
    """Median length of trunk, thigh and shin together, of points (T, 33, 3); NaN where they are not seen."""
    names = skeleton(SKELETON).landmarks
    total = 0.0
    for pair in _LIMBS:
        ends = [[points[:, names.index(f"{side}_{name}")] for name in pair] for side in ("left", "right")]
        lengths = np.concatenate([np.linalg.norm(start - end, axis=-1) for start, end in ends])
        lengths = lengths[np.isfinite(lengths)]
        total += float(np.median(lengths)) if len(lengths) else np.nan
    return total


def _at_once(tracks: Sequence[Track], rows: dict[Track, np.ndarray]) -> bool:
    """True if two of the tracks are of one film, and there in one frame."""
    return any(
        one[0] == other[0] and len(np.intersect1d(rows[one]["frames"], rows[other]["frames"]))
        for one, other in combinations(tracks, 2)
    )
