"""Model only what a scene requires: what is left out changes nothing else, and a fit says what it left out."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
import torch
from rich.console import Console
from scenes import draw_on_screen, loss_on_screen, refine_by_autograd

from warp_partdr import label_set
from warp_partdr.body.labels import LabelSet
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import PART_NAMES
from warp_partdr.fit.explain import explain, print_choices
from warp_partdr.fit.fitting import fit_body
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.stages import Stage
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import Observation
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.refinement.captured import CapturedRefinement
from warp_partdr.refinement.energy import Energy
from warp_partdr.refinement.refine import refine
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.part_mesh import ellipbody_mesh
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh

SIZE = 96
TIPS = ("left_hand", "right_hand", "left_foot", "right_foot")
WITHOUT_TIPS = LabelSet(
    "tipless",
    {name: (name,) for name in PART_NAMES if name not in TIPS},
    {0: "background", **{part: name for part, name in enumerate(PART_NAMES, start=1) if name not in TIPS}},
    left_out=TIPS,
)
GRADIENTS = ["edges", "coverage", "partdr"]


def bodies(device: str = "cpu", batch: int = 2) -> BodyParameters:
    mean = BodyParameters.mean(batch, device=device)
    generator = torch.Generator().manual_seed(4)
    bend = 0.3 * torch.randn(mean.rotations.shape, generator=generator).to(device)
    return replace(mean, rotations=bend, log_scale=mean.log_scale - 0.1)


def target_of(body: BodyParameters, labels: LabelSet, size: int = SIZE) -> torch.Tensor:
    parts = [int(label) for label in labels.part_groups[1:]]
    return draw_ellipsoids(body.posed(), body.camera(size), (size, size), part_labels=parts).labels


def observation(body: BodyParameters, labels: LabelSet, size: int = SIZE) -> Observation:
    names = skeleton("coco17").landmarks
    points = body.camera(2).project(LandmarkGather(names, body.shift.device)(body.posed()))[0, :, :2] - 1
    return Observation(names, points, torch.ones_like(points[:, 0]), target_of(body, labels, size)[0], labels)


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_an_ellipsoid_left_out_is_as_if_it_were_not_there(device, gradient):
    posed, camera = bodies(device).posed(), bodies(device).camera(SIZE)
    target = target_of(bodies(device).select(torch.tensor([1, 0], device=device)), label_set("ellipbody20"))
    kept = [part for part in range(20) if PART_NAMES[part] not in TIPS]
    names = ("centres", "axes", "semi_axes")
    losses, grads, images = [], [], []
    for index, labels in (
        (range(20), [part + 1 if part in kept else 0 for part in range(20)]),
        (kept, [part + 1 for part in kept]),
    ):
        index = list(index)
        leaves = Ellipsoids(*[getattr(posed, name)[:, index].detach().requires_grad_() for name in names])
        loss, image = ellipsoid_label_loss(leaves, camera, target, part_labels=labels, gradient=gradient)
        loss.sum().backward()
        losses.append(loss.detach())
        grads.append([getattr(leaves, name).grad for name in names])
        images.append(image)
    assert torch.equal(losses[0], losses[1])
    assert torch.equal(images[0].labels, images[1].labels)
    assert torch.equal(images[0].depth, images[1].depth)
    for whole, few in zip(*grads, strict=True):
        torch.testing.assert_close(whole[:, kept], few, rtol=1e-5, atol=1e-3)
        assert (np.delete(whole.cpu().numpy(), kept, axis=1) == 0).all()


def test_faces_left_out_are_as_if_they_were_not_there(device):
    posed, camera = bodies(device).posed(), bodies(device).camera(SIZE)
    vertices = camera.project(posed.vertices(1)).detach()
    mesh = ellipbody_mesh(1, device=device)
    few = mesh.relabel(WITHOUT_TIPS.part_groups)
    assert len(few.faces) == len(mesh.faces) * 16 // 20
    assert len(few.edges) == len(mesh.edges) * 16 // 20
    away = posed.vertices(1).clone()
    away.view(2, 20, -1, 3)[:, [PART_NAMES.index(name) for name in TIPS]] += 50.0  # [m], out of the picture
    table = np.where(WITHOUT_TIPS.part_groups == 0, 255, WITHOUT_TIPS.part_groups)
    table[0] = 0
    target = target_of(bodies(device).select(torch.tensor([1, 0], device=device)), WITHOUT_TIPS)
    found = []
    for shape, points in ((few, vertices), (mesh.relabel(table), camera.project(away).detach())):
        points = points.clone().requires_grad_()
        loss, image = loss_on_screen(points, shape, target)
        loss.sum().backward()
        found.append((loss.detach(), image.labels, points.grad))
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])
    torch.testing.assert_close(found[0][2], found[1][2], rtol=1e-5, atol=1e-3)
    assert draw_on_screen(vertices, few, (SIZE, SIZE)).labels.max() <= 16


@pytest.mark.parametrize("renderer", [RendererEllipsoids(), RendererMesh()], ids=["exact", "mesh"])
def test_a_label_set_without_hands_and_feet_is_fitted(device, renderer):
    body = bodies(device, 1)
    energy = Energy(observation(body, WITHOUT_TIPS), SIZE, prior=PosePrior().to(device), renderer=renderer)
    assert energy(body)["seg"] < (1e-6 if isinstance(renderer, RendererEllipsoids) else 20.0)
    moved = replace(body, shift=body.shift + 0.05)
    assert refine(moved, energy, iterations=20).energy < energy(moved)["seg"] + energy(moved)["proj"]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"left_out": ["tail"]}, "left_out: no part 'tail'"),
        ({"left_out": ["head"]}, "head is in 'left_out' and 'top'"),
        ({"left_out": "left_hand"}, "left_out: 'left_hand'; expected a list"),
    ],
)
def test_label_sets_that_leave_out_wrongly_are_refused(data, message):
    whole = {"groups": {"top": ["head"]}, "ids": {"0": "background", "1": "top"}}
    assert label_set({**whole, "left_out": ["left_hand"]}).part_groups[PART_NAMES.index("left_hand") + 1] == 0
    with pytest.raises(ValueError, match=message):
        label_set({**whole, **data})


@pytest.mark.parametrize("path", [refine_by_autograd, refine])
def test_frozen_parameters_stay(device, path):
    body = bodies(device, 1)
    energy = Energy(observation(body, label_set("body14")), SIZE, prior=PosePrior().to(device))
    start = replace(body, rotations=0.9 * body.rotations, lengths=3.0 * body.lengths)  # beyond what is human
    refined = path(start, energy, iterations=3, frozen=("lengths", "thicknesses", "shift"))
    for name, tensor in refined.parameters.tensors().items():
        assert torch.equal(tensor, start.tensors()[name]) == (name in ("lengths", "thicknesses", "shift")), name


def test_frozen_parameters_have_no_gradient():
    leaves = bodies().leaves(("lengths", "thicknesses"))
    leaves.posed().centres.square().sum().backward()
    have = {name for name, tensor in leaves.tensors().items() if tensor.grad is not None}
    assert have == {"orientation", "rotations"}


def test_both_paths_agree_where_sizes_are_frozen(device):
    body = bodies(device, 1)
    energy = Energy(observation(body, label_set("body14")), SIZE, prior=PosePrior().to(device))
    start = replace(body, rotations=0.9 * body.rotations)
    runs = [
        path(start, energy, iterations=5, frozen=("thicknesses",)).parameters for path in (refine_by_autograd, refine)
    ]
    torch.testing.assert_close(runs[0].rotations, runs[1].rotations, rtol=0, atol=2e-3)


@pytest.mark.parametrize(
    ("frozen", "message"),
    [
        (("length",), r"frozen: \['length'\]"),
        ("lengths", "frozen: lengths"),
        (tuple(bodies().tensors()), "frozen: all"),
    ],
)
def test_what_cannot_be_frozen_is_refused(frozen, message):
    energy = Energy(observation(bodies(), label_set("body14")), SIZE)
    for path in (refine_by_autograd, refine):
        with pytest.raises(ValueError, match=message):
            path(bodies(), energy, frozen=frozen)
    with pytest.raises(ValueError, match=message):
        CapturedRefinement(energy, 2, frozen=frozen)


@pytest.mark.parametrize("renderer", [RendererEllipsoids(), RendererMesh()], ids=["exact", "mesh"])
def test_one_label_has_no_z_gradient_and_none_is_looked_for(device, renderer):
    """Leaving it out is no approximation: looked for, it is exactly zero."""
    body = bodies(device, 1)
    energy = Energy(observation(body, label_set("full1")), SIZE, renderer=renderer)
    assert energy.renderer == replace(renderer, depth_weight=0.0)
    gradients = []
    for weight in (0.0, 1.0):
        energy = Energy(observation(body, label_set("full1")), SIZE)
        energy.renderer = replace(renderer, depth_weight=weight)
        leaves = replace(body, shift=body.shift + 0.1, rotations=1.3 * body.rotations).leaves()
        energy.segmentation(leaves, leaves.posed()).sum().backward()
        gradients.append(leaves.rotations.grad)
    # The mesh's sums on CUDA are atomic, in no fixed order.
    tolerance = (
        {"rtol": 0, "atol": 0}
        if isinstance(renderer, RendererEllipsoids) or device == "cpu"
        else {"rtol": 1e-4, "atol": 1e-3}
    )
    torch.testing.assert_close(*gradients, **tolerance)
    assert Energy(observation(body, label_set("body14")), SIZE).renderer.depth_weight == 1.0


# --- What a fit says about it --------------------------------------------------------------------------------------


def seen_by(body: BodyParameters, labels: LabelSet, image: tuple[int, int] = (300, 400)) -> tuple:
    """Keypoints and labels of a picture with the body in its upper left corner."""
    size = 200
    seen = observation(body, labels, size)
    points = ((seen.points + 1) * size / 2).cpu().numpy()
    groups = np.zeros(image, dtype=np.uint8)
    groups[:size, :size] = seen.labels.cpu().numpy()
    confidence = np.ones(len(points), dtype=np.float32)
    confidence[:3] = 0.0
    return Keypoints2D("coco17", points.astype(np.float32), confidence), PartLabels(labels, groups)


def test_a_fit_says_what_it_models():
    keypoints, parts = seen_by(bodies(), WITHOUT_TIPS)
    choices = {choice.what: choice for choice in explain(keypoints, parts)}
    assert choices["keypoints"].modelled.startswith("14 of 17")
    assert choices["keypoints"].left_out == "nose; left_eye; right_eye"
    assert choices["ellipsoids"].modelled == "16 of 20 drawn"
    assert set(choices["ellipsoids"].left_out.split("; ")) == set(TIPS)
    assert 50 < float(choices["picture"].left_out.split()[0]) < 95
    assert choices["groups of parts"].left_out == ""
    assert "16 maps" in choices["L_seg"].left_out
    assert choices["z gradient"].modelled == ""
    assert choices["start"].modelled == "the label network's body"
    assert choices["an iteration"].left_out == "autograd, Python"


def test_a_fit_says_why_it_looks_for_no_depth():
    keypoints, parts = seen_by(bodies(), label_set("full1"))
    depth = next(choice for choice in explain(keypoints, parts) if choice.what == "z gradient")
    assert depth.modelled == ""
    assert "one label" in depth.why


def test_a_fit_without_labels_draws_nothing():
    keypoints, _ = seen_by(bodies(), label_set("body14"))
    last = explain(keypoints)[-1]
    assert last.what == "part labels"
    assert last.left_out == "L_seg; outline"
    searched = explain(keypoints, options=FitOptions.at("balanced", "search"))
    assert "labels, fine; outline" in searched[-1].left_out
    assert searched[1].left_out == "the label network"


def test_a_searching_fit_looks_for_depth_where_parts_hide_one_another():
    keypoints, parts = seen_by(bodies(), WITHOUT_TIPS)
    choices = explain(keypoints, parts, options=FitOptions.at("balanced", "search"))
    depth = next(choice for choice in choices if choice.what == "z gradient")
    assert depth.modelled.startswith("stages labels, coarse")


def test_the_table_holds_every_choice(capsys):
    keypoints, parts = seen_by(bodies(), WITHOUT_TIPS)
    choices = explain(keypoints, parts)
    print_choices(choices, Console(width=200))
    shown = capsys.readouterr().out
    assert all(choice.what in shown for choice in choices)


def test_fits_of_a_few_stages_still_fit():
    """What is explained is what is done: the same stages, the same crop."""
    keypoints, parts = seen_by(bodies(), WITHOUT_TIPS)
    options = FitOptions(stages=(Stage("lift", 8, 5, 0.1), Stage("labels", 2, 3, 0.02, 64)))
    result = fit_body(keypoints, parts, options=options)
    picture = next(choice for choice in explain(keypoints, parts, options=options) if choice.what == "picture")
    assert picture.modelled == f"{256 / result.crop.zoom:.0f} x {256 / result.crop.zoom:.0f} px around the person, " + (
        "drawn at 64 px"
    )


def test_the_commands_run(tmp_path):
    from typer.testing import CliRunner

    from warp_partdr.cli import main

    example = resources.files("warp_partdr") / "assets" / "example"
    inputs = [str(example / "photo.png"), "--keypoints", str(example / "keypoints.json")]
    run = CliRunner().invoke(main.app, ["fit", *inputs, "--explain", "--model", "none", "--out", str(tmp_path / "fit")])
    assert run.exit_code == 0, run.output
    assert "What is modelled" in run.output
    run = CliRunner().invoke(main.app, ["bench", "savings", "--help"])
    assert run.exit_code == 0
