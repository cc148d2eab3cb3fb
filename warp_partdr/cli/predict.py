"""The command ``partdr predict``: bodies of people in one pass of the label network, without refinement."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ..errors import InputError
from ..networks.detection import MIN_SCORE
from .options import CameraOptions, DeviceOption, LabelsOption, LandmarksOption, MinScoreOption

PREDICT_HELP = """Say at once where bodies are: pose and measurements of people in photos and films, without
refinement. For many people; `partdr fit` starts with the same and goes on.

Examples: `partdr predict photo.jpg`; `partdr predict pictures`; `partdr predict film.mp4 --out bodies`

PATH is a photo, a film, or a folder of them. People are found, and followed through films, which need PyAV
(`pip install av`). Or it is a folder of N.jpg or N.png with your own N.keypoints.json and, for all or
none, N.parts.png: the largest person of each is taken; without --labels, labels.json there says what the labels are.
With --focal or --fov, one camera took all pictures, or with `--focal exif` each its own. Without, a usual lens is
assumed for each. Bodies stand in metres before the camera; with an assumed lens distances are rough.

**Results** in --out: N.personK.npz for each person of N.jpg, largest first, as body.npz of `partdr fit` (`partdr
register` clothes it); of a film, one with all frames of that person, most seen first; N.npz where keypoints were given;
predictions.json, which names them all. Older results of those names are replaced. What can't be read is told and left
out; the exit code is then 1.
"""


def predict(
    paths: Annotated[list[Path], Argument(help="Photos, films, or folders of them.", metavar="PATH")],
    labels: LabelsOption = None,
    out: Annotated[Path, Option(help="Folder for the bodies.", metavar="FOLDER")] = Path("out"),
    network: Annotated[
        Path | None,
        Option(help="A network of `partdr train`; by default the packaged one.", metavar="FILE.safetensors"),
    ] = None,
    person: Annotated[
        int | None, Option(help="Whom to take of each photo or film, 0 = first; default: all.", metavar="N")
    ] = None,
    min_score: MinScoreOption = None,
    landmarks: LandmarksOption = None,
    batch: Annotated[
        int | None, Option(help="People at a time in the network; default: 64, on a CPU 16.", metavar="N")
    ] = None,
    device: DeviceOption = "auto",
    *,
    view: CameraOptions,
) -> None:
    """Predict bodies; see ``PREDICT_HELP``."""
    from .predict_folder import predict_folder
    from .predict_found import Taken, predict_found

    if batch is not None and batch < 1:
        raise InputError(f"--batch: {batch}; expected 1 or more")
    described = [path for path in paths if path.is_dir() and any(path.glob("*.keypoints.json"))]
    if described:
        if len(paths) > 1:
            raise InputError(f"{described[0]}: a folder with keypoints, among others; expected it alone")
        for name, given in (("--person", person), ("--min-score", min_score), ("--landmarks", landmarks)):
            if given is not None:
                raise InputError(f"{name}: {given}, with a folder of keypoints; expected photos or films alone")
        predict_folder(described[0], labels, out, network, batch, device, view)
        return
    if labels is not None:
        raise InputError(f"--labels: {labels}, without a folder of keypoints; expected them with it")
    score, heavy = MIN_SCORE if min_score is None else min_score, landmarks == "heavy"
    predict_found(paths, out, network, device, view, Taken(person, score, batch, "heavy" if heavy else "full"))
