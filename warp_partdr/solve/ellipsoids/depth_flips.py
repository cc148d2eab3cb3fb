"""Depth flips: limbs mirrored in depth, which keypoints do not tell apart, proposed where parts overlap.

A bone of fixed length can't swing through its full length while its keypoints hold it, so a refinement keeps the depth
order that it begins with; a flip jumps. What hides what is all that labels say about it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch

from ...body.labels import BACKGROUND, IGNORE, LabelSet
from ...body.landmarks import mirror_order
from ...body.lens import ray_rotations
from ...body.parameters import BodyParameters
from ...body.pose_prior import PosePrior, up_direction
from ...body.posing import Posed
from ...body.rotations import rotation_between, rotation_from_axis_angle, rotation_to_axis_angle
from ...body.stature import bone_statures
from ...body.template import BONE_STARTS, JOINT_NAMES, PARENTS, PART_NAMES
from ...inputs.observations import Observations
from ...networks.regression.uncertainty import Uncertainty
from ...render.renderers import RendererEllipsoids
from .batch import Batch
from .energy import SEG, Energy, Weights
from .refine import refine_unchecked
from .stepper import Descent
from .tables import LANDMARK_NAMES

# Bones of a limb: each may be mirrored, and what follows the last one turns with it.
_LIMBS = {
    f"{side} {limb}": tuple(PART_NAMES.index(f"{side}_{part}") for part in parts)
    for limb, parts in (("arm", ("upper_arm", "forearm", "hand")), ("leg", ("upper_leg", "lower_leg", "foot")))
    for side in ("left", "right")
}
_BESIDE = 2.0  # square of the ratio to an outline within which a bone counts as over it
# Places about a joint at which a limb that is seen has labels, the joint first: in a circle of half an arm's thickness.
_NEAR = 0.03  # of the stature
_CIRCLE = [(math.cos(angle * math.pi / 6), math.sin(angle * math.pi / 6)) for angle in range(12)]
_DISC = _NEAR * torch.tensor([(0.0, 0.0), *((share * x, share * y) for share in (0.5, 1.0) for x, y in _CIRCLE)])
_TWISTS = torch.arange(16) * (2 * math.pi / 16)  # [rad] of a limb's upper bone, from which a flip chooses
_LIMITS = 20.0  # [nat/rad^2], by which joint limits count beside the prior while it does
_FLAT = 0.17  # sine of the angle to the picture's plane below which a bone's mirror image is itself
_OVER_LIMITS = 0.1  # [rad^2], by which a flip may exceed joint limits more than the body does
# Spreads that the network stated by which a flip may move a joint along the view. Of 1,059 flips of its bodies (of
# PartBench's people 300 to 399 at four levels) 18 % of those nearer were nearer to the truth, and 2 % of others, of
# which noisy labels preferred some by far.
_BELIEVED = 5.0
_PLACES = torch.linspace(-1.0, 1.0, 9)  # on a bone, of its half length
# Labels lead while flips are compared, or keypoints would hold what they can't see.
FLIP_SIZE = 128  # [px], side of the crop in which flips are compared
_ITERATIONS, _RATE = 30, 0.02
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
    hidden: tuple[str, ...] = ()  # limbs of which labels show nothing where their joints are, such as "left arm"


def repair_depth_orders(
    bodies: BodyParameters, observations: Observations, prior: PosePrior, *, uncertainty: Uncertainty | None = None
) -> tuple[BodyParameters, list[DepthOrder]]:
    """Return the body of each person, or the flip of it that labels prefer by far.

    A flip is refined a little, as it was compared. A limb of which labels show nothing where its joints are is hidden:
    of its flips, the best for the labels alone is taken, and what the network said of depths rules out none. Of 72
    people with arms behind their backs this changed 5, whose errors fell by 21 mm on average, and none of 180 others
    (PartBench, realistic and hard; 2026-11-28).

    Args:
        bodies: N bodies, one of each person.
        observations: N people with labels.
        prior: Prior of poses.
        uncertainty: Uncertainty of the network about its bodies, which leaves out flips that it does not believe.
    """
    count = bodies.batch_size
    if count == 0:
        return bodies, []
    energy = Energy(observations, FLIP_SIZE, FLIP_WEIGHTS, prior, renderer=RendererEllipsoids("edges"))
    hidden = _hidden_limbs(bodies, Batch.of(energy), observations.label_set)
    lenses = observations.lens
    flips, owners, names = _propose(bodies, prior, lenses, uncertainty, hidden)
    tried: list[list[str]] = [[] for _ in range(count)]
    for name, owner in zip(names, owners.tolist(), strict=True):
        tried[owner].append(name)
    limbs = [tuple(limb for limb, there in zip(_LIMBS, row, strict=True) if there) for row in hidden.tolist()]
    orders = [DepthOrder(tuple(each), None, some) for each, some in zip(tried, limbs, strict=True)]
    if not names:
        return bodies, orders
    # Each one's own body comes before its flips.
    asked = owners.unique()
    both, people = BodyParameters.joined([bodies.select(asked), flips]), torch.cat([asked, owners])
    of_bodies = energy.select(people)
    losses = refine_unchecked(both, of_bodies, Descent(iterations=0)).terms[SEG.name]
    own = losses.new_zeros(count).index_copy(0, asked, losses[: len(asked)])
    worth = (losses <= own[people] * (1 - _WORTH_REFINING))[len(asked) :]
    if not worth.any():
        return bodies, orders
    doubted = torch.isin(asked, owners[worth])
    some = torch.cat([doubted, worth]).nonzero()[:, 0]
    refined = refine_unchecked(both.select(some), of_bodies.select(some), Descent(_ITERATIONS, _RATE))
    chosen = torch.arange(count)
    totals, flip = refined.energy.tolist(), (some - len(asked)).tolist()
    rows_of: dict[int, list[int]] = {}
    for row, person in enumerate(people[some].tolist()):
        rows_of.setdefault(person, []).append(row)
    wrong = losses[some].tolist()
    for person, (own_row, *rows) in rows_of.items():
        best = min(rows, key=totals.__getitem__)
        accepted = totals[best] <= (1 - _MARGIN) * totals[own_row]
        if to_hide := [row for row in rows if names[flip[row]].split(":")[0] in orders[person].hidden]:
            best, accepted = min(to_hide, key=wrong.__getitem__), True
        if accepted:
            chosen[person] = count + best
            orders[person] = replace(orders[person], flipped=names[flip[best]])
    if bool((chosen < count).all()):
        return bodies, orders
    return BodyParameters.joined([bodies, refined.parameters]).select(chosen.to(owners.device)), orders


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
    flips, _, names = _propose(body, prior, None if lens is None else lens[None])
    return BodyParameters.joined([body, flips]), names


def _propose(
    bodies: BodyParameters,
    prior: PosePrior,
    lenses: torch.Tensor | None,
    uncertainty: Uncertainty | None = None,
    hidden: torch.Tensor | None = None,
) -> tuple[BodyParameters, torch.Tensor, list[str]]:
    """Flips of B bodies, whose each is, (F,), in their order, and names.

    What the network says leaves no flips out of limbs that are ``hidden``, shape (B, limbs).
    """
    posed = bodies.posed()
    view = posed.joints.new_tensor([0.0, 0.0, 1.0]).expand(bodies.batch_size, 3)
    if lenses is not None:
        view = ray_rotations(bodies, lenses)[..., 2]
    crossing = _crossing(posed, view)
    found: list[torch.Tensor] = []
    owners: list[torch.Tensor] = []
    names: list[str] = []
    for number, (limb, parts) in enumerate(_LIMBS.items()):
        over = crossing[:, list(parts)].any(1)
        for flipped in ((True, False), (False, True), (True, True)):
            mirror = _mirror(posed, parts, flipped, view)
            good = over & mirror.steep
            if uncertainty is not None:
                # Depths leave out the pelvis, so those of a part's end have the part's own index.
                believed = (mirror.moves <= _BELIEVED * uncertainty.depths[:, list(parts[:2])]).all(1)
                good = good & (believed if hidden is None else believed | hidden[:, number])
            rows = good.nonzero()[:, 0]
            if not len(rows):
                continue
            found.append(_solve_twist(bodies.select(rows), parts, mirror.turns[rows], mirror.bones[rows], prior))
            owners.append(rows)
            bones = [PART_NAMES[part].split("_", 1)[1] for part, flip in zip(parts[:2], flipped, strict=True) if flip]
            names += [f"{limb}: {' and '.join(bones)}"] * len(rows)
    if not found:
        return bodies.select(slice(0)), torch.zeros(0, dtype=torch.int64, device=view.device), []
    rotations, whose = torch.cat(found), torch.cat(owners)
    possible = prior.joint_limits(rotations) <= prior.joint_limits(bodies.rotations)[whose] + _OVER_LIMITS
    kept = possible.nonzero()[:, 0]
    kept = kept[whose[kept].argsort(stable=True)]
    whose = whose[kept]
    return replace(bodies.select(whose), rotations=rotations[kept]), whose, [names[n] for n in kept.tolist()]


def _hidden_limbs(bodies: BodyParameters, people: Batch, labels: LabelSet | None) -> torch.Tensor:
    """Limbs with a keypoint where labels show another part of the person, and nothing of the limb, (B, limbs), bool.

    What is seen there can't be behind the limb. Labels of the limb's mirror image say nothing: sides may be exchanged.
    """
    count = len(people)
    if people.targets is None or labels is None:
        return torch.zeros(count, len(_LIMBS), dtype=torch.bool, device=people.points.device)
    size, device = people.targets.shape[-1], people.points.device
    columns = _joint_columns(device)
    points, weights = people.points.mT @ columns, people.weights @ columns  # (B, 2, joints), (B, joints)
    statures = bone_statures(bodies.lengths) * bodies.log_scale.exp()  # in the crop
    places = points.mT[:, :, None] + statures[:, None, None, None] * _DISC.to(statures)
    at = ((places + 1) * size / 2).floor().long()  # (B, joints, places, 2)
    inside = ((at >= 0) & (at < size)).all(-1).all(-1)
    x, y = at.clamp(0, size - 1).unbind(-1)
    shown = people.targets[torch.arange(count, device=device)[:, None, None], y, x]
    known = inside & (weights > 0) & (shown != IGNORE).all(-1) & (shown[..., 0] != BACKGROUND)
    groups = torch.from_numpy(labels.part_groups[1:]).to(device)[_own_parts(device)]  # (joints, parts)
    nothing = (shown[..., None] != groups[:, None]).all(-1).all(-1)
    return (known & nothing).view(count, len(_LIMBS), 2).any(2)


@lru_cache(maxsize=8)
def _joint_columns(device: torch.device) -> torch.Tensor:
    """Each limb's two joints among ``LANDMARK_NAMES``, by whatever convention, shape (L, 8): 1 where it is one."""
    names = [JOINT_NAMES[part + 1] for parts in _LIMBS.values() for part in parts[:2]]
    return torch.tensor([[float(each.endswith(name)) for name in names] for each in LANDMARK_NAMES], device=device)


