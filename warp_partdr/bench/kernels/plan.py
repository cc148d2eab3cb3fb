"""The plan of ``partdr bench kernels``: the paper's targets first, then other renderers, batches and sizes."""

from __future__ import annotations

from dataclasses import dataclass

from ..renderers import COVERAGE, EXACT, GRADIENTS, LEVELS, MESH, PARTDR

LABELS, GRADIENT, REFINEMENT = "label image", "render, L_seg, gradient", "50 iterations"
TORCH_GRADIENT, TORCH_REFINEMENT = "forward, backward in torch", "50 iterations in torch"
MINIMISE = "50 iterations, one target, with set-up"
TORCH_ITSELF = "torch itself"  # an autograd function that finds nothing: what is left when rendering takes no time


@dataclass(frozen=True)
class KernelPlan:
    """Rows to time.

    Attributes:
        device: "cpu" or "cuda:0".
        size: Side of the picture [px].
        targets: Rows that stand first: (what, renderer, B).
        others: More of them: (what, renderer, B, size).
        kernels: Batches whose kernels are timed one by one.
        peers: Batches that peers draw.
        budget: For each row [s].
        start: Whether to time a cold and a warm start.
    """

    device: str
    size: int
    targets: tuple[tuple[str, str, int], ...]
    others: tuple[tuple[str, str, int, int], ...]
    kernels: tuple[int, ...]
    peers: tuple[int, ...]
    budget: float
    start: bool = True


def plan_kernels(device: str, *, quick: bool = False) -> KernelPlan:
    """The rows that the command times on "cpu" or on a CUDA device."""
    size = 256
    batches: tuple[int, ...] = (1, 16)
    middle = 16
    exact = mesh = labels = refined = batches
    if device != "cpu":
        batches, middle = (1, 8, 128, 1024), 128
        exact, mesh, labels, refined = (1, 128, 1024), (128,), (128,), (1, 1024)
    targets = (
        *((GRADIENT, EXACT, batch) for batch in exact),
        *((GRADIENT, MESH, batch) for batch in mesh),
        *((LABELS, name, batch) for name in (EXACT, MESH) for batch in labels),
        *((REFINEMENT, EXACT, batch) for batch in refined),
        *((TORCH_GRADIENT, name, 1) for name in (EXACT, MESH)),
    )
    if quick:
        return KernelPlan(device, size, targets, (), (1,), (1,), 0.1, start=False)
    grid = [
        *((LABELS, name, batch, size) for name in (EXACT, *LEVELS) for batch in batches),
        *((GRADIENT, name, batch, size) for name in (*GRADIENTS, *LEVELS) for batch in batches),
    ]
    sizes = [(what, name, middle, side) for name in (EXACT, MESH) for what in (LABELS, GRADIENT) for side in (128, 512)]
    more = [
        *((REFINEMENT, name, batch, size) for name in (COVERAGE, PARTDR) for batch in refined),
        *((MINIMISE, EXACT, batch, size) for batch in refined),
        *((TORCH_GRADIENT, name, 1, size) for name in (TORCH_ITSELF, COVERAGE, PARTDR)),
        (TORCH_REFINEMENT, EXACT, 1, size),
        *((TORCH_GRADIENT, name, middle, size) for name in (EXACT, COVERAGE, PARTDR, MESH)),
    ]
    first = {(what, name, batch, size) for what, name, batch in targets}
    others = tuple(row for row in (*grid, *sizes, *more) if row not in first)
    return KernelPlan(device, size, targets, others, (1, middle), (1, middle), 0.4)
