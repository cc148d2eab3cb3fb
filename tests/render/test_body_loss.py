"""L_seg and maps from parameters, by graphs: what kinematics, camera and renderer give one after the other."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import torch

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_6d, rotation_from_axis_angle, rotation_to_6d
from warp_partdr.body.template import LOCKED_PARTS
from warp_partdr.cameras import Camera, Perspective, WeakPerspective
from warp_partdr.interop.graph_cache import set_graph_memory
from warp_partdr.networks.regression.predicted import Predicted, posed_landmarks
from warp_partdr.render.body_passes import BodyPasses
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.renderers import Renderer, RendererEllipsoids, RendererMesh

SIZE = (56, 48)
RENDERERS = [
    *(RendererEllipsoids("edges"), RendererEllipsoids("coverage"), RendererEllipsoids("partdr")),
    *(RendererMesh(1), RendererMesh(1, gradient="edges")),
]
renderers = pytest.mark.parametrize("renderer", RENDERERS, ids=["edges", "coverage", "partdr", "mesh", "mesh-edges"])


def bodies(seed: int, device: str, batch: int = 3) -> BodyParameters:
    """Bodies that differ in everything."""
    generator = torch.Generator().manual_seed(seed)
    mean = BodyParameters.mean(batch, device=device)
    spread = {
        "orientation": 0.2,
        "rotations": 0.4,
        "lengths": 0.01,
        "thicknesses": 0.01,
        "log_scale": 0.1,
        "shift": 0.1,
    }
    moved = {
        name: tensor + (spread.get(name, 0.1) * torch.randn(tensor.shape, generator=generator)).to(device)
        for name, tensor in mean.tensors().items()
    }
    return replace(BodyParameters(**moved), log_scale=moved["log_scale"] - 0.2)


def pose_arguments(given: BodyParameters) -> list[torch.Tensor]:
    """Arguments of ``pose``, the pelvis at the origin."""
    pelvis = torch.zeros_like(given.lengths[:, :3])
    return [given.orientation, pelvis, given.rotations, given.lengths, given.thicknesses]


def seen_bodies(
    given: BodyParameters, kind: str, whole: torch.Tensor, turns: torch.Tensor
) -> tuple[list[torch.Tensor], Camera]:
    """Leaves: arguments of ``pose`` with these rotations, and the numbers of a camera, which comes with them."""
    far = torch.tensor([0.05, -0.1, 2.5], device=whole.device).expand(len(whole), 3)
    cameras = 20 * given.log_scale.exp(), 20 * (given.shift + 1)
    if kind == "perspective":
        cameras = 60 * torch.stack([given.log_scale.exp(), (1.1 * given.log_scale).exp()], 1), cameras[1]
    numbers = whole, far, turns, given.lengths, given.thicknesses, *cameras
    leaves = [tensor.detach().clone().requires_grad_() for tensor in numbers]
    return leaves, (WeakPerspective if kind == "weak" else Perspective)(*leaves[5:])


def maps_scene(seed: int, device: str, batch: int = 3, kind: str = "weak") -> tuple[list[torch.Tensor], Camera]:
    """Leaves and camera of bodies, rotations as numbers."""
    given = bodies(seed, device, batch)
    return seen_bodies(given, kind, given.orientation, given.free_rotations())


def map_gradients(maps: torch.Tensor, leaves: list[torch.Tensor]) -> list[torch.Tensor]:
    """Gradients of maps whose pixels have any weights, but for the pelvis' depth, which a weak camera does not see."""
    weights = torch.rand(maps.shape, generator=torch.Generator().manual_seed(7)).to(maps.device) - 0.3
    found = torch.autograd.grad(maps, leaves, weights)
    return [found[0], found[1][:, :2], *found[2:]]


