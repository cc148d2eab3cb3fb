"""PartBench's people: Anny bodies in poses, seen by a camera, drawn to part labels and keypoints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
import torch

from ...body.landmarks import plain_landmark
from ...body.rotations import rotation_from_axis_angle
from ...body.skeletons import MPJPE_JOINTS, Skeleton, skeleton
from ...body.template import MEAN_STATURE
from ...cameras import Camera, Perspective, WeakPerspective
from ...interop.torch_threads import one_torch_thread
from ...models.anny import anny
from ...models.measuring import statures
from ...render.mesh import draw_mesh
from ...render.part_mesh import PartMesh
from . import people
from .garments import Worn, around_legs, draw_outfit, dress
from .population import QUANTILES, population
from .pose_recipes import POSES, TILTED_POSES, draw_pose
from .poses import mean_body

NUM_PEOPLE = 200
SEED = 20_263

# Pictures of phones and cameras: the focal length in longer sides of the picture, as most lenses have it and as others
# do; the principal point is the middle.
_LENSES, _OTHER_LENSES, _OTHERS = (0.7, 1.2), (0.65, 1.6), 0.2
_DISTANCE = (1.5, 10.0)  # [m]; small ones as often as large ones, as logarithms, if the person fits into the picture
_MOST = 0.94  # share of a side of the picture that the person takes, at most
_ASPECT = 0.75  # shorter side of the longer one
_EXTENT = 320  # [px], of the person's longer extent, unless the picture would be larger than:
_LARGEST = 1024  # [px]
_WEAK = 0.05  # share of weak-perspective cameras, as of crops of pictures from far away
# Pictures of these, and of people seen beside the axis, are cut out about the person.
SHORT_SIDE, LONG_SIDE = 320, 400  # [px]
_FILL = (0.72, 0.9)  # share of the picture's height that the person takes, or of its width
_BESIDE = {"near": (1.5, 3.0), "far": (9.0, 40.0)}  # [m], of perspective cameras that look beside people
_ASIDE = (20.0, 10.0)  # [degrees], how far these are beside the camera's axis, across and up or down, at most
_PITCH = (-10.0, 25.0)  # [degrees], how far the camera looks down
_TILT = (45.0, 20.0)  # [degrees], how far a tilted camera looks up or down, and is turned about its axis, at most
_OFFSET = 0.03  # of the picture's size: how far the person is off its middle, at most
_CUT = 0.15  # share of people of whom the border cuts off
_CUT_SHARE = (0.05, 0.2)  # of their height or width
_AGE = QUANTILES.index("age")
_PLACINGS = 4  # steps: who stands aside is seen from aside
# Of the seeds of a person's clothes and of their keypoints' format, whose draws leave all others as they are.
_CLOTHES, _FORMAT = 18, 19

COCO = skeleton("coco17")
# Formats whose joints lie elsewhere (``CONVENTIONS``), each as often as the other.
OTHER_FORMATS = tuple(map(skeleton, ("h36m17", "shelf14")))
_MARKS = tuple(dict.fromkeys(mark for form in (COCO, *OTHER_FORMATS) for mark in form.marks))
Setting = Literal["usual", "near", "far", "tilted", "clothed"]
_PRIOR_EVERY = (0, 2, 4)  # of five people, these have poses from the prior


def _rows(form: Skeleton) -> list[int]:
    """Rows of a format's keypoints among ``_MARKS``."""
    return [_MARKS.index(mark) for mark in form.marks]


@dataclass(frozen=True)
class PersonRequest:
    """Properties of a person that are asked for instead of drawn.

    Attributes:
        pose: Kind of pose, "prior" or a name that ``draw_pose`` knows. If it is None, the person's index decides.
        age: Range of the quantile of age; children of 3 to 12 years have 0 to 0.06.
        tube: True dresses the person in a skirt or a coat that hangs around both legs, and in what else is drawn.
        distance: Range of the distance of a perspective camera that looks beside the person [m].
    """

    pose: str | None = None
    age: tuple[float, float] | None = None
    tube: bool = False
    distance: tuple[float, float] | None = None


AS_DRAWN = PersonRequest()  # nothing is asked for


