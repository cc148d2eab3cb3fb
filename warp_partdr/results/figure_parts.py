"""Parts of figures: empty figures, legends, pictures on axes, and checks of the arguments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import torch

from ..body.labels import BACKGROUND, IGNORE, LabelSet, label_set
from ..body.parameters import BodyParameters
from ..body.posing import Posed
from ..body.template import LENGTH_NAMES, SIZE_COLUMNS, THICKNESS_NAMES
from ..cameras import Camera, first_of
from ..render.ellipsoids import draw_ellipsoids
from ..solve.ellipsoids.result import FitResult
from .palette import IGNORE_COLOUR, group_colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

Body = FitResult | BodyParameters | Posed
Image = np.ndarray | torch.Tensor

PARTS = "ellipbody20"  # default label set
DPI = 100


def part_patches(groups: LabelSet, labels: Image | None = None) -> list[Patch]:
    """Handles of a legend: colour and name of each group or, if ``labels`` are given, of the ids in them."""
    from matplotlib.patches import Patch

    colours = group_colours(groups.part_groups) / 255
    present = range(1, groups.num_groups + 1) if labels is None else np.unique(to_numpy(labels)).tolist()
    named = [(colours[k], plain_name(groups.group_names[k - 1])) for k in present if 0 < k <= groups.num_groups]
    if IGNORE in present:
        named.append((IGNORE_COLOUR / 255, "ignored"))
    return [Patch(facecolor=colour, edgecolor="0.4", linewidth=0.5, label=name) for colour, name in named]


def empty_figure(width: float, height: float, layout: Literal["constrained"] | None = "constrained") -> Figure:
    """Make an empty figure with a size in inches, which belongs to no window."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DPI, layout=layout)


def add_legend(figure: Figure, patches: list[Patch]) -> None:
    """Add a legend of parts below the axes."""
    columns = legend_columns(figure.get_figwidth() * DPI)
    figure.legend(
        handles=patches, loc="outside lower center", ncols=columns, frameon=False, fontsize=8, columnspacing=1.2
    )


def legend_columns(width: float) -> int:
    """Number of a legend's columns that fit into a width [px]."""
    return max(int(width // 135), 1)


def show_picture(axes: Axes, picture: np.ndarray) -> None:
    """Show a picture on axes, so that pixel (v, u) has its centre at (u + 0.5, v + 0.5)."""
    height, width = picture.shape[:2]
    axes.imshow(picture, extent=(0, width, height, 0))
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")


def outline_labels(axes: Axes, labels: np.ndarray) -> None:
    """Draw the borders of all labels on axes."""
    v = np.arange(labels.shape[0]) + 0.5
    u = np.arange(labels.shape[1]) + 0.5
    for group in np.unique(labels[labels != BACKGROUND]):
        axes.contour(u, v, labels == group, levels=[0.5], colors="0.25", linewidths=0.8)


def draw_groups(posed: Posed, camera: Camera, size: tuple[int, ...], groups: LabelSet) -> np.ndarray:
    """Draw a body's group ids, shape (H, W), uint8."""
    image = draw_ellipsoids(posed, camera, (size[0], size[1]), part_labels=groups.part_groups[1:].tolist())
    return image.labels[0].cpu().numpy()


def body_sizes(posed: Posed) -> np.ndarray:
    """Sizes of a body [m] in the order of ``LENGTH_NAMES``, then ``THICKNESS_NAMES``, shape (27,)."""
    sizes = np.zeros(len(LENGTH_NAMES) + len(THICKNESS_NAMES))
    sizes[np.array(SIZE_COLUMNS)] = 2 * posed.semi_axes[0].cpu().numpy()
    return sizes


def first_body(body: Body) -> Posed:
    """Take the first body of a fit, of parameters or of posed bodies, without gradients."""
    if not isinstance(body, Body):
        raise TypeError(f"body: {type(body).__name__}; expected FitResult, BodyParameters or Posed")
    posed = body.posed if isinstance(body, FitResult) else body.posed() if isinstance(body, BodyParameters) else body
    if posed.joints.shape[0] == 0:
        raise ValueError("body: none in the batch; expected one or more")
    return Posed(*(tensor[:1].detach() for tensor in vars(posed).values()))


def first_camera(body: Body, camera: Camera | None) -> Camera:
    """Take the first camera of a batch, or the fit's own camera if none is given."""
    if camera is None and isinstance(body, FitResult):
        camera = body.camera
    if camera is None:
        raise ValueError(f"camera: none; expected one, as {type(body).__name__} doesn't say how large the picture is")
    return first_of(camera)


def find_label_set(given: LabelSet | str | None) -> LabelSet:
    """Return a label set that is given or named; None: the 20 parts."""
    return given if isinstance(given, LabelSet) else label_set(given or PARTS)


def to_numpy(image: Image) -> np.ndarray:
    """Copy an image to the host, without its gradient."""
    return image.detach().cpu().numpy() if isinstance(image, torch.Tensor) else np.asarray(image)


def read_groups(name: str, image: Image, groups: LabelSet) -> np.ndarray:
    """Check group ids, and return them on the host, shape (H, W); the first ones of a batch."""
    labels = to_numpy(image)
    labels = labels[0] if labels.ndim == 3 and len(labels) else labels
    if labels.ndim != 2 or labels.dtype != np.uint8 or not labels.size:
        raise ValueError(f"{name}: {labels.dtype} {labels.shape}; expected uint8 group ids (H, W)")
    if (strange := labels[(labels > groups.num_groups) & (labels != IGNORE)]).size:
        raise ValueError(f"{name}: id {strange[0]}; expected 0 to {groups.num_groups} of {groups.name}, or {IGNORE}")
    return labels


def plain_name(name: str) -> str:
    """Return a name with blanks for underscores."""
    return name.replace("_", " ")
