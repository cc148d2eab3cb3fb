"""The command ``partdr scene``: the motion of everyone whom several calibrated cameras filmed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ..detection import MIN_SCORE
from ..errors import InputError
from ..inputs.films import film_facts
from .fit_film import FilmRun, fit_films
from .options import DeviceOption, NetworkOptions, OutOption, SettingOptions, check_score

SCENE_HELP = """Fit motions to everyone in films of several cameras: with a second view, depth is no guess.

Examples: `partdr scene left.mp4 right.mp4 --cameras Calib.toml`; one person of four films, `partdr scene cam*.mp4
--cameras calibration/ --person 0`

Films show the same moments, frame by frame; who is who in them is found by where rays meet. **Cameras** stand still:
Pose2Sim's Calib.toml, OpenCV's YAML or JSON (a file, or a folder of them), or a JSON of ours (docs/inputs.md). Each is
of the film of its name (cam1.mp4 of cam1), else they are in the films' order. Distortion is taken away.

Results are those of `partdr fit film.mp4`, in the frame of the first film's camera, with an overlay of each film; a
run that was ended goes on where it was. **Settings** for --set and --config are the same: `window=64`, `overlap=12`,
`smoothing=0.15` seconds, `mesh.iterations=40`, and more.
"""


def scene(
    films: Annotated[list[Path], Argument(help="Films of the same moments.", metavar="FILM...", show_default=False)],
    cameras: Annotated[Path, Option(help="The calibrated cameras.", metavar="FILE", show_default=False)],
    out: OutOption = Path("out"),
    person: Annotated[
        int | None, Option(help="Whom alone, 0 = the most and largest seen; default: everyone.", metavar="N")
    ] = None,
    model: Annotated[str, Option(help="Detailed body: anny, or a model's file.", metavar="NAME")] = "anny",
    min_score: Annotated[float, Option(help="Least confidence that there is a person.", metavar="SHARE")] = MIN_SCORE,
    device: DeviceOption = "auto",
    *,
    networks: NetworkOptions,
    settings: SettingOptions,
) -> None:
    """Fit motions; see ``SCENE_HELP``."""
    values, score = settings.read(), check_score("--min-score", min_score)
    if len({film.resolve() for film in films}) < len(films):
        raise InputError("FILM: the same one twice; expected films of different cameras")
    networks.check()
    for film in films:
        film_facts(film)  # faults of the files are told before anything is loaded
    fit_films(FilmRun(tuple(films), out, device, model, person, score, values, networks, cameras=cameras))
