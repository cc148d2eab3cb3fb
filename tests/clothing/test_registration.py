"""Registration of detailed bodies to EllipBody, and their files."""

from __future__ import annotations

import inspect
import io
import json
import math
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "demos"))

import edit_body

from warp_partdr.body.posing import Posed, pose
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import JOINT_NAMES, LENGTH_NAMES, NUM_PARTS, PARENTS, THICKNESS_NAMES, template
from warp_partdr.clothing.anny import anny, anny_shape
from warp_partdr.clothing.growth import MEASURES, UNGROWN, Growth
from warp_partdr.clothing.pose import pose_from_ellipbody
from warp_partdr.clothing.registration import (
    MATCHED_JOINTS,
    Registered,
    RegistrationOptions,
    RegistrationWeights,
    _Loss,
    _Tailor,
    register,
    shape_from_lengths,
)
from warp_partdr.clothing.surfaces import BAND, PartCells, _VertexCosts, skin_vertices, surface_samples, vertex_parts
from warp_partdr.results.skinned_files import bvh, glb, save_detailed

QUICK = RegistrationOptions(iterations=40)


def ellipbodies(
    device: str, count: int = 2, *, longer: dict[str, float] | None = None, thicker: dict[str, float] | None = None
) -> Posed:
    """Bodies in random poses near the rest pose, camera frame; one length or thickness times a factor."""
    generator = torch.Generator().manual_seed(0)
    turns = 0.3 * torch.randn(count, NUM_PARTS, 3, generator=generator)
    turns[:, :2] = 0
    lengths, thicknesses = (
        torch.tensor(values * [factors.get(name, 1.0) for name in names], dtype=torch.float32)
        for values, factors, names in (
            (template().mean_lengths, longer or {}, LENGTH_NAMES),
            (template().mean_thicknesses, thicker or {}, THICKNESS_NAMES),
        )
    )
    given = (
        torch.diag(torch.tensor([1.0, -1.0, -1.0])).repeat(count, 1, 1),
        torch.tensor([0.1, -0.2, 3.0]).repeat(count, 1),
        rotation_from_axis_angle(turns),
        lengths.repeat(count, 1),
        thicknesses.repeat(count, 1),
    )
    return pose(*(tensor.to(device) for tensor in given))


@pytest.fixture(scope="module")
def registered(device: str) -> Registered:
    return register(ellipbodies(device), anny(torch.device(device)), options=QUICK)


def test_the_mean_body_is_anny_s_default_adult(registered: Registered, device: str) -> None:
    # mean_body.json was measured on it.
    model, posed = registered.model, ellipbodies(device)
    joints = model.landmarks(registered.detailed, MATCHED_JOINTS)
    wanted = posed.joints[:, [JOINT_NAMES.index(name) for name in MATCHED_JOINTS]]
    assert (joints - wanted).norm(dim=-1).mean() < 0.01
    # To what the silhouettes of the two say about thicknesses.
    adult = model.rest(anny_shape(torch.full((2, 6), 0.5, device=device))).vertices
    found = model.rest(registered.shape).vertices
    assert (adult - adult.mean(1, keepdim=True) - found + found.mean(1, keepdim=True)).norm(dim=-1).mean() < 0.015


def test_the_result_poses_the_model(registered: Registered) -> None:
    again = registered.model.pose(
        registered.shape, registered.rotations, registered.translation, stretches=registered.stretches
    )
    assert torch.equal(again.vertices, registered.detailed.vertices)
    identity = registered.rotations @ registered.rotations.mT
    assert (identity - torch.eye(3, device=identity.device)).abs().max() < 1e-5
    assert all(term.shape == (2,) and term.isfinite().all() for term in registered.losses.values())


def test_refinement_lowers_the_loss(registered: Registered, device: str) -> None:
    start = register(ellipbodies(device), registered.model, options=RegistrationOptions(iterations=0))
    before, after = (torch.stack(list(result.losses.values())).sum(0) for result in (start, registered))
    assert (after < 0.7 * before).all()


