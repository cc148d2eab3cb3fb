"""Scenes of known truth: Anny people before several cameras, and two who hide one another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ...body.labels import label_set
from ...body.landmarks import annotated
from ...body.rotations import rotation_from_axis_angle
from ...body.skeletons import MPJPE_JOINTS
from ...body.template import MEAN_STATURE, NUM_PARTS
from ...cameras import Perspective
from ...inputs.keypoints import Keypoints2D
from ...inputs.part_labels import PartLabels
from ...inputs.scene import Scene, SceneObservation, View
from ...interop.torch_threads import one_torch_thread
from ...models.anny import anny
from ...models.measuring import statures
from ...models.model import Detailed
from ...render.mesh import draw_mesh
from ...solve.mesh.observed_body import ObservedBody
from ...solve.scene.depth_order import grown
from ...solve.scene.smoothing import time_shares
from . import people
from .mocap import Clip
from .noise import LEVELS, Level, noisy_keypoints, noisy_labels
from .partbench_people import COCO, NUM_PEOPLE, SEED, draw_shape, pose_kind
from .pose_recipes import draw_pose
from .poses import mean_body

LABELS = replace(label_set("cdcl14"), at_joints=False)  # of Anny's skin
_SIZE = (400, 480)  # (H, W) of pictures [px]
_FILL = 0.8  # of the picture's height or width that the people take
_DISTANCE = (3.0, 5.0)  # [m]
_PITCH = (-5.0, 20.0)  # [degrees], how far cameras look down
_BESIDE, _BEHIND = (0.1, 0.35), (0.3, 0.9)  # [m], of the second of a pair
_APART = 1.08  # ratio of the distances of two people in the wrong order
_HIDDEN = (0.05, 0.6)  # share of the one behind that the other hides
_ROUNDING = 1.5  # [frames], standard deviation over which places of motion capture are averaged
_LASTS, _PER_SECOND = 0.7, 30.0  # correlation of a keypoint's noise from frame to frame, at so many frames a second
_GROUP = (2, 5)  # people, fewest and most
_NEXT, _DEEP, _LIFTED = (0.6, 1.0), 1.2, (0.1, 0.5)  # [m], of a group: from one to the next, in depth, of who jumps
_JUMPS = 0.1  # share of them
_VIEWS, _PAIR, _CLIP, _GROUPS = 19, 20, 21, 22  # of the seeds


@dataclass(frozen=True)
class SceneSample:
    """A scene and its truth.

    Attributes:
        name: Name in PartBench, such as "person 007".
        scene: Scene as it is seen, with noise.
        joints: Joints of LSP, 14 of them, in the world [m], shape (P, T, 14, 3).
        vertices: Vertices of Anny in the world [m], shape (P, T, V, 3).
        statures: Height of each person standing [m], shape (P,).
        parts: True labels of each picture, shape (T V, H, W): person 20 + part, 0 = background.
        source: Group whose figures are pooled.
        wrong_order: True if a fit is to start with the two exchanged in depth, as ``in_wrong_order`` does.
        slots: Greatest number of people in scenes whose figures are pooled with its own. If it is 0, it is the number
            here.
    """

    name: str
    scene: Scene
    joints: np.ndarray
    vertices: np.ndarray
    statures: np.ndarray
    parts: np.ndarray
    source: str = ""
    wrong_order: bool = False
    slots: int = 0

    @property
    def order(self) -> np.ndarray:
        """People from front to back, in the first frame of the first view, shape (P,)."""
        return depths_of(self.scene, self.joints).argsort()


def depths_of(scene: Scene, joints: np.ndarray) -> np.ndarray:
    """Distances of people's middles along the first view in the first frame [m], of joints (P, T, J, 3), shape (P,)."""
    middles = torch.from_numpy(np.asarray(joints)[:, 0].mean(1)).float()
    return scene.views[0].to_camera(middles)[:, 2].numpy()


def in_wrong_order(sample: SceneSample, observed_bodies: Sequence[ObservedBody]) -> list[ObservedBody]:
    """Resizes a pair so that the person behind is in front. Each body grows about the camera and keeps its picture."""
    front = int(sample.order[0])
    away = {observed.person: _distance(observed) for observed in observed_bodies}
    ratio = away[1 - front] / away[front]
    if ratio < 1:  # wrong as it is
        return list(observed_bodies)
    factor = math.sqrt(_APART * ratio)
    return [grown(observed, factor if observed.person == front else 1 / factor) for observed in observed_bodies]


def _distance(observed: ObservedBody) -> float:
    """Distance of the pelvis from the camera, along its view [m]."""
    assert observed.observation.lens is not None
    return float(observed.observation.lens[0] / observed.body.log_scale.exp())


def make_views(index: int, num_views: int, level: str = "realistic") -> SceneSample:
    """PartBench's person ``index`` amid cameras, which stand all around. Two stand 70 to 110 degrees apart."""
    rng = np.random.default_rng([SEED, index, _VIEWS, num_views])
    body, stature = _draw_body(index)
    views = _place_views(body.vertices.numpy(), num_views, rng)
    return _see(f"person {index:03d}", [[body]], [stature], views, LEVELS[level], rng)


