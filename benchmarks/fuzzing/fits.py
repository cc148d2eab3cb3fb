"""Fits, refinements and registrations of the mean body."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

import warp_partdr
from fuzzing.chance import Chance
from warp_partdr import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.clothing.anny import anny
from warp_partdr.clothing.registration import RegistrationOptions, register
from warp_partdr.fit.fitting import fit_body
from warp_partdr.fit.options import FitOptions
from warp_partdr.fit.stages import Stage
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import Observation
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.refinement.energy import Energy
from warp_partdr.refinement.refine import refine
from warp_partdr.refinement.stepper import Refinement
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh


@lru_cache
def person(device: str) -> tuple[Keypoints2D, np.ndarray]:
    """Perfect keypoints and labels of the mean body, 96 x 80 px, drawn on a device."""
    body = BodyParameters.mean(1, device=device)
    seen = replace(body.camera(80), translation=torch.tensor([[40.0, 45.0]], device=device))
    names = warp_partdr.skeleton("coco17").landmarks
    points = seen.project(LandmarkGather(names, device)(body.posed()))[0, :, :2].cpu().numpy()
    labels = draw_ellipsoids(body.posed(), seen, (96, 80)).labels[0].cpu().numpy()
    return Keypoints2D("coco17", points.astype(np.float32), np.ones(17, dtype=np.float32)), labels


@lru_cache
def prior(device: str) -> PosePrior:
    return PosePrior().to(device)


@lru_cache
def anny_model(device: str) -> Any:
    return anny(torch.device(device), torch.float32)


def keypoints_of(chance: Chance) -> Keypoints2D:
    known, _ = person(chance.device)
    points = known.points + chance.rng.normal(0, 2, known.points.shape).astype(np.float32)
    return Keypoints2D(
        chance.either("coco17", "lsp14", "nobody"),
        chance.array(points),
        chance.array(known.confidence * chance.rng.random(17).astype(np.float32)),
    )


def try_fit_body(chance: Chance) -> Any:
    stages = (Stage("lift", 6, 2, 0.1), Stage("keypoints", 4, 2, 0.05), Stage("labels", 2, 2, 0.03, 32))
    labels = person(chance.device)[1]
    if chance.spoils():
        labels = chance.rng.permutation(labels.reshape(-1)).reshape(labels.shape)
    parts = PartLabels(label_set("ellipbody20"), chance.array(labels)) if chance.rng.random() < 0.7 else None
    if chance.spoils():
        stages = tuple(
            replace(
                stage,
                iterations=chance.number(2, 0),
                learning_rate=chance.number(0.1),
                size=chance.number(stage.size, 1),
            )
            for stage in stages
        )
    renderer = chance.one([RendererEllipsoids(), RendererMesh()])
    stages = tuple(replace(stage, renderer=renderer) for stage in stages)
    options = FitOptions(stages=stages, start=chance.one(["network", "search"]))
    others = [keypoints_of(chance)] if chance.rng.random() < 0.2 else []
    result = fit_body(keypoints_of(chance), parts, others=others, options=options, device=chance.device)
    return result.parameters, result.energy, result.posed, result.camera


def try_refine(chance: Chance) -> Any:
    batch = chance.one([0, 1, 2])
    mean = BodyParameters.mean(batch, device=chance.device)
    start = BodyParameters(
        **{
            name: chance.maybe(value + chance.tensor(*value.shape, scale=0.02))
            for name, value in mean.tensors().items()
        }
    )
    names = warp_partdr.skeleton("coco17").landmarks
    labels = torch.from_numpy(chance.rng.integers(0, 21, (16, 16)).astype(np.uint8)).to(chance.device)
    observation = Observation(
        names, chance.tensor(17, 2, scale=0.3), torch.ones(17, device=chance.device), labels, label_set("ellipbody20")
    )
    renderer = RendererEllipsoids(chance.one(["edges", "coverage", "partdr"]))
    energy = Energy(observation, size=16, prior=prior(chance.device), renderer=renderer)
    rule = {"iterations": chance.number(2, 0), "learning_rate": chance.number(0.01, 0.0)}
    return refine(start, energy, **rule) if chance.rng.random() < 0.5 else Refinement(start, energy, **rule).run()


def try_register(chance: Chance) -> Any:
    posed = BodyParameters.mean(1, device=chance.device).posed()
    if chance.spoils():
        posed = replace(posed, **{each.name: chance.maybe(getattr(posed, each.name)) for each in fields(posed)})
    options = RegistrationOptions(iterations=chance.number(2, 0), learning_rate=chance.number(0.01))
    found = register(posed, anny_model(chance.device), options=options)
    return found.shape, found.rotations, found.translation, found.detailed, found.losses


def try_model(chance: Chance) -> Any:
    model = anny_model(chance.device)
    batch = chance.one([0, 1, 2])
    turns = chance.maybe(chance.turns(batch, model.num_joints))
    if isinstance(turns, torch.Tensor) and turns.is_floating_point() and not turns.is_sparse and not turns.is_meta:
        chance.extreme |= not bool((turns.abs() < 100).all())  # multiplied along chains of a dozen joints
    shape, place = chance.maybe(chance.tensor(batch, model.num_shapes)), chance.maybe(chance.tensor(batch, 3))
    detailed = model.pose(shape, turns, place)
    return detailed, model.landmarks(detailed, [chance.one(["nose", "left_knee", "tail"])])
