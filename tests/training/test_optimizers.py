"""Optimizers: which steps which parameters, and how."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from scenes.training import tiny_config

from warp_partdr.errors import InputError
from warp_partdr.network.label_network import LabelNetwork, LabelNetworkConfig
from warp_partdr.training.optimizers import make_optimizer

needs_muon = pytest.mark.skipif(not hasattr(torch.optim, "Muon"), reason="torch before 2.9 has no Muon")
CPU = torch.device("cpu")


def config(optimizer: str):
    return tiny_config(Path("unused"), optimizer=optimizer, learning_rate=1e-2, weight_decay=0.0)


@needs_muon
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
def test_muon_leaves_convolutions_tables_and_heads_of_the_label_network_to_adamw():
    network = LabelNetwork(LabelNetworkConfig(attention_layers=1))
    names = {value: name for name, value in network.named_parameters()}
    muon, *rest = make_optimizer(config("muon"), network, CPU).param_groups
    taken = {names[value] for value in muon["params"]}
    assert {"regressor.first.linear.weight", "attention.said.weight", "keypoints.0.weight"} <= taken
    others = {names[value] for group in rest for value in group["params"]}
    heads = {"regressor.heads.rotations.weight", "uncertainty.layers.2.weight", "attention.names", "stem.0.weight"}
    assert heads <= others
    assert taken | others == set(names.values())
    assert not taken & others


def test_a_torch_without_muon_is_told(monkeypatch):
    monkeypatch.delattr(torch.optim, "Muon", raising=False)
    with pytest.raises(InputError, match=r"optimizer: muon; this is torch .*expected 2\.9"):
        make_optimizer(config("muon"), torch.nn.Linear(3, 2), CPU)
