"""Files of all people in a photo: a folder for each person, and files that show all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import check_type
from ..files.json_files import rounded
from ..interop.torch_threads import one_torch_thread
from ..models.suit import in_suit
from ..pipelines.photo import PhotoFit
from ..solve.confidence.judge import confidence_record
from .ellipbody_files import GLTF_FROM_CAMERA
from .further_files import FURTHER_FILES
from .mesh_files import NamedMesh, meshes_glb
from .overlays import at_overlay_size, draw_keypoints, overlay_size, shade_for_overlay, shaded_over
from .palette import PART_COLOURS
from .photo_page import PAGE, draw_pictures, person_surface, write_photo_page
from .placements import Placement, place_on_ground
from .png_files import save_png
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
from .skinned_files import BODY_MATERIAL
from .views import VIEWS, PlacedBody, draw_views, feet_seen

if TYPE_CHECKING:
    from PIL.Image import Image

PHOTO_FILES = (PAGE, "overlay.png", VIEWS, "people.png", "scene.glb", PEOPLE_REPORT)
_TINT = 0.45  # opacity of masks over the photo


@one_torch_thread()
def save_photo_fit(
    fit: PhotoFit,
    folder: str | Path,
    *,
    photo: np.ndarray,
    formats: Sequence[str] = (),
    name: str = "the photo",
    bare: bool = False,
) -> dict[str, Any]:
    """Write folders person0, person1, ... with ``RESULT_FILES`` and ``DETAILED_FILES``, and write ``PHOTO_FILES``.

    Args:
        fit: Result of ``fit_photo``.
        folder: Folder for the files, made if it does not exist. Files of an older run's people are removed from it, and
            those of a single person's fit.
        photo: Picture, shape (H, W, 3), uint8.
        formats: Formats in ``FURTHER``, for more files of each detailed body.
        name: Name of the photo, which the page shows.
        bare: True draws and writes bare skin. By default bodies wear a plain T-shirt and shorts.

    Returns:
        Report, as ``people.json`` holds it.

    Raises:
        TypeError: If an argument has another type.

    Examples:
        After ``everyone = fit_photo("photo.png")``:

        >>> from pathlib import Path
        >>> from warp_partdr import read_photo, save_photo_fit
        >>> report = save_photo_fit(everyone, "photo", photo=read_photo("photo.png"))
        >>> (Path("photo") / "report.html").exists()
        True
    """
    check_type("fit", fit, PhotoFit, "of fit_photo")
    check_type("photo", photo, np.ndarray, "of read_photo")
    check_photo(photo)
    folder, size = Path(folder), (photo.shape[0], photo.shape[1])
    keypoints = [fit.people[index].keypoints for index in fit.fits]
    placements = dict(zip(fit.fits, place_on_ground(list(fit.fits.values()), keypoints, size), strict=True))
    report: dict[str, Any] = {"people": [_describe(fit, index, placements[index]) for index in fit.fits]}
    small = at_overlay_size(photo)  # once for all people, because it takes long
    placed = {index: _placed(fit, index, placement, bare=bare) for index, placement in placements.items()}
    overlay = small
    for index in sorted(placed, key=lambda index: -placements[index].distance):  # the farthest first
        mesh = fit.fits[index]
        shaded = shade_for_overlay(placed[index].surface, mesh.camera, size)
        overlay = shaded_over(overlay, shaded)
        own, found = folder / _name(index), mesh.ellipbody
        background = small if found.evidence.picture is not None else photo
        save_fit(
            found,
            own,
            photo=background,
            sources=fit.sources[index],
            mesh=mesh.body,
            confidence=fit.confidences[index],
        )
        save_registered(
            mesh.body, own, found.camera, size, photo=small, evidence=found.evidence, clothes=mesh.clothes,
            seconds=round(found.stage_seconds["mesh"], 2), formats=formats, bare=bare,
            shaded=None if fit.confidences[index].guessed else shaded,  # a person's own picture has no pale limbs
        )  # fmt: skip
    views = draw_views(list(placed.values()), size, small)
    pictures = {index: draw_pictures(fit, index, small, each.surface) for index, each in placed.items()}
    page = write_photo_page(report, pictures, overlay, np.asarray(views), size=size, folder=folder, name=name)
    _remove_others(folder, {_name(index) for index in fit.fits})
    # people.json is written last: if it is there, all people are. It outdates a single person's fit with its overlay.
    with replacing(
        folder, PEOPLE_REPORT, report, outdates=(PEOPLE_REPORT, FIT_REPORT, REGISTRATION_REPORT)
    ) as temporary:
        (temporary / PAGE).write_text(page, encoding="utf-8")
        save_png(_picture(overlay), temporary / "overlay.png")
        save_png(views, temporary / VIEWS)
        save_png(draw_people(fit, small), temporary / "people.png")
        shown = {index: each.body if bare else in_suit(each.body) for index, each in fit.fits.items()}
        vertices = {
            index: placements[index].apply(body.detailed.vertices[0].cpu().numpy()) for index, body in shown.items()
        }
        (temporary / "scene.glb").write_bytes(meshes_glb(_meshes(vertices, fit)))
    return report


def draw_people(fit: PhotoFit, photo: np.ndarray) -> Image:
    """Draw the people over the photo as they were found: coloured masks, and keypoints; at the size of overlays."""
    from PIL import Image

    zoom, (height, width) = overlay_size(fit.owners.shape)
    owners = np.asarray(Image.fromarray(fit.owners).resize((width, height), Image.Resampling.NEAREST))
    colours = 1 + np.arange(len(fit.people)) % (len(PART_COLOURS) - 1)
    tints = np.concatenate([PART_COLOURS[:1], PART_COLOURS[colours]]).astype(np.float32)
    share = (_TINT * (owners > 0))[..., None].astype(np.float32)
    image = _picture(((1 - share) * at_overlay_size(photo) + share * tints[owners]).astype(np.uint8))
    for person in fit.people:
        draw_keypoints(image, replace(person.keypoints, points=person.keypoints.points * zoom))
    return image


def _picture(pixels: np.ndarray) -> Image:
    from PIL import Image

    return Image.fromarray(pixels)


def _name(index: int) -> str:
    """Name of a person's folder."""
    return f"person{index}"


