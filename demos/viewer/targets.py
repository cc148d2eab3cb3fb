"""Bodies to start from and targets to reach: presets, random people, and a user's own photo."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import torch

from ..body.labels import BACKGROUND, IGNORE, LabelSet, label_set
from ..body.parameters import BodyParameters
from ..body.posing import LandmarkGather, Posed
from ..body.rotations import rotation_from_axis_angle, rotation_to_6d
from ..body.skeletons import skeleton
from ..errors import InputError
from ..inputs.observation import LABEL_SIZE, Observation, observe, resize_nearest
from ..inputs.person import PersonInputs
from ..lab.synthetic.pose_recipes import draw_pose
from ..networks.regression.checkpoint import packaged_network
from ..networks.regression.predict import predict_bodies
from ..render.ellipsoids import draw_ellipsoids
from ..results.body_file import load_body
from ..results.palette import IGNORE_COLOUR, group_colours
from ..solve.ellipsoids.stepper import SIZES

# Preset: the kind of PartBench pose (None: at rest), the seed that draws it, how far the person turns [degrees].
_PRESETS: dict[str, tuple[str | None, int, float]] = {
    "t-pose": (None, 0, 0.0),
    "walking": ("walking away", 2, 40.0),
    "crossed arms": ("crossed arms", 4, 10.0),
    "sitting": ("sitting", 4, 40.0),
}
PRESETS = tuple(_PRESETS)
RANDOM = "random"
NETWORK = "network"  # a start: what the label network says of the target
_SPREAD = {"lengths": 0.06, "thicknesses": 0.12}  # standard deviation of a random body's sizes, of the mean adult's
_WIDEST_TURN = 60.0  # [degrees] of a random body
_FORMAT = "coco17"  # keypoints of a target that is a body

BACKGROUND_COLOUR = 250
_RIGHT_COLOUR = 226
_UNKNOWN_COLOUR = 238  # of a pixel


@dataclass(frozen=True, eq=False)
class Photo:
    """Photo of the person, at its own resolution, and its place in the crop's coordinates, which are -1 to 1, y down.

    Attributes:
        pixels: The whole photo, RGB, shape (H, W, 3), uint8.
        low: Position (x, y) of its upper left corner, shape (2,).
        high: Position (x, y) of its lower right corner, shape (2,).
    """

    pixels: np.ndarray
    low: np.ndarray
    high: np.ndarray


@dataclass(frozen=True, eq=False)
class Target:
    """Target of the refinement; pictures of it are kept while it is in use."""

    observation: Observation  # no labels where the user has none
    truth: BodyParameters | None = None  # the body it was drawn from
    photo: Photo | None = None  # the user's

    @property
    def label_set(self) -> LabelSet:
        """Label set of pictures: the labels' own, or the 20 parts."""
        return self.observation.label_set or label_set("ellipbody20")

    @cached_property
    def posed(self) -> Posed | None:
        """The true body, posed in the camera frame [m]; None of a photo."""
        return None if self.truth is None else self.truth.posed()


def body_of(name: str, seed: int = 0) -> BodyParameters:
    """A body by name: one of ``PRESETS``, or "random", which the seed draws; else an InputError."""
    if name != RANDOM and name not in _PRESETS:
        raise InputError(f"body: {name!r}; expected one of {', '.join((*PRESETS, RANDOM))}")
    body = BodyParameters.mean(1)
    if name == RANDOM:
        rng = np.random.default_rng(seed)
        rotations = draw_pose("prior", rng).rotations
        turn = rng.uniform(-_WIDEST_TURN, _WIDEST_TURN)
        for field, spread in _SPREAD.items():
            usual = body.tensors()[field]
            share = torch.from_numpy(rng.normal(1.0, spread, usual.shape)).float()
            body = replace(body, **{field: usual * share.clamp(*SIZES[field])})
    else:
        kind, drawn, turn = _PRESETS[name]
        rotations = np.zeros((20, 3)) if kind is None else draw_pose(kind, np.random.default_rng(drawn)).rotations
    yaw = rotation_from_axis_angle(torch.tensor([0.0, math.radians(turn), 0.0]))
    orientation = rotation_to_6d(body.global_orient() @ yaw)
    return replace(body, orientation=orientation, rotations=torch.from_numpy(rotations)[None].float())


