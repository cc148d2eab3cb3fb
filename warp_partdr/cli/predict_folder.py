"""``partdr predict`` of a folder of pictures with their keypoints and part labels."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..errors import InputError, printable
from ..inputs.part_labels import read_photo
from ..inputs.photo_files import LeftOut
from .options import CameraOptions, people_at_a_time, say_people

if TYPE_CHECKING:
    from ..cameras import Perspective
    from ..inputs.cut_people import CutPerson
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

    from ..inputs.cut_out import cut_out_people
    from ..inputs.evidence import PicturePerson
    from ..inputs.observation import observe
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
            some = samples[start : start + together]
            people = [
                PicturePerson(sample.keypoints, sample.parts, sample.others, camera)
                for sample, camera in zip(some, cameras[start : start + together], strict=True)
            ]
            started = time.perf_counter()
            cut = list(map(_usable, cut_out_people(people, where, probabilities=True)))
            sizes = [image_size(sample.keypoints, sample.parts, None) for sample in some]
            read = time.perf_counter()
            files = predict_files([(each.observation, each.crop) for each in cut], sizes, model)
            reading, predicting = reading + read - started, predicting + time.perf_counter() - read
            for sample, each, file in zip(some, cut, files, strict=True):
                file.save(temporary / f"{sample.name}.npz")
                for warning in each.evidence.warnings:
                    progress.say(f"partdr: warning: {sample.name}: {warning}")
            progress(_file(some[-1]).name, len(some))
    typer.echo(
        f"{say_people(len(samples))}: {len(samples) / predicting:.0f} a second through the network, "
        f"{len(samples) / (reading + predicting):.0f} a second with cropping; batches of {together}, {where}"
    )
    typer.echo(f"{out} holds a body of each: N.npz")


def _usable(cut: CutPerson | InputError) -> CutPerson:
    """A person who could be cut out.

    Raises:
        InputError: The person's, if not.
    """
    if isinstance(cut, InputError):
        raise cut
    return cut


def _file(sample: Sample) -> Path:
    assert isinstance(sample.picture, Path)  # of a folder
    return sample.picture


def _camera(view: CameraOptions, sample: Sample) -> Perspective | None:
    """The camera of a sample's picture: a usual one if it is not known, but the picture's size is."""
    from ..cameras import UsualLens

    if not view.given:
        size = sample.keypoints.image_size if sample.parts is None else sample.parts.groups.shape
        return None if size is None else UsualLens.of_size((size[0], size[1]))
    return view.read(read_photo(_file(sample)).shape[:2], _file(sample))