def targets(device: str, size: tuple[int, int] = SIZE, batch: int = 3) -> torch.Tensor:
    """Labels of other bodies."""
    others = bodies(100, device, batch)
    side = torch.full((batch,), 20.0, device=device)
    middle = torch.tensor([size[1] / 2, size[0] / 2], device=device).expand(batch, 2)
    return draw_ellipsoids(others.posed(), WeakPerspective(side, middle), size).labels


def gradients(loss: torch.Tensor, leaves: list[torch.Tensor]) -> list[torch.Tensor]:
    """Loss, and its gradients with a factor for each body."""
    factors = torch.arange(1.0, 1 + len(loss), device=loss.device)
    return [loss.detach(), *torch.autograd.grad(loss @ factors, leaves)]


def assert_near(have: list[torch.Tensor], want: list[torch.Tensor]) -> None:
    """Equal to rounding, and not zero."""
    for one, other in zip(have, want, strict=True):
        assert other.abs().max() > 0
        torch.testing.assert_close(one, other, rtol=1e-4, atol=2e-5 * float(other.abs().max()))


@renderers
@pytest.mark.parametrize("form", ["matrices", "axis-angle", "6D", "mixed"])
@pytest.mark.parametrize("kind", ["weak", "perspective"])
def test_body_loss_equals_posing_and_drawing_apart(device, renderer, form, kind):
    """It holds for each form of rotations and kind of camera, when launched, captured and replayed."""
    target, wrong = targets(device), []
    for seed in range(3):
        given = bodies(seed, device)
        turns, whole = given.free_rotations(), rotation_from_6d(given.orientation)
        if form != "axis-angle":
            turns = rotation_from_axis_angle(turns)
        if form in ("6D", "axis-angle"):
            whole = given.orientation  # the camera looks at faces: half a turn has many axes
        if form == "6D":
            turns = rotation_to_6d(turns)
        leaves, camera = seen_bodies(given, kind, whole, turns)
        have = gradients(renderer.body_loss(leaves[:5], camera, target), leaves)
        want = gradients(renderer.label_loss(pose(*leaves[:5]), camera, target)[0], leaves)
        used = [i for i in range(8) if i != 2 or kind == "perspective" or have[2].abs().max() > 0]
        assert_near([have[i] for i in used], [want[i] for i in used])
        wrong.append(have[0])
    assert not torch.equal(wrong[1], wrong[2])


@renderers
def test_crop_loss_equals_posing_and_drawing_apart(device, renderer):
    """``BodyParameters`` and predictions, whose cameras are numbers of the crop."""
    target = targets(device, (48, 48))
    for seed in range(3):
        given = bodies(seed, device)
        matrices = rotation_from_6d(given.orientation), rotation_from_axis_angle(given.free_rotations())
        sizes = given.lengths, given.thicknesses, given.log_scale, given.shift
        predicted = Predicted(*(t.clone().requires_grad_() for t in (*matrices, *sizes)))
        for each in (given.leaves(), predicted):
            leaves = [value for value in vars(each).values() if value is not None]
            have = gradients(renderer.crop_loss(each, target), leaves)
            want = gradients(renderer.label_loss(each.posed(), each.camera(48), target)[0], leaves)
            assert_near(have, want)
    hips = have_hips(given, renderer, target)
    assert not hips.any()


def have_hips(given: BodyParameters, renderer: Renderer, target: torch.Tensor) -> torch.Tensor:
    """Gradient of the rotations of bones that stay where they are."""
    leaves = given.leaves()
    (gradient,) = torch.autograd.grad(renderer.crop_loss(leaves, target).sum(), leaves.rotations)
    return gradient[:, :2]


def test_body_loss_takes_groups_and_one_camera_for_all(device):
    given, target = bodies(0, device), (targets(device) > 0).to(torch.uint8)
    camera = WeakPerspective(torch.tensor([20.0], device=device), torch.tensor([[24.0, 28.0]], device=device))
    parameters = pose_arguments(given)
    for renderer in RENDERERS:
        leaves = [tensor.clone().requires_grad_() for tensor in parameters]
        options = {"part_labels": [1] * 20}
        have = renderer.body_loss(leaves, camera, target[:1], **options)
        want = renderer.label_loss(pose(*leaves), camera, target[:1], **options)[0]
        assert_near(gradients(have, leaves[2:]), gradients(want, leaves[2:]))


