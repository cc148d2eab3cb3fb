"""Clothes of many people at once look as those of one, and training's labels show them."""

from __future__ import annotations

import numpy as np
import torch
from helpers.bodies import bank

from warp_partdr.body.labels import label_set
from warp_partdr.cameras import WeakPerspective
from warp_partdr.lab.synthetic import wardrobe as module
from warp_partdr.lab.synthetic.garments import GARMENTS, draw_outfit, dress
from warp_partdr.lab.synthetic.people import anny_mesh
from warp_partdr.lab.synthetic.training_people import PeopleMaker
from warp_partdr.lab.synthetic.wardrobe import wardrobe
from warp_partdr.models.anny import anny
from warp_partdr.render.mesh import draw_mesh

OUTFITS = 12
SIZE = (300, 200)


def strides(device: str) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Shape, rotations and translation of mean Annys, one for each outfit, who stride with both thighs turned."""
    model = anny(device)
    turns = torch.eye(3, device=device).repeat(OUTFITS, len(model.joint_names), 1, 1)
    for side, angle in (("L", 0.5), ("R", -0.4)):
        cos, sin = np.cos(angle), np.sin(angle)
        turn = torch.tensor([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]], device=device)
        turns[:, model.joint_names.index(f"upperleg01.{side}")] = turn
    zeros = torch.zeros(OUTFITS, model.num_shapes, device=device)
    return zeros, turns, zeros[:, :3]


def test_many_look_as_one_does(device: str) -> None:
    clothes, model = wardrobe(torch.device(device)), anny(device)
    shape, turns, place = strides(device)
    worn = torch.arange(OUTFITS, device=device)
    bodies = model.pose(shape, turns, place, offsets=clothes.offsets(worn))
    camera = WeakPerspective(torch.tensor([150.0]), torch.tensor([[100.0, 150.0]]))
    front = torch.tensor([1.0, -1.0, -1.0])
    found = draw_mesh(clothes.vertices(bodies, worn).cpu() * front, clothes.mesh.to("cpu"), camera, SIZE).labels
    bare = anny().pose(shape[:1].cpu(), turns[:1].cpu(), place[:1].cpu())
    plain = draw_mesh(bare.vertices * front, anny_mesh(), camera, SIZE).labels[0]
    worn_tubes = 0
    for index in range(OUTFITS):
        outfit = draw_outfit(np.random.default_rng([module._SEED, index]))
        vertices, mesh = dress(bare, shape[:1].cpu(), outfit)
        expected = draw_mesh(torch.from_numpy(vertices)[None] * front, mesh, camera, SIZE).labels[0]
        cloth = int(((expected > 0) & (plain == 0)).sum())
        differ = int(((expected > 0) != (found[index] > 0)).sum())
        assert differ < 0.15 * cloth + 100, index
        assert (expected != found[index]).float().mean() < 0.02, index
        worn_tubes += any(GARMENTS[each.name].flare is not None for each in outfit)
    assert worn_tubes >= 3


def test_labels_of_half_of_the_people_show_clothes_which_the_truth_does_not(device: str) -> None:
    count = 256
    people = PeopleMaker(bank(), size=96, device=device, seed=3, pool=256, held_out=False)(count)
    groups = label_set("ellipbody20").num_groups
    seen, true = (((ids > 0) & (ids <= groups)).float().mean((1, 2)) for ids in (people.groups, people.parts))
    ratio = seen / true
    # Clothes add less to the bodies of a population, a quarter of whom are overweight, than to slim ones.
    assert ratio[: count // 2].median() > 1.06 * ratio[count // 2 :].median()
