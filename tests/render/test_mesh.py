"""The mesh renderer against the float64 reference, on every device."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import warp as wp
from helpers.pictures import (
    CAMERAS,
    draw_on_screen,
    faces,
    loss_on_screen,
    mesh_picture,
    mesh_scene,
    noisy_picture,
    projected_bodies,
    push_on_screen,
    relative_error,
)

from warp_partdr.cameras import Perspective
from warp_partdr.kernels.labels import HIDDEN, MISSING, NUM_EXTENTS, SURPLUS, DenseGradient, LabelTarget
from warp_partdr.kernels.launch import get_num_threads, launch_in_slices, set_num_threads
from warp_partdr.kernels.mesh import push_xy, push_z, rasterize, resolve
from warp_partdr.kernels.mesh.forces import make_vertex_forces
from warp_partdr.kernels.mesh.triangles import ImageArrays, MeshArrays
from warp_partdr.reference import mesh as reference
from warp_partdr.reference.losses import label_gradient
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh

SIZES = [(21, 34), (30, 17)]


def random_scene(seed: int, size: tuple[int, int], device: str, cull: bool = False) -> tuple[torch.Tensor, PartMesh]:
    """Two bodies of overlapping triangles of four parts, some far outside the picture."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-0.3, 1.3, (2, 10, 3, 2)) * size[::-1]
    corners = corners.mean(2, keepdims=True) + (corners - corners.mean(2, keepdims=True)) * 0.8
    vertices = np.concatenate([corners, rng.uniform(1, 3, (2, 10, 3, 1))], -1).reshape(2, -1, 3)
    index = np.arange(30).reshape(-1, 3)
    index[1::2, :2] = index[::2, [2, 1]]  # every other pair of faces shares an edge
    mesh = PartMesh.from_faces(index, np.repeat(rng.integers(1, 5, 5), 2), cull_backfaces=cull, device=device)
    return torch.tensor(vertices, dtype=torch.float32, device=device, requires_grad=True), mesh


@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.parametrize("perspective", CAMERAS)
@pytest.mark.parametrize("size", SIZES)
def test_forward_is_the_reference(device, size, perspective, cull):
    flips = pixels = 0
    for seed in range(4):
        vertices, mesh = random_scene(seed, size, device, cull)
        image = draw_on_screen(vertices, mesh, size, perspective=perspective)
        for b in range(len(vertices)):
            want = reference.rasterize(mesh_scene(vertices[b], mesh, perspective), size)
            have = mesh_picture(image, b)
            same = have.face_index == want.face_index
            flips += (~same).sum()
            pixels += same.size
            np.testing.assert_array_equal(have.labels[same], want.labels[same])
            np.testing.assert_allclose(have.depth[same], want.depth[same], rtol=1e-5)
    # A centre within float32 rounding of an edge may fall on the other side.
    assert flips <= pixels * 2e-4


@pytest.mark.parametrize("scale", [30.0, 3e3])
def test_large_and_thin_faces_lose_no_pixel(device, scale):
    """Rows are cut where the faces' edges cross them: what rounding may add to a row must not be missing."""
    size, rng = (24, 32), np.random.default_rng(0)
    ends = rng.normal(0, scale, (10, 2))
    thin = ends + rng.normal(0, 8, (10, 2))
    corners = np.stack([ends, -ends, thin], 1) + np.array([16, 12])  # each runs right across the picture
    vertices, mesh = faces(np.concatenate([corners, rng.uniform(1, 3, (10, 3, 1))], -1), np.arange(1, 11), device)
    image = draw_on_screen(vertices, mesh, size)
    want = reference.rasterize(mesh_scene(vertices[0], mesh), size).labels
    assert (want > 0).any()
    assert (image.labels[0].cpu().numpy() != want).sum() <= 1


