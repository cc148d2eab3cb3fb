"""Accuracy of registration: Anny bodies of random shape and pose, to be found again from their EllipBody alone.

    python benchmarks/registration.py MOCAP_FOLDER --out FOLDER [--count 30] [--seed 0]

Each person is the packaged Anny model with random phenotype values in a pose of motion capture that no prior has seen.
Its EllipBody is measured as the mean body was (``scripts/measure_mean_body.py``): bones between the person's joints,
and thicknesses of best silhouettes in the rest pose. Registration sees that EllipBody alone. Such ellipsoids are
measured, so about half of the true skin is inside them; "fitted" ones are the same with the weights for a photo's fit;
"inscribed" ones, as the paper has them, are those with each ellipsoid as thin as it takes to have at most
``INSIDE / 20`` of the true person's skin vertices in it.

Writes ``registration.json`` and ``registration.png``: from the front and the side, truth in grey, registration in
colours, which are those of the parts.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import warp as wp
from PIL import Image, ImageDraw

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from anny_person import Person as AnnyPerson
from measure_mean_body import Silhouettes, fit_thicknesses

from warp_partdr.body.posing import Posed, pose
from warp_partdr.body.template import BONE_STARTS, JOINT_NAMES, LENGTH_NAMES, NUM_PARTS, SHAPE_INDICES
from warp_partdr.cameras import WeakPerspective
from warp_partdr.lab.synthetic.mocap import Clip
from warp_partdr.lab.synthetic.mocap_files import held_out_frames
from warp_partdr.lab.synthetic.people import PHENOTYPE_RANGES, pose_anny, rotations_along
from warp_partdr.lab.synthetic.poses import mean_body
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.model import Detailed, DetailedModel, detailed_mesh
from warp_partdr.models.registration import Registered, RegistrationOptions, RegistrationWeights, register
from warp_partdr.models.surfaces import skin_vertices
from warp_partdr.render.part_mesh import PartMesh
from warp_partdr.results.palette import PART_COLOURS
from warp_partdr.results.pictures import blend, shade_mesh

DEPTH = 0.002  # [m] inside an ellipsoid that counts
INSIDE = 0.005  # share of the true person's vertices that may be so deep in an inscribed body
PICTURE = (300, 220)  # (H, W) of one view


@dataclass(frozen=True)
class Person:
    """A true person and its EllipBody."""

    shape: torch.Tensor  # true shape values, shape (1, S)
    truth: Detailed  # the true body
    posed: Posed  # its EllipBody


def measure_shape(model: DetailedModel, shape: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    """EllipBody's lengths (12,) and thicknesses (15,) of a person [m], in EllipBody's rest pose."""
    standing = pose_anny(model, shape, mean_body(torch.eye(3).repeat(1, NUM_PARTS, 1, 1)))
    joints = model.landmarks(standing, JOINT_NAMES)[0].double().numpy()
    bones = np.linalg.norm(joints[1:] - joints[BONE_STARTS], axis=1)
    lengths = np.array([bones[[row[0] == i for row in SHAPE_INDICES]].mean() for i in range(len(LENGTH_NAMES))])
    vertices = standing.vertices[0].double().numpy()
    person = AnnyPerson(vertices, model.faces.numpy(), model.face_parts.numpy().astype(int) - 1, {}, {})
    return lengths, fit_thicknesses(Silhouettes(person, joints[BONE_STARTS], joints[1:]))


def make_person(model: DetailedModel, clip: Clip, rng: np.random.Generator) -> Person:
    """A person of random shape in the pose of one frame, and the EllipBody whose bones lie between its joints."""
    shape = anny_shape(torch.from_numpy(rng.uniform(*PHENOTYPE_RANGES.T))[None].float())
    lengths, thicknesses = (torch.from_numpy(v).float()[None] for v in measure_shape(model, shape))
    rotations, orient = (torch.from_numpy(v).float() for v in (clip.rotations, clip.global_orient))
    posed = pose(orient, torch.zeros(1, 3), rotations, lengths, thicknesses)
    truth = pose_anny(model, shape, posed)
    # People's bones lie a little askew of the template's: the bones turn until they end at the person's joints.
    joints = model.landmarks(truth, JOINT_NAMES)
    directions = torch.nn.functional.normalize(joints[:, 1:] - joints[:, BONE_STARTS], dim=-1)
    posed = pose(orient, joints[:, 0], rotations_along(directions, orient, posed.rotations), lengths, thicknesses)
    return Person(shape, truth, posed)


def inscribed(person: Person, skin: torch.Tensor) -> Posed:
    """The person's EllipBody with each ellipsoid as thin as it takes to have few skin vertices within it."""
    posed = person.posed
    low, high = torch.full((NUM_PARTS,), 0.1), torch.ones(NUM_PARTS)
    for _ in range(12):
        middle = (low + high) / 2
        deep = inside(person.truth.vertices[:, skin], thinner(posed, middle))[0].float().mean(0) > INSIDE / NUM_PARTS
        low, high = torch.where(deep, low, middle), torch.where(deep, middle, high)
    return thinner(posed, low)


