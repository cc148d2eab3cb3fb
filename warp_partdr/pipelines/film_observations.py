"""Observed bodies of films. Each observation is made once, although windows of frames overlap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from ..inputs.scene import Scene, SceneObservation, View
from ..solve.mesh.observed_body import ObservedBody
from ..solve.scene.observations import observation_batch_size, observe_batches

_Block = tuple[int, int, int]  # indices of a person, a view and a block of frames


class FilmObservations:
    """Observed bodies of a film, which are kept until ``forget``.

    The network gets blocks of frames that do not depend on what is asked for first. So a run that continues an earlier
    one has the same results to the bit.

    Args:
        views: Cameras of the films.
        observations: Function that returns the observations of a person in a view, for a range of frames.
        device: Device of the network.
    """

    def __init__(
        self,
        views: Sequence[View],
        observations: Callable[[int, int, range], Sequence[SceneObservation]],
        device: torch.device | str,
    ) -> None:
        self._views = views
        self._observations = observations
        self._device = device
        self._length = observation_batch_size(device)
        self._blocks: dict[_Block, dict[int, ObservedBody]] = {}

    def of(self, scene: Scene, people: Sequence[int], frames: Sequence[int]) -> list[ObservedBody]:
        """Observed bodies of a scene, in the order of people, frames and views.

        Args:
            scene: Scene with some of the films' people and frames.
            people: Index in the films of each person of the scene.
            frames: Index in the films of each frame of the scene.
        """
        observations = sorted(scene.observations, key=lambda each: (each.person, each.frame, each.view))
        keys = [(people[each.person], each.view, frames[each.frame]) for each in observations]
        missing = sorted({self._block(*key) for key in keys} - self._blocks.keys())
        batches = [
            self._observations(person, view, range(block * self._length, (block + 1) * self._length))
            for person, view, block in missing
        ]
        for block, observed_bodies in zip(missing, observe_batches(self._views, batches, self._device), strict=True):
            self._blocks[block] = {observed.frame: observed for observed in observed_bodies}
        return [
            replace(self._blocks[self._block(*key)][key[-1]], source=observation)
            for observation, key in zip(observations, keys, strict=True)
        ]

    def forget(self, before: int) -> None:
        """Drops observed bodies of frames before one."""
        kept: dict[_Block, dict[int, ObservedBody]] = {}
        for key, observed_bodies in self._blocks.items():
            if (key[2] + 1) * self._length > before:
                kept[key] = observed_bodies
        self._blocks = kept

    def _block(self, person: int, view: int, frame: int) -> _Block:
        """Block that a frame belongs to."""
        return person, view, frame // self._length
