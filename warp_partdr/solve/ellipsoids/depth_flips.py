"""Depth flips: limbs mirrored in depth, which are tried where parts overlap.

Keypoints do not tell a limb from its mirror image in depth. Labels do where parts overlap, because the nearer part
hides the other one. A flip can change the depth order. Gradient steps alone cannot: on the way a bone would be seen in
its full length, and its keypoints do not let it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
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
from ...interop.device_cache import device_cache
from ...networks.regression.uncertainty import Uncertainty
from ...render.renderers import RendererEllipsoids
from .batch import Batch
from .energy import SEG, Energy, Weights
from .refine import refine_unchecked
from .stepper import Descent
from .tables import LANDMARK_NAMES

# Parts of a limb: its upper and lower bone can be mirrored, and its last part turns with the lower bone.
_LIMBS = {
    f"{side} {limb}": tuple(PART_NAMES.index(f"{side}_{part}") for part in parts)
    for limb, parts in (("arm", ("upper_arm", "forearm", "hand")), ("leg", ("upper_leg", "lower_leg", "foot")))
    for side in ("left", "right")
}
# A bone lies over another part if it comes within the part's ellipse, enlarged by the root of this.
_OVERLAP = 2.0
# Points about a joint, the joint first, at which a visible limb has labels: a disc of half an arm's thickness.
_NEAR = 0.03  # share of the stature
_CIRCLE = [(math.cos(angle * math.pi / 6), math.sin(angle * math.pi / 6)) for angle in range(12)]
_DISC = _NEAR * torch.tensor([(0.0, 0.0), *((share * x, share * y) for share in (0.5, 1.0) for x, y in _CIRCLE)])
_TWISTS = torch.arange(16) * (2 * math.pi / 16)  # twists of a limb's upper bone from which a flip chooses [rad]
_LIMITS = 20.0  # weight of joint limits beside the prior in this choice [nat/rad^2]
_FLAT = 0.17  # sine of the angle to the picture's plane below which a bone hardly differs from its mirror image
_OVER_LIMITS = 0.1  # largest excess over joint limits by which a flip may be worse than the body [rad^2]
# Largest move of a joint along the view in a flip, in units of the network's uncertainty. Of 1,059 flips of its bodies
# (PartBench's people 300 to 399 at four levels), 18 % of those with smaller moves were nearer to the truth than the
# body, and 2 % of the others, some of which noisy labels preferred by far.
_LARGEST_MOVE = 5.0
_BONE_POINTS = torch.linspace(-1.0, 1.0, 9)  # points along a bone, in halves of its length
# Labels have much weight while flips are compared; otherwise keypoints, which do not see depth, would decide.
FLIP_SIZE = 128  # side of the crop in which flips are compared [px]
_ITERATIONS, _RATE = 30, 0.02
FLIP_WEIGHTS = Weights(seg=0.5, proj=0.05, prior=0.1)
# Least share of the body's energy that a flip must save. With labels drawn from EllipBody, right flips save 6 to 70 %.
# For people with clothes of another shape and noisy labels, none of 300 flips saves so much (2026-11-23).
_MARGIN = 0.06
_WORTH_REFINING = 0.05  # least share of the label loss that a flip must save before it is refined


@dataclass(frozen=True)
class DepthOrder:
    """Flips of one person that were tried at the start of a fit.

    Attributes:
        tried: Flips that were tried, such as "left arm: forearm".
        flipped: Flip that was accepted; None if the body stayed.
        hidden: Limbs that labels do not show at their joints, such as "left arm".
    """

    tried: tuple[str, ...]
    flipped: str | None
    hidden: tuple[str, ...] = ()


def repair_depth_orders(
    bodies: BodyParameters, observations: Observations, prior: PosePrior, *, uncertainty: Uncertainty | None = None
) -> tuple[BodyParameters, list[DepthOrder]]:
    """Return the body of each person, or its flip if labels prefer that by far.

    A flip that is returned was refined by a few steps before it was compared.

    A limb is hidden if labels show other parts, but nothing of the limb, at one of its joints. Of the flips of a hidden
    limb, the one with the lowest label loss is taken, and the network's uncertainty rules out none of them. This
    changed 5 of 72 people with arms behind their backs, whose errors fell by 21 mm on average, and none of 180 others
    (PartBench, realistic and hard; 2026-11-28).

    Args:
        bodies: N bodies, one of each person.
        observations: Observations of the N people, with labels.
        prior: Prior of poses.
        uncertainty: Uncertainty of the network about its bodies. It rules out flips that move a joint much farther than
            the uncertainty of its depth; None rules out none.

    Returns:
        N bodies, and the flips that were tried of each person.
    """
    count = bodies.batch_size
    if count == 0:
        return bodies, []
    energy = Energy(observations, FLIP_SIZE, FLIP_WEIGHTS, prior, renderer=RendererEllipsoids("edges"))
    hidden = _hidden_limbs(bodies, Batch.of(energy), observations.label_set)
    lenses = observations.lens
    flips = _propose(bodies, prior, lenses, uncertainty, hidden)
    tried: list[list[str]] = [[] for _ in range(count)]
    for name, person in zip(flips.names, flips.people.tolist(), strict=True):
        tried[person].append(name)
    limbs = [tuple(limb for limb, there in zip(_LIMBS, row, strict=True) if there) for row in hidden.tolist()]
    orders = [DepthOrder(tuple(each), None, some) for each, some in zip(tried, limbs, strict=True)]
    if not flips.names:
        return bodies, orders
    # Candidates are the bodies that have flips, and then all flips.
    with_flips = flips.people.unique()
    candidates = BodyParameters.joined([bodies.select(with_flips), flips.bodies])
    people = torch.cat([with_flips, flips.people])
    energies = energy.select(people)
    losses = refine_unchecked(candidates, energies, Descent(iterations=0)).terms[SEG.name]
    body_losses = losses.new_zeros(count).index_copy(0, with_flips, losses[: len(with_flips)])
    worth = (losses <= body_losses[people] * (1 - _WORTH_REFINING))[len(with_flips) :]
    if not worth.any():
        return bodies, orders
    doubted = torch.isin(with_flips, flips.people[worth])
    some = torch.cat([doubted, worth]).nonzero()[:, 0]
    refined = refine_unchecked(candidates.select(some), energies.select(some), Descent(_ITERATIONS, _RATE))
    chosen = torch.arange(count)
    totals = refined.energy.tolist()
    label_losses = losses[some].tolist()
    flip_indices = (some - len(with_flips)).tolist()
    rows_of: dict[int, list[int]] = {}
    for row, person in enumerate(people[some].tolist()):
        rows_of.setdefault(person, []).append(row)
    for person, (body_row, *rows) in rows_of.items():
        best = min(rows, key=totals.__getitem__)
        accepted = totals[best] <= (1 - _MARGIN) * totals[body_row]
        of_hidden = [row for row in rows if flips.names[flip_indices[row]].split(":")[0] in orders[person].hidden]
        if of_hidden:
            best = min(of_hidden, key=label_losses.__getitem__)
            accepted = True
        if accepted:
            chosen[person] = count + best
            orders[person] = replace(orders[person], flipped=flips.names[flip_indices[best]])
    if bool((chosen < count).all()):
        return bodies, orders
    return BodyParameters.joined([bodies, refined.parameters]).select(chosen.to(people.device)), orders


def flip_depths(
    body: BodyParameters, prior: PosePrior, lens: torch.Tensor | None = None
) -> tuple[BodyParameters, list[str]]:
    """Mirror bones of a body in depth, in limbs that overlap other parts in the picture.

    Args:
        body: One body, B = 1.
        prior: Prior whose joint limits rule out flips.
        lens: Focal length and principal point of the camera in the crop's coordinates, shape (3,); None: weak
            perspective.

    Returns:
        1 + F bodies, the body first and then its flips; and the names of the flips, such as "left arm: forearm".
    """
    flips = _propose(body, prior, None if lens is None else lens[None])
    return BodyParameters.joined([body, flips.bodies]), flips.names


class _Flips(NamedTuple):
    """Flips of several people's bodies.

    Attributes:
        bodies: F flips; those of a person follow one another.
        people: Person of each flip, in ascending order, shape (F,), int64.
        names: Name of each flip, such as "left arm: forearm".
    """

    bodies: BodyParameters
    people: torch.Tensor
    names: list[str]


def _propose(
    bodies: BodyParameters,
    prior: PosePrior,
    lenses: torch.Tensor | None,
    uncertainty: Uncertainty | None = None,
    hidden: torch.Tensor | None = None,
) -> _Flips:
    """Make the flips of B bodies.

    Args:
        bodies: B bodies.
        prior: Prior whose joint limits rule out flips.
        lenses: Lenses of their cameras, shape (B, 3); None: weak perspective.
        uncertainty: Uncertainty of the network about the bodies, which rules out flips; None rules out none.
        hidden: Limbs for which the uncertainty rules out no flips, shape (B, limbs), bool; None: no limb.
    """
    posed = bodies.posed()
    view = posed.joints.new_tensor([0.0, 0.0, 1.0]).expand(bodies.batch_size, 3)
    if lenses is not None:
        view = ray_rotations(bodies, lenses)[..., 2]
    overlaps = _overlapping_parts(posed, view)
    found: list[torch.Tensor] = []
    found_people: list[torch.Tensor] = []
    names: list[str] = []
    for index, (limb, parts) in enumerate(_LIMBS.items()):
        overlapping = overlaps[:, list(parts)].any(1)
        for flipped in ((True, False), (False, True), (True, True)):
            mirror = _mirror(posed, parts, flipped, view)
            possible = overlapping & mirror.steep
            if uncertainty is not None:
                # Depths have no entry for the pelvis, so the depth of a part's end has the index of the part.
                credible = (mirror.moves <= _LARGEST_MOVE * uncertainty.depths[:, list(parts[:2])]).all(1)
                possible = possible & (credible if hidden is None else credible | hidden[:, index])
            rows = possible.nonzero()[:, 0]
            if not len(rows):
                continue
            found.append(_solve_twist(bodies.select(rows), parts, mirror.turns[rows], mirror.bones[rows], prior))
            found_people.append(rows)
            bones = [PART_NAMES[part].split("_", 1)[1] for part, flip in zip(parts[:2], flipped, strict=True) if flip]
            names += [f"{limb}: {' and '.join(bones)}"] * len(rows)
    if not found:
        return _Flips(bodies.select(slice(0)), torch.zeros(0, dtype=torch.int64, device=view.device), [])
    rotations = torch.cat(found)
    people = torch.cat(found_people)
    within_limits = prior.joint_limits(rotations) <= prior.joint_limits(bodies.rotations)[people] + _OVER_LIMITS
    kept = within_limits.nonzero()[:, 0]
    kept = kept[people[kept].argsort(stable=True)]
    people = people[kept]
    flips = replace(bodies.select(people), rotations=rotations[kept])
    return _Flips(flips, people, [names[index] for index in kept.tolist()])


def _hidden_limbs(bodies: BodyParameters, people: Batch, labels: LabelSet | None) -> torch.Tensor:
    """Find limbs with a keypoint where labels show another part of the person, but nothing of the limb.

    The other part can't be behind the limb there. Labels of the same limb on the other side of the body do not count,
    because sides may be exchanged.

    Returns:
        True for hidden limbs, shape (B, limbs), bool.
    """
    count = len(people)
    if people.targets is None or labels is None:
        return torch.zeros(count, len(_LIMBS), dtype=torch.bool, device=people.points.device)
    size = people.targets.shape[-1]
    device = people.points.device
    columns = _joint_columns(device)
    points = people.points.mT @ columns  # (B, 2, joints)
    weights = people.weights @ columns  # (B, joints)
    statures = bone_statures(bodies.lengths) * bodies.log_scale.exp()  # [half-sides of the crop]
    disc = points.mT[:, :, None] + statures[:, None, None, None] * _DISC.to(statures)
    pixels = ((disc + 1) * size / 2).floor().long()  # (B, joints, points, 2)
    inside = ((pixels >= 0) & (pixels < size)).all(-1).all(-1)
    x, y = pixels.clamp(0, size - 1).unbind(-1)
    labels_there = people.targets[torch.arange(count, device=device)[:, None, None], y, x]
    known = inside & (weights > 0) & (labels_there != IGNORE).all(-1) & (labels_there[..., 0] != BACKGROUND)
    groups = torch.from_numpy(labels.part_groups[1:]).to(device)[_own_parts(device)]  # (joints, parts)
    limb_missing = (labels_there[..., None] != groups[:, None]).all(-1).all(-1)
    return (known & limb_missing).view(count, len(_LIMBS), 2).any(2)


@device_cache(8)
def _joint_columns(device: torch.device) -> torch.Tensor:
    """Matrix that selects each limb's two joints from ``LANDMARK_NAMES`` of all conventions: 1 or 0, shape (L, 8)."""
    names = [JOINT_NAMES[part + 1] for parts in _LIMBS.values() for part in parts[:2]]
    return torch.tensor([[float(each.endswith(name)) for name in names] for each in LANDMARK_NAMES], device=device)