def test_bodies_of_a_batch_do_not_touch_each_other(registered: Registered, device: str) -> None:
    posed = ellipbodies(device)
    alone = register(Posed(*(tensor[1:] for tensor in vars(posed).values())), registered.model, options=QUICK)
    assert (alone.detailed.vertices[0] - registered.detailed.vertices[1]).norm(dim=-1).max() < 2e-3


@pytest.fixture(scope="module")
def edits() -> tuple[list[edit_body.Body], list[Registered]]:
    body = edit_body.mean_body()
    bodies = [body.edited(edit) for edit in edit_body.EDITS]
    return bodies, edit_body.register_all(bodies)


def test_the_mesh_follows_edits_and_other_parts_stay(edits: tuple[list[edit_body.Body], list[Registered]]) -> None:
    for followed, others in edit_body.following(*edits):
        assert all(0.8 < share < 1.25 for share in followed.values()), followed
        assert all(share < 0.2 for share in others.values()), others


def test_growth_turns_no_face_over_and_makes_no_steps(
    edits: tuple[list[edit_body.Body], list[Registered]],
) -> None:
    first, *others = (result.rest().vertices[0] for result in edits[1])
    corners = edits[1][0].model.faces.long()
    skin = (skin_vertices(edits[1][0].model) > 0)[corners].all(1)

    def normals(vertices: torch.Tensor) -> torch.Tensor:
        edges = vertices[corners[:, 1:]] - vertices[corners[:, :1]]
        return torch.nn.functional.normalize(torch.linalg.cross(edges[:, 0], edges[:, 1]), dim=-1)

    starts, ends = corners.flatten(), corners.roll(-1, 1).flatten()
    for other in others:
        turned = (normals(first) * normals(other)).sum(-1)[skin]
        assert turned.min() > 0
        assert turned.mean() > 0.97
        # An edge is stretched by no more than the edit's factor and what is shared with the neighbours.
        ratios = (other[starts] - other[ends]).norm(dim=-1) / (first[starts] - first[ends]).norm(dim=-1)
        assert 0.55 < ratios.quantile(0.001) < ratios.quantile(0.999) < 1.8


def test_between_two_bodies_nothing_jumps() -> None:
    body = edit_body.mean_body()
    other = body
    for edit in edit_body.EDITS[1:4]:
        other = other.edited(edit)
    shares = torch.linspace(0, 1, 5).tolist()
    results = edit_body.register_all([body.toward(other, share) for share in shares])
    vertices = torch.cat([result.detailed.vertices for result in results])
    steps = vertices.diff(dim=0)
    whole = (vertices[-1] - vertices[0]).norm(dim=-1)
    assert whole.max() > 0.08
    assert (steps.norm(dim=-1) < whole / len(steps) + 0.012).all()
    assert steps.diff(dim=0).norm(dim=-1).max() < 0.02


def test_growth_is_seen_on_any_device(registered: Registered, device: str) -> None:
    options = replace(QUICK, iterations=10)
    longer = ellipbodies(device, longer={"lower leg": 1.2}, thicker={"head thickness": 1.3})
    edited = register(longer, registered.model, start=registered, options=options)
    names = [list(MEASURES).index(name) for name in ("lower leg", "head thickness")]
    assert (edited.growth[:, names] > torch.tensor([1.1, 1.15], device=device)).all()
    still = [list(MEASURES).index(name) for name in ("upper arm", "hand", "upper arm thickness", *UNGROWN)]
    assert (edited.growth[:, still] / registered.growth[:, still] - 1).abs().max() < 0.04
    alone = register(longer, registered.model, options=options)
    assert torch.equal(alone.growth, torch.ones_like(alone.growth))
    asked = register(longer, registered.model, options=replace(options, growth=True))
    assert (asked.growth[:, names[1]] > 1.15).all()


