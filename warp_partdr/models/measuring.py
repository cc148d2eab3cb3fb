"""Measures of a detailed body: the 20 ellipsoids that one would have on it, in its pose, and those that tailors take.

A girth is the length of a tape around a horizontal section: of its convex hull. Arms take no part in it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch

from ..body.posing import pose
from ..body.rotations import rotation_between
from ..body.template import (
    BONE_STARTS,
    JOINT_NAMES,
    LENGTH_NAMES,
    LOCKED_PARTS,
    NUM_PARTS,
    PARENTS,
    PART_NAMES,
    template,
)
from ..interop.captured_call import call_as_graph
from ..interop.device_cache import device_cache
from ..interop.layouts import Tensors
from .growth import Growth
from .model import Detailed, DetailedModel, unique_pairs
from .pose import end_joints, rest_turns
from .registration import Registered

_LEFT_HIP, _RIGHT_HIP = PART_NAMES.index("left_hip"), PART_NAMES.index("right_hip")

BODY_MEASURES = ("stature", "chest girth", "waist girth", "hip girth", "thigh girth")

_TRUNK = ("left_hip", "right_hip", "abdomen", "chest")
_DIRECTIONS = 180  # in which the hull's extent is taken
_LEVELS = 9  # sections among which the widest or narrowest is looked for
# Levels as shares of the way from the hips' joints up to the shoulders' (chest, waist, hips), or down to the knee's.
_CHEST, _WAIST, _HIPS, _THIGH = (0.75, 0.75), (0.2, 0.6), (-0.15, 0.15), (0.3, 0.5)


def measure_ellipbody(body: Registered) -> Tensors:
    """Arguments of ``pose`` for the EllipBodies of detailed bodies, in their frame.

    Lengths and thicknesses are measured at rest, sides averaged. Each bone has the direction that it has in the
    detailed body, and turns about it as that part of the body does; the pelvis' two are locked, and the line through
    the hips says where they point. The middle of all joints coincides.

    Returns:
        Orientation (B, 3, 3), position of the pelvis [m] (B, 3), local rotations (B, 20, 3, 3), ``LENGTH_NAMES`` [m]
        (B, 12), ``THICKNESS_NAMES`` [m] (B, 15).
    """
    return call_as_graph(_measure, (body.shape, body.stretches, *vars(body.detailed).values()), body.model)


def _measure(
    shape: torch.Tensor,
    stretches: torch.Tensor,
    vertices: torch.Tensor,
    joints: torch.Tensor,
    transforms: torch.Tensor,
    model: DetailedModel,
) -> Tensors:
    """Compute ``measure_ellipbody`` from tensors of ``Registered`` and of its ``detailed``."""
    rest = model.rest(shape, stretches=stretches)
    sizes = Growth(model, shape).measured_at(rest).exp()
    lengths, thicknesses = sizes[:, : len(LENGTH_NAMES)], sizes[:, len(LENGTH_NAMES) :]
    landmarks = model.landmarks(Detailed(vertices, joints, transforms), JOINT_NAMES)
    orientation, rotations = _rotations(model, rest, transforms[..., :3, :3], landmarks)
    origin = landmarks.new_zeros(len(landmarks), 3)
    there = pose(orientation, origin, rotations, lengths, thicknesses, validate=False)
    return orientation, (landmarks - there.joints).mean(1), rotations, lengths, thicknesses


def statures(model: DetailedModel, shape: torch.Tensor) -> torch.Tensor:
    """Heights of standing people of shape values (B, S), shape (B,) [m]."""
    return heights(model.rest(shape))


def heights(rest: Detailed) -> torch.Tensor:
    """Heights of bodies at rest, of ``model.rest``, shape (B,) [m]."""
    places = rest.vertices[..., 1]
    low, high = places.amin(1), places.amax(1)  # aminmax has no derivative in older PyTorch
    return high - low


def measure_body(model: DetailedModel, rest: Detailed) -> torch.Tensor:
    """``BODY_MEASURES`` of bodies at rest, of ``model.rest`` or ``Registered.rest``, shape (B, 5) [m], differentiable.

    Chest: three quarters of the way from the hips' joints to the shoulders'. Waist: the narrowest between them. Hips:
    the widest near the hips' joints, both legs in it. Thigh: the widest below the crotch, sides averaged.
    """

    def height(name: str) -> torch.Tensor:
        sides = [f"{side}_{name}" for side in ("left", "right")]
        return model.landmarks(rest, sides)[..., 1].mean(1)

    hips, shoulders, knees = height("hip"), height("shoulder"), height("knee")

    def sections(parts: tuple[str, ...], end: torch.Tensor, shares: tuple[float, float]) -> torch.Tensor:
        steps = torch.linspace(*shares, _LEVELS if shares[0] < shares[1] else 1, dtype=hips.dtype, device=hips.device)
        edges = _edges(model, parts)
        levels = (hips[:, None] + steps * (end - hips)[:, None]).unbind(1)
        return torch.stack([_girths(rest.vertices, edges, level) for level in levels], dim=1)

    thighs = [sections((f"{side}_upper_leg",), knees, _THIGH).amax(1) for side in ("left", "right")]
    return torch.stack(
        [
            heights(rest),
            sections(_TRUNK, shoulders, _CHEST)[:, 0],
            sections(_TRUNK, shoulders, _WAIST).amin(1),
            sections((*_TRUNK, "left_upper_leg", "right_upper_leg"), shoulders, _HIPS).amax(1),
            torch.stack(thighs).mean(0),
        ],
        dim=1,
    )


def _rotations(
    model: DetailedModel, rest: Detailed, world: torch.Tensor, joints: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Orientation (B, 3, 3) and local rotations (B, 20, 3, 3) in which bones have the directions of these joints'.

    ``world`` are the rotations of the model's joints from rest, shape (B, J, 3, 3).
    """
    tables = _part_tables(model)
    turned = rest_turns(model, rest, trunk_along=True)
    carried = world[:, tables.end_joints] @ turned.mT
    directions = tables.directions
    bones = joints[:, 1:] - joints[:, tables.bone_starts]
    hips = directions[_LEFT_HIP] - directions[_RIGHT_HIP], bones[:, _LEFT_HIP] - bones[:, _RIGHT_HIP]
    orientation = rotation_between(world[:, 0] @ hips[0], hips[1]) @ world[:, 0]
    found = rotation_between((carried @ directions[..., None])[..., 0], bones) @ carried
    found = torch.where(tables.locked, orientation[:, None], found)
    above = torch.cat([found, orientation[:, None]], dim=1)[:, tables.parents]
    return orientation, above.mT @ found


