"""PartBench's level "crossed": bodies with a limb mirrored in depth, of which labels alone can tell.

EllipBodies themselves, keypoints equal to the pixel and labels their own: depth order, and nothing else, is at stake.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch

from ....body.labels import label_set
from ....body.parameters import BodyParameters
from ....body.pose_prior import PosePrior, packaged_prior
from ....body.posing import LandmarkGather
from ....body.rotations import rotation_to_6d
from ....body.skeletons import MPJPE_JOINTS, skeleton
from ....cameras import Crop
from ....errors import check_whole
from ....inputs.evidence import weigh_evidence
from ....inputs.keypoints import Keypoints2D
from ....inputs.observation import crop_evidence
from ....inputs.part_labels import PartLabels
from ....inputs.sample import Sample
from ....render.ellipsoids import draw_ellipsoids
from ....render.renderers import RendererEllipsoids
from ....solve.ellipsoids.depth_flips import FLIP_WEIGHTS, flip_depths
from ....solve.ellipsoids.fitting import fit_evidence
from ....solve.ellipsoids.options import FitOptions
from ....solve.ellipsoids.result import FitResult
from ....solve.ellipsoids.stages import Stage
from ...synthetic.people import seen_by_camera, upright
from ...synthetic.poses import draw_from_prior
from ..evaluate import Method
from .samples import CROSSED, source_name

CASES = 40
MIRRORED = "mirrored start, default fit"
_FIRST_CASE = 440  # those before were looked at while the margin of flips was chosen
_SIDE = 512  # [px], of the picture
_PITCH = 0.1  # [rad], of the camera
_TELLS = 0.01  # of the body's pixels that must change with the flip
_SKELETON = skeleton("coco17")


@dataclass(frozen=True)
class CrossedSample(Sample):
    """Body of which keypoints tell all but the depth order of a limb.

    Attributes:
        truth: Body in the picture of side 2.
        wrong: Body with the limb mirrored in depth.
    """

    truth: BodyParameters = field(default_factory=lambda: BodyParameters.mean(1))
    wrong: BodyParameters = field(default_factory=lambda: BodyParameters.mean(1))


@dataclass(frozen=True)
class CrossedMethod(Method):
    """Fit from the mirrored body, or from the true one, in place of the network's."""

    from_truth: bool = False

    def serves(self, sample: object) -> bool:
        """True for people of the level."""
        return isinstance(sample, CrossedSample)

    def fit_sample(self, sample: Sample, device: str) -> FitResult:
        """Fit one person."""
        assert isinstance(sample, CrossedSample)
        evidence = weigh_evidence(sample.keypoints, sample.parts)[0]
        crop = crop_evidence(evidence)[1]
        start = _in_crop(sample.truth if self.from_truth else sample.wrong, crop)
        return fit_evidence([evidence], self.options, device=device, body=start.to(device))


def _in_crop(body: BodyParameters, crop: Crop) -> BodyParameters:
    """Body of the picture of side 2 in a crop of it."""
    half = crop.size[0] / 2
    shift = crop.to_crop((body.shift + 1) * (_SIDE / 2)) / half - 1
    return replace(body, log_scale=body.log_scale + float(np.log(crop.zoom * _SIDE / 2 / half)), shift=shift)


def _refined(renderer: RendererEllipsoids, *, depth_flips: bool = False) -> CrossedMethod:
    """50 iterations in which labels lead."""
    stage = Stage("labels", 1, 50, 0.02, 96, FLIP_WEIGHTS, renderer)
    return CrossedMethod(options=FitOptions(stages=(stage,), search=(), depth_flips=depth_flips))


CROSSED_METHODS: dict[str, CrossedMethod] = {
    "mirrored start, 50 iterations": _refined(RendererEllipsoids("edges")),
    **{
        f"mirrored start, z gradient {weight:g}": _refined(RendererEllipsoids("partdr", depth_weight=weight))
        for weight in (0.1, 10.0)
    },
    "mirrored start, depth flips": _refined(RendererEllipsoids("edges"), depth_flips=True),
    MIRRORED: CrossedMethod(),
    "true start, default fit": CrossedMethod(from_truth=True),
}


def crossed_samples(count: int = CASES) -> list[CrossedSample]:
    """The first cases of the level.

    Raises:
        ValueError: If the count is not positive.
    """
    prior = packaged_prior("cpu")
    return [make_crossed(index, prior) for index in range(check_whole("count", count, 1))]


def make_crossed(index: int, prior: PosePrior) -> CrossedSample:
    """Case of an index: a mean adult in a pose of the prior, any heading, one of ``flip_depths`` that labels tell."""
    rng = np.random.default_rng(_FIRST_CASE + index)
    while True:
        drawn = draw_from_prior(rng)
        if drawn is None:
            continue
        yaw, pitch = (torch.tensor([value], dtype=torch.float64) for value in (rng.uniform(-np.pi, np.pi), _PITCH))
        orientation = rotation_to_6d(seen_by_camera(upright(drawn[1], yaw), pitch).float())
        mean = BodyParameters.mean(1)
        size = mean.log_scale - 0.1
        body = replace(mean, orientation=orientation, rotations=drawn[0].float(), log_scale=size)
        flips, names = flip_depths(body, prior)
        if not names:
            continue
        chosen = int(rng.integers(len(names)))
        wrong = flips.select(torch.tensor([chosen + 1]))
        shown, other = (
            draw_ellipsoids(each.posed(), each.camera(_SIDE), (_SIDE, _SIDE)).labels[0].numpy()
            for each in (body, wrong)
        )
        if (shown != other).sum() > _TELLS * (shown > 0).sum():
            return _sample(f"{index}, {names[chosen]}", body, wrong, shown)


def _sample(name: str, body: BodyParameters, wrong: BodyParameters, labels: np.ndarray) -> CrossedSample:
    marks = body.camera(_SIDE).project(LandmarkGather(_SKELETON.marks, "cpu")(body.posed()))[0, :, :2].numpy()
    joints, mirrored = (LandmarkGather(MPJPE_JOINTS, "cpu")(each.posed())[0].numpy() for each in (body, wrong))
    return CrossedSample(
        source=source_name(CROSSED),
        name=name,
        keypoints=Keypoints2D(_SKELETON.name, marks, np.ones(len(marks), dtype=np.float32)),
        parts=PartLabels(label_set("ellipbody20"), labels),
        target=labels,
        joints=joints,
        mirrored=mirrored,
        truth=body,
        wrong=wrong,
    )
