"""Bodies from observations in one pass of the label network."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from ..body.parameters import BodyParameters
from ..errors import check_each, check_type
from ..inputs.observation import Observation, resize_nearest
from ..interop.torch_threads import one_torch_thread
from .label_network import NUM_CHANNELS, LabelNetwork, label_shares, label_table, lens_rays, map_shares
from .landmarks import network_keypoints
from .mirror import mean_bodies, mirror_bodies, mirror_inputs
from .predicted import Predicted


def network_inputs(seen: Observation, size: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Input of a label network for one person: shares (22, size, size), keypoints (24, 3) and rays (4,)."""
    return *_network_picture(seen, size), _network_rays(seen)


def _network_rays(seen: Observation) -> torch.Tensor:
    lens = seen.points.new_ones(3) if seen.lens is None else seen.lens
    return lens_rays(lens[None], torch.full((1,), seen.lens is not None, device=lens.device))[0]


def _network_picture(seen: Observation, size: int) -> tuple[torch.Tensor, torch.Tensor]:
    keypoints = network_keypoints(seen.landmarks, seen.points, seen.confidence)
    device = keypoints.device
    if seen.label_set is None or seen.labels is None:
        shares = torch.zeros(NUM_CHANNELS, size, size, device=device)
        shares[-1] = 1.0
        return shares, keypoints
    table = label_table(seen.label_set).to(device)
    if seen.maps is not None and seen.known is not None:
        maps, known = resize_nearest(seen.maps, size), resize_nearest(seen.known, size)
        return map_shares(maps[None], known[None], table)[0], keypoints
    labels = resize_nearest(seen.labels, size)
    return label_shares(labels[None], table[None], torch.zeros(1, dtype=torch.int64, device=device))[0], keypoints


@one_torch_thread()
@torch.no_grad()
def predict_bodies(observations: Sequence[Observation], network: LabelNetwork) -> BodyParameters:
    """Predict bodies from observations, without refinement.

    Args:
        observations: N people, on the network's device; ``observe`` makes them.
        network: In evaluation mode.

    Returns:
        N bodies in their crops.

    Raises:
        TypeError: If these are no observations, or no network.
        ValueError: If there is no observation.
    """
    check_each("observations", observations, Observation, "of observe")
    check_type("network", network, LabelNetwork, "of load_label_network")
    if not observations:
        raise ValueError("observations: none; expected at least one")
    return ask_network(observations, network).parameters()


@torch.no_grad()
def ask_network(observations: Sequence[Observation], network: LabelNetwork) -> Predicted:
    """Bodies as of ``predict_bodies``, and how sure they are: halfway between a picture's and its mirror image's."""
    each = [network_inputs(seen, network.config.size) for seen in observations]
    inputs = tuple(torch.stack(values) for values in zip(*each, strict=True))
    shares, keypoints, rays = (torch.cat(both) for both in zip(inputs, mirror_inputs(*inputs), strict=True))
    predicted: Predicted = network(shares.contiguous(memory_format=torch.channels_last), keypoints, rays)
    count = len(observations)
    return mean_bodies(predicted.select(slice(count)), mirror_bodies(predicted.select(slice(count, None))))
