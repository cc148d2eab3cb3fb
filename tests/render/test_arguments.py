"""Arguments of both renderers: types and strides that change nothing, and what is refused by name."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.pictures import (
    Intrinsics,
    Leaves,
    ball,
    body_camera,
    body_parameters,
    checked_target,
    draw_on_screen,
    loss_on_screen,
    one_scene,
    triangle,
)
from helpers.renderers import RENDERERS

from warp_partdr.body.posing import pose
from warp_partdr.cameras import Crop, Perspective, WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh

SIZE = (24, 32)
NAN, INF = math.nan, math.inf


def inputs(renderer, device="cpu"):
    """Two ellipsoids or a triangle, by name, to be asked for gradients."""
    if renderer == "mesh":
        return {"vertices": triangle(device)[0].requires_grad_()}
    return Leaves.of(one_scene((0.1, 0, 3), (0.5, 0.4, 0.3), True), device=device).tensors()


def draw(renderer, tensors, size=SIZE, **options):
    if renderer == "mesh":
        return draw_on_screen(tensors["vertices"], triangle()[1], size, **options)
    *parts, camera = tensors.values()
    return draw_ellipsoids(Ellipsoids(*parts), Intrinsics(camera, True), size, gradient=renderer, **options)


def loss_of(renderer, tensors, target, **options):
    """Loss and picture."""
    if renderer == "mesh":
        mesh = triangle("cpu" if target.is_meta else target.device)[1]
        return loss_on_screen(tensors["vertices"], mesh, target, **options)
    *parts, camera = tensors.values()
    return ellipsoid_label_loss(Ellipsoids(*parts), Intrinsics(camera, True), target, gradient=renderer, **options)


def assert_same(renderer, have, want):
    """They agree to the bit, but for sums that CUDA's float atomics make."""
    for one, other in zip(have, want, strict=True):
        torch.testing.assert_close(one, other.to(one.dtype), **({} if renderer == "mesh" else {"rtol": 0, "atol": 0}))


# --- What changes nothing ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float64])
@pytest.mark.parametrize("renderer", RENDERERS)
def test_other_types_give_what_float32_gives(device, renderer, dtype):
    target = checked_target(SIZE, 1 if renderer == "mesh" else 2, device)
    found = []
    for kind in (dtype, torch.float32):
        given = inputs(renderer, device).items()
        tensors = {name: tensor.detach().to(dtype).to(kind).requires_grad_() for name, tensor in given}
        loss, image = loss_of(renderer, tensors, target)
        gradients = torch.autograd.grad(loss.sum(), list(tensors.values()))
        assert all(tensor.dtype == kind and torch.isfinite(tensor).all() for tensor in gradients)
        found.append((image.labels, *gradients))
    assert_same(renderer, *found)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_expanded_and_strided_tensors_give_what_contiguous_ones_give(device, renderer):
    """Gradients must not be written twice to memory that is shared."""
    target = checked_target(SIZE, 1 if renderer == "mesh" else 2, device)
    found = []
    for strided in (False, True):
        leaves = inputs(renderer, device)
        tensors = {name: leaf.expand(3, *leaf.shape[1:]) for name, leaf in leaves.items()}
        if strided:
            tensors = {name: each.transpose(0, -1).contiguous().transpose(0, -1) for name, each in tensors.items()}
            wanted = target.expand(3, -1, -1)
        else:
            tensors, wanted = {name: each.contiguous() for name, each in tensors.items()}, target.repeat(3, 1, 1)
        loss, image = loss_of(renderer, tensors, wanted)
        loss.sum().backward()
        found.append([image.labels, image.depth, loss.detach(), *(leaf.grad for leaf in leaves.values())])
    assert_same(renderer, *found)


def test_nothing_behind_a_perspective_camera_is_drawn(device):
    """The near plane does not matter."""
    bodies, _ = ball(device=device)
    behind = replace(bodies, centres=-bodies.centres)
    camera = Perspective(torch.full((1, 2), 8.0, device=device), torch.full((1, 2), 4.0, device=device), near=-10.0)
    assert (draw_ellipsoids(behind, camera, (8, 8)).labels == 0).all()
    vertices, mesh = triangle(device)
    for depth in (-1.0, 0.0, 1e-40):
        moved = torch.cat([vertices[..., :2], torch.full_like(vertices[..., 2:], depth)], -1)
        assert (draw_mesh(moved, mesh, camera, (8, 8)).labels == 0).all()


# --- What is refused ---------------------------------------------------------------------------------------------


def refuse(message, renderer, *, target=None, **options):
    """Assert that drawing and, where a target can be meant, the loss name what is wrong."""
    tensors = options.pop("tensors", inputs(renderer))
    if target is None:
        with pytest.raises((ValueError, TypeError), match=message):
            draw(renderer, tensors, **options)
    if not options.keys() & {"size", "num_maps"}:
        target = torch.zeros(1, 8, 8, dtype=torch.uint8) if target is None else target
        with pytest.raises((ValueError, TypeError), match=message):
            loss_of(renderer, tensors, target, **options)


