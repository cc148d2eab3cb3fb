"""Learn how far the mean of a clip's sizes lies from the mean person, for ``solve/scene/clip_sizes.py``, and print it.

    python scripts/learn_sizes.py MOCAP [--people FIRST LAST]

People of PartBench's kind from 1000 on, whom no level has, move for two seconds as in motion capture that networks
learn from; the label network observes 7.5 frames a second. It takes two seconds a person.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from warp_partdr.lab.evaluation.evaluate import one_thread
from warp_partdr.lab.harness import run_script
from warp_partdr.lab.options import Mocap, People
from warp_partdr.lab.synthetic.mocap import Clip, is_held_out, smooth_windows
from warp_partdr.lab.synthetic.mocap_files import FRAME_RATE, load_clips
from warp_partdr.lab.synthetic.scene_people import make_clip
from warp_partdr.solve.scene.observations import observe_scene

_FRAMES, _EVERY = 60, 4
_COUNTS = (1, 2, 4, 8, 15)
_BONES = [
    (0, 1),
    (1, 2),
    (3, 4),
    (4, 5),
    (6, 7),
    (7, 8),
    (9, 10),
    (10, 11),
    (2, 8),
    (3, 9),
    (12, 13),
]  # of LSP's joints


def learned_windows(folder: Path) -> list[Clip]:
    """Windows of motion that networks learn from, kinds in turn."""
    kinds: dict[str, list[Clip]] = {}
    for clip in load_clips(folder):
        if clip.name.startswith("expmap.") and not is_held_out(clip):
            kinds.setdefault(clip.name.rpartition("_")[0], []).extend(smooth_windows(clip, _FRAMES))
    some = [kinds[kind] for kind in sorted(kinds) if kinds[kind]]
    return [windows[turn % len(windows)] for turn in range(max(map(len, some))) for windows in some]


def main(mocap: Mocap, /, *, people: People = range(1000, 1600)) -> None:
    """Look at people, and print slopes and their fit.

    Args:
        mocap: Motion of the people.
        people: People whom no level has.
    """
    one_thread()
    windows, true, predicted = learned_windows(mocap), [], []
    for index in people:
        sample = make_clip(index, windows[index % len(windows)][::_EVERY], FRAME_RATE / _EVERY)
        joints = sample.joints[0, 0]
        true.append(np.log(sum(float(np.linalg.norm(joints[one] - joints[other])) for one, other in _BONES)))
        observed_bodies = observe_scene(sample.scene, torch.device("cpu"))
        predicted.append(np.log([float(observed.body.lengths.sum()) for observed in observed_bodies]))
    inverse = []
    for count in _COUNTS:
        pairs = [
            (sizes[first : first + count].mean(), size)
            for size, sizes in zip(true, predicted, strict=True)
            for first in range(0, len(sizes) - count + 1, count)
        ]
        found, size = np.array(pairs).T
        slope, start = np.polyfit(found, size, 1)
        before, after = (size - found).std(), (size - slope * found - start).std()
        inverse.append(1 / slope)
        print(f"{count} observations: slope {slope:.3f}, off by {100 * before:.2f} %, stretched {100 * after:.2f} %")
    noise, shrunk = np.polyfit(1 / np.array(_COUNTS), inverse, 1)
    middle = np.exp(np.mean([sizes.mean() for sizes in predicted]))
    print(f"slope 1 / ({shrunk:.3f} + {noise:.3f} / n), about {middle:.3f} m")


if __name__ == "__main__":
    run_script(main)
