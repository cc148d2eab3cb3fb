"""Measure and print what keeping parts and people apart gives, on PartBench's people and pairs at realistic noise.

    python scripts/measure_apart.py people|pairs [FIRST LAST] [WEIGHT ...]

Volumes are of the skin's parts, closed where they are cut, on a grid of 1 cm; of one body those that lie in two parts
that are no neighbours, of a pair those that lie in both bodies. Intervals are of 95 %, over people.
"""

from __future__ import annotations

import sys
import time
from functools import cache, partial

import numpy as np
import warp as wp
from measure_camera import interval
from rich.console import Console
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from warp_partdr import FitOptions, fit_body
from warp_partdr.body.template import NUM_PARTS
from warp_partdr.lab.evaluation.evaluate import Fitting, evaluate, tables
from warp_partdr.lab.evaluation.partbench.samples import PAIRS, make_sample
from warp_partdr.lab.evaluation.partbench.scenes import SCENE_METHODS, SceneMethod, fit_all_together, partbench_scenes
from warp_partdr.lab.evaluation.scoring import Score, score_fit, summarise
from warp_partdr.lab.evaluation.volumes import STEP, point_grid, shared_volume, windings
from warp_partdr.models.anny import anny
from warp_partdr.models.capsules import measure_capsules
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.mesh.mesh_stage import refine_mesh
from warp_partdr.solve.scene.options import SceneOptions


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
    """The same of pairs, half of which start in the wrong order, and world MPJPE."""
    samples = partbench_scenes(range(first, last + 1), [PAIRS])
    methods: dict[str, Fitting] = {"each alone": SCENE_METHODS["each alone"]}
    for weight in weights:
        methods[f"weight {weight:g}"] = SceneMethod(partial(fit_all_together, options=SceneOptions(apart=weight)))
    report = evaluate(samples, methods)
    faces = anny().faces.numpy()
    true = [shared_volume(sample.vertices[:, 0], faces) for sample in samples]
    print(f"the true bodies share {np.mean(true):.0f} cm^3")
    for table in tables(report):
        Console(width=170).print(table)


def own_volume(vertices: np.ndarray) -> float:
    """Volume of a body that lies in two parts that are no neighbours [cm^3]."""
    model = anny()
    low, count = point_grid(vertices)
    inside = np.zeros((NUM_PARTS, *count), dtype=bool)
    for part in range(NUM_PARTS):
        faces, rims = _surface(part)
        middles = [vertices[rim].mean(0, keepdims=True) for rim in rims]
        inside[part] = windings(np.concatenate([vertices, *middles]), faces, low, count) > 0
    capsules = measure_capsules(model)
    parts = np.array(capsules.parts)
    pairs = {tuple(sorted((parts[i], parts[j]))) for i, j in np.argwhere(np.isfinite(capsules.allowed.numpy()))}
    inside[0] |= inside[1]  # both hips are one
    shared = np.zeros(count, dtype=bool)
    for one, other in pairs:
        shared |= inside[one] & inside[other]
    return float(shared.sum()) * (100 * STEP) ** 3


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


if __name__ == "__main__":
    wp.config.log_level = wp.LOG_WARNING
    what, *rest = sys.argv[1:]
    people = what == "people"
    first, last = map(int, rest[:2] or ((200, 249) if people else (100, 129)))
    (measure_people if people else measure_pairs)(first, last, [float(each) for each in rest[2:]] or [0.0, 0.1])
