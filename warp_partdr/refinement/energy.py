"""What a fit minimises: L_proj + L_seg + L_l + L_t (paper, section 3.4), a pose prior, joint limits, a hold in depth.

Units decide what the paper's weights 1 : 1e-2 : 1e-3 : 1e-3 mean. Here L_proj is in pixels of a crop of 256 px, L_seg
in pixels of the same (whatever size is drawn), L_l, L_t and the hold in square millimetres, the prior in nats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import torch

from ..body.ellipbody import DEFAULT_SUBDIVISIONS
from ..body.parameters import BodyParameters
from ..body.pose_prior import PosePrior, up_direction
from ..body.posing import LandmarkGather, Posed
from ..cameras import WeakPerspective
from ..inputs.observation import REFERENCE_SIZE, Observation, resize_nearest
from ..render.ellipsoid_passes import Gradient
from ..render.ellipsoids import draw_ellipsoids, ellipsoid_label_loss
from ..render.mesh import DEFAULT_DEPTH_WEIGHT, label_loss, rasterize_parts
from ..render.part_mesh import PartMesh, ellipbody_mesh
from ..render.subdivisions import DEFAULT_TOLERANCE, Subdivisions, coarsest_subdivisions

Renderer = Literal["exact", "mesh"]

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