@device_cache(8)
def _own_parts(device: torch.device) -> torch.Tensor:
    """Indices of the parts that meet at each limb's two joints, and of the same parts on the other side, (8, 4)."""
    pairs = [parts[end : end + 2] for parts in _LIMBS.values() for end in range(2)]
    twins = mirror_order(PART_NAMES)
    return torch.tensor([[*pair, *twins[list(pair)].tolist()] for pair in pairs], device=device)


class _Mirror(NamedTuple):
    """Bones of one limb of B bodies, with one or both of them mirrored in depth.

    Attributes:
        bones: Directions of the limb's upper and lower bone, shape (B, 2, 3).
        turns: Smallest rotations that bring the upper bone to its new direction, shape (B, 3, 3).
        moves: Moves of the ends of both bones along the view [m], shape (B, 2).
        steep: True if all mirrored bones change more than hardly, shape (B,), bool.
    """

    bones: torch.Tensor
    turns: torch.Tensor
    moves: torch.Tensor
    steep: torch.Tensor


def _mirror(posed: Posed, parts: tuple[int, ...], flipped: tuple[bool, bool], view: torch.Tensor) -> _Mirror:
    """Mirror bones of a limb in depth.

    Args:
        posed: B posed bodies.
        parts: Upper, lower and last part of the limb.
        flipped: True for the upper and the lower bone if it is mirrored.
        view: Direction from the camera to each body, shape (B, 3).
    """
    steep = torch.ones(len(view), dtype=torch.bool, device=view.device)
    move = torch.zeros_like(view[:, 0])
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
            move = move - 2 * (slope * length)[:, 0]
        bones.append(bone)
        moves.append(move)
    return _Mirror(
        torch.stack(bones, dim=1), rotation_between(before[0], bones[0]), torch.stack(moves, dim=1).abs(), steep
    )


