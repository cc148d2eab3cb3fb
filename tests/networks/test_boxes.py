"""Boxes of people by detectors of others: read from checkpoints, and used instead of the packaged detector's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from helpers.checkpoints import knowing_vitpose, tiny_detector, tiny_segformer
from helpers.example import example_photo

from warp_partdr.errors import InputError
from warp_partdr.networks.detection.crops import Pyramid
from warp_partdr.networks.detection.given_boxes import BoxNetwork, find_boxes, find_people_in_boxes
from warp_partdr.networks.detection.people import find_people
from warp_partdr.networks.predictors.film_predictions import GivenNetworks
from warp_partdr.networks.predictors.networks import KeypointNetwork, upright_crop
from warp_partdr.pipelines.photo import PACKAGED, fit_photo
from warp_partdr.solve.ellipsoids.options import FitOptions

PHOTO = example_photo()
CLASSES = {0: "dog", 1: "Person", 2: "car"}
EVERYTHING = 0.0


def saying(*rows: Sequence[float]) -> BoxNetwork:
    """Network that says these boxes [px] of any picture of the size of ``PHOTO``."""
    sides = torch.tensor([PHOTO.shape[1], PHOTO.shape[0]] * 2 + [1])
    return BoxNetwork((64, 48), lambda _: torch.tensor(rows).reshape(-1, 5) / sides, name="given")


def box_of_example() -> tuple[float, ...]:
    return tuple(find_people(PHOTO)[0].box)


@pytest.mark.parametrize("kind", ["rt_detr", "rt_detr_v2", "detr", "conditional_detr", "yolos"])
def test_detectors_say_what_their_library_does(kind: str, tmp_path: Path) -> None:
    transformers = pytest.importorskip("transformers", reason="needs the extra photo")
    from warp_partdr.networks.predictors.checkpoints import load_box_network

    folder = tiny_detector(kind, tmp_path / kind, CLASSES)
    told: list[str] = []
    network = load_box_network(str(folder), say=told.append)
    assert told == [f"boxes from {network.about}"]
    seen: list[torch.Tensor] = []
    spied = replace(network, predict=lambda picture: (seen.append(picture), network.predict(picture))[1])
    photo = PHOTO[:240, :320]
    boxes, scores = find_boxes(spied, Pyramid(photo, "cpu"), EVERYTHING)
    assert seen[0].shape[-2:] == ((64, 64) if kind.startswith("rt") else (48, 64))
    assert len(boxes) > 0
    model = transformers.AutoModelForObjectDetection.from_pretrained(folder).eval()
    mean, deviation = (torch.tensor(values)[:, None, None] for values in ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]))
    with torch.no_grad():
        said = model(pixel_values=(seen[0] - mean) / deviation)
    if kind in ("detr", "yolos"):  # their softmax has a class of nothing
        sure = said.logits[0].softmax(-1)[:, 1]
    else:
        sure = said.logits[0].sigmoid()[:, 1]
    x, y, width, height = said.pred_boxes[0].unbind(-1)
    edges = torch.stack([x - width / 2, y - height / 2, x + width / 2, y + height / 2], -1).clamp(0, 1)
    wanted = edges * torch.tensor([320, 240, 320, 240])
    for box, score in zip(boxes, scores, strict=True):
        row = int((sure - score).abs().argmin())
        assert score == pytest.approx(float(sure[row]), abs=1e-6)
        np.testing.assert_allclose(box, wanted[row], atol=1e-3)


def test_checkpoints_that_are_no_detector_of_people_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("transformers", reason="needs the extra photo")
    from warp_partdr.networks.predictors.checkpoints import load_box_network, load_keypoint_network

    with pytest.raises(InputError, match=r"a segformer; expected a network of object detection"):
        load_box_network(str(tiny_segformer(tmp_path / "seg", {0: "person"})))
    with pytest.raises(InputError, match=r"0 of its classes 'dog, cat', ... are 'person'; expected one"):
        load_box_network(str(tiny_detector("yolos", tmp_path / "animals", {0: "dog", 1: "cat"})))
    detector = tiny_detector("yolos", tmp_path / "yolos", CLASSES)
    pose = knowing_vitpose(tmp_path / "pose+", [(5, 5)] * 17)
    both = load_keypoint_network(f"{pose}+{detector}")
    assert both.boxes is not None
    assert (both.name, both.boxes.name) == (str(pose), str(detector))
    assert load_keypoint_network(str(pose)).boxes is None  # a folder with a + in its name
    with pytest.raises(InputError, match=r"no\+: a \+ without two names; expected KEYPOINTS\+BOXES"):
        load_keypoint_network("no+")
    with pytest.raises(InputError, match=r"keypoints_from: with boxes of .*yolos, for a film"):
        GivenNetworks(keypoints_from=both)


def test_boxes_are_checked_and_merged() -> None:
    picture = Pyramid(PHOTO, "cpu")
    rows = [(10, 10, 50, 90, 0.9), (11, 10, 51, 92, 0.8), (40, 10, 90, 90, 0.7), (60, 20, 90, 90, 0.3)]
    wrong = [(5, 5, 5, 50, 0.9), (float("nan"), 5, 20, 50, 0.9), (-30, -20, 20, 20, 0.6)]
    boxes, scores = find_boxes(saying(*rows, *wrong), picture, 0.5)
    np.testing.assert_allclose(boxes, [[10, 10, 50, 90], [40, 10, 90, 90], [0, 0, 20, 20]], atol=1e-4)
    np.testing.assert_allclose(scores, [0.9, 0.7, 0.6], atol=1e-6)
    assert find_boxes(saying(), picture, 0.5)[0].shape == (0, 4)
    assert find_people_in_boxes(saying(), picture, 0.5) == []
    with pytest.raises(InputError, match=r"boxes: \(1, 4\); expected left, top, right, bottom, confidence \(N, 5\)"):
        find_boxes(BoxNetwork((9, 9), lambda _: torch.zeros(1, 4)), picture, 0.5)
    assert BoxNetwork((800, 800), torch.zeros_like, 1333).size_of((1000, 2000)) == (666, 1333)


def test_a_box_leads_to_the_landmarks_that_the_packaged_detector_leads_to() -> None:
    (alone,) = find_people(PHOTO)
    left, top, right, bottom = alone.box
    half = (left, top, right, top + 0.6 * (bottom - top), 0.6)  # of the same person
    boxes = saying((*alone.box, 0.8), half)
    person, other = find_people_in_boxes(boxes, Pyramid(PHOTO, "cpu"), 0.5)
    assert not other.seen  # whose landmarks are the first one's
    assert person.score == pytest.approx(0.8)
    assert person.seen
    apart = np.linalg.norm(person.keypoints.points - alone.keypoints.points, axis=1)
    assert apart.mean() < 0.01 * (bottom - top)
    landmarks, beside = alone.keypoints, np.array([0.8 * (right - left), 0.0])

    def seeing(shift: np.ndarray) -> KeypointNetwork:
        """Network that sees the same points in both boxes, in the second one moved."""
        asked: list[None] = []

        def predict(pictures: torch.Tensor) -> torch.Tensor:
            second = len(asked) % 2
            asked.append(None)
            crop = upright_crop((person, other)[second], (64, 48))
            places = crop.from_picture((landmarks.points + second * shift)[None].astype(float))[0]
            return torch.from_numpy(np.column_stack([places, landmarks.confidence]))[None]

        return KeypointNetwork("blazepose33", (64, 48), predict, boxes=boxes)

    how = {"options": FitOptions.at("fast")}
    assert len(fit_photo(PHOTO, keypoints_from=seeing(0 * beside), **how).people) == 1  # found twice
    pair = fit_photo(PHOTO, keypoints_from=seeing(beside), **how)
    assert pair.sources[1] == {"keypoints": "unnamed", "parts": None}
    assert ((person.mask > 0.5).sum() / (alone.mask > 0.5).sum()) == pytest.approx(1, abs=0.1)


def test_people_in_boxes_have_the_keypoints_of_the_network_that_is_asked_for() -> None:
    (alone,) = find_people(PHOTO, landmarks="heavy")
    boxes = saying((0, 0, 12, 12, 0.7), (*alone.box, 0.8))
    (full, corner), (heavy, empty) = (
        find_people_in_boxes(boxes, Pyramid(PHOTO, "cpu"), 0.5, landmarks=name) for name in ("full", "heavy")
    )
    assert (corner.seen, empty.seen) == (False, False)
    assert torch.equal(full.mask, heavy.mask)
    off = [np.linalg.norm(person.keypoints.points - alone.keypoints.points, axis=1).mean() for person in (heavy, full)]
    assert off[0] < 0.7 * off[1]


def test_who_is_in_a_box_alone_gets_the_given_keypoints() -> None:
    """The packaged network does not see the person, in a corner of plain grey."""
    height, width = PHOTO.shape[:2]
    photo = np.concatenate([PHOTO, np.full((height, width, 3), 128, np.uint8)], axis=1)
    box = (width + 60.0, 100.0, width + 160.0, 380.0)
    given = torch.tensor([(*box_of_example(), 0.8), (*box, 0.7)]) / torch.tensor([2 * width, height] * 2 + [1])
    boxes = BoxNetwork((64, 64), lambda _: given)
    people = find_people_in_boxes(boxes, Pyramid(photo, "cpu"), 0.5)
    assert [person.seen for person in people] == [True, False]
    crop = upright_crop(people[1], (256, 192))
    corners = crop.from_picture(np.array(box).reshape(1, 2, 2))[0]
    np.testing.assert_allclose(corners[:, 1], [0.1, 0.9], atol=1e-6)  # the whole box, with a margin

    standing = [(0.5, 0.15), (0.52, 0.13), (0.48, 0.13), (0.55, 0.14), (0.45, 0.14), (0.6, 0.28), (0.4, 0.28)]
    standing += [(0.63, 0.4), (0.37, 0.4), (0.64, 0.5), (0.36, 0.5), (0.56, 0.52), (0.44, 0.52)]
    standing += [(0.56, 0.7), (0.44, 0.7), (0.56, 0.86), (0.44, 0.86)]
    said = torch.tensor([(x, y, 0.9) for x, y in standing])[None]
    network = KeypointNetwork("coco17", (256, 192), lambda pictures: said, name="mine", boxes=boxes)
    fit = fit_photo(photo, options=FitOptions.at("fast"), keypoints_from=network)
    assert sorted(fit.fits) == [0, 1]
    assert fit.sources[1] == {"keypoints": "mine", "parts": None}
    points = fit.people[1].keypoints.points
    assert ((points > box[:2]) & (points < box[2:])).all()
    blind = replace(network, predict=lambda pictures: torch.zeros(len(pictures), 17, 3))
    fit = fit_photo(photo, options=FitOptions.at("fast"), keypoints_from=blind)
    assert sorted(fit.fits) == [0]  # of the other, nothing is known
    assert fit.sources[0]["keypoints"] == PACKAGED
    with pytest.raises(InputError, match="nobody found"):
        fit_photo(photo, keypoints_from=replace(network, boxes=replace(boxes, predict=lambda _: given[:0])))
