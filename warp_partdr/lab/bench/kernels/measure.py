"""Times of every kernel, of both renderers and of the whole iteration, on one device."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import torch

from ....body.parameters import BodyParameters
from ....solve.ellipsoids.energy import Energy
from ....solve.ellipsoids.refine import refine
from ....solve.ellipsoids.stages import Progress
from ....solve.ellipsoids.stepper import Refined, Refinement
from ..jobs import run_jobs
from ..launches import count_bytes, observe_launches, time_kernels
from ..machine import about, copy_bandwidth
from ..renderers import COVERAGE, EXACT, GRADIENTS, LEVELS, MESH, PARTDR
from ..scene import BenchScene
from ..timing import Timing, capture, peak_memory, time_calls, time_graph
from .calls import CALLS_OF, mesh_view
from .first_call import time_first_calls
from .peer_gradients import measure_gradients
from .peers import OURS, PEERS
from .plan import (
    CALLS,
    GRADIENT,
    KERNELS,
    LABELS,
    OTHERS,
    PEER_ROWS,
    REFINEMENT,
    STARTS,
    STEPS,
    TARGETS,
    TORCH_REFINEMENT,
    KernelPlan,
    Run,
)
from .report import NOTES, copy_share, make_row
from .runs import NUM_ITERATIONS, ExactRun, KinematicsRun, MeshRun, refined_once
from .start import time_commands, time_starts
from .whole_steps import time_steps

_Rows = list[dict[str, Any]]  # of ``make_row``
_Jobs = Iterator[tuple[str, Callable[[], _Rows]]]


def run_kernels(plan: KernelPlan, progress: Progress | None = None) -> dict[str, Any]:
    """Time all of a plan; returns figures for JSON, with one of ``remarks`` for each thing that could not be timed.

    Raises:
        AssertionError: If what would be timed is not what the library computes.
    """
    bandwidth = copy_bandwidth(plan.device, plan.budget)
    rows: _Rows = []
    remarks: list[str] = []

    def add(job: Callable[[], _Rows]) -> None:
        rows.extend({**row, "share_of_copy_bandwidth": copy_share(row, bandwidth)} for row in job())
        gc.collect()  # buffers of large batches, before the next job makes its own

    jobs = [*_render_jobs(plan), *_step_jobs(plan), *_kernel_jobs(plan), *_peer_jobs(plan, remarks)]
    if plan.start:
        jobs.append(("cold and warm start", partial(_time_starts, plan)))
        jobs.append(("first call", partial(_time_first_calls, plan)))
    gradients: list[dict[str, Any]] = []

    def compare() -> None:
        gradients.extend(measure_gradients(plan.size, plan.device, remarks))

    named = [(name, partial(add, job)) for name, job in jobs]
    run_jobs([*named, ("gradients of meshes", compare)] if plan.gradients else named, progress)
    return {
        "device": plan.device,
        "machine": about(plan.device),
        "copy_bandwidth_bytes_per_second": bandwidth,
        "rows": rows,
        "gradients": gradients,
        "remarks": remarks,
        "notes": NOTES,
    }


def _render_jobs(plan: KernelPlan) -> _Jobs:
    for group, runs in ((TARGETS, plan.targets), (CALLS, plan.calls), (OTHERS, plan.others)):
        for run in runs:
            what, name, batch, size = run
            yield f"{what}, {name}, B = {batch}, {size} px", partial(_time, plan, group, run)


def _time(plan: KernelPlan, group: str, wanted: Run) -> _Rows:
    """One row, of a renderer or of the refinement."""
    what, name, batch, size = wanted
    scene = BenchScene.random(batch, size, plan.device)
    row = partial(make_row, group, wanted)
    if what in (LABELS, GRADIENT):
        run = _renderer(scene, name)
        run.check()
        launch = run.labels if what == LABELS else run.gradient
        launches = observe_launches(launch)
        timing = time_graph(capture(launch, plan.device), plan.device, plan.budget)
        moved = sum(launched.bytes for launched in launches)
        return [row("graph", timing, moved=moved, memory=count_bytes(launches))]
    if what == REFINEMENT:
        captured = refined_once(scene, GRADIENTS[name])
        launches = observe_launches(captured.iterate)
        timing = time_calls(partial(captured.refine, scene.bodies), plan.device, plan.budget)
        moved = NUM_ITERATIONS * sum(launched.bytes for launched in launches)
        return [row("call", timing, moved=moved, memory=count_bytes(launches))]
    if what in CALLS_OF:
        call = CALLS_OF[what](scene, name)
    else:
        refine_all = _refine_by_autograd if what == TORCH_REFINEMENT else partial(refine, iterations=NUM_ITERATIONS)
        call = partial(refine_all, scene.bodies, scene.energy(GRADIENTS[name]))
    timing = time_calls(call, plan.device, plan.budget)
    return [row("call", timing, memory=peak_memory(call, plan.device))]


def _step_jobs(plan: KernelPlan) -> _Jobs:
    for run in plan.steps:
        what, name, batch, _ = run
        yield f"{what}, {name}, B = {batch}", partial(_time_step, plan, run)


def _time_step(plan: KernelPlan, wanted: Run) -> _Rows:
    what, name, batch, size = wanted
    timing, memory = time_steps(BenchScene.random(batch, size, plan.device), what, name, plan.budget)
    return [make_row(STEPS, wanted, "step", timing, memory=memory)]


def _refine_by_autograd(bodies: BodyParameters, energy: Energy) -> Refined:
    return Refinement(bodies, energy, iterations=NUM_ITERATIONS).run()


def _renderer(scene: BenchScene, name: str) -> ExactRun | MeshRun:
    return ExactRun(scene, GRADIENTS[name]) if name in GRADIENTS else MeshRun(scene, LEVELS[name])


def _kernel_jobs(plan: KernelPlan) -> _Jobs:
    for batch in plan.batches:
        for name, make in _KERNEL_RUNS.items():
            yield f"kernels, {name}, B = {batch}", partial(_time_kernels, plan, name, make, batch)


def _time_kernels(plan: KernelPlan, name: str, make: _MakeRun, batch: int) -> _Rows:
    run = make(BenchScene.random(batch, plan.size, plan.device))
    return [
        make_row(KERNELS, (kernel.name, name, batch, plan.size), "kernel", timing, moved=kernel.bytes)
        for kernel, timing in time_kernels(run, plan.device, plan.budget)
    ]


_MakeRun = Callable[[BenchScene], Callable[[], None]]
_KERNEL_RUNS: dict[str, _MakeRun] = {
    f"iteration, {EXACT}": lambda scene: refined_once(scene, GRADIENTS[EXACT], learning_rate=0.0).iterate,
    COVERAGE: lambda scene: _renderer(scene, COVERAGE).gradient,
    PARTDR: lambda scene: _renderer(scene, PARTDR).gradient,
    MESH: lambda scene: _renderer(scene, MESH).gradient,
    "kinematics, E1": lambda scene: KinematicsRun(scene).launch,
}


def _time_starts(plan: KernelPlan) -> _Rows:
    durations = {**time_starts(plan.device), **time_commands(plan.device)}
    return [make_row(STARTS, (name, EXACT, 0, 0), "process", Timing((each,))) for name, each in durations.items()]


def _time_first_calls(plan: KernelPlan) -> _Rows:
    durations = time_first_calls(plan.device)
    return [
        make_row(STARTS, (f"fit_photo: {name}", "", 0, 0), "process", Timing(tuple(seconds)))
        for name, seconds in durations.items()
    ]


def _peer_jobs(plan: KernelPlan, remarks: list[str]) -> _Jobs:
    peers = {name: peer for name, peer in PEERS.items() if torch.device(plan.device).type in peer.devices}
    for name, peer in peers.items():
        if not peer.is_installed:
            remarks.append(f"{name}: not timed, {peer.package} is not installed")
            continue
        for batch in (batch for batch in plan.batches if batch <= peer.most_bodies):
            yield f"{name}, B = {batch}", partial(_time_peer, plan, remarks, name, batch)


def _time_peer(plan: KernelPlan, remarks: list[str], name: str, batch: int) -> _Rows:
    view = mesh_view(BenchScene.random(batch, plan.size, plan.device), MESH)
    leaf = view.vertices.clone().requires_grad_()
    try:
        draw, loss = PEERS[name].adapt(view)
        agreement = float((draw() == PEERS[OURS].adapt(view)[0]()).float().mean())
        calls: dict[str, Callable[[], object]] = {LABELS: draw}
        if loss is not None:
            calls[GRADIENT] = lambda: torch.autograd.grad(loss(leaf), leaf)
        return [
            make_row(
                *(PEER_ROWS, (what, name, batch, plan.size), "call", time_calls(call, plan.device, plan.budget)),
                memory=peak_memory(call, plan.device),
                agreement=agreement,
            )
            for what, call in calls.items()
        ]
    except Exception as error:  # whatever somebody else's package raises
        if name == OURS:
            raise
        remarks.append(f"{name}: not timed, it failed: {type(error).__name__}: {error}")
        return []
