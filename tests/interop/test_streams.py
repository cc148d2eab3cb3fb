"""Captures hold nothing that another thread launched meanwhile, and are not spoilt by it."""

from __future__ import annotations

import gc
import math
import threading
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace

import pytest
import torch
import warp as wp
from conftest import HANG
from helpers.bodies import seen_by, walker
from helpers.quick import QUICK_FIT

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.inputs.observation import observe
from warp_partdr.interop.captured_step import CapturedStep
from warp_partdr.interop.streams import capture_graph, capturing, launching, on_torch_stream
from warp_partdr.models.joint_chain import chain_joints
from warp_partdr.models.joint_turns import turn_joints
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.solve.ellipsoids.energy import Energy
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.refine import refine

WAIT = 1_000_000  # [cycles] of a GPU, about half a millisecond


@pytest.fixture
def cuda(device):
    if device == "cpu":
        pytest.skip("the CPU has no streams")
    return device


def test_a_capture_waits_for_launches_and_launches_for_it():
    order: list[str] = []
    cpu, begun = torch.device("cpu"), threading.Event()

    def launch():
        with on_torch_stream(cpu):  # the capturing thread itself may
            order.append("captured")

    def capture():
        begun.set()
        return capture_graph(launch, cpu)

    with ThreadPoolExecutor(1) as pool:
        with on_torch_stream(cpu), on_torch_stream(cpu):
            waiting = pool.submit(capture)
            assert begun.wait(HANG)
            assert not wait([waiting], timeout=0.2).done  # time enough for one that does not wait
            order.append("launched")
        waiting.result(timeout=HANG)
    assert order == ["launched", "captured"]


def test_a_capture_does_not_wait_for_itself():
    cpu = torch.device("cpu")
    with on_torch_stream(cpu), pytest.raises(RuntimeError, match="inside on_torch_stream"):
        capture_graph(lambda: None, cpu)


def test_no_garbage_is_collected_during_a_capture():
    """The collector might free a graph, which CUDA forbids then."""
    assert gc.isenabled()
    with capturing():
        assert not gc.isenabled()
    assert gc.isenabled()


def test_a_launch_that_belongs_to_a_capture_does_not_wait_for_it():
    """Autograd's thread, for which the one that captures waits."""

    def launch():
        with launching(captured=True):
            return "launched"

    with ThreadPoolExecutor(1) as pool, capturing():
        assert pool.submit(launch).result(timeout=HANG) == "launched"


def test_kernels_of_a_backward_are_captured(cuda):
    """The gradient of the step is a kernel's, which autograd's thread launches."""
    turns = torch.zeros(2, 3, 3, device=cuda, requires_grad=True)
    rotations, joints = torch.eye(3, device=cuda).repeat(2, 4, 1, 1), torch.tensor([0, 1, 3], device=cuda)
    aim = torch.randn(2, 4, 3, 3, device=cuda)

    def slope() -> torch.Tensor:
        turned = turn_joints(rotations, joints, turns)
        frames = chain_joints((-1, 0, 1, 2), turned, aim[..., 0])
        return torch.autograd.grad((frames[..., :3, :3] * aim).sum(), turns)[0]

    captured = CapturedStep(slope, torch.device(cuda))
    with torch.no_grad():
        turns.copy_(torch.randn(2, 3, 3))
    captured.replay()
    torch.testing.assert_close(captured.result, slope())


def test_fits_and_pictures_of_two_threads_are_those_of_one():
    keypoints, parts = seen_by(walker())
    body = BodyParameters.mean(1)

    def fit(_):
        return fit_body(keypoints, parts, options=QUICK_FIT).parameters.rotations

    def draw(_):
        return draw_ellipsoids(body.posed(), body.camera(64), (64, 64)).labels

    want_fit, want_picture = fit(0), draw(0)
    with ThreadPoolExecutor(3) as pool:
        fits, pictures = pool.map(fit, range(4)), pool.map(draw, range(200))
        assert all(torch.equal(have, want_picture) for have in pictures)
        assert all(torch.equal(have, want_fit) for have in fits)


def test_scratch_memory_of_a_side_stream_comes_from_torch(cuda):
    """Warp's own memory comes back on the default stream, for which torch's side streams don't wait."""
    where, side = torch.device("cuda", torch.cuda.current_device()), torch.cuda.Stream()
    size = 1 << 24
    for stream, share in ((torch.cuda.default_stream(), 0), (side, size)):
        with torch.cuda.stream(stream):
            before = torch.cuda.memory_allocated()
            with on_torch_stream(where) as alias, on_torch_stream(where):
                scratch = wp.zeros(size, dtype=wp.uint8, device=alias)
            assert torch.cuda.memory_allocated() - before == share
            del scratch
            assert torch.cuda.memory_allocated() == before
    body = BodyParameters.mean(1, device=cuda)
    want = draw_ellipsoids(body.posed(), body.camera(64), (64, 64)).labels
    torch.cuda.synchronize()
    with torch.cuda.stream(side):
        have = draw_ellipsoids(body.posed(), body.camera(64), (64, 64)).labels
    side.synchronize()
    assert torch.equal(have, want)


def test_others_may_use_the_default_stream_during_a_capture(cuda):
    keypoints, parts = seen_by(walker(cuda))
    done = threading.Event()

    def disturb():
        while not done.is_set():
            torch.ones(8, device=cuda).sum().item()

    with ThreadPoolExecutor(1) as pool:
        other = pool.submit(disturb)
        try:
            assert math.isfinite(sum(fit_body(keypoints, parts, options=QUICK_FIT, device=cuda).energy.values()))
        finally:
            done.set()
        other.result(timeout=HANG)


def test_two_threads_capture_at_once_again_and_again(cuda):
    """torch hands its few streams out again: captures must not meet on one, nor others' launches spoil them.

    What a thread launches waits there a while, so that on another one's stream it would be read too early.
    """
    keypoints, parts = seen_by(walker(cuda))
    seen, _ = observe(keypoints, parts, device=cuda)
    energy, start = Energy(seen, size=64), BodyParameters.mean(1, device=cuda)
    want = refine(start, energy, iterations=2).energy

    def found_late():
        torch.cuda._sleep(WAIT)
        return refine(start, energy, iterations=2).energy

    def capture(_):
        with torch.cuda.stream(torch.cuda.Stream()):
            return [torch.equal(found_late(), want) for _ in range(40)]

    with ThreadPoolExecutor(2) as pool:
        assert all(map(all, pool.map(capture, range(2))))


def test_two_threads_launch_each_on_its_own_stream(cuda):
    body = BodyParameters.mean(1, device=cuda)
    bodies = [body, replace(body, shift=body.shift + 0.2)]
    want = [draw_ellipsoids(b.posed(), b.camera(64), (64, 64)).labels for b in bodies]
    torch.cuda.synchronize()

    def draw(which):
        right = []
        with torch.cuda.stream(torch.cuda.Stream()):
            for _ in range(100):
                torch.cuda._sleep(WAIT)
                have = draw_ellipsoids(bodies[which].posed(), bodies[which].camera(64), (64, 64)).labels
                right.append(torch.equal(have, want[which]))
        return right

    with ThreadPoolExecutor(2) as pool:
        assert all(map(all, pool.map(draw, range(2))))
