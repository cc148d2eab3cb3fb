"""Networks at work on people in a picture: crops, labels and keypoints, and what networks may not give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr.body.labels import IGNORE, label_set
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.networks.detection.crops import Pyramid, TurnedCrops, cut_crops
from warp_partdr.networks.detection.masks import instance_map
from warp_partdr.networks.detection.person import FoundPerson
from warp_partdr.networks.predictors.keypoints import find_keypoints
from warp_partdr.networks.predictors.networks import KeypointNetwork, PartNetwork, Predict, upright_crop
from warp_partdr.networks.predictors.parts import PeopleParts

SIZE = (120, 200)
LSP6 = label_set("lsp6")


def person(x: float, y: float, height: float, angle: float = 0.0) -> FoundPerson:
    """Somebody about a place, 0.4 of the height wide, turned."""
    mask = torch.zeros(256, 256)
    mask[28:228, 88:168] = 1.0  # 200 x 80 of 256 x 256
    crop = TurnedCrops(
        np.array([[x, y]]), np.array([height * 256 / 200]), np.array([angle]), np.zeros(1, dtype=np.int64)
    )
    points = np.full((33, 2), (x, y), dtype=np.float32)
    points[0, 1] -= 1
    keypoints = Keypoints2D("blazepose33", points, np.ones(33, dtype=np.float32))
    return FoundPerson(keypoints, 0.9, (0.0, 0.0, 1.0, 1.0), crop, mask, crop)


def by_colour(pictures: torch.Tensor) -> torch.Tensor:
    """Ids by brightness, in steps of 40; a mean of two is somebody's mistake."""
    return (pictures.mean(1) * 255 / 40).round().long()


def as_probabilities(pictures: torch.Tensor) -> torch.Tensor:
    return 0.51 * torch.nn.functional.one_hot(by_colour(pictures), 7).permute(0, 3, 1, 2).float() + 0.07


def picture_of(ids: np.ndarray) -> np.ndarray:
    return np.repeat((40 * ids)[..., None], 3, axis=2).astype(np.uint8)


def parts_of(picture: np.ndarray, people: list[FoundPerson], network: PartNetwork) -> PeopleParts:
    return PeopleParts(network, Pyramid(picture, "cpu"), people, instance_map(people, picture.shape[:2]), len(people))


@pytest.mark.parametrize("angle", [0.0, 0.4, np.pi / 2])
@pytest.mark.parametrize(("size", "stretch"), [((64, 64), 1.0), ((64, 64), 1.5), ((128, 96), 1.0), ((60, 90), 1.2)])
def test_crops_hold_the_whole_person(size: tuple[int, int], stretch: float, angle: float) -> None:
    one = person(100, 60, 80, angle)
    crop = upright_crop(one, size, stretch=stretch)
    corners = one.crop.to_picture(np.array([[[88, 28], [168, 28], [88, 228], [168, 228]]]) / 256)
    places = crop.from_picture(corners)[0]
    assert ((places > 0.05) & (places < 0.95)).all()
    assert places.min() == pytest.approx(0.1, abs=0.01)  # a margin of 1.25 in one direction at least
    shape = crop.aspect / (size[1] / size[0])
    assert 1 / stretch - 1e-6 <= shape <= stretch + 1e-6
    assert shape == pytest.approx(max(1 / stretch, 0.4 / (size[1] / size[0])), rel=0.01)


@pytest.mark.parametrize("angle", [0.0, 0.5])
@pytest.mark.parametrize("stretch", [1.0, 1.5])
@pytest.mark.parametrize("size", [(192, 144), (160, 160)])
def test_labels_come_back_to_their_places(size: tuple[int, int], stretch: float, angle: float) -> None:
    ids = np.zeros(SIZE, dtype=np.uint8)
    ids[30:60, 90:100], ids[30:60, 100:112], ids[60:90, 92:108] = 1, 2, 3
    one = person(100, 60, 80, angle)
    soft = parts_of(picture_of(ids), [one], PartNetwork(LSP6, size, as_probabilities, stretch)).of(0)
    hard = parts_of(picture_of(ids), [one], PartNetwork(LSP6, size, by_colour, stretch)).of(0)
    assert soft is not None
    assert hard is not None
    for found in (soft, hard):
        assert (found.groups != ids).mean() < 0.01  # at edges, which are between two colours
        assert found.groups[75, 100] == 3
    assert hard.maps is None
    assert soft.maps is not None
    assert soft.maps.shape == (7, *SIZE)
    assert soft.maps[3, 75, 100] == pytest.approx(0.58, abs=1e-3)
    np.testing.assert_allclose(soft.maps.sum(0), 1.0, atol=1e-3)
    assert soft.maps[0, 0, 0] == 1.0  # beyond the crop


