"""Free pictures: Anny people in random clothes under a random light before backgrounds that mean nothing.

No photo, no licence: enough to prove that EllipBodyNet learns, not to make it see people in photos.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from ..body.labels import label_set
from ..body.landmarks import annotated
from ..body.rotations import rotation_from_axis_angle
from ..body.skeletons import MPJPE_JOINTS, skeleton
from ..body.template import PART_NAMES
from ..cameras import Perspective
from ..clothing.anny import anny, anny_shape
from ..inputs.keypoints import Keypoints2D
from ..inputs.part_labels import PartLabels
from ..inputs.sample import Sample
from ..render.mesh import draw_mesh
from .people import PHENOTYPE_RANGES, anny_mesh, pose_anny, seen_by_camera
from .pose_sampler import PoseBank, PoseSampler
from .poses import mean_body
from .rng import TorchRng

SIZE = 288  # [px], side of the pictures
_SAMPLES = 2  # a side of a pixel, for smooth outlines
_BATCH = 32
_PRIOR_POSES = 1024  # whose limbs are mixed
_LARGEST_POOL = 1024
_FILL = (0.7, 0.9)  # how much of the picture the person takes
_DISTANCE = (3.0, 8.0)  # [m]
_PITCH = (-10.0, 25.0)  # [degrees], how far the camera looks down
_NOISE = ((2, 0.5), (6, 0.25), (24, 0.15), (96, 0.1))  # cells a side, and how much they change a colour
_BOXES = 4
_GRAIN = 0.02
_KEYPOINTS = "body25"
_CLOTHES = (  # ends of the names of parts: skin, shirt, sleeves, trousers, legs, shoes
    ("head", "neck", "hand"),
    ("abdomen", "chest", "shoulder", "upper_arm"),
    ("forearm",),
    ("hip", "upper_leg"),
    ("lower_leg",),
    ("foot",),
)


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
    low, high = torch.from_numpy(PHENOTYPE_RANGES).to(device, torch.float32).T
    shape = anny_shape(low + (high - low) * rng.uniform(count, len(low)))
    posed = mean_body(rotation_from_axis_angle(rotations), _views(ups, rng))
    body = pose_anny(model, shape, posed)
    away = torch.zeros(count, 1, 3, device=device)
    away[:, 0, 2] = rng.uniform(count, low=_DISTANCE[0], high=_DISTANCE[1])
    vertices = body.vertices + away
    camera = _look(vertices, rng)

    side = SIZE * _SAMPLES
    mesh = anny_mesh(device)
    fine = Perspective(camera.focal * _SAMPLES, camera.centre * _SAMPLES)
    drawn = draw_mesh(vertices, mesh, fine, (side, side))
    corners = vertices[:, mesh.faces.long()]
    normals = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    light = rng.uniform(count, 3, low=-1) * torch.tensor([1.0, 1.0, 0.5], device=device)
    light[:, 2] -= 0.7  # from the viewer's side
    unit = torch.nn.functional.normalize
    lit = (unit(normals, dim=-1) * unit(light, dim=-1)[:, None]).sum(-1).clamp_min(0)
    ambient = rng.uniform(count, 1, low=0.3, high=0.6)
    brightness = (ambient + (1 - ambient) * lit).gather(1, drawn.face_index.clamp_min(0).long().flatten(1))
    colours = _clothe(rng.uniform(count, len(_CLOTHES), 3)).gather(
        1, drawn.labels.long().flatten(1)[..., None].expand(-1, -1, 3)
    )
    foreground = (colours * brightness[..., None]).unflatten(1, (side, side)).permute(0, 3, 1, 2)
    background = _background(count, side, rng)
    image = torch.where(drawn.labels[:, None] > 0, foreground, background)
    image = torch.nn.functional.avg_pool2d(image, _SAMPLES) + _GRAIN * rng.uniform(count, 3, SIZE, SIZE, low=-1)
    pictures = (image.clamp(0, 1) * 255).byte().permute(0, 2, 3, 1).cpu().numpy()
    labels = drawn.labels[:, ::_SAMPLES, ::_SAMPLES].cpu().numpy()

    names = annotated(skeleton(_KEYPOINTS).landmarks, model.landmark_names)
    points = camera.project(model.landmarks(body, names) + away)[..., :2].cpu().numpy()
    joints = (model.landmarks(body, MPJPE_JOINTS) + away).cpu().numpy()
    parts = label_set("ellipbody20")
    sure = np.ones(len(names), dtype=np.float32)
    for k in range(count):
        yield Sample(
            source="shaded",
            name=f"person {first + k:04d}",
            keypoints=Keypoints2D(_KEYPOINTS, points[k], sure),
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


def _clothe(colours: torch.Tensor) -> torch.Tensor:
    """RGB of each part label of people with pieces of clothing (N, 6, 3), shape (N, 21, 3)."""
    pieces = [[name.endswith(ends) for ends in _CLOTHES].index(True) for name in PART_NAMES]
    skin = torch.tensor([0.95, 0.75, 0.62], device=colours.device) * (0.35 + 0.65 * colours[:, :1, :1])
    bare = colours[:, 2:5:2, :1] > 0.5  # sleeves and trousers may be short
    worn = torch.cat([skin, colours[:, 1:]], dim=1)
    worn[:, 2:5:2] = torch.where(bare, skin, worn[:, 1:4:2])
    dark = torch.zeros(len(colours), 1, 3, device=colours.device)
    return torch.cat([dark, worn[:, pieces]], dim=1)


def _background(count: int, side: int, rng: TorchRng) -> torch.Tensor:
    """Smooth noise on several scales about a random colour, and boxes, shape (N, 3, side, side)."""
    image = rng.uniform(count, 3, 1, 1).expand(-1, -1, side, side)
    for cells, strength in _NOISE:
        noise = rng.uniform(count, 3, cells, cells, low=-strength, high=strength)
        image = image + torch.nn.functional.interpolate(noise, size=(side, side), mode="bilinear")
    places = (torch.arange(side, device=image.device) + 0.5) / side
    for _ in range(_BOXES):
        middle, half = rng.uniform(count, 2, 1), rng.uniform(count, 2, 1, low=0.02, high=0.25)
        inside = (places - middle).abs() < half
        box = (inside[:, 1, :, None] & inside[:, 0, None, :])[:, None]
        image = torch.where(box, rng.uniform(count, 3, 1, 1), image)
    return image
