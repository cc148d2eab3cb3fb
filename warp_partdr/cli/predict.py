"""The command ``partdr predict``: bodies of a folder's people in one pass of the label network, without refinement."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from ..errors import InputError
from ..inputs.part_labels import read_photo
from .options import CameraOptions, DeviceOption, LabelsOption

if TYPE_CHECKING:
    from ..cameras import Perspective
    from ..inputs.sample import Sample

PREDICT_HELP = """Say at once where bodies are: 2D keypoints and part labels in, pose and measurements out, without
refinement. For many people; `partdr fit` starts with the same and goes on.

Example: `partdr predict pictures --labels cdcl14 --out bodies`

FOLDER holds N.jpg or N.png, N.keypoints.json and, for all or none, N.parts.png; the largest person of each picture is
taken. Without --labels, labels.json in the folder says what the part labels are. With --focal or --fov, one camera took
all pictures, or with `--focal exif` each its own, and bodies stand in metres before it.

**Results** in --out: N.npz for each picture, as body.npz of `partdr fit` (`partdr register` clothes it), and
predictions.json, which names them. Older results of those names are replaced.
"""


def predict(
    folder: Annotated[Path, Argument(help="Pictures, keypoints and part labels.", metavar="FOLDER")],
    labels: LabelsOption = None,
    out: Annotated[Path, Option(help="Folder for the bodies.", metavar="FOLDER")] = Path("out"),
    network: Annotated[
        Path | None,
        Option(help="A network of `partdr train`; by default the packaged one.", metavar="FILE.safetensors"),
    ] = None,
    batch: Annotated[int, Option(help="People at a time.", metavar="N")] = 64,
    device: DeviceOption = "auto",
    *,
    view: CameraOptions,
) -> None:
    """Predict bodies; see ``PREDICT_HELP``."""
    from ..body.labels import label_set
    from ..evaluation.datasets import read_folder

    if batch < 1:
        raise InputError(f"--batch: {batch}; expected 1 or more")
    samples = list(read_folder(folder, None if labels is None else label_set(labels)))
    cameras = [_camera(view, sample) for sample in samples]

    import torch

    from ..body.lens import find_camera, turn_to_rays
    from ..inputs.evidence import weigh_evidence
    from ..inputs.observation import REFERENCE_SIZE, crop_evidence, observe
    from ..interop.devices import choose_device
    from ..network.checkpoint import load_label_network
    from ..network.predict import predict_bodies
    from ..results.result_sets import PREDICTIONS_REPORT, check_folder, replacing
    from ..results.save import body_file, image_size
    from .progress import FitProgress

    where = choose_device(device)
    check_folder(out)
    model = load_label_network(network, device=where)
    reading = predicting = 0.0
    told: list[str] = []
    first, _ = observe(samples[0].keypoints, samples[0].parts, others=samples[0].others, device=where)
    predict_bodies([first], model)  # what is set up once counts for no speed
    report = {"network": None if network is None else str(network), "people": len(samples)}
    with FitProgress() as progress, replacing(out, PREDICTIONS_REPORT, report) as temporary:
        for start in range(0, len(samples), batch):
            some, theirs = samples[start : start + batch], cameras[start : start + batch]
            started = time.perf_counter()
            evidence = [weigh_evidence(sample.keypoints, sample.parts, sample.others)[0] for sample in some]
            pairs = zip(evidence, theirs, strict=True)
            seen = [crop_evidence(each, device=where, camera=camera) for each, camera in pairs]
            read = time.perf_counter()
            bodies = predict_bodies([observation for observation, _ in seen], model)
            bodies.shift.sum().item()  # waits for the device
            reading, predicting = reading + read - started, predicting + time.perf_counter() - read
            for i, (sample, (observation, crop)) in enumerate(zip(some, seen, strict=True)):
                body, lens = bodies.select(torch.tensor([i], device=where)), observation.lens
                if lens is not None:
                    body = turn_to_rays(body, lens)
                camera, pelvis = find_camera(body, lens, REFERENCE_SIZE)
                size = image_size(sample.keypoints, sample.parts, None)
                place = None if pelvis is None else pelvis[0]
                body_file(body, camera.in_full(crop), size, place).save(temporary / f"{sample.name}.npz")
            for sample, each in zip(some, evidence, strict=True):
                told += [f"partdr: warning: {sample.name}: {warning}" for warning in each.warnings]
            progress("predicting", start + len(some), len(samples))
    for line in told:
        typer.echo(line, err=True)
    people = f"{len(samples)} people" if len(samples) > 1 else "1 person"
    typer.echo(
        f"{people}: {len(samples) / predicting:.0f} a second through the network, "
        f"{len(samples) / (reading + predicting):.0f} a second with cropping; batches of {batch}, {where}"
    )
    typer.echo(f"{out} holds a body of each: N.npz")


def _camera(view: CameraOptions, sample: Sample) -> Perspective | None:
    """The camera of a sample's picture, if it is known."""
    if not view.given:
        return None
    assert isinstance(sample.picture, Path)  # of a folder
    return view.read(read_photo(sample.picture).shape[:2], sample.picture)
