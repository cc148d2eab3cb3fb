"""Small batches take a captured graph: the same answers, and nothing left over from the call before."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

import pytest
import torch
from scenes.pictures import draw_on_screen, loss_on_screen

from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.posing import Posed, pose
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.cameras import WeakPerspective
from warp_partdr.interop import loss_graph
from warp_partdr.kernels.launch import set_num_threads
from warp_partdr.render.ellipsoids import EllipsoidImage, Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import PartImage
from warp_partdr.render.part_mesh import PartMesh, ellipbody_mesh

SIZE = (48, 40)
RENDERERS = ["coverage", "edges", "partdr", "mesh"]


@dataclass
class Scene:
    """Posed bodies, a camera, and the labels of other poses."""

    posed: Posed
    camera: WeakPerspective
    target: torch.Tensor

    @classmethod
    def make(cls, seed: int, device: str, batch: int = 1, size: tuple[int, int] = SIZE) -> Scene:
        generator = torch.Generator().manual_seed(seed)
        shape = EllipBody.mean(batch, device=device).torch()
        middle = torch.tensor([[20.0, 22.0]], device=device).expand(batch, 2)
        camera = WeakPerspective(torch.full((batch,), 20.0, device=device), middle)
        facing = torch.diag(torch.tensor([1.0, -1.0, -1.0])).to(device).expand(batch, 3, 3)

        def posed() -> Posed:
            turns = rotation_from_axis_angle(0.3 * torch.randn(batch, 20, 3, generator=generator)).to(device)
            still = torch.zeros(batch, 3, device=device)
            return pose(facing.contiguous(), still, turns, shape["lengths"], shape["thicknesses"])

        return cls(posed(), camera, draw_ellipsoids(posed(), camera, size).labels)

    def leaves(self, renderer: str) -> list[torch.Tensor]:
        """What a renderer's gradient is with respect to."""
        if renderer == "mesh":
            tensors = [self.camera.project(self.posed.vertices(1))]
        else:
            tensors = [self.posed.centres, self.posed.axes, self.posed.semi_axes]
        return [tensor.detach().clone().requires_grad_() for tensor in tensors]

    def loss(
        self, renderer: str, leaves: list[torch.Tensor], **options: object
    ) -> tuple[torch.Tensor, EllipsoidImage | PartImage]:
        """L_seg and the picture."""
        if renderer == "mesh":
            return loss_on_screen(leaves[0], ellipbody_mesh_on(str(self.target.device)), self.target, **options)
        return ellipsoid_label_loss(Ellipsoids(*leaves), self.camera, self.target, gradient=renderer, **options)

    def maps_gradient(self, renderer: str) -> list[torch.Tensor]:
        """Gradients through maps."""
        leaves = self.leaves(renderer)
        if renderer == "mesh":
            image = draw_on_screen(leaves[0], ellipbody_mesh_on(str(self.target.device)), SIZE, num_maps=20)
        else:
            image = draw_ellipsoids(Ellipsoids(*leaves), self.camera, SIZE, num_maps=20, gradient=renderer)
        return list(torch.autograd.grad(image.maps.square().sum(), leaves))

    def answer(self, renderer: str, **options: object) -> list[torch.Tensor]:
        """Loss, images and gradients."""
        leaves = self.leaves(renderer)
        loss, image = self.loss(renderer, leaves, **options)
        grads = torch.autograd.grad(loss.sum(), leaves)
        nearest = image.face_index if isinstance(image, PartImage) else image.parts
        return [loss.detach(), image.labels, image.depth, nearest, *grads]


@cache  # one mesh for all tests, for graphs are kept by it
def ellipbody_mesh_on(device: str) -> PartMesh:
    return ellipbody_mesh(1, device=device)


def equal(have: list[torch.Tensor], want: list[torch.Tensor], renderer: str) -> bool:
    """To the bit, but for the mesh's gradient on CUDA, which float atomics add up in any order."""
    if renderer == "mesh" and have[0].is_cuda:
        torch.testing.assert_close(have.pop(), want.pop(), rtol=1e-4, atol=1e-3)
    return all(torch.equal(a, b) for a, b in zip(have, want, strict=True))


@pytest.fixture
def launched(monkeypatch) -> Callable[[], None]:
    """Call it to have no graphs from then on."""
    return lambda: monkeypatch.setattr(loss_graph, "_SMALL_PIXELS", 0)


@pytest.mark.parametrize("batch", [1, 3])
@pytest.mark.parametrize("renderer", RENDERERS)
def test_graph_and_launches_agree(device, renderer, batch, launched):
    scenes = [Scene.make(seed, device, batch) for seed in range(3)]
    with_graph = [scene.answer(renderer) for scene in scenes]  # the second and third in the buffers of the first
    launched()
    want = [scene.answer(renderer) for scene in scenes]
    assert not torch.equal(with_graph[0][0], with_graph[1][0])
    assert all(equal(a, b, renderer) for a, b in zip(with_graph, want, strict=True))


