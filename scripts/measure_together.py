"""Measure and print how many people a second are fitted side by side, from crops on the device to bodies.

    python scripts/measure_together.py [DEVICE [PEOPLE...]]

PartBench's first 64 people at realistic noise, again and again; each number of people three times, the last one counts.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import torch
import warp as wp

from warp_partdr.bulk.people import stages_of_quality
from warp_partdr.evaluation.partbench.samples import make_sample
from warp_partdr.fit.together import CutPerson, fit_together
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.observation import crop_evidence
from warp_partdr.network.checkpoint import packaged_network

_DISTINCT = 64


def main(device: str = "cpu", *counts: str) -> None:
    wp.config.log_level = wp.LOG_WARNING
    some = [cut(index, device) for index in range(_DISTINCT)]
    network = packaged_network(device)
    for quality in ("network", "fast"):
        for count in map(int, counts or ("64",)):
            people = [some[row % _DISTINCT] for row in range(count)]
            for _ in range(3):
                began = time.perf_counter()
                fit_together(people, stages_of_quality(quality), network)  # type: ignore[arg-type]
                if device != "cpu":
                    torch.cuda.synchronize()
                seconds = time.perf_counter() - began
            print(f"{quality}, {count} people: {count / seconds:.0f} a second", flush=True)


def cut(index: int, device: str) -> CutPerson:
    """One person as data sets have them."""
    sample = make_sample(index, "realistic")
    evidence = weigh_evidence(sample.keypoints, sample.parts, sample.others)[0]
    observation, crop = crop_evidence(evidence, device=device)
    return CutPerson(replace(evidence, picture=None, groups=None), observation, crop)


if __name__ == "__main__":
    main(*sys.argv[1:])
