"""Batch normalisation over processes: by itself the same as torch's. test_training_loop.py has two processes."""

from __future__ import annotations

import copy

import pytest
import torch
import torch.distributed as dist
from torch import nn

from warp_partdr.lab.training.joint_norm import JointBatchNorm, normalise_jointly


@pytest.fixture
def group(device, tmp_path):
    """A group of one process."""
    backend = "gloo" if device == "cpu" else "nccl"
    dist.init_process_group(backend, init_method=f"file://{tmp_path / 'meeting'}", rank=0, world_size=1)
    yield
    dist.destroy_process_group()


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("layout", ["images", "channels last", "vectors"])
def test_joint_normalisation_equals_torchs_for_one_process(device, group, dtype, layout):
    torch.manual_seed(0)
    shape = (6, 5) if layout == "vectors" else (6, 5, 4, 3)
    values = torch.randn(shape, device=device) * 3 + 2
    if layout == "channels last":
        values = values.to(memory_format=torch.channels_last)
    values, wanted = values.to(dtype), torch.randn(shape, device=device).to(dtype)
    plain = (nn.BatchNorm1d if layout == "vectors" else nn.BatchNorm2d)(5).to(device)
    nn.init.uniform_(plain.weight)
    nn.init.uniform_(plain.bias)
    joint = normalise_jointly(copy.deepcopy(plain))
    assert isinstance(joint, JointBatchNorm)
    found = []
    for norm in (plain, joint):
        leaf = values.clone().requires_grad_()
        for _ in range(2):  # the second time the running statistics have moved
            normalised = norm(leaf)
            (normalised * wanted).sum().backward()
        norm.eval()
        assert leaf.grad is not None
        found.append([normalised.detach(), leaf.grad, norm(values).detach(), *(p.grad for p in norm.parameters())])
    tolerance = {"rtol": 1e-4, "atol": 1e-4} if dtype == torch.float32 else {"rtol": 3e-2, "atol": 6e-2}
    for have, want in zip(found[1], found[0], strict=True):
        torch.testing.assert_close(have, want, **tolerance)
    torch.testing.assert_close(joint.state_dict(), plain.state_dict(), rtol=1e-5, atol=1e-5)


def test_each_normalisation_of_a_model_becomes_joint(device):
    model = nn.Sequential(nn.Linear(3, 4), nn.ModuleDict({"norm": nn.BatchNorm1d(4)})).to(device)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    normalise_jointly(model)
    assert [type(module) for module in model.modules()][-1] is JointBatchNorm
    torch.testing.assert_close(dict(model.state_dict()), before)


def test_one_sample_a_process_leaves_the_running_statistics_finite(device, group):
    joint = normalise_jointly(nn.BatchNorm1d(3).to(device))
    joint(torch.randn(1, 3, device=device))
    assert all(torch.isfinite(buffer).all() for buffer in joint.buffers())


def test_a_second_derivative_is_an_error(device, group):
    joint = normalise_jointly(nn.BatchNorm1d(3).to(device))
    values = torch.randn(5, 3, device=device, requires_grad=True)
    (slope,) = torch.autograd.grad(joint(values).pow(3).sum(), values, create_graph=True)
    with pytest.raises(NotImplementedError, match=r"^JointBatchNorm: differentiated twice"):
        slope.sum().backward()
