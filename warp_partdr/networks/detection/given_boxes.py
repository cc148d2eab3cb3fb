"""People in boxes of another detector, with landmarks and masks of the packaged network if it sees the same person."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from ...errors import InputError
from ...inputs.keypoints import Keypoints2D
from ...inputs.person import Box
from ...interop.checks import check_image_size
from ...interop.torch_threads import one_torch_thread
from . import LandmarkNetwork
from .asset import packaged_people_networks
from .crops import Pyramid, TurnedCrops, cut_crops
from .heavy import with_heavy_landmarks
from .look import NUM_LANDMARKS, FoundLandmarks, look
from .person import SKELETON, FoundPerson
from .same_person import similarity

_MARGIN = 1.25  # side of a first crop, as a share of the longer side of the box
_MERGED = 0.7  # intersection over union above which two boxes are of one person
_AGREED = 0.5  # intersection over union of a box and a mask from which on both are of one person
_ALIKE = 0.5  # similarity above which landmarks coincide, as in ``same_person``
_EMPTY = 1e-9  # [px^2]


@dataclass(frozen=True)
class BoxNetwork:
    """Network that finds people's boxes in a whole picture.

    Attributes:
        size: Height and width (H, W) of the pictures that it takes [px].
        predict: Function from a picture, RGB from 0 to 1, shape (1, 3, H, W), to left, top, right and bottom of each
            box, from 0 to 1 across the picture, and the confidence that there is a person, from 0 to 1, shape (N, 5).
        longest: Greatest length of the longer side, for pictures that keep their shape [px]. The shorter side is then
            that of ``size``. If it is None, pictures are stretched to ``size``.
        about: Name and size of the network, to be shown.
        name: Name or folder of the network, for reports.

    Examples:
        >>> import torch
        >>> from warp_partdr import BoxNetwork
        >>> def predict(picture):  # (1, 3, 320, 320), to left, top, right, bottom and confidence of each box
        ...     return torch.tensor([[0.3, 0.1, 0.7, 0.9, 0.8]])
        >>> boxes = BoxNetwork(size=(320, 320), predict=predict, name="mine")
        >>> boxes.predict(torch.zeros(1, 3, 320, 320)).shape  # KeypointNetwork(..., boxes=boxes) takes it
        torch.Size([1, 5])
    """

    size: tuple[int, int]
    predict: Callable[[torch.Tensor], torch.Tensor]
    longest: int | None = None
    about: str = ""
    name: str = "unnamed"

    def __post_init__(self) -> None:
        check_image_size(self.size)
        if self.longest is not None and not self.longest >= min(self.size):
            raise ValueError(f"longest: {self.longest}; expected {min(self.size)} or more, as size has it")

    def size_of(self, size: tuple[int, int]) -> tuple[int, int]:
        """Size (H, W) in which the network takes a picture of this size [px]."""
        if self.longest is None:
            return self.size
        zoom = min(min(self.size) / min(size), self.longest / max(size))
        return max(round(size[0] * zoom), 1), max(round(size[1] * zoom), 1)


@torch.no_grad()
def find_boxes(network: BoxNetwork, picture: Pyramid, min_score: float) -> tuple[np.ndarray, np.ndarray]:
    """Boxes of people in a picture, best first, each person once.

    Returns:
        Left, top, right, bottom [px], within the picture, shape (N, 4), and scores, at least ``min_score``, shape (N,).

    Raises:
        InputError: If the network gives something else than ``BoxNetwork`` says.
    """
    height, width = picture.size
    whole = TurnedCrops(
        np.array([[width / 2, height / 2]]),
        np.array([float(height)]),
        np.zeros(1),
        np.zeros(1, np.int64),
        width / height,
    )
    said = network.predict(cut_crops([picture], whole, network.size_of(picture.size), beyond="border"))
    if not isinstance(said, torch.Tensor) or said.ndim != 2 or said.shape[1] != 5:
        found = tuple(said.shape) if isinstance(said, torch.Tensor) else type(said).__name__
        raise InputError(f"boxes: {found}; expected left, top, right, bottom, confidence (N, 5)")
    values = said.double().cpu().numpy()
    values = values[np.isfinite(values).all(axis=1) & (values[:, 4] >= min_score)]
    boxes = (values[:, :4].clip(0, 1)) * [width, height, width, height]
    there = (boxes[:, 2:] - boxes[:, :2] > 1).all(axis=1)  # at least a pixel
    boxes, scores = boxes[there], values[there, 4].clip(0, 1)
    kept: list[int] = []
    for row in np.argsort(-scores, kind="stable").tolist():
        if all(_overlap(boxes[row], boxes[other]) <= _MERGED for other in kept):
            kept.append(row)
    return boxes[kept], scores[kept]


@one_torch_thread()
def find_people_in_boxes(
    network: BoxNetwork, picture: Pyramid, min_score: float, *, landmarks: LandmarkNetwork = "full"
) -> list[FoundPerson]:
    """Find the people of another detector's boxes, largest box first.

    The packaged network looks at each box twice. If it sees nobody or somebody else in a box, only the box is known
    (``FoundPerson.seen``). If the landmarks of several boxes coincide, only the best box keeps them.

    Args:
        network: Network that finds the boxes.
        picture: Picture on the network's device.
        min_score: Least confidence of a box, and of the landmarks.
        landmarks: Network whose keypoints are taken, as in ``find_people``.

    Raises:
        InputError: If the network returns something else than ``BoxNetwork`` says.
    """
    boxes, scores = find_boxes(network, picture, min_score)
    order = np.argsort(-(boxes[:, 2:] - boxes[:, :2]).prod(axis=1), kind="stable")
    boxes, scores = boxes[order], scores[order]
    crops = TurnedCrops(
        (boxes[:, :2] + boxes[:, 2:]) / 2,
        _MARGIN * (boxes[:, 2:] - boxes[:, :2]).max(axis=1, initial=0),
        np.zeros(len(boxes)),
        np.zeros(len(boxes), np.int64),
    )
    networks = packaged_people_networks(str(picture.device), landmarks=landmarks)
    first = look(networks, [picture], crops)
    looks = [first, look(networks, [picture], first.next_crops)] if len(boxes) else []
    candidates = [_seen(each, scores, picture.size) for each in looks]
    fits = np.zeros((len(candidates), len(boxes)))
    for index, (looked, found) in enumerate(zip(looks, candidates, strict=True)):
        shared = [_overlap(np.array(person.box), box) for person, box in zip(found, boxes, strict=True)]
        fits[index] = np.where(looked.presence >= min_score, shared, 0.0)
    chosen: list[FoundPerson | None] = []
    for row in range(len(boxes)):
        better = 1 if fits[1, row] >= _AGREED else 0  # the crop of the second look is placed by the landmarks
        chosen.append(candidates[better][row] if fits[better, row] >= _AGREED else None)
    taken: list[FoundPerson] = []
    for row in np.argsort(-fits.max(axis=0, initial=0), kind="stable").tolist():
        person = chosen[row]
        if person is None or any(_coincide(person, other) for other in taken):
            chosen[row] = None
        else:
            taken.append(person)
    if networks.heavy is not None:
        there = [person for person in chosen if person is not None]
        rows = [row for row, person in enumerate(chosen) if person is not None]
        nearer = with_heavy_landmarks(networks.heavy, [picture], [there])[0]
        for row, person in zip(rows, nearer, strict=True):
            chosen[row] = person
    return [
        person or _only_box(boxes[row], float(scores[row]), crops[row : row + 1], picture.device)
        for row, person in enumerate(chosen)
    ]


def _seen(landmarks: FoundLandmarks, scores: np.ndarray, size: tuple[int, int]) -> list[FoundPerson]:
    return landmarks.people(np.arange(len(scores)), scores, np.tile(np.array(size), (len(scores), 1)))


def _only_box(box: np.ndarray, score: float, crop: TurnedCrops, device: torch.device) -> FoundPerson:
    """Person with a box alone, without known landmarks and pixels."""
    points = np.tile(crop.centres, (NUM_LANDMARKS, 1)).astype(np.float32)
    keypoints = Keypoints2D(SKELETON, points, np.zeros(NUM_LANDMARKS, np.float32))
    left, top, right, bottom = box.tolist()
    edges: Box = (left, top, right, bottom)
    return FoundPerson(keypoints, score, edges, crop, torch.zeros(256, 256, device=device), crop)


def _overlap(box: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union of two boxes (4,)."""
    both = float(np.clip(np.minimum(box[2:], other[2:]) - np.maximum(box[:2], other[:2]), 0, None).prod())
    areas = [float((each[2:] - each[:2]).prod()) for each in (box, other)]
    return both / max(sum(areas) - both, _EMPTY)


def _coincide(one: FoundPerson, other: FoundPerson) -> bool:
    """True if the landmarks of two people are about the same."""
    return same_keypoints(
        one.keypoints, other.keypoints, (float(one.next_crop.sides[0]), float(other.next_crop.sides[0]))
    )


def same_keypoints(one: Keypoints2D, other: Keypoints2D, sides: tuple[float, float]) -> bool:
    """True if keypoints of one format are about the same, for people in crops of these sides [px]."""
    ours = one.points[None].astype(np.float64), one.confidence[None], np.array([sides[0]])
    theirs = other.points[None].astype(np.float64), other.confidence[None], np.array([sides[1]])
    return bool(similarity(ours, theirs)[0] >= _ALIKE)