def make_pair(index: int, level: str = "realistic") -> SceneSample:
    """Two people, one partly before the other, the first of them ``index``; odd ones start in the wrong order."""
    rng = np.random.default_rng([SEED, index, _PAIR])
    (one, first), (other, second) = _draw_body(index), _draw_body(index + 1)
    # Both stand on the same ground.
    ground = float(one.vertices[..., 1].max() - other.vertices[..., 1].max())
    mesh = people.anny_mesh().repeated(2, NUM_PARTS, anny().num_vertices)
    while True:
        beside = rng.uniform(*_BESIDE) * rng.choice((-1, 1))
        behind = rng.uniform(*_BEHIND) * rng.choice((-1, 1))
        beyond = other.moved(torch.tensor([[beside, ground, behind]], dtype=torch.float32))
        every = torch.cat([one.vertices, beyond.vertices])
        view = _place_view(every.numpy(), 0.0, rng)
        seen = view.to_camera(every)
        both = draw_mesh(seen.flatten(0, 1)[None], mesh, view.camera, _SIZE).labels[0]
        counts = [
            int((draw_mesh(body[None], people.anny_mesh(), view.camera, _SIZE).labels > 0).sum()) for body in seen
        ]
        left = int((both > NUM_PARTS).sum()) if behind > 0 else int(((both > 0) & (both <= NUM_PARTS)).sum())
        if _HIDDEN[0] <= 1 - left / counts[int(behind > 0)] <= _HIDDEN[1]:
            break
    name = f"people {index:03d}, {index + 1:03d}"
    sample = _see(name, [[one], [beyond]], [first, second], [view], LEVELS[level], rng)
    return replace(sample, wrong_order=index % 2 == 1)


def make_group(index: int, level: str = "realistic") -> SceneSample:
    """Two to five people on one ground, the first of them ``index``; one in ten jumps."""
    rng = np.random.default_rng([SEED, index, _GROUPS])
    count = _GROUP[0] + index % (_GROUP[1] - _GROUP[0] + 1)
    people_there = [_draw_body((index + place) % NUM_PEOPLE) for place in range(count)]
    beside = rng.permutation(np.cumsum(rng.uniform(*_NEXT, count)))
    bodies = []
    for (body, _), aside in zip(people_there, beside, strict=True):
        up = rng.uniform(*_LIFTED) * (rng.random() < _JUMPS)
        move = [aside, -up - float(body.vertices[..., 1].max()), rng.uniform(-_DEEP, _DEEP)]
        bodies.append(body.moved(torch.tensor([move], dtype=torch.float32)))
    view = _place_view(torch.cat([body.vertices for body in bodies]).numpy(), 0.0, rng)
    name = f"{count} people from {index:03d}"
    statures_there = [stature for _, stature in people_there]
    sample = _see(name, [[body] for body in bodies], statures_there, [view], LEVELS[level], rng)
    return replace(sample, slots=_GROUP[1])


def make_clip(
    index: int, clip: Clip, frame_rate: float, level: str = "realistic", *, num_views: int = 1
) -> SceneSample:
    """Person of PartBench's shape ``index`` who moves as a clip says, before cameras; noise lasts some frames."""
    rng = np.random.default_rng([SEED, index, _CLIP])
    shape, _ = draw_shape(index)
    world = torch.from_numpy(clip.global_orient).float()
    zero = torch.zeros(1, dtype=world.dtype)
    posed = mean_body(torch.from_numpy(clip.rotations).float(), people.seen_by_camera(world, zero.expand(len(world))))
    bodies = people.pose_anny(anny(), shape.expand(len(world), -1), posed)
    stature = float(statures(anny(), shape))
    if clip.positions is not None:
        # Files round places to 2 mm, which would be most of the acceleration; who has longer legs goes farther, or feet
        # that stand would slide.
        numbers = torch.arange(len(clip), dtype=torch.float64)
        shares = time_shares(torch.ones(1, len(clip), dtype=torch.bool), numbers, _ROUNDING)[0].numpy()
        heights = bodies.vertices[..., 1].amax(1).numpy()  # of the pelvis over the lowest point [m]
        smooth = shares @ clip.positions * (np.median(heights) / np.median(clip.positions[:, 1]))
        bodies = bodies.moved(torch.from_numpy((smooth - smooth.mean(0)) * [1, -1, -1]).float())
    views = _place_views(bodies.vertices.numpy(), num_views, rng)
    frames = [bodies.select(slice(frame, frame + 1)) for frame in range(len(world))]
    name = f"person {index:03d}, {clip.name}"
    return _see(name, [frames], [stature], views, LEVELS[level], rng, frame_rate)


@one_torch_thread()
def _draw_body(index: int) -> tuple[Detailed, float]:
    """A body in PartBench's shape and kind of pose, upright in a world with y down, and its stature [m]."""
    shape, rng = draw_shape(index)
    pose = draw_pose(pose_kind(index), rng)
    up, yaw, level = (torch.tensor(value, dtype=torch.float64)[None] for value in (pose.up, pose.yaw, 0.0))
    orientation = people.seen_by_camera(people.upright(up, yaw), level).float()
    rotations = rotation_from_axis_angle(torch.from_numpy(pose.rotations)[None].float())
    model = anny()
    return people.pose_anny(model, shape, mean_body(rotations, orientation)), float(statures(model, shape))


