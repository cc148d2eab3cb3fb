"""``partdr bench savings``: time and memory saved by modelling only what a scene requires, one row a saving."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

import torch

from ..body.labels import label_set
from ..body.parameters import BodyParameters
from ..body.template import PART_NAMES
from ..cameras import Crop, WeakPerspective
from ..fit.fitting import Progress
from ..render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from ..render.mesh import mesh_label_loss
from ..render.options import Gradient
from ..render.part_mesh import PartMesh, ellipbody_mesh
from .jobs import run_jobs
from .machine import in_words
from .report import make_table, print_tables
from .scene import BenchScene
from .timing import Timing, peak_memory, time_in_turn

if TYPE_CHECKING:
    from rich.console import Console

_SIZE = 256
_BATCH = {"cpu": 4, "cuda": 64}
_NUM_PARTS = len(PART_NAMES)
_FEW = 3  # parts of a small scene
_TIPS = ("left_hand", "right_hand", "left_foot", "right_foot")
_NO_PARTS = [0] * _NUM_PARTS


@dataclass(frozen=True)
class Saving:
    """One thing that need not be modelled.

    Attributes:
        name: Of the thing saved.
        whole: Modelled otherwise.
        needed: Modelled instead.
        before: Time of ``whole``.
        after: Time of ``needed``.
        base: Time of the same call with nothing in it that could be saved, 0 where that means nothing.
        memory_before: Peak memory of ``whole`` [bytes]; on CUDA.
        memory_after: Of ``needed``.
    """

    name: str
    whole: str
    needed: str
    before: Timing
    after: Timing
    base: Timing
    memory_before: int | None
    memory_after: int | None

    @property
    def share(self) -> float:
        """Time that is left, as a share of what depends on the thing saved."""
        return (self.after.median - self.base.median) / (self.before.median - self.base.median)


Call = Callable[[], object]


@dataclass(frozen=True)
class _Case:
    name: str
    whole: tuple[str, Call]
    needed: tuple[str, Call]
    base: Call | None = None


def run_savings(device: str, *, budget: float = 1.0, progress: Progress | None = None) -> list[Saving]:
    """Time each saving.

    Args:
        device: "cpu" or a CUDA device.
        budget: Of each of the two or three figures of a row [s].
        progress: Called with (name, rows done, rows in all).
    """
    rows: list[Saving] = []

    def add(case: _Case) -> None:
        (whole, before), (needed, after) = case.whole, case.needed
        calls = [before, after] + ([] if case.base is None else [case.base])
        timings = time_in_turn(calls, device, budget * len(calls))
        base = Timing((0.0,)) if case.base is None else timings[2]
        memory = [peak_memory(call, device) for call in (before, after)]
        rows.append(Saving(case.name, whole, needed, timings[0], timings[1], base, memory[0], memory[1]))

    run_jobs([(case.name, partial(add, case)) for case in _cases(device)], progress)
    return rows


def _cases(device: str) -> Iterator[_Case]:
    scene = BenchScene.random(_BATCH["cpu" if device == "cpu" else "cuda"], _SIZE, device)
    yield from _body_cases(scene)
    yield from _sphere_cases(scene.batch_size, device)


def _body_cases(scene: BenchScene) -> Iterator[_Case]:
    camera, targets = scene.camera, scene.targets
    posed = Ellipsoids(*[t.detach() for t in (scene.posed.centres, scene.posed.axes, scene.posed.semi_axes)])
    vertices = scene.posed.vertices(1).detach()
    loss = partial(_loss_of_ellipsoids, posed, camera, targets)

    yield _Case(
        "L_seg against labels",
        (f"{_NUM_PARTS} maps of floats", partial(_loss_of_maps, posed, camera, targets)),
        ("the label image", loss),
    )
    silhouette = (targets > 0).to(torch.uint8)
    yield _Case(
        "z gradient of one label, mesh E1",
        ("looked for", partial(_loss_of_mesh, vertices, camera, silhouette, 1.0)),
        ("left out", partial(_loss_of_mesh, vertices, camera, silhouette, 0.0)),
    )
    yield _Case(
        "sizes of the body",
        ("gradients of all parameters", partial(_loss_of_body, scene, ())),
        ("lengths, thicknesses frozen", partial(_loss_of_body, scene, ("lengths", "thicknesses"))),
    )
    no_tips = [0 if name in _TIPS else part for part, name in enumerate(PART_NAMES, start=1)]
    yield _Case(
        "hands and feet",
        ("drawn", loss),
        ("left out by the label set", partial(loss, part_labels=no_tips)),
        partial(loss, part_labels=_NO_PARTS),
    )
    large_camera, large_targets = _in_larger_picture(camera, targets, times=4)
    yield _Case(
        "region of interest",
        (f"picture of {large_targets.shape[1]} px", partial(_loss_of_ellipsoids, posed, large_camera, large_targets)),
        (f"crop of {_SIZE} px", loss),
    )


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
    gradient: Gradient
    for gradient in ("edges", "coverage", "partdr"):
        loss = partial(_loss_of_ellipsoids, gradient=gradient)
        whole = partial(loss, spheres, camera, targets)
        none = partial(loss, spheres, camera, torch.zeros_like(targets), part_labels=_NO_PARTS)
        yield _Case(
            f"parts of a scene, {gradient}",
            (f"{_NUM_PARTS} equal spheres", whole),
            (f"{_FEW} of them", partial(loss, few, camera, few_targets)),
            none,
        )
        yield _Case(
            f"parts out of the picture, {gradient}",
            (f"{_NUM_PARTS} equal spheres in it", whole),
            (f"{_FEW} in it, the others beside", partial(loss, replace(spheres, centres=beside), camera, few_targets)),
            none,
        )


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


@lru_cache(maxsize=1)
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


_HEADINGS = (
    *("what", "whole", "needed"),
    *("whole [ms]", "needed [ms]", "nothing [ms]", "left", "whole [MB]", "needed [MB]"),
)


def print_savings(rows: Sequence[Saving], machine: Mapping[str, str], console: Console) -> None:
    """A table."""
    cells = [
        [
            row.name,
            row.whole,
            row.needed,
            f"{1e3 * row.before.median:.2f}",
            f"{1e3 * row.after.median:.2f}",
            f"{1e3 * row.base.median:.2f}" if row.base.median else "",
            f"{100 * row.share:.0f} %",
            *("" if size is None else f"{size / 1e6:.1f}" for size in (row.memory_before, row.memory_after)),
        ]
        for row in rows
    ]
    title = "Model only what a scene requires: L_seg and its gradient through torch, medians"
    note = "left: needed over whole, each less the time of a scene without parts, where that was taken."
    print_tables([in_words(machine)], [make_table(title, _HEADINGS, cells, left=(0, 1, 2))], [], [note], console)


def savings_as_dict(rows: Sequence[Saving], machine: Mapping[str, str]) -> dict[str, Any]:
    """For JSON: seconds and bytes."""
    return {
        "machine": machine,
        "rows": [
            {
                "name": row.name,
                "whole": row.whole,
                "needed": row.needed,
                "whole_s": row.before.median,
                "needed_s": row.after.median,
                "nothing_s": row.base.median,
                "left": row.share,
                "whole_bytes": row.memory_before,
                "needed_bytes": row.memory_after,
            }
            for row in rows
        ],
    }
