"""Accuracy of registration: Anny bodies of random shape and pose, found again from their EllipBody alone.

Each person is the packaged Anny model with random phenotype values in a pose of motion capture that no prior has seen.
Its EllipBody is measured as the mean body was: bones between the person's joints, and thicknesses of best silhouettes
in the rest pose. Registration sees that EllipBody alone. "Measured": such ellipsoids have about half of the true skin
inside them. "Fitted": the same with the weights for a photo's fit. "Inscribed", as the paper has them: each ellipsoid
is as thin as it takes to have few of the true person's skin vertices in it.

With `--out`, registration.png is written there: from the front and the side, truth in grey, registration in colours,
which are those of the parts.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

from ...body.posing import Posed, pose
from ...body.template import BONE_STARTS, JOINT_NAMES, NUM_PARTS
from ...cameras import WeakPerspective
from ...models.anny import anny, anny_shape
from ...models.model import Detailed, DetailedModel, detailed_mesh
from ...models.registration import Registered, RegistrationOptions, RegistrationWeights, register
from ...models.surfaces import skin_vertices
from ...render.part_mesh import PartMesh
from ...results.palette import PART_COLOURS
from ...results.shading import blend, shade_mesh
from ..options import Mocap, tracked
from ..silhouettes import measure_by_silhouettes
from ..synthetic.mocap import Clip
from ..synthetic.mocap_files import held_out_frames
from ..synthetic.people import PHENOTYPE_RANGES, pose_anny, rotations_along
from ..tables import FigureTable

_DEPTH = 0.002  # [m] inside an ellipsoid that counts
_INSIDE = 0.005  # share of the true person's vertices that may be so deep in an inscribed body
_PICTURE = (300, 220)  # (H, W) of one view


_COLUMNS = {
    "ellipsoids": "",
    "vertices [mm]": ".1f",
    "worst vertex [mm]": ".1f",
    "joints [mm]": ".1f",
    "skin inside [%]": ".1f",
    "of the true people [%]": ".1f",
    "time [s]": ".2f",
}


def measure_registration(
    mocap: Mocap, /, *, count: int = 30, seed: int = 0, out: Path | None = None
) -> Iterator[FigureTable]:
    """Register people.

    Args:
        mocap: Poses of the people, of which those count that no network and no prior has seen.
        count: Number of people.
        seed: Seed of their shapes.
        out: Folder for the picture.
    """
    model = anny()
    mesh = detailed_mesh(model)
    skin = skin_vertices(model) > 0
    frames = held_out_frames(mocap, count)
    rows: dict[str, list[list[float]]] = {"measured": [], "fitted": [], "inscribed": []}
    each = FigureTable("Each person", {"person": "d"} | _COLUMNS)
    tiles = []
    for i in tracked(range(len(frames))):
        person = _make_person(model, frames[i : i + 1], np.random.default_rng([seed, i]))
        for kind, weights, posed in (
            ("measured", RegistrationWeights(), person.posed),
            ("fitted", RegistrationWeights.fitted(), person.posed),
            ("inscribed", RegistrationWeights.inscribed(), _inscribed(person, skin)),
        ):
            begun = time.perf_counter()
            registered = register(posed, model, options=RegistrationOptions(weights=weights))
            seconds = time.perf_counter() - begun
            figures = [*_score(model, skin, person, posed, registered), seconds]
            rows[kind].append(figures)
            each.add(i, kind, *figures)
            if kind == "measured":
                truth, found = (body.vertices[0].double().numpy() for body in (person.truth, registered.detailed))
                tiles.append(_tile(mesh, truth, found, f"{i}  {figures[0]:.1f} mm"))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        Image.fromarray(np.concatenate([np.asarray(tile) for tile in tiles])).save(out / "registration.png")
    yield each
    table = FigureTable(f"Mean of {len(frames)} people", _COLUMNS)
    for kind, each_row in rows.items():
        table.add(kind, *np.mean(each_row, axis=0).tolist())
    yield table


@dataclass(frozen=True)
class _Person:
    """A true person and its EllipBody."""

    shape: torch.Tensor  # true shape values, shape (1, S)
    truth: Detailed  # the true body
    posed: Posed  # its EllipBody


def _make_person(model: DetailedModel, clip: Clip, rng: np.random.Generator) -> _Person:
    """A person of random shape in the pose of one frame, and the EllipBody whose bones lie between its joints."""
    shape = anny_shape(torch.from_numpy(rng.uniform(*PHENOTYPE_RANGES.T))[None].float())
    lengths, thicknesses = (torch.from_numpy(v).float()[None] for v in measure_by_silhouettes(model, shape))
    rotations, orient = (torch.from_numpy(v).float() for v in (clip.rotations, clip.global_orient))
    posed = pose(orient, torch.zeros(1, 3), rotations, lengths, thicknesses)
    truth = pose_anny(model, shape, posed)
    # People's bones lie a little askew of the template's: the bones turn until they end at the person's joints.
    joints = model.landmarks(truth, JOINT_NAMES)
    directions = torch.nn.functional.normalize(joints[:, 1:] - joints[:, BONE_STARTS], dim=-1)
    posed = pose(orient, joints[:, 0], rotations_along(directions, orient, posed.rotations), lengths, thicknesses)
    return _Person(shape, truth, posed)


def _inscribed(person: _Person, skin: torch.Tensor) -> Posed:
    """The person's EllipBody with each ellipsoid as thin as it takes to have few skin vertices within it."""
    posed = person.posed
    low, high = torch.full((NUM_PARTS,), 0.1), torch.ones(NUM_PARTS)
    for _ in range(12):
        middle = (low + high) / 2
        deep = _inside(person.truth.vertices[:, skin], _thinner(posed, middle))[0].float().mean(0) > _INSIDE / NUM_PARTS
        low, high = torch.where(deep, low, middle), torch.where(deep, middle, high)
    return _thinner(posed, low)


