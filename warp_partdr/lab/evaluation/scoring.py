"""Scores of single fits, and summaries of many.

Part labels are compared after grouping into LSP's six parts where their set allows it, else in its own groups.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ... import metrics
from ...body.labels import BACKGROUND, LabelSet, label_set, regroup
from ...body.stature import bone_statures
from ...body.template import JOINT_NAMES
from ...inputs.keypoints import person_height
from ...inputs.own_pixels import ignore_missing_limbs
from ...inputs.sample import Sample
from ...solve.ellipsoids.result import FitResult
from ...solve.mesh.mesh_stage import MeshFit
from .sizes import trunk_and_legs

_GROUPS = "lsp6"
_HIPS = ("left_hip", "right_hip")
_MEANS = (  # figure, field of ``Score``, and digits
    ("mpjpe_mm", "mpjpe", 1),
    ("pa_mpjpe_mm", "pa_mpjpe", 1),
    ("pve_mm", "pve", 1),
    ("size_share", "size_share", 4),
    ("stature_share", "stature_share", 4),
    ("world_mpjpe_mm", "world_mpjpe", 1),
    ("depth_between_mm", "depth_between", 1),
    ("stature_off_mm", "stature", 1),
    ("acceleration_mm", "acceleration", 2),
    ("sliding_mm_s", "sliding", 1),
    ("order_right", "order", 3),
    ("depth_within_spread", "depth_within", 3),
    ("depth_within_two_spreads", "depth_within_two", 3),
    ("shared_volume_cm3", "shared_volume", 1),
    ("seconds", "seconds", 2),
)


@dataclass(frozen=True)
class Pixels:
    """Pixels of one picture, by (target, rendered) class."""

    classes: tuple[str, ...]  # their names, background first
    parts: np.ndarray  # without ignored pixels, shape (C, C)
    undisputed: np.ndarray  # nor background that keypoints contradict (``ignore_missing_limbs``), shape (C, C)
    filled: np.ndarray  # with ignored pixels as background, shape (C, C)
    foreground: np.ndarray  # background and person, shape (2, 2)


@dataclass(frozen=True)
class Score:
    """Errors of one fit."""

    source: str  # of the sample
    sample: str  # its name
    method: str  # how it was fitted
    keypoints: np.ndarray  # distance of each confident keypoint, as a share of the person's height, shape (K,)
    seconds: float  # wall time
    pixels: Pixels | None = None  # None if the sample has no labels to be scored against
    mpjpe: float = math.nan  # [mm], pelvis-centred; NaN if the true joints are not known
    pa_mpjpe: float = math.nan  # [mm], the same
    pve: float = math.nan  # [mm], the same for vertices, and NaN if the method has none
    world_mpjpe: float = math.nan  # [mm], as joints stand in the world; NaN but for scenes
    depth_between: float = math.nan  # [mm], error of how far two people are from each other in depth; NaN with one
    stature: float = math.nan  # [mm], error of a person's; NaN but for scenes
    acceleration: float = math.nan  # [mm/frame²], how far joints' are from the true ones; NaN but for motion
    sliding: float = math.nan  # [mm/s], speed of ankles while the true ones stand; NaN but for motion where some do
    order: float = math.nan  # share of pairs of people, or of a limb (``Sample.mirrored``), in the right order in depth
    depth_within: float = math.nan  # share of joints whose depth lies in the interval of 68 % that the network stated
    depth_within_two: float = math.nan  # the same of twice that interval
    shared_volume: float = math.nan  # [cm³], of people who stand in one another, a frame; NaN but for several people
    size_share: float = math.nan  # length of legs and trunk (``trunk_and_legs``) over the true one
    stature_share: float = math.nan  # height standing over the true one
    cluster: str | None = None  # scores of one, such as of a person's views, are not independent; None: alone


def score_fit(
    sample: Sample, method: str, result: FitResult | MeshFit, seconds: float, vertices: np.ndarray | None = None
) -> Score:
    """Compare a result with what is known of the sample.

    Args:
        sample: The person.
        method: Name of the method.
        result: Result of ``Method.fit``.
        seconds: Duration of the fit.
        vertices: Vertices of the result's mesh in its camera frame, if it and the sample have one, shape (V, 3) [m].
    """
    confident = sample.keypoints.confident
    form = sample.keypoints.format
    landmarks = torch.from_numpy(_marked(result, form.marks, form.landmarks))[None]
    projected = result.camera.project(landmarks.to(result.camera.intrinsics))[0, :, :2].cpu().numpy()
    distances = np.linalg.norm(projected - sample.keypoints.points, axis=1)[confident]
    return Score(
        source=sample.source,
        sample=sample.name,
        method=method,
        keypoints=distances / max(person_height(sample.keypoints), 1.0),
        seconds=seconds,
        pixels=_pixels(sample, result),
        cluster=sample.cluster,
        **_joint_errors(sample, result, vertices),
        **_sizes(sample, result),
        **_depth_figures(sample, result),
    )


def _marked(result: FitResult | MeshFit, marks: Sequence[str], names: Sequence[str]) -> np.ndarray:
    """Points of a body that joints mark, shape (L, 3) [m]; a detailed model without one gives that of the name."""
    if isinstance(result, MeshFit):
        known = result.body.model.landmark_names
        marks = [mark if mark in known else name for mark, name in zip(marks, names, strict=True)]
    return result.landmarks(marks)


def _joint_errors(sample: Sample, result: FitResult | MeshFit, vertices: np.ndarray | None) -> dict[str, float]:
    """Errors by their names in ``Score``, as far as the truth is known [mm]."""
    if sample.joints is None:
        return {}
    names = sample.joint_names
    hips = [names.index(name) for name in _HIPS]
    joints, known = _marked(result, sample.body_points, names), np.isfinite(sample.joints).all(axis=1)
    errors = {"pa_mpjpe": metrics.pa_mpjpe(joints, sample.joints, valid=known)}
    if known[hips].all():
        errors["mpjpe"] = metrics.mpjpe(joints, sample.joints, centre_on=hips, valid=known)
        if vertices is not None and sample.vertices is not None:
            pelvis, true_pelvis = joints[hips].mean(0), sample.joints[hips].mean(0)
            errors["pve"] = metrics.pve(vertices, sample.vertices, pelvis=pelvis, target_pelvis=true_pelvis)
    return {name: 1000 * float(error) for name, error in errors.items()}


def _sizes(sample: Sample, result: FitResult | MeshFit) -> dict[str, float]:
    """Sizes over the true ones, as far as these are known, by their names in ``Score``."""
    figures = {}
    if sample.joints is not None:
        found = trunk_and_legs(_marked(result, sample.body_points, sample.joint_names), sample.joint_names)
        figures["size_share"] = float(found / trunk_and_legs(sample.joints, sample.joint_names))
    if sample.stature is not None:
        body = result.ellipbody if isinstance(result, MeshFit) else result
        figures["stature_share"] = float(bone_statures(body.parameters.lengths)[0]) / sample.stature
    return figures


def _depth_figures(sample: Sample, result: FitResult | MeshFit) -> dict[str, float]:
    """Depths, from the hips' middle, as far as something is to be told of them: shares by their names in ``Score``."""
    if sample.joints is None:
        return {}
    names, figures = sample.joint_names, {}
    hips = [names.index(name) for name in _HIPS]
    found, true = (
        each[:, 2] - each[hips, 2].mean() for each in (_marked(result, sample.body_points, names), sample.joints)
    )
    if sample.mirrored is not None:
        wrong = sample.mirrored[:, 2] - sample.mirrored[hips, 2].mean()
        most = int(np.abs(wrong - true).argmax())
        figures["order"] = float(abs(found[most] - true[most]) < abs(found[most] - wrong[most]))
    if isinstance(result, FitResult) and result.uncertainty is not None:
        scored = [name for name in names if name in JOINT_NAMES and name not in _HIPS]  # which lie by the pelvis
        rows, columns = [names.index(name) for name in scored], [JOINT_NAMES.index(name) - 1 for name in scored]
        off = np.abs(found - true)[rows]
        known = np.isfinite(off)
        if known.any():
            spreads = result.uncertainty.depths[0, columns].cpu().numpy()
            figures["depth_within"] = float((off < spreads)[known].mean())
            figures["depth_within_two"] = float((off < 2 * spreads)[known].mean())
    return figures


