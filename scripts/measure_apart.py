"""Measure and print what keeping parts and people apart gives, on PartBench's people and pairs at realistic noise.

    python scripts/measure_apart.py people|pairs [FIRST LAST] [WEIGHT ...]

Volumes are of the skin's parts, closed where they are cut, on a grid of 1 cm; of one body those that lie in two parts
that are no neighbours, of a pair those that lie in both bodies. Intervals are of 95 %, over people.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from functools import cache

import numpy as np
import torch
import warp as wp
from measure_camera import interval
from measure_scenes import fit_from_wrong_order, score
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from warp_partdr import FitOptions, fit_body
from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.body.template import NUM_PARTS
from warp_partdr.clothing.anny import anny
from warp_partdr.clothing.capsules import measure_capsules
from warp_partdr.evaluation.partbench.samples import make_sample
from warp_partdr.evaluation.scoring import Score, score_fit, summarise
from warp_partdr.fit.mesh_options import MeshOptions
from warp_partdr.fit.mesh_stage import refine_mesh
from warp_partdr.scenes import fitting
from warp_partdr.scenes.options import SceneOptions
from warp_partdr.synthetic.scene_people import make_pair

_STEP = 0.01  # [m]
_OFFSET = np.array([0.00137, 0.00271, 0.00613])  # of the grid [m], so that nothing lies on its lines


def measure_people(first: int, last: int, weights: list[float]) -> None:
    """Joints, parts and volumes of single people, by weight."""
    scores: dict[float, list[Score]] = {weight: [] for weight in weights}
    volumes: dict[float, list[float]] = {weight: [] for weight in weights}
    true, seconds = [], dict.fromkeys(weights, 0.0)
    for index in range(first, last + 1):
        sample = make_sample(index, "realistic")
        start = fit_body(sample.keypoints, sample.parts, others=sample.others, options=FitOptions.at("fast"))
        assert sample.vertices is not None
        true.append(own_volume(sample.vertices))
        for weight in weights:
            began = time.perf_counter()
            mesh = refine_mesh(start, options=MeshOptions(apart=weight))
            seconds[weight] += time.perf_counter() - began
            scores[weight].append(score_fit(sample, str(weight), mesh, 0.0, mesh.vertices))
            volumes[weight].append(own_volume(mesh.vertices))
    print(f"volume of the true bodies: mean {np.mean(true):.0f} cm^3, {np.mean(np.array(true) > 5):.0%} above 5")
    plain = scores[weights[0]]
    for weight in weights:
        found, own = summarise(scores[weight]), np.array(volumes[weight])
        print(
            f"weight {weight:g}: volume mean {own.mean():.0f} cm^3, {np.mean(own > 5):.0%} above 5; "
            f"part F1 {found['part_f1']:.4f}, {1000 * seconds[weight] / len(own):.0f} ms"
        )
        for what in ("pa_mpjpe", "mpjpe"):
            values, before = (np.array([getattr(each, what) for each in those]) for those in (scores[weight], plain))
            print(f"  {what} {np.nanmean(values):.2f} mm, against the first {interval(values - before)}")


def measure_pairs(first: int, last: int, weights: list[float]) -> None:
    """The same of pairs that start in the wrong order, and world MPJPE."""
    rows: dict[str, list[tuple[object, ...]]] = {}
    for index in range(first, last + 1):
        sample = make_pair(index)
        sights = sorted(sample.scene.sights, key=lambda sight: sight.person)
        if {sight.person for sight in sights} != {0, 1}:
            continue
        truth = torch.from_numpy(sample.joints)
        bodies = {"true bodies": (torch.from_numpy(sample.vertices), truth, 0.0)}
        alone = [fitting.fit_scene(replace(sample.scene, sights=[replace(each, person=0)])) for each in sights]
        both = torch.cat([each.vertices for each in alone]), torch.cat([each.landmarks(MPJPE_JOINTS) for each in alone])
        bodies["each alone"] = *both, 0.0
        for weight in weights:
            options = SceneOptions(apart=weight)
            fit = fit_from_wrong_order(sample, options, exchanged=True)
            bodies[f"weight {weight:g}"] = fit.vertices, fit.landmarks(MPJPE_JOINTS), fit.seconds["scene"]
        for name, (vertices, joints, seconds) in bodies.items():
            world = 1000 * float((joints.float() - truth.float()).norm(dim=-1).mean())
            own = np.mean([own_volume(each[0].numpy()) for each in vertices])
            row = *score(sample, vertices.float(), joints.float()), world, shared_volume(vertices[:, 0].numpy()), own
            rows.setdefault(name, []).append((*row, seconds))
    for name, found in rows.items():
        counts, right, errors, worlds, shared, own, seconds = zip(*found, strict=True)
        hits, sizes = sum(counts)
        print(
            f"{name}: shared mean {np.mean(shared):.0f} cm^3, {np.mean(np.array(shared) > 5):.0%} above 5; own mean "
            f"{np.mean(own):.0f}; part F1 {np.mean(2 * hits / sizes):.4f}, order right {sum(right)} of {len(right)}, "
            f"PA {np.mean(errors):.1f}, world MPJPE {np.mean(worlds):.1f} mm, {np.mean(seconds):.2f} s"
        )


def own_volume(vertices: np.ndarray) -> float:
    """Volume of a body that lies in two parts that are no neighbours [cm^3]."""
    model = anny()
    low, count = _grid(vertices)
    inside = np.zeros((NUM_PARTS, *count), dtype=bool)
    for part in range(NUM_PARTS):
        faces, rims = _surface(part)
        middles = [vertices[rim].mean(0, keepdims=True) for rim in rims]
        inside[part] = _winding(np.concatenate([vertices, *middles]), faces, low, count) > 0
    capsules = measure_capsules(model)
    parts = np.array(capsules.parts)
    pairs = {tuple(sorted((parts[i], parts[j]))) for i, j in np.argwhere(np.isfinite(capsules.allowed.numpy()))}
    inside[0] |= inside[1]  # both hips are one
    shared = np.zeros(count, dtype=bool)
    for one, other in pairs:
        shared |= inside[one] & inside[other]
    return float(shared.sum()) * (100 * _STEP) ** 3


def shared_volume(vertices: np.ndarray) -> float:
    """Volume that lies in both of two bodies, (2, V, 3) [cm^3]."""
    low, count = _grid(vertices.reshape(-1, 3))
    faces = anny().faces.numpy().astype(np.int64)
    one, other = (_winding(each, faces, low, count) > 0 for each in vertices)
    return float((one & other).sum()) * (100 * _STEP) ** 3


def _grid(vertices: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]]:
    """Place of the first point, and how many there are each way."""
    low = np.floor(vertices.min(0) / _STEP) * _STEP - _STEP + _OFFSET
    return low, tuple(np.ceil((vertices.max(0) - low) / _STEP).astype(int) + 2)


@cache
def _surface(part: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Faces of a part whose holes are closed, each by a fan about the middle of its rim; and these rims' vertices."""
    model = anny()
    faces = model.faces.numpy().astype(np.int64)[model.face_parts.numpy() == part + 1]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = {tuple(edge) for edge in edges.tolist()}
    rim = np.array([edge for edge in edges.tolist() if (edge[1], edge[0]) not in there])
    graph = coo_array((np.ones(len(rim)), rim.T), shape=(model.num_vertices, model.num_vertices))
    loops = np.unique(connected_components(graph, directed=False)[1][rim[:, 0]], return_inverse=True)[1]
    fan = np.column_stack([rim[:, 1], rim[:, 0], model.num_vertices + loops])
    return np.concatenate([faces, fan]), [rim[loops == loop, 0] for loop in range(loops.max() + 1)]


