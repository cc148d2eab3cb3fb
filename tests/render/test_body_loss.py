"""L_seg from parameters in one graph: what kinematics, camera and renderer give one after the other."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
import torch

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import pose
from warp_partdr.body.rotations import rotation_from_6d, rotation_from_axis_angle, rotation_to_6d
from warp_partdr.cameras import Perspective, WeakPerspective
from warp_partdr.interop.graph_cache import set_graph_memory
from warp_partdr.network.predicted import Predicted, posed_landmarks
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.renderers import Renderer, RendererEllipsoids, RendererMesh

SIZE = (56, 48)
RENDERERS = [RendererEllipsoids("edges"), RendererEllipsoids("coverage"), RendererEllipsoids("partdr"), RendererMesh(1)]
renderers = pytest.mark.parametrize("renderer", RENDERERS, ids=["edges", "coverage", "partdr", "mesh"])


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
def test_as_one_after_the_other(device, renderer, form, kind):
    """For each form of rotations and kind of camera, three times: launched, captured, replayed."""
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
        far = torch.tensor([0.05, -0.1, 2.5], device=device).expand(3, 3)
        cameras = 20 * given.log_scale.exp(), 20 * (given.shift + 1)
        if kind == "perspective":
            cameras = 60 * torch.stack([given.log_scale.exp(), (1.1 * given.log_scale).exp()], 1), cameras[1]
        make = WeakPerspective if kind == "weak" else Perspective
        leaves = [
            t.detach().clone().requires_grad_() for t in (whole, far, turns, given.lengths, given.thicknesses, *cameras)
        ]
        camera = make(*leaves[5:])
        have = gradients(renderer.body_loss(leaves[:5], camera, target), leaves)
        want = gradients(renderer.label_loss(pose(*leaves[:5]), camera, target)[0], leaves)
        used = [i for i in range(8) if i != 2 or kind == "perspective" or have[2].abs().max() > 0]
        assert_near([have[i] for i in used], [want[i] for i in used])
        wrong.append(have[0])
    assert not torch.equal(wrong[1], wrong[2])


@renderers
def test_of_crops(device, renderer):
    """``BodyParameters`` and predictions, whose cameras are numbers of the crop."""
    target = targets(device, (48, 48))
    for seed in range(3):
        given = bodies(seed, device)
        matrices = rotation_from_6d(given.orientation), rotation_from_axis_angle(given.free_rotations())
        sizes = given.lengths, given.thicknesses, given.log_scale, given.shift
        predicted = Predicted(*(t.clone().requires_grad_() for t in (*matrices, *sizes)))
        for each in (given.leaves(), predicted):
            leaves = list(vars(each).values())
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


def test_groups_and_one_camera_for_all(device):
    given, target = bodies(0, device), (targets(device) > 0).to(torch.uint8)
    camera = WeakPerspective(torch.tensor([20.0], device=device), torch.tensor([[24.0, 28.0]], device=device))
    parameters = pose_arguments(given)
    for renderer in RENDERERS:
        leaves = [tensor.clone().requires_grad_() for tensor in parameters]
        options = {"part_labels": [1] * 20}
        have = renderer.body_loss(leaves, camera, target[:1], **options)
        want = renderer.label_loss(pose(*leaves), camera, target[:1], **options)[0]
        assert_near(gradients(have, leaves[2:]), gradients(want, leaves[2:]))


def test_a_mesh_of_its_own_level(device):
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


def test_under_autocast(device):
    given, target = bodies(0, device), targets(device, (48, 48))
    want = gradients(RENDERERS[0].crop_loss(leaves := given.leaves(), target), list(leaves.tensors().values()))
    with torch.autocast(torch.device(device).type, dtype=torch.bfloat16):
        have = gradients(RENDERERS[0].crop_loss(leaves := given.leaves(), target), list(leaves.tensors().values()))
    assert all(torch.equal(one, other) for one, other in zip(have, want, strict=True))


@renderers
def test_compiled(device, renderer):
    given, target = bodies(0, device, 2), targets(device, (40, 40), 2)
    leaves = list(given.leaves().tensors().values())

    def loss_of(*tensors):
        return renderer.crop_loss(BodyParameters(*tensors), target).sum()

    torch._dynamo.reset()
    whole = isinstance(renderer, RendererEllipsoids)  # a mesh is looked up in between
    have = torch.autograd.grad(torch.compile(loss_of, fullgraph=whole, backend="aot_eager")(*leaves), leaves)
    assert_near(list(have), list(torch.autograd.grad(loss_of(*leaves), leaves)))


def test_on_many_threads():
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


def test_on_two_devices():
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


def test_on_a_side_stream(device):
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


def test_without_graphs(device):
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