def test_body_loss_chooses_the_level_of_its_mesh(device):
    given, target = bodies(0, device), targets(device)
    parameters = pose_arguments(given)
    camera = WeakPerspective(20 * given.log_scale.exp(), 20 * (given.shift + 1))
    automatic = RendererMesh("auto", tolerance=0.3)
    want = RendererMesh(automatic.fixed(pose(*parameters), camera).subdivisions).body_loss(parameters, camera, target)
    assert torch.equal(automatic.body_loss(parameters, camera, target), want)


@pytest.mark.parametrize("dtype", [torch.float64, torch.bfloat16])
def test_other_precisions_keep_their_dtype(device, dtype):
    given, target = bodies(0, device).leaves(), targets(device)
    leaves = [tensor.detach().to(dtype).requires_grad_() for tensor in pose_arguments(given)]
    middle = torch.full((3, 2), 24.0, device=device, dtype=dtype)
    camera = WeakPerspective(middle[:, 0], middle)
    loss = RENDERERS[0].body_loss(leaves, camera, target)
    for gradient, leaf in zip(torch.autograd.grad(loss.sum(), leaves), leaves, strict=True):
        assert gradient.dtype == leaf.dtype == dtype


def test_autocast_changes_no_bit(device):
    given, target = bodies(0, device), targets(device, (48, 48))
    want = gradients(RENDERERS[0].crop_loss(leaves := given.leaves(), target), list(leaves.tensors().values()))
    with torch.autocast(torch.device(device).type, dtype=torch.bfloat16):
        have = gradients(RENDERERS[0].crop_loss(leaves := given.leaves(), target), list(leaves.tensors().values()))
    assert all(torch.equal(one, other) for one, other in zip(have, want, strict=True))


@renderers
def test_parts_that_do_not_turn_change_no_loss(device, renderer):
    given, target = bodies(0, device), targets(device, (48, 48))
    turned = given.rotations.clone()
    turned[:, list(LOCKED_PARTS)] += 0.5
    want, have = renderer.crop_loss(given, target), renderer.crop_loss(replace(given, rotations=turned), target)
    assert torch.equal(have, want)


@renderers
def test_compiled_losses_have_the_eager_gradients(device, renderer):
    given, target = bodies(0, device, 2), targets(device, (40, 40), 2)
    leaves = list(given.leaves().tensors().values())

    def loss_of(*tensors):
        return renderer.crop_loss(BodyParameters(*tensors), target).sum()

    torch._dynamo.reset()
    have = torch.autograd.grad(torch.compile(loss_of, fullgraph=True, backend="aot_eager")(*leaves), leaves)
    assert_near(list(have), list(torch.autograd.grad(loss_of(*leaves), leaves)))


def test_threads_change_no_bit():
    target = targets("cpu", (48, 48))
    given = [bodies(seed, "cpu") for seed in range(4)]

    def answer(each: BodyParameters) -> list[torch.Tensor]:
        leaves = each.leaves()
        return gradients(RENDERERS[0].crop_loss(leaves, target), list(leaves.tensors().values()))

    want = [answer(each) for each in given]
    with ThreadPoolExecutor(3) as pool:
        for _ in range(10):
            for have, expected in zip(pool.map(answer, given), want, strict=True):
                assert all(torch.equal(one, other) for one, other in zip(have, expected, strict=True))


def test_two_devices_agree_to_the_bit():
    if torch.cuda.device_count() < 2:
        pytest.skip("needs two CUDA devices")
    want = None
    for device in ("cuda:0", "cuda:1", "cuda:0"):
        leaves = bodies(0, device).leaves()
        target = targets(device, (48, 48))
        found = gradients(RENDERERS[0].crop_loss(leaves, target), list(leaves.tensors().values()))
        assert all(each.device == torch.device(device) for each in found)
        want = want or [each.cpu() for each in found]
        assert all(torch.equal(each.cpu(), other) for each, other in zip(found, want, strict=True))


