"""Renderers and body under torch.compile: traced whole at the first call, and the same numbers as eager code."""

import pytest
import torch
from scenes.pictures import GRADIENTS, draw_on_screen, loss_on_screen, noisy_picture, projected_bodies

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import pose
from warp_partdr.cameras import WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh

SIZE = (24, 20)
INF = float("inf")


def mesh_scene(device):
    """Vertices, a mesh of which nothing has been asked yet, and a target."""
    leaf, mesh = projected_bodies(6, SIZE, device, batch=2)
    target = noisy_picture(draw_on_screen(leaf, mesh, SIZE).labels, 20, 3)
    return leaf, PartMesh(mesh.faces, mesh.face_labels, mesh.edges), target


def ellipsoids_and_camera(device):
    body = BodyParameters.mean(2, device=device)
    posed = body.posed()
    return Ellipsoids(posed.centres.detach().requires_grad_(), posed.axes, posed.semi_axes), body.camera(SIZE[1])


def scene_of(renderer, device):
    """A leaf, and a function that draws it and one that compares it."""
    if renderer == "mesh":
        leaf, mesh, target = mesh_scene(device)
        return (
            leaf,
            lambda points, **options: draw_on_screen(points, mesh, SIZE, **options),
            lambda points: loss_on_screen(points, mesh, target),
        )
    given, camera = ellipsoids_and_camera(device)
    target = draw_ellipsoids(given, camera, SIZE).labels.roll(2, 2)

    def moved(centres):
        return Ellipsoids(centres, given.axes, given.semi_axes), camera

    return (
        given.centres,
        lambda centres, **options: draw_ellipsoids(*moved(centres), SIZE, gradient=renderer, **options),
        lambda centres: ellipsoid_label_loss(*moved(centres), target, gradient=renderer),
    )


def assert_compiled_first_gives_eager_numbers(function, leaf):
    """Compiled before it ever ran, and with torch's own memory of other tests cleared."""
    torch._dynamo.reset()
    compiled = torch.compile(function, fullgraph=True, backend="aot_eager")(leaf)
    (have,) = torch.autograd.grad(compiled, leaf)
    eager = function(leaf)
    (want,) = torch.autograd.grad(eager, leaf)
    assert want.abs().max() > 0
    torch.testing.assert_close(compiled, eager)
    torch.testing.assert_close(have, want, rtol=1e-4, atol=1e-3)


@pytest.mark.parametrize("kind", ["mesh", "ellipsoid"])
def test_opcheck(device, kind):
    if kind == "mesh":
        leaf, mesh, target = mesh_scene(device)
        tensors, settings = [leaf, mesh.faces, mesh.face_labels, mesh.edges], ([20, 1], "partdr", [0.01, INF, 1.0])
        near = {"atol": 1e-3, "rtol": 1e-4}  # float atomics may differ in the last bits between two runs on CUDA
    else:
        given, camera = ellipsoids_and_camera(device)
        tensors, settings = (
            [*vars(given).values(), camera.intrinsics],
            ([0, *range(1, 21)], "coverage", [-INF, INF, 1, 1]),
        )
        target, near = torch.zeros(2, *SIZE, dtype=torch.uint8, device=device), {}
    operations = torch.ops.warp_partdr
    torch.library.opcheck(getattr(operations, f"{kind}_maps").default, (tensors, [20, *SIZE], *settings), **near)
    loss = getattr(operations, f"{kind}_label_loss").default
    torch.library.opcheck(loss, (tensors, target, True, *settings), **near)


@pytest.mark.parametrize("renderer", [*GRADIENTS, "mesh"])
@pytest.mark.parametrize("path", ["labels", "maps"])
def test_renderers(device, path, renderer):
    leaf, draw, compare = scene_of(renderer, device)

    def loss_of(numbers):
        if path == "labels":
            loss, picture = compare(numbers * 1.02)
            return loss.sum() + picture.labels.sum()
        return (draw(numbers * 1.02, num_maps=20).maps * 0.5).square().sum()

    assert_compiled_first_gives_eager_numbers(loss_of, leaf)


@pytest.mark.parametrize("renderer", ["coverage", "mesh"])
def test_pictures_alone(device, renderer):
    leaf, draw, _ = scene_of(renderer, device)

    def picture(numbers):
        return [image for image in vars(draw(numbers)).values() if image is not None]

    torch._dynamo.reset()
    compiled = torch.compile(picture, fullgraph=True, backend="aot_eager")(leaf)
    for have, want in zip(compiled, picture(leaf), strict=True):
        assert torch.equal(have, want)


def test_from_the_body_s_parameters_to_the_loss(device):
    body = BodyParameters.mean(2, device=device)
    turns = torch.eye(3, device=device).expand(2, 20, 3, 3)
    _, mesh, target = mesh_scene(device)

    def loss_of(lengths):
        posed = pose(body.global_orient(), lengths.new_zeros(2, 3), turns, lengths, body.thicknesses)
        camera = WeakPerspective(lengths.new_full((2,), 10.0), lengths.new_full((2, 2), 10.0))
        return mesh_label_loss(posed.vertices(0), mesh, camera, target)[0].sum() + posed.joints.square().sum()

    assert_compiled_first_gives_eager_numbers(loss_of, body.lengths.requires_grad_())


def test_eager_takes_the_function():
    leaf, mesh, target = mesh_scene("cpu")
    loss, _ = loss_on_screen(leaf, mesh, target)
    assert "LabelLoss" in type(loss.grad_fn).__name__
