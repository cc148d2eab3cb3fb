"""A detailed body bound to its skeleton, for files of skinned meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..body.rotations import rotation_to_quaternion
from ..models.registration import Registered


@dataclass(frozen=True)
class Binding:
    """The first body's mesh and joints where the skin does nothing, in the body frame.

    Attributes:
        points: Of the mesh that the skin takes to the posed one, shape (V, 3) [m]: what a viewer shows is exact, though
            a file has fewer weights than the model, no pose correctives and no stretches.
        joints: At rest, shape (J, 3) [m].
        bones: The joints that move each vertex, shape (V, K).
        shares: Their weights, shape (V, K), each row of sum 1.
    """

    points: np.ndarray
    joints: np.ndarray
    bones: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(cls, registered: Registered, most: int | None = None) -> Binding:
        """Bind the first body by its ``most`` largest weights a vertex, by default by all that are not 0."""
        model = registered.model
        full = model.skin_weights.cpu().double()
        count = int((full > 0).sum(1).max()) if most is None else most
        weights, joints = full.topk(min(count, model.num_joints), dim=1)
        padding = (0, count - weights.shape[1])
        shares = torch.nn.functional.pad(weights / weights.sum(1, keepdim=True), padding).numpy()
        bones = torch.nn.functional.pad(joints, padding).numpy()
        rest, transforms = numbers_of(registered.rest().joints), numbers_of(registered.detailed.transforms)
        skin = np.einsum("vk,vkij->vij", shares, (transforms @ from_rest(rest))[bones])
        posed = numbers_of(registered.detailed.vertices)
        points = np.linalg.solve(skin[:, :3, :3], (posed - skin[:, :3, 3])[..., None])[..., 0]
        return cls(points, rest, bones, shares)


def from_rest(joints: np.ndarray) -> np.ndarray:
    """Matrices that take the body frame to each joint's own at rest, shape (J, 4, 4)."""
    matrices = np.tile(np.eye(4), (len(joints), 1, 1))
    matrices[:, :3, 3] = -joints
    return matrices


def numbers_of(tensor: torch.Tensor) -> np.ndarray:
    """The first body's values in double precision."""
    return tensor[0].detach().cpu().double().numpy()


def to_quaternions(rotations: np.ndarray) -> np.ndarray:
    """Quaternions (x, y, z, w) of rotation matrices (T, ..., 3, 3), the sign nearest the one before, (T, ..., 4)."""
    found = rotation_to_quaternion(torch.from_numpy(rotations)).numpy()
    turned = (found[1:] * found[:-1]).sum(-1, keepdims=True) < 0
    found[1:] *= np.where(np.cumsum(turned, axis=0) % 2, -1.0, 1.0)
    return found[..., [1, 2, 3, 0]]
