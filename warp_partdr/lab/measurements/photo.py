"""Agreement of fits from photos alone with part labels and keypoints of other predictors.

FOLDER holds NAME.jpg, NAME.keypoints.json and NAME.parts.png of one of the people, and labels.json. F1 counts pixels
pooled over the photos; part F1 is over LSP's six parts and background.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from ...body.labels import label_set, regroup
from ...errors import InputError
from ...inputs.evidence import weigh_evidence
from ...inputs.keypoint_files import read_keypoints
from ...inputs.keypoints import person_height
from ...inputs.part_labels import read_labelled_parts, read_photo
from ...metrics import confusion, foreground_counts, part_f1
from ...networks.detection import PackagedParts
from ...pipelines.photo import fit_photo
from ..options import tracked
from ..tables import Cell, FigureTable

_COARSE = label_set("lsp6")
_COLUMNS = {
    "photo": "",
    "people": "d",
    "time [s]": ".2f",
    "keypoints off [%]": ".2f",
    "foreground F1": ".3f",
    "part F1": ".3f",
}


def measure_photo(folder: Path, /) -> Iterator[FigureTable]:
    """Fit everyone in each photo, with parts of the part head and with masks, and compare the labelled person.

    Args:
        folder: Folder of photos with labels and keypoints.

    Raises:
        InputError: If there are no photos.
    """
    photos = sorted(folder.glob("*.jpg"))
    if not photos:
        raise InputError(f"{folder}: no .jpg; expected photos with keypoints and part labels")
    for parts_from in get_args(PackagedParts):
        yield _measure(photos, parts_from)


def _measure(photos: Sequence[Path], parts_from: PackagedParts) -> FigureTable:
    table = FigureTable(f"Photos alone, parts from: {parts_from}", _COLUMNS)
    pooled = np.zeros((_COARSE.num_groups + 1,) * 2, dtype=np.int64)
    for path in tracked(photos, "photos"):
        photo, truth = read_photo(path), read_keypoints(path.with_suffix(".keypoints.json"))[0]
        labels = read_labelled_parts(path.with_suffix(".parts.png"), None)
        assert labels is not None
        fit_photo(photo, parts_from=parts_from)  # loads kernels
        started = time.perf_counter()
        everyone = fit_photo(photo, parts_from=parts_from)
        seconds = time.perf_counter() - started
        confident = truth.confident
        apart = [
            np.linalg.norm(each.keypoints.points - truth.points, axis=1)[confident].mean() for each in everyone.people
        ]
        nearest = int(np.argmin(apart))
        others = [each.keypoints for index, each in enumerate(everyone.people) if index != nearest]
        evidence = weigh_evidence(truth, labels, others)[0]
        size = photo.shape[0], photo.shape[1]
        drawn = everyone.fits[nearest].draw(size).labels[0].cpu().numpy()
        groups = regroup(labels.label_set, _COARSE)
        counts = confusion(
            groups[labels.label_set.part_groups][drawn], groups[evidence.target(size)], _COARSE.num_groups + 1
        )
        pooled += counts
        off = 100 * float(apart[nearest]) / person_height(truth)
        table.add(path.stem, len(everyone.people), seconds, off, *_scores(counts))
    table.add("pooled", None, None, None, *_scores(pooled))
    return table


def _scores(counts: np.ndarray) -> list[Cell]:
    """Both F1 of pixels by label that is shown and true one."""
    return [float(part_f1(foreground_counts(counts))), float(part_f1(counts))]
