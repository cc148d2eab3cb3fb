"""Bodies in photos of hard situations, one row a kind: how many people are found, and how right their bodies are.

Errors in depth and across the picture are of the joints that the photo shows, as in the measurement "confidence".
PA-MPJPE is over all of LSP's joints, those that nobody sees, too. "Thigh" is the girth of the found thigh as a share of
the found stature, divided by the same of the truth: a skirt or a coat makes thighs thick. "Exchanged" are bodies whose
joints lie nearer to the truth after left and right are exchanged.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ...body.landmarks import mirror_order
from ...body.skeletons import MPJPE_JOINTS
from ...errors import InputError
from ...metrics import pa_mpjpe
from ...models.anny import anny
from ...models.measuring import BODY_MEASURES, measure_body
from ...pipelines.photo import fit_photo
from ...solve.confidence.model import packaged_model
from ...solve.ellipsoids.options import FitOptions
from ...solve.mesh.mesh_stage import MeshFit
from ..options import Device, People, tracked
from ..photo_truth import match_truth, seen_errors
from ..synthetic.hard_photos import KINDS, PhotographedPerson, make_hard_photo
from ..tables import FigureTable, estimate_mean
from .confidence import RIGHT, WRONG
from .kept_keypoints import as_part_labels

_THIGH, _STATURE = BODY_MEASURES.index("thigh girth"), BODY_MEASURES.index("stature")
_MIRRORED = mirror_order(MPJPE_JOINTS)
_ARMS_AND_LEGS = [row for row, name in enumerate(MPJPE_JOINTS) if name.startswith(("left", "right"))]


@dataclass(frozen=True)
class HardCase:
    """Person in a photo of a hard situation, and the body that was found.

    Attributes:
        photo: Index of the photo.
        kind: Kind of the photo.
        person: Index of the person in the photo, 0 is the one whom the kind is about.
        confidence: Confidence in the body. NaN if the person was not found; then all that follows is NaN.
        depth: Mean error of seen joints in depth [m].
        across: Mean error of seen joints across the picture [m].
        pa_mpjpe: PA-MPJPE of all joints, for a person of the true stature [m].
        stature: Ratio of the found stature to the true one.
        thigh: Ratio of the found thigh's girth to the true one, each as a share of the stature.
        exchanged: Flag, 1 if left and right are exchanged, else 0.
    """

    photo: int
    kind: str
    person: int
    confidence: float = np.nan
    depth: float = np.nan
    across: float = np.nan
    pa_mpjpe: float = np.nan
    stature: float = np.nan
    thigh: float = np.nan
    exchanged: float = np.nan

    @property
    def found(self) -> bool:
        """True if the person was found."""
        return bool(np.isfinite(self.depth))


def hard_cases(index: int, kind: str, device: str, options: FitOptions | None = None) -> Iterator[HardCase]:
    """The people of photo ``index`` of a kind, found or not, with fits that have these options."""
    photo = make_hard_photo(index, kind)
    cases = {row: HardCase(index, kind, row) for row in range(len(photo.people))}
    try:
        fit = fit_photo(photo.pixels, device=device, options=options)
    except InputError:  # nobody is found
        yield from cases.values()
        return
    for found, row in match_truth(fit, photo).items():
        cases[row] = _case(cases[row], fit.fits[found], photo.people[row], fit.confidences[found].probability)
    yield from cases.values()


def _case(case: HardCase, fit: MeshFit, person: PhotographedPerson, confidence: float) -> HardCase:
    joints = fit.landmarks(MPJPE_JOINTS)
    depth, across, _ = seen_errors(joints, person)
    model = anny()
    true = measure_body(model, model.rest(person.shape))[0].numpy()
    own = measure_body(fit.body.model, fit.body.rest())[0].cpu().numpy()
    exchanged = _limbs_apart(joints, person.joints[_MIRRORED]) < _limbs_apart(joints, person.joints)
    return HardCase(
        case.photo,
        case.kind,
        case.person,
        confidence,
        depth,
        across,
        float(pa_mpjpe(torch.from_numpy(joints), torch.from_numpy(person.joints))),
        float(own[_STATURE] / true[_STATURE]),
        float(own[_THIGH] / own[_STATURE] / (true[_THIGH] / true[_STATURE])),
        float(exchanged),
    )


def _limbs_apart(joints: np.ndarray, others: np.ndarray) -> float:
    """Mean distance of the joints of arms and legs, after a move that brings their means together [m]."""
    differences = joints[_ARMS_AND_LEGS] - others[_ARMS_AND_LEGS]
    return float(np.linalg.norm(differences - differences.mean(axis=0), axis=1).mean())


def measure_hard_cases(
    *,
    people: People = range(70_000, 70_020),
    kinds: tuple[str, ...] = KINDS,
    as_parts: bool = False,
    device: Device = "cpu",
    save: Path | None = None,
) -> Iterator[FigureTable]:
    """Find and fit the people in photos of hard situations.

    Args:
        people: Indices of photos, the same for each kind.
        kinds: Kinds of photos.
        as_parts: Switch that lets masks count as much as part labels.
        device: Device of the fits.
        save: File .npz for the rows of all people.
    """
    for kind in kinds:
        if kind not in KINDS:
            raise InputError(f"kinds: {kind!r}; expected some of {', '.join(KINDS)}")
    pairs = [(index, kind) for kind in kinds for index in people]
    options = FitOptions.at("balanced")
    if as_parts:
        options = replace(options, mesh=as_part_labels(options.mesh))
    cases = [case for index, kind in tracked(pairs) for case in hard_cases(index, kind, device, options)]
    if save is not None:
        save_cases(save, cases)
    yield describe_cases(cases)


def describe_cases(cases: Sequence[HardCase]) -> FigureTable:
    """Table with a row for each kind."""
    columns = {
        "photos of": "",
        "people": "d",
        "found [%]": ".0f",
        "depth [cm]": ".1f",
        "across [cm]": ".1f",
        "PA-MPJPE [mm]": ".0f",
        "stature off [%]": ".1f",
        "thigh": ".2f",
        "exchanged [%]": ".0f",
        "right [%]": ".0f",
        "wrong [%]": ".0f",
        "right, warned [%]": ".0f",
        "wrong, warned [%]": ".0f",
    }
    table = FigureTable(f"{len(cases)} people", columns)
    least = packaged_model().least
    for kind in dict.fromkeys(case.kind for case in cases):
        own = [case for case in cases if case.kind == kind]
        found = [case for case in own if case.found]
        if not found:
            table.add(kind, len(own), 0.0, *[None] * (len(columns) - 3))
            continue
        largest = np.array([max(case.depth, case.across) for case in found])
        warned = np.array([case.confidence < least for case in found])
        right, wrong = largest < RIGHT, largest >= WRONG
        table.add(
            kind,
            len(own),
            100 * len(found) / len(own),
            estimate_mean([100 * case.depth for case in found]),
            estimate_mean([100 * case.across for case in found]),
            estimate_mean([1000 * case.pa_mpjpe for case in found]),
            100 * float(np.median([abs(case.stature - 1) for case in found])),
            float(np.median([case.thigh for case in found])),
            100 * float(np.mean([case.exchanged for case in found])),
            100 * float(right.mean()),
            100 * float(wrong.mean()),
            100 * float(warned[right].mean()) if right.any() else None,
            100 * float(warned[wrong].mean()) if wrong.any() else None,
        )
    return table


def save_cases(path: Path, cases: Sequence[HardCase]) -> None:
    """Write cases as columns."""
    names = list(HardCase.__dataclass_fields__)
    table: dict[str, Any] = {name: np.array([getattr(case, name) for case in cases]) for name in names}
    np.savez_compressed(path, **table)


def read_cases(path: Path) -> list[HardCase]:
    """Read the cases that ``save_cases`` wrote."""
    columns = {name: values.tolist() for name, values in np.load(path).items()}
    return [HardCase(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]
