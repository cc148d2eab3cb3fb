"""The detector MoveNet MultiPose: held to its original runtime, and the reading of its maps by hand-made ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.example import example_photo

from warp_partdr.networks.detection.asset import packaged_people_networks
from warp_partdr.networks.detection.movenet import NUM_KEYPOINTS, STRIDE, read_people

FIXTURE = Path(__file__).with_name("movenet_example.json")
CELLS = 64
MAPS = {"centre": 1, "size": 2, "centre_offset": 2, "heat": 17, "keypoints": 34, "keypoint_offset": 34}


def halved_example() -> torch.Tensor:
    """The example at half its size in the corner of a black square, numbers from 0 to 255, shape (1, 3, 256, 256)."""
    blocks = example_photo().astype(np.int64).reshape(256, 2, 192, 2, 3).sum(axis=(1, 3)) // 4
    picture = np.zeros((256, 256, 3), np.float32)
    picture[:, :192] = blocks
    return torch.from_numpy(picture).permute(2, 0, 1)[None]


def test_tensorflow_js_says_the_same(device: str) -> None:
    """All six people of its answer, of whom five are noise: keypoints to 0.01 px.

    Its confidence in a keypoint is the highest of all six people's at that place. Ours is each one's own: at most that.
    """
    theirs = np.array(json.loads(FIXTURE.read_text(encoding="utf-8"))["people"])
    with torch.no_grad():
        maps = packaged_people_networks(device).detector(halved_example().to(device) / 127.5 - 1)
    pictures, scores, keypoints = (each.cpu().numpy() for each in read_people(maps, 0.0))
    assert (pictures == 0).all()
    for row in theirs:
        points = row[:51].reshape(NUM_KEYPOINTS, 3)
        apart = np.abs(keypoints[..., :2] - 256 * points[:, 1::-1]).max(axis=(1, 2))
        same = int(apart.argmin())
        assert apart[same] < (0.01 if device == "cpu" else 0.3)
        assert (keypoints[same, :, 2] < points[:, 2] + 1e-3).all()
    best = int(scores.argmax())
    own = np.abs(keypoints[best, :, 2] - theirs[0, 2:51:3]) < 1e-3
    assert own.sum() > 5  # the others are those of the noise
    assert scores[best] == pytest.approx(theirs[0, 55], abs=0.03)


def hand_made_maps(*people: tuple[int, int]) -> dict[str, torch.Tensor]:
    """Maps of one picture with people whose centres are in these cells (column, row), whose box is 12 cells a side.

    Every keypoint is expected two cells to the right of the centre, and its heat is one cell below there.
    """
    maps = {name: torch.full((1, channels, CELLS, CELLS), 0.0) for name, channels in MAPS.items()}
    maps["centre"] -= 9.0
    maps["heat"] -= 9.0
    for column, row in people:
        maps["centre"][0, 0, row, column] = 2.0
        maps["size"][0, :, row, column] = 12.0
        maps["keypoints"][0, 1::2, row, column] = 2.0  # y comes first
        maps["heat"][0, :, row + 1, column + 2] = 3.0
        maps["keypoint_offset"][0, 1::2, row + 1, column + 2] = 0.25
    return maps


def test_keypoints_are_the_hot_cells_near_where_they_are_expected() -> None:
    maps = hand_made_maps((20, 30))
    pictures, scores, keypoints = read_people(maps, 0.15)
    assert pictures.tolist() == [0]
    np.testing.assert_allclose(keypoints[0, :, :2], [[STRIDE * 22.25, STRIDE * 31]] * NUM_KEYPOINTS)
    heat, centre = 1 / (1 + np.exp(-3)), 1 / (1 + np.exp(-2))
    confidence = heat * np.exp(-1 / (0.3 * CELLS))
    np.testing.assert_allclose(keypoints[0, :, 2], confidence, rtol=1e-5)
    assert float(scores[0]) == pytest.approx(centre * confidence, rel=1e-5)


def test_keypoints_are_in_the_box() -> None:
    maps = hand_made_maps((20, 30))
    maps["heat"][0, :, 31, 22] = -2.0
    maps["heat"][0, :, 36, 22] = 9.0  # much hotter, just below the box
    _, _, keypoints = read_people(maps, 0.15)
    np.testing.assert_allclose(keypoints[0, :, :2], [[STRIDE * 22.25, STRIDE * 31]] * NUM_KEYPOINTS)


def test_scores_count_the_keypoints_that_are_seen() -> None:
    maps = hand_made_maps((20, 30))
    maps["heat"][0, 5:] = -9.0
    _, scores, keypoints = read_people(maps, 0.15)
    centre = 1 / (1 + np.exp(-2))
    assert float(scores[0]) == pytest.approx(centre * float(keypoints[0, :5, 2].mean()), rel=1e-5)


def test_more_people_are_read_than_the_network_counts_and_neighbours_are_one() -> None:
    places = [(8 * column + 6, 8 * row + 6) for row in range(4) for column in range(6)]
    maps = hand_made_maps(*places)
    maps["centre"][0, 0, 8, 8] = 1.0  # two cells from a higher one
    assert len(read_people(maps, 0.15)[0]) == len(places)


def test_batches_say_what_each_picture_says() -> None:
    one, other = hand_made_maps((20, 30)), hand_made_maps((40, 10), (10, 50))
    together = read_people({name: torch.cat([one[name], other[name]]) for name in MAPS}, 0.15)
    assert together[0].tolist() == [0, 1, 1]
    for number, maps in enumerate((one, other)):
        alone = read_people(maps, 0.15)
        for whole, part in zip(together[1:], alone[1:], strict=True):
            torch.testing.assert_close(whole[together[0] == number], part)


def test_nobody_is_read_from_cold_maps() -> None:
    pictures, scores, keypoints = read_people(hand_made_maps(), 0.15)
    assert (len(pictures), len(scores), tuple(keypoints.shape)) == (0, 0, (0, 17, 3))
