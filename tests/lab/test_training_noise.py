"""Batched noise does what PartBench's does: of strength 0 nothing, of strength 1 about as much."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from warp_partdr.body.labels import BACKGROUND, IGNORE, LABEL_SETS
from warp_partdr.body.template import NUM_PARTS, PART_NAMES
from warp_partdr.lab.synthetic.keypoint_noise import KeypointNoise
from warp_partdr.lab.synthetic.label_noise import (
    CLEAN,
    MAX_STRENGTH,
    TRAINING_LABEL_SETS,
    LabelNoise,
    _majority,
    draw_absent,
    draw_strengths,
)
from warp_partdr.lab.synthetic.noise import HIDDEN_NOISE, KEYPOINT_NOISE
from warp_partdr.lab.synthetic.occluders import Occluders, draw_occluders
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.networks.regression.landmarks import LANDMARKS

SIZE = 64
NAMES = list(TRAINING_LABEL_SETS)


def stripes(count: int, device: str) -> torch.Tensor:
    """All 20 parts as blocks on background, shape (count, 64, 64)."""
    parts = torch.zeros(SIZE, SIZE, dtype=torch.uint8)
    for part in range(NUM_PARTS):
        row, column = divmod(part, 5)
        parts[8 + row * 12 : 20 + row * 12, 2 + column * 12 : 14 + column * 12] = part + 1
    return parts.to(device).repeat(count, 1, 1)


def person(count: int, columns: slice, device: str) -> torch.Tensor:
    """A chest on background, shape (count, 64, 64)."""
    parts = torch.zeros(count, SIZE, SIZE, dtype=torch.uint8, device=device)
    parts[:, 10:50, columns] = 4
    return parts


def sets(count: int, device: str, name: str = "cdcl14") -> torch.Tensor:
    return torch.full((count,), NAMES.index(name), device=device)


def full(count: int, value: float, device: str) -> torch.Tensor:
    return torch.full((count,), value, device=device)


def occluders(parts: torch.Tensor, places: torch.Tensor, strength: float) -> Occluders:
    """The samples have labels of cdcl14."""
    rng, (count, device) = TorchRng(0, parts.device), (len(parts), str(parts.device))
    tables = LabelNoise(rng).tables(sets(count, device))
    return draw_occluders(rng, parts, tables, places, full(count, strength, device))


def test_generators_repeat_themselves_and_keep_to_their_weights(device: str) -> None:
    assert torch.equal(TorchRng(3, device).uniform(5, 2), TorchRng(3, device).uniform(5, 2))
    drawn = TorchRng(0, device).choice([1.0, 0.0, 3.0], 4000)
    shares = torch.bincount(drawn, minlength=3).cpu() / 4000
    assert shares[1] == 0
    assert shares[0] == pytest.approx(0.25, abs=0.03)
    span = TorchRng(0, device).uniform(2000, low=-2.0, high=5.0)
    assert span.min() >= -2
    assert span.max() < 5
    assert span.mean().item() == pytest.approx(1.5, abs=0.2)


@pytest.mark.parametrize("name", ["cdcl14", "pascal6", "ellipbody20", "surreal14"])
def test_without_strength_labels_are_the_truth(name: str, device: str) -> None:
    parts = stripes(4, device)
    groups = LabelNoise(TorchRng(0, device)).groups(parts, sets(4, device, name), full(4, 0.0, device))
    truth = LABEL_SETS[name].from_parts(parts.cpu().numpy())
    np.testing.assert_array_equal(groups.cpu().numpy(), truth)


def test_clothes_are_unknown_and_regions_without_ids_too(device: str) -> None:
    parts = stripes(64, device)
    groups = LabelNoise(TorchRng(0, device)).groups(parts, sets(64, device, "lip20"), full(64, 0.0, device))
    lip = LABEL_SETS["lip20"]

    def share_unknown(part: str) -> float:
        return float((groups[parts == PART_NAMES.index(part) + 1] == IGNORE).float().mean())

    assert share_unknown("chest") == 1.0  # LIP has no class for a torso, only for what it wears
    assert share_unknown("head") == 0.0
    assert 0.3 < share_unknown("left_upper_arm") < 0.95
    assert 0.0 < share_unknown("left_forearm") < share_unknown("left_upper_arm")
    assert set(groups[groups != IGNORE].unique().tolist()) <= {0, *range(1, lip.num_groups + 1)}
    assert (groups[parts == 0] == BACKGROUND).all()


def test_labels_err_more_with_strength_and_stay_within_their_set(device: str) -> None:
    parts = stripes(48, device)
    truth = torch.from_numpy(LABEL_SETS["cdcl14"].from_parts(parts.cpu().numpy())).to(device)
    wrong = []
    for strength in (0.3, 1.0, MAX_STRENGTH):
        groups = LabelNoise(TorchRng(1, device)).groups(parts, sets(48, device), full(48, strength, device))
        assert groups.dtype == torch.uint8
        assert set(groups.unique().tolist()) <= {*range(15), IGNORE}
        wrong.append(float((groups != truth)[truth > 0].float().mean()))
    assert 0.005 < wrong[0] < wrong[1] < wrong[2] < 0.6


@pytest.mark.parametrize("apart", [1, 2])
def test_majority_is_that_of_nine(apart: int, device: str, rng: np.random.Generator) -> None:
    images = rng.integers(0, 3, (3, 12, 10)).astype(np.uint8)
    padded = np.pad(images, ((0, 0), (apart, apart), (apart, apart)), mode="edge")
    steps = (0, apart, 2 * apart)
    nine = np.stack([padded[:, i : i + 12, j : j + 10] for i in steps for j in steps])
    counts = np.stack([(nine == label).sum(0) for label in range(3)])
    chosen = torch.tensor([True, False, True], device=device)
    got = _majority(torch.from_numpy(images).to(device), chosen, apart).cpu().numpy()
    np.testing.assert_array_equal(got[1], images[1])
    votes = np.take_along_axis(counts, got[None].astype(np.int64), 0)[0]
    assert (votes == counts.max(0))[[0, 2]].all()
    tied = (counts == counts.max(0)).sum(0) > 1
    centre_wins = np.take_along_axis(counts, images[None].astype(np.int64), 0)[0] == counts.max(0)
    assert (got == images)[[0, 2]][(tied & centre_wins)[[0, 2]]].all()


def test_growing_makes_people_wider_or_narrower_by_a_pixel_or_two(device: str) -> None:
    groups = torch.zeros(200, SIZE, SIZE, dtype=torch.uint8, device=device)
    groups[:, 20:40, 20:40] = 3
    grown = LabelNoise(TorchRng(2, device))._grow(groups, full(200, MAX_STRENGTH, device))
    areas = grown.flatten(1).gt(0).sum(1)
    assert set(grown.unique().tolist()) == {0, 3}
    assert areas.min() == 18 * 18
    assert areas.max() == 20 * 20 + 4 * 20
    assert (areas == 400).any()


def test_keypoints_jitter_as_partbenchs_and_hidden_ones_more(device: str) -> None:
    count, stature = 4000, 1.6
    points = torch.zeros(count, len(LANDMARKS), 2, device=device)
    hidden = (torch.arange(len(LANDMARKS), device=device) < 5).expand(count, -1)
    known = (torch.arange(len(LANDMARKS), device=device) != 20).expand(count, -1)
    sizes = full(count, stature, device), full(count, 1.0, device)
    seen = KeypointNoise(TorchRng(0, device)).keypoints(points, hidden, known, *sizes)
    found = seen[..., 2] > 0
    assert (seen[~found] == 0).all()
    assert not found[:, 20].any()
    expected = stature * KEYPOINT_NOISE
    for landmarks, factor, dropout in ((slice(0, 5), HIDDEN_NOISE, 0.12), (slice(5, 20), 1.0, 0.06)):
        offsets = seen[:, landmarks, :2][found[:, landmarks]].abs()
        # The median, for a few lie anywhere; sides that changed places have the same offsets.
        assert offsets.median().item() / 0.6745 == pytest.approx(factor * expected, rel=0.05)
        assert 1 - found[:, landmarks].float().mean().item() == pytest.approx(dropout, abs=0.015)
    assert (seen[..., 2] <= 1).all()
    assert seen[:, :5, 2][found[:, :5]].mean() < seen[:, 5:20, 2][found[:, 5:20]].mean() - 0.1


def test_swapped_sides_exchange_left_and_right(device: str) -> None:
    count = 3000
    places = torch.arange(len(LANDMARKS), device=device).float()
    points = torch.stack([places, places], dim=1).expand(count, -1, -1) / 24
    flags = torch.zeros(count, len(LANDMARKS), dtype=torch.bool, device=device)
    noise = KeypointNoise(TorchRng(0, device))
    seen = noise.keypoints(points, flags, ~flags, full(count, 0.0, device), full(count, 1.0, device))
    left, right = LANDMARKS.index("left_wrist"), LANDMARKS.index("right_wrist")
    found = (seen[:, [left, right], 2] > 0).all(1)
    swapped = (seen[:, left, 0] - points[:, right, 0]).abs() < 1e-6
    assert (((seen[:, right, 0] - points[:, left, 0]).abs() < 1e-6) == swapped)[found].float().mean() > 0.97
    assert 0.01 < swapped[found].float().mean() < 0.07


def test_things_in_front_cover_pixels_and_strangers_come_from_the_side(device: str) -> None:
    parts, places = person(64, slice(26, 38), device), torch.zeros(64, 6, 2, device=device)
    nothing = occluders(parts, places, 0.0)
    assert not nothing.mask.any()
    fronts = occluders(parts, places, MAX_STRENGTH)
    assert not (fronts.hiding & ~fronts.mask).any()
    assert (fronts.mask & ~fronts.hiding).any()  # holes hide nothing
    torso = LABEL_SETS["cdcl14"].group_names.index("torso") + 1
    assert set(fronts.groups[fronts.mask].unique().tolist()) <= {BACKGROUND, IGNORE, torso}
    beside = fronts.mask[:, 10:50, :20].flatten(1).any(1) | fronts.mask[:, 10:50, 44:].flatten(1).any(1)
    assert 0.05 < beside.float().mean() < 0.7


def test_detectors_know_the_landmarks_of_their_formats(device: str) -> None:
    known = KeypointNoise(TorchRng(0, device)).detected(500)
    by_name = dict(zip(LANDMARKS, known.float().mean(0).tolist(), strict=True))
    assert by_name["left_knee"] == 1.0
    assert by_name["nose"] < 0.95
    assert 0.1 < by_name["left_heel"] < 0.6
    assert 0.1 < by_name["head_top"] < 0.7
    assert all(by_name[name] == by_name[name.replace("left", "right")] for name in LANDMARKS)


def test_some_samples_are_clean_or_lack_labels_or_keypoints_and_others_are_of_any_strength(device: str) -> None:
    labels, keypoints = draw_absent(4000, TorchRng(0, device))
    assert not (labels & keypoints).any()
    assert 0.15 < labels.float().mean() < 0.26
    assert 0.03 < keypoints.float().mean() < 0.1
    strengths = draw_strengths(20_000, TorchRng(0, device))
    noisy = strengths[strengths > 0].cpu().numpy()
    assert 1 - len(noisy) / 20_000 == pytest.approx(CLEAN, abs=0.01)
    np.testing.assert_allclose(np.quantile(noisy, [0.25, 0.5, 0.75]) / MAX_STRENGTH, [0.25, 0.5, 0.75], atol=0.02)


def test_strangers_stand_before_or_behind_the_person(device: str) -> None:
    """Behind, the person hides what overlaps; before, it is the stranger's. Beside the person they show either way."""
    parts = person(2000, slice(16, 48), device)
    nowhere = torch.full((2000, 6, 2), 9.0, device=device)  # no holes and no things
    fronts = occluders(parts, nowhere, MAX_STRENGTH)
    there = fronts.mask.flatten(1).any(1)
    beside = (fronts.mask & (parts == 0)).flatten(1).any(1)
    over = (fronts.mask & (parts > 0)).flatten(1).any(1)
    assert 0.2 < there.float().mean() < 0.4
    assert torch.equal(beside, there)
    assert 1 - over[there].float().mean().item() == pytest.approx(0.3, abs=0.06)
