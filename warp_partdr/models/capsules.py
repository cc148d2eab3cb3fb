"""Capsules in a detailed body's parts, which say how deep parts and people stand in one another.

They are measured once, from the skin at rest; they follow shape values, linearly, and the joints that carry their
parts. Clothes don't count.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import torch
import warp as wp

from ..body.landmarks import without_side
from ..body.template import PARENTS, PART_NAMES
from ..errors import check_whole
from ..interop.arrays import warp_array, warp_arrays
from ..interop.captured_function import Fixed, call_captured
from ..interop.checks import check_tensor
from ..interop.device_cache import device_cache
from ..interop.graph_cache import Launch
from ..interop.layouts import Tensors
from ..interop.movable import Movable
from ..interop.operation import Gradients, Operation
from ..interop.streams import on_torch_stream
from ..kernels import capsules as kernels
from ..kernels.launch import launch_shared
from .model import Detailed, DetailedModel
from .surfaces import BAND, vertex_parts

FLESH = 0.015  # [m] that parts and people give way where they touch
_NUMBERS = int(kernels.NUMBERS)  # of a capsule
_NEAR = 0.02  # [m] between capsules that are neighbours: they touch at rest, or nearly
_HALVES = ("upper_leg", "lower_leg", "upper_arm", "forearm")  # thinner at one end, so that each has two capsules
# Of parts that are as wide as long: the axis, x to the left or y up at rest. Others lie along their longest way.
_AXES = {"hip": 0, "abdomen": 0, "chest": 0, "shoulder": 0, "neck": 1, "head": 1}


@dataclass(frozen=True, eq=False)
class Capsules(Movable):
    """C capsules of a model's body: all within a radius of a line between two ends.

    Attributes:
        parts: Part 0 to 19 that each capsule belongs to. Both hips share the left one.
        joints: Joint that carries each capsule, shape (C,), int64.
        ends: Both ends of each capsule for shape 0, relative to its joint, in axes that are the body frame's at rest
            [m], shape (C, 2, 3).
        end_directions: Change of the ends by a unit of each shape value [m], shape (S, C, 2, 3).
        radii: Radii for shape 0 [m], shape (C,).
        radius_directions: Change of the radii by a unit of each shape value [m], shape (S, C).
        allowed: Depth of each capsule in each other one that costs nothing [m], infinite for neighbours, shape (C, C).
    """

    parts: tuple[int, ...]
    joints: torch.Tensor
    ends: torch.Tensor
    end_directions: torch.Tensor
    radii: torch.Tensor
    radius_directions: torch.Tensor
    allowed: torch.Tensor

    def of(self, body: Detailed, shape: torch.Tensor, by: torch.Tensor | None = None) -> torch.Tensor:
        """Both ends and the radius of each [m], shape (B, C, 7), float32; bodies moved by (B, 3) [m]."""
        at_rest, by_shape = self._rows
        rest = torch.nn.functional.linear(shape, by_shape, at_rest).unflatten(1, (-1, _NUMBERS))
        moves = shape.new_zeros(len(shape), 3) if by is None else by
        return _Placed()(rest, body.transforms, moves, self.joints)[0]

    @cached_property
    def _rows(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Ends and radii of shape 0, shape (7 C,), and their change by shape values, shape (7 C, S)."""
        pairs = (self.ends, self.radii), (self.end_directions, self.radius_directions)
        with torch.inference_mode(False):  # kept for calls outside of it, too
            at_rest, changes = (torch.cat([ends.flatten(-2), radii[..., None]], dim=-1) for ends, radii in pairs)
            return at_rest.flatten(), changes.flatten(1).mT.contiguous()

    def overlap(self, placed: torch.Tensor, people: int = 1) -> torch.Tensor:
        """Sum of the squares of depths [cm^2] beyond what flesh gives way, shape (B,).

        Args:
            placed: Capsules that ``of`` has placed, float32, shape (B, C, 7).
            people: Number of people P. Body b also meets the bodies b + B / P, b + 2 B / P and so on. Each of two
                bodies has half of their cost, and the gradient of each cost is with respect to both.

        Raises:
            ValueError: If ``placed`` has another shape, dtype or device, or P does not divide B.
        """
        return find_overlap(placed, self.allowed, people)