@dataclass(frozen=True)
class Person:
    """A person and the whole truth."""

    name: str  # such as "person 007"
    kind: str  # of pose: "prior" or a key of ``POSES``
    parts: np.ndarray  # part labels, 0 = background, shape (H, W), uint8
    marks: np.ndarray  # points of the body that keypoints of ``COCO`` and ``OTHER_FORMATS`` mark [px], shape (M, 2)
    covered: np.ndarray  # which of them are behind something, shape (M,), bool
    stature: float  # standing [m]
    height: float  # of the person standing, in the picture [px]
    joints: np.ndarray  # LSP's 14 joints, camera frame [m], shape (14, 3)
    vertices: np.ndarray  # Anny's, camera frame [m], shape (V, 3), float32
    camera: Camera  # that drew the labels, B = 1
    shape: torch.Tensor  # Anny's shape values, shape (1, 20)
    shown: tuple[np.ndarray, PartMesh]  # vertices [m] and faces that the labels show, of the body or of its clothes

    def keypoints(self, form: Skeleton = COCO) -> np.ndarray:
        """Keypoints where the data set of ``form``, COCO or one of ``OTHER_FORMATS``, marks them [px], shape (J, 2)."""
        return self.marks[_rows(form)]

    def hidden(self, form: Skeleton = COCO) -> np.ndarray:
        """True for ``keypoints`` that are behind something, shape (J,), bool."""
        return self.covered[_rows(form)]


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


def draw_shape(index: int, age: tuple[float, float] | None = None) -> tuple[torch.Tensor, np.random.Generator]:
    """A person's shape values, shape (1, 20), and the source of chance that goes on from there.

    A range of the quantile of ``age`` replaces the range from 0 to 1.
    """
    quantiles, rng = draw_quantiles(index)
    if age is not None:
        quantiles[_AGE] = age[0] + (age[1] - age[0]) * quantiles[_AGE]
    return population().shapes(torch.from_numpy(quantiles)[None].float()), rng


def _tube_outfit(rng: np.random.Generator) -> tuple[Worn, ...]:
    """Outfit with a skirt or a coat."""
    while True:
        outfit = draw_outfit(rng)
        if around_legs(outfit)[0] > 0:
            return outfit


def draw_format(index: int, others: float) -> Skeleton:
    """Format of a person's keypoints: COCO's, or with a chance of ``others`` one of ``OTHER_FORMATS``."""
    rng = np.random.default_rng([SEED, index, _FORMAT])
    return OTHER_FORMATS[rng.integers(len(OTHER_FORMATS))] if rng.random() < others else COCO


@lru_cache(maxsize=NUM_PEOPLE)
@one_torch_thread()  # or sums, and so the last bits, would depend on their number
def make_person(index: int, setting: Setting = "usual", request: PersonRequest = AS_DRAWN) -> Person:
    """Person 0 to 199; each has a seed of its own.

    "near": the same before a perspective camera that is near and looks beside, as in a crop of a wide picture; "far":
    the same before one that is far away;
    "tilted": the same bodies upright, lying, reclining and seated, before a camera that looks up, down and askew;
    "clothed": as "usual" but for the labels, which show clothes. All else is of the body beneath.

    A ``request`` replaces what would be drawn.
    """
    beside, tilted = request.distance or _BESIDE.get(setting), setting == "tilted"
    shape, rng = draw_shape(index, request.age)
    kind = request.pose or pose_kind(index, setting)
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
    if beside is not None:
        distance, aside = rng.uniform(*beside), np.radians(_ASIDE)
        offset[2] = distance - vertices[:, 2].mean()
        offset[:2] = distance * np.tan(rng.uniform(-aside, aside))
    if weak or beside is not None:
        camera, size = _cut_out(vertices + offset, weak, rng)
    else:
        offset, camera, size = _photograph(vertices, rng)
    outermost, mesh = vertices + offset, people.anny_mesh()
    shown = drawn = draw_mesh(torch.from_numpy(outermost)[None], mesh, camera, size)
    if setting == "clothed" or request.tube:
        own = np.random.default_rng([SEED, index, _CLOTHES])
        clothes, mesh = dress(body, shape, _tube_outfit(own) if request.tube else draw_outfit(own))
        outermost = clothes + offset
        shown = draw_mesh(torch.from_numpy(outermost)[None], mesh, camera, size)

    def landmarks(names: tuple[str, ...]) -> torch.Tensor:
        return model.landmarks(body, names) + torch.from_numpy(offset)

    points = landmarks(_MARKS)
    pixels = camera.project(points)[..., :2]
    cover = stature / MEAN_STATURE * torch.from_numpy(people.cover_of(tuple(map(plain_landmark, _MARKS))))
    at = people.pixel_indices(pixels, size)
    return Person(
        name=f"person {index:03d}",
        kind=kind,
        parts=shown.labels[0].numpy(),
        marks=pixels[0].numpy(),
        covered=people.behind_something(points[..., 2], at, drawn.depth, cover)[0].numpy(),
        stature=stature,
        height=stature * float(camera.intrinsics[0, 0]) / (1.0 if weak else float(offset[2])),
        joints=landmarks(MPJPE_JOINTS)[0].numpy(),
        vertices=vertices + offset,
        camera=camera,
        shape=shape,
        shown=(outermost, mesh),
    )


