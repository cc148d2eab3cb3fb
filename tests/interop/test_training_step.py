"""Steps of a training as one captured graph do what a loop does, and say what is wrong."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
import torch
from torch import nn

from warp_partdr import (
    BodyParameters,
    RendererEllipsoids,
    RendererMesh,
    TrainingStep,
    anny,
    detailed_mesh,
    ellipsoid_label_loss,
    mesh_label_loss,
    pose_from_ellipbody,
)
from warp_partdr.render.ellipsoids import draw_ellipsoids

SIZE = 48  # [px]

Function = Callable[..., torch.Tensor]


def eager(function: Function, optimizer: torch.optim.Optimizer, inputs: list[Any], **options: Any) -> list[float]:
    """Losses of the loop that a user would write."""
    scheduler, clip_norm = options.get("scheduler"), options.get("clip_norm")
    losses = []
    for each in inputs:
        optimizer.zero_grad()
        loss = function(*each)
        loss.backward()
        if clip_norm is not None:
            parameters = [parameter for group in optimizer.param_groups for parameter in group["params"]]
            nn.utils.clip_grad_norm_(parameters, clip_norm)
        optimizer.step()
        if scheduler is not None:
            scheduler.step()
        losses.append(loss.item())
    return losses


def stepped(function: Function, optimizer: torch.optim.Optimizer, inputs: list[Any], **options: Any) -> list[float]:
    """Losses of the same steps, none of which waits for the one before."""
    scheduler = options.pop("scheduler", None)
    step = TrainingStep(function, optimizer, **options)
    losses = []
    for each in inputs:
        losses.append(step(*each))
        if scheduler is not None:
            scheduler.step()
    step.check()
    return torch.stack(losses).tolist()


class Fit:
    """Fit of a small network to random numbers; equal arguments make equal ones."""

    def __init__(self, device: str, *, dropout: float = 0.0, seed: int = 0) -> None:
        torch.manual_seed(seed)
        self.network = nn.Sequential(nn.Linear(6, 32), nn.Tanh(), nn.Dropout(dropout), nn.Linear(32, 3)).to(device)
        self.device = device

    def loss(self, points: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
        return (self.network(points) - wanted).square().mean()

    def inputs(self, count: int, *, batches: tuple[int, ...] = (8,)) -> list[tuple[torch.Tensor, torch.Tensor]]:
        generator = torch.Generator().manual_seed(1)
        sizes = [batches[index % len(batches)] for index in range(count)]
        return [
            (
                torch.randn(size, 6, generator=generator).to(self.device),
                torch.randn(size, 3, generator=generator).to(self.device),
            )
            for size in sizes
        ]

    def adam(self, **options: Any) -> torch.optim.Adam:
        return torch.optim.Adam(self.network.parameters(), **({"lr": 0.01} | options))


def same_losses(
    device: str,
    make: Callable[[Fit], torch.optim.Optimizer] = Fit.adam,
    *,
    batches: tuple[int, ...] = (8,),
    **options: Any,
) -> list[float]:
    """Assert that a loop and steps end at the same parameters, by the same losses."""
    first, second = Fit(device), Fit(device)
    want = eager(first.loss, make(first), first.inputs(9, batches=batches), **options)
    have = stepped(second.loss, make(second), second.inputs(9, batches=batches), **options)
    assert have == pytest.approx(want, rel=1e-4)
    for one, other in zip(first.network.parameters(), second.network.parameters(), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)
    return have


def bodies_and_labels(device: str, batch: int, count: int) -> tuple[BodyParameters, list[tuple[torch.Tensor]]]:
    """Mean bodies, and label images of bent ones."""
    generator = torch.Generator().manual_seed(0)
    mean = BodyParameters.mean(batch, device=device)
    images = []
    for _ in range(count):
        bent = replace(mean, rotations=0.3 * torch.randn(mean.rotations.shape, generator=generator).to(device))
        images.append((draw_ellipsoids(bent.posed(), bent.camera(SIZE), (SIZE, SIZE)).labels,))
    return mean, images


def crop_function(renderer: RendererEllipsoids | RendererMesh, leaves: Any) -> Function:
    return lambda target: renderer.crop_loss(leaves.bodies(), target).mean()


def posed_function(renderer: RendererEllipsoids, leaves: Any) -> Function:
    def function(target: torch.Tensor) -> torch.Tensor:
        bodies = leaves.bodies()
        seen = bodies.posed(), bodies.camera(SIZE), target
        return ellipsoid_label_loss(*seen, gradient=renderer.gradient, validate=False)[0].mean()

    return function


def body_function(renderer: RendererEllipsoids | RendererMesh, leaves: Any) -> Function:
    def function(target: torch.Tensor) -> torch.Tensor:
        bodies = leaves.bodies()
        origin = torch.zeros_like(bodies.lengths[:, :3])
        parameters = bodies.orientation, origin, bodies.free_rotations(), bodies.lengths, bodies.thicknesses
        return renderer.body_loss(parameters, bodies.camera(SIZE), target, validate=False).mean()

    return function


def maps_function(renderer: RendererEllipsoids | RendererMesh, leaves: Any) -> Function:
    def function(target: torch.Tensor) -> torch.Tensor:
        bodies = leaves.bodies()
        image = renderer.draw(bodies.posed(), bodies.camera(SIZE), (SIZE, SIZE), num_maps=20, validate=False)
        numbers = torch.arange(1, 21, dtype=torch.uint8, device=target.device)
        return (image.maps - (target[:, None] == numbers[:, None, None]).float()).square().mean()

    return function


CALLS = {
    "crop_loss, edges": (crop_function, RendererEllipsoids("edges")),
    "crop_loss, coverage": (crop_function, RendererEllipsoids("coverage")),
    "crop_loss, PartDR": (crop_function, RendererEllipsoids("partdr")),
    "crop_loss, mesh": (crop_function, RendererMesh(1)),
    "posed, ellipsoid_label_loss": (posed_function, RendererEllipsoids("edges")),
    "body_loss": (body_function, RendererEllipsoids("edges")),
    "maps": (maps_function, RendererEllipsoids("edges")),
    "maps, mesh": (maps_function, RendererMesh(0)),
}


@pytest.mark.parametrize("call", CALLS)
def test_bodies_are_trained_as_by_a_loop(device, call):
    make, renderer = CALLS[call]
    mean, images = bodies_and_labels(device, 2, 2)
    losses = []
    for run in (eager, stepped):
        leaves = mean.leaves(log_sizes=True)
        optimizer = torch.optim.Adam(leaves.tensors().values(), lr=0.01)
        losses.append(run(make(renderer, leaves), optimizer, images * 4))
    want, have = losses
    # A mesh's forces are added in any order on CUDA.
    assert have == pytest.approx(want, rel=1e-3 if isinstance(renderer, RendererEllipsoids) else 2e-2)
    assert have[-1] < have[1]
    assert have[-2] < have[0]


def test_a_fused_optimiser_gets_gradients_laid_out_as_parameters(device):
    """Gradients of bodies are columns of one table."""
    mean, images = bodies_and_labels(device, 3, 1)
    losses = []
    for run in (eager, stepped):
        leaves = mean.leaves(log_sizes=True)
        optimizer = torch.optim.Adam(leaves.tensors().values(), lr=0.01, fused=True)
        losses.append(run(crop_function(RendererEllipsoids("edges"), leaves), optimizer, images * 4))
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)


def test_gradients_that_others_hold_stay_as_they_are(device):
    """Two parameters have the same gradient, and each is clipped once."""
    losses = []
    for run in (eager, stepped):
        one, other = (torch.zeros(3, device=device, requires_grad=True) for _ in range(2))

        def function(one: torch.Tensor = one, other: torch.Tensor = other) -> torch.Tensor:
            return (one + other - 1).square().sum()

        losses.append(run(function, torch.optim.SGD([one, other], lr=0.1), [()] * 5, clip_norm=0.5))
    assert losses[1] == pytest.approx(losses[0], rel=1e-4)


def test_a_detailed_body_is_trained_as_by_a_loop(device):
    model = anny(device)
    mesh, mean = detailed_mesh(model), BodyParameters.mean(1, device=device)
    shape = torch.zeros(1, model.num_shapes, device=device)
    rotations, place = pose_from_ellipbody(model, mean.posed(), shape)
    camera = mean.camera(SIZE)
    target = mesh_label_loss(
        model.pose(shape, rotations, place).vertices,
        mesh,
        camera,
        torch.zeros(1, SIZE, SIZE, dtype=torch.uint8).to(device),
    )[1].labels
    losses = []
    for run in (eager, stepped):
        move = torch.full((1, 3), 0.1, device=device, requires_grad=True)

        def function(image: torch.Tensor, move: torch.Tensor = move) -> torch.Tensor:
            vertices = model.pose(shape, rotations, place + move).vertices
            return mesh_label_loss(vertices, mesh, camera, image, validate=False)[0].sum()

        losses.append(run(function, torch.optim.Adam([move], lr=0.01), [(target,)] * 6))
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)
    assert losses[1][-1] < losses[1][0]


OPTIMIZERS: dict[str, Callable[[Fit], torch.optim.Optimizer]] = {
    "Adam": Fit.adam,
    "Adam, one by one": partial(Fit.adam, foreach=True),
    "Adam, rate as a tensor": lambda fit: fit.adam(lr=torch.tensor(0.01, device=fit.device), foreach=False),
    "AdamW": lambda fit: torch.optim.AdamW(fit.network.parameters(), lr=0.01, weight_decay=0.1),
    "SGD": lambda fit: torch.optim.SGD(fit.network.parameters(), lr=0.1, momentum=0.9),
    "RMSprop": lambda fit: torch.optim.RMSprop(fit.network.parameters(), lr=0.01),
    "groups": lambda fit: torch.optim.Adam(
        [{"params": [*fit.network[0].parameters()]}, {"params": [*fit.network[3].parameters()], "lr": 0.03}], lr=0.01
    ),
}


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_each_optimiser_steps_as_in_a_loop(device, name):
    same_losses(device, OPTIMIZERS[name])


def test_a_large_gradient_is_clipped(device):
    make = OPTIMIZERS["SGD"]  # Adam's steps don't depend on the gradient's length
    assert same_losses(device, make, clip_norm=0.05) != pytest.approx(same_losses(device, make), rel=1e-2)


def test_the_norm_is_that_before_clipping(device):
    fit = Fit(device)
    (inputs,) = fit.inputs(1)
    gradients = torch.autograd.grad(fit.loss(*inputs), [*fit.network.parameters()])
    step = TrainingStep(fit.loss, fit.adam(), clip_norm=1e-3)
    assert step.gradient_norm is None
    step(*inputs)
    want = torch.cat([each.flatten() for each in gradients]).norm()
    torch.testing.assert_close(step.gradient_norm, want)


@pytest.mark.parametrize("as_tensor", [False, True])
def test_a_scheduler_is_followed(device, as_tensor):
    losses = []
    for run in (eager, stepped):
        fit = Fit(device)
        rate = torch.tensor(0.01, device=device) if as_tensor else 0.01
        optimizer = fit.adam(lr=rate, foreach=False)
        scheduler = torch.optim.lr_scheduler.StepLR(optimizer, 3, gamma=0.1)
        losses.append(run(fit.loss, optimizer, fit.inputs(9), scheduler=scheduler))
        assert float(optimizer.param_groups[0]["lr"]) == pytest.approx(1e-5)
    assert losses[1] == pytest.approx(losses[0], rel=1e-4)
    assert losses[1] != pytest.approx(same_losses(device), rel=1e-3)


def test_shapes_may_take_turns(device):
    same_losses(device, batches=(8, 5, 8, 3))


def test_few_graphs_are_kept(device):
    fit = Fit(device)
    step = TrainingStep(fit.loss, fit.adam(), max_graphs=2)
    inputs = fit.inputs(9, batches=(8, 5))
    losses = [step(*each) for each in inputs]
    assert step.num_graphs == (0 if device == "cpu" else 2)
    again = Fit(device)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        one = stepped(again.loss, again.adam(), inputs, max_graphs=1)
    assert torch.stack(losses).tolist() == pytest.approx(one, rel=1e-4)


def test_shapes_without_end_give_a_warning(device):
    if device == "cpu":
        pytest.skip("nothing is captured on the CPU")
    fit = Fit(device)
    with pytest.warns(UserWarning, match="max_graphs = 1"):
        stepped(fit.loss, fit.adam(), fit.inputs(3, batches=(8, 5, 3)), max_graphs=1)


def test_random_numbers_are_new_in_each_step(device):
    """The loss is a random number, and its gradient changes nothing that the loss shows."""
    moved = torch.zeros((), device=device, requires_grad=True)
    own = torch.Generator(device).manual_seed(3)

    def function() -> torch.Tensor:
        return torch.rand((), device=device) + torch.rand((), device=device, generator=own) + 0 * moved

    losses = stepped(function, torch.optim.Adam([moved]), [()] * 8, generators=[own])
    assert len(set(losses)) == 8


def test_random_numbers_are_those_of_a_loop(device):
    losses = []
    for run in (eager, stepped):
        fit = Fit(device, dropout=0.5)
        torch.manual_seed(7)
        losses.append(run(fit.loss, fit.adam(), fit.inputs(8)))
    assert losses[1] == pytest.approx(losses[0], rel=1e-4)


def test_parts_of_a_batch_have_the_gradient_of_the_whole(device):
    fit, other = Fit(device), Fit(device)
    want = eager(fit.loss, fit.adam(), fit.inputs(5))
    assert stepped(other.loss, other.adam(), other.inputs(5), accumulation=4) == pytest.approx(want, rel=1e-4)


def test_bfloat16_is_as_in_a_loop(device):
    losses = []
    for run in (eager, stepped):
        fit = Fit(device)

        def function(*inputs: torch.Tensor, fit: Fit = fit) -> torch.Tensor:
            with torch.autocast(torch.device(device).type, dtype=torch.bfloat16):
                return fit.loss(*inputs)

        losses.append(run(function, fit.adam(), fit.inputs(6)))
    assert losses[1] == pytest.approx(losses[0], rel=1e-2)


def test_autocast_around_a_captured_step_is_an_error(device):
    fit = Fit(device)
    if device == "cpu":
        pytest.skip("nothing is captured on the CPU")
    with torch.autocast("cuda", dtype=torch.bfloat16), pytest.raises(ValueError, match="expected it in the function"):
        TrainingStep(fit.loss, fit.adam())(*fit.inputs(1)[0])


def test_inputs_may_come_from_the_cpu(device):
    fit, other = Fit(device), Fit(device)
    inputs = [tuple(tensor.cpu() for tensor in each) for each in fit.inputs(5)]
    want = eager(fit.loss, fit.adam(), fit.inputs(5))
    assert stepped(other.loss, other.adam(), inputs) == pytest.approx(want, rel=1e-4)


@pytest.mark.parametrize("guard", [torch.no_grad, torch.inference_mode])
def test_steps_need_no_gradients_around_them(device, guard):
    fit, other = Fit(device), Fit(device)
    want = eager(fit.loss, fit.adam(), fit.inputs(4))
    inputs = other.inputs(4)
    with guard():
        assert stepped(other.loss, other.adam(), inputs) == pytest.approx(want, rel=1e-4)


def test_a_loss_of_an_earlier_loop_may_still_be_there(device):
    fit = Fit(device)
    inputs = fit.inputs(4)
    optimizer, loss = fit.adam(), fit.loss(*inputs[0])
    loss.backward()
    stepped(fit.loss, optimizer, inputs)
    assert all(each.grad is None for each in fit.network.parameters())
    assert loss.grad_fn is not None


def changed(fit: Fit, run: str, change: Callable[[Fit, torch.optim.Optimizer], None]) -> list[float]:
    """Losses with a change after five of ten steps."""
    optimizer, inputs = fit.adam(weight_decay=0.0), fit.inputs(10)
    if run == "eager":
        losses = eager(fit.loss, optimizer, inputs[:5])
        change(fit, optimizer)
        return losses + eager(fit.loss, optimizer, inputs[5:])
    step = TrainingStep(fit.loss, optimizer)
    found = [step(*each) for each in inputs[:5]]
    change(fit, optimizer)
    found += [step(*each) for each in inputs[5:]]
    step.check()
    return torch.stack(found).tolist()


def set_decay(_: Fit, optimizer: torch.optim.Optimizer) -> None:
    optimizer.param_groups[0]["weight_decay"] = 0.5


def set_rate(_: Fit, optimizer: torch.optim.Optimizer) -> None:
    optimizer.param_groups[0]["lr"] = 0.1


def freeze(fit: Fit, _: torch.optim.Optimizer) -> None:
    fit.network[0].weight.requires_grad_(False)


def forget(_: Fit, optimizer: torch.optim.Optimizer) -> None:
    """Load a state of the optimiser, in which its moments are half of what they were."""
    state = copy.deepcopy(optimizer.state_dict())
    for each in state["state"].values():
        each["exp_avg"] *= 0.5
    optimizer.load_state_dict(state)


def replace_weights(fit: Fit, _: torch.optim.Optimizer) -> None:
    weight = fit.network[3].weight
    weight.data = 0.5 * weight.data


@pytest.mark.parametrize("change", [set_decay, set_rate, freeze, forget, replace_weights])
def test_what_changes_between_steps_is_followed(device, change):
    want, have = (changed(Fit(device), run, change) for run in ("eager", "stepped"))
    assert have == pytest.approx(want, rel=1e-4)
    assert have != pytest.approx(changed(Fit(device), "stepped", lambda *_: None), rel=1e-4)


@pytest.mark.parametrize("at", [0, 1, 3])
def test_a_loss_that_is_no_number_is_an_error_at_the_next_look(device, at):
    fit = Fit(device)
    step = TrainingStep(fit.loss, fit.adam())
    for index, (points, wanted) in enumerate(fit.inputs(at + 1)):
        step(points, wanted * math.nan if index == at else wanted)
    with pytest.raises(FloatingPointError, match=f"step {at + 1}: the loss is nan"):
        step.check()
    step.check()  # once is enough
    if device != "cpu":
        torch.cuda.synchronize()
    step(*fit.inputs(1)[0])  # all is NaN by now
    if device != "cpu":
        torch.cuda.synchronize()
    with pytest.raises(FloatingPointError, match=f"step {at + 2}"):
        step(*fit.inputs(1)[0])


def test_a_gradient_that_is_infinite_is_an_error(device):
    number = torch.zeros((), device=device, requires_grad=True)
    step = TrainingStep(lambda: number.sqrt(), torch.optim.Adam([number]))
    step()
    with pytest.raises(FloatingPointError, match="step 1: the loss is 0 and the norm of its gradient is inf"):
        step.check()


def wait_by_item(loss: torch.Tensor) -> torch.Tensor:
    return loss * (1 if loss.item() > 0 else 2)


def wait_by_copy(loss: torch.Tensor) -> torch.Tensor:
    return loss + loss.detach().cpu().to(loss.device)


@pytest.mark.parametrize("wait", [wait_by_item, wait_by_copy])
def test_a_step_that_waits_is_named(device, wait):
    if device == "cpu":
        pytest.skip("nothing is captured on the CPU")
    fit = Fit(device, dropout=0.1)
    inputs = fit.inputs(4)
    step = TrainingStep(lambda *each: wait(fit.loss(*each)), fit.adam())
    step(*inputs[0])
    before = [each.detach().clone() for each in fit.network.parameters()]
    with pytest.raises(RuntimeError, match=r"can't be captured.*validate=False"):
        step(*inputs[1])
    assert torch.cuda.current_stream() == torch.cuda.default_stream()
    assert all(map(torch.equal, before, fit.network.parameters()))  # nothing was done
    assert len(stepped(fit.loss, fit.adam(), inputs)) == 4  # and the process can go on
    assert len(stepped(lambda *each: wait(fit.loss(*each)), fit.adam(), inputs, captured=False)) == 4


def test_a_check_that_waits_is_named(device):
    if device == "cpu":
        pytest.skip("nothing is captured on the CPU")
    mean, images = bodies_and_labels(device, 2, 1)
    leaves = mean.leaves()
    step = TrainingStep(
        lambda target: ellipsoid_label_loss(leaves.posed(), leaves.camera(SIZE), target)[0].sum(),
        torch.optim.Adam(leaves.tensors().values(), lr=0.01),
    )
    step(*images[0])
    with pytest.raises(RuntimeError, match=r"can't be captured.*validate=False"):
        step(*images[0])


def test_an_optimiser_that_cannot_be_captured_is_refused(device):
    fit = Fit(device)
    optimizer = torch.optim.LBFGS(fit.network.parameters())
    if device == "cpu":
        TrainingStep(fit.loss, optimizer)
    else:
        with pytest.raises(TypeError, match=r"optimizer: LBFGS; expected one of torch.optim that is capturable"):
            TrainingStep(fit.loss, optimizer)


@pytest.mark.parametrize(
    ("function", "error", "words"),
    [
        (lambda fit, *each: 1.0, TypeError, "function: returned float"),
        (lambda fit, points, wanted: fit.network(points), ValueError, r"function: returned shape \(8, 3\)"),
        (lambda fit, *each: fit.loss(*each).detach(), ValueError, "without gradient"),
    ],
)
def test_a_loss_must_be_one_number_with_a_gradient(device, function, error, words):
    fit = Fit(device)
    with pytest.raises(error, match=words):
        TrainingStep(partial(function, fit), fit.adam())(*fit.inputs(1)[0])


def test_wrong_arguments_are_named():
    fit = Fit("cpu")
    (points, wanted), make = fit.inputs(1)[0], partial(TrainingStep, fit.loss, fit.adam())
    with pytest.raises(ValueError, match="clip_norm: 0; expected a positive number or None"):
        make(clip_norm=0)
    with pytest.raises(ValueError, match="accumulation: 0; expected an integer of 1 or more"):
        make(accumulation=0)
    with pytest.raises(ValueError, match="max_graphs: 0; expected an integer of 1 or more"):
        make(max_graphs=0)
    with pytest.raises(TypeError, match=r"optimizer: str; expected one of torch.optim"):
        TrainingStep(fit.loss, "adam")
    with pytest.raises(TypeError, match=r"inputs\[1\]: int; expected a torch.Tensor"):
        make()(points, 1)
    with pytest.raises(ValueError, match=r"inputs\[0\]: has a gradient"):
        make()(fit.network(points), wanted)
    with pytest.raises(
        ValueError, match=r"inputs\[0\]: shape \(8, 6\); expected a first dimension that accumulation = 3"
    ):
        make(accumulation=3)(points, wanted)


def test_hooks_that_a_step_would_leave_out_are_refused():
    fit = Fit("cpu")
    fit.network[0].weight.register_post_accumulate_grad_hook(lambda parameter: None)
    with pytest.raises(ValueError, match="a parameter has a hook"):
        TrainingStep(fit.loss, fit.adam())


def test_several_processes_are_refused(monkeypatch):
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: True)
    monkeypatch.setattr(torch.distributed, "get_world_size", lambda: 4)
    fit = Fit("cpu")
    with pytest.raises(RuntimeError, match="4 processes train together; expected one"):
        TrainingStep(fit.loss, fit.adam())


def test_accelerate_may_prepare_network_and_optimiser(device):
    accelerate = pytest.importorskip("accelerate")
    from accelerate.state import AcceleratorState, GradientState

    fit, other = Fit(device), Fit(device)
    want = eager(fit.loss, fit.adam(), fit.inputs(5))
    accelerator = accelerate.Accelerator(cpu=device == "cpu")
    try:
        optimizer = other.adam()
        schedule = torch.optim.lr_scheduler.ConstantLR(optimizer, factor=1.0)
        other.network, prepared, scheduler = accelerator.prepare(other.network, optimizer, schedule)
        assert stepped(other.loss, prepared, fit.inputs(5), scheduler=scheduler) == pytest.approx(want, rel=1e-4)
    finally:
        AcceleratorState._reset_state(reset_partial_state=True)
        GradientState._reset_state()


def test_a_scaler_of_float16_is_refused():
    fit = Fit("cpu")
    optimizer = fit.adam()
    optimizer.scaler = object()
    with pytest.raises(TypeError, match="optimizer: scales float16's gradients"):
        TrainingStep(fit.loss, optimizer)


def test_graphs_of_several_shapes_share_memory(device):
    """A second graph as large as the first one takes little more than the memory of its inputs."""
    if device == "cpu":
        pytest.skip("nothing is captured on the CPU")
    torch.manual_seed(0)
    weight = torch.ones(1, device=device, requires_grad=True)
    step = TrainingStep(lambda rows: (rows * weight).square().tanh().mean(), torch.optim.SGD([weight], lr=0.0))
    taken = []
    for width in (1 << 22, (1 << 22) - 512):
        rows = torch.ones(1, width, device=device)
        before = torch.cuda.memory_reserved()
        for _ in range(2):
            step(rows)
        taken.append(torch.cuda.memory_reserved() - before)
    assert step.num_graphs == 2
    assert taken[1] < 0.7 * taken[0]


def test_the_first_loss_stays_when_the_next_step_is_taken(device):
    """Results are copies: a graph fills the same memory again."""
    fit = Fit(device)
    step = TrainingStep(fit.loss, fit.adam())
    kept = [step(*each) for each in fit.inputs(4)]
    before = [float(each) for each in kept]
    step(*fit.inputs(1)[0])
    assert [float(each) for each in kept] == before
