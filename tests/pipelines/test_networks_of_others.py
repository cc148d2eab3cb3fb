"""Fits of a photo from part and keypoint networks that a user gives."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.example import example_keypoints, example_photo
from helpers.files import EXAMPLE
from PIL import Image

from warp_partdr import metrics
from warp_partdr.body.labels import label_set
from warp_partdr.networks.detection.crops import TurnedCrops
from warp_partdr.networks.detection.people import find_people
from warp_partdr.networks.detection.person import FoundPerson
from warp_partdr.networks.predictors.networks import KeypointNetwork, PartNetwork, upright_crop
from warp_partdr.pipelines.photo import PACKAGED, PhotoFit, fit_photo
from warp_partdr.solve.ellipsoids.options import FitOptions

FAST = FitOptions.at("fast")
CDCL = label_set("cdcl14")
PHOTO = example_photo()
PARTS = np.asarray(Image.open(EXAMPLE / "parts.png"))
SIZE = (256, 256)
MIRRORED = np.array([CDCL.channel_ids.index(i) for i in (0, 1, 2, 4, 3, 6, 5, 8, 7, 10, 9, 12, 11, 14, 13)])


@pytest.fixture(scope="module")
def found() -> FoundPerson:
    return find_people(PHOTO)[0]


def true_parts(crop: TurnedCrops) -> np.ndarray:
    """The example's labels in a person's crop."""
    steps = (np.arange(SIZE[0]) + 0.5) / SIZE[0]
    places = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(1, -1, 2)
    x, y = np.floor(crop.to_picture(places)[0]).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < PARTS.shape[1]) & (y < PARTS.shape[0])
    return np.where(inside, PARTS[y.clip(0, len(PARTS) - 1), x.clip(0, PARTS.shape[1] - 1)], 0).reshape(SIZE)


def part_network(person: FoundPerson, change: Callable[[np.ndarray], np.ndarray] = lambda ids: ids) -> PartNetwork:
    """Network that knows the example, and gives probabilities."""

    def predict(pictures: torch.Tensor) -> torch.Tensor:
        assert pictures.shape == (1, 3, *SIZE)
        ids = change(true_parts(upright_crop(person, SIZE, stretch=1.5)))
        return torch.from_numpy(0.9 * np.eye(15)[ids] + 0.1 / 15).permute(2, 0, 1)[None].float()

    return PartNetwork(CDCL, SIZE, predict, 1.5)


def keypoint_network(person: FoundPerson, shift: float = 0.0) -> KeypointNetwork:
    """Network that knows the example's keypoints, moved by a share of its crop."""
    truth = example_keypoints()

    def predict(pictures: torch.Tensor) -> torch.Tensor:
        places = upright_crop(person, SIZE).from_picture(truth.points[None].astype(float))[0] + shift
        return torch.from_numpy(np.column_stack([places, truth.confidence]))[None]

    return KeypointNetwork(truth.skeleton, SIZE, predict, name="mine")


def error_mm(fit: PhotoFit) -> float:
    joints = json.loads((EXAMPLE / "truth.json").read_text())["joints"]["lsp14"]
    return 1000 * float(metrics.pa_mpjpe(fit.fits[0].landmarks(joints["names"]), np.array(joints["points_m"])))


def part_f1(fit: PhotoFit) -> float:
    drawn = fit.fits[0].draw(PARTS.shape).labels[0].cpu().numpy()
    counts = metrics.confusion(CDCL.part_groups[drawn], CDCL.to_groups(PARTS), CDCL.num_groups + 1)
    return float(metrics.part_f1(counts))


@pytest.fixture(scope="module")
def alone() -> PhotoFit:
    return fit_photo(PHOTO, options=FAST)


@pytest.fixture(scope="module")
def with_parts(found: FoundPerson) -> PhotoFit:
    return fit_photo(PHOTO, options=FAST, parts_from=part_network(found))


