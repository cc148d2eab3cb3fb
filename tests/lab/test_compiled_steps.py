"""The step that is timed under torch.compile is the step that is timed without it."""

from functools import partial

import pytest
import torch

from warp_partdr.lab.bench.kernels.compiled_steps import compiled_step, training_step
from warp_partdr.lab.bench.kernels.plan import COMPILED_STEP, TORCH_STEP, plan_kernels
from warp_partdr.lab.bench.renderers import EXACT, MESH
from warp_partdr.lab.bench.scene import BenchScene


@pytest.mark.parametrize("name", [EXACT, MESH])
def test_compiled_steps_have_the_losses_of_eager_ones(device, monkeypatch, name):
    # its own backend of kernels in C++ would take most of a minute
    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend="aot_eager"))
    torch._dynamo.reset()
    scene = BenchScene.random(2, 32, device)
    plain, compiled = training_step(scene, name), compiled_step(scene, name)
    losses = [(plain(), compiled()) for _ in range(4)]
    assert losses[0][0] > losses[-1][0]
    for want, have in losses:
        torch.testing.assert_close(have, want, rtol=1e-3, atol=0)


def test_both_steps_are_timed_on_a_gpu():
    runs = [run[1:] for run in plan_kernels("cuda").calls if run[0] == TORCH_STEP]
    assert runs == [run[1:] for run in plan_kernels("cuda").calls if run[0] == COMPILED_STEP]
    assert runs