def _place_views(vertices: np.ndarray, num_views: int, rng: np.random.Generator) -> list[View]:
    """Place cameras all around the people; two are 54 to 126 degrees apart."""
    turns = rng.uniform(0, 2 * np.pi, 1)
    if num_views > 1:
        even = 2 * np.pi / num_views if num_views > 2 else np.pi / 2
        turns = turns + even * (np.arange(num_views) + rng.uniform(-0.2, 0.2, num_views))
    return [_place_view(vertices, turn, rng) for turn in turns]


def _place_view(vertices: np.ndarray, turn: float, rng: np.random.Generator) -> View:
    """A camera that looks at vertices (N, V, 3) from this angle about the vertical [rad] and sees all of them."""
    pitch = np.radians(rng.uniform(*_PITCH))
    angles = torch.tensor([[pitch, 0.0, 0.0], [0.0, turn, 0.0]], dtype=torch.float64)
    about_x, about_y = rotation_from_axis_angle(angles)
    rotation = (about_x @ about_y).float()
    flat = vertices.reshape(-1, 3) @ rotation.numpy().T
    middle = (flat.min(0) + flat.max(0)) / 2
    shift = np.array([-middle[0], -middle[1], rng.uniform(*_DISTANCE) - middle[2]], dtype=np.float32)
    rays = (flat + shift)[:, :2] / (flat + shift)[:, 2:]
    height, width = _SIZE
    focal = _FILL * float((np.array([width, height]) / 2 / np.abs(rays).max(0)).min())
    camera = Perspective.of_picture(_SIZE, focal=focal)
    return View(camera, rotation, torch.from_numpy(shift))


def _see(
    name: str,
    bodies: list[list[Detailed]],
    statures: list[float],
    views: list[View],
    level: Level,
    rng: np.random.Generator,
    frame_rate: float = 30.0,
) -> SceneSample:
    """Scene of P people in T frames, as cameras see them."""
    model, mesh = anny(), people.anny_mesh()
    both = mesh.repeated(len(bodies), NUM_PARTS, model.num_vertices)
    observations: list[SceneObservation] = []
    pictures: list[np.ndarray] = []
    names = annotated(COCO.landmarks, model.landmark_names)
    lasts = _LASTS ** (_PER_SECOND / frame_rate)
    lasting: dict[tuple[int, int], np.ndarray] = {}  # noise of keypoints one frame ago
    for frame in range(len(bodies[0])):
        for view_index, view in enumerate(views):
            now = [each[frame] for each in bodies]
            vertices = torch.cat([view.to_camera(body.vertices) for body in now], dim=1)
            drawn = draw_mesh(vertices, both, view.camera, _SIZE)
            shown, depth = drawn.labels[0].numpy(), drawn.depth[0]
            pictures.append(shown)
            for person, body in enumerate(now):
                points = view.to_camera(model.landmarks(body, names))
                pixels = view.camera.project(points)[..., :2]
                cover = statures[person] / MEAN_STATURE * torch.from_numpy(people.cover_of(COCO.landmarks))
                at = people.pixel_indices(pixels, _SIZE)
                hidden = people.behind_something(points[..., 2], at, depth[None], cover)[0].numpy()
                height = statures[person] * float(view.camera.focal[0, 0] / points[..., 2].mean())
                mine = (shown > NUM_PARTS * person) & (shown <= NUM_PARTS * (person + 1))
                groups = LABELS.from_parts(np.where(mine, shown - NUM_PARTS * person, 0).astype(np.uint8))
                groups = noisy_labels(groups, LABELS, height, level, rng)
                # What is somebody else's for sure is no background of this one.
                groups[(shown > 0) & ~mine & (groups == 0)] = 255
                true = pixels[0].numpy()
                seen = noisy_keypoints(true, hidden, COCO.landmarks, height, _SIZE, level=level, rng=rng)
                off = lasting.get((person, view_index))
                there = seen[:, 2:] > 0
                lasting[person, view_index] = np.where(there, seen[:, :2] - true, 0.0)
                if off is not None:
                    lasting[person, view_index] *= math.sqrt(1 - lasts**2)
                    lasting[person, view_index] += lasts * off
                placed = np.where(there, true + lasting[person, view_index], 0.0).astype(np.float32)
                keypoints = Keypoints2D(COCO.name, placed, seen[:, 2].astype(np.float32))
                if keypoints.visible.any():
                    observations.append(
                        SceneObservation(keypoints, PartLabels(LABELS, groups), person, frame, view_index)
                    )
    truth = [torch.cat([model.landmarks(body, MPJPE_JOINTS) for body in each]).numpy() for each in bodies]
    every = [torch.cat([body.vertices for body in each]).numpy() for each in bodies]
    scene = Scene(tuple(views), tuple(observations), frame_rate)
    return SceneSample(name, scene, np.stack(truth), np.stack(every), np.array(statures), np.stack(pictures))
