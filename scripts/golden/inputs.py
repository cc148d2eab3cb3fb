"""Photos, films, cameras and annotations, made of the packaged example's person."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import av
import numpy as np
import torch
from PIL import Image

from warp_partdr.body.rotations import rotation_to_axis_angle
from warp_partdr.lab.synthetic.people import anny_mesh
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.lab.synthetic.scene_people import make_views
from warp_partdr.lab.synthetic.shading import shade_people

EXAMPLE = Path(str(resources.files("warp_partdr").joinpath("assets", "example")))
SIZE = (384, 560)  # (H, W) of photos of several people [px]
FRAMES, RATE, STEP = 8, 10, 3  # of films; the people move by STEP pixels from frame to frame
_BOX = (95, 20, 300, 500)  # of the person in the example's photo [px]
_PEOPLE = ((270, 150, 50, True), (330, 60, 35, False), (250, 400, 70, False))  # height, left, top [px], mirrored
_PERSON = 5  # of PartBench, whose two cameras are found without calibration


def make_crowd(moved: int = 0) -> np.ndarray:
    """A photo of three people, the first partly behind the second and the third alone; RGB, (H, W, 3), uint8."""
    background = np.tile(np.linspace(200, 150, SIZE[0])[:, None, None], (1, SIZE[1], 3))
    picture = Image.fromarray(background.astype(np.uint8))
    for height, left, top, mirrored in _PEOPLE:
        person, mask = _cut_out(height, mirrored)
        picture.paste(person, (left + moved, top), mask)
    return np.asarray(picture)


def _cut_out(height: int, mirrored: bool) -> tuple[Image.Image, Image.Image]:
    """The example's person and their mask."""
    size = round(height * (_BOX[2] - _BOX[0]) / (_BOX[3] - _BOX[1])), height
    with Image.open(EXAMPLE / "photo.png") as photo, Image.open(EXAMPLE / "parts.png") as parts:
        mask = Image.fromarray(((np.asarray(parts) > 0) * 255).astype(np.uint8))
        images = photo.convert("RGB").crop(_BOX).resize(size), mask.crop(_BOX).resize(size)
    if mirrored:
        return images[0].transpose(Image.Transpose.FLIP_LEFT_RIGHT), images[1].transpose(
            Image.Transpose.FLIP_LEFT_RIGHT
        )
    return images


def write_film(path: Path, pictures: Sequence[np.ndarray]) -> None:
    """Write a film of pictures of even size."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=RATE)
        stream.height, stream.width = pictures[0].shape[:2]
        stream.pix_fmt, stream.bit_rate = "yuv420p", 8_000_000
        stream.codec_context.thread_count = 1  # so that it is the same film each time
        for index, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = index
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def write_crowd_film(path: Path) -> None:
    """Write a film of the photo's people, who move to the right."""
    write_film(path, [make_crowd(STEP * frame) for frame in range(FRAMES)])


def write_views(folder: Path) -> None:
    """Write left.mp4 and right.mp4, a person who stands still before two cameras, and the cameras, rig.json."""
    sample = make_views(_PERSON, 2)
    height, width = sample.parts.shape[1:]
    cameras = {}
    for name, view in zip(("left", "right"), sample.scene.views, strict=True):
        vertices = view.to_camera(torch.from_numpy(sample.vertices[0]))
        (picture,), _ = shade_people(vertices, anny_mesh(), view.camera, (height, width), TorchRng(_PERSON, "cpu"))
        write_film(folder / f"{name}.mp4", [picture] * 4)
        focal_x, focal_y, *principal = view.camera.intrinsics[0].tolist()
        cameras[name] = {
            "size": [width, height],
            "focal": [focal_x, focal_y],
            "principal": principal,
            "rotation": rotation_to_axis_angle(view.rotation).tolist(),
            "translation": view.translation.tolist(),
            "distortion": [],
        }
    (folder / "rig.json").write_text(json.dumps({"cameras": cameras}))


def _example_photo(height: int) -> Image.Image:
    with Image.open(EXAMPLE / "photo.png") as photo:
        return photo.convert("RGB").resize((photo.width * height // photo.height, height))


def write_photos(folder: Path) -> None:
    """Write one person, several people, and a picture of nobody."""
    folder.mkdir()
    _example_photo(256).save(folder / "one.png")
    Image.fromarray(make_crowd()).save(folder / "several.png")
    Image.new("RGB", (160, 120), (90, 120, 90)).save(folder / "nobody.png")


def write_labelled_photos(folder: Path) -> None:
    """Write the example with its keypoints and part labels beside it, and again in half its size."""
    folder.mkdir()
    given = json.loads((EXAMPLE / "keypoints.json").read_text())
    for name, shrink in (("full", 1), ("half", 2)):
        for source, ending in (("photo.png", "png"), ("parts.png", "parts.png")):
            with Image.open(EXAMPLE / source) as image:
                size = image.width // shrink, image.height // shrink
                image.resize(size, Image.Resampling.NEAREST).save(folder / f"{name}.{ending}")
        points = [[x / shrink, y / shrink, confidence] for x, y, confidence in given["keypoints"]]
        (folder / f"{name}.keypoints.json").write_text(json.dumps({**given, "keypoints": points}))


def write_coco(folder: Path) -> None:
    """Write people.json, COCO's annotations with outlines, and the photo of several people that they belong to."""
    folder.mkdir()
    Image.fromarray(make_crowd()).save(folder / "several.png")
    annotations = [
        {"id": 100 + place, "image_id": 1, "category_id": 1, **_annotation(*person)}
        for place, person in enumerate(_PEOPLE)
    ]
    images = [{"id": 1, "file_name": "several.png", "height": SIZE[0], "width": SIZE[1]}]
    (folder / "people.json").write_text(json.dumps({"images": images, "annotations": annotations}))


def _annotation(height: int, left: int, top: int, mirrored: bool) -> dict[str, Any]:
    """Keypoints, box and outline of a person, where ``make_crowd`` puts it."""
    given = json.loads((EXAMPLE / "keypoints.json").read_text())["keypoints"]
    image, mask = _cut_out(height, mirrored)
    zoom = height / (_BOX[3] - _BOX[1])
    rows = [((x - _BOX[0]) * zoom, (y - _BOX[1]) * zoom) for x, y, _ in given]
    if mirrored:  # left and right of COCO's pairs are exchanged: the nose, then left, right, left, ...
        order = [0, *(place + (1 if place % 2 else -1) for place in range(1, len(rows)))]
        rows = [(image.width - 1 - rows[place][0], rows[place][1]) for place in order]
    covered = np.asarray(mask) > 127
    lines = np.flatnonzero(covered.any(1)).tolist()
    first = [(left + int(covered[line].argmax()), top + line) for line in lines]
    last = [(left + covered.shape[1] - int(covered[line, ::-1].argmax()), top + line) for line in lines]
    columns = np.flatnonzero(covered.any(0))
    return {
        "keypoints": [number for x, y in rows for number in (round(x + left, 2), round(y + top, 2), 2)],
        "bbox": [left + int(columns[0]), top + lines[0], int(np.ptp(columns)) + 1, lines[-1] - lines[0] + 1],
        "segmentation": [[number for point in (*first, *reversed(last)) for number in point]],
    }
