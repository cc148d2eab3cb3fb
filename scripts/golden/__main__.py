"""Results of the package before and after a change of its code, compared to the bit or within a tolerance.

    python scripts/golden save before.npz                   # with the code before
    python scripts/golden check before.npz                  # after; exit code 1 if a bit differs
    python scripts/golden check before.npz --within 0.5     # accepts differences up to 0.5 mm (see differences.py)
    python scripts/golden check before.npz --only photo     # one topic alone; may be repeated

A tolerance is for a change that rounds otherwise. It holds for the topics that are steady. The fits of the others take
many steps, which magnify rounding; of these, any difference of numbers is accepted and summed up in a line. For
comparison: when the label network's joint angles and lengths change by 2e-7, steady results differ by up to 0.5 and
half of those that differ by up to 0.001; of the others, half differ by up to 5, and all by up to 260.

Results belong to a machine, its library versions and its number of CPU threads, which is one here.
The topics need the extras "film" and "dataset".
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np

os.environ["OMP_NUM_THREADS"] = "1"  # before torch is loaded, here and by the commands

import commands
import drawing
import fits
import torch
from differences import Found, difference_between

from warp_partdr.kernels.launch import set_num_threads


@dataclass(frozen=True)
class Topic:
    """Results that belong together.

    Attributes:
        run: Makes them.
        steady: Rounding changes them little. Fits of many steps magnify it to millimetres, because Adam's steps do not
            become small where gradients do.
    """

    run: Callable[[], Found]
    steady: bool = False


MAGNIFIED = sys.float_info.max  # accepted in topics that are not steady: any difference of numbers
TOPICS = {
    "drawing": Topic(drawing.drawing, steady=True),
    "example": Topic(fits.example),
    "people": Topic(partial(fits.people, few_steps=False)),
    "people, few steps": Topic(partial(fits.people, few_steps=True), steady=True),
    "together": Topic(partial(fits.together, few_steps=False)),
    "together, few steps": Topic(partial(fits.together, few_steps=True), steady=True),
    "overlap": Topic(partial(fits.overlap, few_steps=False)),
    "overlap, few steps": Topic(partial(fits.overlap, few_steps=True), steady=True),
    "views": Topic(partial(fits.views, few_steps=False)),
    "views, few steps": Topic(partial(fits.views, few_steps=True), steady=True),
    "photo": Topic(partial(fits.photo, few_steps=False)),
    "photo, few steps": Topic(partial(fits.photo, few_steps=True), steady=True),
    "saved by default": Topic(commands.saved_by_default),
    "saved person": Topic(commands.saved_person, steady=True),
    "saved photo": Topic(commands.saved_photo, steady=True),
    "saved film": Topic(commands.saved_film, steady=True),
    "saved views": Topic(commands.saved_views, steady=True),
    "dataset": Topic(commands.dataset, steady=True),
    "predict": Topic(commands.predict, steady=True),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["save", "check"])
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", action="append", choices=list(TOPICS), metavar="TOPIC", help=", ".join(TOPICS))
    parser.add_argument("--within", type=float, metavar="MM", help="differences to accept; default: not a bit")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    set_num_threads(1)
    topics = arguments.only or list(TOPICS)
    if arguments.action == "save":
        found = {name: value for topic in topics for name, value in run(topic).items()}
        with arguments.file.open("wb") as file:  # given a name, NumPy might change its ending
            np.savez_compressed(file, allow_pickle=False, **found)
    else:
        sys.exit(not check(arguments.file, topics, arguments.within))


def run(topic: str) -> Found:
    """Results of a topic, by names that begin with its own."""
    started = time.perf_counter()
    found = {f"{topic}: {name}": value for name, value in TOPICS[topic].run().items()}
    print(f"{topic}: {len(found)} results in {time.perf_counter() - started:.0f} s", flush=True)
    return found


def check(file: Path, topics: Sequence[str], within: float | None) -> bool:
    """Run the topics, print what differs from the file and how much, and return whether all of it is accepted."""
    with np.load(file, allow_pickle=False) as saved:
        expected = {name: saved[name] for name in saved.files}
    results, same, accepted = 0, 0, 0
    for topic in topics:
        before = {name: value for name, value in expected.items() if name.partition(": ")[0] == topic}
        after = run(topic)
        limit = 0.0 if within is None else within if TOPICS[topic].steady else MAGNIFIED
        amounts = []
        for name in sorted({*before, *after}):
            results += 1
            difference = difference_between(before.get(name), after.get(name))
            if difference is None:
                same += 1
                continue
            amounts.append(difference.amount)
            accepted += difference.amount <= limit
            if difference.amount > limit:
                print(f"  {name}: {difference}", flush=True)
        if amounts:
            print(
                f"  {len(amounts)} differ, half of them by up to {median(amounts):.2g}, all by up to {max(amounts):.2g}"
            )
    refused = results - same - accepted
    print(f"{same} of {results} results are the same to the bit, {accepted} are accepted, {refused} are not")
    return not refused


if __name__ == "__main__":
    main()
