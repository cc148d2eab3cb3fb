"""``partdr predict`` of a folder of pictures with their keypoints and part labels."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..errors import printable
from ..inputs.part_labels import read_photo
from ..inputs.photo_files import LeftOut
from .options import CameraOptions, people_at_a_time, say_people

if TYPE_CHECKING:
    from ..cameras import Perspective
    from ..inputs.sample import Sample


def predict_folder(
    folder: Path,
    labels: str | None,
    out: Path,
    network: Path | None,
    batch: int | None,
    device: str,
    view: CameraOptions,
) -> None:
    """Predict the body of the person of each picture.

    Args:
        folder: As ``read_folder`` wants it.
        labels: Name or file of the label set.
        out: Folder for the results.
        network: File of a label network; None: the packaged one.
        batch: People at a time; None: as the device likes.
        device: As the option says.
        view: The camera.
    """
    from ..body.labels import label_set
    from ..lab.evaluation.datasets import read_folder

    left_out = LeftOut()
    samples = list(read_folder(folder, None if labels is None else label_set(labels), left_out))
    if left_out:
        typer.echo(f"partdr: {left_out}", err=True)
    cameras = [_camera(view, sample) for sample in samples]

    from ..inputs.evidence import weigh_evidence
    from ..inputs.observation import crop_evidence, observe, usual_lens
    from ..interop.devices import choose_device
    from ..networks.regression.checkpoint import load_label_network
    from ..networks.regression.predict import predict_bodies
    from ..results.predictions import predict_files
    from ..results.result_sets import PREDICTIONS_REPORT, check_folder, replacing
    from ..results.save import image_size
    from .progress import PictureProgress

    where = choose_device(device)
    check_folder(out)
    together = people_at_a_time(batch, where)
    model = load_label_network(network, device=where)
    reading = predicting = 0.0
    first, _ = observe(samples[0].keypoints, samples[0].parts, others=samples[0].others, device=where)
    predict_bodies([first], model)  # what is set up once counts for no speed
    names = [{"file": f"{sample.name}.npz", "picture": printable(_file(sample).name)} for sample in samples]
    report: dict[str, Any] = {"network": None if network is None else str(network), "people": names}
    with PictureProgress(len(samples)) as progress, replacing(out, PREDICTIONS_REPORT, report) as temporary:
        for start in range(0, len(samples), together):
            some, theirs = samples[start : start + together], cameras[start : start + together]
            started = time.perf_counter()
            evidence = [weigh_evidence(sample.keypoints, sample.parts, sample.others)[0] for sample in some]
            if not view.given:
                theirs = [usual_lens(each) for each in evidence]
            pairs = zip(evidence, theirs, strict=True)
            seen = [crop_evidence(each, device=where, camera=camera) for each, camera in pairs]
            sizes = [image_size(sample.keypoints, sample.parts, None) for sample in some]
            read = time.perf_counter()
            files = predict_files(seen, sizes, model)
            reading, predicting = reading + read - started, predicting + time.perf_counter() - read
            for sample, each, file in zip(some, evidence, files, strict=True):
                file.save(temporary / f"{sample.name}.npz")
                for warning in each.warnings:
                    progress.say(f"partdr: warning: {sample.name}: {warning}")
            progress(_file(some[-1]).name, len(some))
    typer.echo(
        f"{say_people(len(samples))}: {len(samples) / predicting:.0f} a second through the network, "
        f"{len(samples) / (reading + predicting):.0f} a second with cropping; batches of {together}, {where}"
    )
    typer.echo(f"{out} holds a body of each: N.npz")


def _file(sample: Sample) -> Path:
    assert isinstance(sample.picture, Path)  # of a folder
    return sample.picture


def _camera(view: CameraOptions, sample: Sample) -> Perspective | None:
    """The camera of a sample's picture, if it is known."""
    if not view.given:
        return None
    return view.read(read_photo(_file(sample)).shape[:2], _file(sample))
