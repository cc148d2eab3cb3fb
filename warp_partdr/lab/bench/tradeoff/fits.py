"""Refinements of people of known truth: their errors, and the time of an iteration."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from ....body.parameters import BodyParameters
from ....body.pose_prior import packaged_prior
from ....body.posing import LandmarkGather
from ....body.skeletons import MPJPE_JOINTS
from ....body.template import NUM_PARTS
from ....metrics import accuracy, confusion, pa_mpjpe, part_f1
from ....render.renderers import RendererMesh
from ....solve.ellipsoids.captured import CapturedRefinement
from ....solve.ellipsoids.energy import Energy, Weights
from ....solve.ellipsoids.refine import refine
from ....solve.ellipsoids.stepper import Refined
from ...synthetic.tradeoff_people import TRUTH_SIZE, People, draw_truth
from ..timing import time_calls
from .plan import RATE, Setting

_SCORED = TRUTH_SIZE // 3  # [px], side of the pictures that are compared
_TIMED_PEOPLE, _TIMED_ITERATIONS = 4, 5


def score_bodies(bodies: BodyParameters, people: People) -> dict[str, np.ndarray]:
    """Nearness of a body for each person to the truth, shape (N,) each.

    Returns:
        ``part_f1`` of 20 parts and background, of exact ellipsoids at 512 px; ``accuracy``, the share of the picture's
        pixels with the right label; ``joint_error_mm``, the mean distance of 14 joints after the best similarity.
    """
    counts = _confusion(draw_truth(bodies, _SCORED), people)
    joints = LandmarkGather(MPJPE_JOINTS, bodies.shift.device)(bodies.posed())
    errors = 1000 * pa_mpjpe(joints, people.joints)
    return {"part_f1": part_f1(counts), "accuracy": accuracy(counts), "joint_error_mm": errors.cpu().numpy()}


def own_part_f1(setting: Setting, bodies: BodyParameters, people: People) -> np.ndarray:
    """Part F1, shape (N,), of the bodies as the setting's renderer draws them."""
    size = _SCORED, _SCORED
    drawn = [setting.renderer.draw(body.posed(), body.camera(_SCORED), size).labels for body in one_by_one(bodies)]
    return part_f1(_confusion(torch.cat(drawn), people))


def _confusion(drawn: torch.Tensor, people: People) -> np.ndarray:
    """Pixels by label that is drawn and true one, at the centres of the compared pictures' pixels."""
    return confusion(drawn, people.labels[:, 1::3, 1::3], NUM_PARTS + 1)


def one_by_one(bodies: BodyParameters) -> list[BodyParameters]:
    """Batches of one body each."""
    return [bodies.select(index) for index in torch.arange(bodies.batch_size, device=bodies.shift.device).split(1)]


def refine_all(
    setting: Setting, people: People, start: BodyParameters, weights: Weights | None = None
) -> tuple[BodyParameters, float]:
    """Refine a body for each person, as the library would: one graph for exact ellipsoids, torch for meshes.

    Returns:
        The bodies, and the seconds that an iteration took for one of them.
    """
    prior = packaged_prior(str(start.shift.device))
    run = _refinement(setting, setting.energy(people.observations(), prior, weights), len(people))
    begin = time.perf_counter()
    found = run(start)
    float(found.energy.sum())  # until the device is done
    seconds = time.perf_counter() - begin
    return found.parameters, seconds / (len(people) * setting.iterations)


def time_iteration(setting: Setting, people: People, start: BodyParameters, device: str, budget: float) -> list[float]:
    """Time of one body's refinement without its set-up [s an iteration]: the fastest run of each of a few people.

    Runs are short, so that some of them are disturbed by nothing else on the machine.
    """
    setting = replace(setting, iterations=_TIMED_ITERATIONS)
    prior = packaged_prior(str(start.shift.device))
    bodies = one_by_one(start)[:_TIMED_PEOPLE]
    fastest = []
    for person, body in enumerate(bodies):
        run = partial(
            _refinement(setting, setting.energy(people.observations().select(slice(person, person + 1)), prior), 1),
            body,
        )
        fastest.append(time_calls(run, device, budget / len(bodies)).fastest / setting.iterations)
    return fastest


def _refinement(setting: Setting, energy: Energy, batch_size: int) -> Callable[[BodyParameters], Refined]:
    """A refinement of so many bodies."""
    if isinstance(setting.renderer, RendererMesh):
        return partial(refine, energy=energy, iterations=setting.iterations, learning_rate=RATE)
    captured = CapturedRefinement(energy, batch_size, iterations=setting.iterations, learning_rate=RATE)
    return captured.refine
