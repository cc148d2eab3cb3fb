"""Growth: parts of a detailed model made longer or thicker than its shape values reach, in EllipBody's terms.

The body of some shape values has the lengths and thicknesses that EllipBody would have on it. Where EllipBody demands
others, parts are stretched at rest along its axes; skinning weights blend one part's stretch into the next one's.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from ..body.template import BONE_STARTS, JOINT_NAMES, LENGTH_NAMES, NUM_PARTS, SIZE_COLUMNS, THICKNESS_NAMES, template
from ..interop.device_cache import device_cache
from .model import Detailed, DetailedModel, weigh_points
from .pose import rest_turns
from .surfaces import vertex_parts

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


@dataclass(frozen=True)
class _MeasureTables:
    """Numbers of a model that its bodies' measures are taken by.

    Attributes:
        indices: Measure of each part along each axis, shape (20, 3), int64.
        bone_starts: Joint where each bone starts, shape (20,), int64.
        joint_weights: Weights of ``JOINT_NAMES`` over vertices and joints, shape (21, V + J).
        shares: Share of each vertex in the skin of each part, shape (20, V).
        middles: Middle of each vertex' own part, shape (V, 3). About the whole body's middle, float32 leaves a foot's
            variance three digits.
        sharing: Share of each part's axis in each measure, shape (60, 27).
        ratios: Factors from lengths and standard deviations to measures, shape (20, 3).
        spreads: Spreads of ``Growth``, shape (27,).
        rest_axes: Axes of EllipBody's parts at rest, shape (20, 3, 3).
    """

    indices: torch.Tensor
    bone_starts: torch.Tensor
    joint_weights: torch.Tensor
    shares: torch.Tensor
    middles: torch.Tensor
    sharing: torch.Tensor
    ratios: torch.Tensor
    spreads: torch.Tensor
    rest_axes: torch.Tensor


@device_cache(8)
def _measure_tables(model: DetailedModel) -> _MeasureTables:
    with torch.inference_mode(False):  # kept for calls outside of it, too
        parts, areas = vertex_parts(model)
        indices = torch.tensor(SIZE_COLUMNS, device=areas.device)
        of_parts = torch.nn.functional.one_hot(parts.long(), NUM_PARTS).to(areas) * areas[:, None]
        whole = of_parts.sum(0)
        shares = (of_parts / whole.clamp(min=1e-12)).T
        # A part without skin, which a model may have, does not count.
        counts = torch.stack([torch.ones_like(whole), whole > 0, whole > 0], dim=-1).flatten()
        sharing = torch.nn.functional.one_hot(indices.flatten(), len(MEASURES)) * counts[:, None]
        ratios, spreads = zip(*(THICKNESS_RATIOS[name] for name in THICKNESS_NAMES), strict=True)
        return _MeasureTables(
            indices=indices,
            bone_starts=torch.tensor(BONE_STARTS, device=areas.device),
            joint_weights=model.weights_of(JOINT_NAMES),
            shares=shares,
            middles=(shares @ model.rest_vertices)[parts.long()],
            sharing=sharing / sharing.sum(0).clamp(min=1),
            ratios=areas.new_tensor([1.0] * len(LENGTH_NAMES) + [*ratios])[indices],
            spreads=areas.new_tensor([_LENGTH_SPREAD] * len(LENGTH_NAMES) + [*spreads]),
            rest_axes=torch.from_numpy(template().rest_axes).to(areas),
        )


class Growth:
    """EllipBody's measures of a model's bodies, and stretches of the model's parts that change them.

    Attributes:
        spreads: Standard deviation of the logarithm of each measure among natural people, shape (27,).
    """

    def __init__(self, model: DetailedModel, shape: torch.Tensor) -> None:
        """Prepare for shapes near one (B, S)."""
        self.model = model
        self._tables = _measure_tables(model)
        self.spreads = self._tables.spreads
        self.axes = rest_turns(model, model.rest(shape)).mT @ self._tables.rest_axes

    def demanded(self, semi_axes: torch.Tensor) -> torch.Tensor:
        """Logarithms of the 27 measures [log m] of ellipsoids, shape (B, 20, 3), shape (B, 27)."""
        return (2 * semi_axes).log().flatten(1) @ self._tables.sharing

    def measured(self, shape: torch.Tensor, stretches: torch.Tensor | None = None) -> torch.Tensor:
        """Logarithms of the 27 measures of the model's bodies, shape (B, 27), differentiable."""
        return self.measured_at(self.model.rest(shape, stretches=stretches))

    def measured_at(self, rest: Detailed) -> torch.Tensor:
        """Logarithms of the 27 measures of bodies at rest, shape (B, 27), differentiable."""
        tables = self._tables
        joints = weigh_points(tables.joint_weights, torch.cat([rest.vertices, rest.joints], dim=1))
        lengths = (joints[:, 1:] - joints[:, tables.bone_starts]).norm(dim=-1, keepdim=True)
        # Vertices last: products of three numbers side by side are slow.
        points = (rest.vertices - tables.middles).mT.contiguous()
        means = (points @ tables.shares.mT).mT
        products = (points[:, :, None] * points[:, None]).flatten(1, 2)
        squares = (products @ tables.shares.mT).mT.unflatten(2, (3, 3))
        covariances = squares - means[..., :, None] * means[..., None, :]
        across = self.axes[..., 1:]
        variances = (across * (covariances @ across)).sum(-2)
        sizes = torch.cat([lengths, variances.clamp(min=1e-12).sqrt()], dim=-1)
        return (sizes * tables.ratios).log().flatten(1) @ tables.sharing

    def stretches(self, factors: torch.Tensor) -> torch.Tensor:
        """Stretches for ``model.pose``, shape (B, 20, 3, 3), from a factor of each measure, shape (B, 27)."""
        return (self.axes * factors[:, self._tables.indices][..., None, :]) @ self.axes.mT
