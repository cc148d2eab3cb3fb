"""Draw the pictures of README and docs, with the project's own renderer.

    python scripts/make_docs_pictures.py [--out docs/images]

``example.png``: the packaged example, what goes into a fit and what comes out. ``ellipbody.png``: the mean body in the
rest pose, and the four levels of its mesh. ``two_triangles.png`` is that of ``demos/two_triangles.py``.
"""

from __future__ import annotations

import argparse
from importlib import resources
from pathlib import Path

import numpy as np
import torch
import warp as wp
from PIL import Image, ImageDraw, ImageFont

from warp_partdr import (
    PART_NAMES,
    BodyParameters,
    PartMesh,
    WeakPerspective,
    choose_person,
    draw_mesh,
    ellipbody_mesh,
    fit_body,
    label_set,
    read_keypoints,
    read_parts,
    read_photo,
)
from warp_partdr.results.palette import PART_COLOURS, group_colours
from warp_partdr.results.pictures import turntable_views
from warp_partdr.results.save import draw_overlay

EXAMPLE = Path(str(resources.files("warp_partdr"))) / "assets" / "example"
GAP, BAR = 12, 30  # [px]
ARM = ("left_forearm", "left_hand")
LIGHT = np.array([-0.35, -0.6, -0.72])  # toward the light, camera frame


def side_by_side(panels: dict[str, Image.Image]) -> Image.Image:
    """Pictures of one height in a row, each under its name."""
    font = ImageFont.load_default(16)
    width = sum(panel.width for panel in panels.values()) + GAP * (len(panels) - 1)
    height = max(panel.height for panel in panels.values()) + BAR
    sheet = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(sheet)
    x = 0
    for name, panel in panels.items():
        draw.text((x + panel.width / 2, BAR / 2), name, "black", font, anchor="mm")
        sheet.paste(panel, (x, BAR))
        x += panel.width + GAP
    return sheet


def save(picture: Image.Image, path: Path) -> None:
    """Write a PNG and say how large it is."""
    picture.save(path, optimize=True)
    print(f"{path}: {picture.width} x {picture.height}, {path.stat().st_size / 1024:.0f} KiB")


def draw_example(height: int = 400) -> Image.Image:
    """Photo and part labels of the packaged example, the body over the photo, and the body from the side."""
    photo = read_photo(EXAMPLE / "photo.png")
    parts = read_parts(EXAMPLE / "parts.png", label_set("cdcl14"))
    person = choose_person(read_keypoints(EXAMPLE / "keypoints.json"), parts.groups)
    result = fit_body(person, parts)
    colours = group_colours(parts.label_set.part_groups)
    colours[0] = 255
    views = {
        "photo": Image.fromarray(photo),
        "part labels": Image.fromarray(colours[parts.groups]),
        "fitted body, with the keypoints": draw_overlay(result, photo.shape[:2], photo),
    }
    width = round(height * photo.shape[1] / photo.shape[0])
    panels = {name: view.resize((width, height), Image.Resampling.LANCZOS) for name, view in views.items()}
    (side,) = turntable_views(result.posed, ((90, 0),), height)
    margin = (height - width) // 2
    panels["the same from the side"] = Image.fromarray(side).crop((margin, 0, margin + width, height))
    return side_by_side(panels)


def draw_ellipbody(size: int = 360) -> Image.Image:
    """The mean body from three sides, and the mesh of its left forearm and hand at each level."""
    posed = BodyParameters.mean(1).posed()
    sides = {"from the front": ((0, 0), 0.8), "from its left": ((90, 0), 0.35), "from above": ((0, 90), 0.8)}
    panels = {}
    for name, (angles, share) in sides.items():
        (view,) = turntable_views(posed, (angles,), size)
        margin = round(size * (1 - share) / 2)
        panels[name] = Image.fromarray(view[:, margin : size - margin])
    levels = Image.new("RGB", (size // 2, size), "white")
    for level in range(4):
        levels.paste(draw_arm(posed.vertices(level).detach(), level, size), (0, level * size // 4))
    panels["an arm: E0, E1, E2, E3"] = levels
    return side_by_side(panels)


def draw_arm(vertices: torch.Tensor, level: int, size: int, samples: int = 3) -> Image.Image:
    """Left forearm and hand of one level, size // 2 wide and size // 4 high."""
    body = ellipbody_mesh(level)
    kept = torch.isin(body.face_labels, torch.tensor([PART_NAMES.index(name) + 1 for name in ARM]))
    mesh = PartMesh.from_faces(body.faces[kept].numpy(), body.face_labels[kept].numpy())
    triangles = vertices[0].numpy()[mesh.faces.numpy()]
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    height, width = size // 4 * samples, size // 2 * samples
    scale = 0.92 * width / (high[0] - low[0])  # [px/m]
    u, v = (low[:2] + high[:2]) / 2 * scale
    camera = WeakPerspective(torch.tensor([scale]), torch.tensor([[width / 2 - u, height / 2 - v]]))
    shown = draw_mesh(vertices, mesh, camera, (height, width))
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    brightness = 0.45 + 0.55 * np.clip(normals @ LIGHT, 0, 1)
    index, labels = shown.face_index[0].numpy(), shown.labels[0].numpy()
    image = np.where((labels > 0)[..., None], PART_COLOURS[labels] * brightness[index][..., None], 255)
    return Image.fromarray(image.astype(np.uint8)).resize((size // 2, size // 4), Image.Resampling.LANCZOS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(__file__).resolve().parents[1] / "docs" / "images"
    parser.add_argument("--out", type=Path, default=default, help="folder (default: docs/images)")
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)  # the tensors are small
    options.out.mkdir(parents=True, exist_ok=True)
    save(draw_ellipbody(), options.out / "ellipbody.png")
    save(draw_example(), options.out / "example.png")


if __name__ == "__main__":
    main()
