"""Shaded people: colours are of their clothes, faces are in front and hair behind, and a seed says all."""

from __future__ import annotations

import numpy as np
import torch

from warp_partdr.body.template import PART_NAMES
from warp_partdr.cameras import Perspective
from warp_partdr.lab.synthetic import shading
from warp_partdr.lab.synthetic.partbench_people import make_person
from warp_partdr.lab.synthetic.people import anny_mesh
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.lab.synthetic.shading import SAMPLES, shade_people
from warp_partdr.models.anny import anny


def shaded(device: str, seed: int = 0, index: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """Picture and labels of one of PartBench's people, (H, W, 3) and (H, W)."""
    person = make_person(index)
    vertices = torch.from_numpy(person.vertices)[None].to(device)
    size = person.parts.shape
    rng = TorchRng(seed, device)
    pictures, drawn = shade_people(vertices, anny_mesh(device), person.camera.to(device), size, rng)
    return pictures[0], drawn.labels[0, ::SAMPLES, ::SAMPLES].cpu().numpy()


def test_people_are_where_they_are_and_a_seed_says_all(device: str) -> None:
    picture, labels = shaded(device)
    assert picture.dtype == np.uint8
    assert picture.shape == (*make_person(9).parts.shape, 3)
    assert (labels != make_person(9).parts).mean() < 0.02  # which is a majority's
    np.testing.assert_array_equal(picture, shaded(device)[0])
    other = shaded(device, seed=1)
    np.testing.assert_array_equal(labels, other[1])
    assert (picture != other[0]).any(2).mean() > 0.9


def test_a_piece_of_clothing_has_one_colour_brighter_and_darker(device: str) -> None:
    picture, labels = shaded(device)
    trunk = np.isin(labels, [PART_NAMES.index(name) + 1 for name in ("chest", "abdomen")])
    inner = trunk & np.roll(trunk, 2, 0) & np.roll(trunk, -2, 0) & np.roll(trunk, 2, 1) & np.roll(trunk, -2, 1)
    colours = picture[inner].astype(float)
    hues = colours / np.linalg.norm(colours, axis=1, keepdims=True)
    mean = hues.mean(0)
    assert np.median(hues @ mean / np.linalg.norm(mean)) > 0.995
    low, middle, high = np.quantile(np.linalg.norm(colours, axis=1), [0.1, 0.5, 0.9])
    assert high - low > 0.15 * middle  # more than grain


def test_eyes_and_mouth_are_in_front_and_hair_is_on_top_and_behind() -> None:
    model, features = anny(), shading.face_features()
    rest = model.rest(torch.zeros(1, model.num_shapes))
    middles = rest.vertices[0].numpy()[model.faces.numpy()].mean(1)
    head = model.face_parts.numpy() == PART_NAMES.index("head") + 1
    assert head[features > 0].mean() > 0.95
    dark, hair = middles[features == shading.DARK_FACE], middles[features == shading.HAIR_FACE]
    eyes = model.landmarks(rest, ("left_eye", "right_eye"))[0].numpy()
    for eye in eyes:
        assert (np.linalg.norm(dark - eye, axis=1) < 0.02).any()
    assert abs(dark[:, 0].mean()) < 0.005
    assert dark[:, 2].min() > hair[:, 2].mean()
    assert hair[:, 1].max() > eyes[0, 1] + 0.08
    assert hair[:, 2].mean() < middles[head, 2].mean()
    assert 0.1 < (features[head] == shading.HAIR_FACE).mean() < 0.9


def test_each_person_has_a_camera_of_their_own(device: str) -> None:
    vertices = torch.from_numpy(make_person(9).vertices)[None].to(device).expand(2, -1, -1)
    vertices = vertices - vertices.mean(1, keepdim=True) + torch.tensor([0.0, 0.0, 4.0], device=device)
    focal = torch.tensor([[120.0], [60.0]], device=device).expand(-1, 2)
    camera = Perspective(focal, torch.tensor([[32.0, 48.0]], device=device).expand(2, -1))
    pictures, drawn = shade_people(vertices, anny_mesh(device), camera, (96, 64), TorchRng(0, device))
    assert pictures.shape == (2, 96, 64, 3)
    assert drawn.labels.shape == (2, 96 * SAMPLES, 64 * SAMPLES)
    large, small = (drawn.labels > 0).sum((1, 2)).tolist()
    assert 3.5 < large / small < 4.5
