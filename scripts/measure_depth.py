"""Measure and print how sure the label network is of depth, and what flips repair, on people it was not trained on.

    python scripts/measure_depth.py [FIRST LAST]

* Spreads: the share of joints of PartBench's people whose depth lies within the spread that the network states for it,
  which is to be 68 %.
* Flips: of 40 EllipBodies with a limb mirrored in depth, keypoints equal to the pixel and labels their own, how many
  get the right depth order back, by 50 iterations alone, with the z gradient at two weights, and by flips.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
import warp as wp

from warp_partdr import FitOptions, fit_body
from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.rotations import rotation_to_6d
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import JOINT_NAMES
from warp_partdr.evaluation.partbench.samples import make_sample
from warp_partdr.fit.depth_flips import FLIP_WEIGHTS, flip_depths, repair_depth_order
from warp_partdr.inputs.observation import Observation
from warp_partdr.network.predicted import posed_landmarks
from warp_partdr.refinement.energy import Energy
from warp_partdr.refinement.refine import refine
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.renderers import RendererEllipsoids
from warp_partdr.synthetic import people
from warp_partdr.synthetic.poses import draw_from_prior

CASES = 40
_FIRST_CASE = 440  # those before were looked at while the margin was chosen
_SIZE = 96  # [px]
_TELLS = 0.01  # of the body's pixels that must change with the flip
_LANDMARKS = skeleton("coco17").landmarks


@dataclass(frozen=True)
class Crossed:
    """A body, the same with a limb mirrored in depth, and what is seen of the first."""

    truth: BodyParameters
    mirrored: BodyParameters
    seen: Observation

    def repaired(self, found: BodyParameters) -> bool:
        """True if the joint that was moved most is nearer to the truth than to its mirror image."""
        true, wrong, have = (each.posed().joints[0, :, 2] for each in (self.truth, self.mirrored, found))
        joint = int((wrong - true).abs().argmax())
        return bool((have - true)[joint].abs() < 0.5 * (wrong - true)[joint].abs())


def crossed(seed: int, prior: PosePrior) -> Crossed:
    """Case of a seed: mean adults in poses of the prior, any heading, one of ``flip_depths`` that labels can tell."""
    rng = np.random.default_rng(seed)
    while True:
        drawn = draw_from_prior(rng)
        if drawn is None:
            continue
        yaw, pitch = (torch.tensor([value], dtype=torch.float64) for value in (rng.uniform(-np.pi, np.pi), 0.1))
        orientation = people.seen_by_camera(people.upright(drawn[1], yaw), pitch).float()
        mean = BodyParameters.mean(1)
        turned = {"orientation": rotation_to_6d(orientation), "rotations": drawn[0].float()}
        body = replace(mean, **turned, log_scale=mean.log_scale - 0.1)
        flips, names = flip_depths(body, prior)
        if not names:
            continue
        mirrored = flips.select(torch.tensor([int(rng.integers(len(names))) + 1]))
        right, wrong = (
            draw_ellipsoids(each.posed(), each.camera(512), (512, 512)).labels[0] for each in (body, mirrored)
        )
        if (right != wrong).sum() > _TELLS * (right > 0).sum():
            points = body.camera(2).project(posed_landmarks(body.posed(), _LANDMARKS))[0, :, :2] - 1
            seen = Observation(_LANDMARKS, points, torch.ones(len(points)), right, label_set("ellipbody20"))
            return Crossed(body, mirrored, seen)


def repairs() -> Iterator[tuple[str, int]]:
    """Ways to repair, and of how many cases."""
    prior = PosePrior()
    cases = [crossed(seed, prior) for seed in range(_FIRST_CASE, _FIRST_CASE + CASES)]
    for weight in (0.1, 10.0):
        renderer = RendererEllipsoids("partdr", depth_weight=weight)
        energies = (Energy(case.seen, _SIZE, FLIP_WEIGHTS, prior, renderer=renderer) for case in cases)
        found = [
            refine(case.mirrored, energy, iterations=50, learning_rate=0.02).parameters
            for case, energy in zip(cases, energies, strict=True)
        ]
        yield f"z gradient of weight {weight:g}", sum(map(Crossed.repaired, cases, found))
    flipped = [repair_depth_order(case.mirrored, case.seen, prior)[0] for case in cases]
    yield "flips", sum(map(Crossed.repaired, cases, flipped))
    kept = [repair_depth_order(case.truth, case.seen, prior)[1].flipped is None for case in cases]
    yield "right bodies that stay as they are", sum(kept)


def shares(first: int, last: int, level: str) -> tuple[np.ndarray, int]:
    """Share of people whose joint lies within the stated spread, each of LSP's joints no hips; and how many flip."""
    within, flipped, prior = [], 0, PosePrior()
    for index in range(first, last + 1):
        sample = make_sample(index, level)
        options = FitOptions(stages=(), search=())
        result = fit_body(sample.keypoints, sample.parts, others=sample.others, options=options)
        assert sample.joints is not None
        assert result.uncertainty is not None
        names = [name for name in sample.joint_names if name in JOINT_NAMES and not name.endswith("hip")]
        rows = [sample.joint_names.index(name) for name in names]
        hips = [sample.joint_names.index(f"{side}_hip") for side in ("left", "right")]
        true = sample.joints[rows, 2] - sample.joints[hips, 2].mean()
        found = result.posed.joints[0, [JOINT_NAMES.index(name) for name in names], 2]
        spread = result.uncertainty.depths[0, [JOINT_NAMES.index(name) - 1 for name in names]]
        within.append(np.abs(found.numpy() - true) < spread.numpy())
        flipped += repair_depth_order(result.parameters, result.observation, prior)[1].flipped is not None
    return np.mean(within, axis=0), flipped


def main(first: int = 200, last: int = 299) -> None:
    wp.config.log_level = wp.LOG_WARNING
    for level in ("realistic", "hard", "tilted"):
        found, flipped = shares(first, last, level)
        share, low, high = (100 * value for value in (found.mean(), found.min(), found.max()))
        print(f"{level}: {share:.0f} % of depths within their 68 %; {low:.0f} to {high:.0f} % by joint")
        print(f"{level}: flips of {flipped} of {last - first + 1} people accepted")
    for way, count in repairs():
        print(f"{way}: {count} of {CASES}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
