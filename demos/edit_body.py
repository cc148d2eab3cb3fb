"""Edit a body through EllipBody's shape, and let a detailed model follow (the paper's figure 8).

    python demos/edit_body.py [BODY.npz] --out FOLDER

Without a file of ``partdr fit``, the mean body is edited. Writes ``edits.png`` (longer legs, bigger head, thicker arms,
a thinner and a wider trunk; ellipsoids above, the registered model below) and ``between.png`` (from the body to one
with longer legs, bigger head, thicker arms and wider trunk), and prints how far the mesh follows.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
import warp as wp
from PIL import Image, ImageDraw, ImageFont

from warp_partdr import (
    BONE_STARTS,
    JOINT_NAMES,
    LENGTH_NAMES,
    PART_NAMES,
    SIZE_COLUMNS,
    THICKNESS_NAMES,
    BodyParameters,
    Posed,
    Registered,
    WeakPerspective,
    anny,
    load_body,
    register,
    vertex_parts,
)
from warp_partdr.plot import blend, shade_body, shade_detailed

OUT = Path("out/edit_body")
SIZE = (560, 400)  # (H, W) of a picture
BAR = 44  # [px] above, for names
SCALE = 270.0  # [px/m]
STEPS = 5  # from one body to another

MEASURES = LENGTH_NAMES + THICKNESS_NAMES
HIDDEN = ("pelvis height", "shoulder thickness")  # in the trunk: a mesh need not follow them

# Factors of ``MEASURES`` by name.
EDITS: dict[str, dict[str, float]] = {
    "as it is": {},
    "longer legs": {"upper leg": 1.15, "lower leg": 1.15},
    "bigger head": {"head": 1.25, "head thickness": 1.25},
    "thicker arms": {"upper arm thickness": 1.4, "forearm thickness": 1.4},
    "thinner trunk": {"torso depth": 0.8, "abdomen width": 0.8, "chest width": 0.8},
    "wider trunk": {"torso depth": 1.25, "abdomen width": 1.25, "chest width": 1.25},
}
TOGETHER = ("longer legs", "bigger head", "thicker arms", "wider trunk")


def mean_body() -> BodyParameters:
    """The mean adult, arms hanging a little away from the body."""
    rotations = torch.zeros(1, len(PART_NAMES), 3)
    rotations[0, PART_NAMES.index("left_upper_arm"), 2] = -1.0
    rotations[0, PART_NAMES.index("right_upper_arm"), 2] = 1.0
    return replace(BodyParameters.mean(1), rotations=rotations)


def edited(body: BodyParameters, *names: str) -> BodyParameters:
    """The body after one of ``EDITS`` or several."""
    sizes = measures(body)
    for name in names:
        sizes = sizes * torch.tensor([EDITS[name].get(measure, 1.0) for measure in MEASURES])
    return resized(body, sizes)


def between(body: BodyParameters, other: BodyParameters, share: float) -> BodyParameters:
    """A body between two of one pose."""
    return resized(body, torch.lerp(measures(body), measures(other), share))


def measures(body: BodyParameters) -> torch.Tensor:
    """``MEASURES`` [m], shape (27,)."""
    return torch.cat([body.lengths[0], body.thicknesses[0]])


def resized(body: BodyParameters, sizes: torch.Tensor) -> BodyParameters:
    """The body with other ``measures``."""
    lengths, thicknesses = sizes[None].tensor_split([len(LENGTH_NAMES)], dim=1)
    return replace(body, lengths=lengths, thicknesses=thicknesses)


def register_all(bodies: list[BodyParameters]) -> list[Registered]:
    """The first body, then the others as edits of it."""
    model = anny()
    first = register(bodies[0].posed(), model)
    return [first, *(register(body.posed(), model, start=first) for body in bodies[1:])]


def mesh_measures(registered: Registered, posed: Posed) -> torch.Tensor:
    """``MEASURES`` of the posed mesh, up to a factor each, shape (B, 27).

    Lengths are between joints; for thicknesses, the standard deviation of a part's skin along the ellipsoid's axis.
    """
    parts, areas = vertex_parts(registered.model)
    joints = registered.model.landmarks(registered.detailed, JOINT_NAMES)
    sizes = torch.zeros_like(posed.semi_axes)
    sizes[..., 0] = (joints[:, 1:] - joints[:, BONE_STARTS]).norm(dim=-1)
    for part in range(len(PART_NAMES)):
        weights = (areas * (parts == part) / areas[parts == part].sum())[:, None]
        across = registered.detailed.vertices @ posed.axes[:, part, :, 1:]
        middle = (weights * across).sum(1, keepdim=True)
        sizes[:, part, 1:] = (weights * (across - middle).square()).sum(1).sqrt()
    sharing = torch.nn.functional.one_hot(torch.tensor(SIZE_COLUMNS).flatten(), len(MEASURES)).to(sizes)
    return sizes.flatten(1) @ (sharing / sharing.sum(0))


def following(
    bodies: list[BodyParameters], registered: list[Registered]
) -> list[tuple[dict[str, float], dict[str, float]]]:
    """Share of each edit that the mesh follows, for each body but the first.

    Returns:
        Numbers by name. For an edited measure, it is the share of the relative change that the mesh has, 1 at best. For
        the others, it is their relative change as a share of the largest demanded one, 0 at best.
    """
    has = [mesh_measures(result, body.posed())[0] for result, body in zip(registered, bodies, strict=True)]
    rows = []
    for body, sizes in zip(bodies[1:], has[1:], strict=True):
        demanded, changes = measures(body) / measures(bodies[0]) - 1, sizes / has[0] - 1
        asked = demanded.abs() > 1e-4
        shares = torch.where(asked, changes / demanded, changes.abs() / demanded.abs().max()).tolist()
        followed, others = (
            {name: share for name, share, was in zip(MEASURES, shares, asked.tolist(), strict=True) if was is kind}
            for kind in (True, False)
        )
        rows.append((followed, {name: share for name, share in others.items() if name not in HIDDEN}))
    return rows


def picture(bodies: dict[str, BodyParameters], registered: list[Registered]) -> Image.Image:
    """Ellipsoids above, the registered model below, one column a named body."""
    height, width = SIZE
    white = np.full((*SIZE, 3), 255, dtype=np.uint8)
    shown = Image.new("RGB", (width * len(bodies), 2 * height + BAR), "white")
    font = ImageFont.load_default(28)
    for column, ((name, body), result) in enumerate(zip(bodies.items(), registered, strict=True)):
        feet = float(result.detailed.vertices[..., 1].max())
        standing = WeakPerspective(torch.tensor([SCALE]), torch.tensor([[width / 2, height - 5.0 - feet * SCALE]]))
        drawn = shade_body(body.posed(), standing, SIZE), shade_detailed(result.detailed, result.model, standing, SIZE)
        shown.paste(Image.fromarray(np.concatenate([blend(white, rgba, 1.0) for rgba in drawn])), (column * width, BAR))
        ImageDraw.Draw(shown).text(((column + 0.5) * width, BAR / 2), name, "black", font, anchor="mm")
    return shown


def main(path: Annotated[Path | None, typer.Argument(metavar="BODY.npz")] = None, out: Path = OUT) -> None:
    """Edit the body of ``partdr fit``, or the mean body, and write pictures to a folder."""
    wp.config.log_level = wp.LOG_WARNING
    out.mkdir(parents=True, exist_ok=True)

    body = load_body(path).parameters() if path else mean_body()
    bodies = {name: edited(body, name) for name in EDITS}
    registered = register_all([*bodies.values()])
    picture(bodies, registered).save(out / "edits.png", optimize=True)
    print("| edit | share of it that the mesh follows | what else changes most, as a share of the edit |")
    print("|---|---|---|")
    for name, (followed, others) in zip([*EDITS][1:], following([*bodies.values()], registered), strict=True):
        said = ", ".join(f"{measure} {share:.0%}" for measure, share in followed.items())
        print(f"| {name} | {said} | {max(others, key=others.__getitem__)} {max(others.values()):.0%} |")

    other = edited(body, *TOGETHER)
    bodies = {f"{share:.0%}": between(body, other, float(share)) for share in np.linspace(0, 1, STEPS)}
    picture(bodies, register_all([*bodies.values()])).save(out / "between.png", optimize=True)
    print(f"Pictures: {out}")


if __name__ == "__main__":
    typer.run(main)
