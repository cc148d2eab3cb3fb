"""Surfaces of ellipsoids and detailed models: samples, closest points, and what lies inside (paper, eq. 16 to 18)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
import warp as wp

from ..body.icosphere import icosphere
from ..body.posing import Posed
from ..body.template import NUM_PARTS
from ..interop.arrays import warp_array
from ..interop.device_cache import device_cache
from ..interop.layouts import Tensors
from ..interop.operation import Gradients, Operation
from ..interop.streams import on_torch_stream
from ..kernels import registration as kernels
from .model import DetailedModel, unique_pairs
from .packaged import packaged_findings

SKIN = "skin"  # name of the packaged findings
# Ellipsoids taper toward the joints, limbs don't: only samples and vertices within this share of a bone's half-length,
# from its middle, say how thick a limb is.
BAND = 0.7
_SUBDIVISIONS = 2  # of the icosphere whose corners are the samples
_CELL = 4.0  # [m] between the cells of the mesh of all parts and bodies
_RAY_START = 1e-3  # [m] from a vertex: a ray does not hit the faces around it


@device_cache(4)  # rays of all vertices take a tenth of a second
def vertex_parts(model: DetailedModel) -> tuple[torch.Tensor, torch.Tensor]:
    """Part of each vertex of a model, and each vertex's share of the skin at rest.

    A vertex belongs to the part that has most of the area around it. A vertex within the body, as in the mouth, has the
    share 0.

    Returns:
        Part indices 0 to 19, shape (V,), int32, which are labels minus 1; and shares, whose sum is 1, shape (V,).

    Examples:
        >>> from warp_partdr import PART_NAMES, anny, vertex_parts
        >>> parts, shares = vertex_parts(anny())
        >>> parts.shape
        torch.Size([13718])
        >>> head = float(shares[parts == PART_NAMES.index("head")].sum())  # the head's share of the skin
        >>> 0.05 < head < 0.15
        True
    """
    with torch.inference_mode(False):  # kept for calls outside of it, too
        corners = model.rest_vertices[model.faces.long()]
        doubled = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).norm(dim=-1)
        shares = corners.new_zeros(model.num_vertices, NUM_PARTS)
        for corner in model.faces.long().unbind(1):
            shares.index_put_((corner, model.face_parts.long() - 1), doubled, accumulate=True)
        areas = shares.sum(1) * skin_vertices(model)
        return shares.argmax(1).int(), areas / areas.sum()


def skin_vertices(model: DetailedModel) -> torch.Tensor:
    """1 for each vertex that can be seen from outside when the model is at rest, else 0, shape (V,)."""
    found = packaged_findings(model, SKIN)
    if found is not None:
        return torch.from_numpy(found["seen"]).to(model.rest_vertices)
    return find_seen_vertices(model)


def find_seen_vertices(model: DetailedModel) -> torch.Tensor:
    """Find by rays what ``skin_vertices`` returns."""
    vertices = model.rest_vertices.contiguous()
    directions = torch.from_numpy(icosphere(1)[0]).to(vertices)
    skin = torch.empty_like(vertices[:, 0])
    with on_torch_stream(vertices.device) as device:
        mesh = wp.Mesh(points=_vectors(vertices), indices=warp_array(model.faces.flatten().contiguous()))
        inputs = [mesh.id, _vectors(vertices), _vectors(directions), _RAY_START]
        wp.launch(kernels.find_skin, dim=len(skin), inputs=inputs, outputs=[_flat(skin)], device=device)
    return skin


def is_closed(model: DetailedModel) -> bool:
    """True if the model's surface has no hole and its faces wind counterclockwise as seen from outside."""
    vertices, faces = model.rest_vertices.double(), model.faces.long()
    sides = torch.stack([faces.flatten(), faces.roll(-1, 1).flatten()])
    once = unique_pairs(sides, len(vertices))
    if once.shape[1] < sides.shape[1] or not torch.equal(once, unique_pairs(sides.flip(0), len(vertices))):
        return False  # a side of a face must be a side of one other face, which passes it the other way
    first, second, third = vertices[faces].unbind(1)
    return bool((first * torch.linalg.cross(second, third)).sum() > 0)


def surface_samples(posed: Posed) -> tuple[torch.Tensor, torch.Tensor]:
    """Points on the ellipsoids' middles [m], shape (B, 20 N, 3), and their shares of the area, shape (B, 20 N).

    A sample that another ellipsoid covers has no share.
    """
    like = posed.semi_axes
    sphere = torch.from_numpy(icosphere(_SUBDIVISIONS)[0]).to(like)
    sphere = sphere[sphere[:, 0].abs() < BAND]
    offsets = sphere * posed.semi_axes[:, :, None]
    samples = posed.centres[:, :, None] + offsets @ posed.axes.mT
    samples = samples.flatten(1, 2).contiguous()
    # The area that a patch of the sphere becomes.
    areas = posed.semi_axes.prod(-1)[..., None] * (sphere / posed.semi_axes[:, :, None]).norm(dim=-1)
    seen = torch.empty(samples.shape[:2], dtype=like.dtype, device=like.device)
    with on_torch_stream(like.device) as device:
        inputs = [_vectors(samples), _part_arrays(posed), len(sphere)]
        wp.launch(kernels.cover_samples, dim=seen.numel(), inputs=inputs, outputs=[_flat(seen)], device=device)
    weights = seen * areas.flatten(1)
    return samples, weights / weights.sum(1, keepdim=True).clamp(min=1e-12)


