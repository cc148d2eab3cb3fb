"""Write your own loss on part maps: any function of them has a gradient.

    python demos/own_loss.py --out FOLDER

The IoU of parts, in which a hand counts as much as the chest, instead of L_seg, which counts pixels. Writes
``before.png``, ``after.png`` and ``loss.png``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
import typer
import warp as wp

from warp_partdr import PART_NAMES, BodyParameters, draw_ellipsoids
from warp_partdr.plot import loss_curve, part_panels

K = len(PART_NAMES)


def iou_loss(maps: torch.Tensor, target_maps: torch.Tensor) -> torch.Tensor:
    """1 - IoU, mean of all parts that are there or in the target: small parts count as much as large ones.

    Args:
        maps: Part maps as the renderer makes them, shape (B, K, H, W): 1 where a part shows, else 0.
        target_maps: Part maps of the target, the same shape.
    """
    overlap = (maps * target_maps).sum((2, 3))
    union = (maps + target_maps - maps * target_maps).sum((2, 3))
    counts = union > 0
    return ((1 - overlap / union.clamp_min(1)) * counts).sum(1) / counts.sum(1).clamp_min(1)


def one_hot(labels: torch.Tensor) -> torch.Tensor:
    """Part maps (B, K, H, W) of a label image (B, H, W)."""
    index = torch.arange(1, K + 1, dtype=torch.uint8, device=labels.device)
    return (labels[:, None] == index[:, None, None]).float()


def main(out: Path = Path("out/own_loss"), size: int = 192, iterations: int = 80) -> list[float]:
    """Follow the IoU of parts in a picture with sides of ``size`` pixels, and write pictures to a folder."""
    wp.config.log_level = wp.LOG_WARNING
    out.mkdir(parents=True, exist_ok=True)
    shape = (size, size)

    # The target: a mean body with bent elbows and one leg to the side, seen in a picture of 2 m by 2 m.
    start = BodyParameters.mean(1)
    goal = start.rotations.clone()
    for name, turn in (
        ("left_upper_arm", (0.0, 0.0, -0.4)),
        ("right_forearm", (0.0, 0.0, -0.6)),
        ("left_upper_leg", (0.0, 0.0, 0.3)),
    ):
        goal[0, PART_NAMES.index(name)] = torch.tensor(turn)
    camera = start.camera(size)
    target = draw_ellipsoids(replace(start, rotations=goal).posed(), camera, shape).labels
    part_panels(target, draw_ellipsoids(start.posed(), camera, shape).labels).savefig(out / "before.png")

    # With ``num_maps`` the renderer makes float maps (B, K, H, W). Whatever is computed from them flows back: here each
    # pixel's share of the IoU, which PartDR turns into pulls on outlines.
    target_maps = one_hot(target)
    rotations = start.rotations.clone().requires_grad_()
    optimizer = torch.optim.Adam([rotations], lr=0.03)
    losses = []
    for _ in range(iterations):
        optimizer.zero_grad()
        posed = replace(start, rotations=rotations).posed()
        image = draw_ellipsoids(posed, camera, shape, num_maps=K, gradient="partdr")
        loss = iou_loss(image.maps, target_maps).sum()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    part_panels(target, image.labels).savefig(out / "after.png")
    loss_curve(losses, label="1 - IoU").savefig(out / "loss.png")
    print(f"1 - IoU: {losses[0]:.3f} at the start, {losses[-1]:.3f} after {len(losses)} iterations")
    print(f"Pictures: {out}")
    return losses


if __name__ == "__main__":
    typer.run(main)
