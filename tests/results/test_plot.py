"""Figures: what they show is where it belongs, in the palette's colours, with names and units; bad input is named."""

import subprocess
import sys
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import torch
from helpers.bodies import PICTURE_SIZE, seen_by
from PIL import Image

from warp_partdr import plot
from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.template import JOINT_NAMES, LENGTH_NAMES, PARENTS, PART_NAMES, THICKNESS_NAMES
from warp_partdr.cameras import Perspective, WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.results.figure_parts import part_patches
from warp_partdr.results.palette import IGNORE_COLOUR, PART_COLOURS, group_colours
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.stages import Stage
from warp_partdr.solve.ellipsoids.stepper import Refined

SIZE = (120, 180)  # not square
HEAD = PART_NAMES.index("head") + 1


def body(device="cpu"):
    return BodyParameters.mean(2, device=device)


def camera(device="cpu"):
    scale = torch.full((2,), 60.0, device=device)
    return WeakPerspective(scale, torch.tensor([[90.0, 62.0]], device=device).repeat(2, 1))


def far_camera(device="cpu"):
    """Its body is 5 m away."""
    return Perspective(torch.full((2, 2), 300.0, device=device), camera(device).translation)


def away(device="cpu"):
    """Bodies 5 m before the camera."""
    posed, far = body(device).posed(), torch.tensor([0.0, 0.0, 5.0], device=device)
    return replace(posed, centres=posed.centres + far, joints=posed.joints + far)


def drawn(device="cpu", right=0.0):
    """Labels (H, W) of the body, so far to the right [m]."""
    posed = body(device).posed()
    moved = replace(posed, centres=posed.centres + torch.tensor([right, 0.0, 0.0], device=device))
    return draw_ellipsoids(moved, camera(device), SIZE).labels[:1]


def pixels(figure):
    """The figure as it is written to a file, shape (H, W, 3)."""
    file = BytesIO()
    figure.savefig(file)
    return np.asarray(Image.open(file).convert("RGB"))


def names(figure):
    """Texts of its legends."""
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def shown(figure):
    """The picture on its first axes."""
    return figure.axes[0].get_images()[0].get_array()


def has_colour(picture, colour):
    return bool((np.abs(picture.astype(int) - np.asarray(colour).astype(int)).max(-1) <= 1).any())


@pytest.fixture(scope="module")
def fit():
    """A quick fit in a picture that is not square, and what it was fitted to."""
    person, parts = seen_by(body().select(torch.tensor([0])))
    stages = (Stage("lift", 8, 4, 0.05), Stage("labels", 2, 6, 0.02, 48))
    return fit_body(person, parts, options=FitOptions(stages=stages, start="search")), person, parts


def test_overlay_lies_where_the_body_is_seen(device):
    photo = np.full((*SIZE, 3), 200, dtype=np.uint8)
    figure = plot.overlay(body(device), photo, camera=camera(device))
    person = drawn(device)[0].cpu().numpy() > 0
    changed = (shown(figure) != photo).any(-1)
    assert shown(figure).shape == (*SIZE, 3)
    assert (changed == person).mean() > 0.98
    assert figure.axes[0].get_images()[0].get_extent() == [0, SIZE[1], SIZE[0], 0]  # pixel centres at + 0.5
    assert names(figure) == [name.replace("_", " ") for name in PART_NAMES]
    picture = pixels(figure)
    assert all(has_colour(picture, colour) for colour in PART_COLOURS[1:])  # of the legend: the body is shaded


def test_an_overlay_in_perspective_covers_the_person(device):
    photo, view = np.full((*SIZE, 3), 200, dtype=np.uint8), far_camera(device)
    far = away(device)
    changed = (shown(plot.overlay(far, photo, camera=view)) != photo).any(-1)
    person = draw_ellipsoids(far, view, SIZE).labels[0].cpu().numpy() > 0
    assert person.any()
    assert (changed == person).mean() > 0.98


