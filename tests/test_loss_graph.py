"""Small batches take a captured graph: the same answers, and nothing left over from the call before."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

from warp_partdr import ellipsoids as module
from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.cameras import WeakPerspective
from warp_partdr.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.posing import pose

SIZE = (48, 40)


def scene(seed: int, device: str) -> tuple[Ellipsoids, WeakPerspective, torch.Tensor]:
    """A posed body that collects gradients, its camera, and the labels of another pose."""
    generator = torch.Generator().manual_seed(seed)
    shape = EllipBody.mean(1, device=device).torch()
    camera = WeakPerspective(torch.full((1,), 20.0, device=device), torch.tensor([[20.0, 22.0]], device=device))

    def posed():
        turns = rotation_from_axis_angle(0.3 * torch.randn(1, 20, 3, generator=generator)).to(device)
        facing = torch.diag(torch.tensor([1.0, -1.0, -1.0])).to(device)[None]
        return pose(facing, torch.zeros(1, 3, device=device), turns, shape["lengths"], shape["thicknesses"])

    body = posed()
    leaves = Ellipsoids(*(t.detach().requires_grad_() for t in (body.centres, body.axes, body.semi_axes)))
    return leaves, camera, draw_ellipsoids(posed(), camera, SIZE).labels


def answer(bodies: Ellipsoids, camera: WeakPerspective, target: torch.Tensor, gradient: str) -> list[torch.Tensor]:
    loss, image = ellipsoid_label_loss(bodies, camera, target, gradient=gradient)
    grads = torch.autograd.grad(loss.sum(), (bodies.centres, bodies.axes, bodies.semi_axes))
    return [loss.detach(), image.labels, image.depth, image.parts, *grads]


@pytest.mark.parametrize("gradient", ["coverage", "partdr"])
def test_graph_and_launches_agree(device, gradient, monkeypatch):
    scenes = [scene(seed, device) for seed in range(3)]
    with_graph = [answer(*one, gradient) for one in scenes]  # the second and third in the buffers of the first
    monkeypatch.setattr(module, "_is_small", lambda target, batch: False)
    launched = [answer(*one, gradient) for one in scenes]
    assert not torch.equal(with_graph[0][0], with_graph[1][0])
    for have, want in zip(with_graph, launched, strict=True):
        for a, b in zip(have, want, strict=True):
            assert torch.equal(a, b)


def test_each_thread_has_buffers_of_its_own():
    scenes = [scene(seed, "cpu") for seed in range(2)]
    want = [answer(*one, "partdr") for one in scenes]
    with ThreadPoolExecutor(2) as pool:
        for _ in range(20):
            both = pool.map(lambda one: answer(*one, "partdr"), scenes)
            for have, expected in zip(both, want, strict=True):
                assert all(torch.equal(a, b) for a, b in zip(have, expected, strict=True))


def test_what_needs_no_gradient_takes_no_graph(monkeypatch):
    def refuse(*_):
        raise AssertionError("made a graph")

    monkeypatch.setattr(module, "loss_graph", refuse)
    bodies, camera, target = scene(0, "cpu")
    with torch.no_grad():
        loss, _ = ellipsoid_label_loss(bodies, camera, target)
    assert loss.item() > 0
