"""Detailed bodies made as tall as somebody is known to be, with the proportions that they had, as far as models can."""

from __future__ import annotations

import torch

from .measuring import statures
from .model import DetailedModel

_STEPS = 3  # statures are nearly linear in the shape
_REGULAR = 1e-4  # of the mean square of a shape value's directions


@torch.no_grad()
def resize_shapes(model: DetailedModel, shape: torch.Tensor, wanted: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Shape values (B, S) of bodies that have statures ``wanted`` (B,) [m], and how many times as large these are (B,).

    Vertices at rest come as near as the model can to those of the body itself, enlarged (least squares).
    """
    directions = model.shape_directions.flatten(1)
    products = directions @ directions.mT
    products.diagonal().add_(_REGULAR * products.diagonal().mean())
    shares = wanted / statures(model, shape)
    for _ in range(_STEPS):
        rest = model.rest(shape).vertices.flatten(1)
        grown = torch.linalg.solve(products, directions @ rest.mT).mT  # (B, S), to be twice as large
        shape = shape + (wanted / statures(model, shape) - 1)[:, None] * grown
    return shape, shares


def resize_before(
    model: DetailedModel, shape: torch.Tensor, positions: torch.Tensor, stature: float, eye: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Shape values (1, S) of a body of a stature [m], and where its root joints (N, 3) then are, seen as before.

    ``eye``, shape (3,), is the place of the camera that sees it.
    """
    shape, shares = resize_shapes(model, shape, torch.full_like(shape[:, 0], stature))
    eye = eye.to(positions)
    return shape, eye + shares[:, None] * (positions - eye)