def test_overlay_of_a_fit_needs_no_camera(fit):
    result, person, _ = fit
    photo = np.full((*PICTURE_SIZE, 3), 200, dtype=np.uint8)
    plain, dotted = (shown(plot.overlay(result, photo, keypoints=keypoints)) for keypoints in (None, person))
    u, v = person.points[-1].astype(int)
    assert (plain[v, u] != dotted[v, u]).any()
    assert ((plain != photo).any(-1) == (result.draw(PICTURE_SIZE).labels[0].numpy() > 0)).mean() > 0.98
    with pytest.raises(ValueError, match=r"^camera"):
        plot.overlay(result.posed, photo)


def test_panels_show_target_and_drawn_in_the_palette(device, fit):
    result, _, parts = fit
    colours = group_colours(parts.label_set.part_groups)
    target = drawn(device)
    target[0, :4] = 255
    figure = plot.part_panels(target, drawn(device, right=0.5))
    assert names(figure) == [*(name.replace("_", " ") for name in PART_NAMES), "ignored"]
    sheet = shown(figure)
    assert (pixels(figure)[: sheet.shape[0], : sheet.shape[1]] == sheet).mean() > 0.999  # no pixel is smeared
    third = sheet.shape[1] // 3
    panels = sheet[:, :third], sheet[:, third : 2 * third], sheet[:, 2 * third :]
    assert [has_colour(panel, colours[HEAD]) for panel in panels] == [True, True, False]
    assert has_colour(panels[2], (220, 50, 32))  # too much
    assert has_colour(shown(plot.part_panels(parts, result)), colours[HEAD])


def test_panels_name_the_groups_of_a_label_set(fit):
    result, _, _ = fit
    groups = label_set("cdcl14")
    labels = groups.part_groups[drawn()[0].numpy()]
    figure = plot.part_panels(labels, result, label_set="cdcl14")
    assert names(figure) == [name.replace("_", " ") for name in groups.group_names]
    assert part_patches(groups, np.array([[1, 255]], dtype=np.uint8))[1].get_label() == "ignored"
    assert part_patches(groups)[0].get_facecolor()[:3] == tuple(group_colours(groups.part_groups)[1] / 255)
    assert part_patches(groups, np.array([255]))[0].get_facecolor()[:3] == tuple(IGNORE_COLOUR / 255)


def quiver(figure):
    return next(each for each in figure.axes[0].collections if type(each).__name__ == "Quiver")


def test_gradient_arrows_are_the_downhill_gradient(device):
    target = drawn(device, right=0.1)
    figure = plot.gradient_field(body(device), target, camera=camera(device))
    posed = body(device).posed()
    one = Ellipsoids(posed.centres[:1].clone().requires_grad_(), posed.axes[:1], posed.semi_axes[:1])
    view = WeakPerspective(camera(device).scale[:1], camera(device).translation[:1])
    ellipsoid_label_loss(one, view, target, gradient="partdr")[0].sum().backward()
    slope = one.centres.grad[0].cpu().numpy()
    there = np.abs(slope).max(1) > 0
    arrows = quiver(figure)
    drawn_arrows = np.stack([arrows.U, arrows.V, arrows.get_array()], axis=1)
    np.testing.assert_allclose(drawn_arrows, -slope[there], rtol=1e-4, atol=1e-3)
    places = view.project(posed.centres[:1])[0, :, :2].cpu().numpy()
    np.testing.assert_allclose(arrows.XY, places[there], rtol=1e-5)
    assert arrows.U.sum() > 0  # to the right, where the target is
    assert figure.axes[0].get_xlabel() == "u [px]"
    assert "[px/m]" in figure.axes[1].get_ylabel()
    pixels(figure)


def test_gradients_of_meshes_and_in_perspective_are_drawn(device):
    view, far = far_camera(device), away(device)
    target = drawn(device, right=0.1)
    exact, mesh = (
        quiver(plot.gradient_field(far, target, camera=view, renderer=renderer, subdivisions=0)).U
        for renderer in ("exact", "mesh")
    )
    assert 0 < exact.sum() < np.inf
    assert 0 < mesh.sum() < np.inf
    assert len(mesh) > len(exact)


