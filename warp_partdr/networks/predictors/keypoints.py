"""Keypoints of people by a network of others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...body.skeletons import skeleton
from ...errors import InputError
from ...inputs.keypoints import Keypoints2D
from ..detection.crops import Pyramid
from ..detection.person import FoundPerson
from .networks import KeypointNetwork, cut_upright, upright_crop


def find_keypoints(network: KeypointNetwork, picture: Pyramid, person: FoundPerson) -> Keypoints2D | None:
    """Keypoints of a person in the picture; None if the network sees no two of them.

    Raises:
        InputError: If the network gives something else than ``KeypointNetwork`` says.
    """
    return ask_keypoints(network, cut_upright(picture, person, network.size), [person])[0]


@torch.no_grad()
def ask_keypoints(
    network: KeypointNetwork, pictures: torch.Tensor, people: Sequence[FoundPerson]
) -> list[Keypoints2D | None]:
    """Ask a network for the keypoints of N people, each in a picture of ``cut_upright``.

    Raises:
        InputError: If the network gives something else than ``KeypointNetwork`` says.
    """
    form = skeleton(network.skeleton)
    said = network.predict(pictures)
    if not isinstance(said, torch.Tensor) or said.shape != (len(people), form.count, 3):
        found = tuple(said.shape) if isinstance(said, torch.Tensor) else type(said).__name__
        raise InputError(f"keypoints_from: {found}; expected x, y, confidence (N, {form.count}, 3) of {form.name}")
    each = said.double().cpu().numpy()[:, list(form.places)]
    return [_placed(network, values, person) for values, person in zip(each, people, strict=True)]


def _placed(network: KeypointNetwork, values: np.ndarray, person: FoundPerson) -> Keypoints2D | None:
    """Keypoints (K, 3) of a person's crop, in the picture."""
    there = np.isfinite(values).all(axis=1) & (values[:, 2] > 0)
    confidence = np.where(there, values[:, 2], 0.0).clip(0.0, 1.0)
    crop = upright_crop(person, network.size)
    points = np.where(there[:, None], crop.to_picture(values[None, :, :2])[0], 0.0)
    if len(np.unique(points[there], axis=0)) < 2:
        return None
    return Keypoints2D(network.skeleton, points.astype(np.float32), confidence.astype(np.float32))
