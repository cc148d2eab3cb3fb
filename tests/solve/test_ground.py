"""Ground of a scene: of feet whose distances are known in closed form, and under Anny people before one camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.quick import QUICK_SCENE

from warp_partdr.body.skeletons import skeleton
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.scene import Ground, Scene, SceneObservation
from warp_partdr.lab.synthetic.scene_people import make_group, make_views
from warp_partdr.models.anny import anny
from warp_partdr.solve.scene.fitting import fit_scene
from warp_partdr.solve.scene.ground import Standing, ankle_confidence, find_ground, stand_on_ground
from warp_partdr.solve.scene.observations import observe_scene
from warp_partdr.solve.scene.options import SceneOptions
from warp_partdr.solve.scene.plan import plan_scene

PLACES = np.array([[-1.0, 3.0], [-0.4, 5.0], [0.3, 3.6], [0.9, 4.6], [1.4, 5.4], [-1.6, 4.0]])  # [m]: right, away
LEVEL = np.array([0.0, -1.0, 0.0])


def turned(pitch: float, roll: float) -> np.ndarray:
    """World to camera, of a camera that looks down and is turned about its axis [degrees]."""
    a, b = np.radians([pitch, roll])
    down = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about = np.array([[np.cos(b), -np.sin(b), 0], [np.sin(b), np.cos(b), 0], [0, 0, 1]])
    return about @ down.T


def standing(sizes: np.ndarray, turn: np.ndarray, lifted: np.ndarray | float = 0.0, height: float = 1.6) -> Standing:
    """People on a ground so far below the camera [m], seen too large by the exponents of ``sizes``."""
    feet = np.column_stack([PLACES[:, 0], height - np.broadcast_to(lifted, len(PLACES)), PLACES[:, 1]])
    sides = np.array([[-0.1, 0.0, 0.0], [0.1, -0.05, 0.0]])
    both = (feet[:, None] + sides) * np.exp(sizes)[:, None, None]
    ups = np.broadcast_to(turn @ LEVEL, (len(PLACES), 3))
    return Standing(both @ turn.T, ups, np.ones(len(PLACES)), np.arange(len(PLACES)))


@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (15.0, 0.0), (-10.0, 12.0), (25.0, -10.0)])
def test_people_of_the_right_size_show_the_ground(pitch: float, roll: float) -> None:
    turn = turned(pitch, roll)
    found = find_ground(standing(np.zeros(6), turn), turn @ LEVEL)
    np.testing.assert_allclose(found.ground.normal, turn @ LEVEL, atol=1e-6)
    assert found.ground.offset == pytest.approx(-1.6, abs=1e-6)
    assert np.abs(found.sizes).max() < 1e-6
    np.testing.assert_allclose(found.shares, found.shares[0], rtol=1e-6)
    assert found.shares[0] > 0.9


def test_sizes_of_people_on_a_known_ground_have_a_closed_form() -> None:
    turn, wrong = turned(10.0, 5.0), np.array([0.15, -0.1, 0.0, 0.05, -0.15, 0.1])
    given = Ground(turn @ LEVEL, -1.6)
    found = find_ground(standing(wrong, turn), turn @ LEVEL, given)
    assert found.ground.offset == -1.6
    # At the end, share (f e^s - d) f e^s / feet^2 + s / size^2 = 0, of the feet f without growth.
    heights = -1.6 * np.exp(wrong) * np.exp(found.sizes)
    balance = found.shares * (heights + 1.6) * heights / 0.03**2 + found.sizes / 0.1**2
    assert np.abs(balance).max() < 1e-6
    assert np.abs(found.sizes + wrong).max() < 0.02


def test_a_child_nearby_and_an_adult_far_away_are_told_apart() -> None:
    """The first is seen a quarter too large, as an adult would be farther away, on a ground that is tilted."""
    turn, wrong = turned(15.0, 8.0), np.array([0.25, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = find_ground(standing(wrong, turn), LEVEL)
    assert found.sizes[0] < -0.1
    assert np.ptp(wrong + found.sizes) < 0.5 * np.ptp(wrong)


def test_a_camera_is_held_near_the_horizon() -> None:
    """One body, on any plane, leans by 0.2 rad: the plane lies between what it says and the level of the camera."""
    lean = np.array([0.0, -np.cos(0.2), np.sin(0.2)])
    body = Standing(np.array([[[0.0, 1.6, 4.0]]]), lean[None], np.ones(1), np.zeros(1, dtype=np.int64))
    found = find_ground(body, LEVEL)
    turned_by = np.arctan2(found.ground.normal[2], -found.ground.normal[1])
    weights = found.shares[0] / 0.15**2, 1 / 0.35**2
    assert turned_by == pytest.approx(0.2 * weights[0] / sum(weights), rel=0.03)


def test_whose_ankles_are_not_seen_in_a_frame_does_not_stand_in_it_alone() -> None:
    group = make_group(0).scene
    observations = [replace(each, frame=frame) for each in group.observations[:2] for frame in range(2)]
    observations[1] = without_ankles(observations[1])
    scene = replace(group, observations=observations)
    observed_bodies = observe_scene(scene, "cpu")
    with torch.no_grad():
        _, grounded = stand_on_ground(plan_scene(scene, observed_bodies, anny(), QUICK_SCENE), observed_bodies)
    assert grounded is not None
    assert (grounded.shares > 0).tolist() == [True, False, True, True]


def test_who_jumps_or_is_not_seen_is_not_on_the_ground() -> None:
    turn, lifted = turned(10.0, 0.0), np.array([0.9, 0.0, 0.0, 0.0, 0.0, 0.0])
    bodies = standing(np.zeros(6), turn, lifted)
    found = find_ground(bodies, turn @ LEVEL)
    assert found.shares[0] < 0.1 < 0.8 < found.shares[1:].min()
    assert np.abs(found.sizes).max() < 0.05
    unseen = replace(bodies, confidence=np.array([0.0, 1, 1, 1, 1, 1]))
    assert find_ground(unseen, turn @ LEVEL).shares[0] == 0
    assert abs(find_ground(unseen, turn @ LEVEL).sizes[0]) < 1e-9


def test_feet_are_seen_as_surely_as_ankles_are(tmp_path: Path) -> None:
    confidence = np.full(17, 0.5, np.float32)
    confidence[-2:] = 0.8, 0.4  # coco17's ankles
    points = np.ones((17, 2), np.float32)
    assert ankle_confidence(Keypoints2D("coco17", points, confidence)) == pytest.approx(0.6)
    (tmp_path / "trunk.json").write_text('{"landmarks": ["nose", "left_knee", "right_knee"]}')
    trunk = Keypoints2D(skeleton(tmp_path / "trunk.json"), points[:3], np.ones(3, np.float32))
    assert ankle_confidence(trunk) == 0  # nobody knows where feet are


def test_who_lies_is_not_on_the_ground() -> None:
    turn = turned(10.0, 0.0)
    bodies = standing(np.zeros(6), turn)
    ups = bodies.ups.copy()
    ups[0] = turn @ [1.0, 0.0, 0.0]
    found = find_ground(replace(bodies, ups=ups), turn @ LEVEL)
    assert found.shares[0] < 1e-3
    np.testing.assert_allclose(found.ground.normal, turn @ LEVEL, atol=1e-3)


def test_impossible_grounds_are_refused() -> None:
    with pytest.raises(ValueError, match="normal: "):
        Ground(np.array([0.0, -2.0, 0.0]), 0.0)
    with pytest.raises(ValueError, match="offset: nan"):
        Ground(LEVEL, float("nan"))
    with pytest.raises(ValueError, match="ground: -1"):
        SceneOptions(ground=-1)
    scene = make_views(3, 1).scene
    known = replace(scene, ground=Ground(np.array([0.0, -1.0, 0.0]), -1.6))
    with pytest.raises(ValueError, match=r"options.ground: 0, for a scene whose ground is known"):
        fit_scene(known, options=SceneOptions(ground=0))
    with pytest.raises(TypeError, match="ground"):
        replace(scene, ground="floor")


def without_ankles(observation: SceneObservation) -> SceneObservation:
    confidence = observation.keypoints.confidence.copy()
    confidence[-2:] = 0
    points = np.where(confidence[:, None] > 0, observation.keypoints.points, 0).astype(np.float32)
    return replace(observation, keypoints=replace(observation.keypoints, points=points, confidence=confidence))


def same(one: Scene, options: SceneOptions) -> bool:
    """True if the ground changes no bit."""
    with_it, without = (fit_scene(one, options=replace(options, ground=weight)) for weight in (0.1, 0.0))
    assert "ground" not in without.energy
    return torch.equal(with_it.vertices, without.vertices) and "ground" not in with_it.energy


def test_what_needs_no_ground_is_bit_for_bit_as_without() -> None:
    assert same(make_views(3, 1).scene, QUICK_SCENE)
    group = make_group(0).scene
    assert same(
        replace(group, observations=[without_ankles(observation) for observation in group.observations]), QUICK_SCENE
    )


def test_feet_of_a_group_come_to_one_ground(device) -> None:
    sample = make_group(6, "clean")
    with torch.no_grad():
        observed_bodies = observe_scene(sample.scene, device)
    off = {}
    for weight in (0.0, 0.1):
        fit = fit_scene(
            sample.scene, options=replace(QUICK_SCENE, ground=weight), device=device, observed_bodies=observed_bodies
        )
        lowest = fit.vertices[:, 0, :, 1].amax(1).cpu().numpy()  # the world's y is down
        off[weight] = float(np.std(lowest))
    assert fit.ground is not None
    assert off[0.1] < 0.7 * off[0.0]


def test_the_ground_does_not_depend_on_the_world_s_frame() -> None:
    scene = make_group(2).scene
    turn = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(1)))[0]
    turn = turn * torch.linalg.det(turn)
    move = torch.tensor([2.0, -1.0, 3.0])
    (view,) = scene.views
    moved = replace(view, rotation=view.rotation @ turn, translation=view.translation + view.rotation @ move)
    here, there = (fit_scene(each, options=QUICK_SCENE) for each in (scene, replace(scene, views=[moved])))
    assert here.ground is not None
    assert there.ground is not None
    np.testing.assert_allclose(turn.numpy() @ there.ground.normal, here.ground.normal, atol=1e-3)
    points = there.joints[:, 0].numpy()
    np.testing.assert_allclose(
        there.ground.heights(points), here.ground.heights(points @ turn.numpy().T + move.numpy()), atol=5e-3
    )