def test_no_arrow_is_drawn_where_nothing_is_wrong():
    figure = plot.gradient_field(body(), drawn(), camera=camera())
    assert len(quiver(figure).U) == 0
    assert "L_seg = 0 px" in figure.axes[0].get_title()
    pixels(figure)


def test_a_loss_curve_shows_each_stage_of_a_history(fit):
    result, _, _ = fit
    axes = plot.loss_curve(result).axes[0]
    lines = [line.get_ydata() for line in axes.lines]
    for line, rows in zip(lines, result.history, strict=True):
        np.testing.assert_array_equal(line, rows)
    assert [text.get_text() for text in axes.texts] == ["lift", "labels"]
    assert axes.lines[1].get_xdata()[0] == 4.5
    assert axes.get_xlabel() == "iteration"
    assert axes.get_yscale() == "log"
    refined = Refined(result.parameters, torch.zeros(3), {}, torch.rand(7, 3))
    assert len(plot.loss_curve(refined).axes[0].lines) == 3
    falling = plot.loss_curve([3.0, 0.0], label="L [px]").axes[0]
    assert falling.get_yscale() == "linear"
    assert falling.get_ylabel() == "L [px]"


def test_turntable_turns_the_body(device):
    figure = plot.turntable(body(device), turns=(0, 90, 180))
    front, side, back = (axes.get_images()[0].get_array() for axes in figure.axes)
    assert [axes.get_title() for axes in figure.axes] == ["0°", "90°", "180°"]
    width = [np.ptp(np.nonzero((view < 255).any((0, 2)))[0]) for view in (front, side, back)]
    assert width[1] < width[0] / 2  # arms are out to the sides
    assert abs(width[0] - width[2]) <= 2
    assert names(figure)[0] == "left hip"
    pixels(figure)


def test_compared_bodies_show_distances_and_sizes(device):
    first = body(device)
    longer = replace(first, lengths=first.lengths * torch.linspace(1.0, 1.2, 12, device=device))
    figure = plot.compare_bodies(first, longer, names=("one", "other"))
    front, _, distance, sizes = figure.axes
    apart = (first.posed().joints[0] - longer.posed().joints[0]).norm(dim=-1).cpu().numpy() * 1000
    np.testing.assert_allclose([bar.get_width() for bar in distance.patches], apart, atol=1e-3)
    assert [text.get_text() for text in distance.get_yticklabels()] == [name.replace("_", " ") for name in JOINT_NAMES]
    assert f"MPJPE {apart.mean():.0f} mm" in distance.get_title()
    rows = [bar.get_width() for bar in sizes.patches]
    expected = [100 * torch.cat([each.lengths[0], each.thicknesses[0]]).cpu().numpy() for each in (first, longer)]
    np.testing.assert_allclose(rows, np.concatenate(expected), rtol=1e-5)
    assert [text.get_text() for text in sizes.get_yticklabels()] == [*LENGTH_NAMES, *THICKNESS_NAMES]
    assert names(figure) == ["one", "other"]
    units = [axes.get_xlabel() for axes in figure.axes]
    assert units == ["x [m], right", "z [m], away from the viewer", "distance of joints [mm]", "size [cm]"]
    assert apart[JOINT_NAMES.index("pelvis")] == 0
    assert apart[JOINT_NAMES.index("left_fingertip")] > 50
    # The shaded body lies under its own skeleton.
    picture = front.get_images()[0]
    left, right, bottom, top = picture.get_extent()
    person = (picture.get_array() < 250).any(-1)
    for x, y, _ in (first.posed().joints[0] - first.posed().joints[0, 0]).tolist()[1:8]:
        row = int((y - top) / (bottom - top) * person.shape[0])
        column = int((x - left) / (right - left) * person.shape[1])
        assert person[row, column]


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda: plot.overlay(body(), np.zeros((4, 4), np.uint8), camera=camera()), "photo"),
        (lambda: plot.overlay(body(), np.zeros((4, 4, 3)), camera=camera()), "photo"),
        (lambda: plot.part_panels(np.zeros((4, 4)), np.zeros((4, 4), np.uint8)), "target"),
        (lambda: plot.part_panels(np.full((4, 4), 21, np.uint8), np.zeros((4, 4), np.uint8)), "target: id 21"),
        (lambda: plot.part_panels(np.zeros((4, 4), np.uint8), np.zeros((4, 5), np.uint8)), "drawn"),
        (lambda: plot.gradient_field(body(), np.zeros((4, 4), np.uint8)), "camera"),
        (lambda: plot.gradient_field(body(), drawn(), camera=camera(), renderer="none"), "renderer"),
        (lambda: plot.loss_curve([]), "history"),
        (lambda: plot.loss_curve(np.zeros((2, 2, 2))), "history"),
        (lambda: plot.turntable(body(), turns=()), "turns"),
        (lambda: plot.turntable(BodyParameters.mean(0)), "body"),
        (lambda: plot.turntable(3), "body: int"),
    ],
)
def test_bad_input_is_named(call, named):
    with pytest.raises(TypeError if named.endswith("int") else ValueError, match=rf"^{named}"):
        call()


