"""Clothes and hair over a detailed body: skin moved outward, so far for each kind of part, smooth at borders."""

from __future__ import annotations

from dataclasses import replace

import torch

from ..body.landmarks import without_side
from ..body.template import PART_NAMES
from ..interop.device_cache import device_cache
from .model import DetailedModel
from .normals import vertex_normals

# Kinds of parts that have a thickness of clothes each, the same left and right: hands, feet, hips and shoulders have
# none, for there labels draw thickness wherever joints are off.
CLOTHED: tuple[str, ...] = ("head", "neck", "chest", "abdomen", "upper_arm", "forearm", "upper_leg", "lower_leg")
THICKEST = 0.05  # [m]; and no less than 0, for labels drawn too small would eat the body
_MEAN = 0.01  # [m], of thicknesses
_HAIRLINE = 0.04  # [m], along y or z, over which hair begins


def clothes_offsets(basis: torch.Tensor, thicknesses: torch.Tensor) -> torch.Tensor:
    """Offsets of vertices at rest, for ``model.pose``, shape (B, V, 3) [m].

    Args:
        basis: Basis that ``clothes_basis`` returns, or some of its rows, shape (8, V, 3).
        thicknesses: Thickness of the clothes on each kind of part in ``CLOTHED`` [m], shape (B, 8), within
            ``THICKEST``. They are differentiable.
    """
    return (bounded(thicknesses) @ basis.flatten(1)).unflatten(1, (-1, 3))


def dressed_model(model: DetailedModel, basis: torch.Tensor) -> DetailedModel:
    """The model whose shape values are followed by thicknesses, as ``bounded`` gives them, of this basis."""
    moves = model.joint_directions
    return replace(
        model,
        shape_directions=torch.cat([model.shape_directions, basis]),
        joint_directions=torch.cat([moves, moves.new_zeros(len(basis), *moves.shape[1:])]),
    )


def clothes_costs(thicknesses: torch.Tensor) -> torch.Tensor:
    """Negative logarithms of how likely thicknesses before ``bounded`` [m] are, but for a constant; any shape.

    They are exponential: most parts of most people wear next to nothing, and a thickness that labels hardly ask for
    is none, for it would make the body thinner.
    """
    return thicknesses.abs() / _MEAN


def bounded(thicknesses: torch.Tensor) -> torch.Tensor:
    """Thicknesses [m] that clothes can have."""
    return thicknesses.clamp(0.0, THICKEST)


@device_cache(4)
def clothes_basis(model: DetailedModel) -> torch.Tensor:
    """Move of each vertex at rest by a metre of each thickness, shape (8, V, 3)."""
    with torch.inference_mode(False):  # kept for calls outside of it, too
        kinds = [without_side(name) for name in PART_NAMES]
        sums = torch.tensor([[float(kind == name) for name in CLOTHED] for kind in kinds], device=model.faces.device)
        shares = model.spread_weights @ sums.to(model.rest_vertices)
        normals = vertex_normals(model.rest_vertices.cpu().numpy(), model.faces.cpu().numpy())
        moves = shares.T[..., None] * torch.from_numpy(normals).to(shares)
        moves[0] = shares[:, :1] * _hair(model.rest_vertices, shares[:, 0] > 0.5)
        return moves


def _hair(vertices: torch.Tensor, head: torch.Tensor) -> torch.Tensor:
    """Move of each vertex of a head by a metre of hair, shape (V, 3); at rest y is up and z ahead.

    Hair grows above and behind a plane from the nape to the hairline, so that no face swells, and away from the head's
    middle, so that no ear does.
    """
    low, high = vertices[head].amin(0), vertices[head].amax(0)
    away = vertices - (low + high) / 2
    grows = ((away[:, 1] - away[:, 2]) / _HAIRLINE + 0.5).clamp(0.0, 1.0)
    return grows[:, None] * torch.nn.functional.normalize(away, dim=1)
