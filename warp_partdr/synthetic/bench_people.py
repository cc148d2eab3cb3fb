"""PartBench's people: Anny bodies in poses, seen by a camera, drawn to part labels and keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from ..body.rotations import rotation_from_axis_angle
from ..body.skeletons import MPJPE_SKELETON, skeleton
from ..body.template import JOINT_NAMES, NUM_PARTS, SHAPE_INDICES, template
from ..cameras import Crop, Perspective, WeakPerspective
from ..clothing.anny import PHENOTYPE_ANCHORS, anny, anny_shape
from ..clothing.mesh import detailed_mesh
from ..clothing.pose import pose_from_ellipbody
from ..render.mesh import draw_mesh
from ..render.part_mesh import PartMesh
from .bench_poses import POSES, Pose, draw_pose, posed_ellipbody

NUM_PEOPLE = 200
SEED = 20_241

# Uniform between: Anny's ages 1/3, 2/3 and 1 are a child, young and old. With these heights, children are about 1.1 m
# to 1.5 m tall, adults 1.4 m to 1.9 m.
PHENOTYPES: dict[str, tuple[float, float]] = {
    "gender": (0.0, 1.0),
    "age": (1 / 3, 1.0),
    "muscle": (0.2, 0.8),
    "weight": (0.2, 0.8),
    "height": (0.2, 0.5),
    "proportions": (0.0, 1.0),
}
SHORT_SIDE, LONG_SIDE = 320, 400  # [px], of the picture
_SAMPLES = 2  # a side of a pixel, whose majority it takes
_FILL = (0.72, 0.9)  # how much of the picture's height the person takes, or of its width
_DISTANCE = (2.5, 6.0)  # [m], of perspective cameras
_WEAK = 0.5  # share of weak-perspective cameras
_PITCH = (-10.0, 25.0)  # [degrees], how far the camera looks down
_OFFSET = 0.03  # of the picture's size: how far the person is off its middle, at most
_CUT = 0.15  # share of people of whom the border cuts off
_CUT_SHARE = (0.05, 0.2)  # of their height or width
_FACE_COVER = 0.04  # [m]: how much nearer than a point of the face a surface must be to hide it
MEAN_STATURE = 1.63  # [m], of the template's mean body

COCO = skeleton("coco17")
_PRIOR_EVERY = (0, 2, 4)  # of five people, these have poses from the prior


@dataclass(frozen=True)
class Person:
    """A person and the whole truth.

    Attributes:
        name: Such as "person 007".
        kind: Of pose: "prior" or a key of ``POSES``.
        parts: Part labels, 0 = background, shape (H, W), uint8.
        keypoints: COCO-17 in the picture, as COCO's annotators place them [px], shape (17, 2).
        hidden: Which of them are behind something, shape (17,), bool.
        height: Of the person standing, in the picture [px].
        joints: LSP's 14 joints, camera frame [m], shape (14, 3).
        vertices: Anny's, camera frame [m], shape (V, 3), float32.
        camera: That drew the labels, B = 1.
    """

    name: str
    kind: str
    parts: np.ndarray
    keypoints: np.ndarray
    hidden: np.ndarray
    height: float
    joints: np.ndarray
    vertices: np.ndarray
    camera: WeakPerspective | Perspective


def pose_kind(index: int) -> str:
    """What kind of pose person ``index`` has: any first N people have all kinds in about the same shares."""
    if index % 5 in _PRIOR_EVERY:
        return "prior"
    kinds = tuple(POSES)
    return kinds[(index // 5 * 2 + index % 5 // 2) % len(kinds)]


@lru_cache(maxsize=NUM_PEOPLE)
def make_person(index: int) -> Person:
    """Person 0 to 199; each has a seed of its own."""
    rng = np.random.default_rng([SEED, index])
    values = [rng.uniform(*PHENOTYPES[name]) for name in PHENOTYPE_ANCHORS]
    shape = anny_shape(torch.tensor([values], dtype=torch.float32))
    pose = draw_pose(pose_kind(index), rng)
    model = anny()
    posed = posed_ellipbody(pose.rotations, _orientation(pose, rng))
    body = model.pose(shape, *pose_from_ellipbody(model, posed, shape))
    standing = model.rest(shape).vertices[0, :, 1]
    stature = float(standing.max() - standing.min())

    vertices = body.vertices[0].numpy()
    weak = rng.random() < _WEAK
    offset = np.zeros(3, dtype=np.float32)
    if not weak:
        offset[2] = rng.uniform(*_DISTANCE) - vertices[:, 2].mean()
    camera, size = _look(vertices + offset, weak, rng)
    parts, depth = _draw(vertices + offset, camera, size)

    def landmarks(names: tuple[str, ...]) -> np.ndarray:
        return model.landmarks(body, names)[0].numpy() + offset

    points = landmarks(
        tuple(f"coco_{name}" if f"coco_{name}" in model.landmark_names else name for name in COCO.landmarks)
    )
    pixels = camera.project(torch.from_numpy(points)[None])[0, :, :2].numpy()
    distance = 1.0 if weak else float(offset[2])
    return Person(
        name=f"person {index:03d}",
        kind=pose.kind,
        parts=parts,
        keypoints=pixels,
        hidden=_is_hidden(points, pixels, depth, stature / MEAN_STATURE),
        height=stature * float(camera.intrinsics[0, 0]) / distance,
        joints=landmarks(skeleton(MPJPE_SKELETON).landmarks),
        vertices=vertices + offset,
        camera=camera,
    )


def _orientation(pose: Pose, rng: np.random.Generator) -> np.ndarray:
    """Rotation of the pelvis in the camera frame, shape (3, 3): upright, turned, then tilted with the camera."""
    axis, goal = pose.up, np.array([0.0, 1.0, 0.0])
    cross = np.cross(axis, goal)
    angle = np.arctan2(np.linalg.norm(cross), axis @ goal)
    upright = _rotation(cross / max(float(np.linalg.norm(cross)), 1e-9) * angle)
    # The pelvis' own heading goes, so that the yaw alone says where the person looks.
    forward = upright[:, 2]
    heading = np.arctan2(forward[0], forward[2])
    turned = _rotation(np.array([0.0, pose.yaw - heading, 0.0])) @ upright
    pitch = np.radians(rng.uniform(*_PITCH))
    return _rotation(np.array([pitch, 0.0, 0.0])) @ np.diag([1.0, -1.0, -1.0]) @ turned


def _rotation(vector: np.ndarray) -> np.ndarray:
    return rotation_from_axis_angle(torch.from_numpy(vector)).numpy()


def _look(
    vertices: np.ndarray, weak: bool, rng: np.random.Generator
) -> tuple[WeakPerspective | Perspective, tuple[int, int]]:
    """A camera that sees the person, or all but what the border cuts off, and the picture's size (H, W)."""
    flat = vertices[:, :2] if weak else vertices[:, :2] / vertices[:, 2:]
    low, high = flat.min(0), flat.max(0)
    extent = high - low
    size = np.array([SHORT_SIDE, LONG_SIDE] if extent[1] >= extent[0] else [LONG_SIDE, SHORT_SIDE])  # (W, H)
    scale = (size * rng.uniform(*_FILL) / extent).min()
    centre = size * (0.5 + rng.uniform(-_OFFSET, _OFFSET, 2)) - scale * (low + high) / 2
    if rng.random() < _CUT:
        axis, far = rng.integers(2), rng.random() < 0.7  # the bottom or the right side more often than the others
        beyond = rng.uniform(*_CUT_SHARE) * extent[axis] * scale
        edge = scale * (high if far else low)[axis] + centre[axis]
        centre[axis] += size[axis] + beyond - edge if far else -beyond - edge
    zoom, shift = (torch.tensor(values, dtype=torch.float32)[None] for values in (float(scale), centre))
    camera = WeakPerspective(zoom, shift) if weak else Perspective(zoom[:, None].expand(-1, 2), shift)
    return camera, (int(size[1]), int(size[0]))