def _thinner(posed: Posed, factors: torch.Tensor) -> Posed:
    """Bodies with the same bones, in which the thicknesses of each part are multiplied by a factor, shape (20,)."""
    scale = torch.stack([torch.ones_like(factors), factors, factors], dim=-1)
    return Posed(posed.joints, posed.rotations, posed.centres, posed.axes, posed.semi_axes * scale)


def _inside(vertices: torch.Tensor, posed: Posed) -> torch.Tensor:
    """True where a vertex is more than ``_DEPTH`` within an ellipsoid, to first order, shape (B, V, 20)."""
    local = (vertices[:, :, None] - posed.centres[:, None])[..., None, :] @ posed.axes[:, None]
    unit = local[..., 0, :] / posed.semi_axes[:, None]
    e = unit.norm(dim=-1)
    return (1 - e) * e / (unit / posed.semi_axes[:, None]).norm(dim=-1).clamp(min=1e-9) > _DEPTH


def _score(
    model: DetailedModel, skin: torch.Tensor, person: _Person, posed: Posed, registered: Registered
) -> list[float]:
    """Errors of vertices, the worst vertex and joints [mm], and shares of the skin's vertices that are inside [%]."""
    joints = model.landmarks(registered.detailed, JOINT_NAMES) - model.landmarks(person.truth, JOINT_NAMES)
    errors = (registered.detailed.vertices - person.truth.vertices).norm(dim=-1)
    deep = [_inside(body.vertices[:, skin], posed).any(-1) for body in (registered.detailed, person.truth)]
    lengths = errors.mean(), errors.max(), joints.norm(dim=-1).mean()
    return [*(1000 * float(each) for each in lengths), *(100 * float(each.float().mean()) for each in deep)]


def _draw(mesh: PartMesh, vertices: np.ndarray, side: bool, *, coloured: bool) -> np.ndarray:
    """A body from its front or side, shaded, shape (H, W, 3), uint8; world with y up."""
    points = vertices - (vertices.min(0) + vertices.max(0)) / 2
    if side:
        points = points @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]).T
    points = points * [1.0, -1.0, -1.0]
    points[:, 2] += 5.0
    height, width = _PICTURE
    scale = 0.9 * min(width / np.ptp(points[:, 0]), height / np.ptp(points[:, 1]))
    camera = WeakPerspective(torch.tensor([scale]).float(), torch.tensor([[width / 2, height / 2]]))
    colours = PART_COLOURS if coloured else np.full_like(PART_COLOURS, 190)
    shaded = shade_mesh(torch.from_numpy(points).float()[None], mesh, camera, _PICTURE, colours)
    return blend(np.full((height, width, 3), 255, dtype=np.uint8), shaded, 1.0)


def _tile(mesh: PartMesh, truth: np.ndarray, found: np.ndarray, title: str) -> Image.Image:
    """Truth and registration, each from the front and the side."""
    views = [_draw(mesh, body, side, coloured=body is found) for side in (False, True) for body in (truth, found)]
    height, width = _PICTURE
    shown = Image.new("RGB", (4 * width, height + 12), "white")
    shown.paste(Image.fromarray(np.concatenate(views, axis=1)), (0, 12))
    ImageDraw.Draw(shown).text((2, 0), title, fill="black")
    return shown
