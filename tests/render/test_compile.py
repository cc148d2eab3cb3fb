"""Renderers and body under torch.compile: traced whole at the first call, and the same numbers as eager code."""

from dataclasses import replace

import pytest
import torch
from helpers.renderers import RENDERERS, Scene

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import pose
from warp_partdr.cameras import WeakPerspective
from warp_partdr.render.mesh import mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh

INF = float("inf")


def new_scene(device):
    """Two bodies; of their mesh nothing has been asked yet."""
    scene = Scene.make(6, device, batch=2, size=(24, 20))
    return replace(scene, mesh=PartMesh(scene.mesh.faces, scene.mesh.face_labels, scene.mesh.edges))


def assert_compiled_first_gives_eager_numbers(function, leaves):
    """Compiled before it ever ran, and with torch's own memory of other tests cleared."""
    torch._dynamo.reset()
    compiled = torch.compile(function, fullgraph=True, backend="aot_eager")(*leaves)
    have = torch.autograd.grad(compiled, leaves)
    eager = function(*leaves)
    want = torch.autograd.grad(eager, leaves)
    torch.testing.assert_close(compiled, eager)
    for one, other in zip(have, want, strict=True):
        assert other.abs().max() > 0
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-3)


def operations_of(kind, device):
    """A renderer's custom operations, each with its arguments, of which the first tensor is a leaf."""
    scene = new_scene(device)
    if kind == "mesh":
        tensors = [*scene.leaves("mesh"), scene.mesh.faces, scene.mesh.face_labels, scene.mesh.edges]
        settings = [20, 0, 1], "partdr", [0.01, INF, 1.0]
    else:
        leaf, *others = scene.leaves("coverage")
        tensors = [leaf, *(tensor.detach() for tensor in others), scene.camera.intrinsics]
        settings = [0, *range(1, 21)], "coverage", [-INF, INF, 1.0, 1.0]
    maps, loss = (getattr(torch.ops.warp_partdr, f"{kind}_{name}").default for name in ("maps", "label_loss"))
    size = scene.target.shape[1:]
    return (maps, (tensors, [20, *size], *settings)), (loss, (tensors, scene.target, True, *settings))


@pytest.mark.parametrize("kind", ["mesh", "ellipsoid"])
def test_operations_pass_torchs_own_checks(device, kind):
    # float atomics may differ in the last bits between two runs on CUDA
    near = {"atol": 1e-3, "rtol": 1e-4} if kind == "mesh" else {}
    for operation, arguments in operations_of(kind, device):
        torch.library.opcheck(operation, arguments, **near)


@pytest.mark.parametrize("kind", ["mesh", "ellipsoid"])
def test_operations_have_no_second_derivative(device, kind):
    names = ("draw_mesh", "mesh_label_loss") if kind == "mesh" else ("draw_ellipsoids", "ellipsoid_label_loss")
    for name, (operation, arguments) in zip(names, operations_of(kind, device), strict=True):
        (first,) = torch.autograd.grad(operation(*arguments)[0].square().sum(), arguments[0][0], create_graph=True)
        with pytest.raises(NotImplementedError, match=f"^{name}: differentiated twice"):
            first.sum().backward()


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("path", ["labels", "maps"])
def test_compiled_renderers_give_the_eager_numbers(device, path, renderer):
    scene = new_scene(device)

    def loss_of(first, *others):
        numbers = [first * 1.02, *others]
        if path == "labels":
            loss, picture = scene.loss(renderer, numbers)
            return loss.sum() + picture.labels.sum()
        return (scene.draw(renderer, numbers, num_maps=20).maps * 0.5).square().sum()

    assert_compiled_first_gives_eager_numbers(loss_of, scene.leaves(renderer))


@pytest.mark.parametrize("renderer", ["coverage", "mesh"])
def test_compiled_pictures_are_the_eager_ones(device, renderer):
    scene = new_scene(device)

    nearest = "face_index" if renderer == "mesh" else "parts"

    def picture(*numbers):
        image = scene.draw(renderer, numbers)
        return image.labels, image.depth, getattr(image, nearest)

    leaves = scene.leaves(renderer)
    torch._dynamo.reset()
    compiled = torch.compile(picture, fullgraph=True, backend="aot_eager")(*leaves)
    for have, want in zip(compiled, picture(*leaves), strict=True):
        assert torch.equal(have, want)


def test_compiled_fits_from_lengths_to_loss_give_the_eager_numbers(device):
    body, scene = BodyParameters.mean(2, device=device), new_scene(device)
    turns = torch.eye(3, device=device).expand(2, 20, 3, 3)

    def loss_of(lengths):
        posed = pose(body.global_orient(), lengths.new_zeros(2, 3), turns, lengths, body.thicknesses)
        camera = WeakPerspective(lengths.new_full((2,), 10.0), lengths.new_full((2, 2), 10.0))
        loss, _ = mesh_label_loss(posed.vertices(1), scene.mesh, camera, scene.target)
        return loss.sum() + posed.joints.square().sum()

    assert_compiled_first_gives_eager_numbers(loss_of, [body.lengths.requires_grad_()])


def test_eager_takes_the_function():
    scene = new_scene("cpu")
    loss, _ = scene.loss("mesh", scene.leaves("mesh"))
    assert "LabelLoss" in type(loss.grad_fn).__name__