def test_growth_is_what_a_robust_fit_gives_up(registered: Registered, device: str) -> None:
    """Of a measure off by r, r³ / (r² + d²), d being what people differ by: hardly anything of what is usual."""
    model, shape = registered.model, registered.shape
    parts, areas = vertex_parts(model)
    posed = ellipbodies(device, longer={"lower leg": 1.02}, thicker={"head thickness": 1.3, "foot width": 0.8})
    tailor = _Tailor(model, posed, replace(QUICK, growth=True), parts, areas, shape, None)
    for _ in range(12):
        tailor.grow(shape)
    body = Growth(model, parts, areas, shape)
    off = body.demanded(posed.semi_axes) - body.measured(shape)
    wanted = off / (1 + (2 * body.spreads / off).square())
    got = body.measured(shape, tailor.stretches) - body.measured(shape)
    for name, low, high in (("lower leg", 0.0, 0.6), ("head thickness", 0.85, 1.0), ("foot width", 0.5, 0.95)):
        index = MEASURES.index(name)
        torch.testing.assert_close(got[:, index], wanted[:, index], rtol=0.02, atol=2e-3)
        shares = (wanted / off)[:, index]
        assert ((low < shares) & (shares < high)).all(), (name, shares)


def test_a_body_is_its_own_edit(registered: Registered, device: str) -> None:
    again = register(ellipbodies(device), registered.model, start=registered, options=QUICK)
    assert (again.detailed.vertices - registered.detailed.vertices).norm(dim=-1).mean() < 0.004
    assert (again.growth - 1).abs().max() < 0.02


def test_stretches_of_one_are_none_and_of_all_scale_the_body(device: str) -> None:
    model = anny(torch.device(device))
    shape = anny_shape(torch.tensor([[0.2, 0.9, 0.4, 0.6, 0.5, 0.5]], device=device))
    rest = model.rest(shape)
    whole = torch.eye(3, device=device).expand(1, NUM_PARTS, 3, 3)
    for factor in (1.0, 1.3):
        scaled = model.rest(shape, stretches=factor * whole)
        root = rest.joints[:, :1]
        assert (scaled.vertices - root - factor * (rest.vertices - root)).abs().max() < 1e-5
        assert (scaled.joints - root - factor * (rest.joints - root)).abs().max() < 1e-5
    # The measures of a body follow: lengths and thicknesses by the factor.
    body = Growth(model, *vertex_parts(model), shape)
    grown = body.stretches(torch.full((1, len(MEASURES)), 1.3, device=device))
    assert (body.measured(shape, grown) - body.measured(shape)).sub(math.log(1.3)).abs().max() < 1e-3


def test_inscribed_bodies_never_thin_the_person(device: str) -> None:
    thin = dict.fromkeys(THICKNESS_NAMES, 0.6)
    options = replace(QUICK, iterations=5, growth=True, weights=RegistrationWeights.inscribed())
    within = register(ellipbodies(device, thicker=thin), anny(torch.device(device)), options=options)
    assert (within.growth[:, len(LENGTH_NAMES) :] > 0.99).all()
    fitted = register(
        ellipbodies(device, thicker=thin), within.model, options=replace(QUICK, iterations=5, growth=True)
    )
    assert (fitted.growth[:, len(LENGTH_NAMES) :].amin(1) < 0.9).all()


def test_shape_from_lengths_is_exact_for_bodies_of_the_model(device: str) -> None:
    model = anny(torch.device(device))
    shape = anny_shape(torch.tensor([[0.2, 0.9, 0.4, 0.6, 0.5, 0.5]], device=device))
    rest = model.rest(shape)
    joints = model.landmarks(rest, JOINT_NAMES)
    posed = ellipbodies(device, 1)
    bones = (joints[:, 1:] - joints[:, [p + 1 for p in PARENTS]]).norm(dim=-1)
    semi_axes = posed.semi_axes.clone()
    semi_axes[..., 0] = bones / 2
    found = shape_from_lengths(model, replace(posed, semi_axes=semi_axes))
    joints = model.landmarks(model.rest(found), JOINT_NAMES)
    again = (joints[:, 1:] - joints[:, [p + 1 for p in PARENTS]]).norm(dim=-1)
    assert (again - bones).abs().max() < 0.005


