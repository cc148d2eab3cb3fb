"""Depth flips: limbs mirrored in depth, which keypoints do not tell apart, proposed where parts overlap.

A bone of fixed length can't swing through its full length while its keypoints hold it, so a refinement keeps the depth
order that it begins with; a flip jumps. What hides what is all that labels say about it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from ..body.lens import ray_rotations
from ..body.parameters import BodyParameters
from ..body.pose_prior import PosePrior
from ..body.posing import Posed
from ..body.rotations import rotation_between, rotation_to_axis_angle
from ..body.template import BONE_STARTS, PARENTS, PART_NAMES
from ..inputs.observation import Observation
from ..refinement.energy import Energy, Weights
from ..refinement.refine import refine
from ..render.renderers import RendererEllipsoids

# Bones of a limb: each may be mirrored, and what follows the last one turns with it.
_LIMBS = {
    f"{side} {limb}": tuple(PART_NAMES.index(f"{side}_{part}") for part in parts)
    for limb, parts in (("arm", ("upper_arm", "forearm", "hand")), ("leg", ("upper_leg", "lower_leg", "foot")))
    for side in ("left", "right")
}
_BESIDE = 2.0  # square of the ratio to an outline within which a bone counts as over it
_FLAT = 0.17  # sine of the angle to the picture's plane below which a bone's mirror image is itself
_OVER_LIMITS = 0.1  # [rad^2], by which a flip may exceed joint limits more than the body does
_PLACES = torch.linspace(-1.0, 1.0, 9)  # on a bone, of its half length
# Labels lead while flips are compared, or keypoints would hold what they can't see.
_SIZE, _ITERATIONS, _RATE = 96, 30, 0.02
FLIP_WEIGHTS = Weights(seg=0.5, proj=0.05, prior=0.1)
# Share of its energy that a body must lose by a flip. With labels that are EllipBody's own, right flips save 6 % to
# 70 %; on people with clothes of another shape and noisy labels, 0 of 300 save so much (2026-11-23).
_MARGIN = 0.06
_WORTH_REFINING = 0.05  # share of the labels' loss that it must save as it is


@dataclass(frozen=True)
class DepthOrder:
    """Flips of a fit's start."""

    tried: tuple[str, ...]  # such as "left arm: forearm"
    flipped: str | None  # the one that was accepted


def repair_depth_order(body: BodyParameters, seen: Observation, prior: PosePrior) -> tuple[BodyParameters, DepthOrder]:
    """The body, or the flip of it that labels prefer by far; a flip is refined a little, as it was compared."""
    every, names = flip_depths(body, prior, seen.lens)
    if not names:
        return body, DepthOrder((), None)
    energy = Energy(seen, _SIZE, FLIP_WEIGHTS, prior, renderer=RendererEllipsoids("edges"))
    with torch.no_grad():
        losses = energy.segmentation(every, every.posed())
    worth = losses <= losses[0] * (1 - _WORTH_REFINING)
    if not worth.any():
        return body, DepthOrder(tuple(names), None)
    worth[0] = True
    some = worth.nonzero()[:, 0]
    refined = refine(every.select(some), energy, iterations=_ITERATIONS, learning_rate=_RATE)
    best = int(refined.energy.argmin())
    if refined.energy[best] > (1 - _MARGIN) * refined.energy[0]:
        return body, DepthOrder(tuple(names), None)
    order = DepthOrder(tuple(names), names[int(some[best]) - 1])
    return refined.parameters.select(torch.tensor([best], device=some.device)), order