def test_a_side_stream_changes_no_bit(device):
    if device == "cpu":
        pytest.skip("the CPU has no streams")
    target = targets(device, (48, 48))
    leaves = bodies(0, device).leaves()
    want = gradients(RENDERERS[0].crop_loss(leaves, target), list(leaves.tensors().values()))
    torch.cuda.synchronize()
    side = torch.cuda.Stream()
    with torch.cuda.stream(side):
        for _ in range(4):
            torch.cuda._sleep(1_000_000)
            have = gradients(RENDERERS[0].crop_loss(leaves, target), list(leaves.tensors().values()))
    side.synchronize()
    assert all(torch.equal(one, other) for one, other in zip(have, want, strict=True))


def test_what_inference_mode_made_serves_training(device):
    """Graphs and constants that are first asked for in it."""
    target, size = targets(device, (33, 33)), 33
    with torch.inference_mode():
        for _ in range(3):
            given = bodies(0, device)
            inside = RENDERERS[0].crop_loss(given, target)
            drawn = draw_ellipsoids(given.posed(), given.camera(size), (size, size)).labels
            posed_landmarks(given.posed(), ("left_heel",))
    for _ in range(3):
        leaves = bodies(0, device).leaves()
        loss = RENDERERS[0].crop_loss(leaves, target)
        (loss.sum() + leaves.free_rotations().sum() + leaves.posed().joints.sum()).backward()
        posed_landmarks(leaves.posed(), ("left_heel",)).sum().backward()
        assert all(tensor.grad is not None for tensor in leaves.tensors().values())
        assert torch.equal(loss, inside)
        assert torch.equal(draw_ellipsoids(leaves.posed(), leaves.camera(size), (size, size)).labels, drawn)


def test_losses_without_graphs_are_the_same(device):
    target = targets(device, (48, 48))
    leaves = bodies(0, device).leaves()
    captured = [gradients(RENDERERS[0].crop_loss(leaves, target), list(leaves.tensors().values())) for _ in range(3)]
    try:
        set_graph_memory(0)
        launched = gradients(RENDERERS[0].crop_loss(leaves, target), list(leaves.tensors().values()))
    finally:
        set_graph_memory(None)
    assert all(torch.equal(one, other) for one, other in zip(captured[2], launched, strict=True))


def test_bad_calls_name_the_argument(device):
    given, target = bodies(0, device), targets(device)
    good = pose_arguments(given)
    camera = WeakPerspective(torch.full((3,), 20.0, device=device), torch.full((3, 2), 24.0, device=device))
    loss = RENDERERS[0].body_loss
    for _ in range(3):  # launched, captured, replayed
        loss(good, camera, target)
        for index, value, message in [
            (0, good[0][:, :5], "global_orient: shape"),
            (2, good[2][:, :19], "rotations: shape"),
            (2, torch.full_like(good[2], torch.nan), "rotations: holds NaN"),
            (2, torch.zeros(3, 20, 3, 3, device=device), "rotations: matrix"),
            (3, -good[3], "lengths: -"),
            (4, good[4] * 1e13, "thicknesses: holds"),
        ]:
            with pytest.raises(ValueError, match=message):
                loss([*good[:index], value, *good[index + 1 :]], camera, target)
        with pytest.raises(ValueError, match="target: batch 2"):
            loss(good, camera, target[:2])
        with pytest.raises(ValueError, match="target: label 21"):
            RendererMesh(1).body_loss(good, camera, torch.full_like(target, 21))
    with pytest.raises(NotImplementedError, match="body_loss: called under"):
        torch.func.grad(lambda lengths: loss([*good[:3], lengths, good[4]], camera, target).sum())(good[3])
    leaves = given.leaves()
    total = RENDERERS[0].crop_loss(leaves, targets(device, (48, 48))).square().sum()
    (first,) = torch.autograd.grad(total, leaves.lengths, create_graph=True)
    with pytest.raises(NotImplementedError, match="differentiated twice"):
        first.sum().backward()