@lru_cache(maxsize=8)
def _own_parts(device: torch.device) -> torch.Tensor:
    """Parts on either side of each limb's two joints, and their mirror images, shape (8, 4)."""
    pairs = [parts[end : end + 2] for parts in _LIMBS.values() for end in range(2)]
    twins = mirror_order(PART_NAMES)
    return torch.tensor([[*pair, *twins[list(pair)].tolist()] for pair in pairs], device=device)


class _Mirror(NamedTuple):
    """Bones of a limb of B bodies, some of them mirrored in depth."""

    bones: torch.Tensor  # directions of the limb's upper and lower bone, shape (B, 2, 3)
    turns: torch.Tensor  # smallest rotations that take the upper bone there, shape (B, 3, 3)
    moves: torch.Tensor  # how far the ends of both move along the view [m], shape (B, 2)
    steep: torch.Tensor  # False where a bone hardly changes, shape (B,)


def _mirror(posed: Posed, parts: tuple[int, ...], flipped: tuple[bool, bool], view: torch.Tensor) -> _Mirror:
    """Mirror the bones of a limb that are ``flipped``: along ``view``, the direction in which each body is seen."""
    steep = torch.ones(len(view), dtype=torch.bool, device=view.device)
    moved = torch.zeros_like(view[:, 0])
    moves: list[torch.Tensor] = []
    before: list[torch.Tensor] = []
    bones: list[torch.Tensor] = []
    for part, flip in zip(parts[:2], flipped, strict=True):
        bone = posed.joints[:, part + 1] - posed.joints[:, BONE_STARTS[part]]
        length = bone.norm(dim=-1, keepdim=True)
        bone = bone / length
        before.append(bone)
        if flip:
            slope = (bone * view).sum(-1, keepdim=True)
            steep = steep & (slope[:, 0].abs() >= _FLAT)
            bone = bone - 2 * slope * view
            moved = moved - 2 * (slope * length)[:, 0]
        bones.append(bone)
        moves.append(moved)
    return _Mirror(
        torch.stack(bones, dim=1), rotation_between(before[0], bones[0]), torch.stack(moves, dim=1).abs(), steep
    )