def find_overlap(placed: torch.Tensor, allowed: torch.Tensor, people: int = 1) -> torch.Tensor:
    """``Capsules.overlap`` with ``allowed`` in its place; ``placed`` has C capsules, ``allowed`` is (C, C)."""
    check_tensor("placed", placed, (None, len(allowed), _NUMBERS), dtypes=(torch.float32,), like=("allowed", allowed))
    people = check_whole("people", people, 1)
    if len(placed) % people:
        raise ValueError(f"people: {people}; expected a divisor of the {len(placed)} bodies")
    return _OverlapCost(people)(placed, allowed)[0]


class _Placed(Operation):
    """Capsules that joints carry."""

    name = "Capsules.of"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        *moving, joints = inputs
        return call_captured(_prepare_placed, tuple(moving), (moving[0].shape,), Fixed(joints)), ()

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        rest, frames, moves, joints = saved
        given, shapes = (rest, frames, *adjoints), (rest.shape, frames.shape)
        by_rest, by_frames = call_captured(_prepare_placed_adjoint, given, shapes, Fixed(joints))
        by_moves = by_frames[..., :3, 3].sum(1) if moves.requires_grad else None
        return by_rest, by_frames, by_moves


def _prepare_placed(inputs: Tensors, outputs: Tensors, joints: Fixed) -> Launch:
    """Launch that places capsules, from those at rest, joints' frames and moves."""
    rest, frames, moves = warp_arrays(inputs, (None, wp.mat44, wp.vec3))
    carried, placed = warp_array(joints.tensor), warp_array(outputs[0])
    return partial(kernels.launch_place_capsules, rest, frames, moves, carried, placed)


def _prepare_placed_adjoint(inputs: Tensors, outputs: Tensors, joints: Fixed) -> Launch:
    """Launch that fills gradients of capsules at rest and frames from these and the adjoint of placed ones."""
    rest, frames, adjoint = warp_arrays(inputs, (None, wp.mat44, None))
    carried, (by_rest, by_frames) = warp_array(joints.tensor), warp_arrays(outputs, (None, wp.mat44))
    return partial(kernels.launch_place_capsules_adjoint, rest, frames, carried, adjoint, (by_rest, by_frames))


@dataclass(frozen=True, eq=False)
class _OverlapCost(Operation):
    """Cost and gradient at once: both need the nearest points."""

    people: int
    name = "overlap"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        placed, allowed = inputs
        rows = placed.contiguous()
        # Of each person that they meet; people are added in their order.
        costs, gradients = (rows.new_empty(*rows.shape[:2], self.people, *own) for own in ((), (_NUMBERS,)))
        if costs.numel():
            with on_torch_stream(rows.device):
                arrays = [warp_array(rows.view(-1)), warp_array(allowed.view(-1)), FLESH, rows.shape[1], self.people]
                outputs = [warp_array(costs.view(-1)), warp_array(gradients.view(-1))]
                launch_shared(kernels.overlap_costs, (costs.numel(),), arrays, outputs, work=rows.shape[1])
        return (costs.flatten(1).sum(1),), (gradients,)

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        _, _, gradients = saved
        factors = _pair_factors(adjoints[0], self.people)
        return ((gradients * factors[:, None, :, None]).sum(2),)


def _pair_factors(adjoint: torch.Tensor, people: int) -> torch.Tensor:
    """Weight of what each body costs with each of the people at its place, shape (B, P).

    It is the mean of the weights of both bodies' costs, for each cost has half of the pair's.
    """
    by_person = adjoint.unflatten(0, (people, -1))
    return 0.5 * (by_person[:, :, None] + by_person.mT).flatten(0, 1)


@device_cache(4)
def measure_capsules(model: DetailedModel) -> Capsules:
    """Capsules of a model: one a part, across the trunk and along limbs, two along arms' and legs' halves."""
    with torch.inference_mode(False), torch.no_grad():  # kept for calls outside of it, too
        part, areas = vertex_parts(model)
        slices = [each for index in range(len(PART_NAMES)) for each in _slices(model, index, part, areas)]
        carried = torch.tensor([model.part_joints[index] for index, _, _ in slices], device=areas.device)
        joints = model.rest_joints[carried], model.joint_directions[:, carried]
        weights = torch.stack([weights for _, weights, _ in slices])  # (C, 2, V)
        rest, moves = weights @ model.rest_vertices, torch.einsum("cev,svx->scex", weights, model.shape_directions)
        sections = [section for _, _, section in slices]
        radii = _radii(rest, sections, model.rest_vertices)
        changed = [
            _radii(rest + move, sections, model.rest_vertices + direction) - radii
            for move, direction in zip(moves, model.shape_directions, strict=True)
        ]
        parts = tuple(index for index, _, _ in slices)
        ends = rest - joints[0][:, None], moves - joints[1][:, :, None]
        allowed = _allowed(parts, torch.cat([rest.flatten(1), radii[:, None]], dim=1))
        return Capsules(parts, carried, *ends, radii, torch.stack(changed), allowed)


