"""Metrics against cases worked out by hand, and SciPy's Procrustes rotation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from warp_partdr import metrics


def test_confusion_and_f1_by_hand():
    target = np.array([[0, 0, 1, 1], [2, 2, 255, 0]])
    shown = np.array([[0, 1, 1, 0], [2, 1, 2, 255]])
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


def test_a_class_that_is_nowhere_does_not_count():
    counts = metrics.confusion(np.zeros((2, 2), int), np.zeros((2, 2), int), 5)
    assert np.isnan(metrics.f1_scores(counts)[1:]).all()
    assert metrics.part_f1(counts) == 1


def test_bad_classes_and_shapes_name_the_argument():
    with pytest.raises(ValueError, match="predicted: shape"):
        metrics.confusion(np.zeros((2, 3), int), np.zeros((2, 2), int), 2)
    with pytest.raises(ValueError, match="target: class 7"):
        metrics.confusion(np.zeros((1, 1), int), np.full((1, 1), 7), 2)


def test_alignment_undoes_a_similarity(rng):
    target = rng.normal(size=(5, 14, 3))
    turns = Rotation.random(5, rng=rng).as_matrix()
    moved = 1.7 * target @ turns + rng.normal(size=(5, 1, 3))
    np.testing.assert_allclose(metrics.align_similarity(moved, target), target, atol=1e-9)
    assert metrics.pa_mpjpe(moved, target) == pytest.approx(np.zeros(5), abs=1e-9)


def test_alignment_is_a_proper_rotation(rng):
    target = rng.normal(size=(14, 3))
    mirrored = target * [-1, 1, 1]
    assert metrics.pa_mpjpe(mirrored, target) > 0.1
    source, image = mirrored - mirrored.mean(0), target - target.mean(0)
    rotation, _ = Rotation.align_vectors(image, source)
    turned = rotation.apply(source)
    scale = (turned * image).sum() / (source**2).sum()
    np.testing.assert_allclose(metrics.align_similarity(mirrored, target), scale * turned + target.mean(0), atol=1e-6)


def test_mpjpe_by_hand():
    points = np.zeros((2, 3))
    moved = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 0.0]])
    assert metrics.mpjpe(moved, points) == pytest.approx(2.5)
