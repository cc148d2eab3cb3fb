"""The energy of bodies with its gradient in one captured graph, for an optimiser of one's own."""

from __future__ import annotations

from functools import partial

import torch

from ..body.parameters import BodyParameters
from ..interop.graph_cache import BYTES_PER_PIXEL, graphs
from ..interop.loss_graph import LabelLoss
from .captured import CapturedRefinement, can_capture
from .energy import Energy


def energy_loss(energy: Energy, bodies: BodyParameters) -> torch.Tensor:
    """Sum of an energy's terms: segmentation, landmarks, sizes, prior, limits, depth.

    What is asked for twice is a graph: the iteration of ``refine`` at rate 0. Energies that it does not serve
    (probabilities, a mesh, float64) and the first call take torch.

    Args:
        energy: Of one observation, which is not changed afterwards.
        bodies: B of them, whose tensors may want gradients: first ones.

    Returns:
        The energy of each body, shape (B,).
    """
    if torch.compiler.is_compiling() or bodies.lengths.dtype != torch.float32 or not can_capture(energy):
        return torch.stack(list(energy(bodies).values())).sum(0)
    tensors, device = tuple(bodies.tensors().values()), bodies.lengths.device
    key, num_bytes = (energy.key, bodies.batch_size), bodies.batch_size * energy.size**2 * BYTES_PER_PIXEL
    make = partial(CapturedRefinement, energy, bodies.batch_size, iterations=0)
    captured = graphs.find(key, device, num_bytes, make) if num_bytes else None
    if captured is None:
        return torch.stack(list(energy(bodies).values())).sum(0)
    with torch.no_grad():
        found = captured.evaluate(bodies)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
        loss: torch.Tensor = LabelLoss.apply("energy_loss", found, *tensors)
        return loss
    return found[0]
