"""Calls take a captured graph: the same answers, and nothing left over from the call before."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import torch
from helpers.pictures import draw_on_screen
from helpers.renderers import RENDERERS, Scene

from warp_partdr.interop import graph_cache
from warp_partdr.interop.graph_cache import graphs, set_graph_memory
from warp_partdr.interop.loss_graph import LossGraph
from warp_partdr.kernels.launch import set_num_threads
from warp_partdr.render.mesh import PartImage


def answer(scene: Scene, renderer: str) -> list[torch.Tensor]:
    """Loss, images and gradients."""
    leaves = scene.leaves(renderer)
    loss, image = scene.loss(renderer, leaves)
    grads = torch.autograd.grad(loss.sum(), leaves)
    nearest = image.face_index if isinstance(image, PartImage) else image.parts
    return [loss.detach(), image.labels, image.depth, nearest, *grads]


def maps_gradient(scene: Scene, renderer: str) -> list[torch.Tensor]:
    """Gradients through maps."""
    leaves = scene.leaves(renderer)
    return list(torch.autograd.grad(scene.draw(renderer, leaves, num_maps=20).maps.square().sum(), leaves))


def equal(have: list[torch.Tensor], want: list[torch.Tensor]) -> bool:
    """They agree to the bit."""
    return all(torch.equal(a, b) for a, b in zip(have, want, strict=True))


@pytest.fixture(autouse=True)
def budget():
    """The default one, and no graphs of other tests."""
    set_graph_memory(0)
    set_graph_memory(None)
    yield
    set_graph_memory(None)


def loss_graphs() -> list[Any]:
    """Graphs of losses that are kept, the least recently used one first, with their sizes."""
    return [kept for kept in graphs._kept.values() if isinstance(kept.graph, LossGraph)]


@pytest.mark.parametrize("batch", [1, 3])
@pytest.mark.parametrize("renderer", RENDERERS)
def test_graph_and_launches_agree(device, renderer, batch):
    scenes = [Scene.make(seed, device, batch) for seed in range(4)]
    with_graph = [answer(scene, renderer) for scene in scenes][1:]  # the third and fourth in the second one's buffers
    assert len(loss_graphs()) == 1
    set_graph_memory(0)
    want = [answer(scene, renderer) for scene in scenes][1:]
    assert not loss_graphs()
    assert not torch.equal(with_graph[0][0], with_graph[1][0])
    assert all(equal(a, b) for a, b in zip(with_graph, want, strict=True))


@pytest.mark.parametrize("renderer", RENDERERS)
def test_threads_change_no_bit(renderer):
    """It holds through labels, and through maps."""
    scene = Scene.make(4, "cpu", batch=14)
    try:
        set_num_threads(1)
        want = answer(scene, renderer) + maps_gradient(scene, renderer)
        for count in (2, 3, 7):
            set_num_threads(count)
            assert equal(answer(scene, renderer) + maps_gradient(scene, renderer), want)
    finally:
        set_num_threads(0)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_each_thread_has_buffers_of_its_own(renderer):
    scenes = [Scene.make(seed, "cpu") for seed in range(2)]
    want = [answer(scene, renderer) for scene in scenes]
    with ThreadPoolExecutor(2) as pool:
        for _ in range(20):
            both = pool.map(lambda scene: answer(scene, renderer), scenes)
            assert all(equal(have, expected) for have, expected in zip(both, want, strict=True))


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
    want = answer(scene, renderer)
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
    assert torch.equal(leaves[0].grad, want[4])
    with pytest.raises(AttributeError, match="no attribute 'alpha'"):
        image.alpha  # noqa: B018


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_target_that_changes_in_place_changes_the_loss(renderer):
    scene = Scene.make(7, "cpu")
    pixels = scene.target.numpy()  # whose writes torch does not count
    before = answer(scene, renderer)
    kept = pixels.copy()
    pixels[:] = 0
    empty = answer(scene, renderer)
    pixels[:] = kept
    assert empty[0] != before[0]
    assert equal(answer(scene, renderer), before)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_losses_without_a_gradient_are_the_same(device, renderer):
    scene = Scene.make(0, device)
    want = answer(scene, renderer)
    for _ in range(3):
        with torch.no_grad():
            loss, image = scene.loss(renderer, scene.leaves(renderer))
        assert loss == want[0]
        assert not loss.requires_grad
        assert torch.equal(image.labels, want[1])


@pytest.mark.parametrize("renderer", RENDERERS)
def test_pictures_are_captured_labels_until_more_is_wanted(device, renderer):
    scenes = [Scene.make(seed, device) for seed in range(4)]
    leaves = [scene.leaves(renderer) for scene in scenes]
    set_graph_memory(0)
    whole = [scene.draw(renderer, each) for scene, each in zip(scenes, leaves, strict=True)]
    set_graph_memory(None)
    drawn = [scene.draw(renderer, each) for scene, each in zip(scenes, leaves, strict=True)]
    assert not any("depth" in vars(image) for image in drawn)
    for have, want in zip(drawn, whole, strict=True):
        assert torch.equal(have.labels, want.labels)
        assert torch.equal(have.depth, want.depth)  # drawn now
    assert "depth" in vars(scenes[0].draw(renderer, leaves[0]))  # from now on at once


def test_many_vertices_are_not_copied_for_a_few_pixels(device):
    scene = Scene.make(0, device, batch=2)
    (points,) = scene.leaves("mesh")
    many = torch.cat([points, torch.zeros(2, 2**18, 3, device=device)], dim=1)  # beyond those of the mesh
    for _ in range(3):
        assert "depth" in vars(draw_on_screen(many, scene.mesh, (48, 40)))


def test_the_least_recently_used_graphs_go_first(device):
    def call(width: int) -> list[int]:
        scene = Scene.make(0, device, size=(240, width))
        for _ in range(2):
            leaves = scene.leaves("coverage")
            scene.loss("coverage", leaves)
        return [kept.graph._buffers.target.shape[-1] for kept in loss_graphs()]

    assert call(320) == [320]
    size = loss_graphs()[0].size
    assert size > 240 * 320
    set_graph_memory(int(2.7 * size))
    assert call(321) == [320, 321]
    call(320)  # used again
    assert call(322) == [320, 322]
    assert graphs.num_bytes(torch.device(device, 0) if device == "cuda" else torch.device(device)) <= 2.7 * size
    set_graph_memory(size // 2)  # room for none
    assert call(320) == []
    set_graph_memory(2 * size)
    assert call(320) == [320]  # it is tried again
    with pytest.raises(ValueError, match="num_bytes: -1"):
        set_graph_memory(-1)


def test_a_single_call_is_not_captured(device):
    scene = Scene.make(0, device)
    answer(scene, "coverage")
    assert not loss_graphs()


def test_few_keys_are_remembered():
    """Pictures of ever new sizes are never captured, and are forgotten, too."""
    device = torch.device("cpu")
    for number in range(2000):
        assert graphs.find(("some", number), device, 10, lambda: pytest.fail("captured")) is None
    assert 100 < len(graphs) <= 513
    assert graphs.find(("some", 1999), device, 10, lambda: "graph") == "graph"


def test_graphs_are_freed_where_memory_is_out(monkeypatch):
    """Kept graphs go, and the call that found no memory is made again."""
    scene = Scene.make(1, "cpu")
    want = answer(scene, "edges")
    answer(scene, "edges")
    capture, calls = graph_cache.capture_graph, []

    def fail_once(*arguments):
        calls.append(len(loss_graphs()))
        if len(calls) == 1:
            raise torch.OutOfMemoryError
        return capture(*arguments)

    monkeypatch.setattr(graph_cache, "capture_graph", fail_once)
    other = Scene.make(1, "cpu", batch=2)
    answer(other, "edges")
    answer(other, "edges")
    assert len(calls) >= 2
    assert calls[:2] == [1, 0]
    assert torch.equal(answer(scene, "edges")[0], want[0])


def test_a_capture_that_fails_leaves_nothing(monkeypatch):
    scene = Scene.make(8, "cpu", size=(17, 19))
    capture = graph_cache.capture_graph
    want = answer(scene, "coverage")

    def fail(launch, device):
        def launch_and_fail():
            launch()
            raise RuntimeError("no more")

        return capture(launch_and_fail, device)

    with monkeypatch.context() as patch:
        patch.setattr(graph_cache, "capture_graph", fail)
        with pytest.raises(RuntimeError, match="no more"):
            answer(scene, "coverage")
    assert not loss_graphs()
    assert equal(answer(scene, "coverage"), want)