# Colour-blind vision of linear RGB: Machado, Oliveira, Fernandes, IEEE TVCG 15 (6), 2009, severity 1.0.
VISIONS = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def lab(colours, vision):
    """CIE L*a*b* of sRGB colours (N, 3), 0 to 255, as somebody sees them."""
    share = np.asarray(colours) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    xyz = (linear @ np.transpose(VISIONS[vision])).clip(0, 1) @ SRGB_TO_XYZ.T / SRGB_TO_XYZ.sum(1)
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], axis=1)


def touching():
    """Pairs of parts that are often seen side by side: neighbours, both sides' own, arms before the trunk."""
    pairs = {(name, PART_NAMES[parent]) for name, parent in zip(PART_NAMES, PARENTS, strict=True) if parent >= 0}
    pairs |= {(name, name.replace("left", "right")) for name in PART_NAMES if name.startswith("left")}
    for side in ("left", "right"):
        trunk, leg = ["abdomen", "chest"], [f"{side}_hip", f"{side}_upper_leg"]
        beside = {"upper_arm": trunk, "forearm": trunk + leg, "hand": trunk + leg}
        beside |= {"shoulder": ["neck", "head"], "hip": ["abdomen"]}
        pairs |= {(f"{side}_{part}", other) for part, others in beside.items() for other in others}
    return sorted(pairs)


@pytest.mark.parametrize("vision", VISIONS)
def test_parts_that_touch_are_told_apart_by_everybody(vision):
    seen = dict(zip(PART_NAMES, lab(PART_COLOURS[1:], vision), strict=True))
    apart = {pair: np.linalg.norm(seen[pair[0]] - seen[pair[1]]) for pair in touching()}
    assert min(apart.values()) > 12, min(apart, key=apart.__getitem__)


def test_left_is_warm_and_right_is_cool():
    red, _, blue = PART_COLOURS[1:].astype(int).T
    for name, warmth in zip(PART_NAMES, red - blue, strict=True):
        assert warmth >= 25 if name.startswith("left") else warmth <= -25 if name.startswith("right") else True, name


def test_plotting_opens_no_window_and_imports_matplotlib_for_the_first_figure():
    code = (
        "import sys; import warp_partdr.results.figures as p; assert 'matplotlib' not in sys.modules; "
        "p.loss_curve([2.0, 1.0]);"
        "assert 'matplotlib' in sys.modules and 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_bodies_are_compared_with_their_pelvises_in_one_place():
    distance = plot.compare_bodies(body().posed(), away()).axes[2]
    np.testing.assert_allclose([bar.get_width() for bar in distance.patches], 0, atol=1e-2)


def test_of_a_batch_the_first_body_is_shown():
    two = replace(body(), lengths=body().lengths * torch.tensor([[1.0], [1.5]]))
    sizes = plot.compare_bodies(two, body()).axes[3]
    first, second = np.array([bar.get_width() for bar in sizes.patches]).reshape(2, -1)
    np.testing.assert_array_equal(first, second)


def test_a_group_of_one_part_has_its_colour():
    colours = group_colours(label_set("ellipbody20").part_groups)
    np.testing.assert_array_equal(colours[1:21], PART_COLOURS[1:])
    assert not colours[0].any()
