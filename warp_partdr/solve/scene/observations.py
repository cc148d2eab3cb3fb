"""Bodies that the label network predicts for the observations of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain

import torch

from ...body.lens import turn_to_rays
from ...errors import InputError
from ...inputs.evidence import Evidence, weigh_evidence
from ...inputs.observation import crop_evidence
from ...inputs.scene import Scene, SceneObservation, View
from ...interop.torch_threads import one_torch_thread
from ...kernels.launch import get_num_threads, run_slices
from ...networks.regression.checkpoint import packaged_network
from ...networks.regression.label_network import LabelNetwork
from ...networks.regression.predict import ask_about_each
from ..mesh.observed_body import ObservedBody

_BATCH_SIZES = {"cpu": 8, "cuda": 64}  # observations that the network gets at once; on the CPU, in each thread


def observe_scene(scene: Scene, device: torch.device | str) -> list[ObservedBody]:
    """Predicts a body for each observation of a scene, in the order of people, frames and views."""
    observations = sorted(scene.observations, key=lambda each: (each.person, each.frame, each.view))
    size = observation_batch_size(device)
    batches = [observations[start : start + size] for start in range(0, len(observations), size)]
    return list(chain.from_iterable(observe_batches(scene.views, batches, device)))


def observation_batch_size(device: torch.device | str) -> int:
    """Number of observations that the network gets at once."""
    return _BATCH_SIZES[torch.device(device).type]


def observe_batches(
    views: Sequence[View], batches: Sequence[Sequence[SceneObservation]], device: torch.device | str
) -> list[list[ObservedBody]]:
    """Predicts a body for each observation, batch by batch. On the CPU, threads share the batches."""
    network = packaged_network(str(device))
    on_cpu = torch.device(device).type == "cpu"
    found: list[list[ObservedBody]] = [[] for _ in batches]

    @one_torch_thread()
    @torch.no_grad()
    def observe(rows: slice) -> None:
        for index in range(len(batches))[rows]:
            found[index] = _observe(views, batches[index], network, device)

    threads = max(min(get_num_threads(), len(batches)), 1) if on_cpu else 1
    run_slices(observe, [slice(first, None, threads) for first in range(threads)])
    return found


def _observe(
    views: Sequence[View],
    observations: Sequence[SceneObservation],
    network: LabelNetwork,
    device: torch.device | str,
) -> list[ObservedBody]:
    """Predicts a body for each observation of one batch."""
    # Evidence is weighed one person at a time, because pictures of people who overlap are later drawn from the labels
    # in its window. ``cut_out_people`` weighs many people at once, but it does not return these labels.
    evidence = [_weigh(observation) for observation in observations]
    crops = [
        crop_evidence(each, device=device, camera=views[observation.view].camera)
        for each, observation in zip(evidence, observations, strict=True)
    ]
    predicted = ask_about_each([cropped for cropped, _ in crops], network)
    lenses = torch.stack([cropped.lens for cropped, _ in crops if cropped.lens is not None])
    bodies = turn_to_rays(predicted.parameters(), lenses)
    found = []
    for index, (source, each, (cropped, crop)) in enumerate(zip(observations, evidence, crops, strict=True)):
        row = slice(index, index + 1)
        uncertainty = None if predicted.uncertainty is None else predicted.uncertainty.select(row)
        found.append(ObservedBody(source, each, cropped, crop, bodies.select(row), uncertainty))
    return found


def _weigh(observation: SceneObservation) -> Evidence:
    """Weighs the evidence of an observation. If its labels lie along no bone, only the keypoints are used."""
    try:
        return weigh_evidence(observation.keypoints, observation.parts)[0]
    except InputError as error:
        if observation.parts is None:
            raise
        evidence = weigh_evidence(observation.keypoints)[0]
        return replace(evidence, warnings=(f"{error}; only the keypoints are used",))
