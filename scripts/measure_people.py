"""Measure and print how many people a second are found and given bodies by the networks, stage by stage.

    python scripts/measure_people.py [DEVICE] [PEOPLE] [SIDE]

Pictures of SIDE pixels (default 384) show the packaged example's person, a bit elsewhere in each; as many as PEOPLE,
256 unless told. Medians of five runs after one that loads and captures: milliseconds, people a second, and milliseconds
until the host had nothing more to do than to wait for the device. Below, the landmark network alone, on CUDA also
launch by launch and with convolutions rounded to TF32, which changes its results.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp
from PIL import Image

from warp_partdr.detection import MIN_SCORE
from warp_partdr.detection.asset import PeopleNetworks, packaged_people_networks
from warp_partdr.detection.crops import Pyramid
from warp_partdr.detection.detector import detect_people
from warp_partdr.detection.look import look
from warp_partdr.detection.masks import instance_maps
from warp_partdr.detection.people import find_people_in
from warp_partdr.inputs.masked_people import MaskedPerson, cut_masks
from warp_partdr.inputs.part_labels import read_photo
from warp_partdr.network.checkpoint import packaged_network
from warp_partdr.network.predict import predict_bodies

EXAMPLE = Path(__file__).resolve().parents[1] / "warp_partdr" / "assets" / "example"
RUNS = 5


def main(device: str = "cpu", count: str = "256", side: str = "384") -> None:
    wp.config.log_level = wp.LOG_WARNING
    pictures = example_pictures(int(count), int(side))
    timed(pictures, device)
    passes = [timed(pictures, device) for _ in range(RUNS)]
    print(f"{count} people in pictures of {side} px, {name_of(device)}: ms, people a second, ms of the host")
    for stage in passes[0]:
        seconds, host = np.median([each[stage] for each in passes], axis=0).tolist()
        report(stage, seconds, len(pictures), host)
    networks = packaged_people_networks(device)
    for batch in (1, 16, 256) if device != "cpu" else (1, 4):
        measure_landmarks(networks, batch)


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
def timed(pictures: list[np.ndarray], device: str) -> dict[str, np.ndarray]:
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

    networks, network = packaged_people_networks(device), packaged_network(str(torch.device(device)))
    rows = np.arange(len(pictures))
    side = len(pictures[0])
    sizes = np.full((len(pictures), 2), side)
    pyramids = stage("pictures to the device", lambda: [Pyramid(each, networks.device) for each in pictures])
    crops, _ = stage("detector", lambda: detect_people(networks, pyramids, rows.tolist(), MIN_SCORE, 1))
    assert len(crops) == len(pictures)
    first = stage("landmarks, first look", lambda: look(networks, pyramids, crops))
    found = stage("landmarks, second look", lambda: look(networks, pyramids, first.next_crops))
    people = stage("masks", lambda: found.people(rows, found.presence, sizes))
    seconds["so far"] = np.sum(list(seconds.values()), axis=0)
    stage("all of these: find_people_in", lambda: find_people_in(pictures, device=device))
    owners = stage("whom each pixel shows", lambda: instance_maps([[each] for each in people], sizes.tolist()))
    masked = [MaskedPerson(each.keypoints, shown, 1) for each, shown in zip(people, owners, strict=True)]
    cut = stage("evidence and crops", lambda: cut_masks(masked, device))
    stage("label network", lambda: predict_bodies([observation for _, observation, _ in cut], network))
    names = ("all of these: find_people_in", "whom each pixel shows", "evidence and crops", "label network")
    seconds["from pictures to bodies"] = np.sum([seconds[name] for name in names], axis=0)
    return seconds


@torch.no_grad()
def measure_landmarks(networks: PeopleNetworks, batch: int) -> None:
    """The landmark network by itself: as it is called, launch by launch, and with convolutions rounded to TF32."""
    network, device = networks.landmarks, networks.device
    pictures = torch.rand(batch, 3, network.size, network.size, device=device)
    forms: dict[str, Callable[[], Any]] = {"as it is": lambda: network(pictures)}
    if device.type == "cuda":
        forms["eager"] = with_tf32(False, lambda: network._run(pictures))
        forms["eager, TF32"] = with_tf32(True, lambda: network._run(pictures))
    for name, work in forms.items():
        seconds = []
        for _ in range(RUNS + 2):
            synchronize(str(device))
            started = time.perf_counter()
            work()
            synchronize(str(device))
            seconds.append(time.perf_counter() - started)
        report(f"landmark network, {batch} at a time, {name}", float(np.median(seconds[2:])), batch)


def with_tf32(allowed: bool, work: Callable[[], Any]) -> Callable[[], Any]:
    def run() -> Any:
        before, torch.backends.cudnn.allow_tf32 = torch.backends.cudnn.allow_tf32, allowed
        try:
            return work()
        finally:
            torch.backends.cudnn.allow_tf32 = before

    return run


def synchronize(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize(device)


def name_of(device: str) -> str:
    return torch.cuda.get_device_name(device) if device != "cpu" else f"CPU, {torch.get_num_threads()} threads"


def report(name: str, seconds: float, people: int, host: float | None = None) -> None:
    told = "" if host is None else f" {1000 * host:9.1f}"
    print(f"{name:45s} {1000 * seconds:9.1f} {people / seconds:9.0f}{told}")


if __name__ == "__main__":
    main(*sys.argv[1:])