def _solve_twist(
    bodies: BodyParameters, parts: tuple[int, ...], turns: torch.Tensor, bones: torch.Tensor, prior: PosePrior
) -> torch.Tensor:
    """Local rotations, shape (B, 20, 3), of bodies whose limb takes other directions.

    Two directions leave open how far the upper bone is twisted about itself. With the twist that it had, elbows and
    knees bend sideways or backward, where the limb was mirrored. So of ``_TWISTS`` the likeliest one is taken that
    joints allow.

    Args:
        bodies: As they were.
        parts: The limb's upper, lower and last part.
        turns: Rotations that take the upper bone there, shape (B, 3, 3).
        bones: New directions of the upper and the lower bone, shape (B, 2, 3).
        prior: Of poses.
    """
    posed = bodies.posed()
    world = torch.cat([posed.rotations[:, :1], posed.rotations], dim=1)  # of the pelvis, whose hips don't turn
    upper, lower, last = (part + 1 for part in parts)
    before = posed.joints[:, lower] - posed.joints[:, upper]
    turns = rotation_from_axis_angle(bones[:, :1] * _TWISTS.to(bones)[:, None]) @ turns[:, None]  # (B, twists, 3, 3)
    carried = (turns @ before[:, None, :, None])[..., 0]
    swings = rotation_between(carried, bones[:, 1:].expand_as(carried)) @ turns
    world = world[:, None].repeat(1, len(_TWISTS), 1, 1, 1)
    world[:, :, upper] = turns @ world[:, :, upper]
    world[:, :, [lower, last]] = swings[:, :, None] @ world[:, :, [lower, last]]
    rotations = bodies.rotations[:, None].repeat(1, len(_TWISTS), 1, 1)
    local = world[:, :, [BONE_STARTS[part] for part in parts]].mT @ world[:, :, [upper, lower, last]]
    rotations[:, :, list(parts)] = rotation_to_axis_angle(local)
    poses, ups = rotations.flatten(0, 1), up_direction(bodies.global_orient())
    costs = prior(poses, ups.repeat_interleave(len(_TWISTS), 0)) + _LIMITS * prior.joint_limits(poses)
    rows = torch.arange(len(rotations), device=rotations.device)
    return rotations[rows, costs.view(len(rotations), -1).argmin(1)]


