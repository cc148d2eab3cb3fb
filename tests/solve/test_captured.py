"""The captured refinement against the one by autograd: terms, gradients, steps, whole runs, and its own promises."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
import warp as wp
from helpers.bodies import moved_bodies, noise, refine_by_autograd, unsure_observation, walker
from scipy.spatial.transform import Rotation

from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.inputs.observations import Observations
from warp_partdr.kernels.refine.rules import RULES
from warp_partdr.kernels.refine.state import MODULE, Drawn
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh
from warp_partdr.solve.ellipsoids.captured import CapturedRefinement, _split
from warp_partdr.solve.ellipsoids.energy import Energy, Weights
from warp_partdr.solve.ellipsoids.energy_loss import energy_loss
from warp_partdr.solve.ellipsoids.stepper import FINAL_RATE, SHAPE_RATE, rate_share

SIZE = 64
LABELS = label_set("surreal14")


def energy_of(body: BodyParameters, *, labels: bool = False, **options) -> Energy:
    prior = PosePrior().to(body.shift.device)
    return Energy(unsure_observation(body, labels=LABELS if labels else None), size=SIZE, prior=prior, **options)


def check_both_paths(energy: Energy, bodies: BodyParameters, of_terms: float, of_gradient: float) -> tuple[dict, dict]:
    """Compare terms and gradients; gives the captured ones."""
    (terms, gradient), (want_terms, want) = gradient_at(energy, bodies), autograd_at(energy, bodies)
    assert_same(terms, want_terms, of_terms)
    assert_same(gradient, want, of_gradient)
    return terms, gradient


def gradient_at(energy: Energy, bodies: BodyParameters) -> tuple[dict, dict]:
    """Terms and gradient of the captured path."""
    captured = CapturedRefinement(energy, bodies.batch_size, iterations=0)
    return captured.refine(bodies).terms, _split(captured._gradient)


def autograd_at(energy, bodies: BodyParameters) -> tuple[dict, dict]:
    """Autograd computes the same path."""
    leaves = bodies.leaves()
    terms = energy(leaves)
    torch.stack(list(terms.values())).sum().backward()
    return terms, {name: tensor.grad for name, tensor in leaves.tensors().items()}


def assert_same(have: dict, want: dict, tolerance: float) -> None:
    """Equal up to ``tolerance`` of the largest entry of a body."""
    assert have.keys() == want.keys()
    for name, tensor in want.items():
        scale = tensor.detach().abs().flatten(1).amax(1) if tensor.dim() > 1 else tensor.detach().abs()
        error = (have[name] - tensor).detach().abs().reshape(len(tensor), -1).amax(1)
        assert (error <= tolerance * scale.clamp_min(1.0)).all(), (name, error, scale)


class FixedForces:
    """A renderer whose forces are given: the loss is linear in what they act on."""

    def __init__(self, renderer, part_labels, targets, ellipsoids, perspective) -> None:
        rng = np.random.default_rng(3)
        shape, device = ellipsoids.centres.shape, ellipsoids.centres.device
        self.force, self.moment, self.camera = (
            rng.standard_normal((*shape, *size)).astype(np.float32) for size in ((3,), (3, 3), (4,))
        )
        self.drawn = Drawn()
        self.drawn.loss = wp.array(np.ones((shape[0], 7)), dtype=float, device=device)
        # In shares that lose no bit when they are added.
        shares = np.array([0.25, 0.25, 0.5], dtype=np.float32)
        numbers = np.concatenate([self.force, self.moment.reshape(*shape, 9), self.camera], -1)
        self.drawn.forces = wp.array(numbers[:, :, None] * shares[:, None], dtype=float, device=device)

    def launch(self) -> None:
        pass


def test_terms_and_gradient_are_those_of_autograd(device):
    body = walker(device)
    _, gradient = check_both_paths(energy_of(body), moved_bodies(body, 5, amount=0.3), 1e-6, 1e-5)
    assert (gradient["rotations"][:, :2] == 0).all()  # the hips are locked
    assert all(tensor.abs().max() > 0 for tensor in gradient.values())


def test_energy_loss_agrees_with_autograd_for_an_optimiser_of_ones_own(device):
    """Torch computes it first, then a graph: for an optimiser of one's own, with a factor for each body."""
    body = walker(device)
    seen = energy_of(body, labels=True)
    for energy in (seen, replace(seen, renderer=RendererMesh(0))):  # which no graph draws
        for amount in (0.1, 0.2, 0.3):
            leaves = moved_bodies(body, 3, amount=amount).leaves()
            tensors = list(leaves.tensors().values())
            factors = torch.tensor([1.0, -2.0, 0.5], device=device)
            have, want = energy_loss(energy, leaves), torch.stack(list(energy(leaves).values())).sum(0)
            torch.testing.assert_close(have, want, rtol=1e-5, atol=1e-3)
            one, other = (torch.autograd.grad(each @ factors, tensors, retain_graph=True) for each in (have, want))
            for name, mine, torchs in zip(leaves.tensors(), one, other, strict=True):
                assert_same({name: mine}, {name: torchs}, 1e-4)
            assert not energy_loss(energy, leaves.detach()).requires_grad
    totals = [energy_loss(seen, leaves).square().sum() for _ in range(2)]
    (gradient,) = torch.autograd.grad(totals[1], leaves.shift, create_graph=True)
    with pytest.raises(NotImplementedError, match="energy_loss: differentiated twice"):
        torch.autograd.grad(gradient.sum(), leaves.shift)