def spoiled(tensor, value):
    tensor = tensor.detach().clone()
    tensor.view(-1)[-1] = value
    return tensor


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e300])
@pytest.mark.parametrize("name", ["centres", "axes", "semi_axes", "camera", "vertices"])
def test_what_is_no_number_is_named(name, value):
    renderer, said = "mesh" if name == "vertices" else "coverage", "1e" if value == 1e300 else "NaN or infinity"
    for dtype in (torch.float64,) if value == 1e300 else (torch.float32, torch.float64):
        tensors = {other: tensor.to(dtype) for other, tensor in inputs(renderer).items()}
        refuse(f"^{name}: holds {said}", renderer, tensors={**tensors, name: spoiled(tensors[name], value)})


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e300])
@pytest.mark.parametrize("name", ["global_orient", "translation", "rotations", "lengths", "thicknesses"])
def test_poses_that_are_no_numbers_are_named(device, name, value):
    parameters = {name: tensor.double() for name, tensor in body_parameters(0, device).items()}
    with pytest.raises(ValueError, match=f"{name}: "):
        pose(**{**parameters, name: spoiled(parameters[name], value)})


BAD_TENSORS = [  # message, and what is made of the tensor that it names
    ("centres: shape", lambda t: t[0]),
    ("centres: torch.int32", lambda t: t.int()),
    ("axes: shape", lambda t: t[:, :1]),
    ("axes: torch.float64", lambda t: t.double()),
    ("axes: on meta", lambda t: t.to("meta")),
    ("semi_axes: shape", lambda t: t[..., :2]),
    ("semi_axes: on meta", lambda t: t.to("meta")),
    ("semi_axes: 0.0", lambda t: spoiled(t, 0.0)),
    ("semi_axes: -1.0", lambda t: spoiled(t, -1.0)),
    ("camera: 2 of them", lambda t: t.expand(2, 4)),
    ("camera: torch.int64", lambda t: t.long()),
    ("camera: on meta", lambda t: t.to("meta")),
    ("vertices: shape", lambda t: t[0]),
    ("vertices: shape", lambda t: torch.ones(())),
    ("vertices: torch.int32", lambda t: t.int()),
    ("vertices: torch.sparse_coo", lambda t: t.to_sparse()),
    ("vertices: list", lambda t: [[1.0]]),
    ("vertices: 2 a body", lambda t: t[:, :2]),
]


@pytest.mark.parametrize(("message", "change"), BAD_TENSORS)
def test_bad_tensors_are_named(message, change):
    name = message.split(":")[0]
    renderer = "mesh" if name == "vertices" else "coverage"
    tensors = inputs(renderer)
    refuse(f"^{message}", renderer, tensors={**tensors, name: change(tensors[name].detach())})


@pytest.mark.parametrize("count", [0, 256])
def test_only_so_many_ellipsoids_are_counted(count):
    *parts, camera = inputs("coverage").values()
    with pytest.raises(ValueError, match=f"^centres: {count} ellipsoids"):
        draw_ellipsoids(Ellipsoids(*(tensor[:, [0] * count] for tensor in parts)), Intrinsics(camera, True), SIZE)


BAD_OPTIONS = {
    r"image_size: \(0, 8\)": {"size": (0, 8)},
    r"image_size: \(8.0, 8\)": {"size": (8.0, 8)},
    r"image_size: \(8, 8, 3\)": {"size": (8, 8, 3)},
    "image_size: int": {"size": 8},
    "image_size: NoneType": {"size": None},
    "num_maps: 255": {"num_maps": 255},
    "num_maps: -1": {"num_maps": -1},
    "num_maps: 1.5": {"num_maps": 1.5},
    "num_maps: 'a'": {"num_maps": "a"},
    "max_distance: -1": {"max_distance": -1.0},
    "max_distance: nan": {"max_distance": NAN},
    "depth_weight: -0.5": {"depth_weight": -0.5},
    "depth_weight: nan": {"depth_weight": NAN},
    "depth_weight: inf": {"depth_weight": INF},
    "target: shape": {"target": torch.zeros(8, 8, dtype=torch.uint8)},
    "target: batch 2": {"target": torch.zeros(2, 8, 8, dtype=torch.uint8)},
    "target: torch.int64": {"target": torch.zeros(1, 8, 8, dtype=torch.int64)},
    "target: on meta": {"target": torch.zeros(1, 8, 8, dtype=torch.uint8, device="meta")},
}
BAD_OPTIONS_OF_ELLIPSOIDS = {
    "part_labels: 1 of them; expected 2": {"part_labels": [1]},
    "part_labels: -1; expected an integer": {"part_labels": [-1, 1]},
    "part_labels: 256; expected an integer": {"part_labels": [1, 256]},
    "samples_per_pixel: 0": {"samples_per_pixel": 0},
    "samples_per_pixel: nan": {"samples_per_pixel": NAN},
    "samples_per_pixel: 65": {"samples_per_pixel": 65},
}