@renderers
@pytest.mark.parametrize("kind", ["weak", "perspective"])
@pytest.mark.parametrize("batch", [1, 3, 4])
def test_body_maps_equal_posing_and_drawing_apart(device, renderer, batch, kind):
    """It holds for batches that threads share and others, when launched, captured and replayed."""
    seen = []
    for seed in range(3):
        leaves, camera = maps_scene(seed, device, batch, kind)
        have = renderer.body_maps(leaves[:5], camera, SIZE)
        want = renderer.draw(pose(*leaves[:5]), camera, SIZE, num_maps=20).maps
        assert torch.equal(have, want)
        assert_near(map_gradients(have, leaves), map_gradients(want, leaves))
        seen.append(have)
    assert not torch.equal(seen[1], seen[2])


@renderers
def test_maps_of_others_drawn_in_between_change_no_gradient(device, renderer):
    """The same graphs draw other bodies between some maps and their gradient. Gradients that are kept stay."""
    alone = []
    for seed in (0, 1, 2):
        leaves, camera = maps_scene(seed, device)
        one_by_one = map_gradients(renderer.body_maps(leaves[:5], camera, SIZE), leaves)
        alone.append([gradient.clone() for gradient in one_by_one])
    scenes = [maps_scene(seed, device) for seed in (0, 1, 2)]
    maps = [renderer.body_maps(leaves[:5], camera, SIZE) for leaves, camera in scenes]
    found = [map_gradients(one, leaves) for one, (leaves, _) in reversed(list(zip(maps, scenes, strict=True)))]
    for have, want in zip(reversed(found), alone, strict=True):
        assert_near(have, want)


@renderers
def test_maps_are_captured(device, renderer, monkeypatch):
    """Nothing is prepared in a third call; without room for graphs, all is the same."""
    leaves, camera = maps_scene(0, device)

    def found() -> list[torch.Tensor]:
        maps = renderer.body_maps(leaves[:5], camera, (52, 44))
        return [maps.detach(), *map_gradients(maps, leaves)]

    try:
        set_graph_memory(0)
        without = [found() for _ in range(3)][2]
    finally:
        set_graph_memory(None)
    for _ in range(2):
        found()
    monkeypatch.setattr(BodyPasses, "_prepare", None)
    captured = found()
    assert_near(without, captured)
    leaves, camera = maps_scene(1, device)
    assert not torch.equal(found()[0], captured[0])


def test_body_maps_take_groups_and_one_camera_for_all(device):
    leaves, _ = maps_scene(0, device)
    camera = WeakPerspective(torch.tensor([20.0], device=device), torch.tensor([[24.0, 28.0]], device=device))
    options = {"part_labels": [*[1] * 5, 0, 255, *[3] * 13], "num_maps": 4}
    for renderer in RENDERERS:
        have = renderer.body_maps(leaves[:5], camera, SIZE, **options)
        want = renderer.draw(pose(*leaves[:5]), camera, SIZE, **options).maps
        assert torch.equal(have, want)
        assert have.shape == (3, 4, *SIZE)
        assert_near(map_gradients(have, leaves[:5]), map_gradients(want, leaves[:5]))
        nobody = [tensor[:0] for tensor in leaves[:5]]
        assert renderer.body_maps(nobody, camera, SIZE).shape == (0, 20, *SIZE)


def test_body_maps_choose_the_level_of_their_mesh(device):
    leaves, camera = maps_scene(0, device)
    automatic = RendererMesh("auto", tolerance=0.3)
    fixed = automatic.fixed(pose(*leaves[:5]), camera)
    want = fixed.body_maps(leaves[:5], camera, SIZE)
    assert torch.equal(automatic.body_maps(leaves[:5], camera, SIZE), want)


