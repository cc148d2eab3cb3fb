"""Reading of one person from the files that commands take: picture, keypoints and part labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .keypoint_files import read_keypoints
from .keypoints import Keypoints2D, choose_person
from .part_labels import PartLabels, check_sizes, read_labelled_parts, read_photo
from .person import check_inside


@dataclass(frozen=True)
class PersonInputs:
    """Arguments of ``fit_body`` for one person, and the picture.

    Attributes:
        keypoints: The person's.
        others: Other people's in the picture.
        parts: The picture's part labels; None without.
        photo: RGB, shape (H, W, 3), uint8; None without.
    """

    keypoints: Keypoints2D
    others: tuple[Keypoints2D, ...] = ()
    parts: PartLabels | None = None
    photo: np.ndarray | None = None


def read_person(
    keypoints: Path,
    *,
    photo: Path | None = None,
    parts: Path | None = None,
    labels: str | None = None,
    keypoint_format: str | None = None,
    index: int | None = None,
) -> PersonInputs:
    """Read one person's files, and check that they fit each other.

    Args:
        keypoints: 2D keypoints of the picture's people.
        photo: The picture.
        parts: Its part labels.
        labels: Meaning of their ids, as ``read_labelled_parts`` takes it.
        keypoint_format: Format of the keypoints, if the file does not name it.
        index: Index of the person among those with keypoints; None takes the largest.

    Raises:
        InputError: If a file can't be read, or they don't fit each other.
    """
    picture = None if photo is None else read_photo(photo)
    image = read_labelled_parts(parts, labels)
    groups = None if image is None else image.groups
    check_sizes(photo=None if picture is None else picture.shape[:2], parts=None if groups is None else groups.shape)
    people = read_keypoints(keypoints, keypoint_format)
    chosen = choose_person(people, groups, index)
    check_inside(chosen, next((seen.shape[:2] for seen in (picture, groups) if seen is not None), None))
    return PersonInputs(chosen, tuple(other for other in people if other is not chosen), image, picture)
