"""Numbers are looked at by one graph: what passes there is good, and all that is wrong is found."""

from __future__ import annotations

import math

import pytest
import torch

from warp_partdr.interop import checks
from warp_partdr.interop.checks import check_numbers

GOOD = {
    "plain": lambda: torch.randn(3, 5),
    "sizes": lambda: torch.rand(2, 4) + 0.1,
    "turns": lambda: torch.linalg.qr(torch.randn(2, 3, 3, dtype=torch.float64))[0],
    "frames": lambda: torch.diag(torch.tensor([1.0, -1.0, 1.0])).expand(2, 1, 3, 3),
    "nothing": lambda: torch.empty(0, 3),
}
KINDS = {"positive": ["sizes"], "rotations": ["turns"], "frames": ["frames"]}


def good(device) -> dict[str, torch.Tensor]:
    """Tensors of all kinds, of one dtype each."""
    tensors = {name: make() for name, make in GOOD.items()}
    tensors["turns"] *= tensors["turns"].det().sign()[:, None, None]
    return {name: tensor.to(device) for name, tensor in tensors.items()}


@pytest.fixture
def slow(monkeypatch):
    """Counts how often torch had to look."""
    calls: list[int] = []
    norm = torch.linalg.vector_norm
    monkeypatch.setattr(checks.torch.linalg, "vector_norm", lambda *a, **o: (calls.append(1), norm(*a, **o))[1])
    return calls


def test_what_is_good_is_not_looked_at_again(device, slow):
    check_numbers(good(device), **KINDS)  # not yet captured
    assert slow
    slow.clear()
    for _ in range(3):
        check_numbers(good(device), **KINDS)
    assert not slow


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("plain", math.nan, "plain: holds NaN"),
        ("plain", math.inf, "plain: holds NaN or infinity"),
        ("plain", -2e12, "plain: holds 2e"),
        ("sizes", 0.0, "sizes: 0.0; expected positive"),
        ("sizes", math.nan, "sizes: holds NaN"),
        ("turns", 0.5, "turns: matrix"),
        ("turns", math.nan, "turns: holds NaN"),
        ("frames", 0.2, "frames: matrix"),
    ],
)
def test_one_wrong_number_is_found(device, name, value, message):
    for _ in range(3):
        check_numbers(good(device), **KINDS)
    tensors = {each: tensor.contiguous().clone() for each, tensor in good(device).items()}
    tensors[name].view(-1)[-1] = value
    with pytest.raises(ValueError, match=message):
        check_numbers(tensors, **KINDS)
    check_numbers(good(device), **KINDS)  # nothing is left of it


def test_a_reflection_is_no_rotation_but_a_frame(device):
    mirror = torch.diag(torch.tensor([1.0, 1.0, -1.0], device=device))[None]
    for _ in range(3):
        check_numbers({"frames": mirror}, frames=["frames"])
        with pytest.raises(ValueError, match="turns: matrix"):
            check_numbers({"turns": mirror}, rotations=["turns"])


@pytest.mark.parametrize("value", [1e-300, 1e12])
def test_numbers_that_rounding_would_spoil_pass(device, value):
    """Smaller than any float32, and at the bound itself: torch looks again, in the numbers' own precision."""
    for _ in range(3):
        check_numbers({"sizes": torch.full((1, 1), value, dtype=torch.float64, device=device)}, positive=["sizes"])
