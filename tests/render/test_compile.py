"""Renderers and body under torch.compile: traced whole at the first call, and the same numbers as eager code."""

import pytest
import torch
from scenes.pictures import draw_on_screen, loss_on_screen, noisy_picture, projected_bodies

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import pose
from warp_partdr.cameras import WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh

SIZE = (24, 20)


def scene(device):
    vertices, mesh = projected_bodies(6, SIZE, device, subdivisions=0, batch=2)
    leaf = torch.from_numpy(vertices).to(device).requires_grad_()
    return leaf, mesh, noisy_picture(draw_on_screen(leaf, mesh, SIZE).labels, 20, 3)


def untouched(mesh: PartMesh) -> PartMesh:
    """The same mesh, of which nothing has been asked yet."""
    return PartMesh(mesh.faces, mesh.face_labels, mesh.edges)


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


def test_opcheck(device):
    leaf, mesh, target = scene(device)
    arrays = [leaf, mesh.faces, mesh.face_labels, mesh.edges]
    # float atomics may differ in the last bits between two runs on CUDA
    torch.library.opcheck(
        torch.ops.warp_partdr.mesh_maps.default,
        (arrays, [20, 24, 20], [20, 1], "partdr", [0.01, float("inf"), 1.0]),
        atol=1e-3,
        rtol=1e-4,
    )
    torch.library.opcheck(
        torch.ops.warp_partdr.mesh_label_loss.default,
        (arrays, target, True, [20, 1], "partdr", [0.01, float("inf"), 1.0]),
        atol=1e-3,
        rtol=1e-4,
    )


def ellipsoids_and_camera(device):
    body = BodyParameters.mean(2, device=device)
    posed = body.posed()
    return Ellipsoids(posed.centres.detach().requires_grad_(), posed.axes, posed.semi_axes), body.camera(SIZE[1])


def test_opcheck_of_ellipsoids(device):
    given, camera = ellipsoids_and_camera(device)
    tensors = [given.centres, given.axes, given.semi_axes, camera.intrinsics]
    numbers = ([0, *range(1, 21)], "coverage", [-float("inf"), float("inf"), 1.0, 1.0])
    target = torch.zeros(2, *SIZE, dtype=torch.uint8, device=device)
    torch.library.opcheck(torch.ops.warp_partdr.ellipsoid_maps.default, (tensors, [20, *SIZE], *numbers))
    torch.library.opcheck(
        torch.ops.warp_partdr.ellipsoid_label_loss.default,
        (tensors, target, True, *numbers),
    )


@pytest.mark.parametrize("path", ["labels", "maps"])
def test_mesh(device, path):
    leaf, mesh, target = scene(device)
    mesh = untouched(mesh)

    def loss_of(vertices):
        moved = vertices * 1.01
        if path == "labels":
            return loss_on_screen(moved, mesh, target)[0].sum()
        return (draw_on_screen(moved, mesh, SIZE, num_maps=20).maps * 0.5).square().sum()

    assert_compiled_first_gives_eager_numbers(loss_of, leaf)


@pytest.mark.parametrize("gradient", ["coverage", "edges", "partdr"])
@pytest.mark.parametrize("path", ["labels", "maps"])
def test_ellipsoids(device, path, gradient):
    given, camera = ellipsoids_and_camera(device)
    target = draw_ellipsoids(given, camera, SIZE).labels.roll(2, 2)

    def loss_of(centres):
        moved = Ellipsoids(centres * 1.02, given.axes, given.semi_axes)
        if path == "labels":
            loss, picture = ellipsoid_label_loss(moved, camera, target, gradient=gradient)
            return loss.sum() + picture.labels.sum()
        return (draw_ellipsoids(moved, camera, SIZE, num_maps=20, gradient=gradient).maps * 0.5).square().sum()

    assert_compiled_first_gives_eager_numbers(loss_of, given.centres)


def test_pictures_alone(device):
    leaf, mesh, _ = scene(device)
    mesh = untouched(mesh)
    given, camera = ellipsoids_and_camera(device)

    def pictures(vertices, centres):
        mesh_picture = draw_on_screen(vertices, mesh, SIZE)
        picture = draw_ellipsoids(Ellipsoids(centres, given.axes, given.semi_axes), camera, SIZE)
        return mesh_picture.labels, picture.labels, picture.parts, picture.depth

    torch._dynamo.reset()
    compiled = torch.compile(pictures, fullgraph=True, backend="aot_eager")(leaf, given.centres)
    for have, want in zip(compiled, pictures(leaf, given.centres), strict=True):
        assert torch.equal(have, want)


def test_from_the_body_s_parameters_to_the_loss(device):
    body = BodyParameters.mean(2, device=device)
    turns = torch.eye(3, device=device).expand(2, 20, 3, 3)
    _, mesh, target = scene(device)
    mesh = untouched(mesh)

    def loss_of(lengths):
        posed = pose(body.global_orient(), lengths.new_zeros(2, 3), turns, lengths, body.thicknesses)
        camera = WeakPerspective(lengths.new_full((2,), 10.0), lengths.new_full((2, 2), 10.0))
        return mesh_label_loss(posed.vertices(0), mesh, camera, target)[0].sum() + posed.joints.square().sum()

    assert_compiled_first_gives_eager_numbers(loss_of, body.lengths.requires_grad_())


def test_eager_takes_the_function():
    leaf, mesh, target = scene("cpu")
    loss, _ = loss_on_screen(leaf, mesh, target)
    assert "LabelLoss" in type(loss.grad_fn).__name__
