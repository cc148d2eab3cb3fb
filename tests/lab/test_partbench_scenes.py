"""PartBench's scenes: the truth scores full marks, each figure notices its fault, and the command writes them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.quick import QUICK_SCENE
from typer.testing import CliRunner

from warp_partdr.body.skeletons import MPJPE_JOINTS
from warp_partdr.cli.evaluate import evaluate as command
from warp_partdr.errors import InputError
from warp_partdr.lab.evaluation.evaluate import METHODS, evaluate, tables
from warp_partdr.lab.evaluation.partbench import scenes
from warp_partdr.lab.evaluation.partbench.report import compare_methods, write_report
from warp_partdr.lab.evaluation.partbench.samples import make_sample, source_name
from warp_partdr.lab.evaluation.partbench.scenes import SCENE_METHODS, SceneMethod, fit_all_together, partbench_scenes
from warp_partdr.lab.evaluation.scene_scoring import (
    SceneBodies,
    acceleration_error,
    depth_between_error,
    order_share,
    score_scene,
    sliding_speed,
)
from warp_partdr.lab.synthetic.mocap import Clip
from warp_partdr.lab.synthetic.scene_people import SceneSample, depths_of, in_wrong_order, make_clip
from warp_partdr.models.anny import anny
from warp_partdr.solve.scene.observations import observe_scene


class Known:
    """A fit that found the truth, moved by so much [m]."""

    def __init__(self, sample: SceneSample, move: torch.Tensor | None = None) -> None:
        self.sample = sample
        self.move = torch.zeros(3) if move is None else move

    @property
    def vertices(self) -> torch.Tensor:
        return torch.from_numpy(self.sample.vertices) + self.move

    @property
    def statures(self) -> torch.Tensor:
        return torch.from_numpy(self.sample.statures)

    def landmarks(self, names: tuple[str, ...]) -> torch.Tensor:
        if names == MPJPE_JOINTS:
            return torch.from_numpy(self.sample.joints) + self.move
        return torch.zeros(*self.sample.joints.shape[:2], len(names), 3) + self.move


@lru_cache(maxsize=1)
def pair() -> SceneSample:
    (sample,) = partbench_scenes([101], ["pairs"])
    return sample


def standing(frames: int) -> Clip:
    """Somebody who stands and goes to the left."""
    eyes = np.broadcast_to(np.eye(3), (frames, 20, 3, 3)).copy()
    places = np.linspace([0.0, 1.0, 0.0], [0.3, 1.0, 0.0], frames)
    return Clip("left", eyes[:, 0], eyes, np.zeros((frames, 20, 3)), places)


def test_the_truth_scores_full_marks_and_others_do_not() -> None:
    sample = pair()
    assert sample.wrong_order
    assert sample.source == source_name("pairs")
    score = score_scene(sample, "truth", SceneBodies([Known(sample)]), 0.0)
    assert (score.world_mpjpe, score.mpjpe, score.order) == (0, 0, 1)
    assert score.pa_mpjpe < 0.01
    assert score.depth_between == score.stature == 0
    assert np.isnan(score.acceleration)
    assert len(score.pixels.classes) == 13
    off = score.pixels.parts - np.diag(score.pixels.parts.diagonal())
    assert off.sum() == 0
    moved = score_scene(sample, "moved", SceneBodies([Known(sample, torch.tensor([0.0, 0.0, 0.1]))]), 0.0)
    assert moved.world_mpjpe == pytest.approx(100, abs=0.1)
    assert moved.mpjpe < 0.01
    assert moved.order == 1


def test_people_who_change_places_are_in_the_wrong_order() -> None:
    sample = pair()
    truth = sample.joints
    assert order_share(sample, truth) == 1
    depths = depths_of(sample.scene, truth)
    view = sample.scene.views[0]
    front, back = sample.order
    depth = view.to_camera(torch.from_numpy(truth[back, 0].mean(0) - truth[front, 0].mean(0)))
    behind = (view.rotation[2] * (2 * depth[2] - 2 * view.translation[2])).numpy()
    changed = truth.copy()
    changed[front] += behind
    assert order_share(sample, changed) == 0
    assert depth_between_error(sample, changed) == pytest.approx(2 * depths[back] - 2 * depths[front], rel=1e-3)
    right = score_scene(sample, "truth", SceneBodies([Known(sample)]), 0.0)
    other = replace(sample, vertices=sample.vertices + 0)
    other.vertices[front] += behind
    wrong = score_scene(sample, "wrong", SceneBodies([Known(other)]), 0.0)
    share = np.trace(wrong.pixels.parts) / np.trace(right.pixels.parts)
    assert share < 0.99


def test_acceleration_is_of_the_second_differences() -> None:
    time = np.arange(5.0)
    truth = np.zeros((1, 5, 3, 3))
    points = truth + (0.5 * time**2)[None, :, None, None] * np.array([2.0, 0.0, 0.0])
    assert acceleration_error(points, truth) == pytest.approx(2.0)
    assert acceleration_error(truth + time[None, :, None, None], truth) == pytest.approx(0.0)
    assert np.isnan(acceleration_error(truth[:, :2], truth[:, :2]))


def test_feet_slide_that_move_while_the_true_ones_stand() -> None:
    truth = np.zeros((1, 4, 14, 3))
    left, right = (MPJPE_JOINTS.index(f"{side}_ankle") for side in ("left", "right"))
    truth[:, :, right, 0] = 0.1 * np.arange(4)  # goes, at 3 m/s
    found = truth + 0.02 * np.arange(4)[:, None, None] * np.array([0.0, 0.0, 1.0])
    assert sliding_speed(found, truth, 30.0) == pytest.approx(0.6)
    found[:, :, right] += 5 * np.arange(4)[:, None]
    assert sliding_speed(found, truth, 30.0) == pytest.approx(0.6)
    assert sliding_speed(truth, truth, 30.0) == 0
    truth[:, 2:, left, 1] = -0.002  # still slow
    assert sliding_speed(found, truth, 30.0) == pytest.approx(0.6)
    truth[:, 3:, left, 1] = -0.06  # in the air, y down
    assert sliding_speed(found, truth, 30.0) == pytest.approx(0.6)
    truth[:, :, left, 1] = -0.06  # while the other one is on the ground
    assert np.isnan(sliding_speed(found, truth, 30.0))
    assert np.isnan(sliding_speed(found[:, :1], truth[:, :1], 30.0))


def test_smoothing_takes_jitter_away() -> None:
    sample = make_clip(3, standing(6), 30.0, "clean")
    jitter = Known(sample, 0.02 * torch.randn(1, 6, 1, 3, generator=torch.Generator().manual_seed(0)))
    rough, smooth = (score_scene(sample, "", SceneBodies([jitter], width), 0.0) for width in (0.0, 1.5))
    assert smooth.acceleration < 0.3 * rough.acceleration
    assert rough.acceleration > 10  # [mm/frame²]


def test_frames_that_are_fitted_apart_are_one_film() -> None:
    sample = make_clip(3, standing(3), 30.0, "clean")
    shown = SCENE_METHODS["frames apart, smoothed by 3"].fit_sample(sample, "cpu")
    assert [fit.scene.num_frames for fit in shown.fits] == [1, 1, 1]
    assert shown.vertices.shape == sample.vertices.shape
    found, alone = shown.landmarks(MPJPE_JOINTS), [fit.landmarks(MPJPE_JOINTS).numpy() for fit in shown.fits]
    np.testing.assert_allclose(found.mean((0, 1)), np.concatenate(alone).mean((0, 1)), atol=0.02)  # smooth, in order
    assert shown.statures == pytest.approx(np.mean([fit.statures.numpy() for fit in shown.fits]))
    off = score_scene(sample, "", shown, 0.0)
    assert off.mpjpe < 60
    assert np.ptp([fit.statures.item() for fit in shown.fits]) > 0


def test_half_of_the_pairs_start_in_the_wrong_order() -> None:
    sample = pair()
    observed_bodies = observe_scene(sample.scene, "cpu")
    with torch.no_grad():
        wrong = in_wrong_order(sample, observed_bodies)

    def distances(found):
        return [float(observed.observation.lens[0] / observed.body.log_scale.exp()) for observed in found]

    front, back = sample.order
    assert distances(wrong)[front] > distances(wrong)[back]
    for before, after in zip(observed_bodies, wrong, strict=True):  # in the picture all is as before
        torch.testing.assert_close(before.body.shift, after.body.shift)
        ratio = after.body.lengths / before.body.lengths
        torch.testing.assert_close(ratio, (before.body.log_scale - after.body.log_scale).exp().expand_as(ratio))


def test_scenes_are_fitted_scored_and_reported(tmp_path: Path) -> None:
    samples = [*partbench_scenes([4], ["views"]), make_sample(0, "clean")]
    assert [len(each.scene.views) for each in samples[:2]] == [2, 4]
    methods = {
        "scene": SceneMethod(partial(fit_all_together, options=QUICK_SCENE)),
        "keypoints only": replace(METHODS["keypoints only"], vertices=None),
        "each alone": SCENE_METHODS["each alone"],
    }
    report = evaluate(samples, methods)
    assert [(each.source, each.method) for each in report.scores] == [
        (source_name("views, 2 cameras"), "scene"),
        (source_name("views, 4 cameras"), "scene"),
        (source_name("clean"), "keypoints only"),
    ]
    row = report.pooled()[source_name("views, 2 cameras")]["scene"]
    assert row["world_mpjpe_mm"] < 120
    assert "acceleration_mm" not in row
    assert [table.title.plain.rpartition(": ")[2] for table in tables(report)] == ["1 scene", "1 scene", "1 person"]
    write_report(tmp_path / "report.html", report, samples[:2], {"scene": methods["scene"]}, {})
    assert (tmp_path / "report.html").read_text(encoding="utf-8").count("data:image/png;base64,") == 1
    with pytest.raises(InputError, match=f"methods: each alone; expected one that fits {source_name('clean')}"):
        evaluate(samples[2:], {"each alone": methods["each alone"]})


def test_groups_of_several_sizes_are_pooled() -> None:
    samples = partbench_scenes([0, 1], ["groups"])
    assert [len(each.joints) for each in samples] == [2, 3]
    scores = tuple(score_scene(each, "truth", SceneBodies([Known(each)]), 0.0) for each in samples)
    row = replace(evaluate([], {}), scores=scores).pooled()[source_name("groups")]["truth"]
    assert (row["part_f1"], row["depth_between_mm"], row["stature_off_mm"]) == (1, 0, 0)


def test_differences_of_scenes_are_told() -> None:
    sample = pair()
    scores = [
        replace(score_scene(sample, method, SceneBodies([Known(sample, torch.tensor([move, 0, 0]))]), 0.0), sample=name)
        for name in ("a", "b")
        for method, move in (("scene", 0.1), ("each alone", 0.2))
    ]
    (found,) = compare_methods(replace(evaluate([], {}), scores=tuple(scores)))
    assert re.match(r"pairs: scene minus each alone: PA-MPJPE [+-]0\.0 ", found)
    assert "world MPJPE -100.0 (-100.0 to -100.0) mm, depth order right +0.0 (+0.0 to +0.0) %, " in found
    assert "depth between people +0.0 (+0.0 to +0.0) mm, stature +0.0 (+0.0 to +0.0) mm, part F1 +" in found


def test_the_command_scores_scenes_and_asks_for_motion_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenes, "held_out_windows", lambda folder, seconds: [standing(4)])
    monkeypatch.setitem(SCENE_METHODS, "scene", SceneMethod(partial(fit_all_together, options=QUICK_SCENE)))
    arguments = ["partbench", "--people", "1", "--level", "clip", "--method", "scene", "--jobs", "1"]
    missing = CliRunner().invoke(command, arguments)
    assert isinstance(missing.exception, InputError)
    assert "--mocap: missing, but --level clip needs motion" in str(missing.exception)
    result = CliRunner().invoke(command, [*arguments, "--mocap", str(tmp_path), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    row = json.loads((tmp_path / "out" / "partbench.json").read_text())["pooled"][source_name("clip")]["scene"]
    assert {"world_mpjpe_mm", "acceleration_mm", "part_f1", "pa_mpjpe_mm", "mpjpe_mm"} <= row.keys()
    assert "order_right" not in row


def test_a_folder_without_motion_capture_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--mocap: .*no cmu_expmap.npz in it; expected a folder"):
        partbench_scenes([0], ["clip"], tmp_path)
    with pytest.raises(InputError, match="people: 0; expected 1 to 200"):
        partbench_scenes([], ["pairs"])


def test_keypoints_that_were_missing_come_back_where_they_are() -> None:
    """Noise that lasts is not that of a keypoint at (0, 0)."""
    level = "hard"  # 15 % are missing
    sample = make_clip(7, standing(6), 30.0, level)
    view = sample.scene.views[0]
    truth = view.camera.project(view.to_camera(torch.from_numpy(sample.joints[0])))[..., :2].numpy()
    low, high = truth.min((0, 1)) - 60, truth.max((0, 1)) + 60
    shown = [observation.keypoints.points[observation.keypoints.visible] for observation in sample.scene.observations]
    assert min(len(points) for points in shown) < 17
    for points in shown:
        assert ((points > low) & (points < high)).all()


def test_a_clip_goes_where_its_person_goes() -> None:
    sample = make_clip(3, standing(8), 30.0, "clean")
    middles = sample.joints[0].mean(1)
    gone = middles[-1] - middles[0]
    assert 0.24 < np.linalg.norm(gone) < 0.36  # 0.3 m of the mean body, and who has longer legs goes farther
    assert abs(gone[0]) > 0.99 * np.linalg.norm(gone)
    assert sample.vertices.shape == (1, 8, anny().num_vertices, 3)


def test_who_has_longer_legs_goes_farther() -> None:
    """Feet that stand would slide, were the pelvis to go farther than legs reach."""
    clip = standing(8)
    giant = replace(clip, positions=2 * clip.positions)
    one, same = (make_clip(3, each, 30.0, "clean") for each in (clip, giant))
    np.testing.assert_allclose(one.joints, same.joints, atol=1e-5)
