"""Optimizers: which steps which parameters, and how."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from helpers.training import tiny_config

from warp_partdr.lab.training.muon import Muon, orthogonalized
from warp_partdr.lab.training.optimizers import make_optimizer
from warp_partdr.networks.regression.label_network import LabelNetwork, LabelNetworkConfig

needs_muon = pytest.mark.skipif(not hasattr(torch.optim, "Muon"), reason="torch before 2.9 has no Muon")
CPU = torch.device("cpu")


def config(optimizer: str):
    return tiny_config(Path("unused"), optimizer=optimizer, learning_rate=1e-2, weight_decay=0.0)


def test_muon_turns_all_directions_of_a_matrix_alike_and_adamw_all_numbers_of_the_rest():
    first, head = torch.nn.Linear(24, 16), torch.nn.Linear(16, 3)
    model = torch.nn.ModuleDict({"first": first, "heads": torch.nn.ModuleList([head])})
    before = {name: value.detach().clone() for name, value in model.named_parameters()}
    given = torch.randn(50, 24, generator=torch.Generator().manual_seed(1))
    (head(first(given)) * torch.tensor([1.0, 0.3, 0.1])).square().sum().backward()
    make_optimizer(config("muon"), model, CPU).step()
    moved = {name: before[name] - value.detach() for name, value in model.named_parameters()}
    sizes = torch.linalg.svdvals(moved["first.weight"])
    slopes = torch.linalg.svdvals(first.weight.grad)
    assert slopes[2] < 0.02 * slopes[0]  # of the three directions that had a gradient
    assert sizes[2] > 0.3 * sizes[0]  # Newton and Schulz make them 0.5 to 1.5 times as long
    for name in ("first.bias", "heads.0.weight", "heads.0.bias"):
        torch.testing.assert_close(moved[name].abs(), torch.full_like(moved[name], 1e-2), rtol=1e-3, atol=0)


@needs_muon
@pytest.mark.parametrize("memory_format", [torch.contiguous_format, torch.channels_last])
def test_muon_is_torchs_and_a_convolution_is_the_matrix_of_its_filters(memory_format):
    generator = torch.Generator().manual_seed(2)

    def drawn(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator)

    shapes = [(24, 16), (16, 24), (24, 16), (8, 8)]
    values = [torch.nn.Parameter(drawn(*shape)) for shape in shapes]
    filters = torch.nn.Parameter(drawn(12, 5, 3, 3).contiguous(memory_format=memory_format))
    twins = [torch.nn.Parameter(value.detach().clone()) for value in (*values, filters.flatten(1))]
    ours = Muon([*values, filters], lr=1e-2, weight_decay=0.1)
    torchs = torch.optim.Muon(twins, lr=1e-2, weight_decay=0.1, adjust_lr_fn="match_rms_adamw")
    for _ in range(3):
        for value, twin in zip((*values, filters), twins, strict=True):
            twin.grad = drawn(*twin.shape)
            value.grad = twin.grad.view(value.shape).clone()
        filters.grad = filters.grad.contiguous(memory_format=memory_format)
        ours.step()
        torchs.step()
    for value, twin in zip(values, twins, strict=False):
        torch.testing.assert_close(value, twin, rtol=0, atol=1e-6)
    # The order of a matrix's columns changes the rounding to bfloat16 alone.
    torch.testing.assert_close(filters.flatten(1), twins[-1], rtol=0, atol=2e-3)
    assert filters.is_contiguous(memory_format=memory_format)


@pytest.mark.parametrize("shape", [(3, 40, 12), (2, 12, 40), (1, 7, 7)])
def test_all_directions_come_out_about_as_long(shape):
    matrices = torch.randn(shape, generator=torch.Generator().manual_seed(3)) * 1e3
    sizes = torch.linalg.svdvals(orthogonalized(matrices).float())
    assert sizes.min() > 0.3
    assert sizes.max() < 1.6


def test_a_parameter_without_gradient_stays_and_vectors_are_refused():
    still, moved = (torch.nn.Parameter(torch.ones(4, 3)) for _ in range(2))
    moved.grad = torch.ones(4, 3)
    Muon([still, moved], lr=0.1, weight_decay=0.1).step()
    assert (still == 1).all()
    assert (moved != 1).all()
    with pytest.raises(ValueError, match=r"parameters: one of shape \(3,\); expected 2 or 4 axes"):
        Muon([torch.nn.Parameter(torch.ones(3))], lr=0.1, weight_decay=0.0)


def test_muon_leaves_first_layers_tables_and_heads_of_the_label_network_to_adamw():
    network = LabelNetwork(LabelNetworkConfig(attention_layers=1))
    names = {value: name for name, value in network.named_parameters()}
    muon, *rest = make_optimizer(config("muon"), network, CPU).param_groups
    taken = {names[value] for value in muon["params"]}
    inner = {"regressor.first.linear.weight", "attention.said.weight", "keypoints.0.weight", "stages.0.body.0.weight"}
    assert inner <= taken
    others = {names[value] for group in rest for value in group["params"]}
    heads = {"regressor.heads.rotations.weight", "uncertainty.layers.2.weight", "attention.names", "stem.0.weight"}
    assert heads <= others
    assert taken | others == set(names.values())
    assert not taken & others
