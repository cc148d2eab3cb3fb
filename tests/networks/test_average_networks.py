"""The weighted mean of two networks."""

import sys
from pathlib import Path

import pytest
import torch

from warp_partdr.errors import InputError
from warp_partdr.lab.harness import run_script
from warp_partdr.networks.regression.checkpoint import load_label_network, save_label_network
from warp_partdr.networks.regression.label_network import LabelNetwork, LabelNetworkConfig

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))
import average_networks

_SMALL = LabelNetworkConfig(size=32, channels=(8, 8, 8, 8, 8), places=8, keypoint_features=16)


def network(seed: int, config: LabelNetworkConfig = _SMALL) -> LabelNetwork:
    torch.manual_seed(seed)
    return LabelNetwork(config).eval()


def test_the_mean_lies_between_both_by_the_share():
    first, second = network(0), network(1)
    ours, theirs = first.state_dict(), second.state_dict()
    found = average_networks.average(first, second, 0.25)
    assert found.keys() == theirs.keys()
    differing = [name for name in found if not torch.equal(ours[name], theirs[name])]
    assert differing
    for name in differing:
        assert torch.allclose(found[name], 0.75 * ours[name] + 0.25 * theirs[name], atol=1e-6)
    for share, expected in ((0.0, ours), (1.0, theirs)):
        same = average_networks.average(first, second, share)
        assert all(torch.allclose(same[name], expected[name], atol=1e-6) for name in differing)


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_shares_that_are_none_are_refused(share):
    with pytest.raises(InputError, match="share"):
        average_networks.average(network(0), network(1), share)


def test_networks_of_other_sizes_are_refused():
    other = network(1, LabelNetworkConfig(size=64, channels=(8, 8, 8, 8, 8), places=8, keypoint_features=16))
    with pytest.raises(InputError, match="second"):
        average_networks.average(network(0), other, 0.5)


def test_the_command_writes_a_network_that_is_read(tmp_path, capsys):
    for seed, name in enumerate(("a", "b")):
        one = network(seed)
        save_label_network(tmp_path / name, one.state_dict(), one.config, {}, bits=16)
    files = [str(tmp_path / name) for name in ("a", "b", "mean")]
    run_script(average_networks.main, [*files[:2], "--out", files[2], "--bits", "16"])
    assert "0.50 of" in capsys.readouterr().out
    loaded = [load_label_network(file).state_dict() for file in files]
    weight = "keypoints.0.weight"
    assert torch.allclose(loaded[2][weight], (loaded[0][weight] + loaded[1][weight]) / 2, atol=1e-2)
