"""Speed of finding people and giving them bodies by the networks, stage by stage.

Pictures show the packaged example's person, a bit elsewhere in each. Shown are medians of five runs after one that
loads and captures: milliseconds, people a second, and milliseconds until the host had nothing more to do than to wait
for the device; on CUDA with networks in float32, then in 16 bits, as data sets have them. Below, kernels of the
evidence, and the landmark network alone, in both precisions and launch by launch.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
import warp as wp
from PIL import Image

from ...inputs.cut_out import cut_out_people
from ...inputs.cut_people import CutPeople, CutPerson
from ...inputs.evidence import PicturePerson
from ...inputs.own_pixels import Mask
from ...inputs.part_labels import read_photo
from ...networks.detection import MIN_SCORE
from ...networks.detection.asset import packaged_people_networks
from ...networks.detection.crops import Pyramid, join_crops
from ...networks.detection.detector import detect_people, tiles
from ...networks.detection.look import look
from ...networks.detection.masks import instance_maps
from ...networks.detection.people import find_people_in
from ...networks.regression.checkpoint import packaged_network
from ...networks.regression.predict import ask_network
from ..clocks import synchronize
from ..options import Device
from ..tables import FigureTable

_EXAMPLE = Path(__file__).resolve().parents[2] / "assets" / "example"
_RUNS = 5


def measure_people(*, count: int = 256, side: int = 384, device: Device = "cpu") -> Iterator[FigureTable]:
    """Time the stages.

    Args:
        count: Number of pictures, with one person each.
        side: Height and width of a picture [px].
        device: Device of the networks.
    """
    pictures = _example_pictures(count, side)
    precisions = (False,) if device == "cpu" else (False, True)
    for half in precisions:
        _timed(pictures, device, half)
        passes = [_timed(pictures, device, half) for _ in range(_RUNS)]
        table = _empty_table(f"{count} people in pictures of {side} px, {_name_of(device)}, {_precision(half)}")
        for stage in passes[0]:
            seconds, host = np.median([each[stage] for each in passes], axis=0).tolist()
            table.add(stage, 1000 * seconds, len(pictures) / seconds, 1000 * host)
        yield table
    yield _kernels(pictures, device)
    batches = (1, 4) if device == "cpu" else (1, 16, 256)
    table = _empty_table("Landmark network alone")
    for batch in batches:
        for half in precisions:
            _add_landmarks(table, device, batch, half)
    yield table


def _empty_table(title: str) -> FigureTable:
    return FigureTable(title, {"stage": "", "time [ms]": ".1f", "people a second": ".0f", "host [ms]": ".1f"})


def _precision(half: bool) -> str:
    return "16 bits" if half else "float32"


def _example_pictures(count: int, side: int) -> list[np.ndarray]:
    photo = Image.fromarray(read_photo(_EXAMPLE / "photo.png"))
    size = round(photo.width * side / photo.height), side
    ground = Image.new("RGB", (side, side), photo.getpixel((5, 5)))
    pictures = []
    for index in range(count):
        picture = ground.copy()
        picture.paste(photo.resize(size), (index % max(side - size[0], 1), 0))
        pictures.append(np.asarray(picture))
    return pictures


@torch.no_grad()
def _timed(pictures: list[np.ndarray], device: str, half: bool) -> dict[str, np.ndarray]:
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
    sizes = [(side, side)] * len(pictures)
    pyramids = stage("pictures to the device", lambda: Pyramid.each(pictures, networks.device))
    wholes = join_crops([tiles(size, 0, index) for index, size in enumerate(sizes)])
    detected = stage("detector", lambda: detect_people(networks, pyramids, wholes, MIN_SCORE))
    detected = detected[detected.scores >= MIN_SCORE]
    assert len(detected) == len(pictures)
    first = stage("landmarks, first look", lambda: look(networks, pyramids, detected.crops()))
    found = stage("landmarks, second look", lambda: look(networks, pyramids, first.next_crops))
    people = stage("masks", lambda: found.people(rows, found.presence, np.array(sizes)))
    seconds["so far"] = np.sum(list(seconds.values()), axis=0)
    stage("all of these: find_people_in", lambda: find_people_in(pictures, device=device, half=half))
    owners = stage("whom each pixel shows", lambda: instance_maps([[each] for each in people], sizes))
    masked = [PicturePerson(each.keypoints, Mask(shown, 1)) for each, shown in zip(people, owners, strict=True)]
    cut = stage("evidence and crops", lambda: cut_out_people(masked, device))
    together = stage("people as arrays", lambda: CutPeople.of([each for each in cut if isinstance(each, CutPerson)]))
    stage("label network", lambda: ask_network(together.observations, network, half=half).parameters())
    names = ["all of these: find_people_in", "whom each pixel shows", "evidence and crops", "people as arrays"]
    names.append("label network")
    seconds["from pictures to bodies"] = np.sum([seconds[name] for name in names], axis=0)
    return seconds


def _kernels(pictures: list[np.ndarray], device: str) -> FigureTable:
    """Each kernel of the evidence, with a clock that waits for it."""
    people = [each[0] for each in find_people_in(pictures, device=device)]
    owners = instance_maps([[each] for each in people], [(each.shape[0], each.shape[1]) for each in pictures])
    masked = [PicturePerson(each.keypoints, Mask(shown, 1)) for each, shown in zip(people, owners, strict=True)]
    seconds: dict[str, float] = {}
    launch = wp.launch

    def clocked(kernel: Any, *args: Any, **options: Any) -> None:
        synchronize(device)
        started = time.perf_counter()
        launch(kernel, *args, **options)
        synchronize(device)
        seconds[kernel.key] = seconds.get(kernel.key, 0.0) + time.perf_counter() - started

    with patch.object(wp, "launch", clocked):
        cut_out_people(masked, device)
    table = _empty_table("Kernels of the evidence")
    for name, each in seconds.items():
        table.add(name, 1000 * each, len(pictures) / each, None)
    return table


@torch.no_grad()
def _add_landmarks(table: FigureTable, device: str, batch: int, half: bool) -> None:
    """Add rows of the landmark network as it is called, and launch by launch."""
    network = packaged_people_networks(device, half=half).landmarks
    pictures = torch.rand(batch, 3, network.size, network.size, device=device)
    for name, work in (("", network), (", launch by launch", network._run)):
        times = []
        for _ in range(_RUNS + 2):
            synchronize(device)
            started = time.perf_counter()
            work(pictures)
            synchronize(device)
            times.append(time.perf_counter() - started)
        seconds = float(np.median(times[2:]))
        table.add(f"{batch} at a time, {_precision(half)}{name}", 1000 * seconds, batch / seconds, None)


def _name_of(device: str) -> str:
    return torch.cuda.get_device_name(device) if device != "cpu" else f"CPU, {torch.get_num_threads()} threads"
