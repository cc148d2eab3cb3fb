"""Mirror images of what the label network sees and of what it says: with theirs, its bodies have no favourite side."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ...body.landmarks import mirror_order
from ...body.pose_prior import FREE_PARTS
from ...body.rotations import rotation_from_6d, rotation_to_6d
from ...body.template import JOINT_NAMES, PART_NAMES
from ...interop.device_cache import device_cache
from .label_network import NUM_CHANNELS
from .landmarks import LANDMARKS
from .predicted import Predicted
from .uncertainty import Uncertainty

_MOST_CHANNELS = 2 * NUM_CHANNELS


def mirror_inputs(
    shares: torch.Tensor, keypoints: torch.Tensor, conditions: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Inputs of a label network, left and right exchanged in the picture and in names; shapes as its ``forward``."""
    swap = _orders(shares.device)
    points = keypoints[:, swap["landmarks"]] * swap["point"]
    mirrored = shares.permute(0, 2, 3, 1).flip(2)  # channels last, as in memory: gathered so in a sixth of the time
    channels = swap["channels"][: mirrored.shape[-1]]
    pictures = mirrored.flatten(0, 2).index_select(1, channels).view(mirrored.shape).permute(0, 3, 1, 2)
    return pictures, points, conditions * swap["condition"]


def mirror_bodies(bodies: Predicted) -> Predicted:
    """Bodies with left and right exchanged."""
    swap = _orders(bodies.shift.device)
    signs = swap["rotation"]
    said = bodies.uncertainty
    if said is not None:
        said = replace(said, depths=said.depths[:, swap["joints"]], turns=said.turns[:, swap["turns"]])
    return replace(
        bodies,
        orientation=bodies.orientation * signs,
        rotations=bodies.rotations[:, swap["parts"]] * signs,
        shift=bodies.shift * swap["point"][:2],
        uncertainty=said,
    )


def mean_with_images(bodies: Predicted) -> Predicted:
    """Bodies halfway between N people and their mirror images, mirrored back, which follow them as N more."""
    count = len(bodies.shift) // 2
    return mean_bodies(bodies.select(slice(count)), mirror_bodies(bodies.select(slice(count, None))))


def mean_bodies(first: Predicted, second: Predicted) -> Predicted:
    """Bodies halfway between two predictions of the same people."""

    def middle(name: str) -> torch.Tensor:
        return (getattr(first, name) + getattr(second, name)) / 2

    turns = torch.cat([middle("orientation")[:, None], middle("rotations")], dim=1)
    orientation, rotations = rotation_from_6d(rotation_to_6d(turns)).tensor_split([1], dim=1)
    numbers = {name: middle(name) for name in ("lengths", "thicknesses", "log_scale", "shift")}
    said = first.uncertainty
    if said is not None and second.uncertainty is not None:
        pairs = zip(vars(said).items(), vars(second.uncertainty).values(), strict=True)
        said = Uncertainty(**{name: (own + other) / 2 for (name, own), other in pairs})
    return Predicted(orientation[:, 0], rotations, **numbers, uncertainty=said)


@device_cache(8)
def _orders(device: torch.device) -> dict[str, torch.Tensor]:
    """Places of the mirror images of channels, landmarks, parts, joints and rotations; and signs, float32.

    Kept on the device, which would wait for what it is sent.
    """
    parts, free = mirror_order(PART_NAMES), mirror_order([PART_NAMES[part] for part in FREE_PARTS])
    orders = {
        "channels": np.append(parts, np.arange(len(parts), _MOST_CHANNELS)),  # of zeros, the last ones
        "landmarks": mirror_order(LANDMARKS),
        "parts": parts,
        "joints": mirror_order(JOINT_NAMES[1:]),
        "turns": np.append(0, free + 1),
        "point": np.array([-1.0, 1.0, 1.0], np.float32),
        "condition": np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0], np.float32),
        # Of M R M, where M mirrors x.
        "rotation": np.array([[1.0, -1.0, -1.0], [-1.0, 1.0, 1.0], [-1.0, 1.0, 1.0]], np.float32),
    }
    with torch.inference_mode(False):  # kept for calls outside of it, too
        return {name: torch.from_numpy(order).to(device) for name, order in orders.items()}
