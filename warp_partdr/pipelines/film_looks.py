"""Looks of the label network at films: it sees each sight once, though windows of frames overlap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from ..inputs.scene import Scene, Sight, View
from ..solve.mesh.observed_body import ObservedBody
from ..solve.scene.looks import look_in_batches, looked_at_together

_Block = tuple[int, int, int]  # a person, a view, and which block of frames


class FilmLooks:
    """Looks at a film's sights, which are kept until ``forget``.

    The network looks at blocks of frames that are the same whatever is asked for first. So a run that goes on where an
    earlier one ended has its results to the bit.

    Args:
        views: Cameras.
        sights: Sights of a person in a view, in the frames of a range.
        device: Where the network is.
    """

    def __init__(
        self,
        views: Sequence[View],
        sights: Callable[[int, int, range], Sequence[Sight]],
        device: torch.device | str,
    ) -> None:
        self._views, self._sights, self._device = views, sights, device
        self._length = looked_at_together(device)
        self._blocks: dict[_Block, dict[int, ObservedBody]] = {}

    def of(self, scene: Scene, people: Sequence[int], frames: Sequence[int]) -> list[ObservedBody]:
        """Looks at a scene's sights, in the order of people, frames and views.

        Args:
            scene: Some of the films' people and frames.
            people: Numbers of the scene's people in the films.
            frames: Numbers of its frames.
        """
        sights = sorted(scene.sights, key=lambda sight: (sight.person, sight.frame, sight.view))
        places = [(people[sight.person], sight.view, frames[sight.frame]) for sight in sights]
        missing = sorted({self._block(*place) for place in places} - self._blocks.keys())
        batches = [
            self._sights(person, view, range(block * self._length, (block + 1) * self._length))
            for person, view, block in missing
        ]
        for key, looks in zip(missing, look_in_batches(self._views, batches, self._device), strict=True):
            self._blocks[key] = {look.sight.frame: look for look in looks}
        return [
            replace(self._blocks[self._block(*place)][place[-1]], sight=sight)
            for sight, place in zip(sights, places, strict=True)
        ]

    def forget(self, before: int) -> None:
        """Drop looks at frames before one."""
        self._blocks = {key: looks for key, looks in self._blocks.items() if (key[2] + 1) * self._length > before}

    def _block(self, person: int, view: int, frame: int) -> _Block:
        return person, view, frame // self._length
