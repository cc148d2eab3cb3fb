"""Make the pictures of README that show real people: python scripts/film_pictures.py SPORTS2D.whl.

    pip download sports2d==0.8.34 --no-deps
    python scripts/film_pictures.py sports2d-*.whl

The wheel holds the demo film of the project (docs/reference/credits.md). ``film.gif`` shows the film with everyone's
body over it, and from the side and from above; ``views.png`` is what ``partdr fit`` writes of one of its frames.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont

from warp_partdr import WeakPerspective, anny, fit_photo, save_photo_fit
from warp_partdr.inputs.films import FilmFrames, read_frames
from warp_partdr.models.model import Detailed, DetailedModel
from warp_partdr.results.film_overlays import PosedMotions, draw_bodies, zoomed_view
from warp_partdr.results.load_film import SavedFilm, load_film_fit
from warp_partdr.results.overlays import skin_over
from warp_partdr.results.palette import PALE_PEOPLE_COLOURS

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
FILM = "Sports2D/Demo/demo.mp4"  # in the wheel
FRAMES, RATE = range(40, 166, 4), 8  # frames of the film, and the GIF's frames a second
STILL = 118  # frame of the film for views.png
HEIGHT = 360  # [px], of the GIF
SIDE_WIDTH = 250  # [px], of the views beside the film
GAP = 4  # [px]
FLOOR = 12  # [m], half the width of the ground that is drawn
BACK, LINE, INK = (250, 250, 251), (224, 227, 232), (60, 64, 72)


@dataclass(frozen=True)
class SideView:
    """View of the world without perspective.

    Attributes:
        name: Words for it.
        rotation: Rotation from the camera's axes to the view's, shape (3, 3).
        camera: Camera of its picture.
        size: Size (H, W) of its picture [px].
    """

    name: str
    rotation: torch.Tensor
    camera: WeakPerspective
    size: tuple[int, int]

    @classmethod
    def of(cls, name: str, rotation: list[list[float]], points: torch.Tensor, size: tuple[int, int]) -> SideView:
        """View in which all points (N, 3) [m] of the film have room."""
        turn = torch.tensor(rotation)
        low, high = (points @ turn.T)[:, :2].aminmax(dim=0)
        scale = 0.88 * min(size[1] / float(high[0] - low[0]), size[0] / float(high[1] - low[1]))
        middle = torch.tensor([size[1] / 2, size[0] / 2]) - scale * (low + high) / 2
        return cls(name, turn, WeakPerspective(torch.tensor([scale]), middle[None]), size)

    def draw(self, bodies: dict[int, Detailed], model: DetailedModel, ground: float) -> np.ndarray:
        """Draw the bodies of a moment over squares of 1 m, RGB, shape (H, W, 3), uint8."""
        picture = Image.new("RGB", self.size[::-1], BACK)
        draw = ImageDraw.Draw(picture)
        for metre in range(-FLOOR, FLOOR + 1):
            for start, end in (((metre, 0), (metre, FLOOR)), ((-FLOOR, metre), (FLOOR, metre))):
                ends = torch.tensor([[x, ground, z] for x, z in (start, end)])
                flat = self.camera.project((ends @ self.rotation.T)[None])[0, :, :2]
                draw.line(flat.flatten().tolist(), fill=LINE)
        drawn = np.asarray(picture)
        for person, body in bodies.items():
            vertices = body.vertices.cpu() @ self.rotation.T
            drawn = skin_over(drawn, vertices, model, self.camera, colour(person))
        shown = Image.fromarray(drawn)
        ImageDraw.Draw(shown).text((8, 6), self.name, INK, ImageFont.load_default(14))
        return np.asarray(shown)


def colour(person: int) -> np.ndarray:
    """Light colour of a person."""
    chosen: np.ndarray = PALE_PEOPLE_COLOURS[person % len(PALE_PEOPLE_COLOURS)]
    return chosen


def draw_film(path: Path, saved: SavedFilm) -> list[Image.Image]:
    """Frames of the GIF."""
    people, taken = PosedMotions(saved.motions), saved.views[0]
    colours = {person: colour(person) for person in saved.motions}
    moments = {frame: people.at(frame) for frame in FRAMES}
    everything = torch.cat([body.joints[0] for bodies in moments.values() for body in bodies.values()])
    ground = float(everything[:, 1].max()) + 0.06
    size = (HEIGHT // 2, SIDE_WIDTH)
    sides = [
        SideView.of("from the side", [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]], everything, size),
        SideView.of("from above", [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]], everything, size),
    ]
    zoom = HEIGHT / taken.size[0]
    width = round(zoom * taken.size[1])
    view = zoomed_view(taken.view, zoom, (HEIGHT, width))
    frames = []
    for number, frame in enumerate(read_frames(path, size=(HEIGHT, width))):
        if number not in moments:
            continue
        sheet = Image.new("RGB", (width + GAP + SIDE_WIDTH, HEIGHT), "white")
        sheet.paste(Image.fromarray(draw_bodies(frame.picture, moments[number], saved.motions, view, colours)))
        for row, side in enumerate(sides):
            drawn = side.draw(moments[number], anny(), ground)
            sheet.paste(Image.fromarray(drawn), (width + GAP, row * (HEIGHT // 2)))
        frames.append(sheet)
    return frames


def draw_still(path: Path, folder: Path) -> Image.Image:
    """Sheet of views of everyone in one frame of a film."""
    picture = FilmFrames(path).read(STILL)
    save_photo_fit(fit_photo(picture), folder, photo=picture)
    with Image.open(folder / "views.png") as views:
        return views.convert("RGB").resize((views.width * 2 // 3, views.height * 2 // 3), Image.Resampling.LANCZOS)


def main() -> None:
    """Make both pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheel", type=Path, metavar="WHEEL", help="wheel of Sports2D")
    parser.add_argument("--fit", type=Path, help="folder with the film's fit; it is fitted if this is not given")
    parser.add_argument("--out", type=Path, default=IMAGES, help="folder; default: docs/images")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        film = Path(zipfile.ZipFile(options.wheel).extract(FILM, folder))
        draw_still(film, folder / "still").save(options.out / "views.png", optimize=True)
        if options.fit is None:
            command = [sys.executable, "-m", "warp_partdr", "fit", str(film), "--out", str(folder / "fit")]
            subprocess.run(command, check=True)
        frames = draw_film(film, load_film_fit(options.fit or folder / "fit", anny()))
        # One palette for all frames, so that nothing flickers; what stays the same from frame to frame is left out.
        palette = frames[len(frames) // 2].quantize(128)
        drawn = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
        drawn[0].save(
            options.out / "film.gif",
            save_all=True,
            append_images=drawn[1:],
            duration=1000 // RATE,
            loop=0,
            optimize=True,
        )


if __name__ == "__main__":
    main()
