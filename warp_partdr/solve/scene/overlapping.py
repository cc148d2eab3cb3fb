"""Mesh stages of a photo's people.

People who overlap are one scene, in which one person hides another and nobody is inside another person.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch

from ...body.lens import seen_at
from ...cameras import Perspective
from ...inputs.scene import Scene, View
from ...models.model import DetailedModel
from ..ellipsoids.result import FitResult
from ..ellipsoids.stages import Progress
from ..mesh.mesh_options import MeshOptions
from ..mesh.mesh_stage import CropPositions, MeshFit, mesh_fits, refine_meshes
from ..mesh.observed_body import ObservedBody
from .clusters import Clusters, find_clusters, fits_in_labels, of_several
from .fitting import fit_scene
from .options import SceneOptions


def refine_people(
    results: Sequence[FitResult],
    model: DetailedModel | None = None,
    *,
    options: MeshOptions | None = None,
    progress: Progress | None = None,
) -> list[MeshFit]:
    """Refines the detailed bodies of a photo's people, each from its fit of ellipsoids.

    If the camera is known or has the usual lens, each group of people who overlap is one scene (``fit_scene``). The
    other people are refined side by side (``refine_meshes``). Without a camera, distances are unknown, and all people
    are refined side by side.

    Args:
        results: Fits of ellipsoids for the people of one photo, with one camera.
        model: Detailed model, as in ``refine_meshes``.
        options: Options for all people.
        progress: Function that is called with (stage name, iterations done, all iterations).
    """
    options = options or MeshOptions()
    found: dict[int, MeshFit] = {}
    for members in overlapping(results):
        group = [results[index] for index in members]
        found |= zip(members, _fit_overlapping(group, model, options, progress), strict=True)
    others = [index for index in range(len(results)) if index not in found]
    alone = refine_meshes([results[index] for index in others], model, options=options, progress=progress)
    found |= zip(others, alone, strict=True)
    return [found[index] for index in range(len(results))]


def overlapping(results: Sequence[FitResult]) -> Clusters:
    """Clusters of people who may hide one another, as indices of ``results``.

    It is empty if there is no camera. A cluster needs labels from one label set, which tell who hides whom.
    """
    if len(results) < 2 or not isinstance(results[0].camera, Perspective):
        return ()
    observed_bodies = [ObservedBody.of_fit(result, person) for person, result in enumerate(results)]
    clusters = of_several(find_clusters(observed_bodies, len(results)))
    return tuple(members for members in clusters if _have_one_label_set([results[index] for index in members]))


def _have_one_label_set(results: Sequence[FitResult]) -> bool:
    """True if several of the people have labels, all from one label set that leaves room for everyone's ids."""
    sets = [each.observation.label_set for each in results if each.observation.label_set is not None]
    return len(sets) > 1 and all(each == sets[0] for each in sets) and fits_in_labels(len(results), sets[0].num_groups)


def _fit_overlapping(
    results: Sequence[FitResult], model: DetailedModel | None, options: MeshOptions, progress: Progress | None
) -> list[MeshFit]:
    camera = results[0].camera
    assert isinstance(camera, Perspective)
    observed_bodies = [ObservedBody.of_fit(each, person) for person, each in enumerate(results)]
    # The scene has no ground, because a photo's ground is found from all of its people (``results.placements``).
    scene_options = SceneOptions(mesh=options, ground=0.0)
    device = results[0].parameters.shift.device
    scene = Scene([View(camera)], [observed.source for observed in observed_bodies])
    fit = fit_scene(
        scene, options=scene_options, model=model, device=device, progress=progress, observed_bodies=observed_bodies
    )
    with torch.no_grad():
        lens = torch.stack([each.observation.lens for each in results if each.observation.lens is not None])
        pelvises = fit.landmarks(("pelvis",))[:, 0, 0]
        origins = CropPositions(*seen_at(pelvises, lens), lens)
        bodies = fit.bodies.moved(-pelvises)
        losses = {name: lens.new_tensor(len(lens) * [value]) for name, value in fit.energy.items()}
        fits = mesh_fits(replace(bodies, losses=losses), origins, fit.clothes, results)
    for each in fits:
        each.ellipbody.stage_seconds["mesh"] = fit.seconds["scene"] / len(fits)
    return fits