def test_parts_bring_the_body_nearer_to_the_truth(alone: PhotoFit, with_parts: PhotoFit) -> None:
    assert part_f1(with_parts) > part_f1(alone) + 0.02
    fit = with_parts.fits[0].ellipbody
    assert fit.observation.label_set is CDCL
    assert fit.observation.maps is not None
    assert fit.warnings == ()


def test_sides_that_the_network_exchanged_are_set_right(found: FoundPerson, with_parts: PhotoFit) -> None:
    swapped = fit_photo(PHOTO, options=FAST, parts_from=part_network(found, lambda ids: MIRRORED[ids]))
    assert swapped.fits[0].ellipbody.warnings == ("labels: left and right exchanged, say the keypoints; taken so",)
    assert part_f1(swapped) == pytest.approx(part_f1(with_parts), abs=0.01)


def test_keypoints_and_parts_of_given_networks_are_taken_together(
    found: FoundPerson, alone: PhotoFit, device: str
) -> None:
    given = {"parts_from": part_network(found), "keypoints_from": keypoint_network(found)}
    both = fit_photo(PHOTO, options=FAST, device=device, **given)  # type: ignore[arg-type]
    assert both.fits[0].ellipbody.warnings == ()
    assert both.sources[0] == {"keypoints": "mine", "parts": "unnamed"}
    truth = example_keypoints()
    kept = both.people[0].keypoints
    assert kept.skeleton == truth.skeleton
    np.testing.assert_allclose(kept.points[truth.visible], truth.points[truth.visible], atol=0.01)
    assert error_mm(both) < error_mm(alone)


def test_given_networks_have_all_threads_and_the_fit_has_one(found: FoundPerson) -> None:
    """Small tensors lose time with several threads, and large networks of others gain it."""
    threads: dict[str, int] = {}
    parts, keypoints = part_network(found), keypoint_network(found)

    def counted(name: str, predict: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[torch.Tensor], torch.Tensor]:
        def ask(pictures: torch.Tensor) -> torch.Tensor:
            threads[name] = torch.get_num_threads()
            return predict(pictures)

        return ask

    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        fit_photo(
            PHOTO,
            options=FAST,
            parts_from=replace(parts, predict=counted("parts", parts.predict)),
            keypoints_from=replace(keypoints, predict=counted("keypoints", keypoints.predict)),
            progress=lambda name, done, total: threads.update({name: torch.get_num_threads()}),
        )
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)
    assert threads.pop("parts") == threads.pop("keypoints") == 3
    assert set(threads.values()) == {1}


def test_what_sees_nothing_is_told_and_left_out(found: FoundPerson, alone: PhotoFit) -> None:
    blind = part_network(found, np.zeros_like)
    beside = keypoint_network(found, 5.0)
    fit = fit_photo(PHOTO, options=FAST, parts_from=blind, keypoints_from=beside)
    assert fit.fits[0].ellipbody.warnings == (
        "keypoints: the given network found none on this person; those of the packaged network are used",
        "labels: the given network found none along the bones; the mask is used",
    )
    assert fit.sources[0] == {"keypoints": PACKAGED, "parts": PACKAGED}
    np.testing.assert_array_equal(fit.fits[0].vertices, alone.fits[0].vertices)
    elsewhere = replace(blind, predict=lambda pictures: corner(pictures.shape[0]))
    fit = fit_photo(PHOTO, options=FAST, parts_from=elsewhere)
    assert fit.fits[0].ellipbody.warnings == ("labels: the given network found none along the bones; the mask is used",)


def corner(count: int) -> torch.Tensor:
    """Ids of a head in a corner, where nobody is."""
    ids = torch.zeros(count, *SIZE, dtype=torch.long)
    ids[:, :4, :4] = 1
    return ids


def test_networks_of_another_type_are_refused(found: FoundPerson) -> None:
    network = part_network(found)
    with pytest.raises(TypeError, match="parts_from: str; expected PartNetwork, of load_part_network, 'packaged'"):
        fit_photo(PHOTO, parts_from="net")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="keypoints_from: PartNetwork; expected KeypointNetwork or None"):
        fit_photo(PHOTO, keypoints_from=network)  # type: ignore[arg-type]
