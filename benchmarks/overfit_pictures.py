"""Does EllipBodyNet learn? From free pictures of shaded Anny people, through the loop of ``partdr train``.

python benchmarks/overfit_pictures.py               16 pictures by heart: PA-MPJPE under 20 mm
python benchmarks/overfit_pictures.py --held-out    other people than those learnt from: the error falls
... --device cuda --backbone resnet-50              the paper's backbone; by default a small one, for a CPU
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from warp_partdr.training.config import TrainingConfig
from warp_partdr.training.config_files import make_config
from warp_partdr.training.loop import run_training

SMALL = {
    "size": 128,
    "architecture": {
        "model_type": "resnet",
        "layer_type": "basic",
        "embedding_size": 32,
        "hidden_sizes": [32, 64, 128, 256],
        "depths": [1, 1, 1, 1],
    },
    "head_width": 64,
}
PEOPLE, SEED, OTHER_SEED = 16, 11, 12
STILL = {"flip": 0.0, "angle": 0.0, "zoom": 0.0, "shift": 0.0, "colour": 0.0}


def configure(
    out: Path, *, steps: int, held_out: bool = False, resnet50: bool = False, people: int = PEOPLE, workers: int = 0
) -> TrainingConfig:
    """A run in two phases as the paper's: without L_seg, the sizes left at the mean body's, then with all.

    Args:
        out: Folder of the run.
        steps: Of it.
        held_out: Measure on people who aren't learnt from, with augmentation, instead of on the same ones, without.
        resnet50: The paper's backbone, random, on pictures of 256 px, instead of a small one on 128 px.
        people: How many are learnt from.
        workers: Processes that make crops.
    """
    model: dict[str, Any] = {} if resnet50 else SMALL
    learnt = {"kind": "shaded", "count": people, "seed": SEED}
    measured = {"count": 64, "seed": OTHER_SEED} if held_out else {}
    return make_config(
        {
            "task": "ellipbodynet",
            "steps": steps,
            "batch_size": 64 if held_out else min(people, PEOPLE),
            "learning_rate": 5e-4,
            "warm_up": max(steps // 8, 1),
            "clip": 1e6,
            "weights": {"joints": 4.0},  # what is measured; with 1 the parts' borders and mean sizes cost 2 mm
            "ema": 0.95,
            "log_every": max(steps // 20, 1),
            "validate_every": max(steps // 5, 1),
            "checkpoint_every": steps,
            "out": str(out),
            "phases": [
                {
                    "until": 0.6,
                    "without": ["seg"],
                    "frozen": ["regressor.heads.lengths", "regressor.heads.thicknesses"],
                },
                {},
            ],
            "model": {**model, "regressor": {"dropout": 0.1 if held_out else 0.0}},
            "data": {
                "workers": workers,
                "render_size": model.get("size", 256),
                "sources": [learnt, {**learnt, **measured, "validation": True}],
                "augmentation": {} if held_out else STILL,
            },
        }
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--held-out", action="store_true")
    parser.add_argument("--backbone", choices=("small", "resnet-50"), default="small")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--people", type=int, help=f"default {PEOPLE}, and 1024 held out")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--out", type=Path, help="keep the run here")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out = args.out or Path(temporary) / "run"
        config = configure(
            out,
            steps=args.steps,
            held_out=args.held_out,
            resnet50=args.backbone == "resnet-50",
            people=args.people or (1024 if args.held_out else PEOPLE),
            workers=args.workers,
        )
        trained = run_training(config, device=args.device)
        print(json.dumps(trained.report["errors"]), f"{trained.report['seconds']} s")


if __name__ == "__main__":
    main()
