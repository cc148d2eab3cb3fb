"""Fits of a person, of people side by side, of people who overlap, and of a photo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import get_args

import numpy as np
from differences import Found
from inputs import EXAMPLE, make_crowd

from warp_partdr.body.labels import label_set
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import choose_person
from warp_partdr.inputs.observation import crop_evidence
from warp_partdr.inputs.part_labels import read_parts
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.evaluation.scoring import score_fit
from warp_partdr.lab.synthetic.scene_people import make_group, make_pair, make_views
from warp_partdr.models.anny import anny
from warp_partdr.models.registration import register
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.pipelines.photo import fit_photo
from warp_partdr.render.renderers import RendererMesh
from warp_partdr.solve.ellipsoids.fitting import fit_body, fit_evidence, fit_people
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.result import FitResult
from warp_partdr.solve.ellipsoids.stages import Quality, Start
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.mesh.mesh_stage import MeshFit, refine_meshes
from warp_partdr.solve.scene.fitting import SceneFit, fit_scene
from warp_partdr.solve.scene.options import SceneOptions
from warp_partdr.solve.scene.overlapping import refine_people

PEOPLE = (("clean", 0), ("clean", 1), ("realistic", 2), ("realistic", 3), *(("hard", i) for i in range(4, 8)))
PAIR = 103  # of PartBench's pairs
_ITERATIONS, _RATE = 5, 5e-4  # of a fit with few steps, so small that Adam does not magnify rounding


def _options(quality: Quality, few_steps: bool) -> FitOptions:
    options = replace(FitOptions.at(quality), search=())
    if not few_steps:
        return options
    stages = [replace(stage, iterations=_ITERATIONS, learning_rate=_RATE) for stage in options.stages]
    return replace(options, stages=tuple(stages), mesh=_mesh_options(few_steps))


def _mesh_options(few_steps: bool) -> MeshOptions:
    return MeshOptions(iterations=_ITERATIONS, learning_rate=_RATE) if few_steps else MeshOptions()


def example() -> Found:
    """The packaged example, fitted at all qualities from all starts, and with the mesh."""
    keypoints = choose_person(read_keypoints(EXAMPLE / "keypoints.json"))
    parts = read_parts(EXAMPLE / "parts.png", label_set("cdcl14"))
    found: Found = {}
    for start in get_args(Start):
        for quality in get_args(Quality):
            result = fit_body(keypoints, parts, options=FitOptions.at(quality, start).with_outline())
            found |= _of_fit(f"{quality} from {start}", result)
    options = FitOptions.at("fast", "search").drawn_by(lambda old: RendererMesh(1, max_distance=old.max_distance))
    result = fit_body(keypoints, parts, options=options)
    clothed = register(result.posed, anny())
    return {**found, **_of_fit("drawn as a mesh", result), "registered": clothed.detailed.vertices.numpy()}


def people(*, few_steps: bool) -> Found:
    """People of PartBench, each alone: the fits, and their scores against the truth."""
    found: Found = {}
    for level, index in PEOPLE:
        name, sample = f"{level} {index}", make_sample(index, level)
        result = fit_body(sample.keypoints, sample.parts, others=sample.others, options=_options("balanced", few_steps))
        score = score_fit(sample, "parts", result, 0.0)
        assert score.pixels is not None
        found |= _of_fit(name, result)
        found[f"{name}, errors"] = np.array([score.mpjpe, score.pa_mpjpe]) / 1000
        found[f"{name}, shares of pixels"] = score.pixels.parts / score.pixels.parts.sum()
    return found


def together(*, few_steps: bool) -> Found:
    """Fits of PartBench's people side by side, with labels and without, and their mesh stages."""
    people = []
    for level, index in PEOPLE:
        sample = make_sample(index, level)
        for parts in (sample.parts, None):
            evidence = weigh_evidence(sample.keypoints, parts, sample.others)[0]
            people.append(CutPerson(evidence, *crop_evidence(evidence)))
    found: Found = {}
    qualities: tuple[Quality, ...] = ("fast", "balanced")
    for quality in qualities:
        fits = fit_people(people, _options(quality, few_steps), packaged_network("cpu"))
        for (level, index), pair in zip(PEOPLE, zip(fits[::2], fits[1::2], strict=True), strict=True):
            for fit, labels in zip(pair, ("with labels", "without"), strict=True):
                found |= _of_fit(f"{quality}, {level} {index} {labels}", fit)
    labelled = [fit for fit in fits if fit.observation.label_set is not None]
    for (level, index), mesh in zip(PEOPLE, refine_meshes(labelled, options=_mesh_options(few_steps)), strict=True):
        found |= _of_mesh(f"meshes, {level} {index}", mesh)
    return found


