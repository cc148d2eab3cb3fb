"""Scores of scenes: places in the world, motion, the order in depth, and parts of people who are drawn together."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import torch

from ... import metrics
from ...body.labels import BACKGROUND
from ...body.skeletons import MPJPE_JOINTS
from ...body.template import NUM_PARTS
from ...inputs.keypoints import person_height
from ...models.anny import anny
from ...render.mesh import draw_mesh
from ...solve.scene.fitting import SceneFit
from ...solve.scene.smoothing import time_shares
from ..synthetic.people import anny_mesh
from ..synthetic.scene_people import LABELS, SceneSample, depths_of
from .scoring import Pixels, Score, scoring_classes
from .volumes import shared_volume

_HIPS, _ANKLES = ([MPJPE_JOINTS.index(f"{side}_{joint}") for side in ("left", "right")] for joint in ("hip", "ankle"))
# Most of the true ankle of a foot that stands: speed [m/s], for motion capture on other bones slides a little, too, and
# height over the clip's lowest [m].
_STANDS, _LOW = 0.3, 0.05


@dataclass(frozen=True)
class SceneBodies:
    """Bodies of a scene's people: of one fit, or of several, each of some of the people or one of the frames.

    Attributes:
        fits: Fits in the order of people, or of frames.
        smoothing: Standard deviation of the Gaussian by which all points are smoothed in time [frames]. If it is 0,
            they are not smoothed.
        by_frame: True if each fit is of one frame.
    """

    fits: Sequence[SceneFit]
    smoothing: float = 0.0
    by_frame: bool = False

    def landmarks(self, names: tuple[str, ...]) -> np.ndarray:
        """Landmarks in the world [m], shape (P, T, L, 3)."""
        return self._joined([each.landmarks(names) for each in self.fits]).numpy()

    @property
    def vertices(self) -> torch.Tensor:
        """Vertices in the world [m], shape (P, T, V, 3)."""
        return self._joined([each.vertices for each in self.fits])

    @property
    def statures(self) -> np.ndarray:
        """Statures of the people standing [m], shape (P,); where frames were fitted apart, their mean."""
        each = [fit.statures for fit in self.fits]
        return (torch.stack(each).mean(0) if self.by_frame else torch.cat(each)).cpu().numpy()

    def _joined(self, points: list[torch.Tensor]) -> torch.Tensor:
        every = torch.cat(points, dim=1 if self.by_frame else 0).cpu()
        if self.smoothing > 0:
            numbers = torch.arange(every.shape[1], dtype=torch.float64)
            shares = time_shares(torch.ones(1, every.shape[1], dtype=torch.bool), numbers, self.smoothing)[0].to(every)
            every = torch.einsum("ts,ps...->pt...", shares, every)
        return every


def score_scene(sample: SceneSample, method: str, bodies: SceneBodies, seconds: float) -> Score:
    """Compare bodies with the truth."""
    joints, truth = bodies.landmarks(MPJPE_JOINTS), sample.joints
    return Score(
        source=sample.source,
        sample=sample.name,
        method=method,
        keypoints=_keypoint_distances(sample, bodies),
        seconds=seconds,
        pixels=_pixels(sample, bodies),
        mpjpe=1000 * float(metrics.mpjpe(joints, truth, centre_on=_HIPS).mean()),
        pa_mpjpe=1000 * float(metrics.pa_mpjpe(joints, truth).mean()),
        world_mpjpe=1000 * float(metrics.mpjpe(joints, truth).mean()),
        depth_between=1000 * depth_between_error(sample, joints),
        stature=1000 * float(np.abs(bodies.statures - sample.statures).mean()),
        acceleration=1000 * acceleration_error(joints, truth),
        sliding=1000 * sliding_speed(joints, truth, sample.scene.frame_rate),
        order=order_share(sample, joints),
        shared_volume=_shared(bodies.vertices.numpy()),
    )


def acceleration_error(points: np.ndarray, truth: np.ndarray) -> float:
    """Mean distance of accelerations of points (P, T, J, 3) from the true ones, 1/frame²; NaN below three frames."""
    if points.shape[1] < 3:
        return math.nan
    return float(np.linalg.norm(np.diff(points - truth, 2, axis=1), axis=-1).mean())


def sliding_speed(points: np.ndarray, truth: np.ndarray, rate: float) -> float:
    """Mean speed of ankles while the true ones stand [m/s], of ``MPJPE_JOINTS`` in a world with y down; NaN if none do.

    True ankles stand between two frames where they are slow, and near the lowest of the clip's.

    Args:
        points: Found joints [m], shape (P, T, 14, 3).
        truth: The true ones, the same.
        rate: Frames a second.
    """
    found, true = points[:, :, _ANKLES], truth[:, :, _ANKLES]
    speeds, true_speeds = (rate * np.linalg.norm(np.diff(each, axis=1), axis=-1) for each in (found, true))
    low = true[..., 1] > true[..., 1].max((1, 2), keepdims=True) - _LOW
    stands = (true_speeds < _STANDS) & low[:, 1:] & low[:, :-1]
    return float(speeds[stands].mean()) if stands.any() else math.nan


def order_share(sample: SceneSample, joints: np.ndarray) -> float:
    """Share of pairs of people whose order in depth is right, in the first picture; NaN with one person."""
    found, true = depths_of(sample.scene, joints), depths_of(sample.scene, sample.joints)
    right = [(found[i] < found[j]) == (true[i] < true[j]) for i, j in combinations(range(len(true)), 2)]
    return float(np.mean(right)) if right else math.nan


def depth_between_error(sample: SceneSample, joints: np.ndarray) -> float:
    """Mean error of the differences in depth between two people, in the first picture [m]; NaN with one person."""
    off = depths_of(sample.scene, joints) - depths_of(sample.scene, sample.joints)
    pairs = [abs(float(one - other)) for one, other in combinations(off, 2)]
    return float(np.mean(pairs)) if pairs else math.nan


def _shared(vertices: np.ndarray) -> float:
    """Volume that lies in two people, of vertices (P, T, V, 3), mean over frames [cm³]; NaN with one person."""
    if len(vertices) < 2:
        return math.nan
    faces = anny().faces.numpy()
    return float(np.mean([shared_volume(vertices[:, frame], faces) for frame in range(vertices.shape[1])]))


def draw_scene(sample: SceneSample, vertices: torch.Tensor) -> np.ndarray:
    """Parts of all people in each picture, as ``SceneSample.parts`` has them, shape (T V, H, W), uint8."""
    people, frames, count, _ = vertices.shape
    mesh = anny_mesh().repeated(people, NUM_PARTS, count)
    pictures = [
        draw_mesh(view.to_camera(vertices[:, frame]).flatten(0, 1)[None], mesh, view.camera, sample.parts.shape[1:])
        for frame in range(frames)
        for view in sample.scene.views
    ]
    return torch.cat([picture.labels for picture in pictures]).numpy()


def _pixels(sample: SceneSample, bodies: SceneBodies) -> Pixels:
    """Pixels of all pictures; each person's parts are classes of their own, so that a wrong order costs."""
    names, _, from_parts = scoring_classes(LABELS)
    people, count = max(len(sample.joints), sample.slots), len(names) - 1
    table = np.zeros(256, dtype=np.uint8)
    for person in range(people):
        parts = np.arange(1, NUM_PARTS + 1)
        table[person * NUM_PARTS + parts] = from_parts[parts] + person * count
    classes = names if people == 1 else (names[0], *(f"{one}: {name}" for one in range(people) for name in names[1:]))
    shown, true = table[draw_scene(sample, bodies.vertices)], table[sample.parts]
    parts = metrics.confusion(shown, true, len(classes)).sum(0)
    person = metrics.confusion(shown != BACKGROUND, true != BACKGROUND, 2).sum(0)
    return Pixels(classes=classes, parts=parts, undisputed=parts, filled=parts, foreground=person)


def _keypoint_distances(sample: SceneSample, bodies: SceneBodies) -> np.ndarray:
    """Distance of each confident keypoint of each observation, as a share of the person's height there, shape (K,)."""
    observations = sample.scene.observations
    marked = torch.from_numpy(bodies.landmarks(observations[0].keypoints.format.marks))
    shares = []
    for observation in observations:
        view, keypoints = sample.scene.views[observation.view], observation.keypoints
        projected = view.camera.project(view.to_camera(marked[observation.person, observation.frame])[None])[
            0, :, :2
        ].numpy()
        off = np.linalg.norm(projected - keypoints.points, axis=1)[keypoints.confident]
        shares.append(off / max(person_height(keypoints), 1.0))
    return np.concatenate(shares)
