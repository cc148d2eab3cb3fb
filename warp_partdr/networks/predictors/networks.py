"""Networks of others as functions, and the crop in which they see a person."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from ...body.labels import LabelSet
from ...body.skeletons import Skeleton, skeleton
from ...errors import check_type
from ...interop.checks import check_image_size
from ..detection.crops import Pyramid, TurnedCrops, cut_crops
from ..detection.given_boxes import BoxNetwork
from ..detection.person import FoundPerson

Predict = Callable[[torch.Tensor], torch.Tensor]

_MARGIN = 1.25  # extent of a crop, the person's being 1, as ViTPose and most others have it
_SHOWN = 0.5  # least probability of a pixel of the mask that shows the person
_SMALLEST = 1e-3  # least extent of a person, as a share of the detector's crop


@dataclass(frozen=True)
class PartNetwork:
    """Network that says which part each pixel of a person's picture shows.

    Attributes:
        labels: Label set of its results.
        size: Height and width (H, W) of the pictures that it takes [px].
        predict: Function from pictures, RGB from 0 to 1, shape (N, 3, H, W), to probabilities or to ids. Probabilities
            are one map per id of ``labels.channel_ids``, shape (N, K, h, w), and sum to 1. Ids are integers (N, h, w).
            Both may be smaller than the pictures.
        stretch: Greatest factor by which a picture may be stretched in one direction to have that size. A factor of 1
            keeps its shape.
        about: Name and size of the network, to be shown.
        name: Name or folder of the network, for reports.

    Examples:
        >>> from warp_partdr import PartNetwork, fit_photo, label_set
        >>> def predict(pictures):  # (N, 3, 256, 192), to the id of each pixel: here a person is what is not gray
        ...     return (pictures.amax(1) - pictures.amin(1) > 0.1).long()
        >>> network = PartNetwork(label_set("full1"), size=(256, 192), predict=predict, name="mine")
        >>> everyone = fit_photo("photo.png", parts_from=network)
        >>> everyone.sources[0]["parts"]
        'mine'
    """

    labels: LabelSet
    size: tuple[int, int]
    predict: Predict
    stretch: float = 1.0
    about: str = ""
    name: str = "unnamed"

    def __post_init__(self) -> None:
        check_type("labels", self.labels, LabelSet, "of label_set")
        check_image_size(self.size)
        if not self.stretch >= 1:
            raise ValueError(f"stretch: {self.stretch}; expected a number of 1 or more")


@dataclass(frozen=True)
class KeypointNetwork:
    """Network that finds the keypoints of the person in a picture.

    Attributes:
        skeleton: Keypoint format of its results, by name, or one's own.
        size: Height and width (H, W) of the pictures that it takes [px].
        predict: Function from pictures, RGB from 0 to 1, shape (N, 3, H, W), to x and y, from 0 to 1 across the
            picture, and a confidence from 0 to 1, for each point of the format, shape (N, count, 3).
        about: Name and size of the network, to be shown.
        name: Name or folder of the network, for reports.
        boxes: Network that finds the people in photos. If it is None, the packaged one does.

    Examples:
        >>> import torch
        >>> from warp_partdr import KeypointNetwork
        >>> def predict(pictures):  # (N, 3, 256, 192), to x, y and a confidence for each of COCO's 17 points
        ...     return torch.full((len(pictures), 17, 3), 0.5)
        >>> network = KeypointNetwork("coco17", size=(256, 192), predict=predict, name="mine")
        >>> network.predict(torch.zeros(2, 3, 256, 192)).shape  # fit_photo(..., keypoints_from=network) takes it
        torch.Size([2, 17, 3])
    """

    skeleton: str | Skeleton
    size: tuple[int, int]
    predict: Predict
    about: str = ""
    name: str = "unnamed"
    boxes: BoxNetwork | None = None

    def __post_init__(self) -> None:
        skeleton(self.skeleton)
        check_type("boxes", self.boxes, BoxNetwork | None, "of load_box_network")
        check_image_size(self.size)


def upright_crop(person: FoundPerson, size: tuple[int, int], *, stretch: float = 1.0) -> TurnedCrops:
    """Crop about a person, with a margin, turned as the detector's.

    It is as the person's mask and keypoints lie in that, but made wider or higher until it has the shape of (H, W), or
    is at most ``stretch`` narrower or wider.
    """
    pixels = (person.mask > _SHOWN).nonzero().cpu().numpy()
    shown = (pixels[:, ::-1] + 0.5) / person.mask.shape[::-1]
    keypoints = person.keypoints
    confident = person.crop.from_picture(keypoints.points[None, keypoints.confident].astype(np.float64))[0]
    positions = np.concatenate([shown, confident])
    if not len(positions):  # nobody was seen in another detector's box
        positions = person.crop.from_picture(np.array(person.box, dtype=np.float64).reshape(1, 2, 2))[0]
    low, high = positions.min(axis=0), positions.max(axis=0)
    width, height = _MARGIN * np.maximum(high - low, _SMALLEST) * person.crop.sides
    aspect = size[1] / size[0]
    width = max(width, height * aspect / stretch)
    height = max(height, width / (aspect * stretch))
    centre = person.crop.to_picture(((low + high) / 2)[None, None])[0]
    return TurnedCrops(centre, np.array([height]), person.crop.angles, np.zeros(1, np.int64), float(width / height))


def cut_upright(picture: Pyramid, person: FoundPerson, size: tuple[int, int], *, stretch: float = 1.0) -> torch.Tensor:
    """Picture (1, 3, H, W) of a person, from 0 to 1, as a network takes it: of ``upright_crop``."""
    return cut_crops([picture], upright_crop(person, size, stretch=stretch), size)
