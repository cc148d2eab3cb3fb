"""``partdr bench savings``: time and memory saved by modelling only what a scene requires, one row a saving."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, get_args

import torch

from ...body.labels import label_set
from ...body.parameters import BodyParameters
from ...body.template import PART_NAMES
from ...cameras import Crop, WeakPerspective
from ...interop.device_cache import device_cache
from ...render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from ...render.mesh import mesh_label_loss
from ...render.options import Gradient
from ...render.part_mesh import PartMesh, ellipbody_mesh
from ...solve.ellipsoids.stages import Progress
from ..tables import RecordColumn, print_tables, record_table
from .jobs import run_jobs
from .machine import in_words
from .scene import BenchScene
from .timing import peak_memory, time_in_turn

if TYPE_CHECKING:
    from rich.console import Console

_SIZE = 256
_BATCH = {"cpu": 4, "cuda": 64}
_NUM_PARTS = len(PART_NAMES)
_FEW = 3  # parts of a small scene
_TIPS = ("left_hand", "right_hand", "left_foot", "right_foot")
_NO_PARTS = [0] * _NUM_PARTS


_Call = Callable[[], object]
_Option = tuple[str, _Call]  # its name, and what is timed
_Case = tuple[str, _Option, _Option, _Call | None]  # saving, the whole, what is needed, and nothing that could be saved


def run_savings(device: str, *, budget: float = 1.0, progress: Progress | None = None) -> list[dict[str, Any]]:
    """Time each saving.

    Args:
        device: Device, "cpu" or a CUDA device.
        budget: Time for each of the two or three figures of a row [s].
        progress: Function that is called with (name, rows done, rows in all).

    Returns:
        Rows for JSON, one for each thing that need not be modelled. ``left`` is the time that is left, as a share of
        what depends on the thing saved. ``nothing_s`` is 0 where that means nothing. Bytes are peaks on CUDA, else
        None.
    """
    rows: list[dict[str, Any]] = []

    def add(case: _Case) -> None:
        name, (whole, before), (needed, after), base = case
        calls = [before, after] + ([] if base is None else [base])
        seconds = [timing.median for timing in time_in_turn(calls, device, budget * len(calls))]
        whole_s, needed_s, nothing_s = seconds if len(seconds) == 3 else (*seconds, 0.0)
        rows.append(
            {
                "name": name,
                "whole": whole,
                "needed": needed,
                "whole_s": whole_s,
                "needed_s": needed_s,
                "nothing_s": nothing_s,
                "left": (needed_s - nothing_s) / (whole_s - nothing_s),
                "whole_bytes": peak_memory(before, device),
                "needed_bytes": peak_memory(after, device),
            }
        )

    scene = BenchScene.random(_BATCH["cpu" if device == "cpu" else "cuda"], _SIZE, device)
    cases = [*_body_cases(scene), *_sphere_cases(scene.batch_size, device)]
    run_jobs([(case[0], partial(add, case)) for case in cases], progress)
    return rows


def _body_cases(scene: BenchScene) -> Iterator[_Case]:
    camera, targets = scene.camera, scene.targets
    posed = Ellipsoids(*[t.detach() for t in (scene.posed.centres, scene.posed.axes, scene.posed.semi_axes)])
    loss = partial(_loss_of_ellipsoids, posed, camera, targets)
    maps = partial(_loss_of_maps, posed, camera, targets)
    yield "L_seg against labels", (f"{_NUM_PARTS} maps of floats", maps), ("the label image", loss), None

    of_mesh = partial(_loss_of_mesh, scene.posed.vertices(1).detach(), camera, (targets > 0).to(torch.uint8))
    looked_for, left_out = ("looked for", partial(of_mesh, 1.0)), ("left out", partial(of_mesh, 0.0))
    yield "z gradient of one label, mesh E1", looked_for, left_out, None

    of_body = partial(_loss_of_body, scene)
    frozen = "lengths, thicknesses frozen", partial(of_body, ("lengths", "thicknesses"))
    yield "sizes of the body", ("gradients of all parameters", partial(of_body, ())), frozen, None

    no_tips = [0 if name in _TIPS else part for part, name in enumerate(PART_NAMES, start=1)]
    without = "left out by the label set", partial(loss, part_labels=no_tips)
    yield "hands and feet", ("drawn", loss), without, partial(loss, part_labels=_NO_PARTS)

    large_camera, large_targets = _in_larger_picture(camera, targets, times=4)
    large = partial(_loss_of_ellipsoids, posed, large_camera, large_targets)
    size = large_targets.shape[1]
    yield "region of interest", (f"picture of {size} px", large), (f"crop of {_SIZE} px", loss), None


def _sphere_cases(batch: int, device: str) -> Iterator[_Case]:
    """Spheres of one size side by side, so that a part is a part."""
    index = torch.arange(_NUM_PARTS, device=device)
    grid = torch.stack([index % 5 - 2.0, index // 5 - 1.5, torch.zeros_like(index)], dim=1) * 0.36
    spheres = Ellipsoids(
        grid.expand(batch, -1, 3).contiguous(),
        torch.eye(3, device=device).expand(batch, _NUM_PARTS, 3, 3).contiguous(),
        torch.full((batch, _NUM_PARTS, 3), 0.12, device=device),
    )
    camera = WeakPerspective(
        torch.full((batch,), _SIZE / 2, device=device), torch.full((batch, 2), _SIZE / 2, device=device)
    )
    moved = replace(spheres, centres=spheres.centres + 0.02)
    targets = draw_ellipsoids(moved, camera, (_SIZE, _SIZE)).labels
    few_targets = torch.where(targets <= _FEW, targets, 0).to(torch.uint8)
    few = Ellipsoids(*[t[:, :_FEW].contiguous() for t in (spheres.centres, spheres.axes, spheres.semi_axes)])
    beside = spheres.centres.clone()
    beside[:, _FEW:, 0] += 100.0
    apart = replace(spheres, centres=beside)
    for gradient in get_args(Gradient):
        loss = partial(_loss_of_ellipsoids, gradient=gradient)
        whole = partial(loss, spheres, camera, targets)
        none = partial(loss, spheres, camera, torch.zeros_like(targets), part_labels=_NO_PARTS)
        fewer = f"{_FEW} of them", partial(loss, few, camera, few_targets)
        yield f"parts of a scene, {gradient}", (f"{_NUM_PARTS} equal spheres", whole), fewer, none
        in_it = f"{_FEW} in it, the others beside", partial(loss, apart, camera, few_targets)
        yield f"parts out of the picture, {gradient}", (f"{_NUM_PARTS} equal spheres in it", whole), in_it, none


def _leaves(ellipsoids: Ellipsoids) -> Ellipsoids:
    return Ellipsoids(*[t.requires_grad_() for t in (ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes)])


def _gradient(loss: torch.Tensor, ellipsoids: Ellipsoids) -> object:
    return torch.autograd.grad(loss.sum(), (ellipsoids.centres, ellipsoids.axes, ellipsoids.semi_axes))


def _loss_of_ellipsoids(
    ellipsoids: Ellipsoids,
    camera: WeakPerspective,
    targets: torch.Tensor,
    *,
    part_labels: list[int] | None = None,
    gradient: Gradient = "coverage",
) -> object:
    leaves = _leaves(ellipsoids)
    loss, _ = ellipsoid_label_loss(leaves, camera, targets, part_labels=part_labels, gradient=gradient, validate=False)
    return _gradient(loss, leaves)


def _loss_of_maps(ellipsoids: Ellipsoids, camera: WeakPerspective, targets: torch.Tensor) -> object:
    leaves = _leaves(ellipsoids)
    maps = draw_ellipsoids(leaves, camera, (_SIZE, _SIZE), num_maps=_NUM_PARTS, validate=False).maps
    assert maps is not None
    index = torch.arange(1, _NUM_PARTS + 1, device=targets.device)
    return _gradient((maps - (targets[:, None] == index[:, None, None]).float()).square(), leaves)


def _loss_of_mesh(
    vertices: torch.Tensor, camera: WeakPerspective, silhouette: torch.Tensor, depth_weight: float
) -> object:
    mesh = _silhouette_mesh(silhouette.device)
    vertices = vertices.requires_grad_()
    loss = mesh_label_loss(vertices, mesh, camera, silhouette, depth_weight=depth_weight, validate=False)[0]
    return torch.autograd.grad(loss.sum(), vertices)


@device_cache(1)
def _silhouette_mesh(device: torch.device) -> PartMesh:
    return ellipbody_mesh(1, device=device).relabel(label_set("full1").part_groups)


def _loss_of_body(scene: BenchScene, frozen: tuple[str, ...]) -> object:
    bodies = scene.bodies.leaves(frozen)
    loss = ellipsoid_label_loss(bodies.posed(), bodies.camera(_SIZE), scene.targets, validate=False)[0]
    return torch.autograd.grad(loss.sum(), [bodies.tensors()[name] for name in BodyParameters.free(frozen)])


def _in_larger_picture(
    camera: WeakPerspective, targets: torch.Tensor, times: int
) -> tuple[WeakPerspective, torch.Tensor]:
    """Camera and labels where the picture is ``times`` as wide and as high, with the person in its middle."""
    size = times * _SIZE
    start = (size - _SIZE) // 2
    labels = targets.new_zeros(len(targets), size, size)
    labels[:, start : start + _SIZE, start : start + _SIZE] = targets
    return camera.in_full(Crop(start, start, 1.0, (_SIZE, _SIZE))), labels


def _milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.2f}" if seconds else ""


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f}"


_COLUMNS = (
    RecordColumn("what", "name"),
    RecordColumn("whole", "whole"),
    RecordColumn("needed", "needed"),
    RecordColumn("whole [ms]", "whole_s", _milliseconds),
    RecordColumn("needed [ms]", "needed_s", _milliseconds),
    RecordColumn("nothing [ms]", "nothing_s", _milliseconds),
    RecordColumn("left", "left", lambda share: f"{100 * share:.0f} %"),
    RecordColumn("whole [MB]", "whole_bytes", _megabytes),
    RecordColumn("needed [MB]", "needed_bytes", _megabytes),
)


def print_savings(rows: Sequence[Mapping[str, Any]], machine: Mapping[str, str], console: Console) -> None:
    """A table."""
    title = "Model only what a scene requires: L_seg and its gradient through torch, medians"
    note = "left: needed over whole, each less the time of a scene without parts, where that was taken."
    table = record_table(title, _COLUMNS, rows, left=(0, 1, 2))
    print_tables([in_words(machine)], [table], [], [note], console)
