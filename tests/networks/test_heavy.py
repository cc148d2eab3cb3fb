"""The larger landmark network: keypoints of people whom the smaller one finds, on CPU and CUDA."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints, example_photo
from safetensors.numpy import save_file

from warp_partdr import skeleton
from warp_partdr.bulk.people import stages_of_quality
from warp_partdr.errors import InputError
from warp_partdr.inputs.keypoints import Keypoints2D, person_height
from warp_partdr.networks.detection.asset import load_heavy_landmarks, load_people_networks, packaged_people_networks
from warp_partdr.networks.detection.crops import Pyramid, TurnedCrops
from warp_partdr.networks.detection.graph import OperatorGraph
from warp_partdr.networks.detection.heavy import see_landmarks, with_heavy_landmarks
from warp_partdr.networks.detection.look import NUM_LANDMARKS
from warp_partdr.networks.detection.people import find_people, find_people_in
from warp_partdr.networks.detection.person import FoundPerson
from warp_partdr.networks.detection.tracks import PeopleTracker
from warp_partdr.pipelines.photo import person_in_photo
from warp_partdr.solve.ellipsoids.options import FitOptions
from warp_partdr.solve.ellipsoids.settings import change_options
from warp_partdr.solve.scene.options import SceneOptions

MIRROR = skeleton("blazepose33").mirror


@cache
def example_person(device: str, landmarks: str) -> FoundPerson:
    (person,) = find_people(example_photo(), device=device, landmarks=landmarks)  # type: ignore[arg-type]
    return person


def error(found: Keypoints2D) -> float:
    """Mean distance from the annotated keypoints [% of the person's height]."""
    truth = example_keypoints()
    places = [found.format.landmarks.index(name) for name in truth.format.landmarks]
    return 100 * float(np.linalg.norm(found.points[places] - truth.points, axis=1).mean()) / person_height(truth)


class Drawn(OperatorGraph):
    """Network that is sure of these places in any picture, 0 to 1 (39, 2)."""

    def __init__(self, places: np.ndarray) -> None:
        super().__init__(256, 0, {}, (), {})
        self.places = torch.from_numpy(places)

    def forward(self, pictures: torch.Tensor) -> dict[str, torch.Tensor]:
        landmarks = torch.full((len(pictures), 39, 5), 9.0)
        landmarks[..., :2] = 256 * self.places
        return {"landmarks": landmarks.flatten(1), "heat": torch.full((len(pictures), 39, 64, 64), -9.0)}


def test_the_same_person_is_found_with_other_keypoints(device: str) -> None:
    full, heavy = (example_person(device, name) for name in ("full", "heavy"))
    assert (heavy.score, heavy.box) == (full.score, full.box)
    torch.testing.assert_close(heavy.mask, full.mask)
    np.testing.assert_array_equal(heavy.crop.centres, full.crop.centres)
    moved = np.linalg.norm(heavy.keypoints.points - full.keypoints.points, axis=1) / person_height(full.keypoints)
    assert 0.001 < moved.mean() < 0.03
    assert not np.array_equal(heavy.next_crop.centres, full.next_crop.centres)
    assert heavy.keypoints.confidence.mean() > 0.9
    assert error(heavy.keypoints) < error(full.keypoints) + 0.2
    assert error(heavy.keypoints) < 3


def test_a_mirrored_picture_shows_the_mirrored_person() -> None:
    """Exactly, up to rounding: the mean of a picture and its mirror image is that of the mirror image."""
    network, picture = load_heavy_landmarks(), example_photo()
    height, width = picture.shape[:2]
    crop = TurnedCrops(np.array([[width / 2, height / 2]]), np.array([1.1 * height]), np.zeros(1), np.zeros(1, int))
    pyramids = [[Pyramid(np.ascontiguousarray(each), "cpu")] for each in (picture, picture[:, ::-1])]
    seen, turned = (see_landmarks(network, each, crop)[0] for each in pyramids)
    expected = turned[[*MIRROR, NUM_LANDMARKS, NUM_LANDMARKS + 1]]
    np.testing.assert_allclose(seen[:, 0], 1 - expected[:, 0], atol=1e-3)
    np.testing.assert_allclose(seen[:, 1:], expected[:, 1:], atol=2e-2)
    one, other = (see_landmarks(network, each, crop, mirror=False)[0] for each in pyramids)
    assert np.abs(one[:33, 0] - 1 + other[MIRROR, 0]).max() > 2e-3
    mean = (one[:33, :2] + [1, 0] + other[MIRROR, :2] * [-1, 1]) / 2
    np.testing.assert_allclose(seen[:33, :2], mean, atol=1e-3)


def test_people_of_several_pictures_keep_their_own() -> None:
    moved = np.pad(example_photo(), ((0, 0), (130, 0), (0, 0)))
    found = find_people_in([moved, np.zeros((100, 200, 3), np.uint8), example_photo()], landmarks="heavy")
    assert [len(people) for people in found] == [1, 0, 1]
    expected = example_person("cpu", "heavy").keypoints
    np.testing.assert_allclose(found[2][0].keypoints.points, expected.points, atol=0.5)
    np.testing.assert_allclose(found[0][0].keypoints.points - [130, 0], expected.points, atol=4)
    pyramids = [Pyramid(np.zeros_like(example_photo()), "cpu"), Pyramid(example_photo(), "cpu")]
    network = packaged_people_networks("cpu", landmarks="heavy").heavy
    assert network is not None
    _, (again,) = with_heavy_landmarks(network, pyramids, [[], [example_person("cpu", "full")]])
    np.testing.assert_allclose(again.keypoints.points, expected.points, atol=1e-2)


def test_a_person_keeps_their_keypoints_when_the_network_shows_another() -> None:
    """One crop holds two people, and the network shows the second: the first one's keypoints stay."""
    second = example_person("cpu", "full")
    first = replace(second, keypoints=replace(second.keypoints, points=second.keypoints.points + np.float32(200)))
    places = np.full((39, 2), 0.5)
    places[:NUM_LANDMARKS] = second.crop.from_picture(second.keypoints.points[None].astype(float))[0]
    places[NUM_LANDMARKS + 1] = 0.5, 0.1
    symmetric = places.copy()  # as the mirror image would show them
    symmetric[:NUM_LANDMARKS] = (places[:NUM_LANDMARKS] + [1, 0] + places[MIRROR] * [-1, 1]) / 2
    pyramid = Pyramid(example_photo(), "cpu")
    ((one, other),) = with_heavy_landmarks(Drawn(symmetric), [pyramid], [[first, second]])
    assert one is first
    assert other is not second
    np.testing.assert_allclose(
        other.keypoints.points, second.crop.to_picture(symmetric[None, :NUM_LANDMARKS])[0], atol=0.01
    )
    assert with_heavy_landmarks(Drawn(places), [pyramid], [[]]) == [[]]


def test_landmarks_in_float16_are_nearly_the_same(device: str) -> None:
    """They are within half a pixel of 256 on average, and as sure."""
    networks = packaged_people_networks(device, landmarks="heavy")
    halved = packaged_people_networks(device, half=True, landmarks="heavy")
    assert networks.heavy is not None
    assert halved.heavy is not None
    assert networks.halved().heavy is not None
    assert packaged_people_networks(device).heavy is None
    crop, pyramids = example_person(device, "full").crop, [Pyramid(example_photo(), device)]
    expected, found = (see_landmarks(each.heavy, pyramids, crop)[0] for each in (networks, halved))
    assert 256 * np.linalg.norm(expected[:, :2] - found[:, :2], axis=1).mean() < 0.5
    assert np.abs(expected[:, 3:] - found[:, 3:]).mean() < 0.02


def test_weights_of_8_bits_are_multiples_of_their_channel_s_scale(tmp_path: Path) -> None:
    node = {"kind": "convolution", "inputs": [0], "output": 1, "activation": "none"}
    graph = {"size": 4, "input": 0, "outputs": {"landmarks": 1}, "nodes": [node]}
    tensors = {
        "heavy/1.weight.int8": np.array([[1, -127], [50, 2], [0, 3]], np.int8)[:, :, None, None],
        "heavy/1.weight.scale": np.array([0.5, 0.25, 2.0], np.float32),
        "heavy/1.bias": np.array([1, 2, 3], np.float16),
    }
    path = tmp_path / "network.safetensors"
    save_file(tensors, path, {"format": "warp-partdr people detector 1", "graphs": json.dumps({"heavy": graph})})
    said = load_heavy_landmarks(path)(torch.tensor([1.0, 2.0])[None, :, None, None])["landmarks"]
    assert said.flatten().tolist() == [1 + 0.5 - 127, 2 + 12.5 + 1, 3 + 12]
    with pytest.raises(InputError, match=r"network\.safetensors: "):
        load_people_networks(path)


def test_fits_take_the_network_and_fast_ones_and_data_sets_do_without() -> None:
    assert [FitOptions.at(name).landmarks for name in ("fast", "balanced", "accurate")] == ["full", "heavy", "heavy"]  # type: ignore[arg-type]
    assert {stages_of_quality(name).landmarks for name in ("network", "fast", "mesh")} == {"full"}  # type: ignore[arg-type]
    assert SceneOptions.film().landmarks == "heavy"
    assert change_options(FitOptions.at("fast"), {"landmarks": "heavy"}).landmarks == "heavy"


def test_photos_and_films_take_the_network_that_is_asked_for() -> None:
    heavy = example_person("cpu", "heavy").keypoints.points
    np.testing.assert_allclose(person_in_photo(example_photo()).keypoints.points, heavy, atol=1e-3)
    full = example_person("cpu", "full").keypoints.points
    np.testing.assert_allclose(person_in_photo(example_photo(), landmarks="full").keypoints.points, full, atol=1e-3)
    tracker = PeopleTracker(landmarks="heavy")
    np.testing.assert_allclose(tracker.find(example_photo())[0].keypoints.points, heavy, atol=0.01)


def test_other_names_are_refused() -> None:
    with pytest.raises(ValueError, match="landmarks: 'lite'; expected full or heavy"):
        find_people(example_photo(), landmarks="lite")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="landmarks: 'lite'"):
        FitOptions(landmarks="lite")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="landmarks: 'lite'"):
        SceneOptions(landmarks="lite")  # type: ignore[arg-type]
