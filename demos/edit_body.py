"""Edit a body through EllipBody's shape, and let a detailed model follow (the paper's figure 8).

    python demos/edit_body.py [BODY.npz] --out FOLDER

Without a file of ``partdr fit``, the mean body is edited. Writes ``edits.png`` (longer legs, bigger head, thicker arms,
a thinner and a wider trunk; ellipsoids above, the registered model below) and ``between.png`` (from the body to one
with longer legs, bigger head, thicker arms and wider trunk), and prints how far the mesh follows.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
import warp as wp
from PIL import Image, ImageDraw, ImageFont

from warp_partdr.body.posing import Posed, pose
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import (
    JOINT_NAMES,
    LENGTH_NAMES,
    NUM_PARTS,
    PARENTS,
    PART_NAMES,
    SHAPE_INDICES,
    THICKNESS_NAMES,
    template,
)
from warp_partdr.cameras import WeakPerspective
from warp_partdr.clothing.anny import anny
from warp_partdr.clothing.growth import MEASURES, UNGROWN
from warp_partdr.clothing.registration import Registered, register
from warp_partdr.clothing.surfaces import vertex_parts
from warp_partdr.results.body_file import load_body
from warp_partdr.results.pictures import blend, shade_body, shade_detailed

SIZE = (560, 400)  # (H, W) of a picture
BAR = 44  # [px] above, for names
SCALE = 270.0  # [px/m]
STEPS = 5  # from one body to another


@dataclass(frozen=True)
class Edit:
    """Factors of lengths and thicknesses, by name."""

    name: str
    lengths: dict[str, float] = field(default_factory=dict)
    thicknesses: dict[str, float] = field(default_factory=dict)


EDITS = (
    Edit("as it is"),
    Edit("longer legs", lengths={"upper leg": 1.15, "lower leg": 1.15}),
    Edit("bigger head", lengths={"head": 1.25}, thicknesses={"head thickness": 1.25}),
    Edit("thicker arms", thicknesses={"upper arm thickness": 1.4, "forearm thickness": 1.4}),
    Edit("thinner trunk", thicknesses={"torso depth": 0.8, "abdomen width": 0.8, "chest width": 0.8}),
    Edit("wider trunk", thicknesses={"torso depth": 1.25, "abdomen width": 1.25, "chest width": 1.25}),
)
TOGETHER = ("longer legs", "bigger head", "thicker arms", "wider trunk")


@dataclass(frozen=True)
class Body:
    """Arguments of ``pose``, B = 1."""

    global_orient: torch.Tensor
    translation: torch.Tensor
    rotations: torch.Tensor
    lengths: torch.Tensor
    thicknesses: torch.Tensor

    def edited(self, edit: Edit) -> Body:
        lengths = [edit.lengths.get(name, 1.0) for name in LENGTH_NAMES]
        thicknesses = [edit.thicknesses.get(name, 1.0) for name in THICKNESS_NAMES]
        return replace(
            self,
            lengths=self.lengths * torch.tensor(lengths),
            thicknesses=self.thicknesses * torch.tensor(thicknesses),
        )

    def toward(self, other: Body, share: float) -> Body:
        """Between two bodies of one pose."""
        return replace(
            self,
            lengths=torch.lerp(self.lengths, other.lengths, share),
            thicknesses=torch.lerp(self.thicknesses, other.thicknesses, share),
        )

    def posed(self) -> Posed:
        return pose(*vars(self).values())

    def measures(self) -> torch.Tensor:
        """``MEASURES`` [m], shape (27,)."""
        return torch.cat([self.lengths[0], self.thicknesses[0]])


def mean_body() -> Body:
    """The mean adult, arms hanging a little away from the body, camera frame."""
    turns = torch.zeros(1, NUM_PARTS, 3)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        turns[0, PART_NAMES.index(f"{side}_upper_arm"), 2] = sign * 1.0
    lengths, thicknesses = (
        torch.from_numpy(values).float()[None] for values in (template().mean_lengths, template().mean_thicknesses)
    )
    facing = torch.diag(torch.tensor([1.0, -1.0, -1.0]))[None]
    return Body(facing, torch.zeros(1, 3), rotation_from_axis_angle(turns), lengths, thicknesses)


def read_body(path: Path) -> Body:
    """A fitted body."""
    fitted = load_body(path)
    return Body(*(torch.from_numpy(getattr(fitted, name))[None] for name in Body.__dataclass_fields__))


def register_all(bodies: list[Body]) -> list[Registered]:
    """The first body, then the others as edits of it."""
    model = anny()
    first = register(bodies[0].posed(), model)
    return [first, *(register(body.posed(), model, start=first) for body in bodies[1:])]


def mesh_measures(registered: Registered, posed: Posed) -> torch.Tensor:
    """``MEASURES`` of the posed mesh, up to a factor each, shape (B, 27).

    Lengths are between joints; for thicknesses, the standard deviation of a part's skin along the ellipsoid's axis.
    """
    model = registered.model
    parts, areas = vertex_parts(model)
    joints = model.landmarks(registered.detailed, JOINT_NAMES)
    sizes = torch.zeros_like(posed.semi_axes)
    sizes[..., 0] = (joints[:, 1:] - joints[:, [parent + 1 for parent in PARENTS]]).norm(dim=-1)
    for part in range(NUM_PARTS):
        weights = (areas * (parts == part) / areas[parts == part].sum())[:, None]
        across = registered.detailed.vertices @ posed.axes[:, part, :, 1:]
        middle = (weights * across).sum(1, keepdim=True)
        sizes[:, part, 1:] = (weights * (across - middle).square()).sum(1).sqrt()
    indices = torch.tensor(
        [(length, len(LENGTH_NAMES) + first, len(LENGTH_NAMES) + second) for length, first, second in SHAPE_INDICES]
    )
    sharing = torch.nn.functional.one_hot(indices.flatten(), len(MEASURES)).to(sizes)
    return sizes.flatten(1) @ (sharing / sharing.sum(0))


def following(bodies: list[Body], registered: list[Registered]) -> list[tuple[dict[str, float], dict[str, float]]]:
    """Share of each edit that the mesh follows, for each body but the first.

    Returns:
        By name: for edited measures, the share of the relative change that the mesh has, 1 at best; for the others,
        their relative change as a share of the largest demanded, 0 at best.
    """
    has = [mesh_measures(result, body.posed())[0] for result, body in zip(registered, bodies, strict=True)]
    rows = []
    for body, measures in zip(bodies[1:], has[1:], strict=True):
        demanded = body.measures() / bodies[0].measures() - 1
        changes = measures / has[0] - 1
        edited = demanded.abs() > 1e-4
        shares = torch.where(edited, changes / demanded, changes.abs() / demanded.abs().max()).tolist()
        named = list(zip(MEASURES, shares, edited.tolist(), strict=True))
        rows.append(
            (
                {name: share for name, share, was in named if was},
                {name: share for name, share, was in named if not was and name not in UNGROWN},
            )
        )
    return rows


def picture(names: list[str], bodies: list[Body], registered: list[Registered]) -> Image.Image:
    """Ellipsoids above, the registered model below, one column a body."""
    height, width = SIZE
    white = np.full((*SIZE, 3), 255, dtype=np.uint8)
    shown = Image.new("RGB", (width * len(bodies), 2 * height + BAR), "white")
    font = ImageFont.load_default(28)
    for column, (name, body, result) in enumerate(zip(names, bodies, registered, strict=True)):
        feet = float(result.detailed.vertices[..., 1].max())
        standing = WeakPerspective(torch.tensor([SCALE]), torch.tensor([[width / 2, height - 5.0 - feet * SCALE]]))
        drawn = shade_body(body.posed(), standing, SIZE), shade_detailed(result.detailed, result.model, standing, SIZE)
        shown.paste(Image.fromarray(np.concatenate([blend(white, rgba, 1.0) for rgba in drawn])), (column * width, BAR))
        ImageDraw.Draw(shown).text(((column + 0.5) * width, BAR / 2), name, "black", font, anchor="mm")
    return shown


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("body", type=Path, nargs="?", help="body.npz of partdr fit")
    parser.add_argument("--out", type=Path, default=Path("out/edit_body"), help="folder to write to")
    arguments = parser.parse_args(argv)
    wp.config.log_level = wp.LOG_WARNING
    arguments.out.mkdir(parents=True, exist_ok=True)

    body = read_body(arguments.body) if arguments.body else mean_body()
    names, bodies = [edit.name for edit in EDITS], [body.edited(edit) for edit in EDITS]
    registered = register_all(bodies)
    picture(names, bodies, registered).save(arguments.out / "edits.png", optimize=True)
    print("| edit | share of it that the mesh follows | what else changes most, as a share of the edit |")
    print("|---|---|---|")
    for name, (followed, others) in zip(names[1:], following(bodies, registered), strict=True):
        said = ", ".join(f"{measure} {share:.0%}" for measure, share in followed.items())
        print(f"| {name} | {said} | {max(others, key=others.__getitem__)} {max(others.values()):.0%} |")

    other = body
    for edit in EDITS:
        other = other.edited(edit) if edit.name in TOGETHER else other
    shares = np.linspace(0, 1, STEPS)
    between = [body.toward(other, float(share)) for share in shares]
    picture([f"{share:.0%}" for share in shares], between, register_all(between)).save(
        arguments.out / "between.png", optimize=True
    )
    print(f"Pictures: {arguments.out}")


if __name__ == "__main__":
    main()
