"""Command ``partdr predict``: bodies of people in one pass of the label network, without refinement."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from ..errors import InputError, printable
from ..inputs.part_labels import read_photo
from ..inputs.photo_files import LeftOut
from ..networks.detection import MIN_SCORE
from .options import (
    EXIF,
    CameraOptions,
    DeviceOption,
    LabelsOption,
    LandmarksName,
    LandmarksOption,
    MinScoreOption,
    check_person,
    check_score,
    count_people,
    people_at_a_time,
)

if TYPE_CHECKING:
    from ..bulk.named_files import NamedFile
    from ..bulk.predict import PeoplePredictor
    from ..cameras import Perspective
    from ..inputs.sample import Sample

PREDICT_HELP = """Predict pose and measurements of people in photos and films in one pass, without refinement. This is
fast enough for many people; `partdr fit` starts with the same prediction and refines it.

Examples: `partdr predict photo.jpg`; `partdr predict pictures`; `partdr predict film.mp4 --out bodies`

PATH is a photo, a film, or a folder of them. People are found, and are followed through films, which need PyAV
(`pip install av`). Or PATH is a folder of N.jpg or N.png with your own N.keypoints.json and, for all pictures or none,
N.parts.png: then the largest person of each picture is taken, and --labels, or labels.json in the folder, describes the
labels. With --focal or --fov, one camera took all pictures; with `--focal exif`, each picture has its own. Bodies then
have positions before the camera in metres. Without a camera, a usual lens is assumed if keypoints were given, and
distances are rough; people who are found have a camera of weak perspective.

