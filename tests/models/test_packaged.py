"""Packaged findings about Anny are what the code finds, and are taken for no other model; rules of surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from warp_partdr.models import packaged
from warp_partdr.models.anny import anny
from warp_partdr.models.model import DetailedModel, unique_pairs
from warp_partdr.models.packaged import packaged_findings
from warp_partdr.models.reduction import few_name, find_few, first_count
from warp_partdr.models.surfaces import SKIN, find_seen_vertices, is_closed, skin_vertices
from warp_partdr.solve.mesh.drawn_model import few_joints
from warp_partdr.solve.mesh.mesh_options import MeshOptions


@pytest.mark.parametrize("quality", ["balanced", "accurate"])
def test_the_packaged_reduced_mesh_is_what_the_code_makes(quality) -> None:
    """If it is not, ``python scripts/make_anny_findings.py`` makes the asset anew."""
    model, count = few_joints(anny()), int(first_count(MeshOptions.at(quality).skin_error))
    found, expected = packaged_findings(model, few_name(count)), find_few(model, count)
    assert found is not None
    assert found.keys() == vars(expected).keys()
    for name in ("kept", "faces", "face_parts"):
        np.testing.assert_array_equal(found[name], getattr(expected, name))
    np.testing.assert_allclose(found["moves"], expected.moves, atol=1e-9)
    np.testing.assert_allclose(found["error"], expected.error, rtol=1e-9)


def test_the_packaged_skin_is_what_rays_find() -> None:
    for model in (anny(), few_joints(anny())):
        assert packaged_findings(model, SKIN) is not None
        torch.testing.assert_close(skin_vertices(model), find_seen_vertices(model), rtol=0, atol=0)


def test_the_asset_holds_nothing_that_is_not_used() -> None:
    counts = [int(first_count(MeshOptions.at(quality).skin_error)) for quality in ("balanced", "accurate")]
    names = {SKIN, *map(few_name, counts)}
    assert {key.partition(" of ")[0] for key in packaged._asset()} == names


def test_a_model_with_another_surface_has_no_packaged_findings() -> None:
    model = anny()
    taller = replace(model, rest_vertices=model.rest_vertices * 1.01)
    turned = replace(model, faces=model.faces.roll(1, 1))
    named = replace(model, face_parts=model.face_parts.flip(0))
    for other in (taller, turned, named):
        assert packaged_findings(other, SKIN) is None
    assert packaged_findings(model, "no such name") is None
    assert packaged_findings(replace(model, name="other"), SKIN) is not None


def _surfaces() -> list[DetailedModel]:
    model = anny()
    faces, parts = model.faces, model.face_parts
    return [
        model,
        replace(model, faces=faces.flip(1)),  # inside out
        replace(model, faces=faces[1:], face_parts=parts[1:]),  # a hole
        replace(model, faces=torch.cat([faces[:1].flip(1), faces[1:]])),  # a face the other way round
        replace(model, faces=torch.cat([faces, faces]), face_parts=torch.cat([parts, parts])),  # each face twice
    ]


def test_a_closed_surface_is_one_of_trimesh_s() -> None:
    for model in _surfaces():
        expected = trimesh.Trimesh(model.rest_vertices.numpy(), model.faces.numpy(), process=False).is_volume
        assert is_closed(model) == expected


def test_pairs_are_unique_as_torch_s() -> None:
    generator = torch.Generator().manual_seed(0)
    pairs = torch.randint(0, 40, (2, 900), generator=generator)
    torch.testing.assert_close(unique_pairs(pairs, 40), pairs.unique(dim=1))
    assert unique_pairs(pairs[:, :0], 40).shape == (2, 0)
