"""Sizes of people whom one camera sees in many frames.

A body that grows as it goes away from a single camera looks as before, so the network's size of a frame is a guess from
proportions, the nearer to the mean person the less it sees. What frames see errs otherwise in each, so the mean of many
is known better than any of them, but lies as near to the mean person: it is stretched away from there as far as sizes
of known people ask for. Depths of all frames are then those of one size.
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

# Of 600 people of PartBench's kind, whom no level has, in motion that networks learn from (scripts/learn_sizes.py): the
# true logarithm changes by 1 / (a + b / n) where the mean of n looks changes by 1, about this sum of lengths [m].
_SHRUNK, _NOISE, _MIDDLE = 0.771, 0.319, 2.60
_APART = 4 / 30  # [s], from one look to the next
_ROUNDED = 1e-6  # of it, by which times are rounded


def of_one_size(
    model: DetailedModel, scene: Scene, looks: Sequence[ObservedBody], stature: float | None = None
) -> list[ObservedBody]:
    """Sights in which everybody has one size: the known one, or the most probable where one camera sees many frames.

    Args:
        model: Of the known shapes.
        scene: The scene.
        looks: Of ``look_at``.
        stature: The one person's, where it is known [m].
    """
    if scene.shapes:
        stature = None
    if stature is None and (scene.num_frames == 1 or len(scene.views) > 1):
        return list(looks)
    return alike_sizes(scene, looks, stature, model)


def alike_sizes(
    scene: Scene, looks: Sequence[ObservedBody], stature: float | None = None, model: DetailedModel | None = None
) -> list[ObservedBody]:
    """Sights in which everybody has one size, whatever sees them; known shapes count if there is their model."""
    if stature is not None:
        return [grown(look, stature / float(bone_statures(look.body.lengths))) for look in looks]
    targets = {person: _target(model, scene, person, looks) for person in range(scene.num_people)}
    return [grown(look, math.exp(targets[look.sight.person] - _size(look))) for look in looks]


def stretch(count: int) -> float:
    """Factor by which the mean of so many looks lies nearer to the mean person than the truth, 1 or more."""
    return max(1.0, 1 / (_SHRUNK + _NOISE / count))


def _target(model: DetailedModel | None, scene: Scene, person: int, looks: Sequence[ObservedBody]) -> float:
    """Logarithm of the size that a person's sights are to have."""
    own = [look for look in looks if look.sight.person == person]
    mean = sum(map(_size, own)) / len(own)
    if model is not None and (known := scene.shapes.get(person)) is not None:
        alike = torch.cat([grown(look, math.exp(mean - _size(look))).body.lengths for look in own])
        body = replace(own[0].body, lengths=alike.mean(0, keepdim=True))
        seen = shape_from_lengths(model, body.posed())
        return mean + math.log(float(statures(model, known.values.to(seen)[None]) / statures(model, seen)))
    at = scene.frame_times
    times = {math.floor(at[look.sight.frame] / _APART + _ROUNDED) for look in own}
    return mean + (stretch(len(times)) - 1) * (mean - math.log(_MIDDLE))


def _size(look: ObservedBody) -> float:
    """Logarithm of the sum of a body's lengths [m]."""
    return math.log(float(look.body.lengths.sum()))
