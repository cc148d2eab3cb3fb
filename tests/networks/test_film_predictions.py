"""Networks of others on a film's people: as on photos of its frames, a few people at a time."""

from __future__ import annotations

import gc
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from helpers.example import example_photo
from helpers.films import write_film

from warp_partdr.body.labels import BACKGROUND, IGNORE, label_set
from warp_partdr.errors import InputError
from warp_partdr.inputs.calibrated_camera import CalibratedCamera
from warp_partdr.inputs.films import read_frames
from warp_partdr.inputs.person import crop_nearest
from warp_partdr.networks.detection.crops import Pyramid
from warp_partdr.networks.detection.film_people import kept_size
from warp_partdr.networks.detection.masks import instance_map
from warp_partdr.networks.detection.people import find_people
from warp_partdr.networks.predictors.film_predictions import FilmPredictions, GivenNetworks, find_film_predictions
from warp_partdr.networks.predictors.keypoints import find_keypoints
from warp_partdr.networks.predictors.networks import KeypointNetwork, PartNetwork
from warp_partdr.networks.predictors.parts import PeopleParts
from warp_partdr.pipelines.film_pieces import FilmPieces
from warp_partdr.pipelines.observed_film import ObservedFilm

COUNT = 11  # frames
LSP6 = label_set("lsp6")
SIZE = (64, 48)


def pyramids() -> int:
    """Pictures of frames that are in memory."""
    return sum(type(each) is Pyramid for each in gc.get_objects())


class Networks:
    """Networks whose answers depend on each picture alone, and that remember how many they were asked about."""

    def __init__(self) -> None:
        self.batches: list[int] = []
        self.before = pyramids()  # of other tests
        self.pyramids = 0
        self.given = GivenNetworks(
            PartNetwork(LSP6, SIZE, self.parts, 1.5, name="parts"),
            KeypointNetwork("coco17", SIZE, self.keypoints, name="keypoints"),
        )

    def parts(self, pictures: torch.Tensor) -> torch.Tensor:
        """Bright and dark halves of people are two groups, black is background."""
        grey = pictures.mean(1)
        return torch.where(grey < 0.02, 0, torch.where(grey < 0.5, 3, 2))

    def keypoints(self, pictures: torch.Tensor) -> torch.Tensor:
        """Down the middle of a crop, as far to the right as it is bright."""
        self.batches.append(len(pictures))
        self.pyramids = max(self.pyramids, pyramids() - self.before)
        found = torch.full((len(pictures), 17, 3), 0.9)
        found[..., 0] = pictures.mean((1, 2, 3))[:, None]
        found[..., 1] = torch.linspace(0.1, 0.9, 17)
        return found


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example's person, who moves to the right."""
    photo = example_photo()[::2, ::2]
    height, width = (side - side % 2 for side in photo.shape[:2])
    wide = np.pad(photo, [(0, 0), (4 * COUNT, 4 * COUNT), (0, 0)], mode="edge")
    starts = [4 * COUNT - 4 * place for place in range(COUNT)]
    pictures = [np.ascontiguousarray(wide[:height, start : start + width]) for start in starts]
    return write_film(tmp_path_factory.mktemp("film") / "walk.mp4", pictures, rate=30)


@pytest.fixture(scope="module")
def found(film: Path) -> tuple[Networks, Any, FilmPredictions]:
    networks = Networks()
    return networks, *find_film_predictions(film, networks.given)


def test_people_wait_for_one_another_but_pictures_do_not(found: tuple[Networks, Any, FilmPredictions]) -> None:
    networks, people, predictions = found
    assert len(people.rows) == len(predictions.frames) == COUNT
    assert networks.batches == [8, COUNT - 8]
    assert networks.pyramids <= 3  # of the frame at hand, and those made ahead
    assert predictions.warnings == []


@pytest.mark.parametrize(("index", "pixels", "share"), [(0, 0.01, 0.01), (COUNT - 1, 3.0, 0.05)])
def test_predictions_for_a_frame_are_those_for_a_photo(
    found: tuple[Networks, Any, FilmPredictions], film: Path, index: int, pixels: float, share: float
) -> None:
    """Nearly so in the last frame, of the second batch: its person was followed, and moves by 4 px a frame."""
    networks, _, predictions = found
    first = next(islice(read_frames(film), index, None)).picture
    person, picture = find_people(first, levels=2)[0], Pyramid(first, "cpu")
    keypoints = networks.given.keypoints_from
    assert keypoints is not None
    alone = find_keypoints(keypoints, picture, person)
    seen = predictions.keypoints_of(index, 0)
    assert alone is not None
    assert seen is not None
    assert seen.skeleton == "coco17"
    np.testing.assert_allclose(seen.points, alone.points, atol=pixels)
    parts = networks.given.parts_from
    assert parts is not None
    size = first.shape[:2]
    whole = PeopleParts(parts, picture, [person], instance_map([person], size), 1).of(0)
    small = predictions.parts_of(index, 0)
    assert whole is not None
    assert small is not None
    assert small.label_set is LSP6
    assert small.groups.shape == kept_size(size)
    expected = crop_nearest(whole.groups, (0.0, 0.0, size[1], size[0]), kept_size(size), fill=0)
    assert (small.groups != expected).mean() < share
    assert set(np.unique(small.groups)) == {BACKGROUND, 2, 3}


