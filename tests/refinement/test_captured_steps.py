"""What the captured refinement does with a gradient: Adam's step, the falling rate, and orientations of any columns."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes.bodies import unsure_observation, walker
from scipy.spatial.transform import Rotation

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.refinement.captured import CapturedRefinement, _split
from warp_partdr.refinement.energy import Energy, Weights
from warp_partdr.refinement.stepper import FINAL_RATE, SHAPE_RATE, rate_share


def springs(weight: float, body: BodyParameters) -> Energy:
    """Nothing but squares of sizes' deviations: gradients in closed form, of any size."""
    weights = Weights(proj=0.0, seg=0.0, length=weight, thickness=weight, prior=0.0, limits=0.0)
    return Energy(unsure_observation(body), weights=weights)


@pytest.mark.parametrize("weight", [1e-9, 1e-3, 1e6])
@pytest.mark.parametrize("steps", [1, 6])
def test_a_step_is_adams(device, weight, steps):
    """Kingma and Ba's with torch's numbers, however large the gradient is: the first step is the rate itself."""
    rate, body = 0.01, walker(device)
    start = replace(body, lengths=body.lengths + 0.01, thicknesses=body.thicknesses - 0.004)
    captured = CapturedRefinement(springs(weight, body), 1, iterations=steps, learning_rate=rate)
    captured.refine(start)
    last = _split(captured._parameters)
    for name in ("lengths", "thicknesses"):
        usual, moved = body.tensors()[name].double(), start.tensors()[name].double().requires_grad_()
        adam = torch.optim.Adam([moved], lr=SHAPE_RATE * rate)
        falling = torch.optim.lr_scheduler.LambdaLR(adam, lambda step: rate_share(step, steps))
        for _ in range(steps):
            adam.zero_grad()
            (weight * (1000 * (moved - usual)).square()).sum().backward()
            adam.step()
            falling.step()
        torch.testing.assert_close(last[name].double(), moved.detach(), rtol=0, atol=1e-6)
        if steps == 1:
            way = (last[name] - start.tensors()[name]).abs()
            torch.testing.assert_close(way, torch.full_like(way, SHAPE_RATE * rate), rtol=2e-3, atol=0)


def test_the_rate_falls_along_half_a_cosine():
    shares = np.array([rate_share(step, 20) for step in range(21)])
    assert shares[[0, 10, 20]] == pytest.approx([1.0, (1 + FINAL_RATE) / 2, FINAL_RATE])
    np.testing.assert_allclose(shares + shares[::-1], 1 + FINAL_RATE)
    assert (np.diff(shares) <= 0).all()
    assert rate_share(0, 0) == 1.0
    assert rate_share(30, 20) == FINAL_RATE


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-4, 1e-5])
def test_nearly_collinear_columns_are_a_rotation(device, gap):
    """The second axis lies where the columns' small difference points, and is square to the first all the same."""
    axes = torch.from_numpy(Rotation.random(8, rng=0).as_matrix()).float().to(device)
    first, aside = axes[..., 0], axes[..., 1]
    body = walker(device)
    bodies = BodyParameters(**{name: torch.cat([tensor] * 8) for name, tensor in body.tensors().items()})
    captured = CapturedRefinement(springs(1.0, body), 8, iterations=0)
    captured.refine(replace(bodies, orientation=torch.cat([first, first + gap * aside], dim=1)))
    found = torch.from_numpy(captured._state.orientations.numpy()).to(device)
    torch.testing.assert_close(found.mT @ found, torch.eye(3, device=device).expand(8, 3, 3), rtol=0, atol=2e-6)
    assert (found - axes).abs().max() < 1e-6 / gap
