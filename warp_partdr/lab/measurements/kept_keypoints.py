"""Distances of fitted bodies from the keypoints of real photos, where nothing but the photo is known.

FOLDER is that of the measurement "found-people", whose upright photos are taken; of each, the largest person counts.
Distances of the face's landmarks, and of those of the arms, are means weighted by the keypoints' confidence, as shares
of the person's height. Without a true pose, this says only whether heads and arms are where the photo shows them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from ...body.landmarks import annotated
from ...cameras import UsualLens
from ...errors import InputError
from ...inputs.keypoints import Keypoints2D, person_height
from ...networks.detection.masks import instance_map
from ...networks.detection.people import find_people
from ...pipelines.photo import person_evidence
from ...solve.ellipsoids.fitting import fit_evidence
from ...solve.ellipsoids.options import FitOptions
from ...solve.ellipsoids.result import FitResult
from ...solve.mesh.mask_weights import ONE_MASK
from ...solve.mesh.mesh_options import MeshOptions
from ...solve.mesh.mesh_stage import MeshFit, refine_mesh
from ..options import Device, tracked
from ..tables import FigureTable, estimate_mean
from .found_people import marked_photos

_FACE = ("nose", "left_eye", "right_eye", "left_ear", "right_ear", "mouth_left", "mouth_right")
_ARMS = ("left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist")
_FAR = 0.04  # of the height, distance from which on a face or an arm is not where the photo shows it


def measure_kept_keypoints(folder: Path, /, *, device: Device = "cpu") -> Iterator[FigureTable]:
    """Fit the largest person of each photo, and compare the body with the keypoints.

    Args:
        folder: Folder of the packages' contents.
        device: Device of the fits.

    Raises:
        InputError: If a photo is missing, or nobody is found in any.
    """
    found: dict[str, list[tuple[float, float]]] = {}
    for photo in tracked([each for each in marked_photos() if each.turn == 0]):
        for name, distances in _distances(photo.read(folder), device).items():
            found.setdefault(name, []).append(distances)
    if not found:
        raise InputError(f"{folder}: nobody found in its photos; expected people")
    columns = {"fit": "", "photos": "d"}
    for part in ("face", "arms"):
        columns |= {f"{part} [%]": ".1f", f"{part}, median": ".1f", f"{part}, far [%]": ".0f"}
    table = FigureTable("Distances from keypoints, as shares of the height", columns)
    for name, rows in found.items():
        values = 100 * np.array(rows)
        cells = [
            cell
            for each in values.T
            for cell in (estimate_mean(each), float(np.median(each)), 100 * float((each > 100 * _FAR).mean()))
        ]
        table.add(name, len(rows), *cells)
    yield table


def _distances(picture: np.ndarray, device: str) -> dict[str, tuple[float, float]]:
    """Distances of face and arms of each fit of the largest person; none if nobody is found."""
    people = find_people(picture, device=device, landmarks="heavy")
    if not people:
        return {}
    options, keypoints = FitOptions.at("balanced"), people[0].keypoints
    evidence = person_evidence(keypoints, instance_map(people, picture.shape[:2]), 0)
    camera = UsualLens.of_size((picture.shape[0], picture.shape[1]))
    ellipsoids = fit_evidence([evidence], options, device=device, camera=camera)
    meshes = {"mesh": options.mesh, "mesh, a mask counted as part labels": as_part_labels(options.mesh)}
    names = keypoints.format.landmarks
    found = {"ellipsoids": _compare(ellipsoids, ellipsoids.landmarks(names), keypoints)}
    for name, own in meshes.items():
        mesh = refine_mesh(ellipsoids, options=own)
        found[name] = _compare(mesh, mesh.landmarks(annotated(names, mesh.body.model.landmark_names)), keypoints)
    return found


def as_part_labels(options: MeshOptions) -> MeshOptions:
    """Options with which a mask counts as much as part labels."""
    return replace(options, proj=options.proj / ONE_MASK.proj, seg=options.seg / ONE_MASK.seg)


def _compare(fit: FitResult | MeshFit, landmarks: np.ndarray, keypoints: Keypoints2D) -> tuple[float, float]:
    camera = fit.camera
    points = camera.project(torch.from_numpy(landmarks).float()[None].to(camera.intrinsics))[0, :, :2].cpu().numpy()
    distances = np.linalg.norm(points - keypoints.points, axis=1) / person_height(keypoints)
    return _mean(distances, keypoints, _FACE), _mean(distances, keypoints, _ARMS)


def _mean(distances: np.ndarray, keypoints: Keypoints2D, names: Sequence[str]) -> float:
    """Mean of some keypoints' distances, weighted by their confidence."""
    rows = [keypoints.format.landmarks.index(name) for name in names]
    weights = keypoints.confidence[rows] + 1e-6
    return float((distances[rows] * weights).sum() / weights.sum())
