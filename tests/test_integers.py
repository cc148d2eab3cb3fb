"""Sizes, counts, labels and indices: any integer type will do; what is no integer is refused, not cut off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from warp_partdr.body.ellipbody import EllipBody
from warp_partdr.body.icosphere import icosphere
from warp_partdr.body.parameters import BodyParameters
from warp_partdr.cameras import WeakPerspective
from warp_partdr.errors import check_whole
from warp_partdr.fit.stages import Stage
from warp_partdr.inputs.keypoint_files import parse_keypoints
from warp_partdr.inputs.keypoints import choose_person
from warp_partdr.interop.checks import check_image_size
from warp_partdr.kernels.launch import set_num_threads
from warp_partdr.render.ellipsoids import draw_ellipsoids, ellipsoid_label_loss
from warp_partdr.render.mesh import draw_mesh
from warp_partdr.render.part_mesh import ellipbody_mesh
from warp_partdr.results.ellipbody_files import ellipbody_scene

NO_INTEGERS = [1.9, 1.0, True, np.bool_(True), np.float32(1), "1", None]
BODY = BodyParameters.mean(1)
CAMERA = WeakPerspective(torch.tensor([4.0]), torch.tensor([[4.0, 4.0]]))
PEOPLE = parse_keypoints([[[10.0 + k, 20.0 + 2 * k] for k in range(17)]] * 3)


def draw(**options: Any) -> Any:
    size = options.pop("image_size", (8, 8))
    return draw_ellipsoids(BODY.posed(), CAMERA, size, **options)


def rasterize(**options: Any) -> Any:
    size = options.pop("image_size", (8, 8))
    return draw_mesh(BODY.posed().vertices(0), ellipbody_mesh(0), CAMERA, size, **options)


ARGUMENTS = {
    "part_labels": lambda value: draw(part_labels=[value] * 20),
    "part_labels of a loss": lambda value: ellipsoid_label_loss(
        BODY.posed(), CAMERA, torch.zeros(1, 8, 8, dtype=torch.uint8), part_labels=[value] * 20
    ),
    "num_maps": lambda value: draw(num_maps=value),
    "image_size": lambda value: draw(image_size=(value, 8)),
    "image_size of a mesh": lambda value: rasterize(image_size=(8, value)),
    "num_maps of a mesh": lambda value: rasterize(num_maps=value),
    "subdivisions": icosphere,
    "subdivisions of a mesh": ellipbody_mesh,
    "subdivisions of vertices": BODY.posed().vertices,
    "index": lambda value: EllipBody.mean(2, device="cpu").measure(value),
    "index of a scene": lambda value: ellipbody_scene(BodyParameters.mean(2).posed(), index=value),
    "batch_size": BodyParameters.mean,
    "batch_size of EllipBody": lambda value: EllipBody.mean(value, device="cpu"),
    "bodies": lambda value: Stage("some", value, 1, 0.1),
    "size": lambda value: Stage("some", 1, 1, 0.1, size=value),
    "iterations": lambda value: Stage("some", 1, value, 0.1),
    "person": lambda value: choose_person(PEOPLE, None, value),
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_integers_of_any_type_and_nothing_else(name: str) -> None:
    call = ARGUMENTS[name]
    call(1)  # first, so that what is kept of it is not found for the others
    for value in (np.int64(1), np.uint8(1), torch.tensor(1)):
        call(value)
    for value in NO_INTEGERS:
        if name == "person" and value is None:
            continue  # whom to take by default
        with pytest.raises(ValueError, match=f"^{name.split()[0]}: .*expected (an|two positive) integer"):
            call(value)


def test_what_comes_back_is_an_int() -> None:
    assert type(check_whole("count", np.int64(3), 0)) is int
    assert [type(size) for size in check_image_size((np.int64(3), np.uint8(4)))] == [int, int]
    stage = Stage("some", np.int64(3), np.int64(4), 0.1, np.int64(5))
    assert [type(value) for value in (stage.bodies, stage.iterations, stage.size)] == [int] * 3


def test_ranges() -> None:
    assert check_whole("count", 3, 3, 3) == 3
    for value in (2, 5, 10**400):
        with pytest.raises(ValueError, match=r"^count: .*; expected an integer from 3 to 4$"):
            check_whole("count", value, 3, 4)
    with pytest.raises(ValueError, match=r"^count: -1; expected an integer of 0 or more$"):
        set_num_threads(-1)
    with pytest.raises(ValueError, match=r"^part_labels: 2 of them; expected 20"):
        draw(part_labels=[1, 2])
