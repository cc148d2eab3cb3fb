"""Growth: parts of a detailed model made longer or thicker than its shape values reach, in EllipBody's terms.

The body of some shape values has the lengths and thicknesses that EllipBody would have on it. Where EllipBody demands
others, parts are stretched at rest along its axes; skinning weights blend one part's stretch into the next one's.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import torch

from ..body.template import BONE_STARTS, JOINT_NAMES, LENGTH_NAMES, NUM_PARTS, SIZE_COLUMNS, THICKNESS_NAMES, template
from .model import DetailedModel, weigh_points
from .pose import rest_turns

MEASURES: tuple[str, ...] = LENGTH_NAMES + THICKNESS_NAMES

# Thickness of the ellipsoids that match a person's silhouettes best over the standard deviation of the part's skin
# along that axis; and how far single people are off, as the standard deviation of the ratio's logarithm. Over 100
# people of the packaged Anny, by ``python -m warp_partdr.lab thickness-ratios``.
THICKNESS_RATIOS: dict[str, tuple[float, float]] = {
    "torso depth": (2.974, 0.025),
    "pelvis height": (4.265, 0.149),
    "abdomen width": (3.454, 0.101),
    "chest width": (3.955, 0.063),
    "neck thickness": (3.662, 0.045),
    "shoulder thickness": (4.082, 0.127),
    "head thickness": (3.432, 0.017),
    "upper leg thickness": (3.820, 0.026),
    "lower leg thickness": (3.750, 0.040),
    "foot width": (4.488, 0.070),
    "foot height": (3.955, 0.087),
    "upper arm thickness": (4.084, 0.026),
    "forearm thickness": (3.574, 0.029),
    "hand width": (3.674, 0.032),
    "hand thickness": (3.344, 0.043),
}
# Hidden in the trunk, so that silhouettes hardly show their thickness, and stretches hardly change the skin.
UNGROWN: tuple[str, ...] = ("pelvis height", "shoulder thickness")
# Bones between joints are the same on both sides; what an estimated shape leaves.
_LENGTH_SPREAD = 0.015


class Growth:
    """EllipBody's measures of a model's bodies, and stretches of the model's parts that change them.

    Attributes:
        spreads: Standard deviation of the logarithm of each measure among natural people, shape (27,).
    """

    def __init__(self, model: DetailedModel, parts: torch.Tensor, areas: torch.Tensor, shape: torch.Tensor) -> None:
        """Prepare for shapes near one (B, S); ``vertex_parts`` gives parts and areas."""
        self.model = model
        tables = _growth_tables(model, parts, areas)
        self.indices, self.shares, self.sharing = tables.indices, tables.shares, tables.sharing
        self.ratios, self.spreads, self.middles = tables.ratios, tables.spreads, tables.middles
        self.joint_weights, self._bone_starts = model.weights_of(JOINT_NAMES), tables.bone_starts
        self.axes = rest_turns(model, model.rest(shape)).mT @ tables.rest_axes

    def demanded(self, semi_axes: torch.Tensor) -> torch.Tensor:
        """Logarithms of the 27 measures [log m] of ellipsoids, shape (B, 20, 3), shape (B, 27)."""
        return (2 * semi_axes).log().flatten(1) @ self.sharing

    def measured(self, shape: torch.Tensor, stretches: torch.Tensor | None = None) -> torch.Tensor:
        """Logarithms of the 27 measures of the model's bodies, shape (B, 27), differentiable."""
        rest = self.model.rest(shape, stretches=stretches)
        joints = weigh_points(self.joint_weights, torch.cat([rest.vertices, rest.joints], dim=1))
        lengths = (joints[:, 1:] - joints[:, self._bone_starts]).norm(dim=-1, keepdim=True)
        # Vertices last: products of three numbers side by side are slow.
        points = (rest.vertices - self.middles).mT.contiguous()
        means = (points @ self.shares.mT).mT
        products = (points[:, :, None] * points[:, None]).flatten(1, 2)
        squares = (products @ self.shares.mT).mT.unflatten(2, (3, 3))
        covariances = squares - means[..., :, None] * means[..., None, :]
        across = self.axes[..., 1:]
        variances = (across * (covariances @ across)).sum(-2)
        sizes = torch.cat([lengths, variances.clamp(min=1e-12).sqrt()], dim=-1)
        return (sizes * self.ratios).log().flatten(1) @ self.sharing

    def stretches(self, factors: torch.Tensor) -> torch.Tensor:
        """Stretches for ``model.pose``, shape (B, 20, 3, 3), from a factor of each measure, shape (B, 27)."""
        return (self.axes * factors[:, self.indices][..., None, :]) @ self.axes.mT


class _GrowthTables(NamedTuple):
    """Tables of a model for ``Growth``, which are the same for all shapes."""

    indices: torch.Tensor  # measure of each axis of each part, shape (20, 3)
    shares: torch.Tensor  # share of each vertex in its part's skin, shape (20, V)
    sharing: torch.Tensor  # share of each axis of each part in each measure, shape (60, 27)
    ratios: torch.Tensor  # of thicknesses of ellipsoids and skin, shape (20, 3)
    spreads: torch.Tensor  # shape (27,)
    middles: torch.Tensor  # middle of each vertex' part at rest [m], shape (V, 3)
    rest_axes: torch.Tensor  # axes of EllipBody's parts at rest, shape (20, 3, 3)
    bone_starts: torch.Tensor  # shape (20,)


@lru_cache(maxsize=4)
def _growth_tables(model: DetailedModel, parts: torch.Tensor, areas: torch.Tensor) -> _GrowthTables:
    with torch.inference_mode(False):  # kept for calls outside of it, too
        indices = torch.tensor(SIZE_COLUMNS, device=areas.device)
        of_parts = torch.nn.functional.one_hot(parts.long(), NUM_PARTS).to(areas) * areas[:, None]
        whole = of_parts.sum(0)
        shares = (of_parts / whole.clamp(min=1e-12)).T
        # A part without skin, which a model may have, does not count.
        counts = torch.stack([torch.ones_like(whole), whole > 0, whole > 0], dim=-1).flatten()
        sharing = torch.nn.functional.one_hot(indices.flatten(), len(MEASURES)) * counts[:, None]
        ratios, spreads = zip(*(THICKNESS_RATIOS[name] for name in THICKNESS_NAMES), strict=True)
        return _GrowthTables(
            indices=indices,
            shares=shares,
            sharing=sharing / sharing.sum(0).clamp(min=1),
            ratios=areas.new_tensor([1.0] * len(LENGTH_NAMES) + [*ratios])[indices],
            spreads=areas.new_tensor([_LENGTH_SPREAD] * len(LENGTH_NAMES) + [*spreads]),
            # Of each vertex' own part: about the whole body's middle, float32 leaves a foot's variance three digits.
            middles=(shares @ model.rest_vertices)[parts.long()],
            rest_axes=torch.from_numpy(template().rest_axes).to(areas),
            bone_starts=torch.tensor(BONE_STARTS, device=areas.device),
        )