def test_maps_work_in_other_precisions_and_without_gradients(device):
    leaves, camera = maps_scene(0, device)
    double = [tensor.detach().double().requires_grad_() for tensor in leaves]
    have = RENDERERS[0].body_maps(double[:5], WeakPerspective(*double[5:]), SIZE)
    assert have.dtype == torch.float32
    found = map_gradients(have, double)
    assert all(gradient.dtype == torch.float64 for gradient in found)
    assert_near([each.float() for each in found], map_gradients(have_single(leaves, camera), leaves))
    with torch.inference_mode():
        assert torch.equal(have_single(leaves, camera), have)
    with torch.no_grad():
        assert not have_single(leaves, camera).requires_grad


def have_single(leaves: list[torch.Tensor], camera: Camera) -> torch.Tensor:
    """Maps in single precision."""
    return RENDERERS[0].body_maps(leaves[:5], camera, SIZE)


@renderers
def test_compiled_maps_are_the_eager_ones(device, renderer):
    leaves, _ = maps_scene(0, device, 2)

    def maps_of(*tensors):
        return renderer.body_maps(tensors[:5], WeakPerspective(*tensors[5:]), (40, 40), validate=False)

    torch._dynamo.reset()
    have = torch.compile(maps_of, fullgraph=True, backend="aot_eager")(*leaves)
    want = maps_of(*leaves)
    assert torch.equal(have, want)
    assert_near(map_gradients(have, leaves), map_gradients(want, leaves))


def test_a_side_stream_changes_no_bit_of_the_gradients_of_maps(device):
    if device == "cpu":
        pytest.skip("the CPU has no streams")
    leaves, camera = maps_scene(0, device)
    want = map_gradients(have_single(leaves, camera), leaves)
    torch.cuda.synchronize()
    side = torch.cuda.Stream()
    with torch.cuda.stream(side):
        for _ in range(4):
            torch.cuda._sleep(1_000_000)
            have = map_gradients(have_single(leaves, camera), leaves)
    side.synchronize()
    assert all(torch.equal(one, other) for one, other in zip(have, want, strict=True))


def test_bad_calls_for_maps_name_the_argument(device):
    leaves, camera = maps_scene(0, device)
    good, maps = leaves[:5], RENDERERS[0].body_maps
    for _ in range(3):  # launched, captured, replayed
        maps(good, camera, SIZE)
        for index, value, message in [
            (1, good[1][:, :2], "translation: shape"),
            (2, torch.full_like(good[2], torch.nan), "rotations: holds NaN"),
            (2, torch.zeros(3, 20, 3, 3, device=device), "rotations: matrix"),
            (4, -good[4], "thicknesses: -"),
        ]:
            with pytest.raises(ValueError, match=message):
                maps([*good[:index], value, *good[index + 1 :]], camera, SIZE)
        with pytest.raises(ValueError, match="camera: holds NaN"):
            maps(good, WeakPerspective(leaves[5] * torch.nan, leaves[6]), SIZE)
    for size, options, message in [
        ((0, 4), {}, "image_size: "),
        (SIZE, {"num_maps": 0}, "num_maps: 0"),
        (SIZE, {"num_maps": 255}, "num_maps: 255"),
        (SIZE, {"part_labels": [1, 2]}, "part_labels: 2 of them"),
    ]:
        with pytest.raises(ValueError, match=message):
            maps(good, camera, size, **options)
    with pytest.raises(NotImplementedError, match="body_maps: called under"):
        torch.func.grad(lambda lengths: maps([*good[:3], lengths, good[4]], camera, SIZE).sum())(good[3])
    (first,) = torch.autograd.grad(maps(good, camera, SIZE).square().sum(), good[3], create_graph=True)
    with pytest.raises(NotImplementedError, match="body_maps: differentiated twice"):
        first.sum().backward()