def scoring_classes(labels: LabelSet) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """The classes that labels of a set are compared in.

    Returns:
        Names of the classes, background first, the class of each group id, shape (256,), and that of each rendered part
        label, through the same groups, shape (21,).
    """
    coarse = label_set(_GROUPS)
    try:
        table = regroup(labels, coarse)
    except ValueError:  # not finer than LSP's six parts
        coarse, table = labels, np.arange(256, dtype=np.uint8)
    return ("background", *coarse.group_names), table, table[labels.part_groups]


def _pixels(sample: Sample, result: FitResult | MeshFit) -> Pixels | None:
    if sample.target_set is None or sample.target is None:
        return None
    classes, from_groups, from_parts = scoring_classes(sample.target_set)
    drawn = result.draw(sample.target.shape).labels[0].cpu().numpy()
    shown, count = from_parts[drawn], len(classes)
    target = from_groups[sample.target]
    undisputed = from_groups[ignore_missing_limbs(sample.target, sample.keypoints)]
    parts = metrics.confusion(shown, target, count)
    foreground = metrics.foreground_counts(parts)
    if sample.mask is not None:
        foreground = metrics.confusion(drawn != BACKGROUND, sample.mask, 2)
    return Pixels(
        classes=classes,
        parts=parts,
        undisputed=metrics.confusion(shown, undisputed, count),
        filled=metrics.confusion(shown, target, count, ignored_is_background=True),
        foreground=foreground,
    )


