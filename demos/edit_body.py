"""Edit a body through EllipBody's shape, and let a detailed model follow (the paper's figure 8).

    python demos/edit_body.py [BODY.npz] --out FOLDER

Without a file of ``partdr fit``, the mean body is edited. Writes ``edits.png`` (longer legs, bigger head, thicker arms,
a wider trunk; ellipsoids above, the registered model below) and ``between.png`` (from the body to one with all edits).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
import warp as wp
from PIL import Image, ImageDraw

from warp_partdr.body.anny import anny
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.template import LENGTH_NAMES, NUM_PARTS, PART_NAMES, THICKNESS_NAMES, template
from warp_partdr.body_file import load_body
from warp_partdr.cameras import WeakPerspective
from warp_partdr.detailed import detailed_mesh
from warp_partdr.mesh import PartMesh, ellipbody_mesh
from warp_partdr.palette import PART_COLOURS
from warp_partdr.posing import Posed, pose
from warp_partdr.registration import Registered, register
from warp_partdr.render import rasterize_parts

SIZE = (560, 400)  # (H, W) of a picture
SAMPLES = 2  # a pixel, along each side
SCALE = 270.0  # [px/m]
SKIN = np.array([214.0, 178.0, 158.0])
LIGHT = np.array([0.4, -0.5, -0.8]) / np.linalg.norm([0.4, -0.5, -0.8])
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
    Edit("bigger head", lengths={"head": 1.2}, thicknesses={"head thickness": 1.2}),
    Edit("thicker arms", thicknesses={"upper arm thickness": 1.35, "forearm thickness": 1.3}),
    Edit("wider trunk", thicknesses={"torso depth": 1.3, "abdomen width": 1.25, "chest width": 1.15}),
)


@dataclass(frozen=True)
class Body:
    """What ``pose`` takes, B = 1."""

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


def draw(mesh: PartMesh, vertices: torch.Tensor, feet: float, *, coloured: bool) -> np.ndarray:
    """A body standing on the picture's lower border, shape (H, W, 3), uint8.

    Args:
        mesh: Its faces.
        vertices: Camera frame [m], shape (1, V, 3).
        feet: The lowest point's y [m].
        coloured: By part; else in one colour.
    """
    height, width = (side * SAMPLES for side in SIZE)
    scale = SCALE * SAMPLES
    camera = WeakPerspective(torch.tensor([scale]), torch.tensor([[width / 2, height - 10.0 - feet * scale]]))
    image = rasterize_parts(camera.project(vertices), mesh, (height, width))
    points, faces = vertices[0].double().numpy(), mesh.faces.numpy()
    corners = points[faces]
    of_faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    of_faces /= np.linalg.norm(of_faces, axis=1, keepdims=True) + 1e-12
    brightness = 0.4 + 0.6 * np.clip(of_faces @ LIGHT, 0, 1)
    labels = image.labels[0].numpy()
    colours = PART_COLOURS[labels] if coloured else np.broadcast_to(SKIN, (*labels.shape, 3))
    shown = np.where(labels[..., None] > 0, colours * brightness[image.face_index[0].numpy()][..., None], 255.0)
    return shown.reshape(SIZE[0], SAMPLES, SIZE[1], SAMPLES, 3).mean((1, 3)).astype(np.uint8)


def picture(bodies: list[tuple[str, Body]]) -> Image.Image:
    """Ellipsoids above, the registered model below, one column a body; each starts from the first one's shape."""
    model = anny()
    mesh, spheres = detailed_mesh(model), ellipbody_mesh(3)
    height, width = SIZE
    shown = Image.new("RGB", (width * len(bodies), 2 * height + 16), "white")
    first: Registered | None = None
    for column, (name, body) in enumerate(bodies):
        posed = body.posed()
        registered = register(posed, model, start=first)
        first = first or registered
        feet = float(registered.detailed.vertices[..., 1].max())
        drawn = (
            draw(spheres, posed.vertices(3), feet, coloured=True),
            draw(mesh, registered.detailed.vertices, feet, coloured=False),
        )
        shown.paste(Image.fromarray(np.concatenate(drawn)), (column * width, 16))
        ImageDraw.Draw(shown).text((column * width + width // 2 - 30, 2), name, fill="black")
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("body", type=Path, nargs="?", help="body.npz of partdr fit")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder to write to")
    arguments = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    arguments.out.mkdir(parents=True, exist_ok=True)

    body = read_body(arguments.body) if arguments.body else mean_body()
    picture([(edit.name, body.edited(edit)) for edit in EDITS]).save(arguments.out / "edits.png", optimize=True)
    other = body
    for edit in EDITS:
        other = other.edited(edit)
    shares = np.linspace(0, 1, STEPS)
    between = [(f"{100 * share:.0f} %", body.toward(other, float(share))) for share in shares]
    picture(between).save(arguments.out / "between.png", optimize=True)


if __name__ == "__main__":
    main()
