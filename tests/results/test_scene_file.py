"""A scene's GLB: everybody when and where they are, over one ground, and cameras that see them where the fit does."""

from __future__ import annotations

from dataclasses import replace

import helpers.bodies
import numpy as np
import pytest
import torch
from helpers.skins import moving, placed, posed_vertices, read_glb
from scipy.spatial.transform import Rotation

from warp_partdr.cameras import Perspective
from warp_partdr.inputs.scene import View
from warp_partdr.models.registration import Registered
from warp_partdr.results.scene_file import Actor, NamedView, scene_glb
from warp_partdr.results.skinned_files import Poses

registered = helpers.bodies.registered  # a fixture

HEIGHT, WIDTH, FOCAL = 240, 320, 300.0


def actors(registered: Registered) -> list[Actor]:
    """Somebody who comes after 0.2 s and another, 1 m higher in the picture, who is gone after one pose."""
    poses = moving(registered)  # five, ten a second
    late = poses.since(-0.2)
    up = poses.translation[:1] - torch.tensor([0.0, 1.0, 0.0]).to(poses.translation)  # y is down
    above = Poses(poses.rotations[:1], up, np.zeros(1), 10.0, poses.lowest + 1)
    detailed = registered.model.pose(registered.shape[:1], registered.rotations[:1], up)
    body = replace(registered, translation=up, detailed=detailed)
    return [Actor("late", registered, late, 0.7), Actor("above", body, above, 0.15)]


def test_everybody_is_where_and_when_they_are(registered: Registered) -> None:
    document, arrays = read_glb(scene_glb(actors(registered), [], bare=True))
    nodes = document["nodes"]
    late, above = (next(node for node in nodes if node["name"] == name) for name in ("late", "above"))
    assert late["translation"] == above["translation"]  # one ground
    vertices = registered.detailed.vertices[0].cpu().numpy() * [1.0, -1.0, -1.0]  # y up
    for skin, higher in enumerate((0.0, 1.0)):
        expected = vertices - [0.0, vertices[:, 1].min() - higher, 0.0]
        np.testing.assert_allclose(posed_vertices(document, arrays, skin), expected, atol=1e-4)
    (animation,) = document["animations"]
    shown = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        times, values = arrays[sampler["input"]][:, 0], arrays[sampler["output"]]
        if channel["target"]["path"] == "scale":
            assert sampler["interpolation"] == "STEP"
            shown[nodes[channel["target"]["node"]]["name"]] = [*zip(times.tolist(), values[:, 0].tolist(), strict=True)]
        else:
            np.testing.assert_allclose(times, 0.2 + np.arange(5) / 10, atol=1e-6)
    assert shown == {
        "late": [(0.0, 0.0), (pytest.approx(0.2), 1.0)],
        "above": [(0.0, 1.0), (pytest.approx(0.15), 0.0)],
    }
    joints = [set(skin["joints"]) for skin in document["skins"]]
    assert not joints[0] & joints[1]
    assert [nodes[skin["skeleton"]]["name"] for skin in document["skins"]] == ["late", "above"]
    roots_of = {document["nodes"][root]["name"] for root in document["scenes"][0]["nodes"]}
    assert {"late", "above"} < roots_of


def test_cameras_see_bodies_where_the_views_do(registered: Registered) -> None:
    turn = torch.from_numpy(Rotation.from_euler("yx", [40, 10], degrees=True).as_matrix()).float()
    camera = Perspective.of_picture((HEIGHT, WIDTH), focal=FOCAL)
    view = View(camera, turn, torch.tensor([0.3, -0.2, 1.5]))
    document, _ = read_glb(scene_glb(actors(registered)[:1], [NamedView("side", view, (HEIGHT, WIDTH))]))
    node = next(node for node in document["nodes"] if node["name"] == "side")
    lens = document["cameras"][node["camera"]]["perspective"]
    body = next(node for node in document["nodes"] if node["name"] == "late")
    points = registered.detailed.joints[0].double().cpu()
    there = placed(body) @ np.column_stack([points, np.ones(len(points))]).T
    seen = (np.linalg.inv(placed(node)) @ there)[:3].T  # x right, y up, away along -z
    half = np.tan(lens["yfov"] / 2)
    across = WIDTH / 2 * (1 + seen[:, 0] / -seen[:, 2] / (half * lens["aspectRatio"]))
    down = HEIGHT / 2 * (1 - seen[:, 1] / -seen[:, 2] / half)
    expected = camera.project(view.to_camera(points.float())[None])[0, :, :2]
    np.testing.assert_allclose(np.column_stack([across, down]), expected, atol=0.02)
