"""Write the weighted mean of two trained label networks, one of which was trained on from the other.

    python scripts/average_networks.py FIRST SECOND --share 0.7 --out FILE

The weights are (1 - share) times FIRST's plus share times SECOND's ("Robust fine-tuning of zero-shot models",
Wortsman et al., 2022). Such a mean may err less than either on people who are unlike those of the training.
"""

from __future__ import annotations

from pathlib import Path

import torch

from warp_partdr.errors import InputError
from warp_partdr.lab.harness import run_script
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


def main(first: Path, second: Path, /, *, share: float = 0.5, bits: int = 8, out: Path) -> None:
    """Average two networks and write the mean.

    Args:
        first: Network from which the other was trained on.
        second: Network that was trained on.
        share: Share of the second network, 0 to 1.
        bits: Bits of a weight in the file.
        out: File to write.
    """
    ours, theirs = load_label_network(first), load_label_network(second)
    weights = average(ours, theirs, share)
    about = {"mean of": [first.name, second.name], "share": share}
    save_label_network(out, weights, theirs.config, about, bits=bits)
    print(f"{out}: {1 - share:.2f} of {first}, {share:.2f} of {second}")


if __name__ == "__main__":
    run_script(main)