def sum_clusters(values: np.ndarray, clusters: Sequence[str]) -> np.ndarray:
    """Sums of values (N, ...) over each cluster, in the order of their first: shape (C, ...)."""
    names = list(dict.fromkeys(clusters))
    sums = np.zeros((len(names), *values.shape[1:]), dtype=values.dtype)
    np.add.at(sums, [names.index(cluster) for cluster in clusters], values)
    return sums


def summarise(scores: Sequence[Score]) -> dict[str, Any]:
    """Figures of one or more fits by one method: pixels and keypoints pooled, the rest averaged over people.

    Returns:
        Figures by name, those that are known of somebody, and ``interval_95`` of most of them if there are several
        people: bootstrapped over people, which takes them for independent. Scores with a ``cluster`` are bootstrapped
        over clusters, such as people of whom there are several views.

    Raises:
        ValueError: If pixels were counted in different classes.
    """
    clusters = [str(row) if score.cluster is None else score.cluster for row, score in enumerate(scores)]
    figures: dict[str, Any] = {"people": len(set(clusters)), "views": len(scores)}
    intervals: dict[str, list[float]] = {}

    def put(
        name: str, values: np.ndarray, of_sum: Callable[[np.ndarray], Any], digits: int, rows: Sequence[int]
    ) -> None:
        """Put down the figure that ``of_sum`` makes of values, one a score of these ``rows``, and its interval."""
        figures[name] = round(float(of_sum(values.sum(0)[None])[0]), digits)
        sums = sum_clusters(values, [clusters[row] for row in rows])
        if len(sums) > 1:
            intervals[name] = [round(limit, digits) for limit in metrics.bootstrap_sum(sums, of_sum)]

    def ratio(sums: np.ndarray) -> np.ndarray:
        return sums[..., 0] / sums[..., 1]

    everyone = range(len(scores))
    if pixels := [score.pixels for score in scores if score.pixels is not None]:
        labelled = [row for row in everyone if scores[row].pixels is not None]
        if len(classes := {picture.classes for picture in pixels}) > 1:
            found = " and ".join(map(", ".join, sorted(classes)))
            raise ValueError(f"scores: parts of {found}; expected one label set")
        foreground, parts, filled, undisputed = (
            np.stack([getattr(picture, name) for picture in pixels])
            for name in ("foreground", "parts", "filled", "undisputed")
        )
        put("foreground_accuracy", foreground, metrics.accuracy, 4, labelled)
        put("foreground_f1", foreground, metrics.part_f1, 4, labelled)
        put("part_accuracy", filled, metrics.accuracy, 4, labelled)
        put("part_f1", parts, metrics.part_f1, 4, labelled)
        put("undisputed_foreground_f1", metrics.foreground_counts(undisputed), metrics.part_f1, 4, labelled)
        put("undisputed_part_f1", undisputed, metrics.part_f1, 4, labelled)
        figures["f1"] = {
            name: None if np.isnan(value) else round(float(value), 4)
            for name, value in zip(pixels[0].classes, metrics.f1_scores(parts.sum(0)), strict=True)
        }
    keypoints = np.array([[score.keypoints.sum(), len(score.keypoints)] for score in scores])
    put("keypoint_distance", keypoints, ratio, 5, everyone)
    for name, column, digits in _MEANS:
        values = np.array([getattr(score, column) for score in scores], dtype=np.float64)
        known = np.flatnonzero(np.isfinite(values))
        if len(known):
            put(name, np.stack([values[known], np.ones(len(known))], axis=1), ratio, digits, known.tolist())
    if intervals:
        figures["interval_95"] = intervals
    return figures
