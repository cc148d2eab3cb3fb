"""Renderers and body under torch.compile: traced whole at the first call, and the same numbers as eager code."""

from dataclasses import replace

import pytest
import torch
from helpers.renderers import RENDERERS, Scene
from torch._dynamo.testing import CompileCounterWithBackend

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import pose
from warp_partdr.cameras import WeakPerspective
from warp_partdr.interop.graph_cache import graphs
from warp_partdr.interop.loss_graph import LossGraph
from warp_partdr.render.mesh import mesh_label_loss
from warp_partdr.render.part_mesh import PartMesh
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh

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
    if kind == "body":
        body = BodyParameters.mean(2, device=device)
        tensors = [10 * torch.ones(2, device=device), torch.full((2, 2), 10.0, device=device), body.global_orient()]
        tensors += [torch.zeros(2, 3, device=device), body.rotations, body.lengths.requires_grad_(), body.thicknesses]
        settings = [0, 0, 0, *range(1, 21)], "coverage", [0.0, -INF, INF, 1.0, 1.0]
    elif kind == "mesh":
        tensors = [*scene.leaves("mesh"), scene.mesh.faces, scene.mesh.face_labels, scene.mesh.edges]
        settings = [20, 0, 1], "partdr", [0.01, INF, 1.0]
    else:
        leaf, *others = scene.leaves("coverage")
        tensors = [leaf, *(tensor.detach() for tensor in others), scene.camera.intrinsics]
        settings = [0, *range(1, 21)], "coverage", [-INF, INF, 1.0, 1.0]
    maps, loss = (getattr(torch.ops.warp_partdr, f"{kind}_{name}").default for name in ("maps", "label_loss"))
    size = scene.target.shape[1:]
    return (maps, (tensors, [20, *size], *settings)), (loss, (tensors, scene.target, True, *settings))


@pytest.mark.parametrize("kind", ["mesh", "ellipsoid", "body"])
def test_operations_pass_torchs_own_checks(device, kind):
    # float atomics may differ in the last bits between two runs on CUDA
    near = {"atol": 1e-3, "rtol": 1e-4} if kind == "mesh" else {}
    for operation, arguments in operations_of(kind, device):
        torch.library.opcheck(operation, arguments, **near)


@pytest.mark.parametrize("name", ["pose_bones", "place_vertices"])
def test_operations_of_bodies_pass_torchs_own_checks(device, name):
    body = BodyParameters.mean(3, device=device)
    posed = body.posed()
    bones = body.orientation, posed.joints[:, 0], body.rotations, body.lengths, body.thicknesses
    tensors = bones if name == "pose_bones" else (posed.centres, posed.axes, posed.semi_axes)
    leaves = [tensor.clone().requires_grad_() for tensor in tensors]
    torch.library.opcheck(getattr(torch.ops.warp_partdr, name).default, (leaves, 1))


NAMES = {
    "mesh": ("draw_mesh", "mesh_label_loss"),
    "ellipsoid": ("draw_ellipsoids", "ellipsoid_label_loss"),
    "body": ("body_maps", "body_label_loss"),
}


@pytest.mark.parametrize("kind", NAMES)
def test_operations_have_no_second_derivative(device, kind):
    for name, (operation, arguments) in zip(NAMES[kind], operations_of(kind, device), strict=True):
        (leaf,) = [tensor for tensor in arguments[0] if tensor.requires_grad]
        (first,) = torch.autograd.grad(operation(*arguments)[0].square().sum(), leaf, create_graph=True)
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


BODY_RENDERERS = [RendererEllipsoids("edges"), RendererMesh(1, gradient="edges")]
either = pytest.mark.parametrize("renderer", BODY_RENDERERS, ids=["ellipsoids", "mesh"])


def some_bodies(batch, device, size=24):
    """Bodies that bend a little, as leaves, and the labels of others."""
    torch.manual_seed(batch)
    mean = BodyParameters.mean(batch, device=device)
    bent = replace(mean, rotations=0.2 * torch.randn_like(mean.rotations))
    target = RendererEllipsoids().draw(mean.posed(), mean.camera(size), (size, size)).labels
    return list(bent.leaves().tensors().values()), target