def test_a_scene_takes_the_predictions_of_the_given_networks(found: tuple[Networks, Any, FilmPredictions]) -> None:
    _, people, predictions = found
    zoom = kept_size(people.image_size)[1] / people.image_size[1]
    rows = people.rows[3:4]
    (observation,) = ObservedFilm.of(people, given=predictions).observations(rows, 2, 1)
    assert (observation.person, observation.frame, observation.view) == (2, 3, 1)
    assert observation.keypoints.skeleton == "coco17"
    np.testing.assert_allclose(observation.keypoints.points, predictions.keypoints[3, :, :2] * zoom, rtol=1e-5)
    assert observation.parts is not None
    assert observation.parts.label_set is LSP6
    (plain,) = ObservedFilm.of(people).observations(rows, 0, 0)
    assert plain.keypoints.skeleton == "blazepose33"
    # One network alone leaves the rest to the packaged one.
    only = FilmPredictions(
        GivenNetworks(keypoints_from=predictions.networks.keypoints_from),
        predictions.frames,
        predictions.places,
        predictions.keypoints,
        predictions.size,
        (b"",) * COUNT,
    )
    (half,) = ObservedFilm.of(people, given=only).observations(rows, 0, 0)
    assert half.keypoints.skeleton == "coco17"
    assert half.parts is not None
    assert plain.parts is not None
    np.testing.assert_array_equal(half.parts.groups, plain.parts.groups)


def test_networks_that_see_nothing_leave_the_packaged_keypoints(film: Path) -> None:
    blind = GivenNetworks(
        PartNetwork(LSP6, SIZE, lambda pictures: torch.zeros(len(pictures), 8, 8, dtype=torch.long)),
        KeypointNetwork("coco17", SIZE, lambda pictures: torch.zeros(len(pictures), 17, 3)),
    )
    people, predictions = find_film_predictions(film, blind)
    assert predictions.warnings == [
        f"the given network found no keypoints in {COUNT} of {COUNT} observations; those of the packaged network are "
        "used",
        f"the given network found no labels in {COUNT} of {COUNT} observations; only the keypoints are used",
    ]
    (observation,) = ObservedFilm.of(people, given=predictions).observations(people.rows[:1], 0, 0)
    assert observation.keypoints.skeleton == "blazepose33"
    assert observation.parts is None


def test_a_lens_s_distortion_is_taken_away(found: tuple[Networks, Any, FilmPredictions]) -> None:
    _, people, predictions = found
    height, width = people.image_size
    lens = CalibratedCamera((400.0, 400.0), (width / 2, height / 2), (-0.2,))
    seen = ObservedFilm.calibrated(people, lens, given=predictions).given
    assert seen is not None
    expected = lens.undistort_points(predictions.keypoints[..., :2])
    np.testing.assert_allclose(seen.keypoints[..., :2], expected, atol=0.01)
    assert np.abs(expected - predictions.keypoints[..., :2]).max() > 1
    labels, before = seen.parts_of(0, 0), predictions.parts_of(0, 0)
    assert labels is not None
    assert before is not None
    assert set(np.unique(labels.groups)) <= {BACKGROUND, 2, 3, IGNORE}
    assert (labels.groups != before.groups).any()


def test_a_run_that_was_ended_asks_nobody_again(found: tuple[Networks, Any, FilmPredictions], tmp_path: Path) -> None:
    networks, people, predictions = found
    (tmp_path / "walk.mp4").write_bytes(b"film")
    pieces = FilmPieces(tmp_path / "out", [tmp_path / "walk.mp4"], "names")
    pieces.predictions(0, networks.given, lambda: (people, predictions))
    again, kept = pieces.predictions(0, networks.given, lambda: pytest.fail("they are known"))
    np.testing.assert_array_equal(again.rows, people.rows)
    assert kept.packed == predictions.packed
    assert (kept.size, kept.networks) == (predictions.size, networks.given)
    np.testing.assert_array_equal(kept.keypoints, predictions.keypoints)


def test_arguments_and_networks_at_fault_are_named(film: Path) -> None:
    with pytest.raises(TypeError, match="parts_from: str; expected PartNetwork or None"):
        GivenNetworks("net")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="networks: NoneType; expected GivenNetworks"):
        find_film_predictions(film, None)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"keypoints_from: \(8, 16, 3\); expected x, y, confidence"):
        find_film_predictions(
            film,
            GivenNetworks(
                keypoints_from=KeypointNetwork("coco17", SIZE, lambda pictures: torch.zeros(len(pictures), 16, 3))
            ),
        )
