"""Bodies to start from and targets to reach: presets, random people, and a user's own photo."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from ..body.labels import BACKGROUND, IGNORE, LabelSet, label_set
from ..body.parameters import BodyParameters
from ..body.posing import LandmarkGather, Posed
from ..body.rotations import rotation_from_axis_angle, rotation_to_6d, rotation_to_axis_angle
from ..body.skeletons import skeleton
from ..errors import InputError
from ..inputs.observation import LABEL_SIZE, Observation, observe, resize_nearest
from ..inputs.person import PersonInputs
from ..network.checkpoint import packaged_network
from ..network.predict import predict_bodies
from ..refinement.stepper import SIZES
from ..render.ellipsoids import draw_ellipsoids
from ..results.body_file import load_body
from ..results.palette import IGNORE_COLOUR, group_colours
from ..synthetic.pose_recipes import draw_pose
from .style import PAPER

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


@dataclass(frozen=True)
class Target:
    """Target of the refinement.

    Attributes:
        observation: Keypoints and labels in the crop; no labels where the user has none.
        truth: The body it was drawn from; None of a photo.
        photo: The crop of the user's photo, RGB, shape (N, N, 3), uint8; None without.
    """

    observation: Observation
    truth: BodyParameters | None = None
    photo: np.ndarray | None = None

    @property
    def label_set(self) -> LabelSet:
        """Label set of pictures: the labels' own, or the 20 parts."""
        return self.observation.label_set or label_set("ellipbody20")

    @cached_property
    def posed(self) -> Posed | None:
        """The true body, posed in the camera frame [m]; None of a photo."""
        return None if self.truth is None else self.truth.posed()


def body_of(name: str, seed: int = 0) -> BodyParameters:
    """A body by name.

    Args:
        name: One of ``PRESETS``, or "random".
        seed: Of a random one.

    Raises:
        InputError: If there is no such body.
    """
    if name != RANDOM and name not in _PRESETS:
        raise InputError(f"body: {name!r}; expected one of {', '.join((*PRESETS, RANDOM))}")
    body = BodyParameters.mean(1)
    if name == RANDOM:
        rng = np.random.default_rng(seed)
        rotations = draw_pose("prior", rng).rotations
        turn = rng.uniform(-_WIDEST_TURN, _WIDEST_TURN)
        sizes = {}
        for field, spread in _SPREAD.items():
            usual = body.tensors()[field]
            share = torch.from_numpy(rng.normal(1.0, spread, usual.shape)).float()
            sizes[field] = usual * share.clamp(*SIZES[field])
        body = replace(body, **sizes)
    else:
        kind, drawn, turn = _PRESETS[name]
        rotations = np.zeros((20, 3)) if kind is None else draw_pose(kind, np.random.default_rng(drawn)).rotations
    yaw = rotation_from_axis_angle(torch.tensor([0.0, math.radians(turn), 0.0]))
    return replace(
        body,
        orientation=rotation_to_6d(body.global_orient() @ yaw),
        rotations=torch.from_numpy(rotations)[None].float(),
    )


def network_body(target: Target) -> BodyParameters:
    """Body of the packaged label network for a target: where ``partdr fit`` starts."""
    return predict_bodies([target.observation], packaged_network("cpu"))


def read_body(path: str | Path) -> BodyParameters:
    """The body of a ``body.npz``; the longer side of its picture becomes the side of the crop.

    Raises:
        InputError: If the file can't be read.
    """
    stored = load_body(path)
    height, width = stored.image_size.tolist()
    half = max(height, width) / 2
    shift = (stored.camera_translation - np.array([width / 2, height / 2])) / half
    return BodyParameters(
        orientation=rotation_to_6d(torch.from_numpy(stored.global_orient))[None],
        rotations=rotation_to_axis_angle(torch.from_numpy(stored.rotations))[None],
        lengths=torch.from_numpy(stored.lengths)[None],
        thicknesses=torch.from_numpy(stored.thicknesses)[None],
        log_scale=torch.tensor([math.log(float(stored.camera_scale) / half)]),
        shift=torch.from_numpy(shift).float()[None],
    )


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
    """A user's person; without part labels, only keypoints can be followed.

    Raises:
        InputError: If keypoints and labels don't fit each other.
    """
    observation, crop = observe(person.keypoints, person.parts, others=person.others)
    shown = None
    if person.photo is not None:
        from PIL import Image

        height, width = crop.size
        box = (crop.left, crop.top, crop.left + width / crop.zoom, crop.top + height / crop.zoom)
        cut = Image.fromarray(person.photo).transform(
            (width, height), Image.Transform.EXTENT, box, Image.Resampling.BILINEAR, fillcolor=PAPER
        )
        shown = np.asarray(cut)
    return Target(replace(observation, maps=None, known=None), photo=shown)


@dataclass(frozen=True)
class TargetPicture:
    """Target picture for a drawn one to be compared with, N pixels a side.

    Attributes:
        labels: Group ids, 255 = ignore, shape (N, N), uint8.
        picture: Their colours, RGB, shape (N, N, 3), uint8.
        right: What the difference is where all is right, the same.
        wrong: What it is where something is wrong, the same.
    """

    labels: np.ndarray
    picture: np.ndarray
    right: np.ndarray
    wrong: np.ndarray

    def difference(self, drawn: np.ndarray) -> np.ndarray:
        """A wrong pixel has the colour that it should have; what should be background is dark."""
        different = (drawn != self.labels) & (self.labels != IGNORE)
        return np.where(different[..., None], self.wrong, self.right)


def target_picture(target: Target, size: int) -> TargetPicture | None:
    """At ``size`` pixels a side; None of a target without labels."""
    if target.observation.labels is None:
        return None
    labels = resize_nearest(target.observation.labels, size).numpy()
    picture = picture_colours(target)[labels]
    person = (labels != BACKGROUND) & (labels != IGNORE)
    right = np.full_like(picture, BACKGROUND_COLOUR)
    right[person] = _RIGHT_COLOUR
    wrong = np.where(labels[..., None] == BACKGROUND, IGNORE_COLOUR, picture)
    return TargetPicture(labels, picture, right, wrong)


def picture_colours(target: Target) -> np.ndarray:
    """RGB of each group id of a target, shape (256, 3), uint8."""
    colours = group_colours(target.label_set.part_groups)
    colours[BACKGROUND], colours[IGNORE] = BACKGROUND_COLOUR, _UNKNOWN_COLOUR
    return colours
