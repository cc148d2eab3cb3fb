"""Graphs in float16: the same results as in float32, to float16's digits, and numbers to more."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.example import example_photo

from warp_partdr.networks.detection.asset import packaged_people_networks
from warp_partdr.networks.detection.crops import Pyramid, TurnedCrops, cut_crops
from warp_partdr.networks.detection.detector import tiles
from warp_partdr.networks.detection.graph import Node, OperatorGraph
from warp_partdr.networks.detection.movenet import read_people
from warp_partdr.networks.detection.product_graph import ProductGraph


def chain(rng: np.random.Generator, size: int, stride: int, zeros: tuple[int, int, int, int]) -> OperatorGraph:
    """A product at each pixel that is cut off, then by channels, then a product again, and its sum with itself."""
    nodes = [
        Node("convolution", (0,), 1, activation="relu6"),
        Node("convolution", (1,), 2, stride=stride, groups=8, zeros=zeros, activation="relu"),
        Node("convolution", (2,), 3, activation="relu6"),
        Node("add", (3, 3), 4, activation="none"),
        Node("convolution", (4,), 5),
        Node("rows", (5,), 6, shape=(-1, 2)),
    ]
    shapes = {1: (8, 3, 1, 1), 2: (8, 1, size, size), 3: (16, 8, 1, 1), 5: (2, 16, 1, 1)}
    weights = {}
    for number, shape in shapes.items():
        values = rng.normal(size=shape) * (6 if number == 1 else 1)  # of the first, many values are cut off
        weights[f"{number}.weight"] = torch.from_numpy(values).half().float()
        weights[f"{number}.bias"] = torch.from_numpy(rng.normal(size=shape[0])).half().float()
    return OperatorGraph(12, 0, {"map": 4, "numbers": 6}, nodes, weights)


@pytest.mark.parametrize(
    ("size", "stride", "zeros"), [(3, 1, (1, 1, 1, 1)), (5, 2, (2, 2, 2, 2)), (3, 2, (0, 1, 0, 1))]
)
def test_a_chain_is_that_of_float32(rng, device, size, stride, zeros):
    graph = chain(rng, size, stride, zeros).to(device)
    pictures = torch.from_numpy(rng.normal(size=(300, 3, 12, 11)).astype(np.float32)).to(device)
    for some in (pictures[:3], pictures[:70], pictures):  # few are captured on CUDA
        expected, found = graph(some), ProductGraph(graph, torch.float16)(some)
        for name in ("map", "numbers"):
            assert found[name].dtype == torch.float32
            assert found[name].shape == expected[name].shape
            scale = float(expected[name].abs().max())
            torch.testing.assert_close(found[name], expected[name], rtol=0, atol=0.015 * scale)


def test_numbers_have_more_digits_than_float16(rng, device):
    """A place of 200 px would be rounded to eighths."""
    weights = {"1.weight": torch.zeros(4, 3, 1, 1), "1.bias": torch.full((4,), 200.01)}
    nodes = [Node("convolution", (0,), 1), Node("rows", (1,), 2, shape=(-1,))]
    graph = OperatorGraph(2, 0, {"places": 2}, nodes, weights).to(device)
    found = ProductGraph(graph, torch.float16)(torch.zeros(1, 3, 2, 2, device=device))["places"]
    torch.testing.assert_close(found, torch.full_like(found, 200.01), rtol=0, atol=1e-4)


def test_the_packaged_networks_say_the_same_of_a_person(device):
    """Landmarks within half a pixel of 256; the model card has what it comes to on photos."""
    picture = example_photo()
    height, width = picture.shape[:2]
    crop = TurnedCrops(np.array([[width / 2, height / 2]]), np.array([1.1 * height]), np.zeros(1), np.zeros(1, int))
    cut = cut_crops([Pyramid(picture, device)], crop, 256, beyond="border")
    networks = packaged_people_networks(device)
    with torch.no_grad():
        expected, found = (each.landmarks(cut) for each in (networks, networks.halved()))
    places, others = (each["landmarks"].unflatten(1, (-1, 5))[0, :33] for each in (expected, found))
    assert float((places[:, :2] - others[:, :2]).norm(dim=1).max()) < 0.5
    assert float((places[:, 3:].sigmoid() - others[:, 3:].sigmoid()).abs().max()) < 0.02
    assert float(found["presence"]) == pytest.approx(float(expected["presence"]), abs=1e-3)
    assert float(((expected["mask"] > 0) != (found["mask"] > 0)).float().mean()) < 1e-3


def test_the_detector_in_float16_sees_the_same_person(device):
    """Keypoints within a pixel of 256, and the score to 0.01."""
    picture = example_photo()
    view = cut_crops([Pyramid(picture, device)], tiles(picture.shape[:2], 0), 256) * 2 - 1
    networks = packaged_people_networks(device)
    with torch.no_grad():
        exact, half = (read_people(each.detector(view), 0.5) for each in (networks, networks.halved()))
    assert len(exact[1]) == len(half[1]) == 1
    assert float(half[1]) == pytest.approx(float(exact[1]), abs=0.01)
    assert float((exact[2][0, :, :2] - half[2][0, :, :2]).norm(dim=1).max()) < 1
