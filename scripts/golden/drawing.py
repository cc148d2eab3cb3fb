"""Pictures, losses and gradients of bodies, by both renderers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import get_args

import torch
from differences import Found

from warp_partdr.body.labels import label_set
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import Posed
from warp_partdr.cameras import Camera, Perspective, ScreenCamera, WeakPerspective
from warp_partdr.render.ellipsoids import Ellipsoids, draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh, mesh_label_loss
from warp_partdr.render.options import Gradient
from warp_partdr.render.part_mesh import ellipbody_mesh

SCENES = 8
SIZE = (120, 150)
LABELS = label_set("cdcl14")


def drawing() -> Found:
    """Pictures, losses and gradients of bodies in random poses, two a scene, by both renderers."""
    found: Found = {}
    for index in range(SCENES):
        generator = torch.Generator().manual_seed(index)
        mean = BodyParameters.mean(2)
        parameters = replace(mean, rotations=0.3 * torch.randn(2, 20, 3, generator=generator))
        turned = mean.orientation + 0.3 * torch.randn(mean.orientation.shape, generator=generator)
        target, body = parameters.posed(), replace(parameters, orientation=turned).posed()
        camera = _camera(index)
        name = f"scene {index}"
        for gradient in get_args(Gradient):
            for reach in (math.inf, 3.0) if gradient == "partdr" else (math.inf,):
                drawn = _ellipsoids(body, target, camera, gradient, reach)
                found |= {f"{name}, ellipsoids, {gradient}, {reach}, {what}": array for what, array in drawn.items()}
        drawn = _mesh(body, target, camera, 1 + index % 3)
        found |= {f"{name}, mesh, {what}": array for what, array in drawn.items()}
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


def _ellipsoids(body: Posed, target: Posed, camera: Camera, gradient: Gradient, reach: float) -> Found:
    shown = _moved(body, camera)
    leaves = [tensor.requires_grad_() for tensor in (shown.centres, shown.axes, shown.semi_axes)]
    labels = [int(group) for group in LABELS.part_groups[1:]]
    labels_seen = draw_ellipsoids(_moved(target, camera), camera, SIZE, part_labels=labels).labels
    loss, picture = ellipsoid_label_loss(
        shown, camera, labels_seen, part_labels=labels, gradient=gradient, max_distance=reach
    )
    of_loss = torch.autograd.grad(loss.sum(), leaves)
    maps = draw_ellipsoids(
        shown,
        camera,
        SIZE,
        part_labels=labels,
        num_maps=LABELS.num_groups,
        gradient=gradient,
        max_distance=reach,
    ).maps
    assert maps is not None
    of_maps = torch.autograd.grad((maps * torch.linspace(-1, 1, SIZE[1])).sum(), leaves)
    drawn = {"labels seen": labels_seen, "labels": picture.labels, "depth": picture.depth, "parts": picture.parts}
    gradients = {
        f"gradient of {what}, {leaf}": gradient
        for what, found in (("loss", of_loss), ("maps", of_maps))
        for leaf, gradient in zip(("centres", "axes", "semi-axes"), found, strict=True)
    }
    return _as_arrays({**drawn, "loss": loss, "maps": maps, **gradients})


def _mesh(body: Posed, target: Posed, camera: Camera, level: int) -> Found:
    mesh = ellipbody_mesh(level).relabel(LABELS.part_groups)
    shift = torch.tensor([0.0, 0.0, 3.0 if camera.perspective else 0.0])
    labels_seen = draw_mesh(target.vertices(level) + shift, mesh, camera, SIZE).labels
    # By the gradient on the screen: those of the camera's own axes are torch's.
    screen = camera.project(body.vertices(level) + shift).detach().requires_grad_()
    shown = screen, mesh, ScreenCamera(camera.perspective)
    loss, picture = mesh_label_loss(*shown, labels_seen)
    (of_loss,) = torch.autograd.grad(loss.sum(), screen)
    maps = draw_mesh(*shown, SIZE, num_maps=mesh.num_labels).maps
    assert maps is not None
    (of_maps,) = torch.autograd.grad((maps * torch.linspace(-1, 1, SIZE[1])).sum(), screen)
    drawn = {"labels seen": labels_seen, "labels": picture.labels, "depth": picture.depth, "faces": picture.face_index}
    gradients = {"gradient of loss": of_loss, "gradient of maps": of_maps}
    return _as_arrays({**drawn, "loss": loss, "maps": maps, **gradients})


def _as_arrays(tensors: Mapping[str, torch.Tensor | None]) -> Found:
    return {name: tensor.detach().numpy() for name, tensor in tensors.items() if tensor is not None}
