"""Make every picture of README and docs that comes from this code: ``make pictures``.

    python scripts/pictures.py [--out docs/images] [NAME ...]

Says of each whether it is as it was; those of the demo never are to the last pixel, for measured milliseconds stand in
them. A picture that can't be made (VTK without OpenGL) is left as it is, and the exit code is 1. Charts of
long measurements, and pictures that need a film of others, are not made here: ``MADE_ELSEWHERE`` says what draws them.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from importlib import resources
from pathlib import Path

import numpy as np
import torch
import warp as wp
from PIL import Image, ImageDraw, ImageFont, ImageSequence

import warp_partdr as partdr
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.pipelines.photo import fit_photo, mask_labels
from warp_partdr.results.overlays import draw_detailed, draw_overlay
from warp_partdr.results.palette import PART_COLOURS, group_colours
from warp_partdr.results.shading import blend, shade_mesh, turntable_views
from warp_partdr.solve.mesh.mesh_stage import MeshFit, refine_mesh

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
EXAMPLE = ROOT / "warp_partdr" / "assets" / "example"

# The pictures that a command makes, and its arguments, from the project's folder; OUT is where it is to write to.
DRAWN: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (
    *(((name,), (__file__, "--draw", f"OUT/{name}")) for name in ("ellipbody.png", "example.png", "demo_window.png")),
    (("two_triangles.png",), ("demos/two_triangles.py", "--out", "OUT/two_triangles.png")),
    (("edits.png", "between.png"), ("demos/edit_body.py", "--out", "OUT")),
    (
        ("demo.gif",),
        ("-m", "warp_partdr", "demo", "--record", "OUT/demo.gif", "--set", "steps=100"),
    ),
)

MADE_ELSEWHERE = {
    "film.gif": "python scripts/film_pictures.py WHEEL",
    "views.png": "python scripts/film_pictures.py WHEEL",
    "bench-cpu.png": "partdr bench kernels --device cpu",
    "bench-h200.png": "partdr bench kernels --device cuda",
    "tradeoff-cpu.png": "partdr bench tradeoff --device cpu",
    "tradeoff-h200.png": "partdr bench tradeoff --device cuda",
}

GAP, BAR, WIDTH = 12, 30, 300  # [px], the last of a photo
ARM = ("left_forearm", "left_hand")
DEMO_STEPS = 25  # of each setting


def difference(first: Path, second: Path) -> float:
    """Share of pixels that differ, over all frames; 1 if sizes or numbers of frames do."""
    with Image.open(first) as one, Image.open(second) as other:
        pictures = [ImageSequence.Iterator(each) for each in (one, other)]
        old, new = ([np.asarray(frame.convert("RGB")) for frame in frames] for frames in pictures)
    if [frame.shape for frame in old] != [frame.shape for frame in new]:
        return 1.0
    return float(np.mean([(was != now).any(-1).mean() for was, now in zip(old, new, strict=True)]))


def make(names: tuple[str, ...], arguments: tuple[str, ...], out: Path) -> bool:
    """Run a command and keep its pictures of these names; True if it made them."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, *(argument.replace("OUT", folder) for argument in arguments)]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            reason = done.stderr.strip().splitlines()[-1:]
            print(f"{', '.join(names)}: left as it was; {' '.join(arguments)}: {''.join(reason)}")
            return False
        for name in names:
            made, kept = Path(folder) / name, out / name
            if not kept.exists():
                news = "new"
            elif (share := difference(made, kept)) == 0:
                news = "as it was"
            else:
                news = f"{share:.2%} of its pixels are new"
            kept.write_bytes(made.read_bytes())
            print(f"{name}: {kept.stat().st_size / 1024:.0f} KiB, {news}", flush=True)
    return True


def side_by_side(panels: dict[str, Image.Image]) -> Image.Image:
    """Pictures of one height in a row, each under its name."""
    width = sum(panel.width for panel in panels.values()) + GAP * (len(panels) - 1)
    height = max(panel.height for panel in panels.values()) + BAR
    sheet = Image.new("RGB", (width, height), "white")
    draw = ImageDraw.Draw(sheet)
    x = 0
    for name, panel in panels.items():
        draw.text((x + panel.width / 2, BAR / 2), name, "black", ImageFont.load_default(16), anchor="mm")
        sheet.paste(panel, (x, BAR))
        x += panel.width + GAP
    return sheet


def draw_examples() -> Image.Image:
    """Both packaged examples, one above the other: the first with part labels, the second from the photo alone."""
    folder = Path(str(resources.files("warp_partdr"))) / "assets" / "example"
    photo = partdr.read_photo(folder / "photo.png")
    parts = partdr.read_parts(folder / "parts.png", partdr.label_set("cdcl14"))
    person = partdr.choose_person(partdr.read_keypoints(folder / "keypoints.json"), parts.groups)
    labelled = draw_fit(photo, parts, "its part labels", refine_mesh(partdr.fit_body(person, parts)))
    photo = partdr.read_photo(folder / "astronaut.jpg")
    everyone = fit_photo(photo)
    mask = mask_labels(everyone.owners, 0)
    assert mask is not None  # the person is in the middle of the picture
    alone = draw_fit(photo, mask, "the person who is found", everyone.fits[0])
    sheet = Image.new("RGB", (max(labelled.width, alone.width), labelled.height + GAP + alone.height), "white")
    sheet.paste(labelled)
    sheet.paste(alone, (0, labelled.height + GAP))
    return sheet


