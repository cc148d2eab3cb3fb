"""Graphs for CUDA: the results of plain torch, to the digits of float32 or float16, from batches of few sizes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from helpers.example import example_photo

from warp_partdr.networks.detection import product_graph
from warp_partdr.networks.detection.asset import load_heavy_landmarks, packaged_people_networks
from warp_partdr.networks.detection.crops import Pyramid, TurnedCrops, cut_crops
from warp_partdr.networks.detection.detector import tiles
from warp_partdr.networks.detection.graph import Node, OperatorGraph
from warp_partdr.networks.detection.movenet import read_people
from warp_partdr.networks.detection.product_graph import ProductGraph
from warp_partdr.networks.window_products import convolve_windows


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


@pytest.mark.parametrize(("dtype", "error"), [(torch.float32, 1e-5), (torch.float16, 0.015)])
@pytest.mark.parametrize(
    ("size", "stride", "zeros"), [(3, 1, (1, 1, 1, 1)), (5, 2, (2, 2, 2, 2)), (3, 2, (0, 1, 0, 1))]
)
def test_a_chain_is_that_of_plain_torch(rng, device, size, stride, zeros, dtype, error):
    graph = chain(rng, size, stride, zeros).to(device)
    products = ProductGraph(graph, dtype)
    pictures = torch.from_numpy(rng.normal(size=(300, 3, 12, 11)).astype(np.float32)).to(device)
    for some in (pictures[:3], pictures[:70], pictures):
        expected, found = graph(some), products(some)
        for name in ("map", "numbers"):
            assert found[name].dtype == torch.float32
            assert found[name].shape == expected[name].shape
            scale = float(expected[name].abs().max())
            torch.testing.assert_close(found[name], expected[name], rtol=0, atol=error * scale)


def test_any_number_of_people_needs_few_sizes_of_batches(rng, monkeypatch):
    """Each size that is new costs a photo time: its graph is captured, and torch's libraries choose kernels for it."""
    products, sizes = ProductGraph(chain(rng, 3, 1, (1, 1, 1, 1))), set()

    def convolve(values: torch.Tensor, *rest: object) -> torch.Tensor:
        sizes.add(len(values))
        return convolve_windows(values, *rest)

    monkeypatch.setattr(product_graph, "convolve_windows", convolve)
    for count in range(1, 41):
        assert len(products(torch.zeros(count, 3, 12, 11))["map"]) == count
    assert sizes == {4, 16}


@pytest.mark.parametrize("name", ["detector", "landmarks", "heavy"])
def test_packaged_networks_need_no_library_for_convolutions(name, monkeypatch):
    """Loading cuDNN, and its plans for each shape, took most of a first call on CUDA."""

    def fail(*_: object, **__: object) -> None:
        raise AssertionError("conv2d was called")

    network = load_heavy_landmarks() if name == "heavy" else getattr(packaged_people_networks("cpu"), name)
    pictures = torch.rand(1, 3, 256, 256, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        expected = network(pictures)
        monkeypatch.setattr(torch.nn.functional, "conv2d", fail)
        found = ProductGraph(network)(pictures)
    for each, values in expected.items():
        torch.testing.assert_close(found[each], values, rtol=0, atol=1e-3 * float(values.abs().max()))


@pytest.mark.parametrize(("size", "stride"), [(1, 1), (1, 2), (3, 2), (4, 2), (5, 1)])
@pytest.mark.parametrize("zeros", [(0, 0, 0, 0), (0, 1, 2, 3)])
def test_products_of_windows_are_convolutions(rng, device, size, stride, zeros):
    given = (rng.normal(size=shape).astype(np.float32) for shape in ((2, 3, 11, 8), (5, 3, size, size), (5,)))
    values, weight, bias = (torch.from_numpy(each).to(device) for each in given)
    padded = torch.nn.functional.pad(values, zeros).double()
    expected = torch.nn.functional.conv2d(padded, weight.double(), bias.double(), stride)
    found = convolve_windows(values, weight, bias, stride, zeros)
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=1e-4)
    assert found.is_contiguous(memory_format=torch.channels_last)


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
