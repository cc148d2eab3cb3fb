"""Feet that stand in films: what tells that they do, and what holds them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.quick import QUICK_SCENE

from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.inputs.scene import Scene
from warp_partdr.lab.evaluation.scene_scoring import sliding_speed
from warp_partdr.lab.synthetic.mocap import Clip
from warp_partdr.lab.synthetic.scene_people import make_clip, make_pair
from warp_partdr.models.anny import anny
from warp_partdr.solve.mesh.energy import MeshEnergy
from warp_partdr.solve.mesh.feet import FEET, slides
from warp_partdr.solve.mesh.starts import Starts
from warp_partdr.solve.scene.fitting import fit_scene
from warp_partdr.solve.scene.observations import observe_scene
from warp_partdr.solve.scene.options import SceneOptions
from warp_partdr.solve.scene.plan import plan_scene
from warp_partdr.solve.scene.start import gather_scene

RATE = torch.tensor(30.0)
STANDS, MOVES = 0.15, 0.75  # [m/s]


def prepared(scene: Scene, options: SceneOptions = QUICK_SCENE) -> tuple[MeshEnergy, Starts]:
    observed_bodies = observe_scene(scene, "cpu")
    plan = plan_scene(scene, observed_bodies, anny(), options)
    with torch.no_grad():
        return plan.energy, gather_scene(plan, observed_bodies)


def moving(*velocities: tuple[float, float, float]) -> torch.Tensor:
    """A point that passes (0, 0, 4) between two frames, seen by a view at each velocity [m/s], (1, 2, V, 1, 3)."""
    half = torch.tensor(velocities) / RATE / 2
    middle = torch.tensor([0.0, 0.0, 4.0])
    return torch.stack([middle - half, middle + half])[None, :, :, None]


def seen_by(views: int) -> torch.Tensor:
    return torch.ones(1, 2, views, dtype=torch.bool)


def slow_slides(seen: torch.Tensor, shown: torch.Tensor, rates: torch.Tensor) -> torch.Tensor:
    velocities = (seen[:, 1:] - seen[:, :-1]) * rates[:, None, None, None]
    squares = velocities.square().sum(-1)
    with torch.no_grad():
        rays = torch.nn.functional.normalize(seen[:, 1:] + seen[:, :-1], dim=-1)
        across = squares - (velocities * rays).sum(-1).square()
        both = (shown[:, 1:] & shown[:, :-1])[..., None]
        odds = 2 * math.log(MOVES / STANDS) - across / 2 * (STANDS**-2 - MOVES**-2)
        stands = odds.masked_fill(~both, math.inf).amin(2).sigmoid() * both.any(2)
    return stands * squares[:, :, 0]


def walk(people: int, frames: int, views: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Six points of people at 0.05 to 2 m/s, and who is shown: the first in the last frames, the second nowhere."""
    random = torch.Generator().manual_seed(frames)
    starts = torch.randn(people, 1, views, 6, 3, generator=random) + torch.tensor([0.0, 0.0, 4.0])
    speeds = torch.logspace(-1.3, 0.3, 6)[:, None]
    seen = starts + (speeds / RATE * torch.randn(people, frames, views, 6, 3, generator=random)).cumsum(1)
    shown = torch.rand(people, frames, views, generator=random) > 0.2
    shown[:1, -2:], shown[1:2] = True, False
    return seen, shown


def rates_of(seen: torch.Tensor, varying: bool = True) -> torch.Tensor:
    """Most steps take 1/30 s, some are longer, and one is unknown."""
    steps = max(seen.shape[1] - 1, 0)
    rates = RATE.repeat(steps)
    if varying and steps > 2:
        rates[1], rates[2:4] = 0.0, torch.tensor([10.0, 24.0])[: steps - 2]
    return rates


def cost_and_gradient(seen: torch.Tensor, shown: torch.Tensor, device: str) -> tuple[torch.Tensor, torch.Tensor]:
    """Kernels compute them for costs that weigh 1, 2, ..."""
    moving = seen.to(device).detach().requires_grad_()
    cost = slides(moving, shown.to(device), rates_of(seen).to(device))
    weights = torch.arange(1.0, cost.numel() + 1, device=device).reshape(cost.shape)
    (gradient,) = torch.autograd.grad(cost, moving, weights)
    return cost.detach().cpu(), gradient.cpu()