class _PartTables(NamedTuple):
    """Numbers of the 20 parts on a model's device."""

    end_joints: torch.Tensor  # (20,) int64
    bone_starts: torch.Tensor  # (20,) int64
    directions: torch.Tensor  # (20, 3) of bones at rest
    locked: torch.Tensor  # (20, 1, 1) bool
    parents: torch.Tensor  # (20,) int64; 20 is the pelvis


@device_cache(8)
def _part_tables(model: DetailedModel) -> _PartTables:
    device = model.faces.device
    with torch.inference_mode(False):  # kept for calls outside of it, too
        return _PartTables(
            torch.tensor(end_joints(model), device=device),
            torch.tensor(BONE_STARTS, device=device),
            torch.from_numpy(template().rest_directions).to(model.rest_vertices),
            torch.tensor([part in LOCKED_PARTS for part in range(NUM_PARTS)], device=device)[:, None, None],
            torch.tensor([NUM_PARTS if parent < 0 else parent for parent in PARENTS], device=device),
        )


@device_cache(16)
def _edges(model: DetailedModel, parts: tuple[str, ...]) -> torch.Tensor:
    """Edges of the faces of some parts, shape (E, 2)."""
    with torch.inference_mode(False):  # kept for calls outside of it, too
        labels = torch.tensor([PART_NAMES.index(part) + 1 for part in parts], device=model.faces.device)
        corners = model.faces[torch.isin(model.face_parts.long(), labels)].long()
        sides = torch.stack([corners.flatten(), corners.roll(1, 1).flatten()]).sort(dim=0).values
        return unique_pairs(sides, model.num_vertices).T


def _girths(vertices: torch.Tensor, edges: torch.Tensor, level: torch.Tensor) -> torch.Tensor:
    """Lengths of tapes around the sections of bodies (B, V, 3) at heights (B,), shape (B,); 0 where nothing is cut."""
    over = vertices[..., 1] - level[:, None]
    cut = (over[:, edges[:, 0]] > 0) != (over[:, edges[:, 1]] > 0)
    some = cut.any(0)  # one edge in thirty or so
    if not bool(some.any()):
        return vertices.new_zeros(len(vertices))
    edges, cut = edges[some], cut[:, some]
    first, second = vertices[:, edges].unbind(2)
    above, below = over[:, edges].unbind(2)
    share = above / torch.where(cut, above - below, torch.ones_like(above))
    points = (first + share[..., None] * (second - first))[..., ::2]
    angles = torch.arange(_DIRECTIONS, dtype=vertices.dtype, device=vertices.device) * (2 * math.pi / _DIRECTIONS)
    extents = points @ torch.stack([angles.cos(), angles.sin()])
    farthest = extents.masked_fill(~cut[..., None], -math.inf).amax(1)
    # Cauchy: a convex curve is as long as its extent, summed over all directions.
    return torch.where(cut.any(1), farthest.mean(1) * (2 * math.pi), 0.0)
