"""Kernels of training people's pixels say what torch says of the same draws, to the bit."""

from __future__ import annotations

from functools import cache

import pytest
import torch
import torch_label_noise as by_torch
from helpers.bodies import bank

from warp_partdr.body.labels import IGNORE
from warp_partdr.body.template import NUM_PARTS
from warp_partdr.lab.synthetic import label_noise
from warp_partdr.lab.synthetic.cut_masks import cut_mask
from warp_partdr.lab.synthetic.label_noise import MAX_STRENGTH, LabelNoise
from warp_partdr.lab.synthetic.occluders import draw_occluders
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.lab.synthetic.training_people import PeopleMaker

COUNT = 24
KINDS = ["people", "spots", "blots"]  # people of 128 pixels, all labels anywhere, a few of them in lumps


@cache
def images(kind: str, device: str) -> torch.Tensor:
    """Part labels, shape (COUNT, S, S), S being 128, 33 or 65."""
    if kind == "people":
        parts = PeopleMaker(bank(), size=128, device=device, seed=2, held_out=False, pool=COUNT)(COUNT).parts
        assert (parts == IGNORE).any()
        return parts
    rng = TorchRng(1, device)
    if kind == "spots":
        return torch.where(rng.chance(0.1, COUNT, 33, 33), IGNORE, rng.integers(NUM_PARTS + 1, COUNT, 33, 33)).byte()
    lumps = rng.integers(4, COUNT, 17, 17).repeat_interleave(4, 1).repeat_interleave(4, 2)[:, :65, :65]
    return torch.where(rng.chance(0.2, COUNT, 65, 65), rng.integers(4, COUNT, 65, 65), lumps).byte()


def strengths(device: str) -> torch.Tensor:
    """None to the most, shape (COUNT,)."""
    return torch.linspace(0, MAX_STRENGTH, COUNT, device=device).roll(5)


@pytest.mark.parametrize("kind", KINDS)
def test_areas_are_counts(kind: str, device: str) -> None:
    parts = images(kind, device)
    assert torch.equal(label_noise._areas(parts).long(), by_torch.areas(parts))


@pytest.mark.parametrize("kind", KINDS)
def test_boundaries_wander_as_far(kind: str, device: str) -> None:
    parts, strength = images(kind, device), strengths(device)
    tables = LabelNoise(TorchRng(0, device)).tables(torch.arange(COUNT, device=device) % 13)
    mine, theirs = LabelNoise(TorchRng(4, device)), by_torch.TorchLabelNoise(TorchRng(4, device))
    for _ in range(3):
        found = mine._wander(parts, tables, strength)
        assert torch.equal(found, theirs._wander(parts, tables, strength))
        assert not torch.equal(found, by_torch.look_up(tables, parts))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("apart", [1, 2, 5])
def test_majorities_and_ties_are_decided_alike(kind: str, apart: int, device: str) -> None:
    parts = images(kind, device)
    chosen = strengths(device) > 0.5
    found = label_noise._majority(parts, chosen, apart)
    assert torch.equal(found, by_torch.majority(parts, chosen, apart))
    assert not torch.equal(found[chosen], parts[chosen])


@pytest.mark.parametrize("kind", KINDS)
def test_people_grow_and_shrink_alike(kind: str, device: str) -> None:
    parts = images(kind, device)
    mine, theirs = LabelNoise(TorchRng(4, device)), by_torch.TorchLabelNoise(TorchRng(4, device))
    for strength in (strengths(device), 4 * strengths(device)):
        assert torch.equal(mine._grow(parts, strength), theirs._grow(parts, strength))


@pytest.mark.parametrize("kind", KINDS)
def test_all_noise_of_labels_is_alike(kind: str, device: str) -> None:
    parts = images(kind, device)
    parts = torch.where(parts == IGNORE, 0, parts).byte()
    mine, theirs = LabelNoise(TorchRng(4, device)), by_torch.TorchLabelNoise(TorchRng(4, device))
    sets = torch.arange(COUNT, device=device) % 13
    for _ in range(4):
        found = mine.groups(parts, sets, strengths(device))
        assert torch.equal(found, theirs.groups(parts, sets, strengths(device)))


@pytest.mark.parametrize("kind", KINDS)
def test_occluders_are_alike(kind: str, device: str) -> None:
    parts, strength = images(kind, device), strengths(device)
    mine, theirs, rng = (TorchRng(seed, device) for seed in (3, 3, 9))
    tables = LabelNoise(rng).tables(rng.integers(13, COUNT))
    hidden = covered = 0
    for _ in range(20):
        places = rng.uniform(COUNT, 6, 2, low=-1.1, high=1.1)
        found = draw_occluders(mine, parts, tables, places, strength)
        expected = by_torch.draw_occluders(theirs, parts, tables, places, strength)
        for name in ("mask", "hiding", "groups"):
            got, wanted = getattr(found, name), getattr(expected, name)
            assert got.dtype == wanted.dtype
            assert torch.equal(got, wanted)
        hidden, covered = hidden + int(found.hiding.sum()), covered + int(found.mask.sum())
    assert 0 < hidden < covered


@pytest.mark.parametrize("size", [33, 128])
def test_masks_are_cut_alike(size: int, device: str) -> None:
    """Lengths are rounded by a hair otherwise than torch's on the CPU: a pixel may lie exactly between two parts."""
    rng = TorchRng(5, device)
    joints = 0.5 * rng.normal(COUNT, 21, 2)
    joints[0, 1:3] = joints[0, 0]  # bones without a length
    mask, unsure = rng.chance(0.8, COUNT, size, size), rng.chance(0.5, COUNT)
    statures = rng.uniform(COUNT, low=0.3, high=1.6)
    found, expected = (cut(mask, joints, statures, unsure) for cut in (cut_mask, by_torch.cut_mask))
    assert found.dtype == expected.dtype
    assert int((found != expected).sum()) <= 1
    assert set(found.unique().tolist()) == {*range(NUM_PARTS + 1), IGNORE}


def test_empty_batches_stay_empty(device: str) -> None:
    none = torch.zeros(0, 128, 128, dtype=torch.uint8, device=device)
    noise, numbers = LabelNoise(TorchRng(0, device)), torch.zeros(0, device=device)
    sets = numbers.long()
    assert noise.groups(none, sets, numbers).shape == none.shape
    drawn = draw_occluders(noise.rng, none, noise.tables(sets), torch.zeros(0, 6, 2, device=device), numbers)
    assert drawn.groups.shape == drawn.mask.shape == drawn.hiding.shape == none.shape
    assert cut_mask(none > 0, torch.zeros(0, 21, 2, device=device), numbers, sets > 0).shape == none.shape