def test_maps_smaller_than_the_picture_are_enlarged() -> None:
    ids = np.zeros(SIZE, dtype=np.uint8)
    ids[30:90, 84:116] = 3

    def small(pictures: torch.Tensor) -> torch.Tensor:
        return torch.nn.functional.avg_pool2d(as_probabilities(pictures), 4)

    found = parts_of(picture_of(ids), [person(100, 60, 80)], PartNetwork(LSP6, (128, 96), small)).of(0)
    assert found is not None
    assert (found.groups != ids).mean() < 0.02


def test_others_pixels_are_ignored() -> None:
    """Pixels of the other's mask are ignored, and those beside the masks where the other's is stronger."""
    ids = np.zeros(SIZE, dtype=np.uint8)
    ids[20:100, 84:116], ids[20:100, 116:150] = 3, 6
    one, other = person(100, 60, 80), person(134, 60, 80)
    weak = other.mask.clone()
    weak[28:228, 78:88] = 0.1  # its edge, beyond the half
    people = [one, replace(other, mask=weak)]
    first, second = (parts_of(picture_of(ids), people, PartNetwork(LSP6, (96, 96), by_colour)).of(k) for k in (0, 1))
    assert first is not None
    assert second is not None
    assert first.groups[60, 100] == 3
    assert first.groups[60, 130] == IGNORE
    assert first.groups[60, 117] == IGNORE  # in nobody's mask, weakly in the other's
    assert second.groups[60, 117] == 6
    assert second.groups[60, 100] == IGNORE
    soft = parts_of(picture_of(ids), people, PartNetwork(LSP6, (96, 96), as_probabilities)).of(0)
    assert soft is not None
    assert soft.maps is not None
    assert soft.maps[:, 60, 130].sum() == 0.0


def test_ignored_classes_are_in_no_map() -> None:
    atr = label_set("atr18")
    said = torch.zeros(1, 18, 8, 8)
    said[:, 4], said[:, 14] = 0.8, 0.2  # upper clothes; left arm

    found = parts_of(np.zeros((*SIZE, 3), np.uint8), [person(100, 60, 80)], PartNetwork(atr, (64, 64), lambda _: said))
    assert found.of(0) is None  # nothing but clothes
    said[:, :, 3:5, 3:5] = 0.0
    said[:, 14, 3:5, 3:5] = 1.0
    parts = found.of(0)
    assert parts is not None
    assert parts.groups[60, 100] == 1 + atr.group_names.index("left_arm")
    assert parts.groups[40, 100] == IGNORE


