"""Work that threads of the CPU share: the same numbers as by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import torch
from helpers.bodies import random_turns

from warp_partdr.kernels.launch import set_num_threads
from warp_partdr.models.anny import anny
from warp_partdr.models.capsules import measure_capsules
from warp_partdr.models.skinning import carry_skin
from warp_partdr.solve.mesh.placed_people import PictureViews, place_people
from warp_partdr.solve.scene.clusters import slots_of

BODIES = 7
VERTICES = 30_000  # so many that threads share their work, and no graph is captured


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    """Sets how many threads share work."""
    yield set_num_threads
    set_num_threads(0)


def seen(vertices: torch.Tensor) -> torch.Tensor:
    """Vertices of people who stand in pairs, in one frame and three views."""
    slots, places = slots_of(((0, 2), (1, 4), (3, 5), (6,)), BODIES, torch.device("cpu"))
    views = PictureViews(
        rotations=random_turns(1, 3, 0.2)[0].float(),
        translations=torch.tensor([[0.0, 0.0, 4.0], [0.1, 0.0, 5.0], [0.0, 0.2, 6.0]]),
        lenses=torch.tensor([2.0, 0.0, 0.0]).expand(12, 3).contiguous(),
        observed=torch.ones(BODIES, 3, dtype=torch.bool),
        slots=slots,
        person_slots=places,
    )
    return place_people(vertices, vertices.mean(1), views, 96)


def carried(vertices: torch.Tensor) -> torch.Tensor:
    weights, maps = torch.rand(vertices.shape[1], 3), torch.rand(BODIES, 12, 3)
    return carry_skin(weights, maps, vertices)


def overlap(vertices: torch.Tensor) -> torch.Tensor:
    capsules = measure_capsules(anny())
    count = len(capsules.parts)
    placed = vertices.flatten()[: 50 * BODIES * count * 7].view(-1, count, 7)
    return capsules.overlap(0.1 * placed, people=BODIES)


@pytest.mark.parametrize("work", [seen, carried, overlap])
def test_threads_change_no_bit(work, threads):
    found = []
    for count in (1, 3, 3):  # what is launched first is launched by one thread
        threads(count)
        torch.manual_seed(3)
        vertices = torch.randn(BODIES, VERTICES, 3).requires_grad_()
        result = work(vertices)
        found.append((result.detach(), *torch.autograd.grad((result * torch.rand_like(result)).sum(), vertices)))
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            assert bool(one.abs().max() > 0)
            assert torch.equal(one, two)