def _placed(fit: PhotoFit, index: int, placement: Placement, *, bare: bool) -> PlacedBody:
    """Body of a person in the scene."""
    mesh = fit.fits[index]
    return PlacedBody(
        _name(index),
        mesh.body,
        mesh.camera,
        placement,
        feet_seen(fit.people[index].keypoints),
        mesh.ellipbody.camera_guessed or not mesh.camera.perspective,
        person_surface(fit, index, bare=bare),
    )


def _describe(fit: PhotoFit, index: int, placement: Placement) -> dict[str, Any]:
    person, mesh = fit.people[index], fit.fits[index]
    points, confidence = rounded(person.keypoints.points, 2), rounded(person.keypoints.confidence, 3)
    return {
        "person": index,
        "folder": _name(index),
        "score": round(person.score, 3),
        **confidence_record(fit.confidences[index]),
        "box": rounded(person.box, 1),
        "distance_m": round(placement.distance, 2),
        "scene_scale": round(placement.scale, 3),
        "distance": describe_distance(mesh.ellipbody),
        "hidden_by": fit.hidden_by(index),
        "sources": fit.sources[index],
        "format": person.keypoints.format.name,
        "keypoints": [[*point, sure] for point, sure in zip(points, confidence, strict=True)],
        **describe_body(mesh.ellipbody, mesh.body),
        "warnings": list(mesh.ellipbody.warnings),
    }


def _meshes(vertices: dict[int, np.ndarray], fit: PhotoFit) -> list[NamedMesh]:
    """Meshes of all bodies [m], y up, facing as in the picture."""
    faces = {index: fit.fits[index].body.model.faces.cpu().numpy() for index in vertices}
    return [
        NamedMesh(_name(index), points @ GLTF_FROM_CAMERA.T, faces[index], BODY_MATERIAL)
        for index, points in vertices.items()
    ]


def _remove_others(folder: Path, kept: set[str]) -> None:
    """Remove the files of people who are not in this run, and their folders if nothing else is in them."""
    for own in folder.glob("person[0-9]*"):
        if own.name in kept or not own.is_dir() or not own.name[len("person") :].isdigit():
            continue
        for name in (*RESULT_FILES, *DETAILED_FILES, *FURTHER_FILES, SMPLX_FILE):
            (own / name).unlink(missing_ok=True)
        if not any(own.iterdir()):
            own.rmdir()
