"""Refinements of many people whose graphs are kept: others take the first ones' place, and nothing else changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
import torch
from helpers.example import example_keypoints, example_parts

from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.pose_prior import PosePrior
from warp_partdr.inputs.observation import observe
from warp_partdr.inputs.observations import Observations
from warp_partdr.interop.graph_cache import set_graph_memory
from warp_partdr.solve.ellipsoids import captured
from warp_partdr.solve.ellipsoids.captured import CapturedRefinement, refine_captured
from warp_partdr.solve.ellipsoids.energy import Energy
from warp_partdr.solve.ellipsoids.stepper import Descent

COURSE = Descent(iterations=3, learning_rate=0.01)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """Sizes of the refinements that are captured."""
    sizes: list[int] = []

    class Counted(CapturedRefinement):
        def __init__(self, energy: Any, batch_size: int, **how: Any) -> None:
            sizes.append(batch_size)
            super().__init__(energy, batch_size, **how)

    monkeypatch.setattr(captured, "CapturedRefinement", Counted)
    yield sizes
    set_graph_memory(None)


def test_other_people_take_the_place_of_the_first(made: list[int], device: str) -> None:
    """Also where there are fewer than a graph holds; a graph of one's own, without memory to keep it, is the judge."""
    seen, _ = observe(example_keypoints(), example_parts(), device=device)
    factors = [torch.linspace(0.8, 1.2 + 0.1 * number, 36, device=device).view(-1, 1) for number in range(4)]
    mean = BodyParameters.mean(1, device=device)
    people = Observations.of([seen] * 36)
    people.labels[::2] = people.labels[::2].flip(-1)
    people = replace(
        people,
        points=people.points * factors[0][..., None],
        lengths=mean.lengths * factors[1],
        thicknesses=mean.thicknesses * factors[2],
        confidence=people.confidence * factors[3],
    )
    everyone = Energy(people, 48, prior=PosePrior().to(device))
    starts = BodyParameters.mean(36, device=device)
    starts.shift.copy_(torch.linspace(-0.2, 0.2, 72, device=device).view(36, 2))
    groups = slice(0, 18), slice(18, 36), slice(5, 22)  # the last of 17, with a graph of 18

    def refined(some: slice) -> Any:
        return refine_captured(starts.select(some), everyone.select(some), COURSE)

    found = [refined(some) for some in groups]
    kept, made[:] = list(made), []
    assert sum(kept) == 18
    set_graph_memory(0)
    for some, one in zip(groups, found, strict=True):
        other = refined(some)
        assert len(one.energy) == len(other.energy) == some.stop - some.start
        assert torch.equal(one.energy, other.energy)
        assert torch.equal(one.history, other.history)
        for name, values in one.parameters.tensors().items():
            assert torch.equal(values, other.parameters.tensors()[name]), name
        for name, values in one.terms.items():
            assert torch.equal(values, other.terms[name]), name
    assert sum(made) == 3 * 18
    assert len({energy.item() for one in found for energy in one.energy}) > 30
