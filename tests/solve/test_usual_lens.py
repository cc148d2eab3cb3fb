"""A usual lens is assumed where no camera is known and the picture's size is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr import FitOptions, fit_body
from warp_partdr.body.labels import label_set
from warp_partdr.cameras import USUAL_FOCAL, Perspective, UsualLens
from warp_partdr.errors import InputError
from warp_partdr.inputs.cut_people import CutPerson
from warp_partdr.inputs.evidence import weigh_evidence
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import crop_evidence, observe, usual_lens
from warp_partdr.inputs.observations import Observations
from warp_partdr.inputs.sample import Sample
from warp_partdr.lab.evaluation.partbench.samples import make_sample
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.networks.regression.predict import ask_network
from warp_partdr.results.save import describe_body, make_report
from warp_partdr.solve.ellipsoids.far_people import MUCH_FARTHER, with_longer_lens
from warp_partdr.solve.ellipsoids.fitting import fit_people
from warp_partdr.solve.ellipsoids.result import FitResult

FAST = FitOptions.at("fast")


def fitted(sample: Sample, **changes):
    camera = changes.pop("camera", None)
    options = replace(FAST, **changes)
    return fit_body(sample.keypoints, sample.parts, others=sample.others, options=options, camera=camera)


def test_a_usual_lens_is_as_long_as_the_longer_side_and_looks_through_the_middle():
    for size in ((300, 400), (400, 300)):
        camera = UsualLens.of_size(size)
        assert camera.intrinsics.tolist() == [[400.0 * USUAL_FOCAL] * 2 + [size[1] / 2, size[0] / 2]]


@pytest.mark.parametrize("start", ["network", "search"])
def test_a_body_stands_before_a_usual_lens_where_no_camera_is_known(start):
    sample = make_sample(2, "realistic")
    options = {"start": start, "stages": FAST.search[:1]} if start == "search" else {}
    found = fitted(sample, **options)
    assert found.camera_guessed
    assert found.observation.lens_assumed
    expected = UsualLens.of_size(sample.parts.groups.shape)
    assert torch.allclose(found.camera.intrinsics, expected.intrinsics, atol=1e-3)
    assert 0.5 < found.posed.joints[0, 0, 2] < 30
    assert describe_body(found)["camera"]["guessed"] is True
    assert make_report(found)["distance"] == "for an assumed lens"


def test_no_lens_is_assumed_where_one_is_known_or_none_is_asked_for():
    sample = make_sample(2, "realistic")
    known = Perspective.of_picture(sample.parts.groups.shape, focal=900.0)
    given, weak = fitted(sample, camera=known), fitted(sample, guess_camera=False)
    assert not given.camera_guessed
    assert torch.allclose(given.camera.intrinsics, known.intrinsics, atol=1e-3)
    assert not weak.camera_guessed
    assert not weak.camera.perspective
    assert "guessed" not in describe_body(weak)["camera"]
    assert make_report(given)["distance"] == "for a known focal length"
    assert make_report(weak)["distance"] == "for an assumed lens"


def test_keypoints_alone_need_the_pictures_size():
    sample = make_sample(2, "realistic")
    sample = replace(sample, parts=None, keypoints=replace(sample.keypoints, image_size=None))
    size = (480, 640)
    sized = replace(sample, keypoints=replace(sample.keypoints, image_size=size))
    assert not fitted(sample).camera.perspective
    found = fitted(sized)
    assert torch.allclose(found.camera.intrinsics, UsualLens.of_size(size).intrinsics, atol=1e-3)
    assert observe(sample.keypoints, None)[0].lens is None
    assert observe(sized.keypoints, None)[0].lens_assumed


def far_person() -> Sample:
    """A person 12 m away, before a lens 9 times as long as usual."""
    return make_sample(0, "far")


def test_labels_that_show_a_person_far_away_get_a_longer_lens():
    """The body stands much farther away than before a usual lens, and is seen as large in the picture."""
    sample = far_person()
    found = fitted(sample)
    usual = fitted(sample, camera=UsualLens.of_size(sample.parts.groups.shape))
    assert found.camera_guessed
    assert float(found.camera.focal[0, 0]) > MUCH_FARTHER * float(usual.camera.focal[0, 0])
    assert torch.equal(found.camera.centre, usual.camera.centre)
    nearer, farther = float(usual.posed.joints[0, 0, 2]), float(found.posed.joints[0, 0, 2])
    assert farther > MUCH_FARTHER * nearer
    error, before = (np.abs(_projected(fit) - sample.keypoints.points).mean() for fit in (found, usual))
    assert error < 1.2 * before
    assert make_report(found)["distance"] == "for an assumed lens"


def _projected(found: FitResult) -> np.ndarray:
    joints = torch.from_numpy(found.landmarks(found.evidence.keypoints.format.landmarks))
    return found.camera.project(joints[None])[0, :, :2].numpy()


def test_a_lens_that_is_known_or_of_a_whole_photo_stays():
    sample = far_person()
    size = sample.parts.groups.shape
    for camera in (UsualLens.of_size(size), Perspective.of_picture(size, focal=700.0)):
        assert torch.allclose(fitted(sample, camera=camera).camera.intrinsics, camera.intrinsics, atol=1e-2)


def test_only_labels_of_parts_show_that_somebody_is_far_away():
    """Neither keypoints alone nor a mask do, and a known lens is believed."""
    sample = far_person()
    seen = Observations.of([observe(sample.keypoints, sample.parts)[0]])
    network = packaged_network("cpu")
    predicted = ask_network(seen, network)
    longer = with_longer_lens(seen, predicted)
    assert longer.lens[0, 0] > MUCH_FARTHER * seen.lens[0, 0]
    assert torch.equal(longer.lens[:, 1:], seen.lens[:, 1:])
    assert with_longer_lens(replace(seen, lens_assumed=False), predicted) is None
    assert with_longer_lens(replace(seen, labels=None, label_set=None), predicted) is None
    assert with_longer_lens(replace(seen, label_set=label_set("full1")), predicted) is None
    assert with_longer_lens(replace(seen, lens=longer.lens), predicted) is None


def test_people_side_by_side_have_the_lenses_that_they_have_alone(device):
    """One of them is far away, and the other keeps the usual lens."""
    options = replace(FAST, stages=(), search=())
    samples = [far_person(), make_sample(1, "realistic")]
    evidence = [weigh_evidence(sample.keypoints, sample.parts, sample.others)[0] for sample in samples]
    people = [CutPerson(each, *crop_evidence(each, device=device, camera=usual_lens(each))) for each in evidence]
    together = fit_people(people, options, packaged_network(device))
    for sample, fit in zip(samples, together, strict=True):
        alone = fitted(sample, stages=(), search=())
        assert fit.camera_guessed
        torch.testing.assert_close(fit.camera.intrinsics.cpu(), alone.camera.intrinsics, rtol=0.02, atol=0.3)
        torch.testing.assert_close(fit.posed.joints.cpu(), alone.posed.joints, rtol=0.02, atol=0.02)
    far, usual = (
        float(fit.camera.focal[0, 0]) / max(sample.parts.groups.shape)
        for sample, fit in zip(samples, together, strict=True)
    )
    assert far > MUCH_FARTHER * USUAL_FOCAL
    assert usual == pytest.approx(USUAL_FOCAL)


_NO_SIZES = [(0, 10), (3,), (5, -1), (float("nan"), 10), (10.5, 10), ("a", "b"), (True, 9), (None, 5), 7, (10**7, 5)]


@pytest.mark.parametrize("size", _NO_SIZES)
def test_sizes_that_no_picture_has_are_refused(size):
    with pytest.raises(InputError, match=r"image_size: .*; expected .H, W. in whole pixels"):
        Keypoints2D("coco17", np.zeros((17, 2), np.float32), np.ones(17, np.float32), image_size=size)
    if size != 7:
        with pytest.raises(ValueError, match=r"image_size|unpack"):
            UsualLens.of_size(size)


def test_sizes_are_plain_numbers_whatever_they_were():
    points, confidence = np.zeros((17, 2), np.float32), np.ones(17, np.float32)
    keypoints = Keypoints2D("coco17", points, confidence, image_size=np.array([480, 640]))
    assert keypoints.image_size == (480, 640)
    assert type(keypoints.image_size[0]) is int


def test_keypoints_of_another_picture_are_refused():
    """A usual lens would look past a person who is far out of its picture."""
    keypoints = make_sample(2, "realistic").keypoints
    options = replace(FitOptions(), stages=(), search=())
    for wrong in (replace(keypoints, points=keypoints.points + 5e4), replace(keypoints, image_size=(9, 9))):
        with pytest.raises(
            InputError, match=r"keypoints: .* expected it in the picture's \d+x\d+ pixels, or near them"
        ):
            fit_body(wrong, options=options)
