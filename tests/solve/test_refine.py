"""Refinement brings bodies back, each for itself, and leaves alone what is frozen or left out."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from helpers.bodies import WITHOUT_TIPS, bent_bodies, observation_of, refine_by_autograd, walker

from warp_partdr.body.labels import LabelSet, label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh
from warp_partdr.solve.ellipsoids.captured import CapturedRefinement
from warp_partdr.solve.ellipsoids.energy import Energy, Weights
from warp_partdr.solve.ellipsoids.refine import refine
from warp_partdr.solve.ellipsoids.stepper import SIZES

SIZE = 96
PATHS = [refine_by_autograd, refine]
EXACT_AND_MESH = pytest.mark.parametrize("renderer", [RendererEllipsoids(), RendererMesh()], ids=["exact", "mesh"])


def energy_of(body: BodyParameters, labels: LabelSet | str = "body14", **options: Any) -> Energy:
    return Energy(observation_of(body, label_set(labels), SIZE), SIZE, **options)


@pytest.mark.parametrize("path", PATHS)
def test_refinement_brings_a_moved_body_back(device, path):
    body = walker(device)
    energy = Energy(observation_of(body), prior=PosePrior().to(device))
    generator = torch.Generator().manual_seed(0)
    noise = (0.12 * torch.randn(1, 20, 3, generator=generator)).to(device)
    start = replace(body, rotations=body.rotations + noise, shift=body.shift + 0.06, log_scale=body.log_scale + 0.05)
    refined = path(start, energy, iterations=60, learning_rate=0.02)
    before = sum(term.item() for term in energy(start).values())
    assert refined.energy.item() < 0.35 * before
    assert refined.terms["seg"].item() < 0.4 * energy(start)["seg"].item()
    assert refined.history.shape == (60, 1)
    # what comes back is what was measured
    again = sum(term.item() for term in energy(refined.parameters).values())
    assert again == pytest.approx(refined.energy.item(), rel=1e-4)


@pytest.mark.parametrize("path", PATHS)
def test_sizes_stay_within_human_bounds(device, path):
    """A target that no human fills (everything is the head) must not blow the body up."""
    seen = observation_of(walker(device))
    energy = Energy(replace(seen, labels=torch.full_like(seen.labels, 8)), size=64, weights=Weights(seg=1.0))
    found = path(walker(device), energy, iterations=40, learning_rate=0.1).parameters.tensors()
    mean = BodyParameters.mean(1, device=device).tensors()
    for name, (low, high) in SIZES.items():
        share = found[name] / mean[name]
        assert share.min() >= low - 1e-6
        assert share.max() <= high + 1e-6
        assert share.min() < low + 1e-5 or share.max() > high - 1e-5  # or the bounds were not tried
    assert found["thicknesses"][0, 6] > 1.2 * mean["thicknesses"][0, 6]


@EXACT_AND_MESH
def test_a_label_set_without_hands_and_feet_is_fitted(device, renderer):
    body = bent_bodies(device, 1)
    energy = energy_of(body, WITHOUT_TIPS, prior=PosePrior().to(device), renderer=renderer)
    assert energy(body)["seg"] < (1e-6 if isinstance(renderer, RendererEllipsoids) else 20.0)
    moved = replace(body, shift=body.shift + 0.05)
    assert refine(moved, energy, iterations=20).energy < energy(moved)["seg"] + energy(moved)["proj"]


@pytest.mark.parametrize("path", PATHS)
def test_frozen_parameters_stay(device, path):
    body = bent_bodies(device, 1)
    energy = energy_of(body, prior=PosePrior().to(device))
    start = replace(body, rotations=0.9 * body.rotations, lengths=3.0 * body.lengths)  # beyond what is human
    refined = path(start, energy, iterations=3, frozen=("lengths", "thicknesses", "shift"))
    for name, tensor in refined.parameters.tensors().items():
        assert torch.equal(tensor, start.tensors()[name]) == (name in ("lengths", "thicknesses", "shift")), name


def test_frozen_parameters_have_no_gradient():
    leaves = bent_bodies().leaves(("lengths", "thicknesses"))
    leaves.posed().centres.square().sum().backward()
    have = {name for name, tensor in leaves.tensors().items() if tensor.grad is not None}
    assert have == {"orientation", "rotations"}


def test_both_paths_agree_where_sizes_are_frozen(device):
    body = bent_bodies(device, 1)
    energy = energy_of(body, prior=PosePrior().to(device))
    start = replace(body, rotations=0.9 * body.rotations)
    runs = [path(start, energy, iterations=5, frozen=("thicknesses",)).parameters for path in PATHS]
    torch.testing.assert_close(runs[0].rotations, runs[1].rotations, rtol=0, atol=2e-3)


@pytest.mark.parametrize(
    ("frozen", "message"),
    [
        (("length",), r"frozen: \['length'\]"),
        ("lengths", "frozen: lengths"),
        (tuple(bent_bodies().tensors()), "frozen: all"),
    ],
)
def test_what_cannot_be_frozen_is_refused(frozen, message):
    energy = energy_of(bent_bodies())
    for path in (*PATHS, lambda start, energy, **rule: CapturedRefinement(energy, 2, **rule)):
        with pytest.raises(ValueError, match=message):
            path(bent_bodies(), energy, frozen=frozen)


@EXACT_AND_MESH
def test_one_label_has_no_z_gradient_and_none_is_looked_for(device, renderer):
    """Leaving it out is no approximation: looked for, it is exactly zero."""
    body = bent_bodies(device, 1)
    energy = energy_of(body, "full1", renderer=renderer)
    assert energy.renderer == replace(renderer, depth_weight=0.0)
    gradients = []
    for weight in (0.0, 1.0):
        energy = energy_of(body, "full1")
        energy.renderer = replace(renderer, depth_weight=weight)
        leaves = replace(body, shift=body.shift + 0.1, rotations=1.3 * body.rotations).leaves()
        energy.segmentation(leaves, leaves.posed()).sum().backward()
        gradients.append(leaves.rotations.grad)
    assert torch.equal(*gradients)
    assert energy_of(body).renderer.depth_weight == 1.0


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_it_goes_down_whatever_the_caller_s_gradient_mode(mode):
    start = BodyParameters.mean(2)
    with mode():
        found = refine(start, lambda bodies: {"size": bodies.lengths.square().sum(1)}, iterations=5)
    assert (found.history[-1] < found.history[0]).all()
    assert not found.energy.is_inference()


@pytest.mark.parametrize(
    ("terms", "error", "says"),
    [
        (lambda bodies: None, TypeError, "energy: returned NoneType; expected terms by name"),
        (lambda bodies: bodies.lengths.sum(1), TypeError, "energy: returned Tensor; expected terms by name"),
        (lambda bodies: {}, TypeError, "energy: returned none; expected terms by name"),
        (lambda bodies: {"a": bodies.lengths.sum()}, ValueError, r"energy: a: shape \(\); expected \(2\)"),
        (lambda bodies: {"a": torch.zeros(2)}, ValueError, "energy: no term has a gradient"),
    ],
)
def test_energies_that_are_none_are_refused(terms, error, says):
    with pytest.raises(error, match=says):
        refine(BodyParameters.mean(2), terms, iterations=2)


def test_energies_of_something_else_are_refused():
    seen = observation_of(walker("cpu"))
    with pytest.raises(TypeError, match="observation: BodyParameters; expected Observation or Observations, of obs"):
        Energy(walker("cpu"))
    for size in (0, 64.5):
        with pytest.raises(ValueError, match=f"size: {size}; expected an integer of 1 or more"):
            Energy(seen, size)


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("lengths", 0.0, "lengths: 0.0; expected positive numbers"),
        ("thicknesses", -1.0, "thicknesses: -1.0; expected positive numbers"),
        ("log_scale", -200.0, r"exp\(log_scale\): 0.0; expected positive numbers"),
    ],
)
def test_a_start_of_no_size_is_refused(device, path, name, value, says):
    """Bounds alone would let a length of 0 stay, for its gradient is NaN."""
    body = walker(device)
    values = {each: tensor.clone() for each, tensor in body.tensors().items()}
    values[name].flatten()[0] = value
    with pytest.raises(ValueError, match=says):
        path(BodyParameters(**values), energy_of(body), iterations=2)
