"""Free pictures: Anny people in random clothes under a random light before backgrounds that mean nothing.

No photo, no licence: enough to prove that EllipBodyNet learns, not to make it see people in photos.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from ...body.labels import label_set
from ...body.landmarks import annotated
from ...body.rotations import rotation_from_axis_angle
from ...body.skeletons import MPJPE_JOINTS, skeleton
from ...cameras import Perspective
from ...inputs.keypoints import Keypoints2D
from ...inputs.part_labels import PartLabels
from ...inputs.sample import Sample
from ...models.anny import anny
from .people import anny_mesh, pose_anny, seen_by_camera
from .population import QUANTILES, population
from .pose_sampler import PoseBank, PoseSampler
from .poses import mean_body
from .rng import TorchRng
from .shading import SAMPLES, shade_people

SIZE = 288  # [px], side of the pictures
_BATCH = 32
_PRIOR_POSES = 1024  # whose limbs are mixed
_LARGEST_POOL = 1024
_FILL = (0.7, 0.9)  # how much of the picture the person takes
_DISTANCE = (3.0, 8.0)  # [m]
_PITCH = (-10.0, 25.0)  # [degrees], how far the camera looks down
_KEYPOINTS = "body25"


def shaded_people(count: int, *, seed: int, device: torch.device | str = "cpu") -> list[Sample]:
    """Pictures of random people with the whole truth; the same seed gives the same on one device."""
    bank = PoseBank.of_prior(_PRIOR_POSES, seed=seed)
    poses = PoseSampler(bank, device=device, seed=seed, pool=min(max(count, _BATCH), _LARGEST_POOL))
    rng = TorchRng(seed, device)
    drawn: list[Sample] = []
    while len(drawn) < count:
        drawn.extend(_shade(*poses.draw(min(_BATCH, count - len(drawn))), rng, len(drawn)))
    return drawn


@torch.no_grad()
def _shade(rotations: torch.Tensor, ups: torch.Tensor, rng: TorchRng, first: int) -> Iterator[Sample]:
    """People in these poses, counted from ``first``."""
    count, device = len(rotations), rotations.device
    model = anny(device)
    shape = population(device).shapes(rng.uniform(count, len(QUANTILES)))
    posed = mean_body(rotation_from_axis_angle(rotations), _views(ups, rng))
    body = pose_anny(model, shape, posed)
    away = torch.zeros(count, 1, 3, device=device)
    away[:, 0, 2] = rng.uniform(count, low=_DISTANCE[0], high=_DISTANCE[1])
    vertices = body.vertices + away
    camera = _look(vertices, rng)
    pictures, drawn = shade_people(vertices, anny_mesh(device), camera, (SIZE, SIZE), rng)
    labels = drawn.labels[:, ::SAMPLES, ::SAMPLES].cpu().numpy()

    names = annotated(skeleton(_KEYPOINTS).landmarks, model.landmark_names)
    points = camera.project(model.landmarks(body, names) + away)[..., :2].cpu().numpy()
    joints = (model.landmarks(body, MPJPE_JOINTS) + away).cpu().numpy()
    parts = label_set("ellipbody20")
    confidence = np.ones(len(names), dtype=np.float32)
    for k in range(count):
        yield Sample(
            source="shaded",
            name=f"person {first + k:04d}",
            keypoints=Keypoints2D(_KEYPOINTS, points[k], confidence),
            parts=PartLabels(parts, labels[k]),
            target=labels[k],
            joints=joints[k],
            picture=pictures[k],
        )


def _views(ups: torch.Tensor, rng: TorchRng) -> torch.Tensor:
    """Orientations in the camera frame, shape (N, 3, 3): upright, turned anyhow, seen by a camera that looks down."""
    unit = torch.nn.functional.normalize
    any_way = rng.normal(len(ups), 3)
    across = unit(any_way - (any_way * ups).sum(-1, keepdim=True) * ups, dim=-1)
    upright = torch.stack([across, ups, torch.linalg.cross(across, ups)], dim=1)
    return seen_by_camera(upright, torch.deg2rad(rng.uniform(len(ups), low=_PITCH[0], high=_PITCH[1])))


def _look(vertices: torch.Tensor, rng: TorchRng) -> Perspective:
    """Cameras that see all of each person, somewhere in the picture."""
    flat = vertices[..., :2] / vertices[..., 2:]
    low, high = flat.amin(1), flat.amax(1)
    fill = rng.uniform(len(vertices), low=_FILL[0], high=_FILL[1])
    focal = (SIZE * fill / (high - low).amax(1))[:, None]
    free = SIZE - focal * (high - low)
    centre = free * rng.uniform(len(vertices), 2) - focal * low
    return Perspective(focal.expand(-1, 2), centre)