def test_vertex_costs_against_torch(device: str) -> None:
    posed = ellipbodies(device, 2)
    vertices = (posed.centres[:, torch.arange(60) % 20] + 0.06 * torch.randn(2, 60, 3).to(device)).requires_grad_()
    parts = (torch.arange(60, device=device) % 20).int()
    areas = torch.rand(60).to(device)
    fit, inside = _VertexCosts.apply(vertices, parts, areas, posed, 0.03)

    local = (vertices[:, :, None] - posed.centres[:, None])[..., None, :] @ posed.axes[:, None]
    unit = local[..., 0, :] / posed.semi_axes[:, None]
    e = unit.norm(dim=-1)
    expected_inside = (areas * (1 - e).clamp(min=0).square().sum(-1)).sum(-1)
    own = torch.arange(60), parts.long()
    unit, e = unit[:, own[0], own[1]], e[:, own[0], own[1]]
    steep = (unit / posed.semi_axes[:, parts.long()] / e[..., None]).norm(dim=-1)
    squares = ((e - 1) / steep).square() * (unit[..., 0].detach().abs() < 0.7)
    expected_fit = (areas * squares / (1 + squares / 0.03**2)).sum(-1)
    assert torch.allclose(fit, expected_fit, rtol=1e-4)
    assert torch.allclose(inside, expected_inside, rtol=1e-4)
    for value, expected in ((fit, expected_fit), (inside, expected_inside)):
        factors = torch.tensor([1.0, 3.0], device=device)
        got, wanted = (
            torch.autograd.grad((factors * term).sum(), vertices, retain_graph=True)[0] for term in (value, expected)
        )
        assert torch.allclose(got, wanted, rtol=1e-3, atol=1e-4 * float(wanted.abs().max()))


def test_closest_points_are_on_the_same_part_of_the_same_body(device: str) -> None:
    model = anny(torch.device(device))
    posed = ellipbodies(device, 3)
    bodies = model.pose(posed.joints.new_zeros(3, 20), *pose_from_ellipbody(model, posed)).vertices
    samples, weights = surface_samples(posed)
    _, areas = vertex_parts(model)
    cells = PartCells(model, areas > 0, 3)
    for _ in range(2):  # the second time refits the mesh
        corners, places, found = cells.closest(bodies, samples, weights, 0.15)
        bodies = bodies + 0.001
    bodies = bodies - 0.001
    assert found[weights > 0].mean() > 0.95
    nearest = (bodies[torch.arange(3, device=device)[:, None, None], corners] * places[..., None]).sum(-2)
    distances = (nearest - samples).norm(dim=-1)
    count = samples.shape[1] // NUM_PARTS
    for body, k in ((0, 3), (1, 8), (2, 19)):
        faces = model.faces[(model.face_parts == k + 1) & (areas[model.faces.long()] > 0).all(1)].long()
        mesh = trimesh.Trimesh(bodies[body].cpu().numpy(), faces.cpu().numpy(), process=False)
        chosen = slice(k * count, (k + 1) * count)
        there = (found[body, chosen] > 0).cpu().numpy()
        assert there.any()
        centroids = mesh.triangles.mean(1)
        points = samples[body, chosen].cpu().numpy()[there]
        # No closer than to any vertex or centroid of the part, and near.
        bound = np.linalg.norm(points[:, None] - np.concatenate([mesh.triangles.reshape(-1, 3), centroids]), axis=-1)
        got = distances[body, chosen].cpu().numpy()[there]
        assert (got <= bound.min(1) + 1e-5).all()
        assert (got >= bound.min(1) - 0.03).all()


def far_apart(device: str) -> Posed:
    """Spheroids of many sizes, 10 m from each other; the second one is half within the first."""
    numbers = torch.arange(NUM_PARTS, device=device, dtype=torch.float32)
    centres = torch.stack([10 * numbers, 0 * numbers, 0 * numbers], dim=1)
    semi_axes = torch.stack([0.1 + 0.02 * numbers, 0.3 - 0.01 * numbers, 0.3 - 0.01 * numbers], dim=1)
    semi_axes[:2] = 0.2
    centres[1] = centres[0] + torch.tensor([0.0, 0.2, 0.0], device=device)
    axes = torch.eye(3, device=device).expand(1, NUM_PARTS, 3, 3)
    joints = torch.zeros(1, len(JOINT_NAMES), 3, device=device)
    return Posed(joints, axes, centres[None], axes, semi_axes[None])


