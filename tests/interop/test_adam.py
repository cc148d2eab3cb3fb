"""Adam without torch's compiler: torch's own, to the bit."""

from __future__ import annotations

import subprocess
import sys

import pytest
import torch

from warp_partdr.interop.adam import Adam, cosine_share, descend


@pytest.mark.parametrize("betas", [(0.9, 0.999), (0.7, 0.95)])
def test_steps_equal_torchs_adam_to_the_bit(device, betas):
    rates, shares = (0.1, 0.03), (1.0, 0.7, 0.2)
    ours, theirs = ([torch.linspace(-1, 2, n, device=device).requires_grad_() for n in (4, 7, 3000)] for _ in range(2))
    adam = Adam([(ours[:2], rates[0]), (ours[2:], rates[1]), ([], 1.0)], betas=betas)
    groups = [{"params": theirs[:2], "lr": rates[0]}, {"params": theirs[2:], "lr": rates[1]}]
    expected = torch.optim.Adam(groups, betas=betas, capturable=device != "cpu", fused=device != "cpu")
    for share in shares:
        for tensors in (ours, theirs):
            sum((tensor**3).sum() for tensor in tensors).backward()
        for group, rate in zip(expected.param_groups, rates, strict=True):
            group["lr"] = share * rate
        adam.step(share)
        expected.step()
        expected.zero_grad()
        assert all(map(torch.equal, ours, theirs))
        assert all(tensor.grad is None for tensor in ours)


def test_a_restarted_optimizer_takes_the_same_steps(device):
    """A share that is a tensor, as in a captured graph, gives the same steps as a number."""
    ends = []
    moved = torch.ones(3, device=device).requires_grad_()
    adam = Adam([([moved], 0.1)])
    for share in (0.5, torch.tensor(0.5, device=device)) if device != "cpu" else (0.5, 0.5):
        for _ in range(3):
            (moved**3).sum().backward()
            adam.step(share)
        ends.append(moved.detach().clone())
        with torch.no_grad():
            moved.fill_(1.0)
        adam.restart()
    torch.testing.assert_close(*ends)
    assert ends[0].max() < 0.9


def test_a_refinement_loads_no_compiler():
    """Nor trimesh, for a sphere: they take longer to load than a fit takes."""
    code = (
        "import sys; from warp_partdr.body.parameters import BodyParameters as B;"
        "from warp_partdr.solve.ellipsoids.stepper import Refinement;"
        "Refinement(B.mean(1), lambda b: {'x': b.posed().joints.square().sum((1, 2))}, iterations=2).run();"
        "print({'torch._dynamo', 'trimesh', 'scipy'} & set(sys.modules))"
    )
    assert subprocess.check_output([sys.executable, "-c", code], text=True).splitlines()[-1] == "set()"


def test_a_descent_takes_all_steps_at_falling_rates():
    taken: list[tuple[int, float]] = []
    told: list[int] = []
    descend(lambda step, share: taken.append((step, share)), 4, last_share=0.2, progress=told.append)
    assert [step for step, _ in taken] == [0, 1, 2, 3]
    shares = [share for _, share in taken]
    assert shares == pytest.approx([1.0, 0.882843, 0.6, 0.317157], abs=1e-6)
    assert told == [1, 2, 3, 4]
    assert cosine_share(9, 4, 0.2) == pytest.approx(0.2)
