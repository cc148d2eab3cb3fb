"""Make synthetic people: Anny bodies in poses that the pose prior has not seen, with labels, keypoints and 3D truth.

    python benchmarks/anny_people.py MOCAP_FOLDER --out FOLDER --count 24 --seed 0

Writes ``person_000.npz`` and so on, and ``contact_sheet.png``. Picture size (H, W) is 400 x 320, or 320 x 400 for
people who are wider than tall. Points are in the camera frame (x right, y down, z away) [m] or in pixels (u, v). Keys:

* ``parts20`` (H, W) uint8: true labels, 0 = background, k = part ``PART_NAMES[k - 1]``;
* ``cdcl14``, ``cdcl14_noisy`` (H, W) uint8: true labels of that label set, and as a network might give them;
* ``keypoints``, ``keypoints_true`` (17, 3): COCO-17, u, v [px] and confidence (0.5 = hidden), with and without noise;
* ``coco17`` (17, 3), ``lsp14`` (14, 3): true 3D joints [m], in the order of ``body/skeletons.py``;
* ``focal``, ``centre`` (2,): of the perspective camera [px];
* ``source``: mocap clip and frame; ``phenotype``: of Anny, JSON; ``stature`` [m], standing; ``yaw``, ``pitch`` [rad];
* ``global_orient`` (3, 3), ``rotations`` (20, 3, 3): the EllipBody pose that the person was given, camera frame.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "scripts"))

from anny_noise import noisy_keypoints, noisy_labels
from anny_person import Person, PersonFactory
from make_example import crown

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import PARENTS, PART_NAMES, template
from warp_partdr.cameras import Perspective
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import PartMesh
from warp_partdr.results.palette import PART_COLOURS, group_colours
from warp_partdr.synthetic.mocap import Clip, is_held_out, joint_positions, load_clips, rotation_matrices

LABELS = label_set("cdcl14")
COCO = skeleton("coco17")
LSP = skeleton("lsp14")

SHORT_SIDE, LONG_SIDE = 320, 400  # [px], of the picture
FILL = (0.70, 0.80)  # how much of the picture's height the person takes, and at most 0.9 of its width
DISTANCE = (3.0, 6.0)  # [m]
MAX_PITCH = np.radians(10.0)  # of the camera
OFFSET = 0.03  # of the picture's size: how far the person is off its middle, at most
LEAST_DIFFERENCE = 0.05  # [m]: mean distance of joints between any two poses

# Adults: Anny's age 0.67 is young and 1 old; with these heights they are about 1.45 m to 1.9 m tall.
PHENOTYPES: dict[str, tuple[float, float]] = {
    "gender": (0.0, 1.0),
    "age": (0.62, 0.85),
    "muscle": (0.3, 0.75),
    "weight": (0.25, 0.8),
    "height": (0.28, 0.48),
    "proportions": (0.2, 0.8),
}
# The Anny bones where EllipBody's bones begin; those between them turn with their parents. {} is the side.
BONES: dict[str, str] = {
    "abdomen": "spine05",
    "chest": "spine02",
    "neck": "neck01",
    "head": "head",
    "{}_shoulder": "clavicle.{}",
    "{}_upper_leg": "upperleg01.{}",
    "{}_lower_leg": "lowerleg01.{}",
    "{}_foot": "foot.{}",
    "{}_upper_arm": "upperarm01.{}",
    "{}_forearm": "lowerarm01.{}",
    "{}_hand": "wrist.{}",
}
# Bones that have another direction in Anny's A-pose than in EllipBody's rest pose, and the bone at their end.
ENDS: dict[str, str] = {
    "{}_upper_leg": "lowerleg01.{}",
    "{}_lower_leg": "foot.{}",
    "{}_upper_arm": "lowerarm01.{}",
    "{}_forearm": "wrist.{}",
}
# How much nearer than a joint [m] a surface must be to hide it: the joints lie inside the body.
COVER: dict[str, float] = {"shoulder": 0.13, "elbow": 0.08, "wrist": 0.06, "hip": 0.18, "knee": 0.10, "ankle": 0.08}
FACE_COVER = 0.04


def held_out_poses(folder: Path, count: int, rng: np.random.Generator) -> Iterator[tuple[str, Clip]]:
    """Poses (clips of one frame) with their sources, from all held-out clips in turn, no two nearly the same."""
    clips = [clip for clip in load_clips(folder) if is_held_out(clip)]
    frames = [[(f"{clip.name}:{i}", clip[i : i + 1]) for i in range(len(clip))] for clip in clips]
    # Walking is many clips; it counts as one.
    walking = [frame for group in frames for frame in group if "walking" in frame[0]]
    groups = [group for group in [walking, *frames] if group and (group is walking or "walking" not in group[0][0])]
    queues = [[group[i] for i in rng.permutation(len(group))] for group in groups]
    taken: list[np.ndarray] = []
    while len(taken) < count:
        if not any(queues):
            raise SystemExit(f"--count: {count}; expected at most {len(taken)}, as many as there are different poses")
        for queue in queues:
            while queue and len(taken) < count:
                source, pose = queue.pop()
                joints = joint_positions(np.eye(3)[None], pose.rotations)[0]
                if all(np.linalg.norm(joints - other, axis=1).mean() > LEAST_DIFFERENCE for other in taken):
                    taken.append(joints)
                    yield source, pose
                    break


def _both(table: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Part and Anny bone of each entry, on both sides."""
    for part, bone in table.items():
        for side in ("left", "right") if "{}" in part else ("",):
            yield part.format(side), bone.format(side[:1].upper())


