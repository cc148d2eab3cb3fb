"""Bit-exact fingerprints of the package's results, to check that a change of the layout leaves them as they are.

    python scripts/golden.py save before.json     # with the code before
    python scripts/golden.py check before.json    # after; exit code 1 where a bit differs

Fingerprints belong to a machine, its library versions and its number of CPU threads.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import get_args

import numpy as np
import torch

from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import Posed
from warp_partdr.cameras import Camera, Perspective, ScreenCamera, WeakPerspective
from warp_partdr.inputs.keypoint_files import read_keypoints
from warp_partdr.inputs.keypoints import choose_person
from warp_partdr.inputs.part_labels import read_parts
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.lab.evaluation.scoring import score_fit
from warp_partdr.models.anny import anny
from warp_partdr.models.registration import register
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh, mesh_label_loss
from warp_partdr.render.options import Gradient
from warp_partdr.render.part_mesh import ellipbody_mesh
from warp_partdr.render.renderers import RendererMesh
from warp_partdr.solve.ellipsoids.fitting import fit_body
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.stages import Quality, Start

SCENES = 8
SIZE = (120, 150)
PEOPLE = (("clean", 0), ("clean", 1), ("realistic", 2), ("realistic", 3), *(("hard", i) for i in range(4, 8)))
LABELS = label_set("cdcl14")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=["save", "check"])
    parser.add_argument("file", type=Path)
    arguments = parser.parse_args()
    found = {**scenes(), **example(), **people()}
    if arguments.action == "save":
        arguments.file.write_text(json.dumps(found, indent=1))
        return
    expected = json.loads(arguments.file.read_text())
    differing = [name for name in sorted({*expected, *found}) if expected.get(name) != found.get(name)]
    for name in differing:
        print(f"{name}: {found.get(name)}; expected {expected.get(name)}")
    print(f"{len(expected) - len(differing)} of {len(expected)} are the same to the bit")
    sys.exit(bool(differing))


def scenes() -> dict[str, str]:
    """Pictures, losses and gradients of bodies in random poses, two a scene, by both renderers."""
    found: dict[str, str] = {}
    for index in range(SCENES):
        generator = torch.Generator().manual_seed(index)
        mean = BodyParameters.mean(2)
        target = replace(mean, rotations=0.3 * torch.randn(2, 20, 3, generator=generator))
        turned = mean.orientation + 0.3 * torch.randn(mean.orientation.shape, generator=generator)
        target, body = target.posed(), replace(target, orientation=turned).posed()
        camera = _camera(index)
        name = f"scene {index}"
        for gradient in get_args(Gradient):
            for reach in (math.inf, 3.0) if gradient == "partdr" else (math.inf,):
                found[f"{name}, ellipsoids, {gradient}, {reach}"] = _ellipsoids(body, target, camera, gradient, reach)
        found[f"{name}, mesh"] = _mesh(body, target, camera, 1 + index % 3)
    return found


def _camera(index: int) -> Camera:
    middle = torch.tensor([[SIZE[1] / 2, SIZE[0] / 2]]).repeat(2, 1)
    if index % 2:
        return WeakPerspective(torch.tensor([60.0, 50.0]), middle)
    return Perspective(torch.full((2, 2), 160.0), middle)


def _moved(body: Posed, camera: Camera) -> Ellipsoids:
    """Ellipsoids moved before a perspective camera."""
    centres = body.centres + torch.tensor([0.0, 0.0, 3.0 if camera.perspective else 0.0])
    return Ellipsoids(centres.detach(), body.axes.detach(), body.semi_axes.detach())


def _ellipsoids(body: Posed, target: Posed, camera: Camera, gradient: Gradient, reach: float) -> str:
    shown = _moved(body, camera)
    leaves = [tensor.requires_grad_() for tensor in (shown.centres, shown.axes, shown.semi_axes)]
    labels = [int(group) for group in LABELS.part_groups[1:]]
    labels_seen = draw_ellipsoids(_moved(target, camera), camera, SIZE, part_labels=labels).labels
    options = {"part_labels": labels, "gradient": gradient, "max_distance": reach}
    loss, picture = ellipsoid_label_loss(shown, camera, labels_seen, **options)
    of_loss = torch.autograd.grad(loss.sum(), leaves)
    maps = draw_ellipsoids(shown, camera, SIZE, num_maps=LABELS.num_groups, **options).maps
    of_maps = torch.autograd.grad((maps * torch.linspace(-1, 1, SIZE[1])).sum(), leaves)
    return fingerprint(labels_seen, loss, picture.labels, picture.depth, picture.parts, maps, *of_loss, *of_maps)


def _mesh(body: Posed, target: Posed, camera: Camera, level: int) -> str:
    mesh = ellipbody_mesh(level).relabel(LABELS.part_groups)
    shift = torch.tensor([0.0, 0.0, 3.0 if camera.perspective else 0.0])
    labels_seen = draw_mesh(target.vertices(level) + shift, mesh, camera, SIZE).labels
    # By the gradient on the screen: those of the camera's own axes are torch's.
    screen = camera.project(body.vertices(level) + shift).detach().requires_grad_()
    shown = screen, mesh, ScreenCamera(camera.perspective)
    loss, picture = mesh_label_loss(*shown, labels_seen)
    (of_loss,) = torch.autograd.grad(loss.sum(), screen)
    maps = draw_mesh(*shown, SIZE, num_maps=mesh.num_labels).maps
    (of_maps,) = torch.autograd.grad((maps * torch.linspace(-1, 1, SIZE[1])).sum(), screen)
    return fingerprint(labels_seen, loss, picture.labels, picture.depth, picture.face_index, maps, of_loss, of_maps)


def example() -> dict[str, str]:
    """The packaged example, fitted at all qualities from all starts, and with the mesh."""
    folder = resources.files("warp_partdr").joinpath("assets", "example")
    keypoints = choose_person(read_keypoints(str(folder.joinpath("keypoints.json"))))
    parts = read_parts(str(folder.joinpath("parts.png")), LABELS)
    found = {}
    for start in get_args(Start):
        for quality in get_args(Quality):
            result = fit_body(keypoints, parts, options=FitOptions.at(quality, start))
            found[f"example, {quality} from {start}"] = fingerprint(*result.parameters.tensors().values())
    options = FitOptions.at("fast", "search").drawn_by(lambda old: RendererMesh(1, max_distance=old.max_distance))
    result = fit_body(keypoints, parts, options=options)
    found["example, drawn as a mesh"] = fingerprint(*result.parameters.tensors().values())
    clothed = register(result.posed, anny())
    found["example, registered"] = fingerprint(clothed.detailed.vertices)
    return found


def people() -> dict[str, str]:
    """People of PartBench: where joints and pixels are after a fit."""
    found = {}
    for level, index in PEOPLE:
        sample = make_sample(index, level)
        result = fit_body(sample.keypoints, sample.parts, others=sample.others)
        figures = score_fit(sample, "parts", result, 0.0)
        counts = torch.from_numpy(np.ascontiguousarray(figures.pixels.parts))
        found[f"{level} {index}"] = f"{fingerprint(counts)}, {figures.mpjpe:.6f} mm, {figures.pa_mpjpe:.6f} mm"
    return found


def fingerprint(*arrays: torch.Tensor) -> str:
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array.detach().cpu().numpy()).tobytes())
    return digest.hexdigest()[:16]


if __name__ == "__main__":
    main()
