"""Refinements of people of known truth: their errors, and the time of an iteration."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch

from ...body.parameters import BodyParameters
from ...body.pose_prior import PosePrior
from ...body.posing import LandmarkGather
from ...body.template import NUM_PARTS
from ...metrics import accuracy, confusion, pa_mpjpe, part_f1
from ...refinement.captured import CapturedRefinement
from ...refinement.energy import Weights
from ...refinement.refine import refine
from ...render.renderers import RendererMesh
from ...synthetic.tradeoff_people import JOINTS, TRUTH_SIZE, People, draw_truth
from ..timing import Timing, time_calls
from .plan import RATE, Setting

_SCORED = TRUTH_SIZE // 3  # [px], side of the pictures that are compared
_TIMED_PEOPLE, _TIMED_ITERATIONS = 4, 5


@dataclass(frozen=True)
class Scores:
    """Nearness of bodies to the truth, an array of shape (N,) each.

    Attributes:
        part_f1: Of 20 parts and background, of exact ellipsoids at 512 px.
        accuracy: Share of the picture's pixels with the right label.
        joint_error_mm: Mean distance of 14 joints after the best similarity.
    """

    part_f1: np.ndarray
    accuracy: np.ndarray
    joint_error_mm: np.ndarray


def score_bodies(bodies: BodyParameters, people: People) -> Scores:
    """Compare a body for each person with the truth."""
    counts = _confusion(draw_truth(bodies, _SCORED), people)
    joints = LandmarkGather(JOINTS, bodies.shift.device)(bodies.posed())
    error = 1000 * pa_mpjpe(joints, people.joints)
    return Scores(part_f1(counts), accuracy(counts), error.cpu().numpy())


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
    prior = PosePrior().to(start.shift.device)
    run: Callable[..., object]
    if isinstance(setting.renderer, RendererMesh):
        # Each term of the energy broadcasts: with all points and labels as one observation, it is that of each body.
        energy = setting.energy(people.observation(), prior, weights)
        run = partial(refine, energy=energy, iterations=setting.iterations, learning_rate=RATE)
    else:
        energies = [setting.energy(people.observation(index), prior, weights) for index in range(len(people))]
        run = CapturedRefinement(energies, len(people), iterations=setting.iterations, learning_rate=RATE).refine
    begin = time.perf_counter()
    found = run(start)
    float(found.energy.sum())  # until the device is done
    seconds = time.perf_counter() - begin
    return found.parameters, seconds / (len(people) * setting.iterations)


def time_iteration(setting: Setting, people: People, start: BodyParameters, device: str, budget: float) -> Timing:
    """Of one body's refinement without its set-up: the fastest run of each of a few people [s an iteration].

    Runs are short, so that some of them are disturbed by nothing else on the machine.
    """
    setting = replace(setting, iterations=_TIMED_ITERATIONS)
    prior = PosePrior().to(start.shift.device)
    bodies = one_by_one(start)[:_TIMED_PEOPLE]
    fastest = []
    for person, body in enumerate(bodies):
        energy = setting.energy(people.observation(person), prior)
        if isinstance(setting.renderer, RendererMesh):
            run: Callable[[], object] = partial(refine, body, energy, iterations=setting.iterations)
        else:
            run = partial(CapturedRefinement(energy, 1, iterations=setting.iterations).refine, body)
        fastest.append(time_calls(run, device, budget / len(bodies)).fastest / setting.iterations)
    return Timing(tuple(fastest))
