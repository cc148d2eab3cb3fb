"""Borders of parts: neck, arms and legs begin at their joints, for labels that do."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from warp_partdr import FitOptions, fit_body
from warp_partdr.body.labels import label_set
from warp_partdr.body.template import PART_NAMES
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.lab.evaluation.partbench.samples import LABELS, make_sample
from warp_partdr.lab.synthetic.partbench_people import make_person
from warp_partdr.models.anny import anny
from warp_partdr.models.model import detailed_mesh, parts_at_joints
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.solve.mesh.mesh_options import MeshOptions
from warp_partdr.solve.mesh.mesh_stage import refine_mesh

AT_JOINTS = replace(LABELS, at_joints=True)


@pytest.mark.parametrize(
    ("part", "above", "end"),
    [
        ("neck", "chest", "head"),
        ("left_upper_arm", "left_shoulder", "left_forearm"),
        ("right_upper_leg", "right_hip", "right_lower_leg"),
    ],
)
def test_what_is_before_a_limb_s_joint_is_the_trunk_s(part: str, above: str, end: str, device: str) -> None:
    model = anny(torch.device(device))
    old, new = model.face_parts, parts_at_joints(model)
    label = PART_NAMES.index(part) + 1
    moved = (old == label) & (new != label)
    assert moved.any()
    assert (new[moved] == PART_NAMES.index(above) + 1).all()
    assert not ((new == label) & (old != label)).any()
    start, stop = (model.rest_joints[model.joint_names.index(model.bone_of_part[name])] for name in (part, end))
    along = (model.rest_vertices[model.faces.long()].mean(1) - start) @ (stop - start)
    assert (along[moved] < 0).all()
    assert (along[new == label] >= 0).all()


def test_other_parts_stay() -> None:
    model = anny()
    limbs = [PART_NAMES.index(name) + 1 for name in PART_NAMES if name == "neck" or "_upper_" in name]
    others = ~torch.isin(model.face_parts.long(), torch.tensor(limbs))
    assert torch.equal(model.face_parts[others], parts_at_joints(model)[others])


def test_the_mesh_stage_draws_labels_where_their_set_has_them() -> None:
    """Labels of a person whose limbs begin at their joints: they are met if it is said, and drawn so."""
    sample, person = make_sample(9, "clean"), make_person(9)
    seen = draw_mesh(
        torch.from_numpy(person.vertices)[None],
        detailed_mesh(anny(), at_joints=True),
        person.camera,
        person.parts.shape,
    )
    groups = LABELS.from_parts(seen.labels[0].numpy())
    assert 100 < (groups != LABELS.from_parts(person.parts)).sum() < 2000
    wrong = []
    for labels in (AT_JOINTS, LABELS):
        first = fit_body(sample.keypoints, PartLabels(labels, groups), options=FitOptions.at("fast"))
        mesh = refine_mesh(first, options=MeshOptions(iterations=30))
        drawn = labels.from_parts(mesh.draw(groups.shape).labels[0].numpy())
        wrong.append((int((drawn != groups).sum()), float(mesh.body.losses["seg"][0])))
    assert wrong[0][0] < 0.9 * wrong[1][0]
    assert wrong[0][1] < 0.95 * wrong[1][1]


def test_label_sets_of_photo_networks_have_borders_at_joints_and_annys_has_none() -> None:
    assert label_set("cdcl14").at_joints
    assert not LABELS.at_joints
    assert not label_set("ellipbody20").at_joints
