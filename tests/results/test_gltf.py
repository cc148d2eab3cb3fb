"""Binary glTF: where arrays begin, what lies between key frames, which joints move."""

from __future__ import annotations

from dataclasses import replace

import helpers.bodies
import numpy as np
import pytest
import torch
from helpers.skins import moving, read_glb
from scipy.spatial.transform import Rotation

from warp_partdr.models.registration import Registered
from warp_partdr.results.gltf import Document
from warp_partdr.results.skinned_files import glb

registered = helpers.bodies.registered  # a fixture


def test_arrays_begin_at_whole_numbers() -> None:
    """glTF 2.0, 3.6.2.4: at a multiple of the size of a component, wherever the array before ends."""
    document = Document()
    given = [np.arange(3, dtype=np.uint16), np.ones(2, dtype=np.float32), np.arange(5, dtype=np.uint32)]
    for values in given:
        document.add(values)
    whole, arrays = read_glb(document.glb())
    assert [view["byteOffset"] % 4 for view in whole["bufferViews"]] == [0, 0, 0]
    for values, expected in zip(arrays, given, strict=True):
        np.testing.assert_array_equal(values[:, 0], expected)


@pytest.mark.parametrize(("steps", "kind"), [(False, "LINEAR"), (True, "STEP")])
def test_values_between_key_frames_go_on_or_stay(steps: bool, kind: str) -> None:
    document = Document()
    document.nodes.append({"name": "node"})
    document.animate(0, "scale", document.add_times(np.arange(2)), np.ones((2, 3)), steps=steps)
    (animation,) = read_glb(document.glb())[0]["animations"]
    assert [sampler["interpolation"] for sampler in animation["samplers"]] == [kind]


def test_a_joint_that_turns_by_a_degree_moves(registered: Registered) -> None:
    poses = moving(registered)
    rotations = registered.rotations[:1].repeat(5, 1, 1, 1)
    for step in range(5):
        turn = torch.from_numpy(Rotation.from_euler("x", step / 4, degrees=True).as_matrix()).to(rotations)
        rotations[step, 7] = turn @ rotations[step, 7]
    document, _ = read_glb(glb(registered, replace(poses, rotations=rotations)))
    (animation,) = document["animations"]
    moves = {(channel["target"]["node"], channel["target"]["path"]) for channel in animation["channels"]}
    assert moves == {(0, "translation"), (7, "rotation")}
