"""PartBench: its truth is true, its noise is what the levels say, and its report says what was found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from warp_partdr.cli.evaluate import evaluate
from warp_partdr.errors import InputError
from warp_partdr.lab.evaluation.evaluate import METHODS as SUPERVISIONS
from warp_partdr.lab.evaluation.evaluate import Report
from warp_partdr.lab.evaluation.partbench.methods import KNOWN_CAMERA, METHODS, fit_anny, registered_vertices
from warp_partdr.lab.evaluation.partbench.report import compare_methods, worst, write_report
from warp_partdr.lab.evaluation.partbench.samples import (
    CLOTHED,
    FAR,
    LABELS,
    NEAR,
    TURNED,
    make_sample,
    partbench_samples,
    source_name,
)
from warp_partdr.lab.evaluation.scoring import Pixels, Score, score_fit
from warp_partdr.lab.synthetic.noise import LEVELS
from warp_partdr.lab.synthetic.partbench_people import NUM_PEOPLE, draw_format, make_person


def test_clean_samples_hold_the_truth_alone() -> None:
    sample = make_sample(0, "clean")
    person = make_person(0)
    np.testing.assert_array_equal(sample.parts.groups, sample.target)
    there = sample.keypoints.visible
    np.testing.assert_allclose(sample.keypoints.points[there], person.keypoints()[there], rtol=1e-6)
    np.testing.assert_array_equal(sample.keypoints.confidence[there], np.where(person.hidden(), 0.5, 1.0)[there])


def test_each_level_is_farther_from_the_truth() -> None:
    seen = [[make_sample(index, level) for index in range(3)] for level in LEVELS]
    wrong = [np.mean([(sample.parts.groups != sample.target).mean() for sample in samples]) for samples in seen]
    assert wrong[0] == 0
    assert wrong == sorted(wrong)
    assert wrong[-1] > 2 * wrong[1]


def test_some_realistic_people_have_keypoints_where_other_data_sets_mark_them_and_say_so() -> None:
    found: dict[str, list[float]] = {}
    for index in range(8):
        sample, clean = make_sample(index, "realistic"), make_sample(index, "clean")
        form = sample.keypoints.format
        assert form == draw_format(index, LEVELS["realistic"].others)
        assert clean.keypoints.skeleton == "coco17"
        np.testing.assert_array_equal(sample.joints, clean.joints)  # the body's own, whatever the keypoints mark
        assert sample.body_points == sample.joint_names == clean.joint_names
        person, sure = make_person(index), sample.keypoints.confident
        sure &= ~person.hidden(form)
        off = np.linalg.norm(sample.keypoints.points - person.keypoints(form), axis=1)[sure]
        found.setdefault(form.name, []).append(float(np.median(off)) / person.height)
    assert set(found) == {"coco17", "h36m17", "shelf14"}
    assert all(np.mean(off) < 0.02 for off in found.values())  # near their own data set's places, but for the noise
    assert all(make_sample(index, "mild").keypoints.skeleton == "coco17" for index in range(8))


def test_a_stranger_has_keypoints_of_the_persons_format() -> None:
    for index, form in ((12, "h36m17"), (17, "shelf14")):
        sample = make_sample(index, "hard")
        (stranger,) = sample.others
        assert stranger.skeleton == sample.keypoints.skeleton == form


def test_statures_are_scored() -> None:
    sample, person = make_sample(1, "clean"), make_person(1)
    assert sample.stature == make_sample(1, TURNED).stature == person.stature
    score = score_fit(sample, "", METHODS["network"].fit_sample(sample, "cpu"), 0.0)
    assert 0.8 < score.stature_share < 1.2


def test_near_people_come_with_their_camera() -> None:
    (near,), (far, *_) = partbench_samples(1, [NEAR]), partbench_samples(1, ["realistic"])
    assert near.camera is make_person(0, "near").camera
    assert near.source == source_name("near")
    assert far.camera is make_person(0, "usual").camera
    known, weak = (METHODS[name].fit_sample(near, "cpu") for name in (KNOWN_CAMERA, "parts"))
    assert known.camera.perspective
    assert weak.camera.perspective == weak.camera_guessed
    errors = [score_fit(near, "", result, 0.0).mpjpe for result in (known, weak)]
    assert errors[0] < errors[1]


def test_far_people_have_their_size_and_place() -> None:
    off = []
    for index in range(4):
        far = make_sample(index, FAR)
        hips = [far.joint_names.index(f"{side}_hip") for side in ("left", "right")]
        found = METHODS[KNOWN_CAMERA].fit_sample(far, "cpu").landmarks(far.joint_names)[hips].mean(0)
        true = far.joints[hips].mean(0)
        assert true[2] > 8.0
        off.append(np.linalg.norm(found - true) / np.linalg.norm(true))
    assert np.mean(off) < 0.12  # as far as a person's height is uncertain


def test_turned_people_are_the_realistic_ones_in_a_turned_picture() -> None:
    for index in (0, 1, 2):
        turned, upright = make_sample(index, TURNED), make_sample(index, "realistic")
        assert turned.source == source_name(TURNED)
        back = np.rot90(turned.target, -1 - index)
        np.testing.assert_array_equal(back, upright.target)
        rows, columns = (turned.keypoints.points[turned.keypoints.confident].T[::-1] - 0.5).round().astype(int)
        height, width = turned.target.shape
        inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        assert (turned.target[rows[inside], columns[inside]] > 0).mean() > 0.7  # keypoints lie on the person
    half, upright_one = make_sample(1, TURNED), make_sample(1, "realistic")
    np.testing.assert_allclose(half.joints, upright_one.joints * [-1, -1, 1], atol=1e-6)
    found = METHODS["network"].fit_sample(half, "cpu")
    usual = METHODS["network"].fit_sample(upright_one, "cpu")
    errors = [score_fit(each, "", result, 0.0).pa_mpjpe for each, result in ((half, found), (upright_one, usual))]
    assert errors[0] < 1.3 * errors[1]


def test_clothed_people_are_the_realistic_ones_with_other_labels() -> None:
    for index in (0, 1):
        clothed, nude = make_sample(index, CLOTHED), make_sample(index, "realistic")
        assert (clothed.source, clothed.name) == (source_name(CLOTHED), nude.name)
        for name in ("points", "confidence"):
            np.testing.assert_array_equal(getattr(clothed.keypoints, name), getattr(nude.keypoints, name))
        np.testing.assert_array_equal(clothed.vertices, nude.vertices)
        np.testing.assert_array_equal(clothed.target, LABELS.from_parts(make_person(index, "clothed").parts))
        assert (clothed.parts.groups != clothed.target).mean() < (clothed.parts.groups != nude.target).mean()


def test_samples_come_by_level_and_depend_on_their_seed_alone() -> None:
    samples = partbench_samples(2, ["realistic", "hard"])
    assert [sample.source for sample in samples] == [source_name("realistic")] * 2 + [source_name("hard")] * 2
    again = make_sample(1, "hard")
    np.testing.assert_array_equal(samples[-1].keypoints.points, again.keypoints.points)
    np.testing.assert_array_equal(samples[-1].parts.groups, again.parts.groups)


@pytest.mark.parametrize(("count", "levels"), [(0, ["clean"]), (NUM_PEOPLE + 1, ["clean"]), (1, ["spotless"])])
def test_bad_requests_are_refused(count: int, levels: list[str]) -> None:
    with pytest.raises(InputError, match="expected"):
        partbench_samples(count, levels)


def _score(sample: str, method: str, pa_mpjpe: float, right: int) -> Score:
    counts = np.array([[80, 0], [20 - right, right]])
    pixels = Pixels(("background", "body"), counts, counts, counts, counts)
    return Score(source_name("clean"), sample, method, np.array([0.01]), 1.0, pixels, pa_mpjpe, pa_mpjpe)


def test_findings_say_what_is_better() -> None:
    scores = tuple(
        _score(person, method, error, right)
        for person, extra in (("a", 0.0), ("b", 10.0))
        for method, error, right in (("parts", 50.0 + extra, 19), ("full silhouette", 70.0 + extra, 10))
    )
    (found,) = compare_methods(Report(scores))
    assert found.startswith(
        "clean: parts minus full silhouette: PA-MPJPE -20.0 (-20.0 to -20.0) mm, "
        "MPJPE -20.0 (-20.0 to -20.0) mm, part F1 +0.1"
    )
    assert [score.sample for score in worst(Report(scores), "parts")] == ["b", "a"]


def test_annys_mesh_follows_the_labels_and_the_report_draws_the_worst(tmp_path: Path, device: str) -> None:
    sample = make_sample(4, "clean")
    options = METHODS["parts, Anny's mesh"].options
    result = fit_anny(sample.keypoints, sample.parts, options=options, device=device)
    shown = LABELS.from_parts(result.draw(sample.target.shape).labels[0].cpu().numpy())
    before = LABELS.from_parts(result.first.draw(sample.target.shape).labels[0].cpu().numpy())
    assert (shown != sample.target).mean() < 0.75 * (before != sample.target).mean()
    assert result.vertices.shape == sample.vertices.shape
    assert registered_vertices(result.first).shape == sample.vertices.shape

    kept = {"keypoints only": replace(SUPERVISIONS["keypoints only"], vertices=None)}
    score = replace(_score(sample.name, "keypoints only", 50.0, 10), source=sample.source)
    write_report(tmp_path / "report.html", Report((score,)), [sample], kept, {"machine": "<any>"}, device=device)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 1
    assert "&lt;any&gt;" in page


def test_the_command_writes_table_and_figures(tmp_path: Path) -> None:
    arguments = ["partbench", "--people", "2", "--level", "mild", "--method", "keypoints only", "--jobs", "1"]
    result = CliRunner().invoke(evaluate, [*arguments, "--device", "cpu", "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    assert f"{source_name('mild')}: 2 people" in result.output
    figures = json.loads((tmp_path / "out" / "partbench.json").read_text())
    row = figures["pooled"][source_name("mild")]["keypoints only"]
    assert row["people"] == 2
    assert {"foreground_f1", "part_f1", "mpjpe_mm", "pa_mpjpe_mm", "pve_mm", "seconds"} <= row.keys()
    assert (tmp_path / "out" / "partbench.html").stat().st_size > 10_000
