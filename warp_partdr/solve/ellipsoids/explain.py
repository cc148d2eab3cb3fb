"""Report about one input: what a fit models, what it leaves out, and why (``partdr fit --explain``)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...body.labels import BACKGROUND, IGNORE
from ...body.template import PART_NAMES
from ...cameras import USUAL_FOCAL, Perspective
from ...inputs.keypoints import Keypoints2D
from ...inputs.observation import REFERENCE_SIZE, Observation, observe
from ...inputs.part_labels import PartLabels
from ...render.renderers import Renderer, RendererEllipsoids, RendererMesh
from ..mesh.drawn_model import drawn_vertices
from ..mesh.mesh_options import MeshOptions
from .far_people import shows_parts
from .options import FitOptions, stages_of
from .stages import Stage

if TYPE_CHECKING:
    from rich.console import Console

    from ...models.model import DetailedModel


class Choice(NamedTuple):
    """Aspect of the input: the share that a fit models, the share that it leaves out, and the reason."""

    what: str
    modelled: str
    left_out: str
    why: str


def explain(
    keypoints: Keypoints2D,
    parts: PartLabels | None = None,
    *,
    others: Sequence[Keypoints2D] = (),
    options: FitOptions | None = None,
    camera: Perspective | None = None,
) -> list[Choice]:
    """Describe what ``fit_body`` models with the same arguments.

    Args:
        keypoints: Keypoints of the person in the picture.
        parts: Part labels of the picture; None: keypoints alone.
        others: Keypoints of the other people in the picture.
        options: Options of the fit.
        camera: Camera of the picture, if it is known.

    Raises:
        InputError: If ``fit_body`` would raise it.

    Examples:
        After ``parts = read_parts("parts.png", "cdcl14")`` and ``person = read_keypoints("keypoints.json")[0]``:

        >>> from warp_partdr import explain
        >>> choices = explain(person, parts)
        >>> choices[0].what, choices[0].modelled
        ('keypoints', '17 of 17 (coco17)')
    """
    options = options or FitOptions()
    observation, crop = observe(keypoints, parts, others=others, trust_background=options.trust_background)
    stages = stages_of(options, parts)
    choices = [
        _keypoints(keypoints),
        _camera(
            camera,
            assumed=observation.lens_assumed and options.guess_camera,
            labelled=shows_parts(observation.label_set),
        ),
        _size(options.stature),
        _start(options),
    ]
    if parts is None:
        left = {stage.name for stage in stages}
        skipped = [stage.name for stage in options.stages if stage.name not in left]
        return [*choices, Choice("part labels", "", _list(["L_seg", *skipped]), "there are none: nothing is drawn")]
    drawn = [stage for stage in stages if stage.size > 0]
    if not drawn:
        return [*choices, Choice("part labels", "the start", "L_seg", "no stage draws")]
    side = REFERENCE_SIZE / crop.zoom
    size = np.array(parts.groups.shape)
    start = np.array([crop.top, crop.left])
    covered = np.prod(np.clip(start + side, 0, size) - np.clip(start, 0, size)) / size.prod()
    sizes = _list(sorted({stage.size for stage in drawn}))
    return [
        *choices,
        Choice(
            "picture",
            f"{side:.0f} x {side:.0f} px around the person, drawn at {sizes} px",
            f"{100 * (1 - covered):.0f} % of it" if covered < 1 else "",
            "the rest shows nothing of the person" if covered < 1 else "the person fills it",
        ),
        *_labels(observation, max(stage.size for stage in drawn)),
        *_parts(parts),
        _depth_order(parts, options),
        _depth(parts, drawn, options),
        _path(parts, options),
    ]


def explain_mesh(model: DetailedModel, parts: PartLabels | None, options: MeshOptions) -> Choice:
    """Describe how much of a detailed model ``partdr fit`` draws."""
    if parts is None:
        return Choice("detailed body", "a mesh put on the ellipsoids", "the mesh stage", "there are no labels")
    most, every = drawn_vertices(model, options), model.num_vertices
    modelled = f"{min(most, every):,} vertices and thicknesses of clothes, drawn against the labels"
    if every <= most:
        return Choice("detailed body", modelled, "", "it has no more")
    left_out = f"{every - most:,} until the end: fingers, toes, face"
    return Choice("detailed body", modelled, left_out, "labels show no more of it")


def print_choices(choices: list[Choice], console: Console) -> None:
    """Print the choices as a table."""
    from rich.table import Table

    table = Table(title="What is modelled, and what is not", show_lines=True)
    for heading in ("what", "modelled", "left out", "why"):
        table.add_column(heading)
    for choice in choices:
        table.add_row(*(value or "-" for value in choice))
    console.print(table)


def _keypoints(keypoints: Keypoints2D) -> Choice:
    landmarks = np.array(keypoints.format.landmarks)
    missing = landmarks[~keypoints.visible]
    return Choice(
        "keypoints",
        f"{len(landmarks) - len(missing)} of {len(landmarks)} ({keypoints.format.name})",
        _list(missing),
        "a confidence of 0 pulls nowhere" if missing.size else "all were seen",
    )


def _camera(camera: Perspective | None, *, assumed: bool, labelled: bool) -> Choice:
    if camera is None and assumed:
        lens = f"a usual lens, {USUAL_FOCAL:g} times as long as the picture's longer side"
        if labelled:
            lens += ", or a longer one if part labels show the person far away"
        return Choice("camera", lens, "the true one", "no focal length was given")
    if camera is None:
        left_out = "distance; rays beside the axis"
        return Choice("camera", "weak perspective about the body", left_out, "no focal length was given")
    return Choice("camera", f"perspective, focal length {float(camera.focal[0, 0]):.0f} px", "", "it was given")


def _size(stature: float | None) -> Choice:
    if stature is None:
        return Choice("size", "the label network's guess, from proportions", "the true one", "no stature was given")
    return Choice("size", f"a person {stature:g} m tall", "the label network's guess", "it was given")


def _start(options: FitOptions) -> Choice:
    if options.start == "search":
        return Choice("start", f"up to {options.stages[0].bodies} hypotheses", "the label network", "it was asked for")
    if not options.search:
        return Choice("start", "the label network's body", "the search", "it was asked for")
    why = "only where that body ends far from keypoints or labels"
    return Choice("start", "the label network's body", f"up to {options.search[0].bodies} hypotheses", why)


def _labels(observation: Observation, size: int) -> Iterator[Choice]:
    assert observation.label_set is not None
    assert observation.labels is not None
    groups = observation.label_set.num_groups
    megabytes = 4 * groups * size**2 / 1e6
    if observation.maps is None:
        yield Choice(
            "L_seg",
            f"one byte a pixel: {size**2 / 1e3:.0f} KB",
            f"{groups} maps of floats: {megabytes:.1f} MB a body, and as much of gradients",
            "loss and gradient of a pixel follow from two labels, the target's and the one shown",
        )
    else:
        yield Choice(
            "L_seg", f"{groups} maps of probabilities: {megabytes:.1f} MB a body", "", "probabilities were given"
        )
    labels = observation.labels.cpu().numpy()
    ignored = np.mean(labels == IGNORE)
    yield Choice(
        "pixels of the crop",
        f"{100 * (1 - ignored):.0f} %",
        f"{100 * ignored:.0f} %" if ignored else "",
        "ignored: other people, what the set does not know, limbs that labels miss, beyond the border"
        if ignored
        else "every pixel's label is known",
    )
    present = set(np.unique(labels).tolist()) - {BACKGROUND, IGNORE}
    absent = [name for group, name in enumerate(observation.label_set.group_names, start=1) if group not in present]
    yield Choice(
        "groups of parts",
        f"{len(present)} of {groups} ({observation.label_set.name}) are present",
        f"the pull on {_list(absent)}" if absent else "",
        "no pixel of the crop shows them: they can only be wrong" if absent else "all are in the crop",
    )


def _parts(parts: PartLabels) -> Iterator[Choice]:
    label_set = parts.label_set
    left_out = [name for name in PART_NAMES if name in label_set.left_out]
    free = [name for name, group in zip(PART_NAMES, label_set.part_groups[1:], strict=True) if group == IGNORE]
    yield Choice(
        "ellipsoids",
        f"{len(PART_NAMES) - len(left_out)} of {len(PART_NAMES)} drawn",
        _list(left_out),
        f"{label_set.name} leaves them out" if left_out else f"each is in a group of {label_set.name}, or hides others",
    )
    if free:
        yield Choice("parts in no group", f"{_list(free)} hide what is behind", "their labels", "the set has none")


def _depth_order(parts: PartLabels, options: FitOptions) -> Choice:
    flips = "limbs that lie over other parts, mirrored"
    if parts.label_set.num_groups == 1:
        return Choice("depth order", "", flips, "with one label, nothing that shows hides something else")
    if options.start == "search":
        return Choice("depth order", "", flips, "hypotheses have either")
    if not options.depth_flips:
        return Choice("depth order", "", flips, "it was asked for")
    return Choice("depth order", flips, "", "keypoints do not tell it, labels do where parts overlap")


def _depth(parts: PartLabels, drawn: list[Stage], options: FitOptions) -> Choice:
    stages = [stage.name for stage in drawn if _has_depth_gradient(stage.renderer)]
    if parts.label_set.num_groups == 1:
        return Choice("z gradient", "", "all of it", "with one label, nothing that shows hides something else")
    if all(stage.renderer.depth_weight == 0 for stage in drawn if stage.name in stages):
        return Choice("z gradient", "", "all of it", "its weight is 0" if stages else "only PartDR's rule has one")
    others = [stage.name for stage in drawn if stage.name not in stages]
    why = "only PartDR's rule has one" if others else "parts of one label can hide those of another"
    return Choice("z gradient", f"stages {_list(stages)}", f"stages {_list(others)}" if others else "", why)


def _has_depth_gradient(renderer: Renderer) -> bool:
    return isinstance(renderer, RendererMesh) or renderer.gradient == "partdr"


def _path(parts: PartLabels, options: FitOptions) -> Choice:
    if parts.maps is None and isinstance(options.renderer, RendererEllipsoids):
        why = "labels and exact ellipsoids need no more"
        return Choice("an iteration", "one graph of kernels, captured once", "autograd, Python", why)
    why = "against probabilities" if parts.maps is not None else "of a mesh"
    return Choice("an iteration", "kernels called through torch.autograd", "", f"gradients {why} go through torch")


def _list(names: Sequence[object] | np.ndarray) -> str:
    return "; ".join(str(name) for name in names)  # names of stages have commas