def test_haze_over_all_classes_is_taken_as_none() -> None:
    said = torch.full((1, 7, 8, 8), 0.02)
    said[:, 3] = 0.88
    said[:, 3, :4], said[:, 2, :4] = 0.7, 0.2
    found = parts_of(np.zeros((*SIZE, 3), np.uint8), [person(100, 60, 80)], PartNetwork(LSP6, (64, 64), lambda _: said))
    parts = found.of(0)
    assert parts is not None
    assert parts.maps is not None
    np.testing.assert_allclose(parts.maps[:, 85, 100], [0, 0, 0, 1, 0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(parts.maps[:, 35, 100], [0, 0, 2 / 9, 7 / 9, 0, 0, 0], atol=1e-6)


@pytest.mark.parametrize(("count", "kept"), [(1, True), (2**27, False)])
def test_maps_of_too_many_people_are_kept_as_labels(count: int, kept: bool) -> None:
    picture, one = picture_of(np.full(SIZE, 3, dtype=np.uint8)), person(100, 60, 80)
    network = PartNetwork(LSP6, (64, 64), as_probabilities)
    found = PeopleParts(network, Pyramid(picture, "cpu"), [one], instance_map([one], SIZE), count).of(0)
    assert found is not None
    assert (found.maps is not None) == kept


@pytest.mark.parametrize(
    ("said", "message"),
    [
        (torch.zeros(1, 6, 8, 8), r"parts_from: \(1, 6, 8, 8\); expected probabilities \(N, 7, h, w\)"),
        (torch.zeros(7, 8, 8), r"parts_from: \(7, 8, 8\)"),
        (np.zeros((1, 7, 8, 8)), "parts_from: ndarray"),
        (torch.zeros(1, 7, 8, 8), "sums of 0 to 0; expected probabilities"),
        (torch.full((1, 7, 8, 8), torch.nan), "parts_from: values from nan"),
        (torch.full((1, 8, 8), 9), "parts_from: labels: ids 9 not in lsp6"),
    ],
)
def test_part_networks_with_wrong_outputs_are_refused(said: torch.Tensor, message: str) -> None:
    people = parts_of(
        np.zeros((*SIZE, 3), np.uint8), [person(100, 60, 80)], PartNetwork(LSP6, (64, 64), lambda _: said)
    )
    with pytest.raises(InputError, match=message):
        people.of(0)


def test_networks_are_checked() -> None:
    with pytest.raises(TypeError, match="labels: str; expected LabelSet"):
        PartNetwork("lsp6", (64, 64), by_colour)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"stretch: 0\.5"):
        PartNetwork(LSP6, (64, 64), by_colour, 0.5)
    with pytest.raises(ValueError, match="0"):
        PartNetwork(LSP6, (64, 0), by_colour)
    with pytest.raises(InputError, match="skeleton: 'coco'"):
        KeypointNetwork("coco", (64, 64), by_colour)


def keypoints_at(*rows: tuple[float, float, float], count: int = 17) -> Predict:
    values = torch.zeros(1, count, 3)
    values[0, : len(rows)] = torch.tensor(rows).reshape(-1, 3)
    return lambda _: values


@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_keypoints_come_back_to_their_places(angle: float) -> None:
    one, picture = person(100, 60, 80, angle), Pyramid(np.zeros((*SIZE, 3), np.uint8), "cpu")
    network = KeypointNetwork("coco17", (128, 96), keypoints_at((0.5, 0.5, 0.9), (0.5, 0.9, 1.2), (0.1, 0.1, 0.0)))
    found = find_keypoints(network, picture, one)
    assert found is not None
    middle = upright_crop(one, (128, 96)).to_picture(np.array([[[0.5, 0.5]]]))[0, 0]
    np.testing.assert_allclose(found.points[0], middle, atol=1e-3)
    below = found.points[1] - found.points[0]
    np.testing.assert_allclose(below, 40 * np.array([-np.sin(angle), np.cos(angle)]), atol=0.5)  # 0.4 of 1.25 x 80
    np.testing.assert_allclose(found.confidence[:4], [0.9, 1.0, 0.0, 0.0])
    assert (found.points[2:] == 0).all()


def test_keypoints_of_a_larger_file_are_its_landmarks() -> None:
    values = torch.rand(1, 133, 3)
    network = KeypointNetwork("wholebody133", (128, 96), lambda _: values)
    found = find_keypoints(network, Pyramid(np.zeros((*SIZE, 3), np.uint8), "cpu"), person(100, 60, 80))
    assert found is not None
    assert found.points.shape == (len(found.format), 2)
    np.testing.assert_allclose(found.confidence, values[0, list(found.format.places), 2], atol=1e-6)


def test_fewer_than_two_distinct_keypoints_count_as_none() -> None:
    picture = Pyramid(np.zeros((*SIZE, 3), np.uint8), "cpu")
    middle = (0.5, 0.5, 0.9)
    for rows in ((), (middle,), (middle, middle), ((torch.nan, 0.5, 1.0),) * 2):
        network = KeypointNetwork("coco17", (64, 48), keypoints_at(*rows))
        assert find_keypoints(network, picture, person(9, 9, 9)) is None
    with pytest.raises(InputError, match=r"keypoints_from: \(1, 16, 3\); expected x, y, confidence \(N, 17, 3\)"):
        find_keypoints(KeypointNetwork("coco17", (64, 48), keypoints_at(count=16)), picture, person(9, 9, 9))


def test_crops_of_any_shape_are_cut_as_they_are_placed() -> None:
    picture = np.zeros((*SIZE, 3), dtype=np.uint8)
    picture[:, 100:] = 255
    crop = TurnedCrops(np.array([[100.0, 60.0]]), np.array([40.0]), np.zeros(1), np.zeros(1, dtype=np.int64), 1.5)
    cut = cut_crops([Pyramid(picture, "cpu")], crop, (20, 30))
    assert cut.shape == (1, 3, 20, 30)
    assert cut[..., :14].max() == 0
    assert cut[..., 16:].min() == 1
    ends = crop.to_picture(np.array([[[0.0, 0.0], [1.0, 1.0]]]))[0]
    np.testing.assert_allclose(ends, [[70, 40], [130, 80]])
    np.testing.assert_allclose(crop.from_picture(ends[None])[0], [[0, 0], [1, 1]], atol=1e-12)
