"""Speed of fits side by side, from crops on the device to bodies.

PartBench's first 64 people at realistic noise whose keypoints are COCO's are fitted again and again; each number of
people three times, of which the last one counts. A fourth time, which waits for the device after each step, says where
the time goes.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, islice

from ...bulk.people import kept_label_size, stages_of_quality
from ...bulk.rows import PeopleRows, columns, describe_bodies, people_table
from ...inputs.cut_people import CutPeople, CutPerson
from ...inputs.evidence import weigh_evidence
from ...inputs.observation import crop_evidence
from ...inputs.sample import Sample
from ...networks.regression import predict
from ...networks.regression.checkpoint import packaged_network
from ...solve.ellipsoids import captured, depth_flips, network_start
from ...solve.ellipsoids.batch import Batch
from ...solve.ellipsoids.energy import Energy
from ...solve.ellipsoids.fitting import fit_people
from ..clocks import Step, StepClock, synchronize
from ..evaluation.partbench.samples import make_sample
from ..options import Counts, Device
from ..synthetic.partbench_people import COCO
from ..tables import FigureTable

_DISTINCT = 64
_STEPS = (
    Step(predict, "upright_inputs", "network, its input"),
    Step(network_start, "ask_network", "network"),
    Step(Energy, "__post_init__", "expected sizes and label images"),
    Step(Batch, "of", "landmarks in their places"),
    Step(depth_flips, "_propose", "depth flips proposed"),
    Step(network_start, "repair_depth_orders", "depth flips chosen"),
    Step(captured.CapturedRefinement, "__init__", "refinement, set up and captured"),
    Step(captured.CapturedRefinement, "refine", "refinement, replayed"),
)


def measure_together(
    *, counts: Counts = (64,), device: Device = "cpu", half: bool = False, alone: bool = False
) -> Iterator[FigureTable | str]:
    """Time fits by the network alone and at the quality "fast".

    Args:
        counts: Numbers of people side by side.
        device: Device of the fits.
        half: Ask the network in bfloat16.
        alone: Ask the network without the mirror image.
    """
    network = packaged_network(device)
    size = kept_label_size(stages_of_quality("fast"), network, meshes=False)
    coco = (sample for sample in map(_sample, count(0)) if sample.keypoints.format == COCO)
    some = [_cut(sample, size) for sample in islice(coco, _DISTINCT)]
    for quality in ("network", "fast"):
        options = replace(stages_of_quality(quality), half=half, mirror=not alone)
        for number in counts:
            people = CutPeople.of([some[row % _DISTINCT] for row in range(number)]).to(device)
            for _ in range(3):
                synchronize(device)
                began = time.perf_counter()
                fits = fit_people(people, options, network)
                synchronize(device)
                seconds = time.perf_counter() - began
            yield f"{quality}, {number} people: {number / seconds:.0f} a second"
            clock = StepClock(device, _STEPS)
            clock.measure(lambda: fit_people(people, options, network))  # noqa: B023  at once
            yield clock.table(f"{quality}, {number} people", number)
            began = time.perf_counter()
            rows = PeopleRows(number, describe_bodies(fits))
            people_table(rows, columns("coco17"), {})
            beside = 1e6 * (time.perf_counter() - began) / number
            yield f"Rows of a data set are made beside it, in {beside:.1f} µs a person."


def _sample(index: int) -> Sample:
    return make_sample(index, "realistic")


def _cut(sample: Sample, label_size: int) -> CutPerson:
    """One person as data sets have them."""
    evidence = weigh_evidence(sample.keypoints, sample.parts, sample.others)[0]
    observation, crop = crop_evidence(evidence, label_size=label_size)
    return CutPerson(replace(evidence, picture=None, groups=None), observation, crop)
