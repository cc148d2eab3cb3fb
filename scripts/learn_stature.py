"""Learn and print how tall an EllipBody stands, from the lengths of its bones: ``SHARES`` of ``body/stature.py``.

    python scripts/learn_stature.py [--count 4000]

Least squares over Anny's bodies, with uniform phenotype values, whose lengths are a bit off, as those of fits are: else
bones that grow together get shares of either sign. How far off that is, of as many others with exact lengths.
"""

from __future__ import annotations

import numpy as np
import torch

from warp_partdr.body.stature import SHARES
from warp_partdr.body.template import LENGTH_NAMES
from warp_partdr.lab.harness import run_script
from warp_partdr.lab.synthetic import people
from warp_partdr.models.anny import anny, anny_shape
from warp_partdr.models.measuring import measure_ellipbody, statures
from warp_partdr.models.registration import ungrown

_BATCH = 250
_OFF = 0.03  # share of a length


def main(*, count: int = 4000) -> None:
    """Learn and print.

    Args:
        count: Number of people.
    """
    rng = np.random.default_rng(0)
    model = anny()
    still = torch.eye(3).expand(_BATCH, model.num_joints, 3, 3)
    rows: list[np.ndarray] = []
    for _ in range(-(-2 * count // _BATCH)):
        phenotypes = rng.uniform(*people.PHENOTYPE_RANGES.T, size=(_BATCH, len(people.PHENOTYPE_RANGES)))
        shape = anny_shape(phenotypes)
        lengths = measure_ellipbody(ungrown(model, shape, still, torch.zeros(_BATCH, 3), {}))[3]
        rows.append(torch.cat([lengths, statures(model, shape)[:, None]], dim=1).double().numpy())
    own = [LENGTH_NAMES.index(name) for name in SHARES]
    learned, others = ((each[:, own], each[:, -1]) for each in np.array_split(np.concatenate(rows), 2))
    lengths = learned[0] * (1 + _OFF * rng.standard_normal(learned[0].shape))
    shares = np.linalg.lstsq(lengths, learned[1])[0].round(2)
    print(dict(zip(SHARES, shares.tolist(), strict=True)))
    off = others[0] @ shares / others[1] - 1
    print(f"off by {100 * np.abs(off).mean():.2f} % on average, {100 * np.abs(off).max():.2f} % at most")


if __name__ == "__main__":
    run_script(main)
