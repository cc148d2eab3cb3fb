"""Parts that are left out change nothing else, in either renderer."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scenes.bodies import TIPS, WITHOUT_TIPS, bent_bodies, drawn_labels
from scenes.pictures import GRADIENTS, draw_on_screen, loss_on_screen

from warp_partdr import label_set
from warp_partdr.body.template import PART_NAMES
from warp_partdr.render.ellipsoids import Ellipsoids, ellipsoid_label_loss
from warp_partdr.render.part_mesh import ellipbody_mesh

SIZE = 96


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_an_ellipsoid_left_out_is_as_if_it_were_not_there(device, gradient):
    posed, camera = bent_bodies(device).posed(), bent_bodies(device).camera(SIZE)
    target = drawn_labels(
        bent_bodies(device).select(torch.tensor([1, 0], device=device)), label_set("ellipbody20"), SIZE
    )
    kept = [part for part in range(20) if PART_NAMES[part] not in TIPS]
    names = ("centres", "axes", "semi_axes")
    losses, grads, images = [], [], []
    for index, labels in (
        (range(20), [part + 1 if part in kept else 0 for part in range(20)]),
        (kept, [part + 1 for part in kept]),
    ):
        index = list(index)
        leaves = Ellipsoids(*[getattr(posed, name)[:, index].detach().requires_grad_() for name in names])
        loss, image = ellipsoid_label_loss(leaves, camera, target, part_labels=labels, gradient=gradient)
        loss.sum().backward()
        losses.append(loss.detach())
        grads.append([getattr(leaves, name).grad for name in names])
        images.append(image)
    assert torch.equal(losses[0], losses[1])
    assert torch.equal(images[0].labels, images[1].labels)
    assert torch.equal(images[0].depth, images[1].depth)
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
    target = drawn_labels(bent_bodies(device).select(torch.tensor([1, 0], device=device)), WITHOUT_TIPS, SIZE)
    found = []
    for shape, points in ((few, vertices), (mesh.relabel(table), camera.project(away).detach())):
        points = points.clone().requires_grad_()
        loss, image = loss_on_screen(points, shape, target)
        loss.sum().backward()
        found.append((loss.detach(), image.labels, points.grad))
    assert torch.equal(found[0][0], found[1][0])
    assert torch.equal(found[0][1], found[1][1])
    torch.testing.assert_close(found[0][2], found[1][2], rtol=1e-5, atol=1e-3)
    assert draw_on_screen(vertices, few, (SIZE, SIZE)).labels.max() <= 16
