"""Request of ``partdr scene``: its arguments and options, which are checked once and passed on as one object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ..errors import InputError
from ..networks.detection import MIN_SCORE
from .options import (
    BareOption,
    CameraOptions,
    DeviceOption,
    NetworkOptions,
    OutOption,
    RunSettings,
    SettingOptions,
    check_person,
    check_score,
)


@dataclass(frozen=True)
class RigOptions:
    """Options for the cameras of films, and their clocks."""

    cameras: Annotated[
        Path | None,
        Option(help="File or folder of calibrated cameras; default: they are found from the people.", metavar="FILE"),
    ] = None
    align: Annotated[bool, Option("--align", help="Find the frames that show the same moment.")] = False


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
    bare: BareOption = False
    settings: SettingOptions

    def __post_init__(self) -> None:
        _ = self.run
        check_score("--min-score", self.min_score)
        if len({film.resolve() for film in self.films}) < len(self.films):
            raise InputError("FILM: the same one twice; expected films of different cameras")
        if self.rig.cameras is not None and self.view.given:
            raise InputError(f"--focal, --fov, --principal: with --cameras {self.rig.cameras}; expected one of them")
        check_person(self.person)
        self.view.check_films(self.films)
        self.networks.check()

    @cached_property
    def run(self) -> RunSettings:
        """Settings, which are read once."""
        return self.settings.read_run()

    @property
    def score(self) -> float:
        """Least confidence that there is a person."""
        return self.min_score
