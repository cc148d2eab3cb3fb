"""Parts that are left out change nothing else, in either renderer."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scenes.bodies import TIPS, WITHOUT_TIPS, bent_bodies, drawn_labels
from scenes.pictures import GRADIENTS, Leaves, draw_on_screen, push_on_screen

from warp_partdr import label_set
from warp_partdr.body.template import PART_NAMES
from warp_partdr.render.ellipsoids import Ellipsoids
from warp_partdr.render.part_mesh import ellipbody_mesh

SIZE = 96


def others_labels(device, labels):
    """Target of each of the two bodies: the picture of the other one."""
    return drawn_labels(bent_bodies(device).select(torch.tensor([1, 0], device=device)), labels, SIZE)


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_an_ellipsoid_left_out_is_as_if_it_were_not_there(device, gradient):
    posed, camera = bent_bodies(device).posed(), bent_bodies(device).camera(SIZE)
    target = others_labels(device, label_set("ellipbody20"))
    kept = [part for part in range(20) if PART_NAMES[part] not in TIPS]
    found, grads = [], []
    for index, labels in (
        (list(range(20)), [part + 1 if part in kept else 0 for part in range(20)]),
        (kept, [part + 1 for part in kept]),
    ):
        parts = [tensor[:, index].detach().requires_grad_() for tensor in (posed.centres, posed.axes, posed.semi_axes)]
        leaves = Leaves(Ellipsoids(*parts), camera)
        loss, image = leaves.push_by_loss(target, part_labels=labels, gradient=gradient)
        found.append([loss, image.labels, image.depth])
        grads.append([tensor.grad for tensor in parts])
    assert all(torch.equal(have, want) for have, want in zip(*found, strict=True))
    for whole, few in zip(*grads, strict=True):
        torch.testing.assert_close(whole[:, kept], few, rtol=1e-5, atol=1e-3)
        assert (np.delete(whole.cpu().numpy(), kept, axis=1) == 0).all()


def test_faces_left_out_are_as_if_they_were_not_there(device):
    posed, camera = bent_bodies(device).posed(), bent_bodies(device).camera(SIZE)
    vertices = camera.project(posed.vertices(1)).detach()
    mesh = ellipbody_mesh(1, device=device)
    few = mesh.relabel(WITHOUT_TIPS.part_groups)
    assert len(few.faces) == len(mesh.faces) * 16 // 20
    assert len(few.edges) == len(mesh.edges) * 16 // 20
    away = posed.vertices(1).clone()
    away.view(2, 20, -1, 3)[:, [PART_NAMES.index(name) for name in TIPS]] += 50.0  # [m], out of the picture
    table = np.where(WITHOUT_TIPS.part_groups == 0, 255, WITHOUT_TIPS.part_groups)
    table[0] = 0
    target = others_labels(device, WITHOUT_TIPS)
    found = []
    for shape, points in ((few, vertices), (mesh.relabel(table), camera.project(away).detach())):
        points = points.clone().requires_grad_()
        loss, image = push_on_screen(points, shape, target)
        found.append((loss, image.labels, points.grad))
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])
    torch.testing.assert_close(found[0][2], found[1][2], rtol=1e-5, atol=1e-3)
    assert draw_on_screen(vertices, few, (SIZE, SIZE)).labels.max() <= 16
