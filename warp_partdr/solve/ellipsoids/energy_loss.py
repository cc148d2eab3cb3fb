"""Energy of bodies as a torch loss, for use in another optimiser; a captured graph finds it with its gradient."""

from __future__ import annotations

from functools import partial

import torch

from ...body.parameters import BodyParameters
from ...interop.graph_cache import BYTES_PER_PIXEL, graphs
from ...interop.loss_graph import LabelLoss
from .captured import CapturedRefinement, can_capture
from .energy import Energy


def energy_loss(energy: Energy, bodies: BodyParameters) -> torch.Tensor:
    """Sum the terms of an energy: segmentation, landmarks, sizes, prior, limits, depth.

    The first call is evaluated by torch. The second call with the same energy and the same number of bodies is captured
    as a graph, which is an iteration of ``refine`` at rate 0. Energies with label probabilities, with a mesh, or in
    float64 have no graph; torch always evaluates them.

    Args:
        energy: Energy of one person, or of B people. It must not be changed afterwards, because graphs are kept by it.
        bodies: B bodies, whose tensors may require gradients. Only first derivatives exist.

    Returns:
        The energy of each body, shape (B,).

    Examples:
        >>> from warp_partdr import BodyParameters, Energy, energy_loss, observe, read_keypoints, read_parts
        >>> observation, crop = observe(read_keypoints("keypoints.json")[0], read_parts("parts.png", "cdcl14"))
        >>> leaves = BodyParameters.mean(1).leaves()
        >>> loss = energy_loss(Energy(observation, size=128), leaves)
        >>> loss.sum().backward()
        >>> loss.shape, leaves.rotations.grad.shape
        (torch.Size([1]), torch.Size([1, 20, 3]))
    """
    tensors = tuple(bodies.tensors().values())
    batch = bodies.batch_size
    captured = None
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
