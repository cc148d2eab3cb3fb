"""Accuracy and time of every setting, from the same starts to the same people."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import torch

from ....body.parameters import BodyParameters
from ....body.pose_prior import PosePrior
from ....body.posing import LandmarkGather
from ....body.skeletons import MPJPE_JOINTS
from ....solve.ellipsoids.energy import Weights
from ....solve.ellipsoids.options import FitOptions
from ....solve.ellipsoids.stages import Progress
from ....solve.ellipsoids.stepper import Refinement
from ...evaluation.evaluate import Method, evaluate
from ...evaluation.partbench.methods import METHODS
from ...evaluation.partbench.samples import partbench_samples
from ...synthetic.tradeoff_people import People, make_people
from ..jobs import Job, run_jobs
from ..machine import about
from ..renderers import COVERAGE, LEVELS, MESH, PARTDR
from .fits import one_by_one, own_part_f1, refine_all, score_bodies, time_iteration
from .gradient import gradient_error, true_gradient
from .plan import DISTANCE, ITERATIONS, NAMES, RATE, Setting, TradeoffPlan
from .report import BFLOAT16, FLOAT32, FLOAT64, KEYPOINTS_TOO, LABELS_ALONE, TradeoffReport

_WITHOUT_KEYPOINTS = Weights(proj=0.0)
_LEVELS = ("clean", "realistic")  # of PartBench


def run_tradeoff(plan: TradeoffPlan, progress: Progress | None = None) -> TradeoffReport:
    """Measure all of a plan."""
    report = TradeoffReport(plan.device, about(plan.device))
    if progress is not None:
        progress("making people", 0, 1)
    own, annys = (people.to(plan.device) for people in make_people(plan.ellipbodies, plan.annys))
    jobs = [
        *_time_jobs(plan, report, own),
        *_fit_jobs(plan, report, (own, annys)),
        *_gradient_jobs(plan, report, own),
        *_precision_jobs(report, own),
        *_quality_jobs(plan, report),
    ]
    run_jobs(jobs, progress)
    return report


def _time_jobs(plan: TradeoffPlan, report: TradeoffReport, people: People) -> Iterator[Job]:
    start = people.starts(DISTANCE)

    def work(name: str, size: int) -> None:
        fastest = time_iteration(Setting(name, size), people, start, plan.device, plan.budget)
        seconds = {"seconds": float(np.median(fastest)), "fastest_of_each_person_s": fastest}
        report.times.append({"renderer": name, "size_px": size, **seconds})

    for name, size in product(NAMES, plan.sizes):
        yield f"time, {name}, {size} px", partial(work, name, size)


def _fit_jobs(plan: TradeoffPlan, report: TradeoffReport, crowds: tuple[People, ...]) -> Iterator[Job]:
    """All settings from the middle distance; from the others, and with labels alone, fewer."""
    settings = (Setting(*each) for each in product(NAMES, plan.sizes, plan.iterations))
    for setting, people, distance in product(settings, crowds, plan.distances):
        if setting.iterations == ITERATIONS or distance == DISTANCE:
            job = partial(_fit, report, people, setting, distance)
            yield f"{people.name}, {setting.name}, {setting.size} px", partial(job, KEYPOINTS_TOO)
            if setting == Setting(setting.name):
                yield f"{people.name}, {setting.name}, labels alone", partial(job, LABELS_ALONE)


def _fit(report: TradeoffReport, people: People, setting: Setting, distance: float, seen: str) -> None:
    weights = _WITHOUT_KEYPOINTS if seen == LABELS_ALONE else None
    bodies, seconds = refine_all(setting, people, people.starts(distance), weights)
    is_mesh = setting.name in LEVELS and setting == Setting(setting.name)
    report.fits.append(
        {
            **{"truth": people.name, "seen": seen, **setting.columns, "distance_rad": distance},
            **score_bodies(bodies, people),
            "own_part_f1": own_part_f1(setting, bodies, people) if is_mesh else None,
            "batch_seconds": seconds,
        }
    )


def _gradient_jobs(plan: TradeoffPlan, report: TradeoffReport, people: People) -> Iterator[Job]:
    def work(distance: float) -> None:
        bodies = people.starts(distance)
        true = true_gradient(people, bodies)
        for name, size in product(NAMES, plan.sizes):
            error = gradient_error(Setting(name, size), people, bodies, true)
            report.gradients.append({"renderer": name, "size_px": size, "distance_rad": distance, **error})

    for distance in plan.gradient_distances:
        yield f"gradients, {distance} rad off", partial(work, distance)


def _precision_jobs(report: TradeoffReport, people: People) -> Iterator[Job]:
    for name in (MESH, PARTDR, COVERAGE):
        yield f"numbers, {name}", partial(_compare_numbers, report, people, Setting(name))


def _compare_numbers(report: TradeoffReport, people: People, setting: Setting) -> None:
    """Compare a refinement with posing, losses and Adam in float32 and in float64; kernels draw in float32.

    The bodies found in float32 are also compared after rounding to bfloat16.
    """
    start, gather = people.starts(DISTANCE), LandmarkGather(MPJPE_JOINTS, people.labels.device)
    found: dict[str, BodyParameters] = {}
    seconds: dict[str, float] = {}
    for numbers, kind in ((FLOAT32, torch.float32), (FLOAT64, torch.float64)):
        begin = time.perf_counter()
        found[numbers] = _refine_in_torch(setting, people, start, kind)
        seconds[numbers] = (time.perf_counter() - begin) / (len(people) * setting.iterations)
    found[BFLOAT16], seconds[BFLOAT16] = _cast(found[FLOAT32], torch.bfloat16, torch.float32), seconds[FLOAT32]
    reference = gather(found[FLOAT32].posed())
    for numbers, kept in found.items():
        bodies = _cast(kept, torch.float32)
        moved = 1000 * float((gather(bodies.posed()) - reference).norm(dim=-1).mean())
        row = {"renderer": setting.name, "numbers": numbers, **score_bodies(bodies, people)}
        report.precisions.append({**row, "moved_mm": moved, "seconds": seconds[numbers]})


def _refine_in_torch(setting: Setting, people: People, start: BodyParameters, kind: torch.dtype) -> BodyParameters:
    prior = PosePrior().to(start.shift.device, kind)
    found = []
    for person, body in enumerate(one_by_one(_cast(start, kind))):
        seen = people.observations().select(slice(person, person + 1))
        energy = setting.energy(replace(seen, points=seen.points.to(kind)), prior)
        refined = Refinement(body, energy, iterations=setting.iterations, learning_rate=RATE).run()
        found.append(refined.parameters.tensors().values())
    return BodyParameters(*(torch.cat(column) for column in zip(*found, strict=True)))


def _cast(bodies: BodyParameters, *kinds: torch.dtype) -> BodyParameters:
    """Numbers of the first kind, then of the next: what it lost stays lost."""
    tensors = bodies.tensors()
    for kind in kinds:
        tensors = {name: tensor.to(kind) for name, tensor in tensors.items()}
    return BodyParameters(**tensors)


def _quality_jobs(plan: TradeoffPlan, report: TradeoffReport) -> Iterator[Job]:
    """Whole fits, one person at a time, so that none is slowed by another."""

    def work(level: str) -> None:
        methods: dict[str, Method] = {
            "fast": Method(options=FitOptions.at("fast")),
            "balanced": Method(options=FitOptions.at("balanced")),
            "balanced, outline": Method(options=FitOptions.at("balanced").with_outline()),
        }
        methods["mesh stage"] = METHODS["parts, Anny's mesh"]
        found = evaluate(partbench_samples(plan.fits, (level,)), methods, device=plan.device)
        report.qualities[level] = next(iter(found.pooled().values()))

    if plan.fits:
        for level in _LEVELS:
            yield f"whole fits, {level}", partial(work, level)