def check_gradient(leaf, scene, image, g, b=0, **rule):
    want = reference.gradient(scene, mesh_picture(image, b), g, **rule)
    have = leaf.grad[b].cpu().numpy()
    assert relative_error(have[:, :2], want[:, :2]) < 1e-4
    assert relative_error(have[:, 2], want[:, 2]) < 1e-4


@pytest.mark.parametrize(("max_distance", "cull"), [(np.inf, False), (2.5, False), (np.inf, True)])
@pytest.mark.parametrize("perspective", CAMERAS)
def test_dense_gradient_is_the_reference(device, perspective, max_distance, cull):
    for seed, size in enumerate(SIZES):
        leaf, mesh = random_scene(seed, size, device, cull)
        rule = {"max_distance": max_distance, "depth_weight": 0.7}
        image = draw_on_screen(leaf, mesh, size, perspective=perspective, num_maps=4, near=0.01, **rule)
        g = torch.randn(image.maps.shape, generator=torch.Generator().manual_seed(seed))
        (image.maps * g.to(device)).sum().backward()
        for b in range(len(leaf)):
            check_gradient(leaf, mesh_scene(leaf[b], mesh, perspective), image, g[b].double().numpy(), b, **rule)


@pytest.mark.parametrize("frontal", [False, True])
@pytest.mark.parametrize("perspective", CAMERAS)
def test_label_loss_gradient_is_the_reference_on_ellipbody(device, perspective, frontal):
    """Seen from the front, 56 of the mean body's 400 faces have no area in the picture."""
    size = (40, 32)
    leaf, mesh = projected_bodies(3, size, device, perspective, frontal=frontal)
    scene = mesh_scene(leaf[0], mesh, perspective)
    if frontal and not perspective:
        assert sum(reference.cross(*scene.vertices[face]) == 0 for face in scene.faces) == 56
    target = noisy_picture(draw_on_screen(leaf, mesh, size, perspective=perspective).labels, 20, 0)
    loss, image = push_on_screen(leaf, mesh, target, perspective=perspective)
    g = label_gradient(image.labels[0].cpu().numpy(), target[0].cpu().numpy(), 20)
    check_gradient(leaf, scene, image, g)
    assert loss.item() == pytest.approx((np.abs(g).sum() / 2), rel=1e-5)


def test_slices_cover_the_batch_once():
    assert get_num_threads() >= 1
    try:
        set_num_threads(3)
        for batch in (0, 1, 2, 3, 10):
            seen = []
            launch_in_slices(seen.append, batch, wp.get_device("cpu"))
            assert sorted(b for part in seen for b in range(batch)[part]) == list(range(batch))
            assert len(seen) == (3 if batch == 10 else 1)

        def fail(part: slice) -> None:
            if part.start > 0:
                raise RuntimeError("in a thread")

        with pytest.raises(RuntimeError, match="in a thread"):
            launch_in_slices(fail, 6, wp.get_device("cpu"))
        with pytest.raises(ValueError, match="count: -1"):
            set_num_threads(-1)
    finally:
        set_num_threads(0)


def arrays_of(points: torch.Tensor, mesh: PartMesh) -> MeshArrays:
    arrays = MeshArrays()
    arrays.vertices, arrays.faces = wp.from_torch(points, dtype=wp.vec3), wp.from_torch(mesh.faces, dtype=wp.vec3i)
    arrays.face_labels, arrays.edges = wp.from_torch(mesh.face_labels), wp.from_torch(mesh.edges)
    arrays.near, arrays.perspective = -np.inf, False
    return arrays


