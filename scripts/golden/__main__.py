"""Results of the package before and after a change of its code, compared to the bit or within a tolerance.

    python scripts/golden save before.npz                   # with the code before
    python scripts/golden check before.npz                  # after; exit code 1 if a bit differs
    python scripts/golden check before.npz --within 0.1     # accepts differences up to 0.1 mm (see differences.py)
    python scripts/golden check before.npz --only photo     # one topic alone; may be repeated

Results belong to a machine, its library versions and its number of CPU threads, which is one here.
The topics need the extras "film" and "dataset".
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

os.environ["OMP_NUM_THREADS"] = "1"  # before torch is loaded, here and by the commands

import commands
import drawing
import fits
import torch
from differences import Found, difference_between

from warp_partdr.kernels.launch import set_num_threads

TOPICS: dict[str, Callable[[], Found]] = {
    "drawing": drawing.drawing,
    "example": fits.example,
    "people": fits.people,
    "together": fits.together,
    "overlap": fits.overlap,
    "views": fits.views,
    "photo": fits.photo,
    "saved person": commands.saved_person,
    "saved photo": commands.saved_photo,
    "saved film": commands.saved_film,
    "saved views": commands.saved_views,
    "dataset": commands.dataset,
    "predict": commands.predict,
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
    found = {f"{topic}: {name}": value for name, value in TOPICS[topic]().items()}
    print(f"{topic}: {len(found)} results in {time.perf_counter() - started:.0f} s", flush=True)
    return found


def check(file: Path, topics: Sequence[str], within: float | None) -> bool:
    """Run the topics, print what differs from the file and how much, and return whether all of it is accepted."""
    with np.load(file, allow_pickle=False) as saved:
        expected = {name: saved[name] for name in saved.files if name.partition(": ")[0] in topics}
    same, accepted = 0, 0
    for topic in topics:
        before = {name: value for name, value in expected.items() if name.partition(": ")[0] == topic}
        after = run(topic)
        for name in sorted({*before, *after}):
            difference = difference_between(before.get(name), after.get(name))
            if difference is None:
                same += 1
                continue
            if within is not None and difference.amount <= within:
                accepted += 1
            print(f"  {name}: {difference}", flush=True)
        expected |= after  # counts what is new, too
    told = f"{same} of {len(expected)} results are the same to the bit"
    if within is not None:
        told += f", {accepted} are within {within:g} mm, {len(expected) - same - accepted} are not"
    print(told)
    return same + accepted == len(expected)


if __name__ == "__main__":
    main()
