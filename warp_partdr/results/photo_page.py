"""The page of a photo: one HTML file that shows each body beside the photo, the least confident one first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from ..body.template import JOINT_NAMES
from ..cameras import zoomed
from ..files.html_pages import PAGE_STYLE, html_page, join_lines, picture_element
from ..models.measuring import BODY_MEASURES
from ..pipelines.photo import PhotoFit
from ..solve.confidence.limbs import guessed_parts
from ..solve.confidence.model import packaged_model
from ..solve.confidence.sights import sight_in_words
from ..solve.confidence.words import confidence_in_words
from .overlays import clothes_over, overlay_size, surface_over
from .person_pictures import cut_window, draw_side_view, jpeg_file, person_window
from .shading import BodySurface

PAGE = "report.html"
_SIDE = 320  # [px], longer side of a person's pictures
_OVERVIEW = 1200  # [px], longer side of the picture of everyone
# Files of a person that the page links to.
_LINKED = (
    "detailed.png", "overlay.png", "parts.png", "detailed.glb", "detailed.obj", "detailed.bvh", "body.json", "body.npz",
    "report.json", "registration.json",
)  # fmt: skip
_STYLE = """
.overview{position:relative;margin:16px 0;max-width:900px}.overview img{width:100%;display:block;border-radius:6px}
.overview a{position:absolute;transform:translate(-50%,-50%);min-width:1.6em;text-align:center;border-radius:1em;
background:#1c2430;color:#fff;text-decoration:none;font-size:13px;line-height:1.6em;border:1px solid #fff}
.overview a.low{background:#b42318;color:#fff}
.order{display:flex;flex-wrap:wrap;gap:6px 16px;padding:0;list-style:none}
.person{border-top:1px solid var(--line);padding:18px 0 22px}.person:target h2{text-decoration:underline}
.person h2{border:0;margin:0 0 8px}.person h2 span{font-weight:400}.low{color:var(--warn)}
.looks{display:flex;flex-wrap:wrap;gap:12px 28px}.pictures{display:flex;flex-wrap:wrap;gap:10px;margin:8px 0;
align-items:flex-start}
.pictures img{height:260px;max-width:100%;object-fit:contain;display:block;border-radius:4px}
.pictures figure{display:table}.pictures figcaption{display:table-caption;caption-side:bottom}
.tables{flex:1 1 420px;display:flex;flex-wrap:wrap;gap:4px 40px;align-items:flex-start;align-content:flex-start}
.tables table{width:auto}
"""


@dataclass(frozen=True)
class PersonPictures:
    """Pictures of a person, JPEG files: the photo, the body over it, and the body from the side."""

    photo: bytes
    body: bytes
    side: bytes


def person_surface(fit: PhotoFit, index: int, *, bare: bool = False) -> BodySurface:
    """Surface of a person's body in the frame of the photo's camera. Guessed limbs are pale.

    Args:
        fit: Fit of the photo.
        index: Index of the person.
        bare: True is the skin alone. By default the body wears a plain T-shirt and shorts.
    """
    body, pale = fit.fits[index].body, guessed_parts(fit.confidences[index].guessed)
    return BodySurface.of_body(body.detailed.vertices, body.model, pale=pale, bare=bare)


def draw_pictures(fit: PhotoFit, index: int, photo: np.ndarray, surface: BodySurface) -> PersonPictures:
    """Draw the pictures of one person, whose clothes are an outline.

    Args:
        fit: Fit of the photo.
        index: Index of the person.
        photo: Photo at the size of overlays, shape (H, W, 3), uint8.
        surface: BodySurface of the person's body (``person_surface``).
    """
    mesh, size = fit.fits[index], (photo.shape[0], photo.shape[1])
    zoom, _ = overlay_size(fit.owners.shape)
    camera, pale = zoomed(mesh.camera, zoom, size), guessed_parts(fit.confidences[index].guessed)
    vertices, model = mesh.body.detailed.vertices, mesh.body.model
    known = model.faces.cpu().numpy()[~pale[model.face_parts.cpu().numpy()]]
    points = camera.project(vertices)[0, :, :2].cpu().numpy()[np.unique(known)]
    crop = person_window(np.array(fit.people[index].box) * zoom, points, _SIDE)
    seen = cut_window(photo, crop)
    over = surface_over(seen, surface, camera.in_crop(crop))
    return PersonPictures(
        jpeg_file(seen),
        jpeg_file(clothes_over(over, mesh.body, mesh.clothes, camera.in_crop(crop))),
        jpeg_file(draw_side_view(surface, _SIDE)),
    )


def write_photo_page(
    report: Mapping[str, Any],
    pictures: Mapping[int, PersonPictures],
    overlay: np.ndarray,
    views: np.ndarray,
    *,
    size: tuple[int, int],
    folder: Path,
    name: str,
) -> str:
    """Write the page as text.

    Args:
        report: Report of the photo, as ``people.json`` holds it.
        pictures: Pictures of each person, by their index.
        overlay: Photo with all bodies, RGB, uint8, which may be smaller than the photo.
        views: Sheet of views of all bodies, RGB, uint8.
        size: Size (H, W) of the photo [px].
        folder: Folder of the results, which holds the people's files already.
        name: Name of the photo.
    """
    people = in_order(report["people"])
    title = f"{len(people)} {'person' if len(people) == 1 else 'people'} in {name}"
    parts = [f"<h1>{escape(title)}</h1>", _introduction(people)]
    if len(people) > 1:
        parts += [_overview(people, overlay, size), _order(people)]
    parts.append(f"<div class=overview>{picture_element(jpeg_file(views), 'jpeg', 'All bodies from four sides')}</div>")
    parts += [_person(person, pictures[person["person"]], folder) for person in people]
    return html_page(title, PAGE_STYLE + _STYLE, join_lines(parts))


def in_order(people: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """People of a report, the least confident body first; of equal ones the larger person."""
    return sorted(people, key=lambda person: (person["confidence"], person["person"]))


def _introduction(people: Sequence[Mapping[str, Any]]) -> str:
    """Sentences about all people, and links to the files of the photo."""
    least = packaged_model().least
    low = sum(person["confidence"] < least for person in people)
    warned = ""
    if len(people) > 1 and low:
        has = "has" if low == 1 else "have"
        warned = f"<p class=mark>{low} of {len(people)} bodies {has} a confidence below {least:.2f}.</p>"
    order = "The least confident body comes first. " if len(people) > 1 else ""
    files = ", ".join(
        _link(each, each) for each in ("overlay.png", "views.png", "people.png", "scene.glb", "people.json")
    )
    return (
        f"{warned}<p class=soft>{order}The confidence is the probability that a body is right: the joints that the "
        "photo shows lie, on average, within 10 cm of the truth. Limbs are guessed if no keypoint shows them; they are "
        "drawn pale. The line is the outline of clothes and hair, which are not part of the body. Bodies wear a plain "
        f"suit, unless skin is asked for. Files of the photo: {files}.</p>"
    )


def _overview(people: Sequence[Mapping[str, Any]], overlay: np.ndarray, size: tuple[int, int]) -> str:
    """Element of the photo with all bodies, and a link at each head to the entry of the person."""
    from PIL import Image

    _, (height, width) = overlay_size(size, _OVERVIEW)
    small = Image.fromarray(overlay).resize((width, height), Image.Resampling.LANCZOS)
    picture = picture_element(jpeg_file(np.asarray(small)), "jpeg", "All bodies over the photo")
    tags = [_tag(person, size) for person in reversed(people)]  # the least confident one is above the others
    return f"<div class=overview>{picture}{''.join(tags)}</div>"


def _tag(person: Mapping[str, Any], size: tuple[int, int]) -> str:
    """Link to the entry of a person, at the head in the picture of everyone."""
    head = np.array(person["joints"]["pixels"][JOINT_NAMES.index("head_top")])
    left, top = np.clip(head / (size[1], size[0]), 0.02, 0.98) * 100
    style = f"left:{left:.1f}%;top:{top:.1f}%"
    return f"<a href='#{_anchor(person)}'{_mark(person)} style='{style}'>{person['person']}</a>"


def _order(people: Sequence[Mapping[str, Any]]) -> str:
    """List of links to all people, in order."""
    links = [
        f"<li><a href='#{anchor}'>{anchor}</a> <span{_mark(person)}>{person['confidence']:.2f}</span></li>"
        for anchor, person in zip(map(_anchor, people), people, strict=True)
    ]
    return f"<ol class=order>{''.join(links)}</ol>"


def _person(person: Mapping[str, Any], pictures: PersonPictures, folder: Path) -> str:
    """Entry of a person."""
    anchor = _anchor(person)
    drawn = (
        (pictures.photo, "photo"),
        (pictures.body, "body; line: clothes" + ("; pale: guessed" if person["guessed"] else "")),
        (pictures.side, "from the side, camera at the left"),
    )
    figures = [
        f"<figure>{picture_element(data, 'jpeg', f'{anchor}: {words}')}<figcaption>{words}</figcaption></figure>"
        for data, words in drawn
    ]
    words = confidence_in_words(person["confidence"])
    warnings = [f"<p class=mark>{escape(warning)}</p>" for warning in person["warnings"]]
    return join_lines(
        [
            f"<section class=person id={anchor}><h2>{anchor} <span{_mark(person)}>{words}</span></h2>",
            *warnings,
            f"<div class=looks><div class=pictures>{''.join(figures)}</div>",
            f"<div class=tables>{_limbs(person)}{_measures(person)}</div></div>",
            f"<p class=soft>Files: {_files(anchor, folder)}</p></section>",
        ]
    )


def _limbs(person: Mapping[str, Any]) -> str:
    """Table of the limbs with their state and confidence."""
    rows = [
        f"<tr><td>{name.replace('_', ' ')}<td>{sight_in_words(limb['sight'])}<td class=n>{limb['confidence']:.2f}</tr>"
        for name, limb in person["limbs"].items()
    ]
    return f"<table><tr><th>limb<th>how it is known<th class=n>confidence</tr>{''.join(rows)}</table>"


def _measures(person: Mapping[str, Any]) -> str:
    """Table of sizes, of the distance, and of who hides the person."""
    measured = person["measurements_cm"]
    girths = [f"{name.removesuffix(' girth')} {measured[name]:.0f} cm" for name in BODY_MEASURES if "girth" in name]
    rows = [
        ("stature", f"{measured['stature']:.0f} cm"),
        ("girths", ", ".join(girths)),
        ("distance", escape(f"{person['distance_m']:.1f} m, {person['distance']}")),
    ]
    if person["hidden_by"]:
        rows.append(("hidden by", ", ".join(f"person{index}" for index in person["hidden_by"])))
    rows.append(("detection score", f"{person['score']:.2f}"))
    return f"<table>{''.join(f'<tr><td>{name}<td>{value}</tr>' for name, value in rows)}</table>"


def _files(anchor: str, folder: Path) -> str:
    """Links to the files of a person that are there."""
    return ", ".join(_link(name, f"{anchor}/{name}") for name in _LINKED if (folder / anchor / name).exists())


def _link(name: str, path: str) -> str:
    return f"<a href='{path}'>{name}</a>"


def _anchor(person: Mapping[str, Any]) -> str:
    return f"person{person['person']}"


def _mark(person: Mapping[str, Any]) -> str:
    """Attribute of elements that stand for a body with a low confidence."""
    return " class=low" if person["confidence"] < packaged_model().least else ""