def test_samples_share_the_area_that_shows(device: str) -> None:
    posed = far_apart(device)
    samples, weights = (tensor[0].cpu().double().numpy() for tensor in surface_samples(posed))
    samples, weights = samples.reshape(NUM_PARTS, -1, 3), weights.reshape(NUM_PARTS, -1)
    assert weights.sum() == pytest.approx(1)
    for own, other in ((0, 1), (1, 0)):
        covered = np.linalg.norm(samples[own] - posed.centres[0, other].cpu().numpy(), axis=1) < 0.2
        assert 0.2 < covered.mean() < 0.6
        np.testing.assert_array_equal(weights[own] == 0, covered)
    assert (weights[2:] > 0).all()
    # The zone |x| < BAND a of a spheroid: 2 pi b times the integral of sqrt(a² (1 - u²) + b² u²).
    u = np.linspace(-BAND, BAND, 1001)
    a, b = posed.semi_axes[0, 2:, :2].cpu().double().numpy().T[..., None]
    zones = (b * np.sqrt(a**2 * (1 - u**2) + b**2 * u**2)).mean(1)
    np.testing.assert_allclose(weights[2:].sum(1) / weights[2:].sum(), zones / zones.sum(), rtol=0.02)


def loss_of(device: str, options: RegistrationOptions) -> tuple[_Loss, dict[str, torch.Tensor]]:
    """Of bodies 4 cm beside their EllipBodies, of some shape and turned a little."""
    model, posed = anny(torch.device(device)), ellipbodies(device)
    generator = torch.Generator().manual_seed(1)
    shape = 0.1 * torch.randn(2, model.num_shapes, generator=generator).to(device)
    turns = 0.1 * torch.randn(2, 5, 3, generator=generator).to(device)
    pose_, translation = pose_from_ellipbody(model, posed, shape)
    detailed = model.pose(shape, pose_, translation + 0.04)
    loss = _Loss(model, posed, options)
    loss.search(detailed.vertices)
    return loss, {**loss(detailed, shape, turns), "vertices": detailed.vertices}


@pytest.mark.parametrize(
    ("name", "weighed"),
    [
        ("joints", ["joints"]),
        ("icp", ["icp_to_mesh", "icp_to_ellipsoids"]),
        ("penetration", ["penetration"]),
        ("shape", ["shape"]),
        ("pose", ["pose"]),
    ],
)
def test_weights_weigh_their_own_terms(name: str, weighed: list[str], device: str) -> None:
    even = RegistrationWeights(joints=1.0, icp=1.0, penetration=1.0, shape=1.0, pose=1.0)
    _, terms = loss_of(device, RegistrationOptions(weights=even))
    _, changed = loss_of(device, RegistrationOptions(weights=replace(even, **{name: 3.0})))
    for other, term in terms.items():
        assert (term.abs() > 0).any()
        torch.testing.assert_close(changed[other], term * (3.0 if other in weighed else 1.0))


def test_far_samples_count_less(device: str) -> None:
    """A sample's weight is the slope of Geman and McClure's cost of its squared distance."""
    options = RegistrationOptions(scale=0.02)
    loss, terms = loss_of(device, options)
    batch = torch.arange(2, device=device)[:, None, None]
    nearest = (terms["vertices"][batch, loss.corners] * loss.places[..., None]).sum(-2)
    squares = (nearest - loss.samples).square().sum(-1).detach().requires_grad_()
    cost = squares / (1 + squares / options.scale**2)
    (slope,) = torch.autograd.grad(cost.sum(), squares)
    near = loss.icp_weights > 0
    assert near.any()
    torch.testing.assert_close(loss.icp_weights[near], (loss.sample_weights * slope)[near], rtol=1e-4, atol=0)
    shares = (loss.icp_weights / loss.sample_weights)[near]
    assert shares.min() < 0.2
    assert shares.max() > 0.8


