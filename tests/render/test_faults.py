"""Numbers that can't be drawn: refused where a call is checked, and NaN where it is not, never a picture.

A body with NaN, infinity, or a size of 0 or less has NaN as loss, gradient, maps and depth. Its neighbours in the batch
keep theirs.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from helpers.bodies import moved_bodies, unsure_observation, walker

from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.plain_posing import place_vertices_by_torch
from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_6d
from warp_partdr.cameras import Perspective
from warp_partdr.networks.regression.predicted import Predicted
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh, mesh_label_loss
from warp_partdr.render.part_mesh import ellipbody_mesh
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh
from warp_partdr.solve.ellipsoids.energy import Energy
from warp_partdr.solve.ellipsoids.energy_loss import energy_loss

SIZE = 48
RENDERERS = [
    *(RendererEllipsoids("edges"), RendererEllipsoids("coverage"), RendererEllipsoids("partdr")),
    *(RendererMesh(1), RendererMesh(1, gradient="edges")),
]
renderers = pytest.mark.parametrize("renderer", RENDERERS, ids=["edges", "coverage", "partdr", "mesh", "mesh-edges"])
NOT_NUMBERS = [
    ("orientation", (1,), math.nan),
    ("orientation", (4,), math.inf),
    ("orientation", (2,), -math.inf),
    ("rotations", (19, 2), math.nan),  # a hand, which nothing hangs on
    ("rotations", (0, 1), math.nan),  # a hip, which is locked
    ("rotations", (8, 0), math.inf),
    ("lengths", (4,), math.nan),
    ("thicknesses", (9,), math.inf),
    ("log_scale", (), math.nan),
    ("log_scale", (), 1e9),  # whose exponential is infinite
    ("shift", (0,), math.nan),
]
NO_SIZES = [
    *(("lengths", (8,), 0.0), ("lengths", (2,), -0.2)),
    *(("thicknesses", (14,), 0.0), ("thicknesses", (6,), -1e-3)),
    ("thicknesses", (13,), -0.02),  # the first of a hand's alone
    ("log_scale", (), -math.inf),
    ("log_scale", (), -200.0),  # whose exponential is 0 in float32
]
faults = pytest.mark.parametrize(("name", "place", "value"), NOT_NUMBERS + NO_SIZES)


def broken_bodies(device: str, name: str, place: tuple[int, ...], value: float, batch: int = 3) -> BodyParameters:
    """Bodies of which the second has a fault."""
    bodies = BodyParameters.mean(batch, device=device)
    bodies = replace(bodies, rotations=bodies.rotations + 0.2, orientation=bodies.orientation + 0.1)
    bodies.tensors()[name][(1, *place)] = value
    return bodies


def in_perspective(bodies: BodyParameters) -> tuple[tuple[torch.Tensor, ...], Perspective]:
    """Arguments of ``body_loss`` and ``body_maps``: numbers of bodies 3 m before a camera, and the camera."""
    count, device = bodies.batch_size, bodies.shift.device
    far = torch.tensor([0.0, 0.0, 3.0], device=device).repeat(count, 1)
    camera = Perspective(torch.full((count, 2), 60.0, device=device), torch.full((count, 2), SIZE / 2, device=device))
    return (bodies.orientation, far, bodies.rotations, bodies.lengths, bodies.thicknesses), camera


def target(device: str) -> torch.Tensor:
    usual = BodyParameters.mean(1, device=device)
    return RendererEllipsoids().draw(usual.posed(), usual.camera(SIZE), (SIZE, SIZE)).labels


def assert_second_alone(values: torch.Tensor) -> None:
    """NaN in the second body, and in no other."""
    rows = values.detach().flatten(1) if values.dim() > 1 else values.detach()[:, None]
    assert rows.isnan().any(1).tolist() == [body == 1 for body in range(len(rows))]


@renderers
@faults
def test_the_loss_of_a_crop_and_each_gradient_are_nan(device, renderer, name, place, value):
    """Three times: launched, captured, replayed; and without a gradient."""
    for _ in range(3):
        leaves = broken_bodies(device, name, place, value).leaves()
        loss = renderer.crop_loss(leaves, target(device))
        loss.sum().backward()
        assert_second_alone(loss)
        for tensor in leaves.tensors().values():
            assert_second_alone(tensor.grad)
        if not math.isfinite(value):
            assert leaves.orientation.grad[1].isnan().all()
        assert_second_alone(renderer.crop_loss(leaves.detach(), target(device)))


@renderers
@pytest.mark.parametrize(("name", "place", "value"), [NOT_NUMBERS[0], NOT_NUMBERS[3], NO_SIZES[1]])
def test_unchecked_losses_and_maps_are_nan_and_checked_ones_are_refused(device, renderer, name, place, value):
    numbers, camera = in_perspective(broken_bodies(device, name, place, value))

    def leaves() -> list[torch.Tensor]:
        return [tensor.clone().requires_grad_() for tensor in numbers]

    argument = {"orientation": "global_orient"}.get(name, name)
    with pytest.raises(ValueError, match=f"^{argument}: "):
        renderer.body_loss(leaves(), camera, target(device))
    with pytest.raises(ValueError, match=f"^{argument}: "):
        renderer.body_maps(leaves(), camera, (SIZE, SIZE))
    for _ in range(3):
        given = leaves()
        loss = renderer.body_loss(given, camera, target(device), validate=False)
        loss.sum().backward()
        assert_second_alone(loss)
        assert_second_alone(given[3].grad)
        given = leaves()
        maps = renderer.body_maps(given, camera, (SIZE, SIZE), validate=False)
        assert maps[1].isnan().all()
        assert_second_alone(maps)
        maps.sum().backward()
        assert_second_alone(given[3].grad)


@renderers
def test_maps_of_bodies_are_nan_only_while_a_body_is_faulty(device, renderer):
    """One memory draws four times: a fault is not kept for the next picture."""
    for faulty in (False, True, False, True):
        length = math.nan if faulty else 0.2
        numbers, camera = in_perspective(broken_bodies(device, "lengths", (10,), length))
        maps = renderer.body_maps(numbers, camera, (SIZE, SIZE), validate=False)
        assert maps.flatten(1).isnan().any(1).tolist() == [False, faulty, False]
        assert maps[::2].sum() > 0


@renderers
@pytest.mark.parametrize("value", [math.nan, -0.1, 0.0])
def test_posed_bodies_are_drawn_as_nan_or_refused(device, renderer, value):
    bodies = BodyParameters.mean(3, device=device)
    bodies.lengths[1, 10] = value
    posed, camera = bodies.posed(), bodies.camera(SIZE)
    with pytest.raises(ValueError, match=r"centres|semi_axes|vertices"):
        renderer.draw(posed, camera, (SIZE, SIZE))
    with pytest.raises(ValueError, match=r"centres|semi_axes|vertices"):
        renderer.label_loss(posed, camera, target(device))
    maps = renderer.draw(posed, camera, (SIZE, SIZE), num_maps=20, validate=False).maps
    assert_second_alone(maps)
    assert maps[1].isnan().all()
    assert_second_alone(renderer.label_loss(posed, camera, target(device), validate=False)[0])


@pytest.mark.parametrize("gradient", ["edges", "coverage", "partdr"])
@pytest.mark.parametrize(("name", "value"), [("centres", math.nan), ("axes", math.inf), ("semi_axes", -0.1)])
def test_a_faulty_ellipsoid_makes_its_picture_and_gradient_nan(device, gradient, name, value):
    """Depth is NaN everywhere, also where another ellipsoid shows; of the gradients, only the faulty one's is."""
    posed, camera = BodyParameters.mean(3, device=device).posed(), BodyParameters.mean(3, device=device).camera(SIZE)
    tensors = {each: getattr(posed, each).clone() for each in ("centres", "axes", "semi_axes")}
    tensors[name].view(3, 20, -1)[1, 7, 0] = value
    leaves = {each: tensor.requires_grad_() for each, tensor in tensors.items()}
    options = {"gradient": gradient, "validate": False}
    image = draw_ellipsoids(Ellipsoids(**leaves), camera, (SIZE, SIZE), num_maps=20, **options)
    assert image.depth[1].isnan().all()
    assert not image.depth[[0, 2]].isnan().any()
    assert (image.labels[1] != 8).all()
    assert image.maps[1].isnan().all()
    image.maps.sum().backward()
    loss, _ = ellipsoid_label_loss(Ellipsoids(**leaves), camera, target(device), **options)
    loss.sum().backward()
    assert_second_alone(loss)
    for tensor in leaves.values():
        assert_second_alone(tensor.grad)
        assert not tensor.grad[1, :7].isnan().any()