def test_kernels_are_compiled_anew_when_a_rule_changes():
    """Warp's cache looks into every rule: its hash is part of the module's."""
    MODULE.get_module_hash()
    for hasher in MODULE.hashers.values():
        assert {function for _, function in RULES} <= hasher.function_hashes.keys()


def test_depth_is_held_as_in_torch(device):
    """Each body's depth is held to its own energy's, as hard as that is certain, and not at all if there is none."""
    body = walker(device)
    depths = body.posed().centres[0, :, 2]
    free = energy_of(body, weights=Weights(depth=0.01))
    even = torch.full_like(depths, 1e-3)
    sure = torch.linspace(5e-4, 5e-3, len(depths), device=device)
    held = [{"depths": depths + away, "depth_uncertainties": spread} for away, spread in ((0.0, even), (0.05, sure))]
    energies = [replace(free, observation=replace(free.observation, **each)) for each in held]
    both = replace(free, observation=Observations.of([each.observation for each in energies]))
    bodies = moved_bodies(body, 4, amount=0.3)
    terms, gradient = gradient_at(both, bodies)
    for number, energy in enumerate(energies):
        mine = slice(number, None, 2)
        want_terms, want = autograd_at(energy, bodies.select(torch.arange(4, device=device)[mine]))
        assert (want_terms["depth"] > 1.0).all()
        assert_same({name: term[mine] for name, term in terms.items()}, want_terms, 2e-6)
        assert_same({name: tensor[mine] for name, tensor in gradient.items()}, want, 1e-5)
    assert_same(gradient_at(free, bodies)[1], autograd_at(free, bodies)[1], 1e-5)