def _crossing(posed: Posed, view: torch.Tensor) -> torch.Tensor:
    """Parts with a bone that lies, in the picture, over a part that they don't hang on, shape (B, 20), bool."""
    forward = view.new_tensor([0.0, 0.0, 1.0]).expand_as(view)
    across = rotation_between(view, forward)[:, None, :2]  # the picture's plane, square to the view, (B, 1, 2, 3)
    axes = across @ posed.axes  # (B, 20, 2, 3)
    outlines = (axes * posed.semi_axes[:, :, None].square()) @ axes.mT  # ellipses x^T outlines^-1 x = 1
    bones = posed.semi_axes[:, :, :1] * axes[..., 0]
    places = posed.centres @ across[:, 0].mT
    points = places[:, :, None] + _PLACES.to(bones)[:, None] * bones[:, :, None]  # (B, 20, places, 2)
    x, y = (points[:, :, :, None] - places[:, None, None]).unbind(-1)  # (B, 20, places, 20)
    inverse = torch.linalg.inv(outlines)[:, None, None]
    squares = inverse[..., 0, 0] * x * x + 2 * inverse[..., 0, 1] * x * y + inverse[..., 1, 1] * y * y
    return ((squares < _BESIDE).any(2) & _apart(view.device)).any(2)


@lru_cache(maxsize=8)
def _apart(device: torch.device) -> torch.Tensor:
    """Pairs of parts of which none hangs on the other, nor both on the same, shape (20, 20), bool."""
    parts, parents = np.arange(len(PART_NAMES)), np.array(PARENTS)
    hangs = parents[:, None] == parts
    close = hangs | hangs.T | (parents[:, None] == parents) | (parts[:, None] == parts)
    return torch.from_numpy(~close).to(device)
