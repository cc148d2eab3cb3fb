"""The files of everyone in a photo: a folder for each person, and what shows all of them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import check_type
from ..interop.torch_threads import one_torch_thread
from ..pipelines.photo import PhotoFit
from .ellipbody_files import GLTF_FROM_CAMERA
from .further_files import FURTHER_FILES
from .overlays import as_shown, draw_detailed, draw_keypoints, shown_at
from .palette import PART_COLOURS
from .result_sets import FIT_REPORT, PEOPLE_REPORT, REGISTRATION_REPORT, replacing
from .save import (
    DETAILED_FILES,
    RESULT_FILES,
    SMPLX_FILE,
    check_photo,
    describe_body,
    describe_distance,
    save_fit,
    save_registered,
)
from .scene_places import ScenePlace, place_on_ground

if TYPE_CHECKING:
    import trimesh
    from PIL.Image import Image

PHOTO_FILES = ("overlay.png", "people.png", "scene.glb", PEOPLE_REPORT)
_TINT = 0.45  # of masks over the photo


@one_torch_thread()
def save_photo_fit(
    fit: PhotoFit, folder: str | Path, *, photo: np.ndarray, formats: Sequence[str] = ()
) -> dict[str, Any]:
    """Write person0, person1, ... (``RESULT_FILES`` and ``DETAILED_FILES`` each), and ``PHOTO_FILES``.

    Args:
        fit: Of ``fit_photo``.
        folder: Made if it is not there. Files of people whom an older run left in it are removed, and those of a single
            person's fit.
        photo: The picture, shape (H, W, 3), uint8.
        formats: Of ``FURTHER``, for more files of each detailed body.

    Returns:
        The report, which is ``people.json``.

    Raises:
        TypeError: If an argument is of another type.
    """
    check_type("fit", fit, PhotoFit, "of fit_photo")
    check_type("photo", photo, np.ndarray, "of read_photo")
    check_photo(photo)
    folder, size = Path(folder), (photo.shape[0], photo.shape[1])
    keypoints = [fit.people[place].keypoints for place in fit.fits]
    placed = dict(zip(fit.fits, place_on_ground(list(fit.fits.values()), keypoints, size), strict=True))
    report: dict[str, Any] = {"people": [_describe(fit, place, placed[place]) for place in fit.fits]}
    small = as_shown(photo)  # once for all, which takes long
    overlay = small
    for place in sorted(fit.fits, key=lambda place: -placed[place].distance):  # the farthest first
        overlay = np.asarray(draw_detailed(fit.fits[place].body, fit.fits[place].camera, size, overlay))
    for place, mesh in fit.fits.items():
        own, found = folder / _name(place), mesh.ellipbody
        shown = small if found.evidence.picture is not None else photo
        save_fit(found, own, photo=shown, sources=fit.sources[place], mesh=mesh.body)
        save_registered(
            mesh.body, own, found.camera, size, photo=small, evidence=found.evidence, clothes=mesh.clothes,
            seconds=round(found.stage_seconds["mesh"], 3), formats=formats,
        )  # fmt: skip
    _remove_others(folder, {_name(place) for place in fit.fits})
    # Last, so that where people.json is, everyone is; a fit of one person, whose overlay this replaces, goes.
    with replacing(
        folder, PEOPLE_REPORT, report, outdates=(PEOPLE_REPORT, FIT_REPORT, REGISTRATION_REPORT)
    ) as temporary:
        _picture(overlay).save(temporary / "overlay.png")
        draw_people(fit, small).save(temporary / "people.png")
        _scene({place: each.of(fit.fits[place].vertices) for place, each in placed.items()}, fit).export(
            temporary / "scene.glb"
        )
    return report


def draw_people(fit: PhotoFit, photo: np.ndarray) -> Image:
    """The photo with the people as they were found: masks in colours, and keypoints; not larger than shown."""
    from PIL import Image

    zoom, (height, width) = shown_at(fit.owners.shape)
    owners = np.asarray(Image.fromarray(fit.owners).resize((width, height), Image.Resampling.NEAREST))
    places = 1 + np.arange(len(fit.people)) % (len(PART_COLOURS) - 1)
    tints = np.concatenate([PART_COLOURS[:1], PART_COLOURS[places]]).astype(np.float32)
    share = (_TINT * (owners > 0))[..., None].astype(np.float32)
    image = _picture(((1 - share) * as_shown(photo) + share * tints[owners]).astype(np.uint8))
    for person in fit.people:
        draw_keypoints(image, replace(person.keypoints, points=person.keypoints.points * zoom))
    return image


def _picture(pixels: np.ndarray) -> Image:
    from PIL import Image

    return Image.fromarray(pixels)


def _name(place: int) -> str:
    """A person's folder."""
    return f"person{place}"


def _describe(fit: PhotoFit, place: int, placed: ScenePlace) -> dict[str, Any]:
    person, mesh = fit.people[place], fit.fits[place]
    keypoints = np.column_stack([person.keypoints.points.round(2), person.keypoints.confidence.round(3)])
    return {
        "person": place,
        "folder": _name(place),
        "score": round(person.score, 3),
        "box": [round(float(edge), 1) for edge in person.box],
        "distance_m": round(placed.distance, 2),
        "scene_scale": round(placed.scale, 3),
        "distance": describe_distance(mesh.ellipbody),
        "hidden_by": fit.hidden_by(place),
        "sources": fit.sources[place],
        "format": person.keypoints.format.name,
        "keypoints": keypoints.astype(float).tolist(),
        **describe_body(mesh.ellipbody, mesh.body),
        "warnings": list(mesh.ellipbody.warnings),
    }


def _scene(vertices: dict[int, np.ndarray], fit: PhotoFit) -> trimesh.Scene:
    """All bodies as named meshes [m], y up, seen from the camera's side."""
    import trimesh

    scene = trimesh.Scene()
    for place, points in vertices.items():
        faces = fit.fits[place].body.model.faces.cpu().numpy()
        mesh = trimesh.Trimesh(points @ GLTF_FROM_CAMERA.T, faces, process=False)
        scene.add_geometry(mesh, node_name=_name(place), geom_name=_name(place))
    return scene


def _remove_others(folder: Path, kept: set[str]) -> None:
    """Remove the files of people whom this run has not, and their folders if nothing else is in them."""
    for own in folder.glob("person[0-9]*"):
        if own.name in kept or not own.is_dir() or not own.name[len("person") :].isdigit():
            continue
        for name in (*RESULT_FILES, *DETAILED_FILES, *FURTHER_FILES, SMPLX_FILE):
            (own / name).unlink(missing_ok=True)
        if not any(own.iterdir()):
            own.rmdir()
