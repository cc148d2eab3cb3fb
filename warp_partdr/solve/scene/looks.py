"""Looks of the label network at the sights of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import torch

from ...body.lens import turn_to_rays
from ...errors import InputError
from ...inputs.evidence import Evidence, weigh_evidence
from ...inputs.observation import crop_evidence
from ...inputs.scene import Scene, Sight, View
from ...interop.torch_threads import one_torch_thread
from ...kernels.launch import get_num_threads, run_slices
from ...networks.regression.checkpoint import packaged_network
from ...networks.regression.label_network import LabelNetwork
from ...networks.regression.predict import ask_about_each
from ..mesh.observed_body import ObservedBody

_TOGETHER = {"cpu": 8, "cuda": 64}  # sights that the network looks at at a time; on the CPU, on each thread


def look_at(scene: Scene, device: torch.device | str) -> list[ObservedBody]:
    """Bodies that the network sees in each sight, in the order of people, frames and views."""
    sights = sorted(scene.sights, key=lambda sight: (sight.person, sight.frame, sight.view))
    together = looked_at_together(device)
    batches = [sights[start : start + together] for start in range(0, len(sights), together)]
    return list(chain.from_iterable(look_in_batches(scene.views, batches, device)))


def looked_at_together(device: torch.device | str) -> int:
    """Number of sights that the network is to look at at a time."""
    return _TOGETHER[torch.device(device).type]


def look_in_batches(
    views: Sequence[View], batches: Sequence[Sequence[Sight]], device: torch.device | str
) -> list[list[ObservedBody]]:
    """Bodies that the network sees in each sight, of one batch after another; on the CPU, threads share them."""
    network, on_cpu = packaged_network(str(device)), torch.device(device).type == "cpu"
    found: list[list[ObservedBody]] = [[] for _ in batches]

    @one_torch_thread()
    @torch.no_grad()
    def look(some: slice) -> None:
        for place in range(len(batches))[some]:
            found[place] = _look(views, batches[place], network, device)

    threads = max(min(get_num_threads(), len(batches)), 1) if on_cpu else 1
    run_slices(look, [slice(first, None, threads) for first in range(threads)])
    return found


def _look(
    views: Sequence[View], sights: Sequence[Sight], network: LabelNetwork, device: torch.device | str
) -> list[ObservedBody]:
    """Look at sights in one batch."""
    evidence = [_weighed(sight) for sight in sights]
    pairs = [
        crop_evidence(each, device=device, camera=views[sight.view].camera)
        for each, sight in zip(evidence, sights, strict=True)
    ]
    said = ask_about_each([seen for seen, _ in pairs], network)
    lenses = torch.stack([seen.lens for seen, _ in pairs if seen.lens is not None])
    bodies = turn_to_rays(said.parameters(), lenses)
    found = []
    for place, (sight, each, (seen, crop)) in enumerate(zip(sights, evidence, pairs, strict=True)):
        own = slice(place, place + 1)
        unsure = None if said.uncertainty is None else said.uncertainty.select(own)
        found.append(ObservedBody(sight, each, seen, crop, bodies.select(own), unsure))
    return found


def _weighed(sight: Sight) -> Evidence:
    """Evidence of a sight, whose labels are without others' already; where they are along no bone, of keypoints."""
    try:
        return weigh_evidence(sight.keypoints, sight.parts)[0]
    except InputError as error:
        if sight.parts is None:
            raise
        alone = weigh_evidence(sight.keypoints)[0]
        return replace(alone, warnings=(f"{error}; keypoints alone taken",))
