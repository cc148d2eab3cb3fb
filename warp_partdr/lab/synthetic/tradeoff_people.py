"""People of known truth for ``partdr bench tradeoff``, and bodies a stated way off it to start from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch

from ...body.labels import label_set
from ...body.parameters import BodyParameters
from ...body.pose_prior import packaged_prior
from ...body.posing import LandmarkGather
from ...body.rotations import rotation_from_axis_angle, rotation_to_6d
from ...body.skeletons import MPJPE_HIPS, MPJPE_JOINTS, skeleton
from ...cameras import Crop, WeakPerspective
from ...inputs.observation import REFERENCE_SIZE, Observation
from ...interop.movable import Movable
from ...render.ellipsoids import draw_ellipsoids
from ...solve.ellipsoids.energy import Energy
from ...solve.ellipsoids.refine import refine
from .partbench_people import Person, make_person
from .people import draw_anny

LABELS = label_set("ellipbody20")
ELLIPBODY, ANNY = "EllipBody", "Anny"  # whose truth it is
TRUTH_SIZE = 1536  # [px], three samples a side of a pixel of the largest pictures, 24 of the smallest
KEYPOINTS = skeleton("coco17").landmarks
KEYPOINT_NOISE = 0.015  # of the crop's half-side, about 1 % of a person's height
# Of what a start is off by, for each radian that joints are: the crop's half-sides, and the logarithm of the scale.
_SHIFT_PER_RADIAN, _SCALE_PER_RADIAN = 0.2, 0.2

_MARGIN = 0.1  # of the person's extent, on each side of the crop
_STATURE, _GIRTH = 0.05, 0.1  # spread of the logarithm of lengths and of thicknesses, about those of the mean adult
_SEED = 0
_LIFT_ITERATIONS, _LIFT_RATE, _LIFT_WEIGHT = 150, 0.05, 3.0
_TURNS = 8  # orientations that the search for a person's EllipBody starts from


@dataclass(frozen=True)
class People(Movable):
    """N people in a square crop each."""

    name: str  # ``ELLIPBODY`` or ``ANNY``
    bodies: BodyParameters  # the true ones; of Annys, EllipBodies of mean thickness with joints nearest to theirs
    labels: torch.Tensor  # true part labels, shape (N, ``TRUTH_SIZE``, ``TRUTH_SIZE``), uint8
    points: torch.Tensor  # COCO's keypoints with noise, -1 to 1 in the crop, shape (N, 17, 2)
    joints: torch.Tensor  # true ``MPJPE_JOINTS``, in the camera frame [m], shape (N, 14, 3)

    def __len__(self) -> int:
        """Number of people, N."""
        return len(self.labels)

    def observation(self, person: int | None = None) -> Observation:
        """Input of a fit to a person; of None, to all: points (N, 17, 2) and labels (N, ...), a body each."""
        points, labels = (self.points, self.labels) if person is None else (self.points[person], self.labels[person])
        return Observation(KEYPOINTS, points, points.new_ones(len(KEYPOINTS)), labels, LABELS)

    def starts(self, distance: float) -> BodyParameters:
        """The bodies with normal noise of ``distance`` [rad] on each number of a rotation, and mean sizes.

        They are off by 0.2 of that in place [half-sides of the crop] and scale, too.
        """
        generator = torch.Generator().manual_seed(_SEED)
        true = mean_sized(self.bodies)

        def noise(like: torch.Tensor, scale: float = 1.0) -> torch.Tensor:
            return (scale * distance * torch.randn(like.shape, generator=generator)).to(like)

        return replace(
            true,
            orientation=rotation_to_6d(rotation_from_axis_angle(noise(self.joints[:, 0])) @ true.global_orient()),
            rotations=true.rotations + noise(true.rotations),
            log_scale=true.log_scale + noise(true.log_scale, _SCALE_PER_RADIAN),
            shift=true.shift + noise(true.shift, _SHIFT_PER_RADIAN),
        )


def make_people(num_ellipbodies: int, num_annys: int) -> tuple[People, People]:
    """The first of PartBench's people as EllipBodies of random thickness, and as the Annys that they are.

    On the CPU, for every device the same.
    """
    persons = [make_person(index) for index in range(max(num_ellipbodies, num_annys))]
    generator = torch.Generator().manual_seed(_SEED)
    crops = [_crop(person) for person in persons]
    keypoints = [torch.from_numpy(person.keypoints()).float() for person in persons]
    points = torch.stack([crop.to_crop(each) for each, crop in zip(keypoints, crops, strict=True)])
    points = points / (TRUTH_SIZE / 2) - 1
    joints = torch.stack([torch.from_numpy(person.joints).float() for person in persons])
    bodies = _lift(persons, crops, points, joints)
    noise = KEYPOINT_NOISE * torch.randn(points.shape, generator=generator)

    own = mean_sized(bodies.select(torch.arange(num_ellipbodies)))
    own = replace(own, lengths=_spread(own.lengths, _STATURE, generator))
    own = replace(own, thicknesses=_spread(own.thicknesses, _GIRTH, generator))
    posed, some = own.posed(), slice(num_annys)
    seen = own.camera(2).project(LandmarkGather(KEYPOINTS, "cpu")(posed))[..., :2] - 1 + noise[:num_ellipbodies]
    ellipbodies = People(ELLIPBODY, own, draw_truth(own), seen, LandmarkGather(MPJPE_JOINTS, "cpu")(posed))
    parts = torch.cat([_draw_anny(*each) for each in zip(persons[some], crops[some], strict=True)])
    annys = bodies.select(torch.arange(num_annys))
    return ellipbodies, People(ANNY, annys, parts, (points + noise)[some], joints[some])


def mean_sized(bodies: BodyParameters) -> BodyParameters:
    """Mean adults in the same poses, as large in the picture as far as one scale can make them."""
    mean = BodyParameters.mean(bodies.batch_size, device=bodies.shift.device)
    taller = (bodies.lengths / mean.lengths).log().mean(1)
    return replace(bodies, lengths=mean.lengths, thicknesses=mean.thicknesses, log_scale=bodies.log_scale + taller)


def _spread(sizes: torch.Tensor, spread: float, generator: torch.Generator) -> torch.Tensor:
    return sizes * torch.exp(spread * torch.randn(sizes.shape, generator=generator))


def draw_truth(bodies: BodyParameters, size: int = TRUTH_SIZE) -> torch.Tensor:
    """Labels of exact ellipsoids, shape (B, size, size), one at a time: they are large."""
    one = (bodies.select(torch.tensor([index], device=bodies.shift.device)) for index in range(bodies.batch_size))
    return torch.cat([draw_ellipsoids(body.posed(), body.camera(size), (size, size)).labels for body in one])


def _crop(person: Person) -> Crop:
    """A square around the whole person, whatever the picture's border cut off."""
    points = person.camera.project(torch.from_numpy(person.vertices)[None])[0, :, :2]
    low, high = points.min(0).values, points.max(0).values
    half = float((high - low).max()) * (0.5 + _MARGIN)
    left, top = ((low + high) / 2 - half).tolist()
    return Crop(left, top, TRUTH_SIZE / (2 * half), (TRUTH_SIZE, TRUTH_SIZE))