def overlap(*, few_steps: bool) -> Found:
    """People of PartBench who overlap: a pair and a group as scenes, and the pair as people of a photo."""
    options = SceneOptions(mesh=_mesh_options(few_steps))
    found: Found = {}
    for name, sample in (("pair", make_pair(PAIR)), ("group", make_group(1))):
        found |= _of_scene(name, fit_scene(sample.scene, options=options))
    scene = make_pair(PAIR, "clean").scene
    readings = [weigh_evidence(observation.keypoints, observation.parts) for observation in scene.observations]
    given = replace(_options("fast", few_steps), guess_camera=False)
    results = [fit_evidence(each, given, camera=scene.views[0].camera) for each in readings]
    for place, mesh in enumerate(refine_people(results, options=given.mesh)):
        found |= _of_mesh(f"photo, person {place}", mesh)
    return found


def views(*, few_steps: bool) -> Found:
    """A person of PartBench before two calibrated cameras, and one before four."""
    found: Found = {}
    for count in (2, 4):
        options = SceneOptions(mesh=_mesh_options(few_steps))
        found |= _of_scene(f"{count} views", fit_scene(make_views(count, count).scene, options=options))
    return found


def photo(*, few_steps: bool) -> Found:
    """Everyone in a photo, of whom two overlap; these must be one scene, or the photo is no example of it any more."""
    stages: set[str] = set()

    def note(name: str, done: int, total: int) -> None:
        stages.add(name)

    found: Found = {}
    qualities: tuple[Quality, ...] = ("fast", "balanced")
    for quality in qualities:
        stages.clear()
        fit = fit_photo(make_crowd(), options=_options(quality, few_steps), progress=note)
        if len(fit.fits) != 3 or not {"scene", "mesh"} <= stages:
            raise RuntimeError(f"photo: {len(fit.fits)} people, stages {stages}; expected 3, two of them in a scene")
        found[f"{quality}, owners"] = fit.owners
        for place, mesh in fit.fits.items():
            name = f"{quality}, person {place}"
            found |= _of_mesh(name, mesh)
            found[f"{name}, keypoints"] = fit.people[place].keypoints.points
            found[f"{name}, hidden by"] = np.array(str(fit.hidden_by(place)))
    return found


def _of_fit(name: str, fit: FitResult) -> Found:
    arrays = {
        **{key: tensor.numpy() for key, tensor in fit.parameters.tensors().items()},
        **{f"history {stage}": rows for stage, rows in enumerate(fit.history)},
        "joints": fit.posed.joints.numpy(),
        "camera": fit.camera.intrinsics.numpy(),
        "depth order": np.array(str(fit.depth_order)),
        **_energy_arrays(fit.energy, fit.warnings),
    }
    return {f"{name}, {key}": array for key, array in arrays.items()}


def _of_mesh(name: str, mesh: MeshFit) -> Found:
    found = _of_fit(f"{name}, ellipsoids", mesh.ellipbody)
    found |= {f"{name}, vertices": mesh.vertices, f"{name}, clothes": mesh.clothes.numpy()}
    return found | {f"{name}, shape": mesh.body.shape.numpy(), f"{name}, rotations": mesh.body.rotations.numpy()}


def _of_scene(name: str, fit: SceneFit) -> Found:
    arrays = {
        "joints": fit.joints.numpy(),
        "vertices": fit.vertices.numpy(),
        "statures": fit.statures.numpy(),
        "clothes": fit.clothes.numpy(),
        **_energy_arrays(fit.energy, fit.warnings),
    }
    return {f"{name}, {key}": array for key, array in arrays.items()}


def _energy_arrays(energy: Mapping[str, float], warnings: tuple[str, ...]) -> Found:
    terms = {f"energy, {term}": np.array([value]) for term, value in energy.items()}
    return {**terms, "warnings": np.array("\n".join(warnings))}