@either
def test_batches_of_other_sizes_are_compiled_a_few_times(device, renderer):
    """One time for the first size, one for any other size, and one for a single body."""

    def loss_of(target, *tensors):
        return renderer.crop_loss(BodyParameters(*tensors), target).sum()

    torch._dynamo.reset()
    counter = CompileCounterWithBackend("aot_eager")
    compiled = torch.compile(loss_of, fullgraph=True, backend=counter)
    for batch in (3, 5, 2, 8, 1, 6, 7):
        leaves, target = some_bodies(batch, device)
        have = torch.autograd.grad(compiled(target, *leaves), leaves)
        want = torch.autograd.grad(loss_of(target, *leaves), leaves)
        for one, other in zip(have, want, strict=True):
            torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-3)
    assert counter.frame_count <= 3


@either
@pytest.mark.parametrize("path", ["labels", "maps"])
def test_renderers_of_posed_bodies_are_traced_whole(device, path, renderer):
    leaves, target = some_bodies(2, device)

    def loss_of(*tensors):
        bodies = BodyParameters(*tensors)
        if path == "labels":
            return renderer.label_loss(bodies.posed(), bodies.camera(24), target)[0].sum()
        return renderer.draw(bodies.posed(), bodies.camera(24), (24, 24), num_maps=20).maps.square().sum()

    assert_compiled_first_gives_eager_numbers(loss_of, leaves)


@either
def test_compiled_losses_replay_one_captured_graph(device, renderer):
    leaves, target = some_bodies(2, device, size=26)

    def loss_of(*tensors):
        return renderer.crop_loss(BodyParameters(*tensors), target).sum()

    def count():
        return sum(isinstance(kept.graph, LossGraph) for kept in graphs._kept.values())

    torch._dynamo.reset()
    compiled, before = torch.compile(loss_of, fullgraph=True, backend="aot_eager"), count()
    losses = [compiled(*leaves) for _ in range(5)]
    assert count() == before + 1
    for loss in losses:
        torch.testing.assert_close(loss, loss_of(*leaves))


def test_operations_keep_no_graph_on_a_side_stream(device):
    """There, memory may be torch's own for a capture."""
    if device == "cpu":
        pytest.skip("the CPU has no streams")
    (loss, arguments) = operations_of("ellipsoid", device)[1]
    want = [loss(*arguments) for _ in range(3)][-1]
    stream, before = torch.cuda.Stream(), len(graphs)
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        have = [loss(*arguments) for _ in range(3)][-1]
    torch.cuda.current_stream().wait_stream(stream)
    assert len(graphs) == before
    for one, other in zip(have, want, strict=True):
        assert torch.equal(one, other)


def test_reduced_overhead_gives_the_eager_numbers(device):
    """Torch captures the operations in CUDA graphs of its own, and other work goes on between its replays."""
    if device == "cpu":
        pytest.skip("the CPU has no graphs of torch")
    leaves, target = some_bodies(4, device, size=64)
    for renderer in BODY_RENDERERS:

        def loss_of(*tensors, renderer=renderer):
            return renderer.crop_loss(BodyParameters(*tensors), target).sum()

        torch._dynamo.reset()
        compiled = torch.compile(loss_of, fullgraph=True, mode="reduce-overhead")
        want = torch.autograd.grad(loss_of(*leaves), leaves)
        for _ in range(6):
            have = torch.autograd.grad(compiled(*leaves), leaves)
            eager = torch.autograd.grad(loss_of(*leaves), leaves)
            for one, again, other in zip(have, eager, want, strict=True):
                torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-3)
                torch.testing.assert_close(again, other, rtol=1e-4, atol=1e-3)


def test_a_mesh_in_other_tensor_objects_is_captured_once(device):
    """Torch may wrap the mesh anew in each call."""
    (loss, arguments) = operations_of("mesh", device)[1]
    (vertex, *mesh), *others = arguments
    for _ in range(2):
        loss([vertex, *mesh], *others)
    before = len(graphs)
    for _ in range(4):
        loss([vertex, *(tensor.view_as(tensor) for tensor in mesh)], *others)
    assert len(graphs) == before


@pytest.mark.parametrize("transform", [torch.func.grad, torch.func.jacrev])
def test_compiled_transforms_of_bodies_take_plain_torch(device, transform):
    body = BodyParameters.mean(2, device=device)
    turns = torch.eye(3, device=device).expand(2, 20, 3, 3)

    def loss_of(lengths):
        posed = pose(body.global_orient(), lengths.new_zeros(2, 3), turns, lengths, body.thicknesses)
        return posed.vertices(1).square().sum()

    torch._dynamo.reset()
    compiled = torch.compile(transform(loss_of), fullgraph=True, backend="aot_eager")
    torch.testing.assert_close(compiled(body.lengths), transform(loss_of)(body.lengths))
