"""The energy of bodies with its gradient in one captured graph, for an optimiser of one's own."""

from __future__ import annotations

from functools import partial

import torch

from ...body.parameters import BodyParameters
from ...interop.graph_cache import BYTES_PER_PIXEL, graphs
from ...interop.loss_graph import LabelLoss
from .captured import CapturedRefinement, can_capture
from .energy import Energy


def energy_loss(energy: Energy, bodies: BodyParameters) -> torch.Tensor:
    """Sum of an energy's terms: segmentation, landmarks, sizes, prior, limits, depth.

    The second call with an energy and a number of bodies is captured as a graph: the iteration of ``refine`` at rate 0.
    The first call takes torch. So do energies that no graph serves: of label probabilities, of a mesh, and in float64.

    Args:
        energy: Energy of one person, or of B people, which must not be changed afterwards.
        bodies: B bodies, whose tensors may require gradients; only first derivatives exist.

    Returns:
        The energy of each body, shape (B,).
    """
    tensors, batch, captured = tuple(bodies.tensors().values()), bodies.batch_size, None
    served = can_capture(energy) and bodies.lengths.dtype == torch.float32 and not torch.compiler.is_compiling()
    if served and batch > 0:
        make = partial(CapturedRefinement, energy, batch, iterations=0)
        num_bytes = batch * energy.size**2 * BYTES_PER_PIXEL
        captured = graphs.find((energy.key, batch), bodies.lengths.device, num_bytes, make)
    if captured is None:
        return torch.stack(list(energy(bodies).values())).sum(0)
    with torch.no_grad():
        found = captured.evaluate(bodies)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
        loss: torch.Tensor = LabelLoss.apply("energy_loss", found, *tensors)
        return loss
    return found[0]
