"""Statures that bones' lengths say, of people whose true ones are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from warp_partdr.body.stature import bone_statures, check_stature, tall_warning
from warp_partdr.body.template import MEAN_STATURE, template
from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic import people
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.measuring import measure_ellipbody, statures
from warp_partdr.models.registration import ungrown


def test_bones_say_how_tall_somebody_stands():
    model, rng = anny(), np.random.default_rng(5)
    phenotypes = rng.uniform(*people.PHENOTYPE_RANGES.T, size=(24, len(people.PHENOTYPE_RANGES)))
    shape = anny_shape(phenotypes)
    at_rest = torch.eye(3).expand(24, model.num_joints, 3, 3)
    lengths = measure_ellipbody(ungrown(model, shape, at_rest, torch.zeros(24, 3), {}))[3]
    true = statures(model, shape)
    assert true.min() < 1.4 < 1.75 < true.max()
    torch.testing.assert_close(bone_statures(lengths), true, rtol=0.015, atol=0)


def test_the_mean_body_is_as_tall_as_the_mean_adult():
    lengths = torch.from_numpy(template().mean_lengths)[None].float()
    torch.testing.assert_close(bone_statures(lengths), torch.tensor([MEAN_STATURE]), rtol=5e-3, atol=0)


def test_known_statures_are_plain_numbers_of_metres():
    """NumPy's numbers would make tensors of double precision of those that they are multiplied by."""
    for stature in (1.75, np.float64(1.75), np.float32(1.75), 2, np.int64(2)):
        found = check_stature(stature)
        assert type(found) is float
        assert found == stature
    assert check_stature(None) is None
    for stature in (0, -1, 0.3, 9, 178, True, np.nan, np.bool_(True), "1.75", 1.7j):
        with pytest.raises(InputError, match=r"stature: .*; expected metres, 0.4 to 2.8"):
            check_stature(stature)


def test_heights_that_hardly_anybody_has_are_told() -> None:
    assert tall_warning("person0", 1.97) == ()
    assert tall_warning("person0", 1.1) == ()  # a child
    (sentence,) = tall_warning("person3", 2.14)
    assert sentence.startswith("person3 is 2.14 m tall, and hardly anybody is taller than 2.05 m")
    assert "--set stature=1.8" in sentence
