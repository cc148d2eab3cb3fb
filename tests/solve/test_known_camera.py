"""Fits before a known camera: beside its axis and near, where weak perspective is far off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from helpers.bodies import walker

from warp_partdr import FitOptions, Perspective, fit_body, label_set, metrics
from warp_partdr.body.lens import turn_to_rays
from warp_partdr.body.posing import LandmarkGather
from warp_partdr.body.skeletons import skeleton
from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.inputs.observation import observe
from warp_partdr.inputs.part_labels import PartLabels
from warp_partdr.networks.regression.checkpoint import packaged_network
from warp_partdr.networks.regression.predict import predict_bodies
from warp_partdr.render.ellipsoids import draw_ellipsoids

SIZE = 300, 400
CAMERA = Perspective.of_picture(SIZE, focal=260, principal=(200, 150))


def seen_aside(device: str) -> tuple[Keypoints2D, PartLabels, np.ndarray]:
    """A walker 3 m away and 1.7 m to the right of the axis: keypoints, labels, true joints [m]."""
    camera = CAMERA.to(device)
    posed = walker(device).posed().at(torch.tensor([[1.7, 0.1, 3.0]], device=device))
    points = camera.project(LandmarkGather(skeleton("coco17").marks, device)(posed))[0, :, :2].cpu().numpy()
    labels = draw_ellipsoids(posed, camera, SIZE).labels[0].cpu().numpy()
    keypoints = Keypoints2D("coco17", points.astype(np.float32), np.ones(len(points), dtype=np.float32))
    return keypoints, PartLabels(label_set("ellipbody20"), labels), posed.joints[0].cpu().numpy()


@pytest.mark.parametrize("start", ["network", "search"])
def test_a_known_camera_helps_a_person_beside_the_axis(device, start):
    keypoints, parts, joints = seen_aside(device)
    options = replace(FitOptions.at("fast", start), guess_camera=False)
    given = {"options": options, "device": device}
    known, weak = (fit_body(keypoints, parts, camera=camera, **given) for camera in (CAMERA, None))
    errors = [1000 * metrics.mpjpe(each.posed.joints[0].cpu().numpy(), joints, centre_on=[0]) for each in (known, weak)]
    assert errors[0] < 0.75 * errors[1]
    pelvis = known.posed.joints[0, 0].cpu().numpy()
    assert np.linalg.norm(pelvis - joints[0]) < 0.15 * np.linalg.norm(joints[0])  # people's sizes are guessed
    pixel = known.camera.project(known.posed.joints[:, :1])[0, 0, :2].cpu().numpy()
    true = CAMERA.project(torch.from_numpy(joints)[None, :1])[0, 0, :2].numpy()
    assert np.linalg.norm(pixel - true) < 5.0
    drawn = known.draw(SIZE).labels[0].cpu().numpy()
    assert metrics.part_f1(metrics.confusion(drawn, parts.groups, 21)) > 0.6
    torch.testing.assert_close(known.camera.intrinsics.cpu(), CAMERA.intrinsics, rtol=1e-4, atol=1e-2)


def test_the_networks_body_is_turned_to_its_ray(device):
    keypoints, parts, joints = seen_aside(device)
    alone = {"options": FitOptions(stages=(), search=(), guess_camera=False), "device": device}
    found = [fit_body(keypoints, parts, camera=camera, **alone) for camera in (CAMERA, None)]
    seen, _ = observe(keypoints, parts, camera=CAMERA, device=device)
    assert seen.lens is not None
    turned = turn_to_rays(predict_bodies([seen], packaged_network(str(seen.points.device))), seen.lens)
    torch.testing.assert_close(found[0].parameters.orientation, turned.orientation)
    errors = [metrics.mpjpe(each.posed.joints[0].cpu().numpy(), joints, centre_on=[0]) for each in found]
    assert errors[0] < errors[1]


def test_cameras_that_a_fit_cannot_use_are_refused():
    keypoints, parts, _ = seen_aside("cpu")
    two = Perspective(CAMERA.focal.repeat(2, 1), CAMERA.centre.repeat(2, 1))
    flat = Perspective(torch.tensor([[260.0, 200.0]]), CAMERA.centre)
    long = Perspective(torch.full((1, 2), 1e30), CAMERA.centre)
    for camera, error, says in (
        (long, ValueError, r"camera: \[1.*\]; expected pixels, up to 1e\+06"),
        (two, ValueError, "camera: 2 of them; expected one"),
        (flat, ValueError, "camera: focal lengths 260 and 200; expected square pixels"),
        (260.0, TypeError, "camera: float"),
    ):
        with pytest.raises(error, match=says):
            fit_body(keypoints, parts, camera=camera)


def test_a_picture_s_camera_comes_from_its_focal_length_or_field_of_view():
    wide = Perspective.of_picture((100, 200), fov=90)
    assert wide.intrinsics.tolist() == [pytest.approx([100, 100, 100, 50])]
    for options, says in (
        ({}, "focal, fov: None, None; expected one of the two"),
        ({"fov": 0.0}, "fov: 0; expected degrees between 0 and 170"),
        ({"focal": 0.0}, "focal: 0; expected a positive number"),
        ({"focal": 1e7}, r"focal: 1e\+07; expected a positive number of pixels, up to 1e\+06"),
        ({"fov": 1e-4}, r"fov: 0.0001, a focal length of 1.145\d*e\+08; expected .* up to 1e\+06"),
        ({"focal": 5.0, "principal": (float("nan"), 1.0)}, r"principal: .*; expected pixels, up to 1e\+06"),
        ({"focal": 5.0, "principal": (1.0, -1e7)}, r"principal: .*; expected pixels, up to 1e\+06"),
    ):
        with pytest.raises(ValueError, match=says):
            Perspective.of_picture((100, 200), **options)