def slow_cost_and_gradient(seen: torch.Tensor, shown: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Torch computes the same in float64."""
    moving = seen.detach().double().requires_grad_()
    cost = slow_slides(moving, shown, rates_of(seen).double())
    weights = torch.arange(1.0, cost.numel() + 1, dtype=torch.float64).reshape(cost.shape)
    (gradient,) = torch.autograd.grad(cost, moving, weights)
    return cost.detach(), gradient


def assert_as_slow(seen: torch.Tensor, shown: torch.Tensor, device: str) -> None:
    wanted = slow_cost_and_gradient(seen, shown)
    for _ in range(2):  # launched, then by a captured graph
        for one, other in zip(cost_and_gradient(seen, shown, device), wanted, strict=True):
            scale = float(other.abs().amax()) if other.numel() else 0.0
            torch.testing.assert_close(one.double(), other, rtol=1e-4, atol=1e-6 * scale)


@pytest.mark.parametrize(("people", "frames", "views"), [(3, 7, 1), (2, 2, 1), (4, 5, 3), (2, 1, 1), (0, 4, 2)])
def test_costs_and_gradients_are_torchs(people: int, frames: int, views: int, device: str) -> None:
    seen, shown = walk(people, frames, views)
    assert_as_slow(seen, shown, device)
    assert_as_slow(seen.transpose(2, 3).contiguous().transpose(2, 3), shown, device)  # of other strides
    cost, gradient = cost_and_gradient(seen, shown, device)
    assert bool((cost[:1] > 0).any()) == (people > 0 and frames > 1)
    assert not gradient[:, :, 1:].any()  # the other views tell who stands
    assert not cost[1:2].any()
    assert not gradient[1:2].any()


def test_costs_and_gradients_are_the_same_every_time(device: str) -> None:
    seen, shown = walk(8, 64, 2)
    first = cost_and_gradient(seen, shown, device)
    for _ in range(4):
        assert all(map(torch.equal, first, cost_and_gradient(seen, shown, device)))


def test_points_anywhere_at_any_speed_have_finite_costs(device: str) -> None:
    aside = torch.tensor([2.0, -1.0, 4.0])
    along = torch.nn.functional.normalize(aside, dim=0)
    pairs = {
        "at rest": (aside, aside),
        "at the camera": (torch.zeros(3), torch.zeros(3)),
        "through the camera": (-0.001 * along, 0.001 * along),
        "fast along the view": (aside, 10 * aside),
        "at 1000 km/s": (aside, aside + torch.tensor([3e4, 1e4, 0.0])),
        "faster than light": (aside, torch.tensor([1e15, 0.0, 1e15])),
    }
    seen = torch.stack([torch.stack(pair) for pair in pairs.values()], dim=1)[None, :, None]
    cost, gradient = cost_and_gradient(seen, seen_by(1), device)
    assert bool(torch.isfinite(cost).all())
    assert bool(torch.isfinite(gradient).all())
    assert not cost[..., :2].any()
    assert not gradient[..., :2, :].any()
    assert_as_slow(seen[..., :4, :], seen_by(1), device)
    assert_as_slow(seen[..., 4:5, :], seen_by(1), device)
    unseen = cost_and_gradient(seen, ~seen_by(1), device)
    assert not any(bool(each.any()) for each in unseen)


def test_the_gradient_has_no_derivative() -> None:
    seen = moving((0.4, 0.0, 0.3)).requires_grad_()
    (force,) = torch.autograd.grad(slides(seen, seen_by(1), RATE[None]).sum(), seen, create_graph=True)
    with pytest.raises(NotImplementedError, match="slides"):
        force.sum().backward()


@pytest.mark.parametrize(("across", "along"), [(0.0, 0.0), (0.0, 2.0), (0.3, 0.5), (0.5, 0.0), (2.0, 0.0)])
def test_a_point_stands_as_surely_as_its_speed_across_the_view_says(across: float, along: float) -> None:
    likely = [math.exp(-((across / spread) ** 2) / 2) / spread**2 for spread in (STANDS, MOVES)]
    expected = likely[0] / sum(likely) * (across**2 + along**2)
    found = slides(moving((across, 0.0, along)), seen_by(1), RATE[None])
    assert found.shape == (1, 1, 1)
    assert float(found) == pytest.approx(expected, rel=1e-4, abs=1e-9)


def test_the_view_that_sees_a_point_fastest_counts_and_who_is_not_seen_does_not_stand() -> None:
    both = moving((0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    assert float(slides(both, seen_by(2), RATE[None])) < 1e-3
    shown = seen_by(2)
    shown[0, 0, 1] = False  # by the second view, in one of the frames
    assert float(slides(both, shown, RATE[None])) > 0.9
    shown[0, 1, 0] = False
    assert float(slides(both, shown, RATE[None])) == 0


def test_nothing_moves_so_as_to_count_less() -> None:
    """The force is that of a share that does not change."""
    seen = moving((0.4, 0.0, 0.3)).requires_grad_()
    cost = slides(seen, seen_by(1), RATE[None])
    (force,) = torch.autograd.grad(cost.sum(), seen)
    velocity = (seen[:, 1] - seen[:, 0]).detach() * RATE
    share = cost.detach() / velocity.square().sum()
    torch.testing.assert_close(force[:, 1], 2 * share * RATE * velocity)


def test_feet_of_each_person_are_compared_with_their_own_a_frame_before() -> None:
    sample = make_pair(101, "clean")
    observations = [replace(each, frame=frame) for each in sample.scene.observations for frame in range(5)]
    scene = replace(sample.scene, observations=observations)
    energy, people = prepared(scene)
    moves = 0.01 * torch.randn(people.learning_rates().shape, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        unknowns = people.moved(moves)
        cost, points = energy(people, unknowns)["sliding"], energy.place(people, unknowns).points
    names = energy.drawn.model.landmark_names
    feet = torch.stack([points[:, names.index(name)] for name in FEET], dim=1).unflatten(0, (2, 5))
    expected = slides(scene.views[0].to_camera(feet)[:, :, None], torch.ones(2, 5, 1, dtype=torch.bool), RATE.repeat(4))
    assert cost.shape == (2, 4, 6)
    assert float(cost.sum()) > 0.1
    torch.testing.assert_close(cost, expected / (3 * 0.1**2), rtol=1e-2, atol=1e-4)  # three points of a foot, 0.1 m/s


def test_only_films_whose_frames_are_near_one_another_have_feet_that_stand() -> None:
    observation = make_pair(101, "clean").scene.observations[0]
    views = make_pair(101, "clean").scene.views
    film = Scene(views, [replace(observation, frame=frame) for frame in range(3)])
    assert prepared(film)[1].rates.tolist() == [30, 30]
    uneven = replace(film, times=[0.0, 0.1, 0.6])
    assert prepared(uneven)[1].rates.tolist() == [10, 0]
    for other, options in (
        (replace(film, observations=[observation]), QUICK_SCENE),
        (replace(film, frame_rate=5.0), QUICK_SCENE),
        (film, replace(QUICK_SCENE, smoothing=0.0)),
        (film, replace(QUICK_SCENE, sliding=0.0)),
    ):
        energy, people = prepared(other, options)
        assert people.rates is None
        assert "sliding" not in energy(people, people.at_rest())
    with pytest.raises(ValueError, match="sliding: -1"):
        SceneOptions(sliding=-1)


def test_somebody_who_stands_slides_less(device: str) -> None:
    eyes = np.broadcast_to(np.eye(3), (24, 20, 3, 3)).copy()
    stands = Clip("stands", eyes[:, 0], eyes, np.zeros((24, 20, 3)), np.broadcast_to([0.0, 1.0, 0.0], (24, 3)))
    sample = make_clip(5, stands, 30.0)
    speeds = []
    for weight in (0.0, 0.3):
        fit = fit_scene(sample.scene, options=replace(QUICK_SCENE, sliding=weight), device=device)
        speeds.append(sliding_speed(fit.landmarks(MPJPE_JOINTS).cpu().numpy(), sample.joints, 30.0))
        assert ("sliding" in fit.energy) == (weight > 0)
    assert speeds[0] > 0.05  # [m/s]
    assert speeds[1] < 0.6 * speeds[0]
