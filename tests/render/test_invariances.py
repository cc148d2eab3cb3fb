"""Invariances of both renderers, every estimator, loss and gradient: what must not change, or in a known way."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from helpers.bodies import TIPS, WITHOUT_TIPS, bent_bodies, drawn_labels
from helpers.pictures import (
    CAMERAS,
    GRADIENTS,
    Leaves,
    body_camera,
    body_parameters,
    draw_on_screen,
    faces,
    loss_on_screen,
    noisy_picture,
    push_on_screen,
    random_scene,
    upright,
)
from helpers.renderers import RENDERERS
from hypothesis import given, settings
from hypothesis import strategies as st

from warp_partdr import label_set
from warp_partdr.body.landmarks import mirror_order
from warp_partdr.body.posing import pose
from warp_partdr.body.template import PARENTS, PART_NAMES
from warp_partdr.cameras import WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.part_mesh import PartMesh, ellipbody_mesh
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh

SIZE = (40, 48)
LEVEL = 1

few = settings(max_examples=5, derandomize=True, deadline=None)
seeds = st.integers(0, 2**16)


def renderer_of(name, **options):
    return RendererMesh(LEVEL, **options) if name == "mesh" else RendererEllipsoids(name, **options)


def pictured(posed, camera, renderer, size=SIZE):
    """Labels of a body in either renderer."""
    return renderer_of(renderer).draw(posed, camera, size).labels


def losses(posed, camera, target, renderer, **options):
    """L_seg of a body in either renderer."""
    return renderer_of(renderer, **options).label_loss(posed, camera, target)[0]


def losses_of_labels_and_maps(posed, camera, target, renderer):
    """The two paths' losses; the second goes through float maps."""
    wanted = (target[:, None] == torch.arange(1, 21, device=target.device)[:, None, None]).float()
    maps = renderer_of(renderer).draw(posed, camera, tuple(target.shape[1:]), num_maps=20).maps
    return losses(posed, camera, target, renderer), (maps - wanted).square().sum((1, 2, 3))


def leaves_of_parts(posed, part=slice(None)):
    """Numbers of posed ellipsoids, to be asked for gradients, and the bodies of them."""
    names = ("centres", "axes", "semi_axes")
    leaves = {name: getattr(posed, name)[part].detach().clone().requires_grad_() for name in names}
    return leaves, replace(posed, **leaves)


def leaves_of(seed, device, batch=1):
    return {name: value.requires_grad_() for name, value in body_parameters(seed, device, batch).items()}


def gradients(loss, leaves):
    found = torch.autograd.grad(loss.sum(), list(leaves.values()), retain_graph=True)
    return dict(zip(leaves, found, strict=True))


