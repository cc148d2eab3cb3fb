"""Films of people of known places by calibrated cameras, as a finder would see them."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.skeletons import MPJPE_JOINTS, skeleton
from warp_partdr.body.template import NUM_PARTS, PART_NAMES
from warp_partdr.inputs.calibrated_camera import CalibratedCamera
from warp_partdr.inputs.scene import View
from warp_partdr.lab.synthetic.mocap import Clip, rotation_matrices
from warp_partdr.lab.synthetic.people import anny_mesh
from warp_partdr.lab.synthetic.scene_people import SceneSample, make_clip
from warp_partdr.models.anny import anny
from warp_partdr.networks.detection.film_people import SEEN, FilmPeople, kept_size
from warp_partdr.networks.detection.person import SKELETON
from warp_partdr.pipelines.observed_film import ObservedFilm
from warp_partdr.render.mesh import draw_mesh

SIZE = (480, 640)
FRAMES, RATE = 26, 10.0
SWINGS = {"left_upper_arm": 1.1, "right_upper_arm": -0.9, "left_upper_leg": 0.8, "right_upper_leg": -0.8}
_ROW = np.dtype([(name, *kind) for name, kind in SEEN.items()] + [("tracks", np.int64), ("places", np.int64)])


def camera_at(turn: float, *, distance: float = 4.0, distortion: tuple[float, ...] = ()) -> CalibratedCamera:
    """A camera that looks at the world's origin from this angle about the vertical [rad]."""
    rotation = rotation_from_axis_angle(torch.tensor([0.0, turn, 0.0], dtype=torch.float64)).numpy()
    focal = 560.0, 560.0
    return CalibratedCamera(focal, (320.0, 240.0), distortion, rotation, np.array([0.0, 0.0, distance]), SIZE)


def film_of(
    sample: SceneSample, camera: CalibratedCamera, *, order: Sequence[int] = (0, 1), frames: int = 3, noise: float = 0.0
) -> FilmPeople:
    """People of a sample who stand still, as one camera sees them, its distortion included; tracks are in an order.

    Of the keypoints those that are joints are seen.
    """
    view, zoom = View.of(replace(camera, distortion=())), kept_size(SIZE)[1] / SIZE[1]
    middle = torch.from_numpy(sample.vertices).reshape(-1, 3).mean(0)
    vertices = view.to_camera(torch.from_numpy(sample.vertices[:, 0]) - middle)
    joints = view.to_camera(torch.from_numpy(sample.joints[:, 0]) - middle)
    names = skeleton(SKELETON).landmarks
    known = [(names.index(name), MPJPE_JOINTS.index(name)) for name in MPJPE_JOINTS if name in names]
    rng = np.random.default_rng(7)
    rows, packed = [], []
    mesh = anny_mesh().repeated(len(order), NUM_PARTS, anny().num_vertices)
    labels = draw_mesh(vertices.flatten(0, 1)[None], mesh, view.camera, SIZE).labels[0].numpy()
    height, width = kept_size(SIZE)
    for frame in range(frames):
        owners = np.zeros((height, width), np.uint8)
        for place, person in enumerate(order):
            mine = (labels > NUM_PARTS * person) & (labels <= NUM_PARTS * (person + 1))
            owners[mine[(np.arange(height) / zoom).astype(int)][:, (np.arange(width) / zoom).astype(int)]] = place + 1
            flat = view.camera.project(joints[person][None])[0, :, :2].numpy().astype(np.float64)
            seen = camera.distort_points(flat) + rng.normal(size=flat.shape) * noise
            keypoints = np.zeros((33, 3), np.float32)
            for to, source in known:
                keypoints[to] = *seen[source], 1.0
            box = *seen.min(0), *seen.max(0)
            rows.append((frame, frame / 30, 0.9, box, keypoints, place, place))
        packed.append(zlib.compress(owners.tobytes(), 1))
    return FilmPeople(SIZE, 30.0, np.arange(frames) / 30, np.array(rows, _ROW), tuple(packed))


def centred_joints(sample: SceneSample) -> np.ndarray:
    """The people's true joints where the cameras see them, shape (P, 14, 3)."""
    return sample.joints[:, 0] - sample.vertices.reshape(-1, 3).mean(0)


def swinging(moves: float) -> SceneSample:
    """Somebody whose arms and legs swing, faster and faster."""
    vectors = np.zeros((FRAMES, NUM_PARTS, 3))
    phase = 0.35 * np.arange(FRAMES) + 0.012 * np.arange(FRAMES) ** 2
    for name, size in SWINGS.items():
        vectors[:, PART_NAMES.index(name), 0] = moves * size * np.sin(phase)
    still = np.tile(np.eye(3), (FRAMES, 1, 1))
    clip = Clip("swinging", still, rotation_matrices(vectors), np.full((FRAMES, NUM_PARTS, 3), np.nan))
    return make_clip(3, clip, RATE, "clean")


def moving_film(sample: SceneSample, turn: float, frames: Sequence[int]) -> ObservedFilm:
    """Some of the frames of a sample, as a camera at this angle sees them, at their times since the first of these."""
    camera, times = camera_at(turn), (np.array(frames) - frames[0]) / RATE
    rows, packed = [], []
    for place, frame in enumerate(frames):
        now = replace(sample, vertices=sample.vertices[:, [frame]], joints=sample.joints[:, [frame]])
        one = film_of(now, camera, order=(0,), frames=1, noise=1.0)
        one.rows["frames"], one.rows["times"] = place, times[place]
        rows.append(one.rows)
        packed += one.packed
    people = FilmPeople(SIZE, RATE, times, np.concatenate(rows), tuple(packed))
    return ObservedFilm.of(people, camera.without_distortion)
