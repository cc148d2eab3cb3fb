"""Errors of gradients of meshes, ours and others': beside the derivative of the area that shows a wrong label."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any, get_args

import torch

from ....cameras import ScreenCamera
from ....render.mesh import draw_mesh, mesh_label_loss
from ....render.options import MeshGradient
from ..renderers import LEVELS
from ..scene import BenchScene
from .calls import mesh_view
from .peers import OURS, PEERS, MeshView

_Loss = Callable[[torch.Tensor], torch.Tensor]

BODIES = 4
_SAMPLES = 4  # a side of a pixel, of pictures whose areas are counted
_STEP = 0.5  # [px], how far parts are moved to and fro


def measure_gradients(size: int, device: str, remarks: list[str]) -> Iterator[dict[str, Any]]:
    """Rows of figures: mean cosine and length of each renderer's gradient by the true one, at each level of the mesh.

    Args:
        size: Side of the picture [px].
        device: Device to draw on.
        remarks: List to which a line is added about each peer that fails.
    """
    scene = BenchScene.random(BODIES, size, device)
    for level in LEVELS:
        view = mesh_view(scene, level)
        true = true_moves(view)
        for name, loss in _losses(view).items():
            leaf = view.vertices.clone().requires_grad_()
            try:
                (gradient,) = torch.autograd.grad(loss()(leaf), leaf)
            except Exception as error:  # whatever somebody else's package raises
                if name.startswith(OURS):
                    raise
                remarks.append(f"{name}: no gradient, it failed: {type(error).__name__}: {error}")
                continue
            cosine, length = compare_moves(part_moves(view, gradient), true)
            yield {"renderer": name, "mesh": level, "cosine": cosine, "length": length}


def _losses(view: MeshView) -> dict[str, Callable[[], _Loss]]:
    """Losses of a picture by the renderer's name, each made when it is wanted."""

    def theirs(name: str) -> _Loss:
        loss = PEERS[name].adapt(view)[1]
        assert loss is not None
        return loss

    device = view.vertices.device.type
    found: dict[str, Callable[[], _Loss]] = {
        f"{OURS}, {rule}": partial(partial, _our_loss, view, rule) for rule in get_args(MeshGradient)
    }
    for name, peer in PEERS.items():
        if name != OURS and peer.differentiates and device in peer.devices and peer.is_installed:
            found[name] = partial(theirs, name)
    return found


def _our_loss(view: MeshView, rule: MeshGradient, vertices: torch.Tensor) -> torch.Tensor:
    scene = view.mesh, ScreenCamera(perspective=False), view.targets
    return mesh_label_loss(vertices, *scene, gradient=rule, depth_weight=0.0, validate=False)[0].sum()


def true_moves(view: MeshView) -> torch.Tensor:
    """Derivative of L_seg by moves of whole parts in u and v, in areas, not pixels, shape (B, 20, 2).

    Central differences of pictures so fine that a step is some of their pixels.
    """
    targets = view.targets.repeat_interleave(_SAMPLES, 1).repeat_interleave(_SAMPLES, 2)
    fine = replace(view, vertices=view.vertices * view.vertices.new_tensor([_SAMPLES, _SAMPLES, 1.0]), targets=targets)
    part_of, count = _part_of(view), view.mesh.num_labels
    found = view.vertices.new_zeros(len(targets), count, 2)
    for part in range(count):
        for axis in range(2):
            move = torch.zeros_like(view.vertices)
            move[:, part_of == part, axis] = _STEP * _SAMPLES
            losses = [_areas(fine, fine.vertices + sign * move) for sign in (1, -1)]
            found[:, part, axis] = (losses[0] - losses[1]) / (2 * _STEP)
    return found


def _areas(view: MeshView, vertices: torch.Tensor) -> torch.Tensor:
    """L_seg of hard labels [px of the picture before it was made finer], shape (B,)."""
    camera = ScreenCamera(perspective=False)
    labels = draw_mesh(vertices.contiguous(), view.mesh, camera, view.image_size, validate=False).labels
    wrong, shown, wanted = labels != view.targets, labels > 0, view.targets > 0
    return (wrong & shown).sum((1, 2)).add((wrong & wanted).sum((1, 2))).to(vertices) / _SAMPLES**2


def part_moves(view: MeshView, gradient: torch.Tensor) -> torch.Tensor:
    """Gradient by moves of whole parts in u and v, of that by vertices (B, V, 3), shape (B, 20, 2)."""
    found = gradient.new_zeros(len(gradient), view.mesh.num_labels, 2)
    return found.index_add(1, _part_of(view), gradient[..., :2])


def compare_moves(found: torch.Tensor, true: torch.Tensor) -> tuple[float, float]:
    """Mean cosine and mean ratio of lengths of two gradients (B, 20, 2), a body at a time."""
    cosine = torch.nn.functional.cosine_similarity(found.flatten(1), true.flatten(1), dim=1)
    return float(cosine.mean()), float((found.flatten(1).norm(dim=1) / true.flatten(1).norm(dim=1)).mean())


def _part_of(view: MeshView) -> torch.Tensor:
    """The part that each vertex belongs to, shape (V,), int64."""
    faces = view.mesh.faces.long()
    labels = view.mesh.face_labels.long() - 1
    part_of = torch.zeros(view.vertices.shape[1], dtype=torch.int64, device=faces.device)
    return part_of.index_copy(0, faces.flatten(), labels.repeat_interleave(3))