@lru_cache(maxsize=1)
def anny_mesh() -> PartMesh:
    """Anny's mesh with labels 1 to 20."""
    return detailed_mesh(anny())


def draw_anny(
    vertices: torch.Tensor, camera: WeakPerspective | Perspective, image_size: tuple[int, int]
) -> tuple[torch.Tensor, torch.Tensor]:
    """Part labels and depth [m] of Anny bodies (B, V, 3) in the camera frame, shape (B, H, W) each."""
    picture = draw_mesh(vertices, anny_mesh(), camera, image_size)
    return picture.labels, picture.depth


def _draw(
    vertices: np.ndarray, camera: WeakPerspective | Perspective, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Part labels, each pixel's the majority of its samples, and depth [m], shape (H, W) each."""
    height, width = size
    fine_size = (height * _SAMPLES, width * _SAMPLES)
    fine = camera.in_crop(Crop(left=0.0, top=0.0, zoom=_SAMPLES, size=fine_size))
    labels, depth = draw_anny(torch.from_numpy(vertices)[None], fine, fine_size)
    blocks = labels[0].numpy().reshape(height, _SAMPLES, width, _SAMPLES)
    votes = np.stack([(blocks == label).sum((1, 3), dtype=np.uint8) for label in range(NUM_PARTS + 1)])
    return votes.argmax(0).astype(np.uint8), depth[0, ::_SAMPLES, ::_SAMPLES].numpy()


def cover_of(landmarks: tuple[str, ...]) -> np.ndarray:
    """How much nearer than a landmark of a mean adult a surface must be to hide it [m], shape (L,)."""
    thicknesses = template().mean_thicknesses
    return np.array(
        [
            thicknesses[SHAPE_INDICES[JOINT_NAMES.index(name) - 1][1]] if name in JOINT_NAMES else _FACE_COVER
            for name in landmarks
        ]
    )


def _is_hidden(points: np.ndarray, pixels: np.ndarray, depth: np.ndarray, size: float) -> np.ndarray:
    """Which COCO-17 keypoints lie behind something other than their own surroundings, shape (17,), bool.

    Joints lie inside the body: what hides one must be nearer by more than the thickness of the bone that ends there.

    Args:
        points: Camera frame [m], shape (17, 3).
        pixels: In the picture [px], shape (17, 2).
        depth: Of what is seen [m], inf = background, shape (H, W).
        size: Of the person, 1 = mean adult.
    """
    u, v = (np.clip(pixels[:, i].astype(int), 0, depth.shape[1 - i] - 1) for i in range(2))
    return depth[v, u] < points[:, 2] - size * cover_of(COCO.landmarks)
