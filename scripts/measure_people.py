"""Measure and print how many people a second are found and given bodies by the networks, stage by stage.

    python scripts/measure_people.py [DEVICE] [PEOPLE] [SIDE]

Pictures of SIDE pixels (default 384) show the packaged example's person, a bit elsewhere in each; as many as PEOPLE,
256 unless told. Medians of five runs after one that loads and captures: milliseconds, people a second, and milliseconds
until the host had nothing more to do than to wait for the device; on CUDA with networks in float32, then in 16 bits, as
data sets have them. Below, kernels of the evidence, and the landmark network alone, in both precisions and launch by
launch.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
import warp as wp
from PIL import Image

from warp_partdr.inputs.cut_people import CutPeople, CutPerson
from warp_partdr.inputs.masked_people import MaskedPerson, cut_masks
from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.networks.detection import MIN_SCORE
from warp_partdr.networks.detection.asset import packaged_people_networks
from warp_partdr.networks.detection.crops import Pyramid
from warp_partdr.networks.detection.detector import detect_people
from warp_partdr.networks.detection.look import look
from warp_partdr.networks.detection.masks import instance_maps
from warp_partdr.networks.detection.people import find_people_in
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.networks.regression.predict import ask_network

EXAMPLE = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets" / "example"
RUNS = 5


def main(device: str = "cpu", count: str = "256", side: str = "384") -> None:
    wp.config.log_level = wp.LOG_WARNING
    pictures = example_pictures(int(count), int(side))
    for half in (False, True) if device != "cpu" else (False,):
        timed(pictures, device, half)
        passes = [timed(pictures, device, half) for _ in range(RUNS)]
        how = "16 bits" if half else "float32"
        print(f"{count} people in pictures of {side} px, {name_of(device)}, {how}: ms, people a second, ms of the host")
        for stage in passes[0]:
            seconds, host = np.median([each[stage] for each in passes], axis=0).tolist()
            report(stage, seconds, len(pictures), host)
    measure_kernels(pictures, device)
    for batch in (1, 16, 256) if device != "cpu" else (1, 4):
        measure_landmarks(device, batch)


def example_pictures(count: int, side: int) -> list[np.ndarray]:
    photo = Image.fromarray(read_photo(EXAMPLE / "photo.png"))
    size = round(photo.width * side / photo.height), side
    ground = Image.new("RGB", (side, side), photo.getpixel((5, 5)))
    pictures = []
    for index in range(count):
        picture = ground.copy()
        picture.paste(photo.resize(size), (index % max(side - size[0], 1), 0))
        pictures.append(np.asarray(picture))
    return pictures


@torch.no_grad()
def timed(pictures: list[np.ndarray], device: str, half: bool) -> dict[str, np.ndarray]:
    """Seconds of each stage, and those of the host."""
    seconds: dict[str, np.ndarray] = {}

    def stage(name: str, work: Callable[[], Any]) -> Any:
        synchronize(device)
        started = time.perf_counter()
        found = work()
        host = time.perf_counter() - started
        synchronize(device)
        seconds[name] = np.array([time.perf_counter() - started, host])
        return found

    networks, network = packaged_people_networks(device, half=half), packaged_network(str(torch.device(device)))
    rows = np.arange(len(pictures))
    side = len(pictures[0])
    sizes = np.full((len(pictures), 2), side)
    pyramids = stage("pictures to the device", lambda: Pyramid.each(pictures, networks.device))
    crops, _ = stage("detector", lambda: detect_people(networks, pyramids, rows.tolist(), MIN_SCORE, 1))
    assert len(crops) == len(pictures)
    first = stage("landmarks, first look", lambda: look(networks, pyramids, crops))
    found = stage("landmarks, second look", lambda: look(networks, pyramids, first.next_crops))
    people = stage("masks", lambda: found.people(rows, found.presence, sizes))
    seconds["so far"] = np.sum(list(seconds.values()), axis=0)
    stage("all of these: find_people_in", lambda: find_people_in(pictures, device=device, half=half))
    owners = stage("whom each pixel shows", lambda: instance_maps([[each] for each in people], sizes.tolist()))
    masked = [MaskedPerson(each.keypoints, shown, 1) for each, shown in zip(people, owners, strict=True)]
    cut = stage("evidence and crops", lambda: cut_masks(masked, device))
    together = stage("people as arrays", lambda: CutPeople.of([CutPerson(*each) for each in cut]))
    stage("label network", lambda: ask_network(together.seen, network, half=half).parameters())
    names = ("all of these: find_people_in", "whom each pixel shows", "evidence and crops", "people as arrays")
    names = (*names, "label network")
    seconds["from pictures to bodies"] = np.sum([seconds[name] for name in names], axis=0)
    return seconds


def measure_kernels(pictures: list[np.ndarray], device: str) -> None:
    """Each kernel of the evidence, with a clock that waits for it."""
    people = [each[0] for each in find_people_in(pictures, device=device)]
    owners = instance_maps([[each] for each in people], [(each.shape[0], each.shape[1]) for each in pictures])
    masked = [MaskedPerson(each.keypoints, shown, 1) for each, shown in zip(people, owners, strict=True)]
    seconds: dict[str, float] = {}
    launch = wp.launch

    def clocked(kernel: Any, *args: Any, **options: Any) -> None:
        synchronize(device)
        started = time.perf_counter()
        launch(kernel, *args, **options)
        synchronize(device)
        seconds[kernel.key] = seconds.get(kernel.key, 0.0) + time.perf_counter() - started

    with patch.object(wp, "launch", clocked):
        cut_masks(masked, device)
    for name, each in seconds.items():
        report(f"evidence, kernel {name}", each, len(pictures))


@torch.no_grad()
def measure_landmarks(device: str, batch: int) -> None:
    """The landmark network by itself: as it is called, and launch by launch."""
    for half in (False, True) if device != "cpu" else (False,):
        network = packaged_people_networks(device, half=half).landmarks
        pictures = torch.rand(batch, 3, network.size, network.size, device=device)
        for name, work in (("", network), (", launch by launch", network._run)):
            seconds = []
            for _ in range(RUNS + 2):
                synchronize(device)
                started = time.perf_counter()
                work(pictures)
                synchronize(device)
                seconds.append(time.perf_counter() - started)
            how = "16 bits" if half else "float32"
            report(f"landmark network, {batch} at a time, {how}{name}", float(np.median(seconds[2:])), batch)


def synchronize(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize(device)


def name_of(device: str) -> str:
    return torch.cuda.get_device_name(device) if device != "cpu" else f"CPU, {torch.get_num_threads()} threads"


def report(name: str, seconds: float, people: int, host: float | None = None) -> None:
    told = "" if host is None else f" {1000 * host:9.1f}"
    print(f"{name:60s} {1000 * seconds:9.1f} {people / seconds:9.0f}{told}")


if __name__ == "__main__":
    main(*sys.argv[1:])
