"""Augmentation moves picture, labels, keypoints, camera and 3D alike: what is drawn before is what is drawn after."""

import numpy as np
import pytest
import torch

from warp_partdr.body.labels import LABEL_SETS, label_set
from warp_partdr.body.landmarks import mirror_name
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import JOINT_NAMES
from warp_partdr.lab.training.augment import Augmentation, Similarity, mirror_groups
from warp_partdr.render.ellipsoids import draw_ellipsoids
from warp_partdr.results.palette import PART_COLOURS

SIZE = 256
NAMES = skeleton("body25").landmarks
PARTS = label_set("ellipbody20")
FINE = 9 * SIZE  # of the picture before, so that its own pixels don't count; odd, so that centres meet
CROP = (0.0, 0.0, float(FINE), float(FINE))
SIMILARITIES = {
    "nothing": Similarity(),
    "flip": Similarity(mirrored=True),
    "turn": Similarity(angle=0.5),
    "zoom": Similarity(zoom=0.7),
    "shift": Similarity(shift=(0.13, -0.2)),
    "all": Similarity(mirrored=True, angle=-0.4, zoom=0.85, shift=(-0.1, 0.15)),
}


def bent_body() -> BodyParameters:
    """One person in a pose without symmetry, off the middle and turned."""
    body = BodyParameters.mean(1)
    body.rotations[0, 2:] = 0.35 * torch.randn(18, 3, generator=torch.Generator().manual_seed(3))
    body.orientation[0] += 0.5 * torch.randn(6, generator=torch.Generator().manual_seed(4))
    body.shift[0] = torch.tensor([0.1, -0.05])
    body.log_scale[0] = -0.05
    return body


def draw(body: BodyParameters, size: int = SIZE) -> np.ndarray:
    return draw_ellipsoids(body.posed(), body.camera(size), (size, size)).labels[0].numpy()


@pytest.mark.parametrize("name", SIMILARITIES)
def test_labels_are_those_of_the_augmented_body_and_the_picture_moves_with_them(name):
    similarity, body = SIMILARITIES[name], bent_body()
    labels = draw(body, FINE)
    moved = similarity.labels(labels, PARTS, CROP, SIZE)
    drawn = draw(similarity.body(body))
    known = moved != 255
    assert known.mean() > 0.4
    shown = [part for part in range(1, 21) if (drawn == part).sum() > 100]
    assert len(shown) >= 10
    for part in [None, *shown]:
        a, b = (((labels > 0) if part is None else (labels == part)) & known for labels in (drawn, moved))
        assert (a & b).sum() / (a | b).sum() > 0.97, part
    sided = mirror_groups(PARTS)[labels] if similarity.mirrored else labels  # colours stay, names change sides
    picture = similarity.picture(PART_COLOURS[sided], CROP, SIZE)
    wrong = (np.abs(picture.astype(int) - PART_COLOURS[np.where(known, moved, 0)]).max(-1) > 40).mean()
    assert wrong < 0.02  # along borders, where colours mix


@pytest.mark.parametrize("name", SIMILARITIES)
def test_keypoints_and_joints_are_those_of_the_augmented_body(name):
    similarity, body = SIMILARITIES[name], bent_body()
    gather = LandmarkGather(NAMES, "cpu")

    def project(parameters: BodyParameters) -> np.ndarray:
        return parameters.camera(2).project(gather(parameters.posed()))[0, :, :2].numpy() - 1

    np.testing.assert_allclose(similarity.points(project(body), NAMES), project(similarity.body(body)), atol=2e-3)
    joints = similarity.joints(body.posed().joints[0].numpy(), JOINT_NAMES)
    np.testing.assert_allclose(joints, similarity.body(body).posed().joints[0].numpy(), atol=2e-3)


def test_crop_of_a_larger_picture_is_reduced():
    """A fine pattern becomes its mean instead of what single pixels show; beyond the picture all is black."""
    picture = np.zeros((1024, 1024, 3), dtype=np.uint8)
    picture[::2] = 200
    crop = Similarity().picture(picture, (-1024.0, 0.0, 1024.0, 2048.0), 64)
    assert np.abs(crop[2:30, 34:] - 100.0).max() < 3
    assert (crop[:, :30] == 0).all()
    assert (crop[34:] == 0).all()


def test_mirroring_keeps_confidences_and_ignores_groups_without_a_mirror_image():
    points = np.array([[0.1, 0.2, 0.9], [0.5, 0.2, 0.3]], dtype=np.float32)
    moved = Similarity(mirrored=True).points(points, ("left_knee", "right_knee"))
    np.testing.assert_allclose(moved, [[-0.5, 0.2, 0.3], [-0.1, 0.2, 0.9]])
    one_armed = label_set({"groups": {"arm": ["left_forearm"]}, "ids": {"0": "background", "1": "arm"}})
    assert mirror_groups(one_armed)[[0, 1, 255]].tolist() == [0, 255, 255]


@pytest.mark.parametrize("name", LABEL_SETS)
def test_mirrored_groups_have_the_mirrored_parts(name):
    labels = LABEL_SETS[name]
    table = mirror_groups(labels)
    for group, parts in enumerate(labels.groups.values(), start=1):
        if table[group] != 255:
            assert set(labels.groups[labels.group_names[table[group] - 1]]) == set(map(mirror_name, parts))
    groups = np.arange(labels.num_groups + 1)
    assert (table[table[groups]] == groups).all()  # all of the project's sets are symmetric


def test_draws_go_both_ways_within_their_ranges(rng):
    """Examples are enlarged as often as reduced, and moved and turned to either side."""
    chosen = Augmentation(flip=0.5, angle=20, zoom=0.2, shift=0.05)
    drawn = [chosen.draw(rng) for _ in range(400)]
    assert 0.4 < np.mean([one.mirrored for one in drawn]) < 0.6
    assert 0.9 < np.degrees(max(abs(one.angle) for one in drawn)) / 20 <= 1
    assert all(1 / 1.2 <= one.zoom <= 1.2 and max(map(abs, one.shift)) <= 0.05 for one in drawn)
    for values in np.array([(np.log(one.zoom), one.angle, *one.shift) for one in drawn]).T:
        assert min(values) == pytest.approx(-max(values), rel=0.1)
        assert abs(np.mean(values)) < 0.1 * max(values)
    assert Augmentation(flip=0, angle=0, zoom=0, shift=0).draw(rng) == Similarity()


def test_colours_change_within_bounds(rng):
    picture = np.full((4, 4, 3), 100, dtype=np.uint8)
    assert (Augmentation(colour=0.0).recolour(picture, rng) == picture).all()
    changed = Augmentation(colour=0.3).recolour(picture, rng)
    assert changed.shape == picture.shape
    assert changed.dtype == np.uint8
    assert len({int(value) for value in changed[0, 0]}) > 1
