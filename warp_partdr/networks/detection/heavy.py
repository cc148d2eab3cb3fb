"""Keypoints of the larger landmark network, for people whom the smaller one has found.

The larger network is nearer to the truth and seldom exchanges left and right, but takes 2.6 times as long. It runs last
and once for each person, so that the same people are found with either network. Masks are those of the smaller network,
which are better. A part head beside it says which part each pixel shows, and where the joints are. Limbs' keypoints are
means of both networks' answers, and hips those of the head, for BlazePose's lie a hand's breadth off.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from ...body.landmarks import mirror_order
from ...body.skeletons import BODY_LANDMARKS, skeleton
from ...body.template import JOINT_NAMES, PART_NAMES
from ...inputs.keypoints import Keypoints2D
from ...interop.device_cache import device_cache
from .crops import Pyramid, TurnedCrops, cut_crops, join_crops, work_on_crops
from .graph import OperatorGraph
from .heavy_network import HeavyNetwork
from .look import NUM_LANDMARKS, place_landmarks, read_landmarks
from .person import SKELETON, FoundPerson, LikeliestParts
from .same_person import first_of_each, similarity

_JOINTS = [skeleton(SKELETON).landmarks.index(name) for name in BODY_LANDMARKS]
_LEAST_WEIGHT = 1e-3  # so that all joints count alike if none is seen
# Share of the part head's joint in a keypoint. In 24 photos of Pose2Sim's man, hips were 3.1 % of his height from the
# truth by BlazePose and 1.7 % by the head; the median of all limb joints was 1.35 % by either, and 1.29 % in the mean.
_FROM_HEAD = {"hip": 1.0, "shoulder": 0.5, "elbow": 0.5, "wrist": 0.5, "knee": 0.5, "ankle": 0.5}

Network = OperatorGraph | HeavyNetwork  # without or with a part head


@dataclass(frozen=True)
class TwoLooks:
    """Looks at crops of N people and at their mirror images, mirrored back.

    Attributes:
        own: Landmarks in the crops, as ``read_landmarks`` returns them, but without the last four, shape (N, 35, 5).
        turned: Landmarks in the mirror images.
        parts: Likeliest parts in the N crops, by the mean of both looks; None if the network has no part head.
    """

    own: np.ndarray
    turned: np.ndarray
    parts: LikeliestParts | None


def with_heavy_landmarks(
    network: Network, pyramids: Sequence[Pyramid], everyone: Sequence[Sequence[FoundPerson]]
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
    looks = look_twice(network, pyramids, crops)
    points, confidence, next_crops = place_landmarks((looks.own + looks.turned) / 2, crops)
    apart = _mirror_distances(looks.own, looks.turned, confidence)
    before = (
        np.stack([person.keypoints.points for person in found]),
        np.stack([person.keypoints.confidence for person in found]),
        np.concatenate([person.next_crop.sides for person in found]),
    )
    kept = similarity(before, (points, confidence, next_crops.sides))
    for row in first_of_each(points, confidence, next_crops.sides, pictures, kept).tolist():
        keypoints = Keypoints2D(SKELETON, points[row].astype(np.float32), confidence[row].astype(np.float32))
        next_crop, distance = next_crops[row : row + 1], float(apart[row])
        parts = None if looks.parts is None else looks.parts[row]
        found[row] = replace(
            found[row], keypoints=keypoints, next_crop=next_crop, mirror_distance=distance, parts=parts
        )
    rest = iter(found)
    return [[next(rest) for _ in people] for people in everyone]


def see_landmarks(
    network: Network, pyramids: Sequence[Pyramid], crops: TurnedCrops, *, mirror: bool = True
) -> np.ndarray:
    """Find landmarks in crops, as ``read_landmarks`` returns them, but without the last four, shape (N, 35, 5).

    Args:
        network: Landmark network, with or without a part head.
        pyramids: The pictures.
        crops: Crops of the pictures, at least one.
        mirror: True returns means of the landmarks in a crop and in its mirror image. They lie nearer to the truth.
    """
    if mirror:
        looks = look_twice(network, pyramids, crops)
        return (looks.own + looks.turned) / 2

    def ask(part: TurnedCrops) -> torch.Tensor:
        return _landmarks_of(network(cut_crops(pyramids, part, network.size, beyond="border")), network.size)

    return torch.cat(work_on_crops(ask, crops, pyramids[0].device)).cpu().numpy()


def look_twice(network: Network, pyramids: Sequence[Pyramid], crops: TurnedCrops) -> TwoLooks:
    """Look at crops and at their mirror images; arguments as those of ``see_landmarks``."""

    def ask(part: TurnedCrops) -> tuple[torch.Tensor, torch.Tensor, LikeliestParts | None]:
        pictures = cut_crops(pyramids, part, network.size, beyond="border")
        first, second = network(pictures), network(pictures.flip(-1))
        own = _landmarks_of(first, network.size)
        turned = _mirrored_back(_landmarks_of(second, network.size))
        if "parts" not in first:
            return own, turned, None
        mean = (first["parts"] + second["parts"].flip(-1)[:, _head_orders(pictures.device).parts]) / 2
        return own, turned, LikeliestParts.of(mean)

    looks = work_on_crops(ask, crops, pyramids[0].device)
    own = torch.cat([look for look, _, _ in looks])
    turned = torch.cat([look for _, look, _ in looks])
    parts = [each for _, _, each in looks if each is not None]
    return TwoLooks(own.cpu().numpy(), turned.cpu().numpy(), LikeliestParts.joined(parts) if parts else None)


def _landmarks_of(values: Mapping[str, torch.Tensor], size: int) -> torch.Tensor:
    """Landmarks (N, 35, 5) of a network's values; if it has a part head, limbs' landmarks are means with its joints."""
    landmarks = read_landmarks(values, size)[:, : NUM_LANDMARKS + 2]
    if "joints" in values:
        orders = _head_orders(landmarks.device)
        joints = values["joints"][:, orders.joints].double()
        landmarks[:, orders.limbs, :2] = torch.lerp(landmarks[:, orders.limbs, :2], joints, orders.shares)
    return landmarks


def _mirrored_back(landmarks: torch.Tensor) -> torch.Tensor:
    """Landmarks of mirror images, (N, 35, 5), as they lie in the pictures themselves."""
    turned = landmarks[:, _head_orders(landmarks.device).landmarks]
    turned[..., 0] = 1 - turned[..., 0]
    return turned


class _HeadOrders(NamedTuple):
    """Indices on a device, which would wait for what it is sent.

    Attributes:
        landmarks: Landmark that each one becomes in a mirror image, shape (35,).
        parts: Map that each of background and parts becomes in a mirror image, shape (21,).
        limbs: Landmarks that are joints of limbs, shape (12,).
        joints: Joints of these limbs among ``JOINT_NAMES``.
        shares: Shares of the part head's joints in them, shape (12, 1), float64.
    """

    landmarks: torch.Tensor
    parts: torch.Tensor
    limbs: torch.Tensor
    joints: torch.Tensor
    shares: torch.Tensor


@device_cache(8)
def _head_orders(device: torch.device) -> _HeadOrders:
    names = skeleton(SKELETON).landmarks
    hips, top = NUM_LANDMARKS, NUM_LANDMARKS + 1
    limbs = [name for name in names if name.split("_")[-1] in _FROM_HEAD]
    return _HeadOrders(
        torch.tensor([*skeleton(SKELETON).mirror.tolist(), hips, top], device=device),
        torch.tensor([0, *(mirror_order(PART_NAMES) + 1).tolist()], device=device),
        torch.tensor([names.index(name) for name in limbs], device=device),
        torch.tensor([JOINT_NAMES.index(name) for name in limbs], device=device),
        torch.tensor([[_FROM_HEAD[name.split("_")[-1]]] for name in limbs], dtype=torch.float64, device=device),
    )


def _mirror_distances(own: np.ndarray, turned: np.ndarray, confidence: np.ndarray) -> np.ndarray:
    """Compute ``FoundPerson.mirror_distance``, shape (N,), from the landmarks of both looks (N, 35, 5)."""
    distances = np.linalg.norm(own[:, _JOINTS, :2] - turned[:, _JOINTS, :2], axis=-1)
    weights = confidence[:, _JOINTS] + _LEAST_WEIGHT
    found: np.ndarray = (distances * weights).sum(axis=1) / weights.sum(axis=1)
    return found
