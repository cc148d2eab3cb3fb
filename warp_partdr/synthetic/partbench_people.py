"""PartBench's people: Anny bodies in poses, seen by a camera, drawn to part labels and keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import torch

from ..body.landmarks import annotated
from ..body.rotations import rotation_from_axis_angle
from ..body.skeletons import MPJPE_JOINTS, skeleton
from ..body.template import MEAN_STATURE
from ..cameras import Camera, Perspective, WeakPerspective
from ..clothing.anny import anny
from ..clothing.measuring import statures
from ..interop.torch_threads import one_torch_thread
from ..render.mesh import draw_mesh
from . import people
from .garments import draw_outfit, dress
from .population import QUANTILES, population
from .pose_recipes import POSES, TILTED_POSES, draw_pose
from .poses import mean_body

NUM_PEOPLE = 200
SEED = 20_263

SHORT_SIDE, LONG_SIDE = 320, 400  # [px], of the picture
_FILL = (0.72, 0.9)  # share of the picture's height that the person takes, or of its width
_DISTANCE = (2.5, 6.0)  # [m], of perspective cameras
_BESIDE = {"near": (1.5, 3.0), "far": (9.0, 40.0)}  # [m], of perspective cameras that look beside people
_ASIDE = (20.0, 10.0)  # [degrees], how far these are beside the camera's axis, across and up or down, at most
_WEAK = 0.5  # share of weak-perspective cameras
_PITCH = (-10.0, 25.0)  # [degrees], how far the camera looks down
_TILT = (45.0, 20.0)  # [degrees], how far a tilted camera looks up or down, and is turned about its axis, at most
_OFFSET = 0.03  # of the picture's size: how far the person is off its middle, at most
_CUT = 0.15  # share of people of whom the border cuts off
_CUT_SHARE = (0.05, 0.2)  # of their height or width
_CLOTHES = 18  # of the seed of a person's clothes, whose draws leave all others as they are

COCO = skeleton("coco17")
Setting = Literal["usual", "near", "far", "tilted", "clothed"]
_PRIOR_EVERY = (0, 2, 4)  # of five people, these have poses from the prior


@dataclass(frozen=True)
class Person:
    """A person and the whole truth."""

    name: str  # such as "person 007"
    kind: str  # of pose: "prior" or a key of ``POSES``
    parts: np.ndarray  # part labels, 0 = background, shape (H, W), uint8
    keypoints: np.ndarray  # COCO-17 in the picture, as COCO's annotators place them [px], shape (17, 2)
    hidden: np.ndarray  # which of them are behind something, shape (17,), bool
    height: float  # of the person standing, in the picture [px]
    joints: np.ndarray  # LSP's 14 joints, camera frame [m], shape (14, 3)
    vertices: np.ndarray  # Anny's, camera frame [m], shape (V, 3), float32
    camera: Camera  # that drew the labels, B = 1


def pose_kind(index: int, setting: Setting = "usual") -> str:
    """Kind of pose that person ``index`` has: any first N people have all kinds in about the same shares."""
    if setting == "tilted":
        return TILTED_POSES[index % len(TILTED_POSES)]
    if index % 5 in _PRIOR_EVERY:
        return "prior"
    kinds = tuple(POSES)
    return kinds[(index // 5 * 2 + index % 5 // 2) % len(kinds)]


def draw_quantiles(index: int) -> tuple[np.ndarray, np.random.Generator]:
    """A person's ``QUANTILES``, shape (15,), and the source of chance that goes on from there."""
    rng = np.random.default_rng([SEED, index])
    return rng.random(len(QUANTILES)), rng


def draw_shape(index: int) -> tuple[torch.Tensor, np.random.Generator]:
    """A person's shape values, shape (1, 20), and the source of chance that goes on from there."""
    quantiles, rng = draw_quantiles(index)
    return population().shapes(torch.from_numpy(quantiles)[None].float()), rng


@lru_cache(maxsize=NUM_PEOPLE)
@one_torch_thread()  # or sums, and so the last bits, would depend on their number
def make_person(index: int, setting: Setting = "usual") -> Person:
    """Person 0 to 199; each has a seed of its own.

    "near": the same before a perspective camera that is near and looks beside, as in a crop of a wide picture; "far":
    the same before one that is far away;
    "tilted": the same bodies upright, lying, reclining and seated, before a camera that looks up, down and askew;
    "clothed": as "usual" but for the labels, which show clothes. All else is of the body beneath.
    """
    beside, tilted = _BESIDE.get(setting), setting == "tilted"
    shape, rng = draw_shape(index)
    kind = pose_kind(index, setting)
    pose = draw_pose(kind, rng)
    degrees = rng.uniform(np.negative(_TILT), _TILT) if tilted else (rng.uniform(*_PITCH), 0.0)
    values = (pose.up, pose.yaw, *np.radians(degrees))
    up, yaw, pitch, roll = (torch.tensor(value, dtype=torch.float64)[None] for value in values)
    rotations = rotation_from_axis_angle(torch.from_numpy(pose.rotations)[None].float())
    posed = mean_body(rotations, people.seen_by_camera(people.upright(up, yaw), pitch, roll).float())
    model = anny()
    body, stature = people.pose_anny(model, shape, posed), float(statures(model, shape))

    vertices = body.vertices[0].numpy()
    weak = rng.random() < _WEAK and beside is None
    offset = np.zeros(3, dtype=np.float32)
    if not weak:
        distance = rng.uniform(*(beside or _DISTANCE))
        offset[2] = distance - vertices[:, 2].mean()
        if beside is not None:
            aside = np.radians(_ASIDE)
            offset[:2] = distance * np.tan(rng.uniform(-aside, aside))
    camera, size = _place_camera(vertices + offset, weak, rng)
    shown = drawn = draw_mesh(torch.from_numpy(vertices + offset)[None], people.anny_mesh(), camera, size)
    if setting == "clothed":
        clothes, mesh = dress(body, shape, draw_outfit(np.random.default_rng([SEED, index, _CLOTHES])))
        shown = draw_mesh(torch.from_numpy(clothes + offset)[None], mesh, camera, size)

    def landmarks(names: tuple[str, ...]) -> torch.Tensor:
        return model.landmarks(body, names) + torch.from_numpy(offset)

    points = landmarks(annotated(COCO.landmarks, model.landmark_names))
    pixels = camera.project(points)[..., :2]
    cover = stature / MEAN_STATURE * torch.from_numpy(people.cover_of(COCO.landmarks))
    at = people.pixel_indices(pixels, size)
    return Person(
        name=f"person {index:03d}",
        kind=kind,
        parts=shown.labels[0].numpy(),
        keypoints=pixels[0].numpy(),
        hidden=people.behind_something(points[..., 2], at, drawn.depth, cover)[0].numpy(),
        height=stature * float(camera.intrinsics[0, 0]) / (1.0 if weak else float(offset[2])),
        joints=landmarks(MPJPE_JOINTS)[0].numpy(),
        vertices=vertices + offset,
        camera=camera,
    )


def _place_camera(vertices: np.ndarray, weak: bool, rng: np.random.Generator) -> tuple[Camera, tuple[int, int]]:
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
