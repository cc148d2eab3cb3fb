"""Measure and print how good fits from photos alone are, against part labels and keypoints of other predictors.

    python scripts/measure_photo.py FOLDER
    python scripts/measure_photo.py PHOTO.jpg

FOLDER holds NAME.jpg, NAME.keypoints.json and NAME.parts.png of one of the people, and labels.json. F1 is of pixels
pooled over the photos, part F1 of LSP's six parts and background. Of a single photo, four copies are put side by side
two and two, and the time of a fit to everyone in them is printed.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import warp as wp

from warp_partdr import metrics
from warp_partdr.body.labels import label_set, regroup
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import person_height
from warp_partdr.inputs.part_labels import read_labelled_parts, read_photo
from warp_partdr.pipelines.photo import fit_photo

COARSE = label_set("lsp6")


def main(folder: Path) -> None:
    wp.config.log_level = wp.LOG_WARNING
    pooled = np.zeros((COARSE.num_groups + 1,) * 2, dtype=np.int64)
    for path in sorted(folder.glob("*.jpg")):
        photo, truth = read_photo(path), read_keypoints(path.with_suffix(".keypoints.json"))[0]
        labels = read_labelled_parts(path.with_suffix(".parts.png"), None)
        assert labels is not None
        fit_photo(photo)  # loads kernels
        started = time.perf_counter()
        everyone = fit_photo(photo)
        seconds = time.perf_counter() - started
        sure = truth.confident
        apart = [np.linalg.norm(each.keypoints.points - truth.points, axis=1)[sure].mean() for each in everyone.people]
        place = int(np.argmin(apart))
        others = [each.keypoints for index, each in enumerate(everyone.people) if index != place]
        seen = weigh_evidence(truth, labels, others)[0]
        size = photo.shape[0], photo.shape[1]
        drawn = everyone.fits[place].draw(size).labels[0].cpu().numpy()
        table = regroup(labels.label_set, COARSE)
        counts = metrics.confusion(
            table[labels.label_set.part_groups][drawn], table[seen.target(size)], COARSE.num_groups + 1
        )
        pooled += counts
        off = 100 * apart[place] / person_height(truth)
        print(f"{path.stem}: {len(everyone.people)} people, {seconds:.2f} s, keypoints {off:.2f} %, {scores(counts)}")
    print(f"pooled: {scores(pooled)}")


def measure_time(path: Path) -> None:
    """Seconds of a fit to everyone in four copies of a photo, after loading: the least and the median of five."""
    wp.config.log_level = wp.LOG_WARNING
    photo = np.tile(read_photo(path), (2, 2, 1))
    seconds = []
    for _ in range(6):
        started = time.perf_counter()
        everyone = fit_photo(photo)
        seconds.append(time.perf_counter() - started)
    least, median = min(seconds[1:]), float(np.median(seconds[1:]))  # the first one loads kernels
    print(f"{len(everyone.people)} people in {photo.shape[1]}x{photo.shape[0]}: {least:.2f} s, median {median:.2f} s")


def scores(counts: np.ndarray) -> str:
    """Both F1 of pixels by label that is shown and true one."""
    foreground = float(metrics.part_f1(metrics.foreground_counts(counts)))
    return f"foreground F1 {foreground:.3f}, part F1 {float(metrics.part_f1(counts)):.3f}"


if __name__ == "__main__":
    (main if Path(sys.argv[1]).is_dir() else measure_time)(Path(sys.argv[1]))