def _winding(points: np.ndarray, faces: np.ndarray, low: np.ndarray, count: tuple[int, ...]) -> np.ndarray:
    """Number of times that the surface goes around each point of the grid."""
    corners = (points[faces].astype(np.float64) - low) / _STEP
    first = np.maximum(np.ceil(corners[..., :2].min(1)), 0).astype(int)
    sizes = np.maximum(np.floor(corners[..., :2].max(1)).astype(int) - first + 1, 0)
    repeats = sizes.prod(1)
    face = np.repeat(np.arange(len(faces)), repeats)
    within = np.arange(repeats.sum()) - np.repeat(np.cumsum(repeats) - repeats, repeats)
    column = first[face] + np.stack(
        [within // np.maximum(sizes[face, 1], 1), within % np.maximum(sizes[face, 1], 1)], 1
    )
    a, b, c = (corners[face, k] for k in range(3))
    areas = np.stack([_area(b, c, column), _area(c, a, column), _area(a, b, column)], axis=1)
    hit = (areas > 0).all(1) | (areas < 0).all(1)
    areas, column = areas[hit], column[hit]
    whole = areas.sum(1)
    height = (areas * corners[face[hit]][..., 2]).sum(1) / whole
    grid = np.zeros(count, dtype=np.int16)
    # Points below the surface, where it looks up, are inside.
    np.add.at(grid, (column[:, 0], column[:, 1], np.floor(height).astype(int)), np.sign(whole).astype(np.int16))
    return grid[..., ::-1].cumsum(-1)[..., ::-1]


def _area(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    return (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_WARNING
    what, *rest = sys.argv[1:]
    people = what == "people"
    first, last = map(int, rest[:2] or ((200, 249) if people else (100, 129)))
    (measure_people if people else measure_pairs)(first, last, [float(each) for each in rest[2:]] or [0.0, 0.1])
