"""Figures of bodies, fits and gradients.

Each of them is a ``matplotlib.figure.Figure`` that belongs to no window: ``figure.savefig("figure.png")`` needs no
screen, and you may change ``figure.axes``. From a batch, the first body is shown. Parts have the colours of
``palette``, as in all other pictures and files. The first figure loads Matplotlib.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch

from ..body.labels import BACKGROUND, LabelSet, label_set
from ..body.posing import Posed
from ..body.template import BONE_STARTS, JOINT_NAMES, LENGTH_NAMES, THICKNESS_NAMES
from ..cameras import Camera, WeakPerspective
from ..inputs.keypoints import Keypoints2D
from ..inputs.part_labels import PartLabels
from ..metrics import mpjpe, pa_mpjpe
from ..render.ellipsoids import draw_ellipsoids, ellipsoid_label_loss
from ..render.mesh import mesh_label_loss
from ..render.part_mesh import ellipbody_mesh
from ..solve.ellipsoids.result import FitResult
from ..solve.ellipsoids.stepper import Refined
from .figure_parts import (
    DPI,
    PARTS,
    Body,
    Image,
    add_legend,
    body_sizes,
    draw_groups,
    empty_figure,
    find_label_set,
    first_body,
    first_camera,
    legend_columns,
    outline_labels,
    part_patches,
    plain_name,
    read_groups,
    show_picture,
    to_numpy,
)
from .fit_charts import panels
from .overlays import body_over, draw_keypoints
from .palette import DEPTH_COLOURS, group_colours
from .shading import blend, shade_body, turntable_views

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BETWEEN = ("#0f4890", "#dd6623")  # two bodies, cool and warm
_STAGES = ("#f6f6f6", "#e8edf3")


def overlay(
    body: Body, photo: np.ndarray, *, camera: Camera | None = None, keypoints: Keypoints2D | None = None
) -> Figure:
    """Draw a body over the photo that it was fitted to.

    Args:
        body: Fit, parameters or posed body.
        photo: Picture, RGB, shape (H, W, 3), uint8.
        camera: Camera in pixels of the photo; None: the camera of the fit.
        keypoints: Keypoints to draw over the body, if they are confident.

    Raises:
        ValueError: If ``photo`` is no RGB picture, or ``camera`` is missing.

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from warp_partdr import plot, read_photo
        >>> figure = plot.overlay(result, read_photo("photo.png"), keypoints=person)
        >>> figure.savefig("overlay.png", dpi=150)
    """
    from PIL import Image as PilImage

    photo = np.asarray(photo)
    if photo.ndim != 3 or photo.shape[2] != 3 or photo.dtype != np.uint8 or not photo.size:
        raise ValueError(f"photo: {photo.dtype} {photo.shape}; expected uint8 (H, W, 3)")
    size = photo.shape[0], photo.shape[1]
    posed, own_camera = first_body(body), first_camera(body, camera)
    picture = PilImage.fromarray(body_over(photo, posed, own_camera))
    if keypoints is not None:
        draw_keypoints(picture, keypoints)
    figure = empty_figure(6.0 * min(size[1] / size[0], 2.0) + 0.6, 7.1)
    show_picture(figure.subplots(), np.asarray(picture))
    add_legend(figure, part_patches(label_set(PARTS), draw_ellipsoids(posed, own_camera, size).labels))
    return figure


def part_panels(
    target: PartLabels | Image, drawn: FitResult | Image, *, label_set: LabelSet | str | None = None
) -> Figure:
    """Draw labels of the target, labels of the result and their difference side by side, with the names of the parts.

    Args:
        target: Labels from a file, or group ids: 0 = background, 255 = ignore, shape (H, W), uint8.
        drawn: Fit, or group ids of the same shape.
        label_set: Label set of the group ids; None: the one of ``target``, or the 20 parts if it has none.

    Raises:
        ValueError: If the two are no label images of one shape, or an id is not in the set.

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from warp_partdr import plot
        >>> plot.part_panels(parts, result).savefig("parts_compared.png")
    """
    groups = find_label_set(target.label_set if label_set is None and isinstance(target, PartLabels) else label_set)
    expected = read_groups("target", target.groups if isinstance(target, PartLabels) else target, groups)
    if isinstance(drawn, FitResult):
        found = draw_groups(drawn.posed, drawn.camera, expected.shape, groups)
    else:
        found = read_groups("drawn", drawn, groups)
    if found.shape != expected.shape:
        raise ValueError(f"drawn: shape {found.shape}; expected {expected.shape} as the target")
    sheet = np.asarray(panels(expected, found, group_colours(groups.part_groups)))
    patches = part_patches(groups, np.stack([expected, found]))
    rows = -(-len(patches) // legend_columns(sheet.shape[1]))
    width, height = sheet.shape[1] / DPI, sheet.shape[0] / DPI
    below = 0.2 * rows + 0.1
    # One pixel of the sheet is one of the figure's, so that labels stay sharp.
    figure = empty_figure(width, height + below, layout=None)
    axes = figure.add_axes((0, below / (height + below), 1, height / (height + below)))
    axes.imshow(sheet, interpolation="nearest", aspect="auto")
    axes.set_axis_off()
    figure.legend(handles=patches, loc="lower center", ncols=legend_columns(sheet.shape[1]), frameon=False, fontsize=8)
    return figure


def gradient_field(
    body: Body,
    target: Image,
    *,
    camera: Camera | None = None,
    label_set: LabelSet | str | None = None,
    renderer: Literal["exact", "mesh"] = "exact",
    subdivisions: int = 1,
) -> Figure:
    """Draw the pull of part labels on a body: arrows along the negative gradient in x and y, coloured by the one in z.

    The loss is L_seg [px of label maps]. Its gradient is taken with respect to points in the camera frame [px/m]. These
    are the ellipsoids' centres ("exact") or the mesh's vertices ("mesh"). Vertices without gradient have no arrow.

    Args:
        body: Fit, parameters or posed body.
        target: Group ids that the body should reach in the camera's picture: 0 = background, 255 = ignore, shape
            (H, W), uint8.
        camera: Camera in pixels of the target; None: the camera of the fit.
        label_set: Label set of the group ids; None: the 20 parts.
        renderer: Renderer: "exact" draws the ellipsoids, "mesh" draws their meshes.
        subdivisions: Level of the mesh, 0 to 3.

    Raises:
        ValueError: If ``target`` is no label image of the set, ``renderer`` is unknown or ``camera`` is missing.

    Examples:
        >>> from warp_partdr import BodyParameters, draw_ellipsoids, plot
        >>> body = BodyParameters.mean(1)
        >>> target = draw_ellipsoids(body.posed(), body.camera(128), (128, 128)).labels.roll(5, dims=2)  # 5 px right
        >>> plot.gradient_field(body, target, camera=body.camera(128)).savefig("gradient.png")
    """
    if renderer not in ("exact", "mesh"):
        raise ValueError(f"renderer: {renderer!r}; expected exact, mesh")
    from matplotlib.colors import LinearSegmentedColormap, Normalize

    groups = find_label_set(label_set)
    expected = read_groups("target", target, groups)
    posed, own_camera = first_body(body), first_camera(body, camera)
    goal = torch.from_numpy(expected)[None].to(posed.centres.device)
    if renderer == "exact":
        name, width, dot = "centres", 0.008, 40
        points = posed.centres.clone().requires_grad_()
        differentiable = Posed(posed.joints, posed.rotations, points, posed.axes, posed.semi_axes)
        part_labels = groups.part_groups[1:].tolist()
        loss, _ = ellipsoid_label_loss(differentiable, own_camera, goal, part_labels=part_labels, gradient="partdr")
    else:
        name, width, dot = f"vertices of E{subdivisions}", 0.004, 10
        points = posed.vertices(subdivisions).requires_grad_()
        mesh = ellipbody_mesh(subdivisions, device=points.device).relabel(groups.part_groups)
        loss, _ = mesh_label_loss(points, mesh, own_camera, goal)
    (slope,) = torch.autograd.grad(loss.sum(), points)
    downhill = -slope[0].cpu().numpy()
    pixels = own_camera.project(points.detach())[0, :, :2].cpu().numpy()

    colours = group_colours(groups.part_groups)
    colours[BACKGROUND] = 255
    figure = empty_figure(5.5 * min(expected.shape[1] / expected.shape[0], 2.0) + 1.6, 6.6)
    axes = figure.subplots()
    show_picture(axes, (0.4 * colours[expected] + 0.6 * 255).astype(np.uint8))
    outline_labels(axes, draw_groups(posed, own_camera, expected.shape, groups))
    pulled = np.abs(downhill).max(1) > 0
    longest = float(np.linalg.norm(downhill[:, :2], axis=1).max(initial=0)) or 1.0
    steepest = float(np.abs(downhill[:, 2]).max(initial=0)) or 1.0
    colour_map = LinearSegmentedColormap.from_list("depth", DEPTH_COLOURS / 255)
    norm = Normalize(-steepest, steepest)
    sixth = max(expected.shape) / 6  # length of the longest arrow: a sixth of the picture
    u, v = pixels[pulled].T
    arrows = axes.quiver(
        u,
        v,
        *downhill[pulled].T,
        angles="xy",
        scale_units="xy",
        scale=longest / sixth,
        width=width,
        edgecolor="white",
        linewidth=0.4,
        cmap=colour_map,
        norm=norm,
        zorder=3,
    )
    axes.scatter(u, v, dot, downhill[pulled, 2], zorder=4, cmap=colour_map, norm=norm)
    key = float(f"{longest / 2:.1g}")
    axes.quiverkey(arrows, 0.12, 0.95, key, f"-dL/dx, -dL/dy: {key:g} px/m", labelpos="E", color=DEPTH_COLOURS[1] / 255)
    figure.colorbar(arrows, ax=axes, shrink=0.8, label="-dL/dz [px/m]; above 0: away from the viewer")
    axes.set_title(f"L_seg = {float(loss.detach()):.0f} px; its pull on the {name}")
    add_legend(figure, part_patches(groups, expected))
    return figure


def loss_curve(history: FitResult | Refined | Sequence[float] | np.ndarray, *, label: str = "energy") -> Figure:
    """Draw the course of a loss, on a logarithmic scale if it is positive.

    A fit's stages have separate lines, because their weights differ.

    Args:
        history: Fit, refinement (one line a body), or losses of shape (iterations,) or (iterations, B).
        label: Label of the vertical axis.

    Raises:
        ValueError: If there are no values.

    Examples:
        >>> from warp_partdr import plot
        >>> plot.loss_curve([3.0, 2.0, 1.5, 1.2], label="my loss").savefig("loss.png")
    """
    from matplotlib.ticker import LogFormatter

    names = [stage.name for stage in history.stages] if isinstance(history, FitResult) else []
    values = history.history if isinstance(history, FitResult | Refined) else np.asarray(history, dtype=np.float64)
    curves = values if isinstance(values, list) else [to_numpy(values)]
    if not curves or any(curve.ndim not in (1, 2) for curve in curves) or not sum(len(curve) for curve in curves):
        raise ValueError(f"history: {len(curves)} empty or of a wrong shape; expected one loss or more an iteration")
    figure = empty_figure(8.0, 3.6)
    axes = figure.subplots()
    first = 0
    for index, curve in enumerate(curves):
        last = first + len(curve)
        axes.plot(np.arange(first, last) + 0.5, curve, color=_BETWEEN[0], linewidth=1.6)
        if names:
            axes.axvspan(first, last, color=_STAGES[index % 2], zorder=0)
            above = axes.get_xaxis_transform()
            axes.text((first + last) / 2, 1.02, names[index], ha="center", va="bottom", transform=above)
        first = last
    if all((curve > 0).all() for curve in curves):
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(LogFormatter(minor_thresholds=(2, 0.5)))
    axes.set(xlim=(0, first), xlabel="iteration", ylabel=label)
    axes.grid(axis="y", which="both", alpha=0.3)
    return figure


def turntable(body: Body, *, turns: Sequence[float] = (0, 90, 180, 270)) -> Figure:
    """Draw a body from all sides.

    Args:
        body: Fit, parameters or posed body.
        turns: Turns about the vertical [degrees]; 0 is the camera's view.

    Raises:
        ValueError: If there are no turns.

    Examples:
        After ``result = fit_body(person, parts)``:

        >>> from warp_partdr import plot
        >>> plot.turntable(result, turns=range(0, 360, 90)).savefig("turntable.png")
    """
    if not turns:
        raise ValueError("turns: none; expected one angle or more")
    views = np.stack(turntable_views(first_body(body), tuple((float(turn), 0.0) for turn in turns)))
    rows = np.flatnonzero((views < 255).any((0, 2, 3)))
    columns = np.flatnonzero((views < 255).any((0, 1, 3)))
    views = views[:, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]  # one crop for all, around all bodies
    figure = empty_figure(4.0 * len(turns) * views.shape[2] / views.shape[1] + 0.5, 5.0)
    for axes, turn, view in zip(figure.subplots(1, len(turns), squeeze=False)[0], turns, views, strict=True):
        axes.imshow(view)
        axes.set_axis_off()
        axes.set_title(f"{turn:g}°")
    add_legend(figure, part_patches(label_set(PARTS)))
    return figure


def compare_bodies(first: Body, second: Body, *, names: tuple[str, str] = ("first", "second")) -> Figure:
    """Compare two bodies, with both pelvises at one point: from the front, from the side, by joint and by size.

    From the front, the first body is shaded and the second one is an outline. Joints and sizes are shown for both.

    Args:
        first: Fit, parameters or posed body.
        second: Fit, parameters or posed body to compare with.
        names: Names of the two bodies in the legend.

    Examples:
        >>> from dataclasses import replace
        >>> from warp_partdr import BodyParameters, plot
        >>> body = BodyParameters.mean(1)
        >>> longer = replace(body, lengths=1.1 * body.lengths)
        >>> plot.compare_bodies(body, longer, names=("mean", "longer")).savefig("bodies.png")
    """
    bodies = [first_body(body) for body in (first, second)]
    joints = [body.joints[0].cpu().double() - body.joints[0, :1].cpu().double() for body in bodies]
    low = torch.stack(joints).amin((0, 1)).numpy() - 0.15
    high = torch.stack(joints).amax((0, 1)).numpy() + 0.15
    across, down, deep = high - low
    widths = (5.3 * across / down, 5.3 * deep / down, 2.6, 3.0)
    figure = empty_figure(sum(widths) + 4.5, 6.4)
    front, side, distance, sizes = figure.subplots(1, 4, width_ratios=widths)

    scale = 480 / float(max(high[:2] - low[:2]))
    size = int(np.ceil(down * scale)), int(np.ceil(across * scale))
    extent = (low[0], low[0] + size[1] / scale, low[1] + size[0] / scale, low[1])
    shades = []
    for body in bodies:
        pelvis = body.joints[:, 0, :2].cpu()
        corner = torch.tensor(low[:2], dtype=pelvis.dtype)
        camera = WeakPerspective(pelvis.new_tensor([scale]), -(pelvis + corner) * scale)
        shades.append(shade_body(body, camera, size))
    white = np.full((*size, 3), 255, dtype=np.uint8)
    front.imshow(blend(white, shades[0], 0.75), extent=extent)
    front.contour(shades[1][..., 3], levels=[127], colors=_BETWEEN[1], extent=extent, origin="upper", linewidths=1.2)
    for axes, axis, label in ((front, 0, "x [m], right"), (side, 2, "z [m], away from the viewer")):
        for colour, points in zip(_BETWEEN, joints, strict=True):
            ends = torch.stack([points[BONE_STARTS], points[1:]])
            axes.plot(ends[..., axis], ends[..., 1], "o-", color=colour, markersize=3)
        axes.set_aspect("equal")
        axes.set_xlabel(label)
    front.set(title="front", ylabel="y [m], down")
    side.set(title="side", xlim=(low[2], high[2]), ylim=extent[2:])

    apart = (joints[0] - joints[1]).norm(dim=-1).numpy() * 1000
    distance.barh(np.arange(len(apart)), apart, color="#6d6d6d")
    distance.set_yticks(np.arange(len(apart)), [plain_name(name) for name in JOINT_NAMES])
    distance.invert_yaxis()
    mean = float(mpjpe(*joints)) * 1000
    aligned = float(pa_mpjpe(*joints)) * 1000
    title = f"MPJPE {mean:.0f} mm, PA-MPJPE {aligned:.0f} mm"
    distance.set(xlabel="distance of joints [mm]", title=title)

    rows = np.arange(len(LENGTH_NAMES) + len(THICKNESS_NAMES))
    for offset, colour, body, name in zip((-0.2, 0.2), _BETWEEN, bodies, names, strict=True):
        sizes.barh(rows + offset, body_sizes(body) * 100, 0.4, color=colour, label=name)
    sizes.set_yticks(rows, [*LENGTH_NAMES, *THICKNESS_NAMES])
    sizes.invert_yaxis()
    sizes.set(xlabel="size [cm]", title="lengths and thicknesses")
    figure.legend(handles=sizes.get_legend_handles_labels()[0], loc="outside lower center", ncols=2, frameon=False)
    return figure
