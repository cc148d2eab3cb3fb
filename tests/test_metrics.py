"""Metrics against cases worked out by hand, plain loops, and SciPy's Procrustes rotation."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.linalg import orthogonal_procrustes
from scipy.spatial.transform import Rotation

from warp_partdr import metrics

HALF_TURN = np.diag([-1.0, 1.0, -1.0])


def test_confusion_and_f1_agree_with_counts_by_hand(device):
    target = torch.tensor([[0, 0, 1, 1], [2, 2, 255, 0]], dtype=torch.uint8, device=device)
    shown = torch.tensor([[0, 1, 1, 0], [2, 1, 2, 255]], dtype=torch.uint8, device=device)
    counts = metrics.confusion(shown, target, 3)
    assert counts.tolist() == [[2, 1, 0], [1, 1, 0], [0, 1, 1]]
    # background: 2·2 / (2·2 + 1 + 1); part 1: 2 / (2 + 2 + 1); part 2: 2 / (2 + 0 + 1)
    assert metrics.f1_scores(counts) == pytest.approx([4 / 6, 2 / 5, 2 / 3])
    assert metrics.part_f1(counts) == pytest.approx((4 / 6 + 2 / 5 + 2 / 3) / 3)
    assert metrics.accuracy(counts) == pytest.approx(4 / 7)
    foreground = metrics.foreground_counts(counts)
    assert foreground.tolist() == [[2, 1], [1, 3]]
    assert metrics.part_f1(foreground) == pytest.approx((4 / 6 + 6 / 8) / 2)
    assert metrics.pooled([counts, counts]).tolist() == (2 * counts).tolist()


def test_part_accuracy_takes_ignored_pixels_as_background():
    target, shown = np.array([[255, 255, 1, 0]]), np.array([[0, 1, 1, 255]])
    counts = metrics.confusion(shown, target, 2, ignored_is_background=True)
    assert counts.tolist() == [[2, 1], [0, 1]]
    assert metrics.accuracy(counts) == pytest.approx(3 / 4)


def test_counts_are_those_of_plain_loops_of_each_picture(rng):
    """SPIN and UP-3D write the LSP metric so: class by class, with boolean masks."""
    target = rng.choice([0, 1, 2, 3, 4, 255], (3, 2, 20, 15))
    shown = rng.integers(0, 6, target.shape)  # class 5 is never wanted
    counts = metrics.confusion(shown, target, 7)
    assert counts.shape == (3, 2, 7, 7)
    hits, extra, missed = np.zeros((3, 7), dtype=int)
    for c in range(7):
        wanted, drawn = target == c, (shown == c) & (target != 255)
        hits[c], extra[c], missed[c] = (wanted & drawn).sum(), (~wanted & drawn).sum(), (wanted & ~drawn).sum()
    everything = counts.sum((0, 1))
    occurring = hits + extra + missed > 0
    expected = (2 * hits / np.maximum(2 * hits + extra + missed, 1))[occurring]
    assert metrics.f1_scores(everything)[occurring] == pytest.approx(expected)
    assert metrics.part_f1(everything) == pytest.approx(expected.mean())
    filled = np.where(target == 255, 0, target)
    right = metrics.accuracy(metrics.confusion(shown, target, 7, ignored_is_background=True))
    assert right == pytest.approx((filled == shown).mean((-2, -1)))
    for index in np.ndindex(3, 2):
        assert counts[index].tolist() == metrics.confusion(shown[index], target[index], 7).tolist()
        assert metrics.part_f1(counts)[index] == pytest.approx(metrics.part_f1(counts[index]))
        assert metrics.accuracy(counts)[index] == pytest.approx(metrics.accuracy(counts[index]))
        one = metrics.foreground_counts(counts[index])
        assert metrics.foreground_counts(counts)[index].tolist() == one.tolist()
        assert one[1, 1] == ((target[index] % 255 > 0) & (shown[index] > 0)).sum()


def test_a_class_that_is_nowhere_does_not_count():
    counts = metrics.confusion(np.zeros((2, 2), int), np.zeros((2, 2), int), 5)
    assert np.isnan(metrics.f1_scores(counts)[1:]).all()
    assert metrics.part_f1(counts) == 1


@pytest.mark.parametrize(
    ("predicted", "target", "error"),
    [
        (np.zeros((2, 3), int), np.zeros((2, 2), int), "predicted: shape"),
        (np.zeros((1, 1), int), np.full((1, 1), 7), "target: class 7; expected 0 to 1"),
        (np.full((1, 1), -1), np.zeros((1, 1), int), "predicted: class -1"),
        (np.zeros(3, int), np.zeros(3, int), r"target: shape \(3,\); expected \(..., H, W\)"),
    ],
)
def test_bad_classes_and_shapes_name_the_argument(predicted, target, error):
    with pytest.raises(ValueError, match=error):
        metrics.confusion(predicted, target, 2)


@pytest.mark.parametrize("count", [-1, 0, 2.5])
def test_the_number_of_classes_must_be_a_positive_integer(count):
    with pytest.raises(ValueError, match=r"num_classes: .* expected an integer of 1 or more"):
        metrics.confusion(np.zeros((0, 4, 5), int), np.zeros((0, 4, 5), int), count)


def test_mpjpe_is_the_mean_distance_of_joints(device):
    points = torch.zeros(2, 3, device=device)
    moved = torch.tensor([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]], device=device)
    assert float(metrics.mpjpe(moved, points)) == pytest.approx(2.5)
    assert metrics.mpjpe(moved, points).device.type == device


def test_mpjpe_centres_both_on_the_pelvis():
    target = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 5.0, 0.0]])  # hips, and the head
    moved = target + np.array([7.0, 8.0, 9.0])
    assert metrics.mpjpe(moved, target, centre_on=(0, 1)) == pytest.approx(0)
    moved[2, 2] += 3.0
    moved[0, 0] += 2.0  # takes the pelvis 1 along
    # the hips are 1 off each, the head (-1, 0, 3)
    assert metrics.mpjpe(moved, target, centre_on=(0, 1)) == pytest.approx((1 + 1 + np.sqrt(10)) / 3)


def test_joints_that_are_not_valid_count_for_nothing(rng, device):
    points, target = torch.from_numpy(rng.normal(size=(2, 4, 14, 3))).to(device)
    valid = torch.ones(4, 14, dtype=torch.bool, device=device)
    valid[1, 3:] = False
    valid[2, ::2] = False
    target[~valid] = torch.nan
    for metric in (metrics.mpjpe, metrics.pa_mpjpe):
        together = metric(points, target, valid=valid)
        alone = [metric(points[i, valid[i]], target[i, valid[i]]) for i in range(4)]
        assert together.tolist() == pytest.approx([float(value) for value in alone], abs=1e-9)
    assert metrics.mpjpe(points[0], target[0], valid=torch.zeros(14, dtype=torch.bool)).isnan()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_alignment_undoes_a_similarity(rng, device, dtype):
    target = torch.from_numpy(rng.normal(size=(5, 2, 14, 3))).to(device, dtype)
    turns = torch.from_numpy(Rotation.random(10, rng=rng).as_matrix()).reshape(5, 2, 3, 3).to(target)
    moved = 1.7 * target @ turns + torch.from_numpy(rng.normal(size=(5, 2, 1, 3))).to(target)
    tolerance = 1e-5 if dtype == torch.float32 else 1e-12
    error = metrics.pa_mpjpe(moved, target)
    assert error.dtype == dtype
    assert error.shape == (5, 2)
    assert error.max() < tolerance


@pytest.mark.parametrize("mirrored", [False, True])
def test_alignment_is_that_of_scipy(rng, mirrored):
    """``align_vectors`` knows proper rotations alone; ``orthogonal_procrustes`` mirrors, and must be nearer then."""
    target = rng.normal(size=(14, 3))
    points = target * [-1, 1, 1] if mirrored else target + rng.normal(0, 0.3, (14, 3))
    source, image = points - points.mean(0), target - target.mean(0)
    turned = Rotation.align_vectors(image, source)[0].apply(source)
    scale = (turned * image).sum() / (source**2).sum()
    expected = scale * turned + target.mean(0)
    error = metrics.pa_mpjpe(points, target)
    assert error == pytest.approx(np.linalg.norm(expected - target, axis=1).mean(), abs=1e-9)
    free, singular = orthogonal_procrustes(source, image)
    mirrors = np.linalg.norm(singular / (source**2).sum() * source @ free - image, axis=1).mean()
    assert error == pytest.approx(mirrors, abs=1e-9) if not mirrored else error > mirrors + 0.1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_degenerate_points_align_as_well_as_they_can(device, dtype):
    line = torch.arange(14, device=device, dtype=dtype)[:, None] * torch.tensor([1.0, 2.0, -1.0]).to(device, dtype)
    turned = line @ torch.from_numpy(HALF_TURN).to(line) * 2 + 3
    assert metrics.pa_mpjpe(turned, line) < (1e-4 if dtype == torch.float32 else 1e-10)
    assert metrics.pa_mpjpe(line[:1], line[5:6]) == 0  # one joint
    bent = line.clone()
    bent[:, 2] = 0.0
    point = torch.zeros_like(line)  # all in one place: nothing but the mean can be met
    assert float(metrics.pa_mpjpe(point, bent)) == pytest.approx(float((bent - bent.mean(0)).norm(dim=-1).mean()))
    assert float(metrics.pa_mpjpe(bent, point)) == pytest.approx(0, abs=1e-6)


def test_units_do_not_matter_to_alignment(rng):
    points, target = rng.normal(size=(2, 14, 3))
    millimetres = metrics.pa_mpjpe((1000 * points).astype(np.float32), (1000 * target).astype(np.float32))
    assert millimetres == pytest.approx(1000 * float(metrics.pa_mpjpe(points, target)), rel=1e-4)


def test_pve_is_the_mean_distance_of_vertices_from_their_pelvis(device):
    target = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]], device=device)
    moved = target + 10
    moved[0, 1, 1] += 0.5
    pelvis = torch.full((1, 3), 0.25, device=device)
    error = metrics.pve(moved, target, pelvis=pelvis + 10, target_pelvis=pelvis)
    assert error.tolist() == pytest.approx([0.25], abs=1e-6)


@pytest.mark.parametrize("metric", [metrics.mpjpe, metrics.pa_mpjpe])
def test_bad_points_are_named(metric, device):
    good, bad = torch.zeros(2, 14, 3, device=device), torch.zeros(2, 14, 3, device=device)
    bad[1, 3, 2] = torch.nan
    for points, target, options, error in (
        (bad, good, {}, "points: holds NaN"),
        (good, bad, {}, "target: holds NaN"),
        (good[:, 1:], good, {}, r"points: shape \(2, 13, 3\); expected .* \(2, 14, 3\)"),
        (good[..., :2], good[..., :2], {}, r"points: shape \(2, 14, 2\)"),
        (good, good, {"valid": torch.ones(14, dtype=torch.bool)}, r"valid: shape \(14,\); expected \(2, 14\)"),
    ):
        with pytest.raises(ValueError, match=error):
            metric(points, target, **options)
    with pytest.raises(ValueError, match=r"valid: not all of joints \[2, 3\]"):
        metrics.mpjpe(good, good, centre_on=(2, 3), valid=torch.arange(14).expand(2, 14) != 3)


def interval_of_mean(values, seed=0):
    return metrics.bootstrap_sum(values, lambda sums: sums / len(values), seed)


def test_bootstrap_covers_the_mean_as_often_as_it_says():
    values = np.random.default_rng(1).normal(50.0, 10.0, (100, 24))
    intervals = [interval_of_mean(row, seed) for seed, row in enumerate(values)]
    assert 85 <= sum(low <= 50 <= high for low, high in intervals) <= 99
    # 2 x 1.96 x 10 / sqrt(24) = 8.0; the deviation of 24 drawn values is 3 % less than theirs
    assert np.mean([high - low for low, high in intervals]) == pytest.approx(0.97 * 8.0, rel=0.05)


def test_bootstrap_draws_people_with_replacement(rng):
    """Counts of twelve classes are so many numbers that they are resampled in blocks."""
    counts = rng.integers(0, 100, (7, 12, 12))
    drawn = np.random.default_rng(3).integers(0, 7, (metrics.RESAMPLES, 7))
    expected = np.quantile(metrics.part_f1(counts[drawn].sum(1)), [0.025, 0.975])
    assert metrics.bootstrap_sum(counts, metrics.part_f1, seed=3) == pytest.approx(expected)


@pytest.mark.parametrize("values", [np.array([]), np.array([1.0, np.nan])])
def test_bootstrap_refuses_what_has_no_interval(values):
    with pytest.raises(ValueError, match=r"values: .* expected finite numbers"):
        interval_of_mean(values)