def thinner(posed: Posed, factors: torch.Tensor) -> Posed:
    """The same bones, the thicknesses of each part times a factor, shape (20,)."""
    scale = torch.stack([torch.ones_like(factors), factors, factors], dim=-1)
    return Posed(posed.joints, posed.rotations, posed.centres, posed.axes, posed.semi_axes * scale)


def inside(vertices: torch.Tensor, posed: Posed) -> torch.Tensor:
    """True where a vertex is more than ``DEPTH`` within an ellipsoid, to first order, shape (B, V, 20)."""
    local = (vertices[:, :, None] - posed.centres[:, None])[..., None, :] @ posed.axes[:, None]
    unit = local[..., 0, :] / posed.semi_axes[:, None]
    e = unit.norm(dim=-1)
    return (1 - e) * e / (unit / posed.semi_axes[:, None]).norm(dim=-1).clamp(min=1e-9) > DEPTH


def score(
    model: DetailedModel, skin: torch.Tensor, person: Person, posed: Posed, registered: Registered
) -> dict[str, float]:
    """Errors [mm], and shares of the skin's vertices that are inside."""
    joints = model.landmarks(registered.detailed, JOINT_NAMES) - model.landmarks(person.truth, JOINT_NAMES)
    errors = (registered.detailed.vertices - person.truth.vertices).norm(dim=-1)
    bodies = {"inside": registered.detailed, "truth_inside": person.truth}
    deep = {name: inside(body.vertices[:, skin], posed).any(-1) for name, body in bodies.items()}
    return {
        "vertices_mm": 1000 * float(errors.mean()),
        "worst_vertex_mm": 1000 * float(errors.max()),
        "joints_mm": 1000 * float(joints.norm(dim=-1).mean()),
        **{name: float(each.float().mean()) for name, each in deep.items()},
    }


def draw(mesh: PartMesh, vertices: np.ndarray, side: bool, *, coloured: bool) -> np.ndarray:
    """A body from its front or side, shaded, shape (H, W, 3), uint8; world with y up."""
    points = vertices - (vertices.min(0) + vertices.max(0)) / 2
    if side:
        points = points @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]).T
    points = points * [1.0, -1.0, -1.0]
    points[:, 2] += 5.0
    height, width = PICTURE
    scale = 0.9 * min(width / np.ptp(points[:, 0]), height / np.ptp(points[:, 1]))
    camera = WeakPerspective(torch.tensor([scale]).float(), torch.tensor([[width / 2, height / 2]]))
    colours = PART_COLOURS if coloured else np.full_like(PART_COLOURS, 190)
    shaded = shade_mesh(torch.from_numpy(points).float()[None], mesh, camera, PICTURE, colours)
    return blend(np.full((height, width, 3), 255, dtype=np.uint8), shaded, 1.0)


def tile(mesh: PartMesh, truth: np.ndarray, found: np.ndarray, title: str) -> Image.Image:
    """Truth and registration, each from the front and the side."""
    views = [draw(mesh, body, side, coloured=body is found) for side in (False, True) for body in (truth, found)]
    height, width = PICTURE
    shown = Image.new("RGB", (4 * width, height + 12), "white")
    shown.paste(Image.fromarray(np.concatenate(views, axis=1)), (0, 12))
    ImageDraw.Draw(shown).text((2, 0), title, fill="black")
    return shown


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mocap", type=Path, help="folder that warp_partdr/lab/synthetic/mocap_files.py reads")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--count", type=int, default=30, help="how many people")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    arguments.out.mkdir(parents=True, exist_ok=True)
    model = anny()
    mesh = detailed_mesh(model)
    skin = skin_vertices(model) > 0
    frames = held_out_frames(arguments.mocap, arguments.count)
    rows: dict[str, list[dict[str, float]]] = {"measured": [], "fitted": [], "inscribed": []}
    tiles = []
    for i in range(len(frames)):
        person = make_person(model, frames[i : i + 1], np.random.default_rng([arguments.seed, i]))
        for kind, weights, posed in (
            ("measured", RegistrationWeights(), person.posed),
            ("fitted", RegistrationWeights.fitted(), person.posed),
            ("inscribed", RegistrationWeights.inscribed(), inscribed(person, skin)),
        ):
            begun = time.perf_counter()
            registered = register(posed, model, options=RegistrationOptions(weights=weights))
            seconds = time.perf_counter() - begun
            rows[kind].append({**score(model, skin, person, posed, registered), "seconds": seconds})
            if kind == "measured":
                bodies = (body.vertices[0].double().numpy() for body in (person.truth, registered.detailed))
                tiles.append(tile(mesh, *bodies, f"{i}  {rows[kind][-1]['vertices_mm']:.1f} mm"))
            print(i, kind, {name: round(value, 3) for name, value in rows[kind][-1].items()}, flush=True)
    report = {kind: {name: np.mean([row[name] for row in given]) for name in given[0]} for kind, given in rows.items()}
    for kind, means in report.items():
        print(kind, {name: round(float(value), 4) for name, value in means.items()})
    (arguments.out / "registration.json").write_text(json.dumps({"mean": report, "each": rows}, indent=1) + "\n")
    Image.fromarray(np.concatenate([np.asarray(each) for each in tiles])).save(arguments.out / "registration.png")


if __name__ == "__main__":
    main()