@pytest.mark.parametrize("renderer", RENDERERS)
def test_threads_change_no_bit(renderer):
    """Through labels, and through maps."""
    scene = Scene.make(4, "cpu", batch=14)
    try:
        set_num_threads(1)
        want = scene.answer(renderer) + scene.maps_gradient(renderer)
        for count in (2, 3, 7):
            set_num_threads(count)
            assert equal(scene.answer(renderer) + scene.maps_gradient(renderer), want, renderer)
    finally:
        set_num_threads(0)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_each_thread_has_buffers_of_its_own(renderer):
    scenes = [Scene.make(seed, "cpu") for seed in range(2)]
    want = [scene.answer(renderer) for scene in scenes]
    with ThreadPoolExecutor(2) as pool:
        for _ in range(20):
            both = pool.map(lambda scene: scene.answer(renderer), scenes)
            assert all(equal(have, expected, renderer) for have, expected in zip(both, want, strict=True))


@pytest.mark.parametrize("renderer", RENDERERS)
def test_factors_of_losses_scale_the_gradients(device, renderer):
    scene = Scene.make(5, device, batch=2)
    leaves = scene.leaves(renderer)
    loss, _ = scene.loss(renderer, leaves)
    factors = torch.tensor([2.0, -0.5], device=device)
    plain = torch.autograd.grad(loss.sum(), leaves, retain_graph=True)
    loss.backward(factors)
    for leaf, gradient in zip(leaves, plain, strict=True):
        assert torch.equal(leaf.grad, gradient * factors.view(-1, *[1] * (leaf.dim() - 1)))


@pytest.mark.parametrize("renderer", RENDERERS)
def test_the_picture_is_that_of_the_call(device, renderer):
    scene = Scene.make(6, device)
    want = scene.answer(renderer)
    leaves = scene.leaves(renderer)
    loss, image = scene.loss(renderer, leaves)
    with torch.no_grad():
        for leaf in leaves:
            leaf.add_(1e-3 if leaf.shape[-2:] == (3, 3) else 0.2)  # a step, before anybody looked; axes stay such
    scene.loss(renderer, leaves)
    assert torch.equal(image.labels, want[1])
    assert torch.equal(image.depth, want[2])
    image.labels.zero_()
    assert not image.labels.any()  # it is drawn once
    loss.sum().backward()
    assert torch.equal(leaves[0].grad, want[4]) or leaves[0].is_cuda
    with pytest.raises(AttributeError, match="no attribute 'alpha'"):
        image.alpha  # noqa: B018


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_target_that_changes_in_place(renderer):
    scene = Scene.make(7, "cpu")
    pixels = scene.target.numpy()  # whose writes torch does not count
    before = scene.answer(renderer)
    kept = pixels.copy()
    pixels[:] = 0
    empty = scene.answer(renderer)
    pixels[:] = kept
    assert empty[0] != before[0]
    assert equal(scene.answer(renderer), before, renderer)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_what_needs_no_gradient_takes_no_graph(renderer, monkeypatch):
    def refuse(*_):
        raise AssertionError("made a graph")

    scene = Scene.make(0, "cpu")
    want = scene.answer(renderer)
    monkeypatch.setattr(loss_graph, "_graph", refuse)
    with torch.no_grad():
        loss, image = scene.loss(renderer, scene.leaves(renderer))
    assert loss == want[0]
    assert not loss.requires_grad
    assert torch.equal(image.labels, want[1])


def test_few_graphs_are_kept():
    for width in range(20, 32):
        Scene.make(0, "cpu", size=(24, width)).answer("coverage")
    assert loss_graph._cached_graph.cache_info().currsize == 8


def test_a_capture_that_fails_leaves_nothing(monkeypatch):
    scene = Scene.make(8, "cpu", size=(17, 19))
    loss_graph._cached_graph.cache_clear()
    capture = loss_graph.capture_graph

    def fail(launch, device):
        def launch_and_fail():
            launch()
            raise RuntimeError("no more")

        return capture(launch_and_fail, device)

    with monkeypatch.context() as patch:
        patch.setattr(loss_graph, "capture_graph", fail)
        with pytest.raises(RuntimeError, match="no more"):
            scene.answer("coverage")
    assert loss_graph._cached_graph.cache_info().currsize == 0
    have = scene.answer("coverage")
    monkeypatch.setattr(loss_graph, "_SMALL_PIXELS", 0)
    assert equal(have, scene.answer("coverage"), "coverage")