class PartCells:
    """Meshes of all bodies' parts, each in a cell of its own, for closest points on the same part."""

    def __init__(self, model: DetailedModel, skin: torch.Tensor, batch: int) -> None:
        outside = skin[model.faces.long()].all(1)
        faces, parts = model.faces[outside].long(), model.face_parts[outside].long() - 1
        device = faces.device
        self.corners = faces
        # A vertex between two parts has a copy in each one's cell.
        keys, faces = torch.unique(faces * NUM_PARTS + parts[:, None], return_inverse=True)
        self.vertices, self.parts = (keys // NUM_PARTS).int(), (keys % NUM_PARTS).int()
        bodies = torch.arange(batch, device=device)
        self.faces = (faces + bodies[:, None, None] * len(keys)).int().flatten().contiguous()
        self.points = torch.zeros(batch * len(keys), 3, device=device)
        side = max(round(batch**0.5), 1)
        body, part = bodies[:, None], torch.arange(NUM_PARTS, device=device)
        places = torch.stack(torch.broadcast_tensors(part - NUM_PARTS // 2, body % side, body // side), dim=-1)
        self.origins = _CELL * places.to(model.rest_vertices)
        self.mesh: wp.Mesh | None = None

    def closest(
        self, vertices: torch.Tensor, samples: torch.Tensor, weights: torch.Tensor, reach: float
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Vertices of the closest face to each sample (B, M, 3), barycentric coordinates, and 1 where one is near."""
        # Relative to the body, so that cells far from the origin cost no digits.
        middle = vertices.mean(1, keepdim=True)
        origins = (self.origins - middle).contiguous()
        found = torch.empty(samples.shape[:2], dtype=torch.int32, device=samples.device)
        places = torch.empty_like(samples)
        with on_torch_stream(vertices.device) as device:
            if not samples.numel():
                return self.corners[found.long()], places, found
            copies = [warp_array(self.vertices), warp_array(self.parts), _vectors(origins)]
            inputs = [_vectors(vertices), *copies, vertices.shape[1], NUM_PARTS]
            outputs = [_vectors(self.points)]
            wp.launch(kernels.place_cells, dim=len(self.points), inputs=inputs, outputs=outputs, device=device)
            if self.mesh is None:
                self.mesh = wp.Mesh(points=_vectors(self.points), indices=warp_array(self.faces))
            else:
                self.mesh.refit()
            inputs = [self.mesh.id, _vectors(samples), _flat(weights), _vectors(origins)]
            inputs += [samples.shape[1] // NUM_PARTS, len(self.corners), reach]
            outputs = [_flat(found), _vectors(places)]
            wp.launch(kernels.closest_on_cells, dim=found.numel(), inputs=inputs, outputs=outputs, device=device)
        return self.corners[found.clamp(min=0).long()], places, (found >= 0).to(samples.dtype)


def registration_costs(
    vertices: torch.Tensor, parts: torch.Tensor, areas: torch.Tensor, posed: Posed, scale: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Distance of vertices from their own ellipsoids [m²] and eq. 18 over all, means over the area, shape (B,) each.

    Args:
        vertices: Vertices of a detailed model [m], shape (B, V, 3), float32.
        parts: Part of each vertex, shape (V,), int32.
        areas: Share of each vertex, shape (V,).
        posed: Ellipsoids, which have no gradient.
        scale: Distance at which a vertex begins to count less [m].
    """
    fit, penetration = _VertexCosts(posed, scale)(vertices, parts, areas)[0].unbind(0)
    return fit, penetration


@dataclass(frozen=True, eq=False)
class _VertexCosts(Operation):
    """Both costs, shape (2, B), and their gradients at once."""

    posed: Posed
    scale: float
    name = "register"

    def forward(self, inputs: Tensors) -> tuple[Tensors, Tensors]:
        vertices, parts, areas = inputs
        fit, penetration = vertices.new_empty(2, *vertices.shape[:2])
        gradients = vertices.new_empty(2, *vertices.shape)
        with on_torch_stream(vertices.device) as device:
            of_vertices = [_vectors(vertices), warp_array(parts), warp_array(areas)]
            arrays = [*of_vertices, _part_arrays(self.posed), BAND, self.scale]
            outputs = [_flat(fit), _flat(penetration), _vectors(gradients[0]), _vectors(gradients[1])]
            wp.launch(kernels.vertex_costs, dim=fit.numel(), inputs=arrays, outputs=outputs, device=device)
        return (torch.stack([fit.sum(-1), penetration.sum(-1)]),), (gradients,)

    def adjoint(self, saved: Tensors, adjoints: Tensors) -> Gradients:
        *_, gradients = saved
        return ((adjoints[0][..., None, None] * gradients).sum(0),)


def _vectors(tensor: torch.Tensor) -> wp.array:
    return warp_array(tensor.contiguous().view(-1, 3), wp.vec3)


def _flat(tensor: torch.Tensor) -> wp.array:
    return warp_array(tensor.view(-1))


def _part_arrays(posed: Posed) -> kernels.PartArrays:
    arrays = kernels.PartArrays()
    arrays.centres, arrays.semi_axes = _vectors(posed.centres), _vectors(posed.semi_axes)
    arrays.axes, arrays.count = warp_array(posed.axes.view(-1, 3, 3), wp.mat33), NUM_PARTS
    return arrays