def _draw_anny(person: Person, crop: Crop) -> torch.Tensor:
    return draw_anny(torch.from_numpy(person.vertices)[None], person.camera.in_crop(crop), crop.size)[0]


def _lift(persons: list[Person], crops: list[Crop], points: torch.Tensor, joints: torch.Tensor) -> BodyParameters:
    """EllipBodies with joints and keypoints as near as can be, from several orientations, the best of each person."""
    prior = packaged_prior("cpu")
    weak = [_weak_camera(person, crop) for person, crop in zip(persons, crops, strict=True)]
    scale = torch.cat([camera.scale for camera in weak]) / (TRUTH_SIZE / 2)
    shift = torch.cat([camera.translation for camera in weak]) / (TRUTH_SIZE / 2) - 1
    count, turns = len(persons), _TURNS
    mean = BodyParameters.mean(turns * count)
    yaw = 2 * math.pi / turns * torch.arange(turns).repeat_interleave(count)
    turn = rotation_from_axis_angle(torch.nn.functional.pad(yaw[:, None], (1, 1)))
    start = replace(
        mean,
        orientation=rotation_to_6d(turn @ mean.global_orient()),
        rotations=prior.mean_pose.expand_as(mean.rotations).clone(),
        log_scale=scale.log().repeat(turns),
        shift=shift.repeat(turns, 1),
    )
    observation = Observation(KEYPOINTS, points.repeat(turns, 1, 1), points.new_ones(len(KEYPOINTS)), None, None)
    energy, gather = Energy(observation, prior=prior), LandmarkGather(MPJPE_JOINTS, "cpu")
    target = _centred(joints).repeat(turns, 1, 1)

    def lifted(bodies: BodyParameters) -> dict[str, torch.Tensor]:
        off = (_centred(gather(bodies.posed())) - target).abs().sum((1, 2))
        return {**energy(bodies), "lift": _LIFT_WEIGHT * REFERENCE_SIZE / 2 * off}

    found = refine(start, lifted, iterations=_LIFT_ITERATIONS, learning_rate=_LIFT_RATE)
    best = found.energy.view(turns, count).argmin(0)
    return found.parameters.select(best * count + torch.arange(count))


def _weak_camera(person: Person, crop: Crop) -> WeakPerspective:
    """The crop's camera that sees the pelvis where the person's own does."""
    camera, pelvis = person.camera.in_crop(crop), torch.from_numpy(person.joints[MPJPE_HIPS]).float().mean(0)[None]
    if isinstance(camera, WeakPerspective):
        return WeakPerspective(camera.scale, camera.project(pelvis[:, None])[:, 0, :2])
    return camera.to_weak(pelvis)


def _centred(joints: torch.Tensor) -> torch.Tensor:
    return joints - joints[:, MPJPE_HIPS].mean(1, keepdim=True)