@pytest.mark.parametrize("gradient", ["edges", "partdr"])
def test_both_paths_agree_before_known_cameras(device, gradient):
    """Near and beside the axis, where perspective differs from weak perspective, also of each body's own camera."""
    body = walker(device)
    weights = Weights(depth=0.01, seg=1.0)
    plain = energy_of(body, labels=True, weights=weights, renderer=RendererEllipsoids(gradient))
    plain = replace(plain, observation=replace(plain.observation, depths=body.posed().centres[0, :, 2]))
    lenses = torch.tensor([[2.5, 1.5, -0.7], [6.0, 0.1, 0.2]], device=device)
    energies = [replace(plain, observation=replace(plain.observation, lens=lens)) for lens in lenses]
    bodies = moved_bodies(body, 4, amount=0.3)
    both = replace(plain, observation=Observations.of([each.observation for each in energies]))
    terms, gradients = gradient_at(both, bodies)
    for number, energy in enumerate(energies):
        mine = slice(number, None, 2)
        want_terms, want = autograd_at(energy, bodies.select(torch.arange(4, device=device)[mine]))
        assert_same({name: term[mine] for name, term in terms.items()}, want_terms, 5e-6)
        assert_same({name: tensor[mine] for name, tensor in gradients.items()}, want, 5e-5)
        weak, _ = autograd_at(plain, bodies.select(torch.arange(4, device=device)[mine]))
        assert (want_terms["proj"] - weak["proj"]).abs().min() > 1e-2


def test_a_camera_far_away_is_a_weak_one(device):
    body = walker(device)
    bodies = moved_bodies(body, 3, amount=0.3)
    for labels in (False, True):
        plain = energy_of(body, labels=labels)
        far = replace(plain, observation=replace(plain.observation, lens=torch.tensor([3e3, 0.3, -0.2], device=device)))
        (terms, gradient), (want_terms, want) = gradient_at(far, bodies), gradient_at(plain, bodies)
        assert_same(terms, want_terms, 5e-3)
        if not labels:  # a pixel that changes its part would change that of labels
            assert_same(gradient, want, 5e-3)


@pytest.mark.parametrize("fmt", ["h36m17", "mpii16", "blazepose33"])
def test_both_paths_agree_on_each_format_of_keypoints(device, fmt):
    body = walker(device)
    energy = Energy(unsure_observation(body, fmt), weights=Weights(length=0.0, thickness=0.0))
    check_both_paths(energy, moved_bodies(body, 3), 1e-6, 1e-5)


def test_given_forces_reach_every_parameter(device, monkeypatch):
    """Forces in any direction, moments and camera forces, as a renderer may send them."""
    body = walker(device)
    alone = Weights(proj=0.0, seg=1.0, length=0.0, thickness=0.0, prior=0.0, limits=0.0)
    energy = energy_of(body, labels=True, weights=alone)
    bodies = moved_bodies(body, 4, amount=0.5)
    made = []

    def make(*arguments):
        made.append(FixedForces(*arguments))
        return made[0]

    monkeypatch.setattr("warp_partdr.solve.ellipsoids.captured.CapturedEllipsoids", make)
    terms, gradient = gradient_at(energy, bodies)
    force, moment, camera = (torch.from_numpy(a).to(device) for a in (made[0].force, made[0].moment, made[0].camera))

    def linear(leaves):
        posed = leaves.posed()
        value = (force * posed.centres).sum((1, 2))
        value = value + (moment * posed.axes * posed.semi_axes[:, :, None]).sum((1, 2, 3))
        value = value + (camera * leaves.camera(SIZE).intrinsics[:, None]).sum((1, 2))
        return {"seg": (256 / SIZE) ** 2 * value}

    assert_same(gradient, autograd_at(linear, bodies)[1], 1e-5)
    torch.testing.assert_close(terms["seg"], torch.full((4,), 7 * (256 / SIZE) ** 2, device=device))


def test_a_body_whose_forces_are_nan_does_not_end_at_its_bounds(device, monkeypatch):
    """Its parameters are NaN from the first step on, its best ones where it started; the others go on."""
    body = walker(device)
    energy = energy_of(body, labels=True, weights=Weights(seg=1.0))
    start = moved_bodies(body, 3)

    def make(*arguments):
        made = FixedForces(*arguments)
        wp.to_torch(made.drawn.forces)[1] = math.nan
        return made

    monkeypatch.setattr("warp_partdr.solve.ellipsoids.captured.CapturedEllipsoids", make)
    captured = CapturedRefinement(energy, 3, iterations=3)
    refined = captured.refine(start)
    last = _split(captured._parameters)
    for name, tensor in last.items():
        assert tensor.reshape(3, -1).isfinite().all(1).tolist() == [True, False, True], name
    assert last["lengths"][1].isnan().all()
    assert refined.history[1:, 1].isnan().all()
    assert refined.energy.isfinite().all()
    torch.testing.assert_close(refined.parameters.shift[1], start.shift[1])