@pytest.mark.parametrize("message", BAD_OPTIONS | BAD_OPTIONS_OF_ELLIPSOIDS)
def test_bad_options_are_named(message):
    for renderer in ("coverage", "mesh") if message in BAD_OPTIONS else ("coverage",):
        refuse(f"^{message}", renderer, **(BAD_OPTIONS | BAD_OPTIONS_OF_ELLIPSOIDS)[message])


def test_renderers_check_their_options_when_they_are_made():
    for make, says in (
        (lambda: RendererEllipsoids("x"), "gradient: 'x'; expected one of edges, coverage, partdr"),
        (lambda: RendererEllipsoids(samples_per_pixel=0.0), "samples_per_pixel: 0.0"),
        (lambda: RendererMesh(4), "subdivisions: 4; expected 0 to 3, or auto"),
        (lambda: RendererMesh("fine"), "subdivisions: 'fine'; expected 0 to 3, or auto"),
        (lambda: RendererMesh("auto", tolerance=0.0), "tolerance: 0.0; expected a positive number of pixels"),
        (lambda: RendererMesh(depth_weight=-1.0), "depth_weight: -1.0"),
    ):
        with pytest.raises(ValueError, match=says):
            make()


def test_other_gradients_are_refused():
    refuse("^gradient: 'exact'", "exact")


TRIANGLE = np.array([[0, 1, 2]])
OTHER_BAD_CALLS = {
    "scale: shape": lambda: WeakPerspective(torch.ones(1, 1), torch.ones(1, 2)),
    "scale: float": lambda: WeakPerspective(1.0, torch.ones(1, 2)),
    "translation: shape": lambda: WeakPerspective(torch.ones(2), torch.ones(1, 2)),
    "translation: torch.float64": lambda: WeakPerspective(torch.ones(1), torch.ones(1, 2).double()),
    "translation: on meta": lambda: WeakPerspective(torch.ones(1), torch.ones(1, 2, device="meta")),
    "near: nan": lambda: WeakPerspective(torch.ones(1), torch.ones(1, 2), NAN),
    "near: nan; expected": lambda: Perspective(torch.ones(1, 2), torch.ones(1, 2), NAN),
    "focal: torch.int64": lambda: Perspective(torch.ones(1, 2).long(), torch.ones(1, 2)),
    "centre: shape": lambda: Perspective(torch.ones(1, 2), torch.ones(1, 3)),
    "left: nan": lambda: Crop(NAN, 0.0, 1.0, (8, 8)),
    "zoom: 0.0": lambda: Crop(0.0, 0.0, 0.0, (8, 8)),
    "zoom: inf": lambda: Crop(0.0, 0.0, INF, (8, 8)),
    "global_orient: list": lambda: pose([1.0], *list(body_parameters(0).values())[1:]),
    "camera: 2 of them": lambda: draw_mesh(*triangle(), body_camera(SIZE, False, batch=2), SIZE),
    "target: label 9": lambda: loss_on_screen(*triangle(), torch.full((1, 8, 8), 9, dtype=torch.uint8)),
    "faces: shape": lambda: PartMesh.from_faces(np.zeros((2, 4)), np.ones(2)),
    "faces: index -1": lambda: PartMesh.from_faces(np.array([[0, 1, -1]]), np.ones(1)),
    "face_labels: shape": lambda: PartMesh.from_faces(TRIANGLE, np.ones(2)),
    "face_labels: 255": lambda: PartMesh.from_faces(TRIANGLE, np.array([255])),
}


@pytest.mark.parametrize("message", OTHER_BAD_CALLS)
def test_other_bad_calls_name_the_argument(message):
    with pytest.raises((ValueError, TypeError), match=f"^{message}"):
        OTHER_BAD_CALLS[message]()


COUNTLESS = [(1, (2**16, 2**16)), (1, (2**16, 2**15)), (1, (2**14, 2**14)), (1, (2**40, 1)), (2**20, (8192, 8192))]


@pytest.mark.parametrize(("batch", "size"), COUNTLESS)
def test_pictures_that_can_not_be_counted_are_refused(device, batch, size):
    """Nothing is allocated before. There are so many pixels that no machine has the memory for what is not refused."""
    target = torch.zeros(1, 1, 1, dtype=torch.uint8, device=device).expand(batch, *size)
    (ellipsoids, camera), (vertices, mesh) = ball(batch, device), triangle(device)
    many = vertices.expand(batch, -1, -1)
    for call in (
        lambda: draw_ellipsoids(ellipsoids, camera, size),
        lambda: ellipsoid_label_loss(ellipsoids, camera, target),
        lambda: draw_on_screen(many, mesh, size),
        lambda: loss_on_screen(many, mesh, target),
    ):
        with pytest.raises(ValueError, match=f"^image_size: {batch} pictures of"):
            call()