def _photograph(vertices: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, Camera, tuple[int, int]]:
    """Move [m], (3,), that takes a person (V, 3) before a phone's or a camera's lens, and its picture's size (H, W)."""
    lens = rng.uniform(*(_OTHER_LENSES if rng.random() < _OTHERS else _LENSES))
    sides = np.array([_ASPECT, 1.0] if rng.random() < 0.5 else [1.0, _ASPECT])  # (W, H), of the longer side
    middle, extent = (vertices.min(0) + vertices.max(0)) / 2, np.ptp(vertices, axis=0)
    nearest = (lens * extent[:2] / (_MOST * sides)).max() + extent[2] / 2
    distance = max(float(np.exp(rng.uniform(*np.log(_DISTANCE)))), nearest)
    longer = min(_EXTENT * distance / (lens * extent[:2].max()), _LARGEST)
    size = np.rint(longer * sides)  # (W, H)
    focal = lens * size.max()
    share = rng.random((2, 2)).mean(0)  # of the free room, on the person's left and above; the middle more often
    cut, axis, far, beyond = rng.random() < _CUT, *_draw_cut(rng)
    offset = np.append(-middle[:2], distance - middle[2])
    for _ in range(_PLACINGS):
        low, high = _outline(vertices + offset, focal, size)
        start = share * (size - (high - low))
        if cut:
            start[axis] = size[axis] - (1 - beyond) * (high - low)[axis] if far else -beyond * (high - low)[axis]
        offset[:2] += (start - low) * distance / focal
    offset = offset.astype(np.float32)
    centre = torch.from_numpy(size / 2).float()[None]
    return offset, Perspective(torch.full((1, 2), focal), centre), (int(size[1]), int(size[0]))


def _outline(vertices: np.ndarray, focal: float, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest coordinates [px] of vertices (V, 3) in a picture of size (W, H), (2,) each."""
    pixels = focal * vertices[:, :2] / vertices[:, 2:] + size / 2
    return pixels.min(0), pixels.max(0)


def _draw_cut(rng: np.random.Generator) -> tuple[int, bool, float]:
    """Axis of the border that cuts a person, whether it is the far one, and the share beyond it."""
    # The bottom or the right side more often than the others.
    return int(rng.integers(2)), bool(rng.random() < 0.7), float(rng.uniform(*_CUT_SHARE))


def _cut_out(vertices: np.ndarray, weak: bool, rng: np.random.Generator) -> tuple[Camera, tuple[int, int]]:
    """A picture about the person, or all but what its border cuts off: its camera and size (H, W)."""
    flat = vertices[:, :2] if weak else vertices[:, :2] / vertices[:, 2:]
    low, high = flat.min(0), flat.max(0)
    extent = high - low
    size = np.array([SHORT_SIDE, LONG_SIDE] if extent[1] >= extent[0] else [LONG_SIDE, SHORT_SIDE])  # (W, H)
    scale = (size * rng.uniform(*_FILL) / extent).min()
    centre = size * (0.5 + rng.uniform(-_OFFSET, _OFFSET, 2)) - scale * (low + high) / 2
    if rng.random() < _CUT:
        axis, far, share = _draw_cut(rng)
        beyond = share * extent[axis] * scale
        edge = scale * (high if far else low)[axis] + centre[axis]
        centre[axis] += size[axis] + beyond - edge if far else -beyond - edge
    zoom, shift = (torch.tensor(values, dtype=torch.float32)[None] for values in (float(scale), centre))
    camera = WeakPerspective(zoom, shift) if weak else Perspective(zoom[:, None].expand(-1, 2), shift)
    return camera, (int(size[1]), int(size[0]))
