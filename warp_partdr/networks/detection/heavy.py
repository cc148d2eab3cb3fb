"""Keypoints of the larger landmark network, for people whom the smaller one has found.

The larger network is nearer to the truth and seldom exchanges left and right, but takes 2.6 times as long. It runs last
and once for each person, so that the same people are found with either network. Masks are those of the smaller network,
which are better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ...body.skeletons import BODY_LANDMARKS, skeleton
from ...inputs.keypoints import Keypoints2D
from .crops import Pyramid, TurnedCrops, cut_crops, join_crops, work_on_crops
from .graph import OperatorGraph
from .look import NUM_LANDMARKS, place_landmarks, read_landmarks
from .person import SKELETON, FoundPerson
from .same_person import first_of_each, similarity

_JOINTS = [skeleton(SKELETON).landmarks.index(name) for name in BODY_LANDMARKS]
_LEAST_WEIGHT = 1e-3  # so that all joints count alike if none is seen


def with_heavy_landmarks(
    network: OperatorGraph, pyramids: Sequence[Pyramid], everyone: Sequence[Sequence[FoundPerson]]
) -> list[list[FoundPerson]]:
    """Replace people's keypoints by those of the larger network, which looks at the crops of their masks.

    If the larger network sees one person in the crops of several people, only the person whose keypoints change least
    gets the new keypoints. The order of people stays.

    Args:
        network: Network ``PeopleNetworks.heavy``.
        pyramids: The pictures, on the network's device.
        everyone: The people of each picture.
    """
    found = [person for people in everyone for person in people]
    if not found:
        return [list(people) for people in everyone]
    pictures = np.repeat(np.arange(len(everyone)), [len(people) for people in everyone])
    crops = replace(join_crops([person.crop for person in found]), pictures=pictures)
    own, turned = look_twice(network, pyramids, crops)
    points, confidence, next_crops = place_landmarks((own + turned) / 2, crops)
    apart = _mirror_distances(own, turned, confidence)
    before = (
        np.stack([person.keypoints.points for person in found]),
        np.stack([person.keypoints.confidence for person in found]),
        np.concatenate([person.next_crop.sides for person in found]),
    )
    kept = similarity(before, (points, confidence, next_crops.sides))
    for row in first_of_each(points, confidence, next_crops.sides, pictures, kept).tolist():
        keypoints = Keypoints2D(SKELETON, points[row].astype(np.float32), confidence[row].astype(np.float32))
        next_crop, distance = next_crops[row : row + 1], float(apart[row])
        found[row] = replace(found[row], keypoints=keypoints, next_crop=next_crop, mirror_distance=distance)
    rest = iter(found)
    return [[next(rest) for _ in people] for people in everyone]


def see_landmarks(
    network: OperatorGraph, pyramids: Sequence[Pyramid], crops: TurnedCrops, *, mirror: bool = True
) -> np.ndarray:
    """Find landmarks in crops, as ``read_landmarks`` returns them, but without the last four, shape (N, 35, 5).

    Args:
        network: Network as in ``with_heavy_landmarks``.
        pyramids: The pictures.
        crops: Crops of the pictures, at least one.
        mirror: True returns means of the landmarks in a crop and in its mirror image. They lie nearer to the truth.
    """
    if mirror:
        own, turned = look_twice(network, pyramids, crops)
        return (own + turned) / 2

    def ask(part: TurnedCrops) -> torch.Tensor:
        return _see_crops(network, cut_crops(pyramids, part, network.size, beyond="border"), mirrored=False)

    return torch.cat(work_on_crops(ask, crops, pyramids[0].device)).cpu().numpy()


def look_twice(
    network: OperatorGraph, pyramids: Sequence[Pyramid], crops: TurnedCrops
) -> tuple[np.ndarray, np.ndarray]:
    """Find landmarks in crops and in their mirror images, mirrored back, as ``see_landmarks`` returns them."""

    def ask(part: TurnedCrops) -> torch.Tensor:
        pictures = cut_crops(pyramids, part, network.size, beyond="border")
        return torch.stack([_see_crops(network, pictures, mirrored=mirrored) for mirrored in (False, True)], dim=1)

    both = torch.cat(work_on_crops(ask, crops, pyramids[0].device)).cpu().numpy()
    return both[:, 0], both[:, 1]


def _see_crops(network: OperatorGraph, pictures: torch.Tensor, *, mirrored: bool) -> torch.Tensor:
    """Find landmarks in pictures of crops, or in their mirror images, mirrored back, shape (N, 35, 5)."""
    hips, top = NUM_LANDMARKS, NUM_LANDMARKS + 1
    order = torch.tensor([*skeleton(SKELETON).mirror.tolist(), hips, top])
    if not mirrored:
        return read_landmarks(network(pictures), network.size)[:, : len(order)]
    turned = read_landmarks(network(pictures.flip(-1)), network.size)[:, order.to(pictures.device)]
    turned[..., 0] = 1 - turned[..., 0]
    return turned


def _mirror_distances(own: np.ndarray, turned: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Compute ``FoundPerson.mirror_distance``, shape (N,), from the landmarks of both looks (N, 35, 5)."""
    distances = np.linalg.norm(own[:, _JOINTS, :2] - turned[:, _JOINTS, :2], axis=-1)
    weights = confidence[:, _JOINTS] + _LEAST_WEIGHT
    found: np.ndarray = (distances * weights).sum(axis=1) / weights.sum(axis=1)
    return found
