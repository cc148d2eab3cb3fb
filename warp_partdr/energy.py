"""What a fit minimises: L_proj + L_seg + L_l + L_t (paper, section 3.4), a pose prior, joint limits, a hold in depth.

Units decide what the paper's weights 1 : 1e-2 : 1e-3 : 1e-3 mean. Here L_proj is in pixels of a crop of 256 px, L_seg
in pixels of the same (whatever size is drawn), L_l, L_t and the hold in square millimetres, the prior in nats.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import torch

from .body.ellipbody import DEFAULT_SUBDIVISIONS
from .body.labels import LabelSet
from .body.landmarks import landmark_points
from .body.movable import Movable
from .cameras import WeakPerspective
from .ellipsoid_passes import Gradient
from .ellipsoids import draw_ellipsoids, ellipsoid_label_loss
from .mesh import PartMesh, ellipbody_mesh
from .parameters import BodyParameters
from .pose_prior import PosePrior, up_direction
from .posing import Posed
from .render import DEFAULT_DEPTH_WEIGHT, label_loss, rasterize_parts
from .subdivisions import DEFAULT_TOLERANCE, Subdivisions, coarsest_subdivisions

Renderer = Literal["exact", "mesh"]

REFERENCE_SIZE = 256  # [px], the paper's image size; losses are stated for it
_MILLIMETRES = 1000.0


@dataclass(frozen=True)
class Weights:
    """Weights of the energy's terms, a unit of each; the first four terms are the paper's.

    Attributes:
        proj: Of L_proj [1/px of a crop of 256 px].
        seg: Of L_seg [1/px of the same].
        length: Of L_l [1/mm²].
        thickness: Of L_t [1/mm²].
        prior: Of the pose's negative log-likelihood [1/nat].
        limits: Of the squared excess over joint limits [1/rad²].
        depth: Of the squared distance from ``Energy.depths`` along z [1/mm²]; without those it does nothing.
    """

    proj: float = 1.0
    seg: float = 3e-2
    length: float = 1e-3
    thickness: float = 1e-3
    prior: float = 3.0
    limits: float = 20.0
    depth: float = 0.0


@dataclass(frozen=True)
class Observation(Movable):
    """What is known of the person, in a square crop of side 2 (coordinates -1 to 1).

    Attributes:
        landmarks: Names of the L keypoints that are there.
        points: Where they are, shape (L, 2).
        confidence: How much they count, 0 to 1, shape (L,).
        labels: Group ids in the crop, 0 = background, 255 = ignore, shape (N, N), uint8; None without labels.
        label_set: What the group ids mean.
        maps: Probability of each group, shape (G, N, N), instead of ``labels``; None without probabilities.
        known: How much a pixel of ``maps`` counts, shape (N, N): what is missing to 1 is the share to be ignored.
        lengths: What to expect of the person's ``LENGTH_NAMES`` [m], shape (12,); None: the mean adult's.
        thicknesses: The same of ``THICKNESS_NAMES`` [m], shape (15,).
    """

    landmarks: tuple[str, ...]
    points: torch.Tensor
    confidence: torch.Tensor
    labels: torch.Tensor | None
    label_set: LabelSet | None
    maps: torch.Tensor | None = None
    known: torch.Tensor | None = None
    lengths: torch.Tensor | None = None
    thicknesses: torch.Tensor | None = None


@dataclass
class Energy:
    """The terms of the fit's energy for one observation and any batch of bodies.

    Args:
        observation: Keypoints and labels.
        size: Side of the drawn crop [px].
        weights: Of the terms.
        prior: The pose prior.
        renderer: "exact" ellipsoids, or their "mesh".
        subdivisions: Level of the drawn mesh, 0 to 3; "auto": the coarsest that keeps ``tolerance`` for the first
            bodies that are drawn, and the same from then on (``coarsest_subdivisions``).
        tolerance: Of "auto" [px of the drawn crop].
        gradient: Of the exact renderer: "partdr", "coverage" or "edges"; the mesh has PartDR's alone.
        max_distance: PartDR: how far from an edge a pixel may move it [px of the drawn crop], see ``label_loss``.
        depth_weight: PartDR: the paper's lambda of the z gradient; 0 leaves it out, as a label set of one group does,
            with which nothing that shows hides something else.
        depths: Where the parts' centres are to stay along z, pelvis at 0 [m], shape (20,); None: anywhere. Neither
            labels nor keypoints say so, and a body leans to fit an outline.

    Attributes:
        votes: How much each landmark counts, shape (L,).
        usual_lengths: What L_l is measured from [m], shape (12,).
        usual_thicknesses: What L_t is measured from [m], shape (15,).
        target: Labels that the picture is compared with, shape (size, size), uint8; None where none is drawn.
    """

    observation: Observation
    size: int = REFERENCE_SIZE
    weights: Weights = field(default_factory=Weights)
    prior: PosePrior | None = None
    renderer: Renderer = "exact"
    subdivisions: Subdivisions = DEFAULT_SUBDIVISIONS
    tolerance: float = DEFAULT_TOLERANCE
    gradient: Gradient = "partdr"
    max_distance: float = math.inf
    depth_weight: float = DEFAULT_DEPTH_WEIGHT
    depths: torch.Tensor | None = None

    def __post_init__(self) -> None:
        seen = self.observation
        device = seen.points.device
        self._gather = LandmarkGather(seen.landmarks, device)
        # Ten points of a face say little more than one: the landmarks of one part share its vote.
        votes = torch.zeros(20, device=device).index_add(0, self._gather.parts[:, 0], seen.confidence)
        self.votes = seen.confidence / votes.clamp_min(1.0)[self._gather.parts[:, 0]]
        mean = BodyParameters.mean(1, device=device)
        self.usual_lengths = mean.lengths[0] if seen.lengths is None else seen.lengths
        self.usual_thicknesses = mean.thicknesses[0] if seen.thicknesses is None else seen.thicknesses
        self.target: torch.Tensor | None = None
        self._mesh: tuple[int, PartMesh] | None = None  # its level, and itself
        self._part_labels: list[int] = []
        if seen.labels is not None and seen.label_set is not None and self.weights.seg > 0:
            self._part_labels = [int(group) for group in seen.label_set.part_groups[1:]]
            if seen.label_set.num_groups == 1:
                self.depth_weight = 0.0
            self.target = resize_nearest(seen.labels, self.size)
        self._maps = None if seen.maps is None else resize_nearest(seen.maps, self.size)
        self._known = None if seen.known is None else resize_nearest(seen.known, self.size)

    def __call__(self, parameters: BodyParameters) -> dict[str, torch.Tensor]:
        """Each weighted term by name, shape (B,)."""
        weights = self.weights
        posed = parameters.posed()
        terms = {"proj": weights.proj * self.reprojection(parameters, posed)}
        if self.target is not None:
            terms["seg"] = weights.seg * (REFERENCE_SIZE / self.size) ** 2 * self.segmentation(parameters, posed)
        deviation = (parameters.lengths - self.usual_lengths) * _MILLIMETRES
        terms["length"] = weights.length * deviation.square().sum(1)
        deviation = (parameters.thicknesses - self.usual_thicknesses) * _MILLIMETRES
        terms["thickness"] = weights.thickness * deviation.square().sum(1)
        if self.prior is not None:
            rotations = parameters.free_rotations()
            terms["prior"] = weights.prior * self.prior(rotations, up_direction(parameters.global_orient()))
            terms["limits"] = weights.limits * self.prior.joint_limits(rotations)
        if self.depths is not None:
            deviation = (posed.centres[..., 2] - self.depths) * _MILLIMETRES
            terms["depth"] = weights.depth * deviation.square().sum(1)
        return terms

    def segmentation(self, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
        """L_seg against labels, or against probabilities where there are such [pixels], shape (B,)."""
        assert self.target is not None
        camera = parameters.camera(self.size)
        image_size = (self.size, self.size)
        maps = None
        if self.renderer == "mesh":
            level, mesh = self._find_mesh(posed, camera)
            vertices = camera.project(posed.vertices(level))
            if self._maps is None:
                target = self.target.expand(parameters.batch_size, -1, -1)
                return label_loss(
                    vertices,
                    mesh,
                    target,
                    max_distance=self.max_distance,
                    depth_weight=self.depth_weight,
                    validate=False,
                )[0]
            maps = rasterize_parts(
                vertices,
                mesh,
                image_size,
                num_maps=len(self._maps),
                max_distance=self.max_distance,
                depth_weight=self.depth_weight,
                validate=False,
            ).maps
        elif self._maps is None:
            return ellipsoid_label_loss(
                posed,
                camera,
                self.target[None],
                part_labels=self._part_labels,
                gradient=self.gradient,
                max_distance=self.max_distance,
                depth_weight=self.depth_weight,
                validate=False,
            )[0]
        else:
            maps = draw_ellipsoids(
                posed,
                camera,
                image_size,
                part_labels=self._part_labels,
                num_maps=len(self._maps),
                gradient=self.gradient,
                max_distance=self.max_distance,
                depth_weight=self.depth_weight,
                validate=False,
            ).maps
        assert maps is not None
        assert self._known is not None
        return ((maps - self._maps).square() * self._known).sum((1, 2, 3))

    def _find_mesh(self, posed: Posed, camera: WeakPerspective) -> tuple[int, PartMesh]:
        """The drawn mesh and its level, which stays: the energy must not jump while it is minimised."""
        if self._mesh is None:
            label_set = self.observation.label_set
            assert label_set is not None
            level = self.subdivisions
            if level == "auto":
                level = coarsest_subdivisions(posed, camera, tolerance=self.tolerance)
            mesh = ellipbody_mesh(level, device=posed.centres.device).relabel(label_set.part_groups)
            self._mesh = level, mesh
        return self._mesh

    def reprojection(self, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
        """L_proj: L1 distance of the keypoints [px of a 256 px crop], weighted with their confidence, shape (B,)."""
        image = parameters.camera(2).project(self._gather(posed))[..., :2] - 1
        distance = (image - self.observation.points).abs().sum(-1) * (REFERENCE_SIZE / 2)
        return (distance * self.votes).sum(1)


class LandmarkGather:
    """Where landmarks are on posed bodies.

    Args:
        names: L landmarks.
        device: Where the bodies are.
    """

    def __init__(self, names: Sequence[str], device: torch.device | str) -> None:
        points = landmark_points(names)
        self.parts = torch.from_numpy(points.parts).to(device)
        self._normalised = torch.from_numpy(points.normalised.astype(np.float32)).to(device)
        self._weights = torch.from_numpy(points.weights.astype(np.float32)).to(device)

    def __call__(self, posed: Posed) -> torch.Tensor:
        """Shape (B, L, 3) [m], float32 or as the bodies."""
        local = posed.semi_axes[:, self.parts] * self._normalised.to(posed.semi_axes)
        points = posed.centres[:, self.parts] + (posed.axes[:, self.parts] @ local[..., None]).squeeze(-1)
        return (points * self._weights.to(points)[..., None]).sum(2)


def resize_nearest(labels: torch.Tensor, size: int) -> torch.Tensor:
    """Square images (..., N, N) at ``size`` pixels a side: what lies under each new pixel's centre."""
    old = labels.shape[-1]
    index = ((torch.arange(size, device=labels.device) + 0.5) * old / size).long().clamp_max(old - 1)
    return labels[..., index[:, None], index].contiguous()