def test_a_z_buffer_serves_again_and_what_nobody_asked_for_stays(device):
    """Two pictures through one z-buffer are those through fresh ones; without background, depth is where parts show."""
    size = (40, 56)
    zbuffer = rasterize.ZBuffer.make(2, *size, wp.get_device(device))
    for seed in (1, 2):
        points, mesh = projected_bodies(seed, size, device, subdivisions=1, batch=2)
        want = draw_on_screen(points, mesh, size)
        labels, depth = torch.zeros_like(want.labels), torch.full_like(want.depth, -5.0)
        images = ImageArrays()
        images.labels, images.depth = wp.from_torch(labels), wp.from_torch(depth)
        rasterize.launch_draw_faces(arrays_of(points, mesh), zbuffer)
        resolve.launch_resolve_keys(arrays_of(points, mesh), zbuffer, images, background=False)
        assert torch.equal(labels, want.labels)
        assert torch.equal(depth, torch.where(want.labels > 0, want.depth, -5.0))
        assert (zbuffer.keys.numpy() >> np.uint64(32) == 0xFFFFFFFF).all()
        assert not zbuffer.touched.numpy().any()


@pytest.mark.parametrize("labels_end", [7, 60])
@pytest.mark.parametrize("offset", [0, 1])
@pytest.mark.parametrize("size", [(20, 24), (21, 34), (6, 300), (4, 131), (1, 1)])
def test_labels_are_compared_at_any_width_and_address(device, size, offset, labels_end):
    """Four at a time where memory allows it; loss and extents are those of single pixels, extents rounded to blocks."""
    rng = np.random.default_rng(size[1])
    height, width = size
    shown = rng.integers(0, labels_end, (2, *size)).astype(np.uint8)
    wanted = np.where(rng.random(shown.shape) < 0.05, rng.integers(0, labels_end, shown.shape), shown)
    wanted = np.where(rng.random(shown.shape) < 0.1, 255, wanted).astype(np.uint8)

    def image_at(offset: int) -> torch.Tensor:
        return torch.full((shown.size + offset,), 77, dtype=torch.uint8, device=device)[offset:].view(shown.shape)

    labels, target = image_at(offset), LabelTarget()
    target.target = wp.from_torch(image_at(1 - offset).copy_(torch.from_numpy(wanted)))
    target.extents = wp.zeros((2, NUM_EXTENTS, labels_end), dtype=wp.vec4i, device=device)
    squares = rasterize.num_squares(height, width)
    hidden = wp.empty((2, squares[0] * squares[1], 32), dtype=wp.uint32, device=device)
    losses = wp.full((2, squares[0] * squares[1]), np.nan, dtype=wp.float32, device=device)
    mesh, images = MeshArrays(), ImageArrays()  # of a face for each label
    mesh.face_labels = wp.array(np.arange(labels_end), dtype=wp.uint8, device=device)
    mesh.vertices = wp.empty((2, 0), dtype=wp.vec3, device=device)
    images.labels, images.faults = wp.from_torch(labels), wp.full(2, np.nan, dtype=wp.float32, device=device)
    labels.zero_()
    zbuffer = rasterize.ZBuffer.make(2, *size, wp.get_device(device))
    zbuffer.keys.assign(np.where(shown > 0, shown, rasterize.EMPTY_KEY))
    padded = np.pad(shown, ((0, 0), (0, -height % 16), (0, -width % 32)))
    zbuffer.touched.assign(padded.reshape(2, squares[0], 16, squares[1], 32).any((2, 4)))
    resolve.launch_compare_labels(mesh, zbuffer, images, target, hidden=hidden, losses=losses)
    assert np.array_equal(labels.cpu().numpy(), shown)
    assert (zbuffer.keys.numpy() >> np.uint64(32) == 0xFFFFFFFF).all()
    assert not zbuffer.touched.numpy().any()
    assert not images.faults.numpy().any()
    wrong = (shown != wanted) & (wanted != 255)
    costs = ((shown > 0).astype(int) + (wanted > 0)) * wrong
    np.testing.assert_allclose(losses.numpy().sum(1), costs.sum((1, 2)), rtol=1e-5)
    rows, columns = np.arange(4)[:, None], np.arange(4)  # of a block's pixel, whose bit is 7 - row of byte column
    hides = (hidden.numpy().reshape(2, *squares, 4, 8, 1, 1) >> (8 * columns + 7 - rows).astype(np.uint32)) & 1
    hides = hides.transpose(0, 1, 3, 5, 2, 4, 6).reshape(2, 16 * squares[0], 32 * squares[1])
    assert np.array_equal(hides[:, :height, :width], wrong & (shown > 0) & (wanted > 0))
    assert hides.sum() == hides[:, :height, :width].sum()
    for b in range(2):
        for label in range(1, labels_end):
            missing, surplus = (wrong[b] & (image[b] == label) for image in (wanted, shown))
            kinds = {MISSING: missing, SURPLUS: surplus, HIDDEN: missing & (shown[b] != 0)}
            for kind, pixels in kinds.items():
                have = target.extents.numpy()[b, int(kind), label]
                rows, columns = (np.flatnonzero(pixels.any(axis)) // 4 for axis in (1, 0))
                want = [0, 0, 0, 0]
                if pixels.any():
                    want = [height - 4 * rows[0], 4 * rows[-1] + 4, width - 4 * columns[0], 4 * columns[-1] + 4]
                assert have.tolist() == np.minimum(want, [height, height, width, width]).tolist()


@pytest.mark.parametrize("how", ["lanes", "threads", "launches"])
def test_how_work_is_shared_changes_nothing(device, monkeypatch, how):
    size = (40, 57)
    leaf, mesh = projected_bodies(6, size, device, subdivisions=1, batch=5)
    target = noisy_picture(draw_on_screen(leaf, mesh, size).labels, 20, 2)

    def results() -> list[torch.Tensor]:
        other = projected_bodies(6, size, device, subdivisions=1, batch=5)[1]  # a mesh that no captured graph knows
        loss, image = loss_on_screen(leaf, other, target)
        (through_labels,) = torch.autograd.grad(loss.sum(), leaf)
        maps = draw_on_screen(leaf, other, size, num_maps=20).maps
        (general,) = torch.autograd.grad((maps * torch.arange(1, 21, device=device)[:, None, None]).sum(), leaf)
        return [image.labels, image.depth, image.face_index, loss, through_labels, general]

    want = results()
    threads = []
    if how == "lanes":
        for module in (rasterize, push_z):
            monkeypatch.setattr(module, "row_lane_bits", lambda count, device: 2)
    elif how == "threads":
        real, shared = rasterize.launch_bodies, {"push_edges": 37}

        def launch(kernel: wp.Kernel, batch: int, count: int, *rest: object) -> None:
            threads.append(shared.get(kernel.key, count))
            real(kernel, batch, threads[-1], *rest)

        monkeypatch.setattr(push_xy, "launch_bodies", launch)
    else:
        monkeypatch.setattr(rasterize, "_MAX_THREADS", 4000)
    have = results()
    assert how != "threads" or 37 in threads
    assert all(torch.equal(a, b) for a, b in zip(have, want, strict=True))


@pytest.mark.parametrize("num_faces", [2**16, 2**16 + 1])
def test_keys_have_room_for_two_faces_of_a_mesh_or_a_map_has_one(device, num_faces):
    """Up to 65,536 faces, a gradient has no face-index map. Faces beside the picture change nothing."""
    size = (40, 57)
    leaf, mesh = projected_bodies(6, size, device, subdivisions=1, batch=2)
    target = noisy_picture(draw_on_screen(leaf, mesh, size).labels, 20, 2)
    first, count = leaf.shape[1], num_faces - len(mesh.faces)
    strip = torch.arange(count + 2, device=device)
    beside = torch.stack([-9.0 - strip % 2, 0.01 * strip, torch.ones_like(strip)], 1).expand(2, -1, -1)
    more = torch.cat([leaf.detach(), beside], 1).requires_grad_()
    indices = first + np.arange(count)[:, None] + np.arange(3)
    indices = np.concatenate([indices, mesh.faces.cpu().numpy()])
    labels = np.concatenate([np.full(count, 20), mesh.face_labels.cpu().numpy()])
    larger = PartMesh.from_faces(indices, labels, device=device)
    weights = torch.arange(1, 21, device=device)[:, None, None]

    def gradients(leaf: torch.Tensor, mesh: PartMesh) -> list[torch.Tensor]:
        loss = loss_on_screen(leaf, mesh, target)[0].sum()
        maps = draw_on_screen(leaf, mesh, size, num_maps=20).maps
        return [torch.autograd.grad(each, leaf)[0][:, :first] for each in (loss, (maps * weights).sum())]

    for have, want in zip(gradients(more, larger), gradients(leaf, mesh), strict=True):
        assert want[..., 2].abs().max() > 0
        torch.testing.assert_close(have, want)


@pytest.mark.parametrize("rule", [{"depth_weight": 0.7}, {"gradient": "edges"}])
def test_gradients_repeat_to_the_bit(device, rule):
    """Forces are whole numbers, so that their sum is the same in any order, as threads of CUDA add them."""
    size = (96, 70)
    leaf, mesh = projected_bodies(5, size, device, subdivisions=2, batch=3)
    target = noisy_picture(draw_on_screen(leaf, mesh, size).labels, 20, 2)
    weights = torch.arange(1, 21, device=device)[:, None, None]

    def gradients() -> list[torch.Tensor]:
        loss = loss_on_screen(leaf, mesh, target, **rule)[0].sum()
        maps = draw_on_screen(leaf, mesh, size, num_maps=20, **rule).maps
        return [torch.autograd.grad(each, leaf)[0] for each in (loss, (maps * weights).sum())]

    want = gradients()
    assert all(each.abs().max() > 0 for each in want)
    for _ in range(4):
        assert all(torch.equal(a, b) for a, b in zip(gradients(), want, strict=True))


@pytest.mark.parametrize("power", [-70, -30, 30, 90])
def test_gradients_keep_their_digits_whatever_their_size(device, power):
    """A loss in other units, by a power of two, has the gradient in these, bit for bit."""
    leaf, mesh = random_scene(3, SIZES[0], device)
    maps = draw_on_screen(leaf, mesh, SIZES[0], num_maps=4).maps
    g = torch.randn(maps.shape, generator=torch.Generator().manual_seed(0)).to(device)
    (plain,) = torch.autograd.grad(maps, leaf, g, retain_graph=True)
    (scaled,) = torch.autograd.grad(maps, leaf, g * 2.0**power)
    assert plain.abs().max() > 0
    assert torch.equal(scaled, plain * 2.0**power)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_loss_gradient_that_is_no_number_spoils_its_body_s(device, value):
    leaf, mesh = random_scene(3, SIZES[0], device)
    maps = draw_on_screen(leaf, mesh, SIZES[0], num_maps=4).maps
    g = torch.ones_like(maps)
    g[1] = value
    (gradient,) = torch.autograd.grad(maps, leaf, g, retain_graph=True)
    assert gradient[0].isfinite().all()
    assert gradient[1].isnan().all()
    (again,) = torch.autograd.grad(maps, leaf, torch.ones_like(maps))
    assert torch.equal(again[0], gradient[0])
    assert again.isfinite().all()


def test_hidden_pixels_serve_again(device):
    """A second z pass with the same scratch adds the same once more."""
    size = (40, 56)
    points, mesh = projected_bodies(3, size, device, subdivisions=1, batch=2)
    image = draw_on_screen(points, mesh, size)
    images = ImageArrays()
    images.labels, images.face_index = wp.from_torch(image.labels), wp.from_torch(image.face_index)
    gradient = DenseGradient()
    gradient.maps = wp.from_torch(torch.randn(2, 20, *size, device=device))
    keys = rasterize.empty_keys((2, *size), wp.get_device(device))
    faults = wp.zeros(2, dtype=float, device=device)
    forces = make_vertex_forces(size, points.shape[1], len(mesh.edges), faults, depth_slope=push_z.MAX_SLOPE)
    sums = []
    for label in (4, 7, 4, 7):
        gradient.label = label
        push_z.launch_push_depths(arrays_of(points, mesh), images, gradient, keys=keys, hidden=None, forces=forces)
        assert (keys.numpy() >> np.uint64(32) == 0xFFFFFFFF).all()
        sums.append(forces.sums.numpy().copy())
    assert np.abs(sums[0]).max() > 0
    assert not np.array_equal(sums[0], sums[1])
    np.testing.assert_array_equal(sums[3], 2 * sums[1])


@pytest.mark.parametrize("middle", [8.0, 7.5])
def test_shared_edges_are_drawn_once(device, middle):
    """A fan of triangles tiles a square exactly: no pixel is missed, and the fill rule gives each to one face."""
    size = (16, 16)
    # On pixel corners, or on centres, with edges of all eight directions through others. So are the rim's vertices.
    rim = [[x + 0.5, y + 0.5, 1.0] for x, y in [(0, 0), (7, 0), (15, 0), (15, 7), (15, 15), (7, 15), (0, 15), (0, 7)]]
    fan = [faces([[middle, middle, 1.0], rim[k - 1], rim[k]], [1], device) for k in range(8)]
    drawn = sum(draw_on_screen(*each, size).labels[0].int() for each in fan).cpu().numpy()
    assert (drawn[1:15, 1:15] == 1).all()
    assert drawn.max() == 1


def test_equal_depths_go_to_the_lower_face(device):
    image = draw_on_screen(*faces([[[1, 1, 2], [14, 2, 2], [5, 13, 2]]] * 2, [2, 1], device), (16, 16))
    assert set(image.labels.unique().tolist()) == {0, 2}
    assert image.depth[image.labels > 0].eq(2.0).all()


def test_an_empty_batch_has_empty_pictures(device):
    vertices, mesh = projected_bodies(4, (20, 24), device)
    leaf = vertices.detach()[:0].requires_grad_()
    _, image = push_on_screen(leaf, mesh, torch.zeros(0, 20, 24, dtype=torch.uint8, device=device))
    assert image.labels.shape == (0, 20, 24)
    assert leaf.grad.shape == (0, *vertices.shape[1:])


def test_faces_at_the_camera_are_left_out(device):
    camera = Perspective(torch.tensor([[20.0, 20.0]], device=device), torch.tensor([[10.0, 10.0]], device=device))
    points, mesh = faces([[-1, -1, 0], [1, -1, 2], [0, 1, 2]], [1], device)
    assert draw_mesh(points, mesh, camera, (20, 20)).labels.eq(0).all()


def test_parts_in_no_group_cost_nothing_but_still_hide(device):
    """A face relabelled to 255 draws as 255: no loss, no gradient, yet what lies behind it stays hidden."""
    front, back = [[2, 2, 1], [12, 2, 1], [6, 12, 1]], [[2, 2, 2], [14, 2, 2], [6, 14, 2]]
    vertices, mesh = faces([front, back], [1, 2], device)
    mesh = mesh.relabel({1: 255, 2: 1})
    assert mesh.num_labels == 1
    loss, image = push_on_screen(vertices, mesh, torch.zeros(1, 16, 16, dtype=torch.uint8, device=device))
    assert set(image.labels.unique().tolist()) == {0, 1, 255}
    assert loss.item() == (image.labels == 1).sum().item()
    assert (vertices.grad[0, :3] == 0).all()
    assert (vertices.grad[0, 3:] != 0).any()


# --- Topology, and which pixels a face's border gives it -------------------------------------------------------------


def test_edges_of_three_faces_stand_alone():
    """Three faces of a part that meet are no pairs: each may be the silhouette."""
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    edges = PartMesh.from_faces(faces, np.array([1, 1, 1])).edges.tolist()
    shared = sorted(edge[2:] for edge in edges if edge[:2] == [0, 1])
    assert shared == [[0, -1, 2, 2], [1, -1, 3, 3], [2, -1, 4, 4]]
    assert len(edges) == 3 + 6
    assert all(edge[3] == -1 for edge in edges)


def test_edges_of_two_faces_are_one_where_they_show_one_part():
    faces = np.array([[0, 1, 2], [1, 0, 3]])
    one, two = (PartMesh.from_faces(faces, np.array(labels)).edges.tolist() for labels in ([1, 1], [1, 2]))
    assert [edge for edge in one if edge[:2] == [0, 1]] == [[0, 1, 0, 1, 2, 3]]
    assert sorted(edge for edge in two if edge[:2] == [0, 1]) == [[0, 1, 0, -1, 2, 2], [0, 1, 1, -1, 3, 3]]
    assert (len(one), len(two)) == (5, 6)


@pytest.mark.parametrize("order", [[0, 1, 2], [0, 2, 1], [2, 0, 1]])
def test_a_border_on_pixel_centres_belongs_to_one_face(device, order):
    """An edge that goes down, or level to the left, belongs to the face, in whatever order its corners are given."""
    vertices = torch.tensor([[[2.5, 2.5, 1.0], [8.5, 2.5, 1.0], [2.5, 8.5, 1.0]]], device=device)
    mesh = PartMesh.from_faces(np.array([order]), np.array([1]), device=device)
    rows, columns = np.mgrid[:12, :12]
    inside = (columns > 2) & (rows > 2) & (columns + rows <= 10)
    np.testing.assert_array_equal(draw_on_screen(vertices, mesh, (12, 12)).labels[0].cpu().numpy(), inside)
    turned = torch.tensor([[[8.5, 8.5, 1.0], [2.5, 8.5, 1.0], [8.5, 2.5, 1.0]]], device=device)
    inside = (columns <= 8) & (rows <= 8) & (columns + rows > 10)
    np.testing.assert_array_equal(draw_on_screen(turned, mesh, (12, 12)).labels[0].cpu().numpy(), inside)


@pytest.mark.parametrize("perspective", CAMERAS)
def test_nobody_sees_the_backfaces_of_closed_surfaces(device, perspective):
    """Picture, loss and gradient are the same without them; of a mirrored body the insides show, of an open one all."""
    size = (60, 50)
    leaf, mesh = projected_bodies(4, size, device, perspective, subdivisions=1, batch=2)
    culled = replace(mesh, cull_backfaces=True)
    want, have = (draw_on_screen(leaf, each, size, perspective=perspective) for each in (mesh, culled))
    assert torch.equal(want.face_index, have.face_index)
    target = noisy_picture(want.labels, 20, 0)
    found = []
    for each in (mesh, culled):
        again = leaf.detach().clone().requires_grad_()
        loss, _ = push_on_screen(again, each, target, perspective=perspective, gradient="edges")
        found.append((loss, again.grad))
    assert torch.equal(found[0][0], found[1][0])
    torch.testing.assert_close(found[0][1], found[1][1])

    mirrored = leaf.detach().clone()
    mirrored[..., 0] = size[1] - mirrored[..., 0]
    inside = draw_on_screen(mirrored, culled, size, perspective=perspective)
    outside = draw_on_screen(mirrored, mesh, size, perspective=perspective)
    assert torch.equal(inside.labels > 0, outside.labels > 0)
    assert (inside.depth[inside.labels > 0] > outside.depth[inside.labels > 0]).float().mean() > 0.9

    assert culled.relabel(np.arange(21)).cull_backfaces
    assert culled.repeated(2, 20, leaf.shape[1]).cull_backfaces
    assert not culled.relabel(np.arange(21) * (np.arange(21) != 4)).cull_backfaces