def pose_person(factory: PersonFactory, rest: Person, pose: Clip, phenotype: dict[str, float]) -> Person:
    """Give every Anny bone group the world rotation of its EllipBody bone."""
    bones = dict(_both(BONES))
    # From Anny's A-pose to EllipBody's rest pose.
    to_rest: dict[str, np.ndarray] = {}
    for name, end in _both(ENDS):
        direction = template().rest_directions[PART_NAMES.index(name)]
        factory.aim(rest, to_rest, bones[name], end, direction)
    for side in "LR":
        # The hands go along with the forearms (that leaves the palms down), the feet stand as Anny's.
        to_rest[f"wrist.{side}"] = to_rest[f"lowerarm01.{side}"]
    turns = {"root": pose.global_orient[0]}
    world: list[np.ndarray] = []
    for part, parent in enumerate(PARENTS):
        world.append((pose.global_orient[0] if parent < 0 else world[parent]) @ pose.rotations[0, part])
        if bone := bones.get(PART_NAMES[part]):
            turns[bone] = world[part] @ to_rest.get(bone, np.eye(3))
    return factory(turns, phenotype)


def place(points: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A camera, and where it sees the person: picture size (H, W), focal, centre, rotation, translation, yaw, pitch.

    Args:
        points: Vertices in a world with y up [m], shape (V, 3).
        rng: Source of chance.
    """
    yaw, pitch = rng.uniform(-np.pi, np.pi), rng.uniform(-MAX_PITCH, MAX_PITCH)
    tilt = rotation_matrices(np.array([pitch, 0.0, 0.0]))
    rotation = tilt @ np.diag([1.0, -1.0, -1.0]) @ rotation_matrices(np.array([0.0, yaw, 0.0]))
    turned = points @ rotation.T
    low, high = turned.min(0), turned.max(0)
    translation = np.array([0.0, 0.0, rng.uniform(*DISTANCE)]) - (low + high) / 2
    flat = (turned + translation)[:, :2] / (turned + translation)[:, 2:]
    extent = np.ptp(flat, axis=0)
    size = np.array([SHORT_SIDE, LONG_SIDE] if extent[1] >= extent[0] else [LONG_SIDE, SHORT_SIDE])  # (W, H)
    focal = (size * [0.9, rng.uniform(*FILL)] / extent).min()
    # The middle of the person near that of the picture.
    shift = rng.uniform(-OFFSET, OFFSET, 2) * size / focal - (flat.min(0) + flat.max(0)) / 2
    translation[:2] += shift * translation[2]
    return {
        "size": size[::-1],
        "focal": np.array([focal, focal]),
        "centre": size / 2,
        "rotation": rotation,
        "translation": translation,
        "yaw": np.array(yaw),
        "pitch": np.array(pitch),
    }


def is_hidden(points: np.ndarray, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Which COCO-17 joints lie behind something other than their own surroundings, shape (17,).

    Args:
        points: Joints in the camera frame [m], shape (17, 3).
        pixels: Their (u, v) [px], shape (17, 2).
        depth: Of the rendering [m], inf = background, shape (H, W).
    """
    u, v = (np.clip(pixels[:, i].astype(int), 0, depth.shape[1 - i] - 1) for i in range(2))
    cover = np.array([COVER.get(name.partition("_")[2], FACE_COVER) for name in COCO.landmarks])
    return depth[v, u] < points[:, 2] - cover


def make_person(factory: PersonFactory, source: str, pose: Clip, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Everything about one person, as the module's docstring lists it."""
    phenotype = {name: round(float(rng.uniform(*span)), 3) for name, span in PHENOTYPES.items()}
    rest = factory(phenotype=phenotype)
    person = pose_person(factory, rest, pose, phenotype)
    view = place(person.vertices, rng)

    def to_camera(point: np.ndarray) -> np.ndarray:
        return point @ view["rotation"].T + view["translation"]

    vertices = to_camera(person.vertices)
    coco = np.array([to_camera(person.coco[name]) for name in COCO.landmarks])
    joints = {name: to_camera(point) for name, point in person.joints().items()}
    joints["neck"] = (joints["left_shoulder"] + joints["right_shoulder"]) / 2  # As skeletons.py has it.
    joints["head_top"] = vertices[crown(rest)]

    camera = Perspective(torch.from_numpy(view["focal"])[None], torch.from_numpy(view["centre"])[None])
    mesh = PartMesh.from_faces(person.faces, person.face_parts + 1)
    height, width = (int(side) for side in view["size"])
    picture = draw_mesh(torch.from_numpy(vertices)[None], mesh, camera, (height, width))
    parts = picture.labels[0].numpy()
    pixels = camera.project(torch.from_numpy(coco)[None])[0, :, :2].numpy()
    hidden = is_hidden(coco, pixels, picture.depth[0].numpy())

    stature = float(np.ptp(rest.vertices[:, 1]))
    keypoints = noisy_keypoints(pixels, hidden, stature * view["focal"][0] / vertices[:, 2].mean(), rng)
    groups = LABELS.from_parts(parts)
    return {
        "parts20": parts,
        "cdcl14": LABELS.to_ids(groups).astype(np.uint8),
        "cdcl14_noisy": LABELS.to_ids(noisy_labels(groups, LABELS, rng)).astype(np.uint8),
        "keypoints": keypoints,
        "keypoints_true": np.column_stack([pixels, keypoints[:, 2]]),
        "coco17": coco,
        "lsp14": np.array([joints[name] for name in LSP.landmarks]),
        "focal": view["focal"],
        "centre": view["centre"],
        "source": np.array(source),
        "phenotype": np.array(json.dumps(phenotype)),
        "stature": np.array(stature),
        "yaw": view["yaw"],
        "pitch": view["pitch"],
        "global_orient": view["rotation"] @ pose.global_orient[0],
        "rotations": pose.rotations[0],
    }


def tile(person: dict[str, np.ndarray], title: str) -> Image.Image:
    """True parts with true keypoints, beside the noisy labels with the noisy keypoints (hollow = hidden)."""
    shown = Image.new("RGB", (2 * LONG_SIDE, LONG_SIDE + 12))
    draw = ImageDraw.Draw(shown)
    noisy = group_colours(LABELS.part_groups)[LABELS.to_groups(person["cdcl14_noisy"])]
    sides = ((PART_COLOURS[person["parts20"]], person["keypoints_true"]), (noisy, person["keypoints"]))
    for column, (picture, keypoints) in enumerate(sides):
        corner = np.array([column * LONG_SIDE, 12])
        shown.paste(Image.fromarray(picture), tuple(corner.tolist()))
        points = keypoints[:, :2] + corner
        for i, j in COCO.edges:
            names = COCO.landmarks[i] + COCO.landmarks[j]
            colour = "white" if "left" in names and "right" in names else "orange" if "left" in names else "cyan"
            draw.line([*points[i], *points[j]], fill=colour)
        for (u, v), confidence in zip(points, keypoints[:, 2], strict=True):
            draw.ellipse((u - 3, v - 3, u + 3, v + 3), fill="white" if confidence == 1 else None, outline="white")
    draw.text((2, 0), title, fill="white")
    return shown


def contact_sheet(tiles: list[Image.Image], columns: int = 4) -> Image.Image:
    """All people in rows."""
    width, height = tiles[0].size
    sheet = Image.new("RGB", (columns * width, -(-len(tiles) // columns) * height))
    for i, picture in enumerate(tiles):
        sheet.paste(picture, (i % columns * width, i // columns * height))
    return sheet


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mocap", type=Path, help="folder that warp_partdr/synthetic/mocap.py reads")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    parser.add_argument("--count", type=int, default=24, help="how many people")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)

    factory = PersonFactory()
    tiles = []
    poses = held_out_poses(arguments.mocap, arguments.count, np.random.default_rng(arguments.seed))
    for i, (source, pose) in enumerate(poses):
        person = make_person(factory, source, pose, np.random.default_rng([arguments.seed, i]))
        np.savez_compressed(arguments.out / f"person_{i:03d}.npz", **person)
        tiles.append(tile(person, f"{i} {source}  {float(person['stature']):.2f} m"))
    contact_sheet(tiles).save(arguments.out / "contact_sheet.png", optimize=True)


if __name__ == "__main__":
    main()