@pytest.mark.parametrize("gradient", ["coverage", "partdr"])
def test_labels_cost_and_pull_as_in_torch(device, gradient):
    body = walker(device)
    energy = energy_of(body, labels=True, weights=Weights(seg=0.5), renderer=RendererEllipsoids(gradient, 9.0))
    check_both_paths(energy, moved_bodies(body, 3), 1e-6, 1e-4)


@pytest.mark.parametrize("angle", [0.0, 1e-5, 1e-3, 0.49, 0.51, math.pi - 1e-4, math.pi, 6.5])
def test_both_paths_agree_on_rotations_of_any_size(device, angle):
    body = walker(device)
    axes = torch.nn.functional.normalize(noise(np.random.default_rng(0), body.rotations, 1), dim=-1)
    check_both_paths(energy_of(body), replace(moved_bodies(body, 1), rotations=angle * axes), 1e-5, 2e-5)


@pytest.mark.parametrize(
    "columns",
    [
        [0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        [1.0, 2.0, 3.0, 2.0, 4.0, 6.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.3, 0.0, 0.0, 1.0, 0.0, 0.0],
        [3e-15, 1e-15, 0.0, 1e15, -1e15, 1e15],
        [1.0, -2.0, 0.5, 1.0, -2.0, 0.6],
    ],
)
def test_both_paths_agree_on_orientations_of_any_columns(device, columns):
    body = walker(device)
    bodies = replace(moved_bodies(body, 1), orientation=torch.tensor([columns], device=device))
    (terms, gradient), (want_terms, want) = (path(energy_of(body), bodies) for path in (gradient_at, autograd_at))
    assert_same(terms, want_terms, 1e-4)
    assert all(torch.isfinite(tensor).all() for tensor in gradient.values())
    if max(map(abs, columns)) < 1e3 and any(columns[:3]) and columns[1]:  # elsewhere columns are replaced or infinite
        torch.testing.assert_close(gradient["orientation"], want["orientation"], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("iterations", [0, 1, 10, 50])
def test_a_run_ends_where_autograd_does(device, iterations):
    """Without labels, whose pixels flip with the last bit.

    A keypoint's L1 distance flips too, where rounding puts it on the other side of its target: in some 1 of 20 runs of
    50 iterations a body goes another way for a while. So most bodies are held to rounding and all to a loose bound.
    """
    body = walker(device)
    energy, start = energy_of(body), moved_bodies(body, 8)
    want = refine_by_autograd(start, energy, iterations=iterations, learning_rate=0.02)
    steps: list[int] = []
    captured = CapturedRefinement(energy, 8, iterations=iterations, learning_rate=0.02)
    have = captured.refine(start, on_iteration=steps.append)
    assert steps == list(range(1, iterations + 1))
    for name, tensor in want.parameters.tensors().items():
        error = (have.parameters.tensors()[name] - tensor).abs().reshape(8, -1).amax(1).sort().values
        assert error[5] <= 2e-5, name
        assert error[7] <= 2e-2, name
    assert have.history.shape == want.history.shape == (iterations, 8)
    assert have.terms.keys() == want.terms.keys()
    torch.testing.assert_close(have.history, want.history, rtol=0.03, atol=1e-3)
    torch.testing.assert_close(have.energy, want.energy, rtol=0.03, atol=1e-3)
    torch.testing.assert_close(sum(have.terms.values()), have.energy)


def test_further_iterations_leave_bodies_where_they_are(device):
    """They repeat the last one, and write nothing beyond the history."""
    body = walker(device)
    captured = CapturedRefinement(energy_of(body, labels=True), 2, iterations=3)
    want = captured.refine(moved_bodies(body, 2))
    parameters, history = captured._parameters.clone(), captured._history.clone()
    wp.synchronize_device(device)
    for _ in range(5):
        captured.iterate()
    wp.synchronize_device(device)
    assert torch.equal(captured._parameters, parameters)
    assert torch.equal(captured._history, history)
    assert torch.equal(captured.refine(moved_bodies(body, 2)).history, want.history)


def test_two_threads_give_what_one_gives():
    """Replays on the CPU device share nothing; a tile there would."""
    body = walker()
    energy, start = energy_of(body), moved_bodies(body, 16)
    captured = [CapturedRefinement(energy, 16) for _ in range(2)]
    want = captured[0].refine(start).history
    with ThreadPoolExecutor(2) as pool:
        for _ in range(5):
            for have in pool.map(lambda one: one.refine(start).history, captured):
                assert torch.equal(have, want)


def test_bodies_do_not_influence_one_another(device):
    """Not even one that is not a number; and each sees its own observation."""
    body = walker(device)
    other = moved_bodies(body, 1, seed=7)
    energies = [energy_of(body, labels=True), energy_of(other, labels=True)]
    energies[1].prior = energies[0].prior
    start = moved_bodies(body, 4)
    start.shift[2] = math.nan
    both = replace(energies[0], observation=Observations.of([each.observation for each in energies]))
    together = CapturedRefinement(both, 4, iterations=20).refine(start)
    for b in (0, 1, 3):
        alone = CapturedRefinement(energies[b % 2], 1, iterations=20)
        member = alone.refine(start.select(torch.tensor([b], device=device)))
        assert torch.equal(together.history[:, b], member.history[:, 0])
        for name, tensor in member.parameters.tensors().items():
            assert torch.equal(together.parameters.tensors()[name][b : b + 1], tensor), (b, name)
    assert together.energy[2].isnan()


def test_buffers_serve_again(device):
    """And a run repeats bit for bit."""
    body = walker(device)
    energy, first, second = energy_of(body, labels=True), moved_bodies(body, 2), moved_bodies(body, 2, seed=5)
    captured = CapturedRefinement(energy, 2, iterations=10)
    before = captured.refine(first)
    kept = before.history.clone()
    fresh, again = CapturedRefinement(energy, 2, iterations=10).refine(second), captured.refine(second)
    for name, tensor in {"history": fresh.history, **fresh.parameters.tensors()}.items():
        assert torch.equal({"history": again.history, **again.parameters.tensors()}[name], tensor), name
    assert torch.equal(before.history, kept)  # results are copies
    assert torch.equal(captured.refine(first).history, kept)


def test_an_empty_batch_is_refined(device):
    have = CapturedRefinement(energy_of(walker(device)), 0).refine(BodyParameters.mean(0, device=device))
    assert have.energy.shape == (0,)
    assert have.history.shape == (50, 0)


def test_bad_calls_name_the_argument(device):
    body = walker(device)
    energy = energy_of(body)
    captured, together = CapturedRefinement(energy, 2), partial(CapturedRefinement, batch_size=2)
    seen = unsure_observation(body, labels=LABELS)
    double = BodyParameters(**{name: tensor.double() for name, tensor in moved_bodies(body, 2).tensors().items()})
    soft = replace(seen, maps=torch.zeros(14, SIZE, SIZE), known=torch.ones(SIZE, SIZE))
    mesh = energy_of(body, labels=True, renderer=RendererMesh())
    for call, given, message in (
        (captured.refine, body, "shape"),
        (captured.refine, double, "float64"),
        (together, mesh, r"RendererMesh.*expected exact ellipsoids"),
        (together, Energy(soft), "probabilities"),
    ):
        with pytest.raises(ValueError, match=message):
            call(given)


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