**Results** in --out are N.personK.npz for each person of N.jpg, largest first, in the format of body.npz of `partdr
fit` (`partdr register` makes a detailed body of it). For a film, each of these files holds all frames of a person; the
person in most frames is the first. If keypoints were given, the file is N.npz. predictions.json lists all files. Older
results with these names are replaced. Files that can't be read are reported and left out, and the exit code is then 1.
"""


@dataclass(frozen=True, kw_only=True)
class PredictRequest:
    """Arguments and options of ``partdr predict``.

    Raises:
        InputError: If one is wrong whatever the pictures show.
    """

    paths: Annotated[list[Path], Argument(help="Photos, films, or folders of them.", metavar="PATH")]
    labels: LabelsOption = None
    out: Annotated[Path, Option(help="Folder for the bodies.", metavar="FOLDER")] = Path("out")
    network: Annotated[
        Path | None,
        Option(help="Network that `partdr train` wrote; default: the packaged one.", metavar="FILE.safetensors"),
    ] = None
    person: Annotated[
        int | None,
        Option(help="Index of the person to take in each photo or film, 0 = first; default: all.", metavar="N"),
    ] = None
    min_score: MinScoreOption = None
    landmarks: LandmarksOption = None
    batch: Annotated[int | None, Option(help="Number of people at a time; default: 64, on a CPU 16.", metavar="N")] = (
        None
    )
    device: DeviceOption = "auto"
    view: CameraOptions

    def __post_init__(self) -> None:
        if self.batch is not None and self.batch < 1:
            raise InputError(f"--batch: {self.batch}; expected 1 or more")
        if self.described is not None:
            if len(self.paths) > 1:
                raise InputError(f"{self.described}: a folder with keypoints, among others; expected it alone")
            for name in ("person", "min_score", "landmarks"):
                if (given := getattr(self, name)) is not None:
                    option = f"--{name.replace('_', '-')}"
                    raise InputError(f"{option}: {given}, with a folder of keypoints; expected photos or films alone")
            return
        if self.labels is not None:
            raise InputError(f"--labels: {self.labels}, without a folder of keypoints; expected them with it")
        check_score("--min-score", self.score)
        check_person(self.person)

    @property
    def described(self) -> Path | None:
        """Folder with keypoints among the paths; None if there is none."""
        return next((path for path in self.paths if path.is_dir() and any(path.glob("*.keypoints.json"))), None)

    @property
    def score(self) -> float:
        """Least confidence that there is a person."""
        return MIN_SCORE if self.min_score is None else self.min_score

    def report(self) -> dict[str, Any]:
        """Return the beginning of ``predictions.json``."""
        return {"network": None if self.network is None else str(self.network)}

    def predictor(self, device: str) -> PeoplePredictor:
        """Load the networks that find people and predict their bodies to a device."""
        from ..bulk.batches import FindRule
        from ..bulk.cutting import Cutter
        from ..bulk.predict import PeoplePredictor
        from ..networks.regression.checkpoint import load_label_network

        return PeoplePredictor(
            load_label_network(self.network, device=device),
            device,
            people_at_a_time(self.batch, device),
            FindRule(self.score, "heavy" if self.landmarks is LandmarksName.HEAVY else "full"),
            Cutter(person=self.person),
        )


def predict(request: PredictRequest) -> None:
    """Predict bodies; see ``PREDICT_HELP``."""
    if request.described is None:
        _predict_files(request)
    else:
        _predict_folder(request, request.described)


def _predict_files(request: PredictRequest) -> None:
    """Find people in photos and films, and predict their bodies."""
    from ..bulk.named_files import count_pictures, named_files

    left_out = LeftOut()
    files = named_files(request.paths, left_out)
    if left_out:
        typer.echo(f"partdr: {left_out}", err=True)
    total = count_pictures(files)
    _check_view(request.view, files)

    from ..body.template import JOINT_NAMES
    from ..bulk.predict import predict_files
    from ..interop.devices import choose_device
    from ..networks.detection.person import SKELETON
    from ..results.result_sets import PREDICTIONS_REPORT, check_folder, replacing
    from .progress import PictureProgress

    where = choose_device(request.device)
    check_folder(request.out)
    report = request.report() | {"joints": list(JOINT_NAMES), "keypoints": SKELETON, "people": []}
    with PictureProgress(total) as progress, replacing(request.out, PREDICTIONS_REPORT, report) as temporary:
        predictor = request.predictor(where)
        started = time.perf_counter()
        found = predict_files(
            files,
            predictor,
            request.view.read,
            temporary,
            passed=progress,
            say=lambda line: progress.say(f"partdr: {line}"),
        )
        seconds = time.perf_counter() - started
        report |= found.report()
    counts = {"photo": found.photos, "frame": found.frames}
    passed = [f"{count} {name}{'s' * (count > 1)}" for name, count in counts.items() if count]
    speed = f"{sum(counts.values()) / seconds:.1f} a second"
    typer.echo(f"{count_people(len(found.people))} in {' and '.join(passed)}; {speed}, {where}")
    typer.echo(f"{request.out / PREDICTIONS_REPORT} names the files of their bodies")
    if found.unreadable:
        raise typer.Exit(1)


def _check_view(view: CameraOptions, files: Sequence[NamedFile]) -> None:
    """Raise an InputError for wrong options before people are searched."""
    if view.focal == EXIF and (films := [file.path for file in files if file.is_film]):
        raise InputError(f"--focal: exif, with {films[0]}, a film; expected pixels, or --fov")
    view.check()


def _predict_folder(request: PredictRequest, folder: Path) -> None:
    """Predict the body of one person for each picture in a folder with keypoints."""
    from ..body.labels import label_set
    from ..lab.evaluation.datasets import read_folder

    left_out = LeftOut()
    labels = None if request.labels is None else label_set(request.labels)
    samples = list(read_folder(folder, labels, left_out))
    if left_out:
        typer.echo(f"partdr: {left_out}", err=True)
    cameras = [_camera(request.view, sample) for sample in samples] if request.view.given else None

    from ..bulk.predict import predict_samples
    from ..interop.devices import choose_device
    from ..results.result_sets import PREDICTIONS_REPORT, check_folder, replacing
    from .progress import PictureProgress

    where = choose_device(request.device)
    check_folder(request.out)
    predictor = request.predictor(where)
    names = [{"file": f"{sample.name}.npz", "picture": printable(_file(sample).name)} for sample in samples]
    report = request.report() | {"people": names}
    with PictureProgress(len(samples)) as progress, replacing(request.out, PREDICTIONS_REPORT, report) as temporary:
        speeds = predict_samples(
            samples,
            cameras,
            predictor,
            temporary,
            passed=progress,
            say=lambda line: progress.say(f"partdr: {line}"),
        )
    typer.echo(
        f"{count_people(len(samples))}: {speeds.network:.0f} a second through the network, "
        f"{speeds.whole:.0f} a second with cropping; batches of {predictor.batch}, {where}"
    )
    typer.echo(f"{request.out} holds a body of each: N.npz")


def _file(sample: Sample) -> Path:
    assert isinstance(sample.picture, Path)  # of a folder
    return sample.picture


def _camera(view: CameraOptions, sample: Sample) -> Perspective | None:
    """Make the camera of a sample's picture."""
    return view.read(read_photo(_file(sample)).shape[:2], _file(sample))