def network_body(target: Target) -> BodyParameters:
    """Body of the packaged label network for a target: where ``partdr fit`` starts."""
    return predict_bodies([target.observation], packaged_network("cpu"))


def read_body(path: str | Path) -> BodyParameters:
    """The body of a ``body.npz``; the longer side of its picture becomes the side of the crop."""
    return load_body(path).parameters()


def body_target(body: BodyParameters) -> Target:
    """Target made of a body: its keypoints and the labels of its 20 parts."""
    names = skeleton(_FORMAT).landmarks
    with torch.no_grad():
        posed = body.posed()
        points = body.camera(2).project(LandmarkGather(names, "cpu")(posed))[0, :, :2] - 1
        labels = draw_ellipsoids(posed, body.camera(LABEL_SIZE), (LABEL_SIZE, LABEL_SIZE)).labels[0]
    observation = Observation(names, points, torch.ones(len(names)), labels, label_set("ellipbody20"))
    return Target(observation, truth=body)


def person_target(person: PersonInputs) -> Target:
    """A user's person; without part labels, only keypoints can be followed."""
    observation, crop = observe(person.keypoints, person.parts, others=person.others)
    shown = None
    if person.photo is not None:
        corners = np.array([(0, 0), person.photo.shape[1::-1]]) - (crop.left, crop.top)
        low, high = corners * crop.zoom * 2 / crop.size[1] - 1
        shown = Photo(person.photo, low, high)
    return Target(replace(observation, maps=None, known=None), photo=shown)


@lru_cache(maxsize=8)
def target_labels(target: Target, size: int) -> np.ndarray | None:
    """Group ids, 255 = ignore, shape (size, size), uint8; None of a target without labels."""
    labels = target.observation.labels
    return None if labels is None else resize_nearest(labels, size).numpy()


@lru_cache(maxsize=8)
def target_picture(target: Target, size: int) -> np.ndarray:
    """Picture of a target's labels in their colours, RGB, shape (size, size, 3), uint8; blank without labels."""
    if (labels := target_labels(target, size)) is None:
        return np.full((size, size, 3), BACKGROUND_COLOUR, dtype=np.uint8)
    return group_picture(target, labels)


def group_picture(target: Target, groups: np.ndarray) -> np.ndarray:
    """Group ids (N, N) in the target's colours, RGB, shape (N, N, 3), uint8."""
    return _colours(target)[0].take(groups, axis=0)


def difference_picture(target: Target, drawn: np.ndarray) -> np.ndarray:
    """Drawn group ids (N, N) against the target, RGB, shape (N, N, 3), uint8; blank without labels.

    A wrong pixel has the colour that it should have; what should be background is dark.
    """
    if (labels := target_labels(target, len(drawn))) is None:
        return target_picture(target, len(drawn))
    wrong = (drawn != labels) & (labels != IGNORE)
    return _colours(target)[1].take(labels + np.uint16(256) * wrong, axis=0)


@lru_cache(maxsize=8)
def _colours(target: Target) -> tuple[np.ndarray, np.ndarray]:
    """RGB of group ids, shape (256, 3); of those that are drawn right, then of those drawn wrong, (512, 3); uint8."""
    shown = group_colours(target.label_set.part_groups)
    shown[BACKGROUND], shown[IGNORE] = BACKGROUND_COLOUR, _UNKNOWN_COLOUR
    wrong, right = shown.copy(), np.full_like(shown, _RIGHT_COLOUR)
    right[[BACKGROUND, IGNORE]], wrong[BACKGROUND] = BACKGROUND_COLOUR, IGNORE_COLOUR
    return shown, np.concatenate([right, wrong])
