"""Calibration of the confidence in bodies: photos of people in hard situations, found, fitted and compared.

A body is right if its joints lie, on average, within 10 cm of the truth in depth and within 10 cm across the picture.
It is wrong if one of the two errors is 20 cm or more, or if nobody is there. Only joints that the photo shows count,
after a move that brings their mean to the truth, for a person of 1.7 m. The model learned from the photos from 40000
on, except for every fifth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...body.skeletons import MPJPE_JOINTS
from ...errors import InputError
from ...inputs.observations import Observations
from ...pipelines.photo import fit_photo
from ...solve.confidence.limbs import LIMBS
from ...solve.confidence.measures import detection_measures, measure_bodies
from ...solve.confidence.model import packaged_model
from ..options import Device, People, tracked
from ..photo_truth import match_truth, seen_errors
from ..synthetic.hard_photos import make_hard_photo
from ..tables import FigureTable

RIGHT, WRONG = 0.1, 0.2  # [m], largest error of a right body, and least error of a wrong body
LIMB_RIGHT = 0.2  # [m], largest mean distance of a right limb's joints from the truth
HELD_OUT = 5  # every fifth photo is not learned from
LEARNED_FROM = 40_000  # first photo that the model learned from


@dataclass(frozen=True)
class ConfidenceRow:
    """Body in a photo, with its measures and errors.

    Attributes:
        photo: Index of the photo.
        kind: Kind of the photo.
        stated: Confidence that was stated.
        measures: Measures of the body by name.
        limb_measures: Measures of the limbs by name, shape (5,) each.
        errors: Mean error of the seen joints in depth, and across the picture [m]; infinite if nobody is there.
        limb_errors: Mean distance of each limb's joints [m], likewise, shape (5,).
    """

    photo: int
    kind: str
    stated: float
    measures: dict[str, float]
    limb_measures: dict[str, np.ndarray]
    errors: tuple[float, float]
    limb_errors: np.ndarray


def confidence_rows(index: int, device: str) -> Iterator[ConfidenceRow]:
    """Bodies that are found in a photo, which its index names."""
    photo = make_hard_photo(index)
    try:
        fit = fit_photo(photo.pixels, device=device, min_score=0.4)
    except InputError:
        return
    same = match_truth(fit, photo)
    for person, mesh in fit.fits.items():
        last = mesh.ellipbody
        measured = measure_bodies(last.parameters, Observations.of([last.observation]), last.uncertainty)
        measures = {name: float(values[0]) for name, values in measured.columns().items()}
        depth, across, limbs = np.inf, np.inf, np.full(len(LIMBS), np.inf)
        if person in same:
            depth, across, limbs = seen_errors(mesh.landmarks(MPJPE_JOINTS), photo.people[same[person]])
        yield ConfidenceRow(
            index,
            photo.kind,
            fit.confidences[person].probability,
            measures | detection_measures(fit.people[person]),
            {name: values[0] for name, values in measured.limb_columns().items()},
            (depth, across),
            limbs,
        )


def measure_confidence(
    *, people: People = range(60_000, 60_100), device: Device = "cpu", save: Path | None = None
) -> Iterator[FigureTable | str]:
    """Compare stated confidence with the truth.

    Args:
        people: Indices of photos. The model learned from 40000 to 49999, except for every fifth.
        device: Device of the fits.
        save: File .npz for the measures and errors, from which scripts/learn_confidence.py learns.
    """
    rows = [row for index in tracked(people) for row in confidence_rows(index, device)]
    if save is not None:
        save_rows(save, rows)
    yield from describe_confidence(rows)


def describe_confidence(rows: list[ConfidenceRow]) -> Iterator[FigureTable | str]:
    """Tables of how well confidence tells right bodies from wrong ones, and whether it is calibrated."""
    stated = np.array([row.stated for row in rows])
    largest = np.array([max(row.errors) for row in rows])
    right, wrong = largest < RIGHT, largest >= WRONG
    least = packaged_model().least
    clear = right | wrong
    table = FigureTable(
        f"{len(rows)} bodies",
        {"bodies": "", "number": "d", "AUC": ".3f", "right, warned [%]": ".0f", "wrong, warned [%]": ".0f"},
    )
    kinds = np.array([row.kind for row in rows])
    groups = {"all": np.ones(len(rows), dtype=bool)} | {str(kind): kinds == kind for kind in np.unique(kinds)}
    for name, some in groups.items():
        area = area_under_curve(stated[some & clear], right[some & clear])
        warned = [_percent(stated[some & those] < least) for those in (right, wrong)]
        table.add(name, int(some.sum()), area, *warned)
    yield table
    curve = FigureTable("reliability", {"confidence": "", "stated": ".2f", "right": ".2f", "bodies": "d"})
    for low in np.arange(0, 1, 0.2):
        some = (stated >= low) & (stated < low + 0.2)
        if some.any():
            shares = float(stated[some].mean()), float(right[some].mean())
            curve.add(f"{low:.1f} to {low + 0.2:.1f}", *shares, int(some.sum()))
    yield curve
    yield f"{int(right.sum())} right, {int(wrong.sum())} wrong, of them {int(np.isinf(largest).sum())} show nobody"


def _percent(flags: np.ndarray) -> float:
    return 100 * float(flags.mean()) if len(flags) else float("nan")


def area_under_curve(scores: np.ndarray, right: np.ndarray) -> float:
    """Chance that a right body has a higher score than a wrong one, where equal scores count half."""
    if right.all() or not right.any():
        return float("nan")
    above = scores[right][:, None] - scores[~right]
    return float(((above > 0) + 0.5 * (above == 0)).mean())


def save_rows(path: Path, rows: list[ConfidenceRow]) -> None:
    """Write rows as columns; measures that a body lacks are NaN."""
    names = sorted({name for row in rows for name in row.measures})
    limb_names = sorted({name for row in rows for name in row.limb_measures})
    none = np.full(len(LIMBS), np.nan)
    table: dict[str, Any] = {
        "photo": [row.photo for row in rows],
        "kind": [row.kind for row in rows],
        "errors": [row.errors for row in rows],
        "limb_errors": np.array([row.limb_errors for row in rows]),
    }
    table |= {f"body {name}": [row.measures.get(name, np.nan) for row in rows] for name in names}
    table |= {f"limb {name}": np.array([row.limb_measures.get(name, none) for row in rows]) for name in limb_names}
    np.savez_compressed(path, **table)
