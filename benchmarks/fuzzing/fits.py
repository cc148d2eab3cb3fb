"""Fits, refinements and registrations of the mean body."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from fuzzing.bodies import prior
from fuzzing.case import Case
from warp_partdr import label_set, skeleton
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import Observation
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.models.anny import anny
from warp_partdr.models.registration import RegistrationOptions, register
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.render.renderers import RendererEllipsoids, RendererMesh
from warp_partdr.solve.ellipsoids.energy import Energy
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.refine import refine
from warp_partdr.solve.ellipsoids.stages import Stage
from warp_partdr.solve.ellipsoids.stepper import Refinement


@lru_cache
def person(device: str) -> tuple[Keypoints2D, np.ndarray]:
    """Perfect keypoints and labels of the mean body, 96 x 80 px, drawn on a device."""
    body = BodyParameters.mean(1, device=device)
    seen = replace(body.camera(80), translation=torch.tensor([[40.0, 45.0]], device=device))
    names = skeleton("coco17").marks
    points = seen.project(LandmarkGather(names, device)(body.posed()))[0, :, :2].cpu().numpy()
    labels = draw_ellipsoids(body.posed(), seen, (96, 80)).labels[0].cpu().numpy()
    return Keypoints2D("coco17", points.astype(np.float32), np.ones(17, dtype=np.float32)), labels


@lru_cache
def anny_model(device: str) -> Any:
    return anny(torch.device(device), torch.float32)


def keypoints_of(case: Case) -> Keypoints2D:
    known, _ = person(case.device)
    points = known.points + case.rng.normal(0, 2, known.points.shape).astype(np.float32)
    return Keypoints2D(
        case.either("coco17", "lsp14", "nobody"),
        case.array(points),
        case.array(known.confidence * case.rng.random(17).astype(np.float32)),
    )


def try_fit_body(case: Case) -> Any:
    renderer = case.one([RendererEllipsoids(), RendererMesh()])
    stages = [Stage("lift", 6, 2, 0.1), Stage("keypoints", 4, 2, 0.05), Stage("labels", 2, 2, 0.03, 32)]
    if case.spoils():
        stages = [
            replace(
                stage, iterations=case.number(2, 0), learning_rate=case.number(0.1), size=case.number(stage.size, 1)
            )
            for stage in stages
        ]
    options = FitOptions(
        stages=tuple(replace(stage, renderer=renderer) for stage in stages), start=case.one(["network", "search"])
    )
    labels = person(case.device)[1]
    labels = case.rng.permuted(labels) if case.spoils() else labels
    parts = PartLabels(label_set("ellipbody20"), case.array(labels)) if case.happens(7) else None
    others = [keypoints_of(case)] if case.happens(2) else []
    result = fit_body(keypoints_of(case), parts, others=others, options=options, device=case.device)
    return result.parameters, result.energy, result.posed, result.camera


def try_refine(case: Case) -> Any:
    mean = BodyParameters.mean(case.one([0, 1, 2]), device=case.device).tensors()
    start = BodyParameters(
        **{name: case.maybe(value + case.tensor(*value.shape, scale=0.02)) for name, value in mean.items()}
    )
    observation = Observation(
        skeleton("coco17").landmarks,
        case.tensor(17, 2, scale=0.3),
        torch.ones(17, device=case.device),
        torch.from_numpy(case.rng.integers(0, 21, (16, 16)).astype(np.uint8)).to(case.device),
        label_set("ellipbody20"),
    )
    renderer = RendererEllipsoids(case.one(["edges", "coverage", "partdr"]))
    energy = Energy(observation, size=16, prior=prior(case.device), renderer=renderer)
    iterations, rate = case.number(2, 0), case.number(0.01, 0.0)
    if case.happens(5):
        return refine(start, energy, iterations=iterations, learning_rate=rate)
    return Refinement(start, energy, iterations=iterations, learning_rate=rate).run()


def try_register(case: Case) -> Any:
    posed = BodyParameters.mean(1, device=case.device).posed()
    if case.spoils():
        posed = replace(posed, **{each.name: case.maybe(getattr(posed, each.name)) for each in fields(posed)})
    options = RegistrationOptions(iterations=case.number(2, 0))
    found = register(posed, anny_model(case.device), options=options)
    return found.shape, found.rotations, found.translation, found.detailed, found.losses


def try_model(case: Case) -> Any:
    model = anny_model(case.device)
    batch = case.one([0, 1, 2])
    turns = case.maybe(case.turns(batch, model.num_joints))
    if isinstance(turns, torch.Tensor) and turns.is_floating_point() and not turns.is_sparse and not turns.is_meta:
        case.extreme |= not bool((turns.abs() < 100).all())  # multiplied along chains of a dozen joints
    shape, place = case.maybe(case.tensor(batch, model.num_shapes)), case.maybe(case.tensor(batch, 3))
    detailed = model.pose(shape, turns, place)
    return detailed, model.landmarks(detailed, [case.one(["nose", "left_knee", "tail"])])
