"""Detailed bodies of a given stature keep their proportions."""

from __future__ import annotations

import numpy as np
import torch

from warp_partdr.lab.synthetic import people
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.measuring import statures
from warp_partdr.models.resizing import resize_before, resize_shapes


def test_bodies_are_enlarged_as_they_are(device):
    model, rng = anny(torch.device(device)), np.random.default_rng(3)
    phenotypes = rng.uniform(*people.PHENOTYPE_RANGES.T, size=(4, len(people.PHENOTYPE_RANGES)))
    shape = anny_shape(phenotypes).to(device)
    shares = torch.tensor([0.93, 1.0, 1.04, 1.1], device=device)
    wanted = shares * statures(model, shape)
    resized, found = resize_shapes(model, shape, wanted)
    torch.testing.assert_close(found, shares)
    torch.testing.assert_close(statures(model, resized), wanted, rtol=0, atol=1e-4)
    assert torch.equal(resized[1], shape[1])
    before, after = (model.rest(each).vertices for each in (shape, resized))
    off = (before * shares[:, None, None] - after).norm(dim=-1).mean(1)
    grown = (before * (shares - 1)[:, None, None]).norm(dim=-1).mean(1)
    assert (off < 0.25 * grown + 1e-6).all(), (off, grown)


def test_who_is_larger_is_as_much_farther_from_the_camera(device):
    model = anny(torch.device(device))
    shape = anny_shape(torch.full((2, 6), 0.5)).to(device)
    eye, roots = torch.tensor([0.4, -1.0, 2.0]), torch.tensor([[0.0, 0.0, 5.0], [1.0, 0.3, -1.0]], device=device)
    wanted = 1.1 * statures(model, shape)[0].item()
    resized, positions = resize_before(model, shape, roots, wanted, eye)
    torch.testing.assert_close(statures(model, resized), torch.full((2,), wanted, device=device), rtol=0, atol=1e-4)
    torch.testing.assert_close(positions - eye.to(device), 1.1 * (roots - eye.to(device)))