def target_of(seed, camera, renderer, device, size=SIZE):
    """The picture of a body near that of ``seed``, and some pixels that are ignored."""
    parameters = body_parameters(seed, device)
    parameters["translation"] = parameters["translation"] + torch.tensor([0.07, -0.05, 0.0], device=device)
    target = pictured(pose(**parameters), camera, renderer, size)
    target[:, 3 : 3 + size[0] // 6, size[1] // 2 : size[1] // 2 + 6] = 255
    return target


def assert_alike(have, want, tolerance):
    """Equal up to a share of the largest entry."""
    assert (have - want).abs().max() <= tolerance * want.abs().max(), (have, want)


def assert_unchanged(found, num_exact, tolerance):
    """The first results of all runs are equal to the bit, the others up to a share of the largest entry."""
    for other in found[1:]:
        assert all(torch.equal(have, want) for have, want in zip(other[:num_exact], found[0][:num_exact], strict=True))
        for have, want in zip(other[num_exact:], found[0][num_exact:], strict=True):
            assert_alike(have, want, tolerance)


# --- A picture that is its target -----------------------------------------------------------------------------------


@few
@given(seed=seeds, perspective=st.booleans())
@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_picture_equal_to_its_target_pulls_at_nothing(device, renderer, seed, perspective):
    """Exactly: in the label loss and through maps, and whatever pixels are ignored.

    The derivative of covered area ("edges", "coverage") is another thing in the label loss, where a pixel that an
    outline cuts is right or wrong as a whole; see the next test.
    """
    camera = body_camera(SIZE, perspective, device=device)
    leaves = leaves_of(seed, device)
    posed = pose(**leaves)
    target = pictured(posed, camera, renderer)
    through_labels, through_maps = losses_of_labels_and_maps(posed, camera, target, renderer)
    ignored = target.clone()
    ignored[:, ::3, 1::2] = 255
    for loss in (through_maps, through_labels, losses(posed, camera, ignored, renderer)):
        assert loss.item() == 0
        if loss is through_maps or renderer not in ("edges", "coverage"):
            assert all((gradient == 0).all() for gradient in gradients(loss, leaves).values())


@pytest.mark.parametrize("renderer", ["partdr", "mesh"])
def test_label_loss_is_the_maps_loss(device, renderer):
    """Value, and PartDR's gradient through squared differences of maps."""
    camera = body_camera(SIZE, False, 3, device)
    leaves, posed = leaves_of_parts(pose(**body_parameters(5, device, 3)))
    target = noisy_picture(pictured(posed, camera, renderer), 20, 1)
    target[target == 255] = 0
    through_labels, through_maps = losses_of_labels_and_maps(posed, camera, target, renderer)
    torch.testing.assert_close(through_labels, through_maps)
    want = gradients(through_maps, leaves)
    for name, have in gradients(through_labels, leaves).items():
        torch.testing.assert_close(have, want[name], rtol=1e-4, atol=1e-4 * want[name].abs().max().item())


@pytest.mark.parametrize("renderer", ["edges", "coverage"])
def test_pixels_that_outlines_cut_pull_little(device, renderer):
    """Pulls of half a pixel: what is left of the derivative of covered area where picture and target are equal."""
    size = (160, 192)
    camera = body_camera(size, False, device=device)
    pulls = {}
    for name in ("own", "moved"):
        leaves = leaves_of(0, device)
        own = pictured(pose(**leaves), camera, renderer, size)
        target = own if name == "own" else target_of(0, camera, renderer, device, size)
        loss = losses(pose(**leaves), camera, target, renderer)
        pulls[name] = gradients(loss, leaves)["translation"].abs().max()
    assert pulls["own"] < 0.25 * pulls["moved"]


@pytest.mark.parametrize("renderer", RENDERERS)
def test_descending_the_gradient_brings_a_part_to_its_target(device, renderer):
    """It comes from either side, in x and in y. ``unit`` is the scene's in pixels."""
    size = (32, 32)
    camera = body_camera(size, False, device=device)
    if renderer == "mesh":
        corners, mesh = faces([[10, 10, 1], [20, 11, 1], [13, 21, 1]], [1], device)
        target, rate, decay, steps, unit = draw_on_screen(corners, mesh, size).labels, 0.5, 0.97, 120, 1
        shifts = [(7, 0), (-7, 0), (0, 7), (0, -7), (9, 8)]
    else:
        part = upright([(0, 0, 0)], [(0.3, 0.2, 0.2)], device)
        target, rate, decay, steps, unit = draw_ellipsoids(part, camera, size).labels, 0.02, 0.96, 100, 16
        shifts = [(0.2, 0), (-0.2, 0), (0, 0.2), (0, -0.2)]

    def loss_at(move):
        if renderer == "mesh":
            return loss_on_screen(corners + move, mesh, target)[0]
        return ellipsoid_label_loss(replace(part, centres=part.centres + move), camera, target, gradient=renderer)[0]

    for shift in shifts:
        move = torch.tensor([*shift, 0.0], device=device, requires_grad=True)
        optimizer = torch.optim.Adam([move], lr=rate)
        schedule = torch.optim.lr_scheduler.ExponentialLR(optimizer, decay)
        for _ in range(steps):
            loss = loss_at(move)
            optimizer.zero_grad()
            loss.sum().backward()
            optimizer.step()
            schedule.step()
        assert move.abs().max() * unit < 0.6, f"from {shift}: {loss.item()} pixels wrong at {move.tolist()}"


# --- Moving, mirroring, scaling -------------------------------------------------------------------------------------


@few
@given(seed=seeds)
@pytest.mark.parametrize("renderer", RENDERERS)
def test_moving_body_and_camera_together_changes_nothing(device, renderer, seed):
    """The moves are powers of two, which float32 adds without error, so that not a pixel may change."""
    camera = WeakPerspective(torch.tensor([16.0], device=device), torch.tensor([[24.0, 18.0]], device=device))
    target = target_of(seed, camera, renderer, device)
    found = []
    for shift in ((0.0, 0.0), (0.5, -0.25)):
        # On a grid coarse enough that centres, too, move without error.
        leaves = leaves_of(seed, device)
        posed = pose(**leaves)
        centres = (posed.centres * 2**16).round() / 2**16 + torch.tensor([*shift, 0.0], device=device)
        tensors, moved = leaves_of_parts(replace(posed, centres=centres))
        seen = WeakPerspective(camera.scale, camera.translation - 16.0 * torch.tensor([shift], device=device))
        loss = losses(moved, seen, target, renderer)
        found.append((loss.detach(), *gradients(loss, tensors).values()))
    assert_unchanged(found, 1, 1e-4)


@few
@given(seed=seeds, perspective=st.booleans())
@pytest.mark.parametrize("renderer", GRADIENTS)
def test_scaling_metres_scales_the_gradient_back(device, renderer, seed, perspective):
    """Twice the body and the distance and, where it is not perspective, half the pixels a metre: the same picture."""
    scene = random_scene(seed, SIZE, perspective)
    target = rolled_picture(scene, device)
    found = []
    for scale in (1.0, 2.0, 1024.0):
        camera = scene.camera * (1 if perspective else np.array([1 / scale, 1 / scale, 1, 1]))
        larger = replace(scene, centres=scale * scene.centres, semi_axes=scale * scene.semi_axes, camera=camera)
        leaves = Leaves.of(larger, device=device)
        loss, image = leaves.push_by_loss(target, gradient=renderer, depth_weight=0.0)
        centres, axes, semi_axes = (each.grad for each in vars(leaves.ellipsoids).values())
        found.append((image.parts, loss, scale * centres, axes, scale * semi_axes))
    assert_unchanged(found, 2, 2e-5)


def rolled_picture(scene, device):
    return Leaves.of(scene, device=device).draw(SIZE).labels.roll((2, -3), (1, 2))


@few
@given(seed=seeds, perspective=st.booleans())
def test_scaling_the_metres_of_a_mesh_changes_nothing(device, seed, perspective):
    """Vertices are in pixels already; depth in other units leaves picture and pulls as they are."""
    camera = body_camera(SIZE, perspective, device=device)
    target = target_of(seed, camera, "mesh", device)
    points = camera.project(pose(**body_parameters(seed, device)).vertices(LEVEL)).detach()
    found = []
    for scale in (1.0, 2.0, 1024.0):
        leaf = (points * torch.tensor([1.0, 1.0, scale], device=device)).requires_grad_()
        mesh = ellipbody_mesh(LEVEL, device=device)
        loss, image = push_on_screen(leaf, mesh, target, perspective=perspective, depth_weight=0.0)
        found.append((image.face_index, loss, leaf.grad))
    assert_unchanged(found, 2, 1e-5)


@few
@given(seed=seeds, perspective=st.booleans())
@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_mirror_swaps_left_and_right(device, renderer, seed, perspective):
    """Labels, loss and gradient, of bodies whose pose is mirrored too."""
    camera = body_camera((40, 48), perspective, device=device)
    swap = torch.from_numpy(mirror_order(PART_NAMES)).to(device)
    table = torch.cat([torch.zeros(1, dtype=torch.long, device=device), swap + 1])
    flip = torch.tensor([-1.0, 1.0, 1.0], device=device)
    there = leaves_of(seed, device)
    here = {name: value.detach().clone() for name, value in there.items()}
    for name in ("global_orient", "rotations"):
        here[name] = here[name] * flip[:, None] * flip
    here["rotations"] = here["rotations"][:, swap]
    here["translation"] = here["translation"] * flip
    here = {name: value.requires_grad_() for name, value in here.items()}
    picture, mirrored = (pictured(pose(**leaves), camera, renderer) for leaves in (there, here))
    # Its faces are not symmetric, and at a tie the lower of two left or right parts shows.
    agreed = (table[picture.long()].flip(2) == mirrored).float().mean()
    if renderer == "mesh":
        assert agreed > 0.97
        return
    assert agreed > 0.998
    target = target_of(seed, camera, renderer, device)
    known = torch.where(target == 255, target.long(), table[target.long().clamp_max(20)]).to(torch.uint8)
    fine = {"samples_per_pixel": 8.0} if renderer == "coverage" else {}
    loss = losses(pose(**there), camera, target, renderer, **fine)
    mirrored_loss = losses(pose(**here), camera, known.flip(2).contiguous(), renderer, **fine)
    assert abs(loss.item() - mirrored_loss.item()) <= 4
    want, have = gradients(loss, there), gradients(mirrored_loss, here)
    assert_alike(have["translation"] * flip, want["translation"], 0.02)
    assert_alike(have["lengths"], want["lengths"], 0.02)
    assert_alike(have["thicknesses"], want["thicknesses"], 0.02)
    assert_alike((have["rotations"] * flip[:, None] * flip)[:, swap], want["rotations"], 0.02)


def test_every_part_has_its_mirror_image():
    twins, parents = mirror_order(PART_NAMES), np.array(PARENTS)
    np.testing.assert_array_equal(twins[twins], np.arange(20))
    np.testing.assert_array_equal(parents[twins], np.where(parents < 0, parents, twins[parents]))


# --- Order and batches ----------------------------------------------------------------------------------------------


@few
@given(seed=seeds, perspective=st.booleans())
@pytest.mark.parametrize("renderer", GRADIENTS)
def test_order_of_ellipsoids_changes_ids_alone(device, renderer, seed, perspective):
    scene = random_scene(seed, SIZE, perspective)
    target = rolled_picture(scene, device)
    order = np.random.default_rng(seed).permutation(6)
    found = []
    for index in (np.arange(6), order):
        numbers = {name: getattr(scene, name)[index] for name in ("centres", "axes", "semi_axes")}
        leaves = Leaves.of(replace(scene, **numbers), device=device)
        loss, image = leaves.push_by_loss(target, part_labels=(index + 1).tolist(), gradient=renderer)
        grads, back = leaves.tensors(), np.argsort(index)
        found.append((image.labels, image.depth, loss, *(grads[name].grad[0][back] for name in numbers)))
    assert_unchanged(found, 3, 1e-4)


@few
@given(seed=seeds)
def test_order_of_faces_changes_indices_alone(device, seed):
    camera = body_camera(SIZE, False, device=device)
    points = camera.project(pose(**body_parameters(seed, device)).vertices(LEVEL)).detach()
    mesh = ellipbody_mesh(LEVEL, device=device)
    target = target_of(seed, camera, "mesh", device)
    order = torch.from_numpy(np.random.default_rng(seed).permutation(len(mesh.faces))).to(device)
    other = PartMesh.from_faces(mesh.faces[order].cpu().numpy(), mesh.face_labels[order].cpu().numpy(), device=device)
    found = []
    for each in (mesh, other):
        leaf = points.clone().requires_grad_()
        loss, image = push_on_screen(leaf, each, target)
        found.append((image.depth, image.labels, loss, leaf.grad))
    torch.testing.assert_close(found[1][0], found[0][0])
    # Faces of two parts may be equally near, where the lower index shows.
    assert (found[1][1] != found[0][1]).sum() <= 2
    assert abs(found[1][2] - found[0][2]).max() <= 4
    if torch.equal(found[1][1], found[0][1]):
        assert_alike(found[1][3], found[0][3], 1e-3)


@few
@given(seed=seeds, perspective=st.booleans(), batch=st.integers(2, 5), one_target=st.booleans())
@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_batch_equals_its_members_to_the_bit(device, renderer, seed, perspective, batch, one_target):
    """Each has a target, or all share one. On CUDA, PartDR's sums on meshes are made by atomics, whose order varies."""
    cameras = body_camera(SIZE, perspective, batch, device)
    one = body_camera(SIZE, perspective, 1, device)
    target = torch.cat([target_of(seed + b, one, renderer, device) for b in range(1 if one_target else batch)])
    posed = pose(**body_parameters(seed, device, batch))

    def found(part, camera):
        parts, body = leaves_of_parts(posed, part)
        loss, image = renderer_of(renderer).label_loss(body, camera, target if one_target else target[part])
        images = [getattr(image, field.name) for field in fields(image) if field.name != "maps"]
        return [loss.detach(), *images], gradients(loss, parts).values()

    whole = found(slice(0, batch), cameras)
    for b in range(batch):
        alone = found(slice(b, b + 1), one)
        assert all(torch.equal(have[b], want[0]) for have, want in zip(whole[0], alone[0], strict=True))
        for have, want in zip(whole[1], alone[1], strict=True):
            if device == "cuda" and renderer == "mesh":
                assert_alike(have[b], want[0], 1e-4)
            else:
                assert torch.equal(have[b], want[0])


# --- Resolution -----------------------------------------------------------------------------------------------------


RESOLUTION = {  # least cosine of the two gradients, and how much their lengths may differ
    "coverage": (0.995, 0.06),
    "edges": (0.985, 0.1),
    "partdr": (0.99, 0.5),
    "mesh": (0.99, 0.5),
}


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("perspective", CAMERAS)
def test_twice_the_picture_gives_the_same_normalised_gradient(device, renderer, perspective):
    """L_seg counts pixels, so a share of the picture's area is L / size². Its gradient is the same but for sampling.

    PartDR's distances are in pixels: its slope, a loss by a distance, takes one size less.
    """
    found = []
    for scale in (1, 2):
        size = (96 * scale, 112 * scale)
        mean = []
        for seed in range(3):
            camera = body_camera(size, perspective, device=device)
            leaves = leaves_of(seed, device)
            target = target_of(seed, camera, renderer, device, size)
            loss = losses(pose(**leaves), camera, target, renderer)
            mean.append(torch.cat([g.flatten() for g in gradients(loss, leaves).values()]) / scale**2)
        found.append(torch.stack(mean))
    coarse, fine = found
    similarity = torch.cosine_similarity(coarse, fine, dim=1)
    ratio = fine.norm(dim=1) / coarse.norm(dim=1)
    least, spread = RESOLUTION[renderer]
    assert similarity.min() > least, similarity
    assert ((ratio - 1).abs() < spread).all(), ratio


# --- Parts that are left out -----------------------------------------------------------------------------------------


def others_labels(device, labels):
    """Target of each of the two bodies: the picture of the other one."""
    return drawn_labels(bent_bodies(device).select(torch.tensor([1, 0], device=device)), labels, 96)


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_an_ellipsoid_left_out_is_as_if_it_were_not_there(device, gradient):
    posed, camera = bent_bodies(device).posed(), bent_bodies(device).camera(96)
    target = others_labels(device, label_set("ellipbody20"))
    kept = [part for part in range(20) if PART_NAMES[part] not in TIPS]
    found, grads = [], []
    for index, labels in (
        (list(range(20)), [part + 1 if part in kept else 0 for part in range(20)]),
        (kept, [part + 1 for part in kept]),
    ):
        parts = [tensor[:, index].detach().requires_grad_() for tensor in (posed.centres, posed.axes, posed.semi_axes)]
        leaves = Leaves(Ellipsoids(*parts), camera)
        loss, image = leaves.push_by_loss(target, part_labels=labels, gradient=gradient)
        found.append([loss, image.labels, image.depth])
        grads.append([tensor.grad for tensor in parts])
    assert all(torch.equal(have, want) for have, want in zip(*found, strict=True))
    for whole, few in zip(*grads, strict=True):
        torch.testing.assert_close(whole[:, kept], few, rtol=1e-5, atol=1e-3)
        assert (np.delete(whole.cpu().numpy(), kept, axis=1) == 0).all()


def test_faces_left_out_are_as_if_they_were_not_there(device):
    posed, camera = bent_bodies(device).posed(), bent_bodies(device).camera(96)
    vertices = camera.project(posed.vertices(1)).detach()
    mesh = ellipbody_mesh(1, device=device)
    few = mesh.relabel(WITHOUT_TIPS.part_groups)
    assert len(few.faces) == len(mesh.faces) * 16 // 20
    assert len(few.edges) == len(mesh.edges) * 16 // 20
    away = posed.vertices(1).clone()
    away.view(2, 20, -1, 3)[:, [PART_NAMES.index(name) for name in TIPS]] += 50.0  # [m], out of the picture
    table = np.where(WITHOUT_TIPS.part_groups == 0, 255, WITHOUT_TIPS.part_groups)
    table[0] = 0
    target = others_labels(device, WITHOUT_TIPS)
    found = []
    for shape, points in ((few, vertices), (mesh.relabel(table), camera.project(away).detach())):
        points = points.clone().requires_grad_()
        loss, image = push_on_screen(points, shape, target)
        found.append((loss, image.labels, points.grad))
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])
    torch.testing.assert_close(found[0][2], found[1][2], rtol=1e-5, atol=1e-3)
    assert draw_on_screen(vertices, few, (96, 96)).labels.max() <= 16
