"""Binding of a detailed body to its skeleton, for files of skinned meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from ..body.rotations import rotation_to_quaternion
from ..models.registration import Registered


@dataclass(frozen=True)
class Binding:
    """Mesh and joints of the first body in the bind pose, in the body frame.

    Attributes:
        points: Vertices that the skin moves exactly to the posed mesh [m], shape (V, 3). So a viewer shows the posed
            mesh, although a file has fewer weights than the model, no pose correctives and no stretches.
        joints: Joints at rest [m], shape (J, 3).
        bones: Indices of the joints that move each vertex, shape (V, K).
        shares: Weights of these joints, shape (V, K); each row has the sum 1.
    """

    points: np.ndarray
    joints: np.ndarray
    bones: np.ndarray
    shares: np.ndarray

    @classmethod
    def of(cls, registered: Registered, most: int | None = None) -> Binding:
        """Bind the first body with the ``most`` largest weights of each vertex; None: with all that are not 0."""
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
    """Matrices from the body frame to each joint's frame at rest, shape (J, 4, 4)."""
    matrices = np.tile(np.eye(4), (len(joints), 1, 1))
    matrices[:, :3, 3] = -joints
    return matrices


def numbers_of(tensor: torch.Tensor) -> np.ndarray:
    """Values of the first body as a NumPy array in double precision."""
    return tensor[0].detach().cpu().double().numpy()


def to_quaternions(rotations: np.ndarray) -> np.ndarray:
    """Quaternions (x, y, z, w) of rotation matrices (T, ..., 3, 3), shape (T, ..., 4).

    A quaternion and its negative are the same rotation. The sign is the one that is nearest to the quaternion before.
    """
    found = rotation_to_quaternion(torch.from_numpy(rotations)).numpy()
    turned = (found[1:] * found[:-1]).sum(-1, keepdims=True) < 0
    found[1:] *= np.where(np.cumsum(turned, axis=0) % 2, -1.0, 1.0)
    return found[..., [1, 2, 3, 0]]
