"""The plan of ``partdr bench kernels``: the paper's targets first, then other renderers, batches and sizes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

from ..renderers import COVERAGE, EXACT, GRADIENTS, LEVELS, MESH, PARTDR

# Groups of rows in the order of the table.
TARGETS = "The paper's targets"
OTHERS = "Other renderers, batches and sizes"
KERNELS = "Kernels, each in its place in a run"
STARTS = "Starts"
CALLS = "Calls from torch, until the device is done"
STEPS = "Whole steps of a training: parameters, loss, gradient, Adam"
PEER_ROWS = "Peers: the same mesh, the same target"
GROUPS = (TARGETS, CALLS, OTHERS, STEPS, KERNELS, STARTS, PEER_ROWS)

LABELS, GRADIENT, REFINEMENT = "label image", "render, L_seg, gradient", "50 iterations"
TORCH_GRADIENT, TORCH_REFINEMENT = "forward, backward in torch", "50 iterations in torch"
TORCH_BODY = "from parameters: L_seg, gradient, in torch"
TORCH_LABELS, TORCH_POSE = "label image in torch", "pose, gradient, in torch"
MINIMISE = "50 iterations, one target, with set-up"
LOOP_STEP, WHOLE_STEP = "step, loop in Python", "whole step, TrainingStep"
COMPILED_STEP = "compiled step: the loop, its loss by torch.compile"
POSED = ", posed"  # end of a renderer's name: `posed` and `ellipsoid_label_loss`, else `crop_loss`
TORCH_ITSELF = "torch itself"  # an autograd function that finds nothing: what is left when rendering takes no time

Run = tuple[str, str, int, int]  # what, renderer, B, side of the picture [px]


@dataclass(frozen=True)
class KernelPlan:
    """Rows to time."""

    device: str  # "cpu" or "cuda:0"
    size: int  # side of the picture of kernels and peers [px]
    targets: tuple[Run, ...]  # runs that stand first
    calls: tuple[Run, ...]
    others: tuple[Run, ...]
    steps: tuple[Run, ...]
    batches: tuple[int, ...]  # those whose kernels are timed one by one, and that peers draw
    budget: float  # for each row [s]
    start: bool = True  # whether to time a cold and a warm start
    gradients: bool = True  # whether to compare gradients of meshes with the true one


def plan_kernels(device: str, *, quick: bool = False) -> KernelPlan:
    """The rows that the command times on "cpu" or on a CUDA device."""
    size = 256
    batches: tuple[int, ...] = (1, 16)
    middle = 16
    exact = mesh = labels = refined = trained = batches
    compiled: tuple[int, ...] = ()  # on the CPU, torch needs a C++ compiler
    if device != "cpu":
        batches, middle = (1, 8, 128, 1024), 128
        exact, mesh, labels, refined = (1, 128, 1024), (128,), (128,), (1, 1024)
        trained = (1, 8, 128)
        compiled = (1, 128)
    targets = (
        *product([GRADIENT], [EXACT], exact, [size]),
        *product([GRADIENT], [MESH], mesh, [size]),
        *product([LABELS], [EXACT, MESH], labels, [size]),
        *product([REFINEMENT], [EXACT], refined, [size]),
        *product([TORCH_GRADIENT], [EXACT, MESH], [1], [size]),
    )
    if quick:
        return KernelPlan(device, size, targets, (), (), (), (1,), 0.1, start=False, gradients=False)
    calls = (
        (TORCH_GRADIENT, TORCH_ITSELF, 1, size),
        *product([TORCH_BODY], [EXACT, MESH], exact, [size]),
        *product([TORCH_GRADIENT], [EXACT, MESH], exact[1:], [size]),
        *product([TORCH_LABELS], [EXACT, MESH], exact, [size]),
        *product([TORCH_POSE], [""], exact, [size]),
    )
    others = (
        *product([LABELS], [EXACT, *LEVELS], batches, [size]),
        *product([GRADIENT], [*GRADIENTS, *LEVELS], batches, [size]),
        *product([LABELS, GRADIENT], [EXACT, MESH], [middle], [128, 512]),
        *product([REFINEMENT], [COVERAGE, PARTDR], refined, [size]),
        *product([MINIMISE], [EXACT], refined, [size]),
        *product([TORCH_GRADIENT], [COVERAGE, PARTDR], [1], [size]),
        (TORCH_REFINEMENT, EXACT, 1, size),
        *product([TORCH_GRADIENT], [COVERAGE, PARTDR], [middle], [size]),
    )
    drawn = [EXACT, EXACT + POSED, MESH]
    steps = (
        *product([LOOP_STEP, WHOLE_STEP], drawn, trained, [size]),
        *product([COMPILED_STEP], drawn, compiled, [size]),
    )
    left = tuple(row for row in others if row not in targets)
    return KernelPlan(device, size, targets, calls, left, steps, (1, middle), 0.4)
