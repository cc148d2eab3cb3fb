"""Sizes of people whom one camera observes in many frames.

A body that grows while it moves away from a single camera keeps its picture. So the network guesses the size in a frame
from proportions. The less it sees, the nearer its guess is to the mean person. The other errors differ from frame to
frame. So the mean over many frames is more exact than any one of them, but it is still too near to the mean person. It
is stretched away from there, by a factor that was measured on people whose sizes are known. The depths in all frames
then follow from the one size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch

from ...body.stature import bone_statures
from ...inputs.scene import Scene
from ...models.measuring import statures
from ...models.model import DetailedModel
from ...models.registration import shape_from_lengths
from ..mesh.observed_body import ObservedBody
from .depth_order import grown

# Measured on 600 people of PartBench's kind who are in none of its levels, in motions that networks learn from
# (scripts/learn_sizes.py). If the mean logarithm of n observations changes by 1, the true logarithm changes by
# 1 / (_SHRUNK + _NOISE / n). Both are relative to the mean person.
_SHRUNK = 0.771
_NOISE = 0.319
_MIDDLE = 2.60  # [m], sum of the lengths of the mean person
_APART = 4 / 30  # [s] between two observations that count as two
_ROUNDED = 1e-6  # share of _APART by which times may be rounded


def with_one_size(
    model: DetailedModel, scene: Scene, observed_bodies: Sequence[ObservedBody], stature: float | None = None
) -> list[ObservedBody]:
    """Resizes bodies so that each person has one size, if the scene does not tell the size by itself.

    The size is the known one, or the most probable one if one camera observes several frames. Bodies are unchanged if
    no size is known and there are several cameras or only one frame.

    Args:
        model: Detailed model of the known shapes.
        scene: The scene.
        observed_bodies: Bodies that ``observe_scene`` returns.
        stature: Height of the only person, standing, if it is known [m].
    """
    if scene.shapes:
        stature = None
    if stature is None and (scene.num_frames == 1 or len(scene.views) > 1):
        return list(observed_bodies)
    return with_common_size(scene, observed_bodies, stature, model)


def with_common_size(
    scene: Scene,
    observed_bodies: Sequence[ObservedBody],
    stature: float | None = None,
    model: DetailedModel | None = None,
) -> list[ObservedBody]:
    """Resizes bodies so that each person has one size in all frames and views.

    Args:
        scene: The scene.
        observed_bodies: Bodies that ``observe_scene`` returns.
        stature: Height of the only person, standing, if it is known [m].
        model: Detailed model of the known shapes. Without it, known shapes are not used.
    """
    if stature is not None:
        return [grown(observed, stature / float(bone_statures(observed.body.lengths))) for observed in observed_bodies]
    targets = {person: _target(model, scene, person, observed_bodies) for person in range(scene.num_people)}
    return [grown(observed, math.exp(targets[observed.person] - _size(observed))) for observed in observed_bodies]


def stretch(count: int) -> float:
    """Factor by which the mean of ``count`` observations is nearer to the mean person than the truth, 1 or more."""
    return max(1.0, 1 / (_SHRUNK + _NOISE / count))


def _target(model: DetailedModel | None, scene: Scene, person: int, observed_bodies: Sequence[ObservedBody]) -> float:
    """Logarithm of the size that all bodies of a person get."""
    own = [observed for observed in observed_bodies if observed.person == person]
    mean = sum(map(_size, own)) / len(own)
    if model is not None and (known := scene.shapes.get(person)) is not None:
        lengths = torch.cat([grown(observed, math.exp(mean - _size(observed))).body.lengths for observed in own])
        body = replace(own[0].body, lengths=lengths.mean(0, keepdim=True))
        observed_shape = shape_from_lengths(model, body.posed())
        known_values = known.values.to(observed_shape)[None]
        return mean + math.log(float(statures(model, known_values) / statures(model, observed_shape)))
    frame_times = scene.frame_times
    times = {math.floor(frame_times[observed.frame] / _APART + _ROUNDED) for observed in own}
    return mean + (stretch(len(times)) - 1) * (mean - math.log(_MIDDLE))


def _size(observed: ObservedBody) -> float:
    """Logarithm of the sum of a body's lengths [m]."""
    return math.log(float(observed.body.lengths.sum()))
