"""Looks of the label network at films: it sees each observation once, though windows of frames overlap."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from ..inputs.scene import Scene, SceneObservation, View
from ..solve.mesh.observed_body import ObservedBody
from ..solve.scene.observations import observation_batch_size, observe_batches

_Block = tuple[int, int, int]  # a person, a view, and which block of frames


class FilmObservations:
    """Looks at a film's observations, which are kept until ``forget``.

    The network looks at blocks of frames that are the same whatever is asked for first. So a run that goes on where an
    earlier one ended has its results to the bit.

    Args:
        views: Cameras.
        observations: Sights of a person in a view, in the frames of a range.
        device: Where the network is.
    """

    def __init__(
        self,
        views: Sequence[View],
        observations: Callable[[int, int, range], Sequence[SceneObservation]],
        device: torch.device | str,
    ) -> None:
        self._views, self._observations, self._device = views, observations, device
        self._length = observation_batch_size(device)
        self._blocks: dict[_Block, dict[int, ObservedBody]] = {}

    def of(self, scene: Scene, people: Sequence[int], frames: Sequence[int]) -> list[ObservedBody]:
        """Looks at a scene's observations, in the order of people, frames and views.

        Args:
            scene: Some of the films' people and frames.
            people: Numbers of the scene's people in the films.
            frames: Numbers of its frames.
        """
        observations = sorted(
            scene.observations, key=lambda observation: (observation.person, observation.frame, observation.view)
        )
        places = [
            (people[observation.person], observation.view, frames[observation.frame]) for observation in observations
        ]
        missing = sorted({self._block(*place) for place in places} - self._blocks.keys())
        batches = [
            self._observations(person, view, range(block * self._length, (block + 1) * self._length))
            for person, view, block in missing
        ]
        for key, observed_bodies in zip(missing, observe_batches(self._views, batches, self._device), strict=True):
            self._blocks[key] = {observed.frame: observed for observed in observed_bodies}
        return [
            replace(self._blocks[self._block(*place)][place[-1]], source=observation)
            for observation, place in zip(observations, places, strict=True)
        ]

    def forget(self, before: int) -> None:
        """Drop looks at frames before one."""
        self._blocks = {
            key: observed_bodies
            for key, observed_bodies in self._blocks.items()
            if (key[2] + 1) * self._length > before
        }

    def _block(self, person: int, view: int, frame: int) -> _Block:
        return person, view, frame // self._length
