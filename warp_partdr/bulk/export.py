"""Files of single people out of a data set, as ``partdr fit`` writes them: a folder a row."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..body.posing import Posed
from ..errors import InputError
from ..models.model import DetailedModel
from ..models.registration import Registered
from ..models.suit import in_suit
from ..results.ellipbody_files import ellipbody_glb
from ..results.further_files import FURTHER, save_further
from ..results.mesh_files import obj
from ..results.result_sets import FIT_REPORT, REGISTRATION_REPORT, replacing
from ..results.save import describe_posed, save_description, save_detailed_arrays
from ..results.skinned_files import glb, standing_mesh
from .reading import Address, PersonRow


@dataclass(frozen=True)
class Body:
    """A person that is to be written: the row, EllipBody posed, and the detailed body if the row holds one.

    Meshes of the detailed body wear a plain suit, unless ``bare``.
    """

    person: PersonRow
    posed: Posed
    registered: Registered | None
    bare: bool


def _save_glb(body: Body, folder: Path) -> None:
    (folder / "ellipbody.glb").write_bytes(ellipbody_glb(body.posed))
    if body.registered is not None:
        (folder / "detailed.glb").write_bytes(glb(body.registered, bare=body.bare))


def _detailed(body: Body, name: str) -> Registered:
    if body.registered is None:
        fault = "rows hold ellipsoids alone; expected glb, npz or json, or a data set of --quality mesh"
        raise InputError(f"--to: {name}: {fault}")
    return body.registered


def _shown(body: Body, name: str) -> Registered:
    registered = _detailed(body, name)
    return registered if body.bare else in_suit(registered)


def _save_obj(body: Body, folder: Path) -> None:
    (folder / "detailed.obj").write_text(obj(*standing_mesh(_shown(body, "obj"))))


def _save_further(name: str, body: Body, folder: Path) -> None:
    save_further(_shown(body, name), folder / "detailed", [name])


def _save_npz(body: Body, folder: Path) -> None:
    body.person.saved.save(folder / "body.npz")
    if body.registered is not None:
        save_detailed_arrays(body.registered, folder, body.person.clothes)


def _save_json(body: Body, folder: Path) -> None:
    saved, guessed = body.person.saved, bool(body.person.row.get("camera_guessed"))
    save_description(describe_posed(saved, body.posed.joints, saved.camera(), guessed=guessed), folder)


# What --to names; another format, such as SMPL-X's own NPZ, is one more line.
WRITERS: Mapping[str, Callable[[Body, Path], None]] = {
    "glb": _save_glb,
    "obj": _save_obj,
    "npz": _save_npz,
    "json": _save_json,
    **{name: partial(_save_further, name) for name in FURTHER},
}


def save_person(
    person: PersonRow,
    formats: Sequence[str],
    model: DetailedModel | None,
    folder: Path,
    about: Mapping[str, Any],
    *,
    bare: bool = False,
) -> Path:
    """Write a row's body, and a report that says where it is from, into a folder of its own.

    Args:
        person: Row with the body.
        formats: Names of formats, among ``WRITERS``.
        model: Model of the detailed body. It is None if rows hold no detailed bodies.
        folder: Folder in which the person's folder is made.
        about: Facts about the shard.
        bare: True writes meshes of the skin. By default they wear a plain suit.

    Returns:
        The person's folder, which replaces what an earlier export wrote there.
    """
    body = Body(person, person.posed, person.registered(model) if model is not None and person.detailed else None, bare)
    own = folder / folder_name(person.address)
    row = {name: person.row.get(name) for name in ("picture", "person", "annotation", "score", "keypoint_error")}
    report = {"row": str(person.address), **row, "warnings": person.row["warnings"], "made": dict(about)}
    with replacing(own, FIT_REPORT, report, outdates=(FIT_REPORT, REGISTRATION_REPORT)) as temporary:
        for name in formats:
            WRITERS[name](body, temporary)
    return own


def folder_name(address: Address) -> str:
    """Name of a row's folder: 00003-000017 of row 3/17."""
    return f"{address.shard:05d}-{address.row:06d}"
