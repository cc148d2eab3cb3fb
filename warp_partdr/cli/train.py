"""Command ``partdr train``: train a network, on one processor, many GPUs or many machines."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from ..errors import InputError
from .options import DeviceOption, SetOption

TRAIN_HELP = """Train a network: label-network, parts, ellipbodynet, or a config of your own (see
docs/how_to/train_a_network.md).

* **label-network** makes the network that fits start from: part labels and keypoints in, a body out. It learns from
  synthetic people.
* **parts** makes the part head, which says which part each pixel of a photo shows. It learns from shaded people before
  pictures. The packaged landmark network, whose features it looks at, stays as it is. parts-smoke is a try of a minute.
* **ellipbodynet** makes the paper's network: a picture in, a body out. It learns from data sets, which you bring.

Examples:

* `partdr train label-network --out out/net` trains on the GPU, or on the CPU if there is no GPU
* `partdr train label-network --out out/net --resume` continues from the newest checkpoint
* `partdr train label-network --minutes 30 --set batch_size=512` trains for half an hour, in smaller batches
* `partdr train parts --out out/head --backgrounds PHOTOS` puts your pictures behind people; nobody may be seen in them
* `torchrun --nproc-per-node 4 -m warp_partdr train label-network` or `accelerate launch -m warp_partdr train ...` train
  on several GPUs, with batch_size samples on each

CONFIG is the name of a packaged config, or a .toml file with the same keys. `--set steps=1000 --set data.KEY=...`
changes single keys.

**Results** in FOLDER are model.safetensors (the trained network: the running mean of the weights), report.json (errors,
time, machine, config), checkpoints/step-N, pictures/step-N.png (held-out samples), log.jsonl, and tensorboard
(`tensorboard --logdir FOLDER`). Ctrl-C and SIGTERM first write a checkpoint. If the loss is NaN, the run stops, and
nan-batch.safetensors holds the batch that led to it.
"""


def train_network(
    config: Annotated[str, Argument(help="Name of a packaged config, or a file.", metavar="CONFIG")],
    out: Annotated[
        Path | None, Option(help="Folder for all results; default: the one in the config.", metavar="FOLDER")
    ] = None,
    resume: Annotated[
        bool, Option("--resume", help="Continue from FOLDER's newest checkpoint. Give the same options again.")
    ] = False,
    minutes: Annotated[
        float | None,
        Option(
            help="Stop after M minutes, with those of resumed runs. The learning rate falls until then.", metavar="M"
        ),
    ] = None,
    settings: SetOption = None,
    backgrounds: Annotated[
        Path | None,
        Option(
            help="For parts: folder of pictures in which nobody is seen, to stand behind people; default: "
            "scikit-image's sample pictures, or noise if it is not installed.",
            metavar="FOLDER",
        ),
    ] = None,
    bits: Annotated[
        int | None,
        Option(help="Bits of each weight in the trained network's file: 32, 16 or 8; default: 16 for parts, else 32."),
    ] = None,
    device: DeviceOption = "auto",
) -> None:
    """Train; see ``TRAIN_HELP``."""
    from ..lab.training.config import read_config

    if device not in ("auto", "cpu", "cuda"):
        raise InputError(f"--device: {device}; expected auto, cpu or cuda (CUDA_VISIBLE_DEVICES chooses the GPU)")
    overrides = list(settings or ())
    if out is not None:
        overrides.append(f"out={_quoted(out)}")
    if minutes is not None:
        overrides.append(f"minutes={minutes}")
    if backgrounds is not None:
        overrides.append(f"data.backgrounds={_quoted(backgrounds)}")
    numbers = read_config(config, overrides)

    from ..interop.devices import choose_device
    from ..lab.training.loop import MODEL_FILE, run_training

    result = run_training(numbers, resume=resume, device=choose_device(device), bits=bits)
    report = result.report
    if report:
        for name in report["skipped"]:
            typer.echo(f"skipped: {name}", err=True)
        if result.stopped is not None:
            typer.echo(f"stopped at step {result.step}; --resume goes on from there", err=True)
    if result.stopped is not None:
        raise typer.Exit(128 + result.stopped)
    if not report:
        return  # the first process prints for all
    errors = ", ".join(f"{name} {value:.4g}" for name, value in report["errors"].items())
    speed = f"{report['samples_per_second']:,.0f} samples/s"
    typer.echo(f"{result.step} steps, {report['seconds']:.0f} s, {speed}; {errors}")
    typer.echo(f"{numbers.out / MODEL_FILE} holds the network, {numbers.out / 'report.json'} the figures")


def _quoted(path: Path) -> str:
    """A path as a text of TOML, which escapes characters as JSON does."""
    return json.dumps(str(path), ensure_ascii=False)
