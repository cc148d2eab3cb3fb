"""Mesh stages of a photo's people: those who overlap are a scene, where one hides the other and none is in another."""

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
    """Refine the detailed bodies of a photo's people, each on from its fit.

    Before a known camera or a usual lens, those who overlap are one scene each (``fit_scene``); all others, and
    everybody where distances are not known, are refined side by side (``refine_meshes``).

    Args:
        results: Of one photo, before one camera.
        model: As of ``refine_meshes``, like the others.
        options: Of all.
        progress: Told of all iterations, by name.
    """
    options = options or MeshOptions()
    found: dict[int, MeshFit] = {}
    for members in overlapping(results):
        some = [results[place] for place in members]
        found |= zip(members, _fit_together(some, model, options, progress), strict=True)
    others = [place for place in range(len(results)) if place not in found]
    alone = refine_meshes([results[place] for place in others], model, options=options, progress=progress)
    found |= zip(others, alone, strict=True)
    return [found[place] for place in range(len(results))]


def overlapping(results: Sequence[FitResult]) -> Clusters:
    """Places of people who may hide one another, where labels of one set can tell: all of them before a camera."""
    if len(results) < 2 or not isinstance(results[0].camera, Perspective):
        return ()
    found = of_several(
        find_clusters([ObservedBody.of_fit(each, place) for place, each in enumerate(results)], len(results))
    )
    return tuple(members for members in found if _alike([results[place] for place in members]))


def _alike(results: Sequence[FitResult]) -> bool:
    sets = [each.observation.label_set for each in results if each.observation.label_set is not None]
    return len(sets) > 1 and all(each == sets[0] for each in sets) and fits_in_labels(len(results), sets[0].num_groups)


def _fit_together(
    results: Sequence[FitResult], model: DetailedModel | None, options: MeshOptions, progress: Progress | None
) -> list[MeshFit]:
    camera = results[0].camera
    assert isinstance(camera, Perspective)
    looks = [ObservedBody.of_fit(each, person) for person, each in enumerate(results)]
    # No ground: of a photo, it is found of everybody (``results.placements``).
    together, device = SceneOptions(mesh=options, ground=0.0), results[0].parameters.shift.device
    scene = Scene([View(camera)], [look.sight for look in looks])
    fit = fit_scene(scene, options=together, model=model, device=device, progress=progress, looks=looks)
    with torch.no_grad():
        lens = torch.stack([each.observation.lens for each in results if each.observation.lens is not None])
        pelvises = fit.landmarks(("pelvis",))[:, 0, 0]
        origins = CropPositions(*seen_at(pelvises, lens), lens)
        bodies = fit.bodies.moved(-pelvises)
        losses = {name: lens.new_tensor(len(lens) * [value]) for name, value in fit.energy.items()}
        fits = mesh_fits(replace(bodies, losses=losses), origins, fit.clothes, results, len(lens) * [fit.energy])
    for each in fits:
        each.ellipbody.stage_seconds["mesh"] = fit.seconds["scene"] / len(fits)
    return fits