def draw_fit(photo: np.ndarray, parts: PartLabels, seen: str, mesh: MeshFit) -> Image.Image:
    """A photo, the labels that a fit saw, both bodies over the photo, and the ellipsoids from the side."""
    height, width = round(WIDTH * photo.shape[0] / photo.shape[1]), WIDTH
    colours = group_colours(parts.label_set.part_groups)
    colours[0] = 255
    views = {
        "a photo": Image.fromarray(photo),
        seen: Image.fromarray(colours[parts.groups]),
        "ellipsoids, with the keypoints": draw_overlay(mesh.ellipbody, photo.shape[:2], photo),
        "the mesh": draw_detailed(mesh.body, mesh.camera, photo.shape[:2], photo),
    }
    panels = {name: view.resize((width, height), Image.Resampling.LANCZOS) for name, view in views.items()}
    (side,) = turntable_views(mesh.ellipbody.posed, ((90, 0),), height)
    margin = (height - width) // 2
    panels["ellipsoids from the side"] = Image.fromarray(side).crop((margin, 0, margin + width, height))
    return side_by_side(panels)


def draw_ellipbody(size: int = 360) -> Image.Image:
    """The mean body from three sides, and the mesh of its left forearm and hand at each level."""
    posed = partdr.BodyParameters.mean(1).posed()
    sides = {"from the front": ((0, 0), 0.8), "from its left": ((90, 0), 0.35), "from above": ((0, 90), 0.8)}
    panels = {}
    for name, (angles, share) in sides.items():
        (view,) = turntable_views(posed, (angles,), size)
        margin = round(size * (1 - share) / 2)
        panels[name] = Image.fromarray(view[:, margin : size - margin])
    levels = [draw_arm(posed.vertices(level).detach(), level, size // 4, size // 2) for level in range(4)]
    panels["an arm: E0, E1, E2, E3"] = Image.fromarray(np.concatenate(levels))
    return side_by_side(panels)


def draw_arm(vertices: torch.Tensor, level: int, height: int, width: int) -> np.ndarray:
    """Left forearm and hand of one level, shape (H, W, 3), uint8."""
    body = partdr.ellipbody_mesh(level)
    kept = torch.isin(body.face_labels, torch.tensor([partdr.PART_NAMES.index(name) + 1 for name in ARM]))
    mesh = partdr.PartMesh.from_faces(body.faces[kept].numpy(), body.face_labels[kept].numpy())
    points = vertices[0].numpy()[mesh.faces.numpy()]
    low, high = points.min((0, 1)), points.max((0, 1))
    scale = 0.92 * width / (high[0] - low[0])  # [px/m]
    u, v = (low[:2] + high[:2]) / 2 * scale
    camera = partdr.WeakPerspective(torch.tensor([scale]), torch.tensor([[width / 2 - u, height / 2 - v]]))
    white = np.full((height, width, 3), 255, dtype=np.uint8)
    return blend(white, shade_mesh(vertices, mesh, camera, (height, width), PART_COLOURS), 1.0)


def draw_demo_window() -> Image.Image:
    """The demo with all controls, while it plays: two settings from the same start; the second is on its way."""
    from warp_partdr.cli.options import PersonFiles
    from warp_partdr.viewer.state import DemoState
    from warp_partdr.viewer.targets import body_of, person_target
    from warp_partdr.viewer.window import Window

    files = PersonFiles(EXAMPLE / "keypoints.json", parts=EXAMPLE / "parts.png", labels="cdcl14")
    state = DemoState(body_of("t-pose"), person_target(files.read(EXAMPLE / "photo.png")))
    window = Window(state, Path(), off_screen=True, more=True)
    window.scene.screenshot()  # off-screen, nothing is drawn before the first picture
    for quality in ("F7", "F9"):
        window.press(quality)
        window.press("space")
        for _ in range(DEMO_STEPS):
            window.tick()
        if quality != "F9":
            window.press("space")
    return Image.fromarray(window.scene.screenshot())


def draw(path: Path) -> None:
    """Draw that one of this file's own pictures which has the path's name."""
    wp.config.log_level = wp.LOG_WARNING
    torch.set_num_threads(1)  # the tensors are small
    own = {"ellipbody.png": draw_ellipbody, "example.png": draw_examples, "demo_window.png": draw_demo_window}
    own[path.name]().save(path, optimize=True)


def main(argv: list[str] | None = None) -> int:
    """Make the pictures; return 1 if one couldn't be made."""
    choices = [name for names, _ in DRAWN for name in names]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(choices)}; default: all")
    parser.add_argument("--out", type=Path, default=IMAGES, help="folder; default: docs/images")
    parser.add_argument("--draw", type=Path, help=argparse.SUPPRESS)  # one of its own, in a process that may crash
    options = parser.parse_args(argv)
    if options.draw:
        draw(options.draw)
        return 0
    if unknown := set(options.names) - set(choices):
        parser.error(f"NAME: {', '.join(sorted(unknown))}; expected some of {', '.join(choices)}")
    options.out.mkdir(parents=True, exist_ok=True)
    asked = set(options.names or choices)
    done = [
        make(chosen, arguments, options.out)
        for names, arguments in DRAWN
        if (chosen := tuple(name for name in names if name in asked))
    ]
    if not options.names:
        for name, command in MADE_ELSEWHERE.items():
            print(f"{name}: not made here; {command} draws it")
    return 0 if all(done) else 1


if __name__ == "__main__":
    sys.exit(main())