def test_what_is_in_the_mouth_is_no_skin(device: str) -> None:
    skin = skin_vertices(anny(torch.device(device)))
    assert 0.85 < skin.mean() < 0.95
    hands = vertex_parts(anny(torch.device(device)))[0] >= 18
    assert skin[hands].mean() == 1


def test_no_bodies(device: str) -> None:
    posed = Posed(*(tensor[:0] for tensor in vars(ellipbodies(device)).values()))
    result = register(posed, anny(torch.device(device)), options=QUICK)
    assert result.detailed.vertices.shape == (0, 13718, 3)


def test_bad_bodies_are_refused(device: str) -> None:
    model = anny(torch.device(device))
    posed = ellipbodies(device)
    broken = posed.joints.clone()
    broken[0, 3, 1] = float("nan")
    with pytest.raises(ValueError, match="joints: holds NaN"):
        register(replace(posed, joints=broken), model)
    with pytest.raises(ValueError, match=r"joints: torch\.float64; expected torch\.float32"):
        register(Posed(*(tensor.double() for tensor in vars(posed).values())), model)


def read_glb(data: bytes) -> tuple[dict, list[np.ndarray]]:
    """The JSON and the arrays of a GLB, by glTF 2.0's description."""
    magic, version, size = struct.unpack_from("<4sII", data)
    assert (magic, version, size) == (b"glTF", 2, len(data))
    length, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON"
    document = json.loads(data[20 : 20 + length])
    body = data[20 + length + 8 :]
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        dtype = {5126: np.float32, 5123: np.uint16, 5125: np.uint32}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        values = np.frombuffer(body, dtype, accessor["count"] * width, view["byteOffset"])
        arrays.append(values.reshape(accessor["count"], width))
    return document, arrays


def standing(registered: Registered, points: torch.Tensor) -> np.ndarray:
    """Camera frame to the files': y up, the lowest vertex at 0."""
    flip = np.array([1.0, -1.0, -1.0])
    lowest = (registered.detailed.vertices[0].cpu().numpy() * flip)[:, 1].min()
    return points.cpu().numpy() * flip - [0.0, lowest, 0.0]


def test_glb_s_skin_gives_the_posed_mesh(registered: Registered) -> None:
    data = glb(registered)
    document, arrays = read_glb(data)
    # trimesh follows the nodes; the skin is applied here.
    scene = trimesh.load(io.BytesIO(data), file_type="glb")
    skin = document["skins"][0]
    names = [document["nodes"][joint]["name"] for joint in skin["joints"]]
    world = np.stack([scene.graph.get(name)[0] for name in names])
    joints = standing(registered, registered.detailed.joints[0])
    assert np.abs(world[:, :3, 3] - joints).max() < 1e-4
    inverse_bind = arrays[skin["inverseBindMatrices"]].reshape(-1, 4, 4).transpose(0, 2, 1)
    attributes = document["meshes"][0]["primitives"][0]["attributes"]
    bind, bones, weights = (arrays[attributes[name]] for name in ("POSITION", "JOINTS_0", "WEIGHTS_0"))
    assert np.abs(weights.sum(1) - 1).max() < 1e-5
    blended = np.einsum("vk,vkij->vij", weights, (world @ inverse_bind)[bones])
    posed = (blended[:, :3] @ np.column_stack([bind, np.ones(len(bind))])[..., None])[..., 0]
    assert np.abs(posed - standing(registered, registered.detailed.vertices[0])).max() < 1e-4
    assert next(iter(scene.geometry.values())).faces.shape == (27420, 3)


