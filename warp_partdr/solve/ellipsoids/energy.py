"""Energy of a fit: L_proj + L_seg + L_l + L_t (paper, section 3.4), a pose prior, joint limits, a term of depth.

The meaning of the paper's weights 1 : 1e-2 : 1e-3 : 1e-3 depends on the units of the terms. Here L_proj and L_seg are
in pixels of a crop of 256 px, whatever size is drawn. L_l and L_t are in square millimetres. The prior is in nats. The
term of depth is in squares of the uncertainty of depths, or in square millimetres if that is not known.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch

from ...body.landmarks import landmark_points
from ...body.lens import place_bodies
from ...body.parameters import BodyParameters
from ...body.pose_prior import PosePrior, up_direction
from ...body.posing import LandmarkGather, Posed
from ...body.template import NUM_PARTS
from ...cameras import Camera
from ...errors import check_type, check_whole
from ...inputs.observation import REFERENCE_SIZE, Observation, resize_nearest
from ...inputs.observations import Observations
from ...interop.device_cache import device_cache
from ...render.renderers import Renderer, RendererEllipsoids

_MILLIMETRES = 1000.0


class Term(NamedTuple):
    """Term of the energy, which belongs to a field of ``Weights``.

    Attributes:
        name: Name in ``Weights`` and in the energy's result.
        column: Column in the kernels (``kernels.refine``).
        value: Function that gives the term before it is weighted, shape (B,).
        applies: Function that tells if an energy has this term.
        factor: Function that gives the factor of the weight. It brings ``value``, and the kernel's value, to the term's
            unit.
    """

    name: str
    column: int
    value: Callable[[Energy, BodyParameters, Posed], torch.Tensor]
    applies: Callable[[Energy], bool]
    factor: Callable[[Energy], float]


def _term(
    weight: float,
    column: int,
    value: Callable[[Energy, BodyParameters, Posed], torch.Tensor],
    applies: Callable[[Energy], bool] = lambda energy: True,
    factor: Callable[[Energy], float] = lambda energy: 1.0,
) -> Any:
    return field(default=weight, metadata={"term": (column, value, applies, factor)})


def _length(energy: Energy, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
    return ((parameters.lengths - energy.usual_lengths) * _MILLIMETRES).square().sum(1)


def _thickness(energy: Energy, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
    return ((parameters.thicknesses - energy.usual_thicknesses) * _MILLIMETRES).square().sum(1)


def _prior(energy: Energy, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
    assert energy.prior is not None
    return energy.prior(parameters.free_rotations(), up_direction(parameters.global_orient()))


def _limits(energy: Energy, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
    assert energy.prior is not None
    return energy.prior.joint_limits(parameters.free_rotations())


def _depth(energy: Energy, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
    assert energy.depths is not None
    return ((posed.centres[..., 2] - energy.depths) * energy.depth_scales).square().sum(1)


@dataclass(frozen=True)
class Weights:
    """Weights of the energy's terms. Each field is a row of the table ``TERMS``; the first four terms are the paper's.

    A new term needs a field here with its torch function, and a device function in ``kernels.refine.rules``.

    Attributes:
        proj: Weight of L_proj [1/px of a crop of 256 px].
        seg: Weight of L_seg [1/px of a crop of 256 px].
        length: Weight of L_l [1/mm²].
        thickness: Weight of L_t [1/mm²].
        prior: Weight of the pose's negative log-likelihood [1/nat].
        limits: Weight of the squared excess over joint limits [1/rad²].
        depth: Weight of the squared distance from ``Energy.depths`` along z, divided by the squared uncertainty of
            these depths [1]. If their uncertainty is not known, the distance is in mm [1/mm²]. Without depths the term
            is left out.

    Examples:
        >>> from warp_partdr import FitOptions, Weights
        >>> options = FitOptions(weights=Weights(prior=1.0, limits=30.0))
        >>> options.weights.prior
        1.0
    """

    proj: float = _term(
        1.0,
        0,
        lambda energy, parameters, posed: energy.misses(parameters, posed),
        factor=lambda energy: REFERENCE_SIZE / 2,
    )
    seg: float = _term(
        3e-2,
        1,
        lambda energy, parameters, posed: energy.segmentation(parameters, posed),
        lambda energy: energy.target is not None,
        lambda energy: energy.scale_of_labels,
    )
    length: float = _term(1e-3, 2, _length)
    thickness: float = _term(1e-3, 3, _thickness)
    prior: float = _term(3.0, 4, _prior, lambda energy: energy.prior is not None)
    limits: float = _term(20.0, 5, _limits, lambda energy: energy.prior is not None)
    depth: float = _term(0.0, 6, _depth, lambda energy: energy.depths is not None)

    def __post_init__(self) -> None:
        for term in fields(self):
            weight = getattr(self, term.name)
            if not 0 <= weight < math.inf:
                raise ValueError(f"{term.name}: {weight}; expected 0 or a positive number")


def landmark_weights(confidence: torch.Tensor, parts: torch.Tensor) -> torch.Tensor:
    """Weights of landmarks: their confidence, where the landmarks of one part together weigh 1 at most.

    Ten keypoints of a face say little more about the body than one.

    Args:
        confidence: Confidence in L landmarks of B people, shape (B, L).
        parts: Part of the body that each landmark lies on, 0 to 19, shape (B, L), int64.

    Returns:
        Weights, shape (B, L).
    """
    sums = confidence.new_zeros(len(confidence), NUM_PARTS).scatter_add(1, parts, confidence)
    return confidence / sums.clamp_min(1.0).gather(1, parts)


TERMS = tuple(Term(row.name, *row.metadata["term"]) for row in fields(Weights))
SEG = next(term for term in TERMS if term.name == "seg")


@dataclass
class Energy:
    """Terms of the fit's energy for bodies of one person, or of N people.

    Args:
        observation: Keypoints and labels of one person, or of N people. All bodies are compared with the one person;
            each of the N people has one body.
        size: Side of the drawn crop [px].
        weights: Weights of the terms.
        prior: Prior of poses; None leaves out the prior and the joint limits.
        renderer: Renderer of exact ellipsoids, or of their mesh. A level that is "auto" is chosen for the first bodies
            that are drawn. With a label set of one group there is no z gradient: no group can hide another one.

    Attributes:
        observations: Observations as a batch; one observation is a batch of one.
        landmark_weights: Weight of each landmark, shape (N, L).
        usual_lengths: Lengths at which L_l is 0 [m], shape (N, 12).
        usual_thicknesses: Thicknesses at which L_t is 0 [m], shape (N, 15).
        depths: Expected depths of the parts' centres along z, pelvis at 0 [m], shape (N, 20); None leaves the term out.
            Labels and keypoints do not hold depths, so a body would lean to fit an outline.
        depth_scales: Inverse of the uncertainty of the expected depths [1/m], ``1 / depth_uncertainties`` of the
            observations, shape (N, 20). If that is not known, the uncertainty is 1 mm.
        target: Target labels, shape (N, size, size), uint8; None if nothing is drawn.
        key: Object that identifies this energy in the cache of graphs.

    Examples:
        >>> from warp_partdr import BodyParameters, Energy, PosePrior, observe, read_keypoints, read_parts
        >>> observation, crop = observe(read_keypoints("keypoints.json")[0], read_parts("parts.png", "cdcl14"))
        >>> energy = Energy(observation, size=128, prior=PosePrior())
        >>> terms = energy(BodyParameters.mean(2))
        >>> list(terms), terms["seg"].shape
        (['proj', 'seg', 'length', 'thickness', 'prior', 'limits'], torch.Size([2]))
    """

    observation: Observation | Observations
    size: int = REFERENCE_SIZE
    weights: Weights = field(default_factory=Weights)
    prior: PosePrior | None = None
    renderer: Renderer = field(default_factory=RendererEllipsoids)

    def __post_init__(self) -> None:
        check_type("observation", self.observation, Observation | Observations, "of observe")
        self.size = check_whole("size", self.size, 1)
        given = self.observation
        self.observations = people = Observations.of([given]) if isinstance(given, Observation) else given
        count, device = len(people), people.points.device
        self.landmark_weights = landmark_weights(
            people.confidence, _landmark_parts(people.landmarks, device).expand(count, -1)
        )
        mean = BodyParameters.mean(1, device=device)
        self.usual_lengths = mean.lengths.expand(count, -1) if people.lengths is None else people.lengths
        self.usual_thicknesses = (
            mean.thicknesses.expand(count, -1) if people.thicknesses is None else people.thicknesses
        )
        self.depths: torch.Tensor | None = people.depths
        self.depth_scales = torch.full((count, NUM_PARTS), _MILLIMETRES, device=device)
        if people.depth_uncertainties is not None:
            self.depth_scales = 1 / people.depth_uncertainties
        self.target: torch.Tensor | None = None
        self.key = object()
        self._fixed: Renderer | None = None
        self._part_labels: list[int] = []
        if people.labels is not None and people.label_set is not None and self.weights.seg > 0:
            self._part_labels = [int(group) for group in people.label_set.part_groups[1:]]
            if people.label_set.num_groups == 1:
                self.renderer = replace(self.renderer, depth_weight=0.0)
            self.target = resize_nearest(people.labels, self.size)
        self._maps = None if people.maps is None else resize_nearest(people.maps, self.size)
        self._known = None if people.known is None else resize_nearest(people.known, self.size)

    def select(self, rows: torch.Tensor | slice) -> Energy:
        """Select the energy of some of the N people, without the pictures from which the targets were made.

        Args:
            rows: Person of each body, shape (B,); a person may come several times.
        """
        chosen = copy(self)
        chosen.observation = chosen.observations = self.observations.without_pictures().select(rows)
        for name in ("landmark_weights", "usual_lengths", "usual_thicknesses", "depth_scales"):
            setattr(chosen, name, getattr(self, name)[rows])
        for name in ("depths", "target", "_maps", "_known"):
            values = getattr(self, name)
            setattr(chosen, name, None if values is None else values[rows])
        chosen.key = object()
        return chosen

    @property
    def with_probabilities(self) -> bool:
        """True if bodies are compared with probabilities of labels instead of labels."""
        return self._maps is not None

    @cached_property
    def _gather(self) -> LandmarkGather:
        return LandmarkGather(self.observations.marks, self.observations.points.device)

    def __call__(self, parameters: BodyParameters) -> dict[str, torch.Tensor]:
        """Evaluate the weighted terms by name, shape (B,) each."""
        posed = parameters.posed()
        if self.target is None or self._maps is not None or self.observations.lens is not None:
            return self.terms(parameters, posed)
        found = self.terms(parameters, posed, [term.name for term in TERMS if term is not SEG])
        # The label loss is found from the parameters, so that posing and drawing are one graph.
        renderer = self._fix(parameters, posed)
        found[SEG.name] = self.weight(SEG) * renderer.crop_loss(parameters, self.target, part_labels=self._part_labels)
        return {term.name: found[term.name] for term in TERMS if term.name in found}

    def terms(
        self, parameters: BodyParameters, posed: Posed, names: Collection[str] | None = None
    ) -> dict[str, torch.Tensor]:
        """Evaluate the weighted terms of posed bodies by name, shape (B,) each; ``names`` leaves other terms out."""
        return {
            term.name: self.weight(term) * term.value(self, parameters, posed)
            for term in TERMS
            if term.applies(self) and (names is None or term.name in names)
        }

    def weight(self, term: Term) -> float:
        """Factor of a term's value: its weight times the factor that brings the value to the term's unit."""
        weight: float = getattr(self.weights, term.name)
        return weight * term.factor(self)

    @property
    def scale_of_labels(self) -> float:
        """Number of pixels of a crop of 256 px that one pixel of the drawn crop covers."""
        return (REFERENCE_SIZE / self.size) ** 2

    def segmentation(self, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
        """Evaluate L_seg against labels, or against probabilities if the energy has them [drawn px], shape (B,)."""
        renderer, labels = self._fix(parameters, posed), self._part_labels
        posed, camera = self.place(parameters, posed, self.size)
        if self._maps is None:
            assert self.target is not None
            return renderer.label_loss(posed, camera, self.target, part_labels=labels, validate=False)[0]
        size, count = (self.size, self.size), self._maps.shape[1]
        maps = renderer.draw(posed, camera, size, part_labels=labels, num_maps=count, validate=False).maps
        assert maps is not None
        assert self._known is not None
        return ((maps - self._maps).square() * self._known[:, None]).sum((1, 2, 3))

    def place(self, parameters: BodyParameters, posed: Posed, size: int) -> tuple[Posed, Camera]:
        """Place bodies before the camera that draws the crop at ``size`` px.

        The camera is the observation's, or weak perspective if the observation has no lens.
        """
        return place_bodies(parameters, posed, self.observations.lens, size)

    def _fix(self, parameters: BodyParameters, posed: Posed) -> Renderer:
        """Find the renderer with the level that the first bodies need; later calls use it again."""
        if self._fixed is None:
            self._fixed = self.renderer.fixed(*self.place(parameters, posed, self.size))
        return self._fixed

    def misses(self, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
        """Evaluate the weighted sum of L1 distances from keypoints [half-sides of the crop], shape (B,)."""
        posed, camera = self.place(parameters, posed, 2)
        image = camera.project(self._gather(posed))[..., :2] - 1
        return ((image - self.observations.points).abs().sum(-1) * self.landmark_weights).sum(1)

    def reprojection(self, parameters: BodyParameters, posed: Posed) -> torch.Tensor:
        """Evaluate the reprojection cost L_proj: ``misses`` in pixels of a crop of 256 px, shape (B,)."""
        return self.misses(parameters, posed) * (REFERENCE_SIZE / 2)


@device_cache(256)
def _landmark_parts(names: tuple[str, ...], device: torch.device) -> torch.Tensor:
    """Part that each landmark lies on, shape (L,), int64."""
    with torch.inference_mode(False):  # the cached tensor also serves calls outside of inference mode
        return torch.from_numpy(landmark_points(names).parts[:, 0].astype(np.int64)).to(device)