def _slices(
    model: DetailedModel, index: int, part: torch.Tensor, areas: torch.Tensor
) -> list[tuple[int, torch.Tensor, torch.Tensor]]:
    """Capsules of a part: its index, weights of the vertices in both ends, and vertices that say how thick it is.

    The weights have shape (2, V).

    Ends lie on the line that fits the vertices best, so that they are sums of them whatever the shape.
    """
    name = PART_NAMES[index]
    if name == "right_hip":
        return []
    own = (part == index) | ((part == PART_NAMES.index("right_hip")) & (name == "left_hip"))
    members = (own & (areas > 0)).nonzero()[:, 0]
    if not len(members):
        return []
    kind, points = without_side(name), model.rest_vertices[members]
    if kind in _AXES:
        along = points[:, _AXES[kind]]
    else:
        centred = points - points.mean(0)
        axis = torch.linalg.eigh(centred.mT @ (areas[members, None] * centred))[1][:, -1]
        out = points.mean(0) - model.rest_joints[model.part_joints[index]]  # from the joint on
        along = centred @ axis * torch.sign(axis @ out)
    middle = (along.min() + along.max()) / 2
    halves = [along <= middle, along > middle] if kind in _HALVES else [torch.ones_like(along, dtype=torch.bool)]
    found: list[tuple[int, torch.Tensor, torch.Tensor]] = []
    for half in halves:
        some, own_along = members[half], along[half]
        share = areas[some] / areas[some].sum()
        offset = own_along - share @ own_along
        slope = share * offset / (share @ offset.square())
        line = torch.stack([share @ points[half], slope @ points[half]])
        low, high = offset.min(), offset.max()
        inner = (offset - (low + high) / 2).abs() < BAND * (high - low) / 2
        section = some[inner]
        radius = share[inner] @ _off_line(points[half][inner], line[0], line[1]) / share[inner].sum()
        # The end of a half goes on in the next part, that of a whole part is round.
        inset = torch.minimum(radius * (0.5 if kind in _HALVES else 1.0), 0.49 * (high - low))
        weights = areas.new_zeros(2, len(areas))
        for end, place in enumerate((low + inset, high - inset)):
            weights[end, some] = share + place * slope
        found.append((index, weights, section))
    return found


def _off_line(points: torch.Tensor, start: torch.Tensor, direction: torch.Tensor) -> torch.Tensor:
    """Distance of points from a line, shape (N,)."""
    return torch.linalg.cross(points - start, direction.expand_as(points)).norm(dim=1) / direction.norm()


def _radii(ends: torch.Tensor, sections: list[torch.Tensor], vertices: torch.Tensor) -> torch.Tensor:
    """Mean distance of vertices from the lines, shape (C,) [m]."""
    pairs = zip(ends, sections, strict=True)
    return torch.stack([_off_line(vertices[some], end[0], end[1] - end[0]).mean() for end, some in pairs])


def _allowed(parts: tuple[int, ...], rest: torch.Tensor) -> torch.Tensor:
    """``Capsules.allowed``, of capsules at rest, shape (C, 7)."""
    joined = torch.tensor([[one in _chain(part) for one in parts] for part in parts])
    first, second = torch.combinations(torch.arange(len(parts), device=rest.device)).unbind(1)
    near = rest.new_full((2, 2), -_NEAR).fill_diagonal_(torch.inf)
    touching = find_overlap(torch.stack([rest[first], rest[second]], dim=1), near) > 0
    joined = joined.to(rest.device).index_put((first, second), touching, accumulate=True)
    return torch.full_like(rest[:, :1], FLESH).repeat(1, len(parts)).masked_fill(joined | joined.mT, torch.inf)


def _chain(part: int) -> list[int]:
    """A part and those that it hangs on: the next one above, and what a shoulder is part of."""
    above = [part]
    while PARENTS[above[-1]] >= 0 and (len(above) == 1 or without_side(PART_NAMES[above[-1]]) == "shoulder"):
        above.append(PARENTS[above[-1]])
    return above
