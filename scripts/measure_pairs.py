"""Measure and print how many of two overlapping people are found.

    python scripts/measure_pairs.py FOLDER

FOLDER holds photos, as for measure_photo.py. Everyone who is found there with a score above 0.9 is cut out
by the mask; each is pasted before each other one, 0.1, 0.2 and 0.35 of the height aside, on a plain scenery. Found
is who has landmarks like those in the photo (similarity of 0.5); others are mixtures of both, or nobody.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from warp_partdr.detection.masks import draw_mask
from warp_partdr.detection.people import find_people
from warp_partdr.detection.person import FoundPerson
from warp_partdr.detection.same_person import similarity
from warp_partdr.inputs.part_labels import read_photo

HEIGHT, SIZE, TOP = 260, (480, 640), (140, 155)  # [px]; tops of the person behind and of the one before
ASIDE = (0.1, 0.2, 0.35)  # of the height
SURE, ALIKE = 0.9, 0.5  # least score of a person who is cut out; similarity of landmarks


class CutOut(NamedTuple):
    """Somebody cut out: colours and opacity, and landmarks from its corner, with their confidence."""

    colours: np.ndarray
    opacity: np.ndarray
    points: np.ndarray
    confidence: np.ndarray


def cut_out(photo: np.ndarray, person: FoundPerson) -> CutOut:
    left, top, right, bottom = (round(edge) for edge in person.box)
    zoom = HEIGHT / (bottom - top)
    size = (round((right - left) * zoom), HEIGHT)
    mask = draw_mask(person, photo.shape[:2])[top:bottom, left:right]
    colours = Image.fromarray(photo[top:bottom, left:right]).resize(size, Image.Resampling.LANCZOS)
    opacity = Image.fromarray(mask).resize(size, Image.Resampling.BILINEAR)
    points = (person.keypoints.points - [left, top]) * zoom
    return CutOut(np.asarray(colours), np.asarray(opacity)[..., None], points, person.keypoints.confidence)


def paste(picture: np.ndarray, cut: CutOut, middle: float, top: int) -> np.ndarray:
    """Paste somebody into a picture, in place, and give the landmarks there."""
    height, width = cut.opacity.shape[:2]
    left = int(middle - width / 2)
    below = picture[top : top + height, left : left + width]
    below[:] = cut.opacity * cut.colours + (1 - cut.opacity) * below
    return cut.points + np.array([left, top])


def is_found(points: np.ndarray, cut: CutOut, people: list[FoundPerson]) -> list[bool]:
    """Tell which of the people have these landmarks."""
    side = np.array([1.25 * HEIGHT])
    ours = points[None], cut.confidence[None], side
    return [bool(similarity(ours, (each.keypoints.points[None], ours[1], side))[0] >= ALIKE) for each in people]


def main(folder: Path) -> None:
    cuts = []
    for path in sorted(folder.glob("*.jpg")):
        photo = read_photo(path)
        cuts += [cut_out(photo, person) for person in find_people(photo) if person.score > SURE]
    scenery = np.linspace([150, 170, 190], [90, 110, 70], SIZE[0])[:, None].repeat(SIZE[1], axis=1).astype(np.uint8)
    for aside in ASIDE:
        counts = np.zeros(4, dtype=int)
        for back, front in itertools.permutations(cuts, 2):
            picture = scenery.copy()
            places = [
                paste(picture, cut, SIZE[1] / 2 + shift, top)
                for cut, shift, top in zip((back, front), (0, aside * HEIGHT), TOP, strict=True)
            ]
            people = find_people(picture)
            found = np.array([is_found(*each, people) for each in zip(places, (back, front), strict=True)])
            found = found.reshape(2, len(people))
            counts += [1, *found.any(axis=1), (~found.any(axis=0)).sum()]
        print("{} aside: {} pairs, behind found {}, before found {}, others {}".format(aside, *counts))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
