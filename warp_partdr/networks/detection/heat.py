"""Landmarks moved to the peaks of the network's heat maps, because its coordinates alone are coarser."""

from __future__ import annotations

import torch

_REACH = 3  # cells that count around a landmark, in each direction
_SURE = 0.5  # A landmark stays if no cell near it is that hot.


def refine_landmarks(places: torch.Tensor, heat: torch.Tensor) -> torch.Tensor:
    """Move landmarks to the centres of the heat near them. The position of a cell is its corner, as in the network.

    Args:
        places: Positions of landmarks from 0 to 1 across the crop, shape (N, K, 2).
        heat: Logits, shape (N, K, H, W).

    Returns:
        Refined positions, shape (N, K, 2).
    """
    height, width = heat.shape[-2:]
    # Made on the device, for a graph that is captured is sent nothing.
    extent = torch.cat([torch.full((1,), side, device=places.device) for side in (width, height)])
    steps = torch.arange(-_REACH, _REACH + 1, device=places.device)
    cells = (places * extent).floor()
    inside = ((cells >= 0) & (cells < extent)).all(dim=-1)
    columns = cells[..., None, :1] + steps[:, None]  # (N, K, 7, 1)
    rows = cells[..., None, 1:] + steps[:, None]
    near = torch.cat([columns.repeat(1, 1, len(steps), 1), rows.repeat_interleave(len(steps), dim=2)], dim=-1)
    there = ((near >= 0) & (near < extent)).all(dim=-1)  # (N, K, 49)
    index = near.nan_to_num().clamp(min=0).minimum(extent - 1).long()
    shares = heat.flatten(2).gather(2, index[..., 1] * width + index[..., 0]).sigmoid() * there
    centres = (shares[..., None] * near).sum(dim=2) / shares.sum(dim=2).clamp_min(1e-9)[..., None] / extent
    confident = inside & (shares.amax(dim=2) >= _SURE)
    return torch.where(confident[..., None], centres, places)
