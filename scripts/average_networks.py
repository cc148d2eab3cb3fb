"""Write the weighted mean of two trained label networks, one of which was trained on from the other.

    python scripts/average_networks.py FIRST SECOND --share 0.7 --out FILE

The weights are (1 - share) times FIRST's plus share times SECOND's ("Robust fine-tuning of zero-shot models",
Wortsman et al., 2022). Such a mean may err less than either on people who are unlike those of the training.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from warp_partdr.errors import InputError
from warp_partdr.networks.regression.checkpoint import load_label_network, save_label_network
from warp_partdr.networks.regression.label_network import LabelNetwork


def average(first: LabelNetwork, second: LabelNetwork, share: float) -> dict[str, torch.Tensor]:
    """Weights between those of two networks, ``share`` of the second.

    Raises:
        InputError: If the networks' sizes differ, or ``share`` is not from 0 to 1.
    """
    if not 0 <= share <= 1:
        raise InputError(f"share: {share}; expected a number from 0 to 1")
    if first.config != second.config:
        raise InputError(f"second: a network of {second.config}; expected {first.config}")
    ours, theirs = first.state_dict(), second.state_dict()
    weights = dict(theirs)
    for name, value in theirs.items():
        if value.is_floating_point():  # counters of batches are no weights
            weights[name] = ours[name].lerp(value, share)
    return weights


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=Path, help="network from which the other was trained on")
    parser.add_argument("second", type=Path, help="network that was trained on")
    parser.add_argument("--share", type=float, default=0.5, help="of the second network, 0 to 1 (default: 0.5)")
    parser.add_argument("--bits", type=int, default=8, help="of a weight in the file (default: 8)")
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    options = parser.parse_args()
    first, second = load_label_network(options.first), load_label_network(options.second)
    weights = average(first, second, options.share)
    about = {"mean of": [options.first.name, options.second.name], "share": options.share}
    save_label_network(options.out, weights, second.config, about, bits=options.bits)
    print(f"{options.out}: {1 - options.share:.2f} of {options.first}, {options.share:.2f} of {options.second}")


if __name__ == "__main__":
    main()