def _solve_twist(
    bodies: BodyParameters, parts: tuple[int, ...], turns: torch.Tensor, bones: torch.Tensor, prior: PosePrior
) -> torch.Tensor:
    """Find local rotations of bodies whose limb takes new directions.

    The directions of two bones do not fix the twist of the upper bone about itself. With the twist from before, elbows
    and knees of a mirrored limb would bend sideways or backward. So the twist among ``_TWISTS`` with the lowest cost of
    prior and joint limits is taken.

    Args:
        bodies: B bodies before the flip.
        parts: Upper, lower and last part of the limb.
        turns: Rotations that bring the upper bone to its new direction, shape (B, 3, 3).
        bones: New directions of the upper and the lower bone, shape (B, 2, 3).
        prior: Prior of poses.

    Returns:
        Local rotations, shape (B, 20, 3).
    """
    posed = bodies.posed()
    world = torch.cat([posed.rotations[:, :1], posed.rotations], dim=1)  # the pelvis first
    upper_part, lower_part, last_part = parts
    upper = upper_part + 1
    lower = lower_part + 1
    last = last_part + 1
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
    poses = rotations.flatten(0, 1)
    ups = up_direction(bodies.global_orient())
    costs = prior(poses, ups.repeat_interleave(len(_TWISTS), 0)) + _LIMITS * prior.joint_limits(poses)
    rows = torch.arange(len(rotations), device=rotations.device)
    return rotations[rows, costs.view(len(rotations), -1).argmin(1)]