def test_obj_and_ply_read_back(registered: Registered, tmp_path: Path) -> None:
    save_detailed(registered, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {f"detailed.{kind}" for kind in ("glb", "obj", "ply", "bvh")}
    expected = standing(registered, registered.detailed.vertices[0])
    for kind in ("obj", "ply"):
        mesh = trimesh.load(tmp_path / f"detailed.{kind}", process=False)
        assert mesh.faces.shape == (27420, 3)
        assert np.abs(mesh.triangles - expected[registered.model.faces.cpu().numpy()]).max() < 1e-4


def test_bvh_has_the_skeleton_where_it_is(registered: Registered) -> None:
    words = iter(bvh(registered).split())
    names, offsets, parents, channels, stack = [], [], [], [], []
    for word in words:
        if word in ("ROOT", "JOINT"):
            parents.append(stack[-1] if stack else -1)
            names.append(next(words))
        elif word == "End":
            next(words)
            names.append("")
            parents.append(stack[-1])
        elif word == "{":
            stack.append(len(names) - 1)
        elif word == "}":
            stack.pop()
        elif word == "OFFSET":
            offsets.append([float(next(words)) for _ in range(3)])
        elif word == "CHANNELS":
            channels.append((len(names) - 1, [next(words) for _ in range(int(next(words)))]))
        elif word == "Time:":
            next(words)
            break
    values = iter(map(float, words))
    world: dict[int, np.ndarray] = {}
    for joint, given in channels:
        local = np.eye(4)
        local[:3, 3] = offsets[joint]
        for channel in given:
            value = next(values)
            if channel.endswith("position"):
                local["XYZ".index(channel[0]), 3] += value
            else:
                local[:3, :3] = local[:3, :3] @ Rotation.from_euler(channel[0].lower(), value, degrees=True).as_matrix()
        world[joint] = (world[parents[joint]] if parents[joint] >= 0 else np.eye(4)) @ local
    assert next(values, None) is None
    joints = standing(registered, registered.detailed.joints[0])
    for joint, matrix in world.items():
        expected = 100 * joints[registered.model.joint_names.index(names[joint])]
        assert np.abs(matrix[:3, 3] - expected).max() < 0.01


def test_the_command_writes_its_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image
    from typer.testing import CliRunner

    from warp_partdr.cli.main import app
    from warp_partdr.errors import InputError
    from warp_partdr.results.body_file import BodyFile
    from warp_partdr.results.save import DETAILED_FILES

    body = BodyFile(
        global_orient=np.diag([1.0, -1.0, -1.0]),
        translation=np.zeros(3),
        rotations=np.tile(np.eye(3), (NUM_PARTS, 1, 1)),
        lengths=template().mean_lengths,
        thicknesses=template().mean_thicknesses,
        camera_scale=np.array(100.0),
        camera_translation=np.zeros(2),
        image_size=np.array([400, 300]),
    )
    body.save(tmp_path / "body.npz")
    monkeypatch.chdir(tmp_path)
    Image.new("RGB", (300, 400), "white").save("photo.png")
    line = ["register", "body.npz", "--photo", "photo.png", "--out", "detailed", "--device", "cpu"]
    done = CliRunner().invoke(app, line)
    assert done.exit_code == 0, done.output
    assert "detailed/detailed.png" in done.output
    names = {path.name for path in (tmp_path / "detailed").iterdir()}
    assert names == set(DETAILED_FILES)
    with Image.open("detailed/detailed.png") as shown:
        assert shown.size == (300, 400)
        assert shown.getpixel((299, 0)) == (255, 255, 255)
    with np.load(tmp_path / "detailed" / "detailed.npz", allow_pickle=False) as saved:
        model = anny()
        takes = [name for name in inspect.signature(model.pose).parameters if name in saved]
        again = model.pose(**{name: torch.from_numpy(saved[name])[None] for name in takes})
    mesh = trimesh.load(tmp_path / "detailed" / "detailed.ply", process=False)
    assert abs(np.ptp(again.vertices[0, :, 1].numpy()) - mesh.extents[1]) < 1e-4

    Image.new("RGB", (400, 300)).save("photo.png")
    for wrong, says in (
        (["--model", "nobody.npz"], "--model: nobody.npz"),
        (["--model", "none"], "--model: none"),
        (["--photo", "photo.png"], "body: 300x400; photo: 400x300"),
        (["--out", "body.npz"], "body.npz: Not a directory"),
    ):
        refused = CliRunner().invoke(app, ["register", "body.npz", *wrong])
        assert isinstance(refused.exception, InputError)
        assert says in str(refused.exception)
    assert not (tmp_path / "out").exists()
