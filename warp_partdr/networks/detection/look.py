"""The landmark network at work: from crops to landmarks and masks in the picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...inputs.keypoints import Keypoints2D
from ...interop.captured_call import call_as_graph
from .asset import PeopleNetworks
from .crops import Pyramid, TurnedCrops, crops_of_people, cut_crops, join_crops, work_on_crops
from .heat import refine_landmarks
from .person import SKELETON, FoundPerson

NUM_LANDMARKS = 33  # then the middle of the hips and the point above the head that the next crop takes, and four more
_VALUES = 5  # of a landmark: x, y, depth, visibility, presence


@dataclass(frozen=True)
class FoundLandmarks:
    """People in their crops, as the landmark network says them.

    Attributes:
        crops: Crops in which the network looked.
        points: Landmarks [px], shape (N, 33, 2).
        confidence: Confidence that a landmark is in the picture and not hidden, shape (N, 33).
        presence: Confidence that there is a person, shape (N,).
        next_crops: Crops that the landmarks place around the people.
        masks: Logits of the masks, shape (N, 256, 256), on the network's device.
    """

    crops: TurnedCrops
    points: np.ndarray
    confidence: np.ndarray
    presence: np.ndarray
    next_crops: TurnedCrops
    masks: torch.Tensor

    def select(self, rows: np.ndarray) -> FoundLandmarks:
        """Some of them."""
        kept = torch.from_numpy(rows).to(self.masks.device)
        arrays = (self.points[rows], self.confidence[rows], self.presence[rows])
        return FoundLandmarks(self.crops[rows], *arrays, self.next_crops[rows], self.masks[kept])

    def or_better(self, other: FoundLandmarks, better: np.ndarray) -> FoundLandmarks:
        """People as these looks say them, or as the other looks do where a mask (N,) is true."""
        return join_landmarks([self, other]).select(np.arange(len(better)) + len(better) * better)

    def people(self, rows: np.ndarray, scores: np.ndarray, sizes: np.ndarray) -> list[FoundPerson]:
        """Some of them as people, with scores (R,), in pictures of sizes (H, W), shape (R, 2)."""
        some, side = self.select(rows), self.masks.shape[-1]
        corners = some.crops.to_picture(np.broadcast_to([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], (len(rows), 3, 2)))
        start, across, down = torch.from_numpy(corners).to(self.masks)[:, :, None, None].unbind(1)
        steps = (torch.arange(side, device=self.masks.device) + 0.5) / side
        positions = start + (across - start) * steps[:, None] + (down - start) * steps[:, None, None]
        extents = torch.from_numpy(np.ascontiguousarray(sizes[:, ::-1])).to(self.masks)[:, None, None]
        masks = some.masks.sigmoid() * ((positions >= 0) & (positions <= extents)).all(-1)
        shown = (masks > 0.5)[..., None]
        low = torch.where(shown, positions, torch.inf).amin((1, 2)).cpu().numpy()
        high = torch.where(shown, positions, -torch.inf).amax((1, 2)).cpu().numpy()
        lost = ~np.isfinite(low).all(axis=1)  # nothing of the person is shown
        points = np.clip(some.points[lost], 0, sizes[lost, None, ::-1])
        low[lost], high[lost] = points.min(axis=1, initial=np.inf), points.max(axis=1, initial=-np.inf)
        boxes = np.concatenate([low, high], axis=1).tolist()
        values = zip(some.points.astype(np.float32), some.confidence.astype(np.float32), strict=True)
        ones = [slice(row, row + 1) for row in range(len(rows))]
        return [
            FoundPerson(Keypoints2D(SKELETON, *each), score, box, some.crops[one], mask, some.next_crops[one])
            for each, score, box, one, mask in zip(values, scores.tolist(), map(tuple, boxes), ones, masks, strict=True)
        ]


def join_landmarks(parts: Sequence[FoundLandmarks]) -> FoundLandmarks:
    """All of the people in a row."""
    return FoundLandmarks(
        join_crops([part.crops for part in parts]),
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.confidence for part in parts]),
        np.concatenate([part.presence for part in parts]),
        join_crops([part.next_crops for part in parts]),
        torch.cat([part.masks for part in parts]),
    )


def look(networks: PeopleNetworks, pyramids: Sequence[Pyramid], crops: TurnedCrops) -> FoundLandmarks:
    """Landmarks and masks of the people in the crops."""
    network = networks.landmarks

    def ask(part: TurnedCrops) -> tuple[torch.Tensor, ...]:
        values = network(cut_crops(pyramids, part, network.size, beyond="border"))
        return read_landmarks(values, network.size), values["presence"][:, 0].double(), values["mask"][:, 0]

    said = work_on_crops(ask, crops, networks.device)
    if not said:
        none = np.zeros((0, NUM_LANDMARKS))
        masks = torch.zeros(0, network.size, network.size, device=networks.device)
        return FoundLandmarks(crops, np.zeros((*none.shape, 2)), none, none[:, 0], crops, masks)
    landmarks = torch.cat([each[0] for each in said]).cpu().numpy()
    presence = torch.cat([each[1] for each in said]).cpu().numpy()
    masks = torch.cat([each[2] for each in said])
    points, confidence, next_crops = place_landmarks(landmarks, crops)
    return FoundLandmarks(crops, points, confidence, presence, next_crops, masks)


def read_landmarks(values: Mapping[str, torch.Tensor], size: int) -> torch.Tensor:
    """Landmarks that a network says of pictures of a side of ``size`` [px].

    Returns:
        x and y from 0 to 1 across the crop, depth, visibility and presence from 0 to 1, shape (N, 39, 5), float64.
    """
    return call_as_graph(_read_landmarks, (values["landmarks"], values["heat"]), size)[0]


def _read_landmarks(numbers: torch.Tensor, heat: torch.Tensor, size: int) -> tuple[torch.Tensor]:
    """Compute ``read_landmarks`` of numbers (N, 195), with logits of heat (N, 39, H, W)."""
    landmarks = numbers.unflatten(1, (-1, _VALUES))
    places = refine_landmarks(landmarks[..., :2] / size, heat).double()
    rest = landmarks[..., 2:].double()
    return (torch.cat([places, rest[..., :1], rest[..., 1:].sigmoid()], dim=-1),)


def place_landmarks(landmarks: np.ndarray, crops: TurnedCrops) -> tuple[np.ndarray, np.ndarray, TurnedCrops]:
    """Points, confidence and next crops, as ``FoundLandmarks`` has them, of landmarks of ``read_landmarks``."""
    positions = crops.to_picture(landmarks[..., :2])
    next_crops = crops_of_people(positions[:, NUM_LANDMARKS], positions[:, NUM_LANDMARKS + 1], crops.pictures)
    return positions[:, :NUM_LANDMARKS], landmarks[:, :NUM_LANDMARKS, 3:].prod(axis=-1), next_crops
