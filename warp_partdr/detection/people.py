"""Everyone in a picture, or in several: from the detector's boxes to keypoints and masks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ..errors import InputError, check_each, check_type, check_whole, shown
from ..inputs.keypoints import Keypoints2D
from ..interop.torch_threads import one_torch_thread
from .asset import PeopleNetworks, packaged_people_networks
from .boxes import average_boxes, decode
from .crops import Pyramid, TurnedCrops, crops_of_people, cut_crops, join_crops
from .heat import refine_landmarks
from .person import SKELETON, Person
from .same_person import distinct_crops, first_of_each

_NUM_LANDMARKS = 33  # then the middle of the hips and the point above the head that the next crop takes, and four more
_VALUES = 5  # of a landmark: x, y, depth, visibility, presence
_BATCH = {"cpu": 8, "cuda": 256}  # crops at a time: on CPU, what caches hold


def find_people(
    picture: np.ndarray,
    *,
    device: torch.device | str = "cpu",
    min_score: float = 0.5,
    levels: int = 2,
    previous: Sequence[Person] = (),
) -> list[Person]:
    """Find everyone in a picture.

    Args:
        picture: RGB, shape (H, W, 3), uint8.
        device: Device to run on.
        min_score: Least confidence that there is a person, of the detector and of the landmarks, 0 to 1.
        levels: 1 looks at the whole picture alone, where people of a quarter of its longer side and more are found;
            each further level, at overlapping tiles of half the size, finds people half as large. Tiles smaller than
            the detector's 224 pixels are left out.
        previous: The people of a film's last frame. Where they are given, only they are followed, and the detector
            doesn't run; nobody new is found.

    Returns:
        People, largest first; none if nobody is there.

    Raises:
        TypeError: If ``picture`` is no array, or ``previous`` are no people.
        InputError: If it is no picture.
        ValueError: If a number is out of range.
    """
    return find_people_in([picture], device=device, min_score=min_score, levels=levels, previous=[previous])[0]


@one_torch_thread()
@torch.inference_mode()
def find_people_in(
    pictures: Sequence[np.ndarray],
    *,
    device: torch.device | str = "cpu",
    min_score: float = 0.5,
    levels: int = 2,
    previous: Sequence[Sequence[Person]] | None = None,
) -> list[list[Person]]:
    """The same for several pictures of any sizes, in batches.

    Args:
        pictures: RGB, each of shape (H, W, 3), uint8.
        device: Device to run on.
        min_score: As in ``find_people``.
        levels: As in ``find_people``.
        previous: People of the frame before each picture; None of all.

    Returns:
        The people of each picture.
    """
    _check_pictures(pictures)
    levels = check_whole("levels", levels, 1)
    if not 0 <= min_score < 1:
        raise ValueError(f"min_score: {shown(min_score)}; expected a number from 0 to below 1")
    before = [()] * len(pictures) if previous is None else previous
    if len(before) != len(pictures):
        raise ValueError(f"previous: of {len(before)} pictures; expected {len(pictures)}, as pictures")
    for people in before:
        check_each("previous", people, Person, "of find_people")
    networks = packaged_people_networks(str(device))
    pyramids = [Pyramid(picture, networks.device) for picture in pictures]
    new = [index for index, people in enumerate(before) if not people]
    found = _look(networks, pyramids, _detect(networks, pyramids, new, min_score, levels), min_score)
    followed = [_moved(person.next_crop, index) for index, people in enumerate(before) for person in people]
    found = _look(networks, pyramids, join_crops([found.next_crops, *followed]), min_score)
    order = np.argsort(-found.next_crops.sides, kind="stable")
    people_of: list[list[Person]] = [[] for _ in pictures]
    for row in order.tolist():
        picture = int(found.crops.pictures[row])
        people_of[picture].append(found.person(row, pyramids[picture].size))
    return people_of


def _check_pictures(pictures: Sequence[np.ndarray]) -> None:
    for index, picture in enumerate(pictures):
        name = "picture" if len(pictures) == 1 else f"pictures[{index}]"
        check_type(name, picture, np.ndarray, "of read_photo")
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or not picture.size:
            raise InputError(f"{name}: {picture.dtype} {picture.shape}; expected uint8 (H, W, 3), RGB")


def _moved(crop: TurnedCrops, picture: int) -> TurnedCrops:
    return TurnedCrops(crop.centres, crop.sides, crop.angles, np.full(len(crop), picture))


def tiles(size: tuple[int, int], levels: int, smallest: int, picture: int = 0) -> TurnedCrops:
    """The squares that the detector looks at: one about the whole picture, then smaller ones that overlap by half.

    Args:
        size: (H, W) of the picture.
        levels: Number of sizes, each half of the one before.
        smallest: Least side of a tile [px], the first one's aside.
        picture: Index of the picture.
    """
    height, width = size
    centres, sides = [(width / 2, height / 2)], [float(max(size))]
    for level in range(1, levels):
        side = max(size) / 2**level
        if side < smallest:
            break
        rows, columns = (_middles(length, side) for length in size)
        centres += [(x, y) for y in rows for x in columns]
        sides += [side] * (len(rows) * len(columns))
    count = len(sides)
    return TurnedCrops(np.array(centres), np.array(sides), np.zeros(count), np.full(count, picture))


def _middles(length: int, side: float) -> list[float]:
    """Middles of the tiles that cover a length, neighbours at most half a tile apart."""
    if length <= side:
        return [length / 2]
    count = math.ceil((length - side) / (side / 2)) + 1
    return np.linspace(side / 2, length - side / 2, count).tolist()


def _detect(
    networks: PeopleNetworks, pyramids: Sequence[Pyramid], which: Sequence[int], min_score: float, levels: int
) -> TurnedCrops:
    """Crops about the people that the detector finds in the pictures ``which``."""
    size = networks.detector.size
    nothing = np.zeros((0, 2))
    views = join_crops(
        [crops_of_people(nothing, nothing, np.zeros(0, dtype=np.int64))]
        + [tiles(pyramids[picture].size, levels, size, picture) for picture in which]
    )
    found = [views[:0]]
    for part in _batches(views, networks.device):
        said = networks.detector(cut_crops(pyramids, part, size) * 2 - 1)
        for row, (boxes, scores) in enumerate(zip(said["boxes"].cpu(), said["scores"].cpu(), strict=True)):
            means, _ = average_boxes(*decode(boxes.numpy(), scores.numpy()[:, 0], size, min_score))
            view = part[np.full(len(means), row)]
            points = view.to_picture(means[:, 2:4] / size)
            found.append(crops_of_people(points[:, 0], points[:, 1], view.pictures))
    return distinct_crops(join_crops(found))  # larger tiles, which show people whole, come first


@dataclass(frozen=True)
class _Seen:
    """People in their crops, as the landmark network says them; masks [logits] (N, 256, 256) stay on its device."""

    crops: TurnedCrops
    points: np.ndarray  # (N, 33, 2) [px]
    confidence: np.ndarray  # (N, 33)
    presence: np.ndarray  # (N,)
    next_crops: TurnedCrops
    masks: torch.Tensor

    def select(self, rows: np.ndarray) -> _Seen:
        kept = torch.from_numpy(rows).to(self.masks.device)
        arrays = (self.points[rows], self.confidence[rows], self.presence[rows])
        return _Seen(self.crops[rows], *arrays, self.next_crops[rows], self.masks[kept])

    def person(self, row: int, size: tuple[int, int]) -> Person:
        """One of them, in a picture of size (H, W)."""
        one, extent = slice(row, row + 1), np.array(size[::-1])
        side = self.masks.shape[-1]
        y, x = np.mgrid[:side, :side]
        places = self.crops[one].to_picture((np.stack([x, y], axis=-1).reshape(1, -1, 2) + 0.5) / side)[0]
        inside = ((places >= 0) & (places <= extent)).all(axis=1)
        mask = self.masks[row].sigmoid().cpu().numpy() * inside.reshape(side, side).astype(np.float32)
        shown = places[mask.reshape(-1) > 0.5]
        corners = shown if len(shown) else np.clip(self.points[row], 0, extent)
        (left, top), (right, bottom) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        points, confidence = (values[row].astype(np.float32) for values in (self.points, self.confidence))
        score = float(self.presence[row] * confidence.mean())
        keypoints = Keypoints2D(SKELETON, points, confidence)
        return Person(keypoints, score, (left, top, right, bottom), self.crops[one], mask, self.next_crops[one])


def _look(networks: PeopleNetworks, pyramids: Sequence[Pyramid], crops: TurnedCrops, min_score: float) -> _Seen:
    """Landmarks and masks in the crops that do show a person, each person once."""
    network = networks.landmarks
    said = []
    for part in _batches(crops, networks.device):
        values = network(cut_crops(pyramids, part, network.size, beyond="border"))
        landmarks = values["landmarks"].unflatten(1, (-1, _VALUES))
        landmarks[..., :2] = refine_landmarks(landmarks[..., :2] / network.size, values["heat"])
        said.append((landmarks, values["presence"][:, 0], values["mask"][:, 0]))
    if not said:
        none = np.zeros((0, _NUM_LANDMARKS))
        masks = torch.zeros(0, network.size, network.size, device=networks.device)
        return _Seen(crops, np.zeros((*none.shape, 2)), none, none[:, 0], crops, masks)
    all_landmarks, all_presence, masks = (torch.cat(values) for values in zip(*said, strict=True))
    landmarks, presence = (values.cpu().numpy().astype(np.float64) for values in (all_landmarks, all_presence))
    places = crops.to_picture(landmarks[..., :2])
    sure = 1 / (1 + np.exp(-np.clip(landmarks[:, :_NUM_LANDMARKS, 3:], -50, 50)))
    next_crops = crops_of_people(places[:, _NUM_LANDMARKS], places[:, _NUM_LANDMARKS + 1], crops.pictures)
    seen = _Seen(crops, places[:, :_NUM_LANDMARKS], sure.prod(axis=-1), presence, next_crops, masks)
    seen = seen.select(np.flatnonzero(presence >= min_score))
    quality = seen.presence * seen.confidence.mean(axis=1)
    return seen.select(first_of_each(seen.points, seen.confidence, seen.next_crops.sides, seen.crops.pictures, quality))


def _batches(crops: TurnedCrops, device: torch.device) -> list[TurnedCrops]:
    """Crops in numbers that fit into memory."""
    step = _BATCH.get(device.type, max(_BATCH.values()))
    return [crops[start : start + step] for start in range(0, len(crops), step)]