def flip_depths(
    body: BodyParameters, prior: PosePrior, lens: torch.Tensor | None = None
) -> tuple[BodyParameters, list[str]]:
    """The body itself and its flips: limbs that overlap other parts in the picture, bones mirrored in depth.

    Args:
        body: One body, B = 1.
        prior: Its joint limits leave flips out.
        lens: Of the camera, where it is known.

    Returns:
        1 + F bodies, the body first, and the flips' names, such as "left arm: forearm".
    """
    posed = body.posed()
    view = torch.tensor([0.0, 0.0, 1.0], device=posed.joints.device)
    if lens is not None:
        view = (ray_rotations(body, lens) @ view)[0]
    found, names = [body.rotations], ["itself"]
    crossing = _crossing(posed, view)
    for limb, parts in _LIMBS.items():
        if not crossing[list(parts)].any():
            continue
        for upper, lower in ((True, False), (False, True), (True, True)):
            turned = _mirrored(posed, parts, (upper, lower), view)
            if turned is not None:
                found.append(torch.where(_is_one_of(parts, turned), turned, body.rotations))
                bones = [
                    PART_NAMES[part].split("_", 1)[1]
                    for part, flipped in zip(parts[:2], (upper, lower), strict=True)
                    if flipped
                ]
                names.append(f"{limb}: {' and '.join(bones)}")
    rotations = torch.cat(found)
    excess = prior.joint_limits(rotations)
    kept = excess <= excess[0] + _OVER_LIMITS
    kept[0] = True
    every = body.select(torch.zeros(int(kept.sum()), dtype=torch.int64, device=kept.device))
    names = [name for name, good in zip(names, kept.tolist(), strict=True) if good]
    return replace(every, rotations=rotations[kept]), names[1:]


def _is_one_of(parts: tuple[int, ...], like: torch.Tensor) -> torch.Tensor:
    chosen = torch.zeros(len(PART_NAMES), 1, dtype=torch.bool, device=like.device)
    chosen[list(parts)] = True
    return chosen


def _mirrored(
    posed: Posed, parts: tuple[int, ...], flipped: tuple[bool, bool], view: torch.Tensor
) -> torch.Tensor | None:
    """Local rotations with bones of a limb mirrored, shape (1, 20, 3); None if one hardly changes."""
    world = torch.cat([posed.rotations[:, :1], posed.rotations], dim=1).clone()  # of the pelvis, whose hips don't turn
    turn = torch.eye(3, device=world.device)
    for part, flip in zip(parts[:2], flipped, strict=True):
        bone = posed.joints[0, part + 1] - posed.joints[0, BONE_STARTS[part]]
        bone = bone / bone.norm()
        slope = bone @ view
        if flip and slope.abs() < _FLAT:
            return None
        turn = rotation_between(bone, bone - 2 * slope * view) if flip else torch.eye(3, device=world.device)
        world[:, part + 1] = turn @ world[:, part + 1]
    world[:, parts[2] + 1] = turn @ world[:, parts[2] + 1]
    return rotation_to_axis_angle(world[:, BONE_STARTS].mT @ world[:, 1:])


def _crossing(posed: Posed, view: torch.Tensor) -> torch.Tensor:
    """Parts with a bone that lies, in the picture, over a part that they don't hang on, shape (20,), bool."""
    across = rotation_between(view, view.new_tensor([0.0, 0.0, 1.0]))[:2]  # the picture's plane, square to the view
    axes = across @ posed.axes[0]  # (20, 2, 3)
    outlines = (axes * posed.semi_axes[0, :, None].square()) @ axes.mT  # ellipses x^T outlines^-1 x = 1
    bones = posed.semi_axes[0, :, :1] * axes[..., 0]
    places = posed.centres[0] @ across.T
    points = places[:, None] + _PLACES.to(bones)[:, None] * bones[:, None]  # (20, places, 2)
    offsets = points[:, :, None] - places  # (20, places, 20, 2)
    inside = (offsets[..., None, :] @ torch.linalg.inv(outlines) @ offsets[..., None])[..., 0, 0] < _BESIDE
    return (inside.any(1) & _apart(inside.device)).any(1)


@lru_cache(maxsize=8)
def _apart(device: torch.device) -> torch.Tensor:
    """Pairs of parts of which none hangs on the other, nor both on the same, shape (20, 20), bool."""
    parts, parents = np.arange(len(PART_NAMES)), np.array(PARENTS)
    hangs = parents[:, None] == parts
    close = hangs | hangs.T | (parents[:, None] == parents) | (parts[:, None] == parts)
    return torch.from_numpy(~close).to(device)
