"""Labels of people in bulk are kept as small as their fits look at them, and fits are the same."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from warp_partdr.bulk.people import BulkQuality, kept_label_size, stages_of_quality
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.observation import LABEL_SIZE, crop_evidence
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.solve.ellipsoids.fitting import fit_people
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.stages import Stage

PEOPLE = [make_sample(index, "realistic") for index in range(8)]  # of whom limbs of several are tried mirrored


def with_sizes(*sizes: int) -> FitOptions:
    return replace(stages_of_quality("fast"), stages=tuple(Stage("labels", 1, 2, 0.01, size) for size in sizes))


def test_labels_are_kept_as_large_as_any_stage_looks_at_them() -> None:
    network = packaged_network("cpu")
    assert kept_label_size(with_sizes(), network, meshes=False) == 128  # that of the network
    assert kept_label_size(with_sizes(128, 128), network, meshes=False) == 128
    assert kept_label_size(with_sizes(64, 128), network, meshes=False) == LABEL_SIZE
    assert kept_label_size(with_sizes(192), network, meshes=False) == LABEL_SIZE
    assert kept_label_size(with_sizes(), network, meshes=True) == LABEL_SIZE  # meshes are drawn at 160 px
    assert kept_label_size(with_sizes(1024), network, meshes=False) == LABEL_SIZE


@pytest.mark.parametrize("quality", ["network", "fast"])
def test_fits_to_small_kept_labels_are_the_same(quality: BulkQuality, device: str) -> None:
    options, network = stages_of_quality(quality), packaged_network(device)
    evidence = [weigh_evidence(each.keypoints, each.parts, each.others)[0] for each in PEOPLE]
    found = []
    for size in (kept_label_size(options, network, meshes=False), LABEL_SIZE):
        people = [CutPerson(each, *crop_evidence(each, device=device, label_size=size)) for each in evidence]
        assert people[0].observation.labels is not None
        assert people[0].observation.labels.shape == (size, size)
        found.append(fit_people(people, options, network))
    assert quality == "network" or any(fit.depth_order and fit.depth_order.tried for fit in found[0])
    for small, large in zip(*found, strict=True):
        assert torch.equal(small.parameters.free_rotations(), large.parameters.free_rotations())
        assert small.energy == large.energy
        assert small.depth_order == large.depth_order
