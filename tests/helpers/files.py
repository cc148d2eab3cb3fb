"""The packaged example, models of bodies in SMPL's format, saved bodies, and what lies in a folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ExifTags, Image

from warp_partdr.body.template import NUM_PARTS, template
from warp_partdr.results.body_file import BodyFile

EXAMPLE = Path(__file__).resolve().parents[2] / "warp_partdr" / "assets" / "example"
# A tiny body in SMPL's format: a tetrahedron around each joint of a person in a T-pose, x, y, z in cm, left side only.
BODY_PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
MIDDLE = {0: (0, 0, 0), 3: (0, 11, -3), 6: (0, 25, -3), 9: (0, 30, 0), 12: (0, 51, -3), 15: (0, 60, 2)}
LEFT = {1: (7, -9, 0), 4: (11, -47, 0), 7: (9, -87, -3), 10: (12, -93, 9), 13: (7, 42, -2), 16: (17, 45, -3)}
LEFT |= {18: (43, 44, -4), 20: (68, 45, -4)}


def smpl_arrays(num_joints: int = 24, num_shapes: int = 12) -> dict[str, np.ndarray]:
    """Arrays as in a file of SMPL (24), SMPL-H (52) or SMPL-X (55)."""
    rng = np.random.default_rng(0)
    parents, joints = list(BODY_PARENTS), [MIDDLE.get(joint, (0, 0, 0)) for joint in range(22)]
    for joint, place in LEFT.items():
        joints[joint], joints[joint + 1] = place, np.multiply(place, (-1, 1, 1))
    if num_joints == 55:  # jaw and eyes
        parents, joints = parents + [15] * 3, joints + [np.add(joints[15], (0, 3, 5))] * 3
    knuckles, fingers = (1, (1,)) if num_joints == 24 else (3, (3, 1, -3, -1, 4))  # index, middle, pinky, ring, thumb
    for wrist, side in ((20, 1), (21, -1)):
        for forward in fingers:
            for knuckle in range(knuckles):
                parents.append(wrist if knuckle == 0 else len(parents) - 1)
                joints.append(np.add(joints[wrist], (side * (8 + 3 * knuckle), 0, forward)))
    joints = np.array(joints) / 100
    corners = 0.02 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    vertices = (joints[:, None] + corners).reshape(-1, 3)
    weights = np.zeros((len(vertices), num_joints))
    for joint, parent in enumerate(parents):
        weights[4 * joint : 4 * joint + 4, joint] += 0.8
        weights[4 * joint : 4 * joint + 4, max(parent, 0)] += 0.2
    tetrahedron = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    return {
        "v_template": vertices,
        "shapedirs": rng.normal(0, 0.003, (len(vertices), 3, num_shapes)),
        "posedirs": rng.normal(0, 0.002, (len(vertices), 3, 9 * (num_joints - 1))),
        "J_regressor": np.kron(np.eye(num_joints), np.full((1, 4), 0.25)),
        "weights": weights,
        "kintree_table": np.array([[2**32 - 1, *parents[1:]], range(num_joints)], dtype=np.uint32),
        "f": (4 * np.arange(num_joints)[:, None, None] + tetrahedron).reshape(-1, 3).astype(np.uint32),
    }


def save_npz(path: Path, **changes: np.ndarray | None) -> Path:
    arrays = {name: value for name, value in (smpl_arrays() | changes).items() if value is not None}
    np.savez_compressed(path, **arrays)
    return path


@pytest.fixture(scope="module")
def smpl_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_npz(tmp_path_factory.mktemp("models") / "smpl.npz")


def body_file() -> BodyFile:
    """Files that a fit saves of the mean adult at rest."""
    return BodyFile(
        global_orient=np.diag([1.0, -1.0, -1.0]),
        translation=np.zeros(3),
        rotations=np.tile(np.eye(3), (NUM_PARTS, 1, 1)),
        lengths=template().mean_lengths,
        thicknesses=template().mean_thicknesses,
        camera_scale=np.array(100.0),
        camera_translation=np.zeros(2),
        image_size=np.array([400, 300]),
    )


class Trap:
    """Leaves a folder behind if it is ever unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = str(path)

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (self.path,)


def tree(folder: Path) -> dict[str, bytes | None]:
    """The content of every file in a folder; of folders, None."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


def save_with_focal(image: Image.Image, path: Path, focal: object, was: tuple[int, int]) -> None:
    """Save a picture whose EXIF data tell a focal length on 35 mm film, and the (W, H) that it had."""
    exif = Image.Exif()
    said = exif.get_ifd(ExifTags.IFD.Exif)
    said[ExifTags.Base.FocalLengthIn35mmFilm] = focal
    said[ExifTags.Base.ExifImageWidth], said[ExifTags.Base.ExifImageHeight] = was
    image.save(path, exif=exif)
