"""Train a tiny network through the renderer, from part labels alone.

    python demos/train_from_labels.py --out FOLDER

The network sees a label image and says how arms and legs are turned. Nobody tells it the true angles: its body is
drawn, and all it learns from is which pixels came out wrong. Writes ``loss.png`` and ``people.png``, people that it was
not trained on: their labels, the network's bodies before the training, and after it.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import torch
import typer
import warp as wp
from matplotlib.figure import Figure
from torch import nn

from warp_partdr import PART_NAMES, BodyParameters, RendererEllipsoids, draw_ellipsoids
from warp_partdr.plot import PART_COLOURS, loss_curve

BONES = ("upper_arm", "forearm", "upper_leg")
SIGN = {"left": 1.0, "right": -1.0}  # the same number lifts a left limb and a right one
LOWEST, HIGHEST = torch.tensor([-1.2, -0.9, 0.0]).repeat(2), torch.tensor([0.9, 0.9, 0.5]).repeat(2)  # [rad]
SHOWN = 5  # people in the picture


def bodies(angles: torch.Tensor) -> BodyParameters:
    """Mean bodies whose limbs are turned in the picture's plane by ``angles`` (B, 6) [rad]."""
    start = BodyParameters.mean(len(angles))
    rotations = torch.zeros_like(start.rotations)
    for column, (side, bone) in enumerate(product(SIGN, BONES)):
        rotations[:, PART_NAMES.index(f"{side}_{bone}"), 2] = SIGN[side] * angles[:, column]
    return replace(start, rotations=rotations)


def draw(angles: torch.Tensor, size: int) -> torch.Tensor:
    """Label images (B, H, W)."""
    people = bodies(angles)
    return draw_ellipsoids(people.posed(), people.camera(size), (size, size)).labels


def random_angles(count: int) -> torch.Tensor:
    """Poses (B, 6) [rad]."""
    return torch.lerp(LOWEST, HIGHEST, torch.rand(count, len(LOWEST)))


class LimbNetwork(nn.Module):
    """Label images (B, H, W) to angles (B, 6)."""

    def __init__(self) -> None:
        super().__init__()
        widths = (len(PART_NAMES) + 1, 24, 32, 48, 64)
        layers: list[nn.Module] = []
        for before, after in pairwise(widths):
            layers += [nn.Conv2d(before, after, 3, stride=2, padding=1), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Flatten(), nn.LazyLinear(64), nn.ReLU(), nn.Linear(64, len(LOWEST)))

    def forward(self, labels: torch.Tensor) -> torch.Tensor:
        maps = nn.functional.one_hot(labels.long(), len(PART_NAMES) + 1).permute(0, 3, 1, 2).float()
        return torch.lerp(LOWEST, HIGHEST, self.layers(maps).sigmoid())


def wrong_pixels(network: nn.Module, labels: torch.Tensor) -> torch.Tensor:
    """L_seg of the network's bodies against what it was shown, mean a person [px]."""
    people = bodies(network(labels))
    return RendererEllipsoids("partdr").crop_loss(people, labels).mean()


def picture(rows: dict[str, torch.Tensor]) -> Figure:
    """Label images (B, H, W) in named rows."""
    figure = Figure(figsize=(2.2 * SHOWN, 2.4 * len(rows)), layout="constrained")
    colours = PART_COLOURS.copy()
    colours[0] = 255
    for line, (name, labels) in zip(figure.subplots(len(rows), SHOWN), rows.items(), strict=True):
        line[0].set_title(name, loc="left")
        for axes, image in zip(line, labels, strict=False):
            axes.imshow(colours[image.numpy()])
            axes.set_axis_off()
    return figure


def main(
    out: Path = Path("out/train_from_labels"), size: int = 64, batch: int = 32, steps: int = 200
) -> tuple[list[float], list[float]]:
    """Train with label images with sides of ``size`` pixels, and write pictures to a folder.

    Returns:
        Loss of each step [px a person], and the mean error before and after [degrees].
    """
    wp.config.log_level = wp.LOG_WARNING
    torch.manual_seed(0)
    out.mkdir(parents=True, exist_ok=True)

    # People for the end, whom the network isn't trained on. Of them alone the true angles are kept, to compare with.
    truth = random_angles(64)
    unseen = draw(truth, size)
    network = LimbNetwork()
    with torch.no_grad():
        before = network(unseen)

    # Training is ordinary torch: the renderer is one more differentiable layer behind the network. Of random people,
    # the labels are all that is left to learn from.
    optimizer = torch.optim.Adam(network.parameters(), lr=2e-3)
    losses = []
    for _ in range(steps):
        labels = draw(random_angles(batch), size)
        loss = wrong_pixels(network, labels)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))

    with torch.no_grad():
        after = network(unseen)
    loss_curve(losses, label="L_seg [px a person]").savefig(out / "loss.png")
    rows = {
        "labels of people it has not seen": unseen,
        "the network's bodies before the training": draw(before, size),
        "and after it": draw(after, size),
    }
    picture(rows).savefig(out / "people.png")
    errors = [float((angles - truth).abs().mean().rad2deg()) for angles in (before, after)]
    print(f"Angles of people it has not seen: {errors[0]:.1f}° off before the training, {errors[1]:.1f}° after it")
    print(f"Pictures: {out}")
    return losses, errors


if __name__ == "__main__":
    typer.run(main)
