"""Keypoints of a person by a network of others."""

from __future__ import annotations

import numpy as np
import torch

from ..body.skeletons import skeleton
from ..detection.crops import Pyramid, cut_crops
from ..detection.person import FoundPerson
from ..errors import InputError
from ..inputs.keypoints import Keypoints2D
from .networks import KeypointNetwork, upright_crop


@torch.no_grad()
def find_keypoints(network: KeypointNetwork, picture: Pyramid, person: FoundPerson) -> Keypoints2D | None:
    """Keypoints of a person in the picture; None if the network sees no two of them.

    Raises:
        InputError: If the network gives something else than ``KeypointNetwork`` says.
    """
    form = skeleton(network.skeleton)
    crop = upright_crop(person, network.size)
    said = network.predict(cut_crops([picture], crop, network.size))
    if not isinstance(said, torch.Tensor) or said.shape != (1, form.count, 3):
        found = tuple(said.shape) if isinstance(said, torch.Tensor) else type(said).__name__
        raise InputError(f"keypoints_from: {found}; expected x, y, confidence (N, {form.count}, 3) of {form.name}")
    values = said[0].double().cpu().numpy()[list(form.places)]
    there = np.isfinite(values).all(axis=1) & (values[:, 2] > 0)
    confidence = np.where(there, values[:, 2], 0.0).clip(0.0, 1.0)
    points = np.where(there[:, None], crop.to_picture(values[None, :, :2])[0], 0.0)
    if len(np.unique(points[there], axis=0)) < 2:
        return None
    return Keypoints2D(network.skeleton, points.astype(np.float32), confidence.astype(np.float32))