def _overlapping_parts(posed: Posed, view: torch.Tensor) -> torch.Tensor:
    """Find the parts whose bone overlaps a part that is no neighbour in the picture, shape (B, 20), bool."""
    forward = view.new_tensor([0.0, 0.0, 1.0]).expand_as(view)
    across = rotation_between(view, forward)[
        :, None, :2
    ]  # axes of the picture's plane, square to the view, (B, 1, 2, 3)
    axes = across @ posed.axes  # (B, 20, 2, 3)
    outlines = (axes * posed.semi_axes[:, :, None].square()) @ axes.mT  # ellipses x^T outlines^-1 x = 1
    bones = posed.semi_axes[:, :, :1] * axes[..., 0]
    centres = posed.centres @ across[:, 0].mT
    points = centres[:, :, None] + _BONE_POINTS.to(bones)[:, None] * bones[:, :, None]  # (B, 20, points, 2)
    x, y = (points[:, :, :, None] - centres[:, None, None]).unbind(-1)  # (B, 20, points, 20)
    inverse = torch.linalg.inv(outlines)[:, None, None]
    squares = inverse[..., 0, 0] * x * x + 2 * inverse[..., 0, 1] * x * y + inverse[..., 1, 1] * y * y
    return ((squares < _OVERLAP).any(2) & _not_neighbours(view.device)).any(2)


@device_cache(8)
def _not_neighbours(device: torch.device) -> torch.Tensor:
    """Pairs of parts of which neither is the parent of the other, and which share no parent, shape (20, 20), bool."""
    parts = np.arange(len(PART_NAMES))
    parents = np.array(PARENTS)
    is_parent = parents[:, None] == parts
    close = is_parent | is_parent.T | (parents[:, None] == parents) | (parts[:, None] == parts)
    return torch.from_numpy(~close).to(device)
