"""The renderer under torch.compile: registered custom ops, the same numbers as eager code."""

import pytest
import torch
from test_render import body_scene, noisy_target

from warp_partdr.render import label_loss, rasterize_parts


def scene(device):
    vertices, mesh = body_scene(6, (24, 20), device, subdivisions=0, batch=2)
    leaf = torch.from_numpy(vertices).to(device).requires_grad_()
    return leaf, mesh, noisy_target(rasterize_parts(leaf, mesh, (24, 20)).labels, 20, 3)


def test_opcheck(device):
    leaf, mesh, target = scene(device)
    arrays = (leaf, mesh.faces, mesh.face_labels, mesh.edges)
    weights = torch.ones(256, device=device)
    # float atomics may differ in the last bits between two runs on CUDA
    torch.library.opcheck(
        torch.ops.warp_partdr.part_maps.default,
        (*arrays, 20, 24, 20, 0.01, True, False, True, float("inf"), 1.0),
        atol=1e-3,
        rtol=1e-4,
    )
    torch.library.opcheck(
        torch.ops.warp_partdr.label_loss.default,
        (*arrays, target, weights, 20, 0.01, True, False, True, float("inf"), 1.0),
        atol=1e-3,
        rtol=1e-4,
    )


@pytest.mark.parametrize("path", ["labels", "maps"])
def test_fullgraph_gives_eager_numbers(device, path):
    leaf, mesh, target = scene(device)

    def loss_of(vertices):
        moved = vertices * 1.01
        if path == "labels":
            return label_loss(moved, mesh, target)[0].sum()
        return (rasterize_parts(moved, mesh, (24, 20), num_maps=20).maps * 0.5).square().sum()

    eager = loss_of(leaf)
    (want,) = torch.autograd.grad(eager, leaf)
    compiled = torch.compile(loss_of, fullgraph=True, backend="aot_eager")(leaf)
    (have,) = torch.autograd.grad(compiled, leaf)
    torch.testing.assert_close(compiled, eager)
    torch.testing.assert_close(have, want, rtol=1e-4, atol=1e-3)


def test_eager_takes_the_function():
    leaf, mesh, target = scene("cpu")
    loss, _ = label_loss(leaf, mesh, target)
    assert "LabelLoss" in type(loss.grad_fn).__name__
