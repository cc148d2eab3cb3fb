"""Render a body's part labels, and see where wrong labels pull it.

    python demos/render_gradient.py --out FOLDER

Writes ``body.png``, ``target.png``, ``gradient.png`` (of exact ellipsoids), ``gradient_mesh.png`` and ``descent.png``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
import typer
import warp as wp

from warp_partdr import PART_NAMES, BodyParameters, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.plot import gradient_field, loss_curve, part_panels, turntable


def turned(arms: float, forward: float) -> torch.Tensor:
    """Local rotations (1, 20, 3) [rad]: arms so far below the T-pose, the right forearm bent to the trunk."""
    rotations = torch.zeros(1, len(PART_NAMES), 3)
    rotations[0, PART_NAMES.index("left_upper_arm"), 2] = -arms
    rotations[0, PART_NAMES.index("right_upper_arm"), 2] = arms
    rotations[0, PART_NAMES.index("right_forearm")] = torch.tensor([0.0, forward, 1.4])
    return rotations


def main(out: Path = Path("out/render_gradient"), size: int = 256, iterations: int = 60) -> list[float]:
    """Follow the gradient in a picture with sides of ``size`` pixels, and write pictures to a folder."""
    wp.config.log_level = wp.LOG_WARNING
    out.mkdir(parents=True, exist_ok=True)
    shape = (size, size)

    # A body is 20 ellipsoids. Its numbers are tensors: 12 lengths, 15 thicknesses, rotations and a camera.
    body = replace(BodyParameters.mean(1), rotations=turned(1.0, -0.8))
    turntable(body).savefig(out / "body.png")

    # The target is the same body with its arms lower, and the right forearm before the trunk instead of behind it. A
    # label image says which part each pixel shows.
    goal = replace(body, rotations=turned(1.2, 0.8))
    camera = goal.camera(size)
    target = draw_ellipsoids(goal.posed(), camera, shape).labels
    drawn = draw_ellipsoids(body.posed(), camera, shape).labels
    part_panels(target, drawn).savefig(out / "target.png")

    # A label image is made of steps, so its derivative is zero nearly everywhere. PartDR asks instead how far an
    # outline would have to move to put a pixel right, and that gives a gradient to each part, in depth too.
    # Blue comes forward, as the right forearm must; orange goes back, as the abdomen before it.
    gradient_field(body, target, camera=camera).savefig(out / "gradient.png")

    # A mesh has the same gradient at its vertices. This one is coarse and lies within the ellipsoids, so that it is
    # pulled outwards everywhere.
    gradient_field(body, target, camera=camera, renderer="mesh").savefig(out / "gradient_mesh.png")

    # The gradient goes on through the skeleton to the joints' rotations, and a few steps of Adam follow it.
    rotations = body.rotations.clone().requires_grad_()
    optimizer = torch.optim.Adam([rotations], lr=0.03)
    losses = []
    for _ in range(iterations):
        optimizer.zero_grad()
        posed = replace(body, rotations=rotations).posed()
        loss, _ = ellipsoid_label_loss(posed, camera, target, gradient="partdr")
        loss.sum().backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    loss_curve(losses, label="L_seg [px]").savefig(out / "descent.png")
    print(f"L_seg: {losses[0]:.0f} px at the start, {losses[-1]:.0f} px after {len(losses)} iterations")
    print(f"Pictures: {out}")
    return losses


if __name__ == "__main__":
    typer.run(main)
