"""Operators of the packaged graphs, against their definitions written out."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from warp_partdr.networks.detection.graph import KINDS, Node, OperatorGraph


def run(node: Node, *inputs: np.ndarray) -> np.ndarray:
    return KINDS[node.kind](node, *(torch.from_numpy(each.copy()) for each in inputs)).numpy()


@pytest.mark.parametrize("groups", [1, 4])
@pytest.mark.parametrize("zeros", [(1, 1, 1, 1), (0, 1, 1, 2)])
def test_a_convolution_is_a_sum_over_windows(rng, groups, zeros):
    values = rng.normal(size=(2, 4, 6, 5)).astype(np.float32)
    weight = rng.normal(size=(4, 4 // groups, 3, 3)).astype(np.float32)
    bias = rng.normal(size=4).astype(np.float32)
    node = Node("convolution", (0,), 1, stride=2, groups=groups, zeros=zeros, activation="relu6")
    left, right, above, below = zeros
    padded = np.pad(values, ((0, 0), (0, 0), (above, below), (left, right)))
    expected = np.zeros((2, 4, (padded.shape[2] - 3) // 2 + 1, (padded.shape[3] - 3) // 2 + 1))
    for n, c, y, x in itertools.product(*map(range, expected.shape)):
        channels = slice(None) if groups == 1 else slice(c, c + 1)
        window = padded[n, channels, 2 * y : 2 * y + 3, 2 * x : 2 * x + 3]
        expected[n, c, y, x] = np.clip((window * weight[c]).sum() + bias[c], 0, 6)
    np.testing.assert_allclose(run(node, values, weight, bias), expected, atol=1e-5)


def test_sums_are_cut_off_by_their_activation(rng):
    a, b = rng.normal(size=(2, 1, 2, 3, 3)).astype(np.float32) * 5
    for name, low, high in (("none", -np.inf, np.inf), ("relu", 0, np.inf), ("relu6", 0, 6)):
        np.testing.assert_allclose(run(Node("add", (0, 1), 2, activation=name), a, b), np.clip(a + b, low, high))


def test_pools_take_the_largest_of_squares(rng):
    values = rng.normal(size=(1, 2, 4, 4)).astype(np.float32)
    expected = values.reshape(1, 2, 2, 2, 2, 2).max(axis=(3, 5))
    np.testing.assert_array_equal(run(Node("max_pool", (0,), 1, size=2), values), expected)


def test_more_channels_are_zeros_after_the_others(rng):
    values = rng.normal(size=(2, 3, 4, 5)).astype(np.float32)
    more = run(Node("more_channels", (0,), 1, size=2), values)
    np.testing.assert_array_equal(more, np.concatenate([values, np.zeros((2, 2, 4, 5), np.float32)], axis=1))


def test_resized_pictures_keep_straight_ramps():
    """Inner values at pixel centres of halves; the border's repeat."""
    ramp = np.arange(4, dtype=np.float32)[None, None, None].repeat(2, axis=2)
    wide = run(Node("resize", (0,), 1, size=(2, 8)), ramp)
    np.testing.assert_allclose(wide[0, 0, 0], np.clip((np.arange(8) + 0.5) / 2 - 0.5, 0, 3))


def test_rows_are_read_pixel_by_pixel(rng):
    values = rng.normal(size=(2, 6, 2, 3)).astype(np.float32)
    rows = run(Node("rows", (0,), 1, shape=(12, 3)), values)
    np.testing.assert_array_equal(rows, values.transpose(0, 2, 3, 1).reshape(2, 12, 3))


def test_a_graph_keeps_what_is_needed_later(device):
    """A value that two operators take, and an output that is also an input."""
    nodes = [
        Node("convolution", (0,), 1),
        Node("sigmoid", (1,), 2),
        Node("add", (1, 2), 3),
        Node("add", (3, 1), 4),
    ]
    weights = {"1.weight": torch.full((3, 3, 1, 1), 0.5), "1.bias": torch.tensor([0.0, 1.0, 2.0])}
    graph = OperatorGraph(4, 0, {"half": 2, "all": 4}, nodes, weights).to(device)
    pictures = torch.rand(2, 3, 4, 4, device=device)
    first = pictures.sum(1, keepdim=True) * 0.5 + torch.tensor([0.0, 1.0, 2.0], device=device)[:, None, None]
    said = graph(pictures)
    torch.testing.assert_close(said["half"], first.sigmoid(), rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(said["all"], 2 * first + first.sigmoid(), rtol=1e-3, atol=2e-3)


def test_nodes_come_from_json():
    node = Node.from_json({"kind": "convolution", "inputs": [3], "output": 4, "stride": 2, "zeros": [0, 1, 0, 1]})
    assert node == Node("convolution", (3,), 4, stride=2, zeros=(0, 1, 0, 1))


def test_any_number_of_pictures_is_each_of_them(device):
    """On CUDA, few are replayed by a captured graph that may have room for more; what it gave before stays."""
    generator = torch.Generator().manual_seed(0)
    weights = {"1.weight": torch.randn(4, 3, 3, 3, generator=generator), "1.bias": torch.randn(4, generator=generator)}
    nodes = [Node("convolution", (0,), 1, zeros=(1, 1, 1, 1), activation="relu"), Node("sigmoid", (1,), 2)]
    network = OperatorGraph(8, 0, {"found": 2}, nodes, weights).to(device)
    pictures = torch.rand(40, 3, 8, 8, generator=generator)
    with torch.no_grad():
        convolved = torch.nn.functional.conv2d(pictures, weights["1.weight"], weights["1.bias"], padding=1)
        counts = (1, 3, 4, 17, 40, 3, 2)
        starts = [0, 1, 4, 8, 0, 25, 38]
        found = [network(pictures[a : a + count].to(device))["found"] for a, count in zip(starts, counts, strict=True)]
    for a, count, values in zip(starts, counts, found, strict=True):
        torch.testing.assert_close(values.cpu(), convolved[a : a + count].relu().sigmoid(), rtol=0, atol=1e-5)
