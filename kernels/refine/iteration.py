"""Iterations of the refinement: one launch for the prior, beside the renderer, and one for all the rest.

On CUDA a block of threads works on a body: they share out the tasks of a stage and wait for one another after it. Tasks
of different kinds go to different warps, which run at once. On the CPU device a block is one thread.
"""

import warp as wp

from ..ellipsoids.forces import sum_row
from ..lanes import LANES, wait_for_block
from .costs import add_drawn, cost_rules, pull_landmark, sum_forces
from .gradient import gather_camera, gather_length, gather_orientation, gather_rotation, gather_thickness, sum_subtree
from .pose import place_part, turn_body, turn_part
from .prior import compare_component, share_component
from .state import MODULE, SEG, Drawn, Problem, State
from .step import record_energy, step_number

BLOCK = 512  # threads a body on CUDA, a power of two: the first stage's kinds of tasks have 15 warps


@wp.func
def first_task(lane: int, warp: int):
    """First task of a thread if task 0 belongs to the first thread of ``warp``."""
    return (lane - LANES * warp) & (wp.block_dim() - 1)


@wp.func
def pose_body(problem: Problem, state: State, b: int, lane: int):
    """Compute the ellipsoids from the parameters."""
    lanes = wp.block_dim()
    num_parts = state.wrenches.shape[1]
    for k in range(lane, num_parts, lanes):
        turn_part(problem, state, b, k)
    if first_task(lane, 1) == 0:
        turn_body(problem, state, b)
    wait_for_block()

    for k in range(lane, num_parts, lanes):
        place_part(problem, state, b, k)


@wp.kernel(module=MODULE, launch_bounds=(BLOCK, 2), grid_stride=False)
def start_bodies(problem: Problem, state: State):
    """Reset the optimiser and pose the parameters as they are."""
    thread = wp.tid()
    b = thread // wp.block_dim()
    lane = thread - b * wp.block_dim()
    for i in range(lane, state.rows.parameters.shape[1], wp.block_dim()):
        state.rows.first_moment[b, i] = 0.0
        state.rows.second_moment[b, i] = 0.0
    if lane == 0:
        state.iteration[b] = 0
    pose_body(problem, state, b, lane)


@wp.kernel(module=MODULE, launch_bounds=(BLOCK, 2), grid_stride=False)
def step_bodies(problem: Problem, state: State, drawn: Drawn):
    """Take one step from the renderer's output and pose the bodies anew."""
    thread = wp.tid()
    lanes = wp.block_dim()
    b = thread // lanes
    lane = thread - b * lanes
    num_parts = state.wrenches.shape[1]
    for i in range(lane, num_parts * state.drawn.shape[2], lanes):
        add_drawn(problem, state, drawn, b, i)
    for i in range(first_task(lane, 10), state.pulls.shape[1], lanes):
        pull_landmark(problem, state, b, i)
    for k in range(first_task(lane, 12), num_parts, lanes):
        cost_rules(problem, state, b, k)
    for k in range(first_task(lane, 13), problem.mixture.means.shape[0], lanes):
        share_component(state.likelihood, b, k)
    member = first_task(lane, 14)
    if member < LANES:
        cost = sum_row(drawn.loss[b], member, wp.min(lanes, LANES))
        if member == 0:
            state.drawn_cost[b] = problem.weights[SEG] * cost
    wait_for_block()

    for k in range(lane, num_parts, lanes):
        sum_forces(problem, state, b, k)
    wait_for_block()

    for bone in range(lane, num_parts + 1, lanes):
        sum_subtree(problem, state, b, bone)
    for i in range(first_task(lane, 1), state.bodies.thicknesses.shape[1], lanes):
        gather_thickness(problem, state, b, i)
    if first_task(lane, 2) == 0:
        gather_camera(state, b)
    if first_task(lane, 3) == 0:
        record_energy(problem, state, b)
    wait_for_block()

    for k in range(lane, num_parts, lanes):
        gather_rotation(problem, state, b, k)
    for i in range(first_task(lane, 1), state.bodies.lengths.shape[1], lanes):
        gather_length(problem, state, b, i)
    if first_task(lane, 2) == 0:
        gather_orientation(problem, state, b)
    wait_for_block()

    for i in range(lane, state.rows.parameters.shape[1], lanes):
        step_number(problem, state, b, i)
    wait_for_block()

    if lane == 0:
        # After the last iteration, at rate 0, comes itself.
        state.iteration[b] = wp.min(state.iteration[b] + 1, problem.step_rule.schedule.shape[0] - 1)
    pose_body(problem, state, b, lane)


@wp.kernel(module=MODULE)
def compare_components(problem: Problem, state: State):
    """Compare the poses with the prior: a warp for each component of a body's density."""
    thread = wp.tid()
    lanes = wp.block_dim()
    components = problem.mixture.means.shape[0]
    task = thread // lanes
    b = task // components
    compare_component(problem.mixture, state.likelihood, b, task - b * components, thread - task * lanes, lanes)


def _launch(
    kernel: wp.Kernel, problem: Problem, state: State, *drawn: Drawn, tasks: int = 1, block: int = BLOCK
) -> None:
    """Launch a block for each of a body's tasks; on the CPU device it is one thread."""
    device, batch = state.iteration.device, state.iteration.shape[0]
    lanes = 1 if device.is_cpu else block
    wp.launch(kernel, batch * tasks * lanes, [problem, state, *drawn], device=device, block_dim=lanes)


def launch_start(problem: Problem, state: State) -> None:
    """Start from ``state.bodies``: reset the optimiser and pose the bodies."""
    _launch(start_bodies, problem, state)


def launch_compare(problem: Problem, state: State) -> None:
    """Compare the bodies as they are posed with the prior, if there is one."""
    components = problem.mixture.means.shape[0]
    if components > 0:
        _launch(compare_components, problem, state, tasks=components, block=int(LANES))


def launch_step(problem: Problem, state: State, drawn: Drawn) -> None:
    """Take one step from what was ``drawn`` and what the prior says, and pose the bodies anew."""
    _launch(step_bodies, problem, state, drawn)
