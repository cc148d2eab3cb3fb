"""Command ``partdr scene``: the motion of all people in films of several cameras."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ..errors import InputError
from ..inputs.films import film_facts
from ..networks.detection import MIN_SCORE
from .fit_film import RigOptions, check_film_view, fit_films
from .options import (
    CameraOptions,
    DeviceOption,
    NetworkOptions,
    OutOption,
    RunSettings,
    SettingOptions,
    check_person,
    check_score,
)

SCENE_HELP = """Fit motions to all people in films of several cameras. A second view measures depth.

Examples: `partdr scene left.mp4 right.mp4`; `partdr scene left.jpg right.jpg`; for one person and four calibrated
cameras, `partdr scene cam*.mp4 --cameras calibration/ --person 0`

Films (or photos) must start at the same moment; otherwise `--align` finds their common start. Their rates may differ or
vary, because frames are matched by their times. People are matched between the films by the points where rays meet.

**Cameras** must stand still. --cameras takes a file or a folder of Pose2Sim, Anipose, FreeMoCap, Caliscope, OpenCV,
EasyMocap, MC-Calib, Kalibr or Qualisys, or a JSON file of this project (docs/inputs.md), in metres. A camera belongs to
the film with its name or number (cam1 to cam1_sync.mp4); without such names, cameras are in the order of the films.
Distortion is removed. Without --cameras, the positions of the cameras are found from the people. Then give a person's
height, `--set stature=1.78` (metres), or distances follow from the sizes that people seem to have.

Results are those of `partdr fit film.mp4`, in the frame of the first film's camera, with an overlay of each film. If a
run was ended, the same command continues it. **Settings** for --set and --config are the same, too: `window=64`,
`overlap=12`, `smoothing=0.15` seconds, `mesh.iterations=60`, and more.
"""


@dataclass(frozen=True, kw_only=True)
class SceneRequest:
    """Arguments and options of ``partdr scene``.

    Raises:
        InputError: If one is wrong whatever the films show, or the file of settings can't be read.
    """

    films: Annotated[list[Path], Argument(help="Films of the same moments.", metavar="FILM...", show_default=False)]
    out: OutOption = Path("out")
    person: Annotated[
        int | None,
        Option(
            help="Index of the only person to fit, 0 = the largest and in most frames; default: all people.",
            metavar="N",
        ),
    ] = None
    model: Annotated[str, Option(help="Detailed model: anny, or a model's file.", metavar="NAME")] = "anny"
    min_score: Annotated[float, Option(help="Least confidence that there is a person.", metavar="SHARE")] = MIN_SCORE
    device: DeviceOption = "auto"
    rig: RigOptions
    view: CameraOptions
    networks: NetworkOptions
    settings: SettingOptions

    def __post_init__(self) -> None:
        _ = self.run
        check_score("--min-score", self.min_score)
        if len({film.resolve() for film in self.films}) < len(self.films):
            raise InputError("FILM: the same one twice; expected films of different cameras")
        if self.rig.cameras is not None and self.view.given:
            raise InputError(f"--focal, --fov, --principal: with --cameras {self.rig.cameras}; expected one of them")
        check_person(self.person)
        check_film_view(self.view, self.films)
        self.networks.check()

    @cached_property
    def run(self) -> RunSettings:
        """Settings, which are read once."""
        return self.settings.read_run()

    @property
    def score(self) -> float:
        """Least confidence that there is a person."""
        return self.min_score


def scene(request: SceneRequest) -> None:
    """Fit motions; see ``SCENE_HELP``."""
    for film in request.films:
        film_facts(film)  # raises faults of the file before anything is loaded
    fit_films(request.films, request, request.rig)
