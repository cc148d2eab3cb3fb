"""The label network in bfloat16 with what follows a convolution in one launch: the same features, nearly."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import pytest
import torch
from helpers.bodies import seen_by, walker

from warp_partdr.inputs.observation import observe
from warp_partdr.inputs.observations import Observations
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.networks.regression.fused import fused_network, fuses
from warp_partdr.networks.regression.label_network import EVEN_CHANNELS, NUM_CHANNELS, LabelNetwork, network_conditions
from warp_partdr.networks.regression.landmarks import LANDMARKS
from warp_partdr.networks.regression.predict import ask_network

Inputs = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def inputs(device: str) -> Inputs:
    generator = torch.Generator().manual_seed(0)
    groups = torch.randint(NUM_CHANNELS, (3, 8, 8), generator=generator)
    groups = groups.repeat_interleave(16, dim=1).repeat_interleave(16, dim=2)
    shares = torch.nn.functional.one_hot(groups, NUM_CHANNELS).float().permute(0, 3, 1, 2)
    keypoints = torch.rand(3, len(LANDMARKS), 3, generator=generator) - torch.tensor([0.5, 0.5, 0.0])
    certainty, statures = torch.tensor([1.0, 0.0, 0.5]), torch.tensor([1.6, 0.0, 0.0])
    conditions = network_conditions(torch.tensor([[3.0, 0.1, 0.2]]).repeat(3, 1), certainty, statures)
    return shares.to(device), keypoints.to(device), conditions.to(device)


@torch.no_grad()
def off(found: torch.Tensor, expected: torch.Tensor) -> float:
    """Square root of the mean squared difference, as a share of the features' own."""
    return float((found.float() - expected).square().mean().sqrt() / expected.square().mean().sqrt())


@pytest.mark.parametrize("even", [False, True])
def test_fused_features_are_as_exact_as_torchs_in_bfloat16(device: str, even: bool) -> None:
    """The error is at most one and a half times torch's own, also where shares have more channels, which are zeros."""
    network, (shares, *others) = packaged_network(device), inputs(device)
    given = torch.nn.functional.pad(shares, (0, 0, 0, 0, 0, EVEN_CHANNELS - NUM_CHANNELS)) if even else shares
    with torch.no_grad(), torch.autocast(torch.device(device).type, torch.bfloat16):
        usual, found = network.features(shares, *others), fused_network(network).features(given, *others)
    with torch.no_grad():
        exact = network.features(shares, *others)
    assert 0 < off(found, exact) < max(1.5 * off(usual, exact), 0.01)


def test_fused_features_in_float32_are_the_networks_own(device: str) -> None:
    network, given = packaged_network(device), inputs(device)
    with torch.no_grad():
        expected, found = network.features(*given), fused_network(network, torch.float32).features(*given)
    most = 1e-5 if device == "cpu" else 1e-3  # the network's own go through cuDNN, which rounds to TF32
    assert off(found, expected) < most


def test_a_fused_network_is_kept_until_weights_change() -> None:
    network: LabelNetwork = deepcopy(packaged_network("cpu"))
    first = fused_network(network)
    assert fused_network(network) is first
    with torch.no_grad():
        network.stem[1].running_mean.add_(1.0)
    second = fused_network(network)
    assert second is not first
    with torch.no_grad(), torch.autocast("cpu", torch.bfloat16):
        assert not torch.equal(first.features(*inputs("cpu")), second.features(*inputs("cpu")))


def test_bodies_are_the_same_when_asked_again(device: str) -> None:
    """On CUDA, a captured graph answers the second time. Nobody else's tensors hold the answer."""
    network = packaged_network(device)
    seen = Observations.of([observe(*seen_by(walker()), device=device)[0]] * 2)
    other = replace(seen, points=seen.points + 0.05)

    def joints() -> list[torch.Tensor]:
        return [ask_network(each, network, half=True).posed().joints for each in (seen, other)]

    first = joints()
    for _ in range(3):
        for found, expected in zip(joints(), first, strict=True):
            torch.testing.assert_close(found, expected, rtol=0, atol=1e-4)
    assert (first[0] - first[1]).abs().max() > 1e-3


def test_a_gpu_fuses_in_bfloat16_and_a_cpu_does_not(device: str) -> None:
    fuses.cache_clear()  # or an earlier test's answer is kept
    with torch.autocast(torch.device(device).type, torch.bfloat16):  # as a network asks
        if device == "cpu":
            assert not fuses(torch.device("cpu"))  # cuDNN's alone
        else:
            assert fuses(torch.device(device, torch.cuda.current_device()))