@pytest.mark.parametrize("gradient", ["partdr", "edges"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_faulty_mesh_makes_its_own_pictures_nan_and_no_later_ones(device, gradient, value):
    """One z-buffer's graph draws three times: a fault is not kept for the next picture."""
    mesh = ellipbody_mesh(0, device=device)
    bodies = BodyParameters.mean(3, device=device)
    for faulty in (True, False, True, True):
        vertices = bodies.posed().vertices(0)
        if faulty:
            vertices[1, 33, 0] = value
        vertices.requires_grad_()
        options = {"gradient": gradient, "validate": False}
        loss, _ = mesh_label_loss(vertices, mesh, bodies.camera(SIZE), target(device), **options)
        loss.sum().backward()
        maps = draw_mesh(vertices, mesh, bodies.camera(SIZE), (SIZE, SIZE), num_maps=20, **options).maps
        (by_maps,) = torch.autograd.grad(maps.sum(), vertices)
        for values in (loss, vertices.grad, maps, by_maps):
            rows = values.detach().flatten(1) if values.dim() > 1 else values.detach()[:, None]
            assert rows.isnan().any(1).tolist() == [False, faulty, False]


@pytest.mark.parametrize("labels", [False, True], ids=["keypoints", "labels"])
@pytest.mark.parametrize(("name", "place", "value"), NOT_NUMBERS)
def test_an_energy_and_its_gradient_are_nan(device, labels, name, place, value):
    """Torch runs first, and then the captured iteration."""
    body = walker(device)
    seen = unsure_observation(body, labels=label_set("surreal14") if labels else None)
    energy = Energy(seen, size=SIZE)
    for call in range(3):
        bodies = moved_bodies(body, 3, amount=0.1).detach()
        bodies.tensors()[name][(1, *place)] = value
        leaves = bodies.leaves()
        loss = energy_loss(energy, leaves)
        loss.sum().backward()
        if labels or place not in ((19, 2), (0, 1)):  # no keypoint depends on hands, and none on locked hips
            assert not loss[1].isfinite()
            assert call == 0 or not leaves.tensors()[name].grad[1].isfinite().all()  # torch: |NaN| has the slope 0
        assert loss[[0, 2]].isfinite().all()
        assert leaves.tensors()[name].grad[[0, 2]].isfinite().all()


def test_what_a_network_says_stays_nan(device):
    """Rotations are matrices there."""
    usual = BodyParameters.mean(3, device=device)
    turns = torch.eye(3, device=device).repeat(3, 20, 1, 1)
    for name in ("orientation", "rotations", "thicknesses"):
        numbers = {"orientation": rotation_from_6d(usual.orientation), "rotations": turns.clone()}
        numbers["thicknesses"] = usual.thicknesses.clone()
        numbers[name].view(3, -1)[1, -1] = math.nan
        said = Predicted(**numbers, lengths=usual.lengths, log_scale=usual.log_scale, shift=usual.shift)
        for renderer in RENDERERS:
            assert_second_alone(renderer.crop_loss(said, target(device)))


@pytest.mark.parametrize("form", [3, 6])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_rotations_of_every_form_and_dtype_stay_nan(device, form, value):
    """Each number of the whole body's rotation and of a part's, by kernels and by torch."""
    mean = BodyParameters.mean(1, device=device)
    whole = {3: torch.tensor([[0.3, 0.2, -0.1]], device=device), 6: mean.orientation + 0.1}[form]
    turns = whole[:, None].repeat(1, 20, 1)
    for dtype in (torch.float32, torch.float64):
        for index in range(form):
            for part in (None, 0, 5):
                given = [whole.clone().to(dtype), turns.clone().to(dtype)]
                if part is None:
                    given[0][0, index] = value
                else:
                    given[1][0, part, index] = value
                sizes = mean.lengths.to(dtype), mean.thicknesses.to(dtype)
                posed = pose(given[0], torch.zeros(1, 3, dtype=dtype, device=device), given[1], *sizes, validate=False)
                row = 4 if part is None else part
                assert posed.axes[0, row].isnan().any()
                assert posed.rotations[0, row].isnan().any()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("part", [1, 11])
def test_a_locked_part_s_nan_is_not_hidden(device, dtype, part):
    bodies = BodyParameters(**{n: t.to(dtype) for n, t in BodyParameters.mean(2, device=device).tensors().items()})
    bodies.rotations[1, part, 2] = math.nan
    assert_second_alone(bodies.posed().axes)


@pytest.mark.parametrize("size", [0.0, -0.1])
def test_sizes_that_are_not_positive_make_a_mesh_of_nan(device, size):
    """It holds for kernels, for torch, and for the class of Warp arrays."""
    posed = BodyParameters.mean(2, device=device).posed()
    sizes = posed.semi_axes.clone()
    sizes[1, 3, 2] = size
    assert_second_alone(replace(posed, semi_axes=sizes).vertices(0))
    by_torch = place_vertices_by_torch(posed.centres, posed.axes, sizes, 0)
    assert_second_alone(by_torch)
    assert by_torch[1].isnan().flatten(1).all(1).tolist() == [part == 3 for part in range(20)]
    body = EllipBody.mean(2, device=device)
    body.torch()["thicknesses"][1, 0] = size
    assert_second_alone(body.pose().torch()["vertices"])


@pytest.mark.parametrize(("name", "value"), [("lengths", 0.0), ("lengths", -0.3), ("thicknesses", -1e-6)])
def test_pose_refuses_sizes_that_are_not_positive(device, name, value):
    mean = BodyParameters.mean(2, device=device)
    mean.tensors()[name][1, 4] = value
    with pytest.raises(ValueError, match=f"^{name}: .*expected positive"):
        pose(mean.orientation, torch.zeros(2, 3, device=device), mean.rotations, mean.lengths, mean.thicknesses)


def test_a_column_of_nan_and_zeros_is_no_rotation(device):
    """The largest of its numbers is 0, but it is not a column of zeros, which another one replaces."""
    mean = BodyParameters.mean(1, device=device)
    for index in range(6):
        columns = torch.tensor([[1.0, 0.0, 0.0, 0.0, 1.0, 0.0]], device=device)
        columns[0, index // 3 * 3 : index // 3 * 3 + 3] = 0.0
        columns[0, index] = math.nan
        posed = pose(columns, columns.new_zeros(1, 3), mean.rotations, mean.lengths, mean.thicknesses, validate=False)
        assert posed.axes.isnan().any()
        loss = RENDERERS[0].crop_loss(replace(mean, orientation=columns), target(device))
        assert loss.isnan().all()


@pytest.mark.parametrize(
    ("shape", "dtype", "says"),
    [
        ((2, 48, 40), torch.uint8, r"target: shape \(2, 48, 40\); expected square crops"),
        ((3, 48, 48), torch.uint8, "target: batch 3; expected 2"),
        ((48, 48), torch.uint8, r"target: shape \(48, 48\)"),
        ((2, 48, 48), torch.float32, "target: torch.float32; expected torch.uint8"),
    ],
)
def test_targets_that_are_no_crops_are_refused(device, shape, dtype, says):
    bodies = BodyParameters.mean(2, device=device)
    with pytest.raises(ValueError, match=says):
        RENDERERS[0].crop_loss(bodies, torch.zeros(shape, dtype=dtype, device=device))
    with pytest.raises(ValueError, match=r"subdivisions: auto; expected 0 to 3"):
        RendererMesh("auto").crop_loss(bodies, target(device))
