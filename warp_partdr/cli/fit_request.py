"""Request of ``partdr fit``: its arguments and options, which are checked once and passed on as one object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from ..errors import InputError
from ..networks.detection import MIN_SCORE
from .options import (
    BareOption,
    CameraOptions,
    DeviceOption,
    MinScoreOption,
    NetworkOptions,
    OutOption,
    PhotoFiles,
    RunSettings,
    SettingOptions,
    check_person,
    check_score,
)
from .register import MODEL_HELP

if TYPE_CHECKING:
    from ..solve.ellipsoids.options import FitOptions

# The same names as the keys of ``solve.ellipsoids.stages.STAGES``, which is not loaded for --help.
StartName = StrEnum("StartName", ["network", "search"])
QualityName = StrEnum("QualityName", ["fast", "balanced", "accurate"])

# These texts name the default themselves; typer would add a line for each.
_MODEL_HELP = f"Detailed model: {MODEL_HELP}; none skips it. Default: anny."
_QUALITY_HELP = (
    "Quality: fast, balanced (default) or accurate, whose mesh stage takes three times as long "
    "(docs/measured/speed_and_accuracy.md)."
)
_START_HELP = "Start: network (default; if it ends far from the keypoints, a search follows) or search."


@dataclass(frozen=True, kw_only=True)
class FitRequest:
    """Arguments and options of ``partdr fit``.

    Raises:
        InputError: If one is wrong whatever the picture shows, or the file of settings can't be read.
    """

    files: PhotoFiles
    photo: Annotated[
        Path | None, Argument(help="Photo or film. With --keypoints, it may be left out.", metavar="PHOTO")
    ] = None
    out: OutOption = Path("out")
    model: Annotated[str, Option(help=_MODEL_HELP, metavar="NAME", show_default=False)] = "anny"
    quality: Annotated[QualityName, Option(help=_QUALITY_HELP, metavar="NAME", show_default=False)] = (
        QualityName.balanced
    )
    start: Annotated[StartName, Option(help=_START_HELP, metavar="NAME", show_default=False)] = StartName.network
    min_score: MinScoreOption = None
    device: DeviceOption = "auto"
    explain: Annotated[bool, Option("--explain", help="First print what is modelled, what is left out, and why.")] = (
        False
    )
    bare: BareOption = False
    view: CameraOptions
    settings: SettingOptions

    def __post_init__(self) -> None:
        _ = self.run
        check_score("--min-score", self.score)
        check_person(self.files.person)

    @cached_property
    def run(self) -> RunSettings:
        """Settings, which are read once."""
        return self.settings.read_run()

    @property
    def person(self) -> int | None:
        """Index of the only person to fit."""
        return self.files.person

    @property
    def networks(self) -> NetworkOptions:
        """Networks of others."""
        return self.files.networks

    @property
    def score(self) -> float:
        """Least confidence that there is a person."""
        return MIN_SCORE if self.min_score is None else self.min_score

    def fit_options(self) -> FitOptions:
        """Options of the fit: those of the quality and the start, changed by the settings and the camera's options.

        Raises:
            InputError: If a setting is wrong.
        """
        from ..solve.ellipsoids.options import FitOptions
        from ..solve.ellipsoids.settings import change_options

        options = FitOptions.at(self.quality.value, self.start.value)  # type: ignore[arg-type]
        options = change_options(options, self.run.fit)
        if options.network is not None and self.start is StartName.search:
            raise InputError(
                f"network: {options.network}, with --start search, which has none; expected one of the two"
            )
        return replace(options, guess_camera=False) if self.view.refused else options

    def options_before_mesh(self) -> FitOptions:
        """Options of a fit that the mesh stage goes on from, which excludes the outline stage: it would cost joints.

        Raises:
            InputError: If that stage was asked for, or another setting is wrong.
        """
        from ..solve.ellipsoids.stages import OUTLINE

        options = self.fit_options()
        if OUTLINE in self.run.fit:
            fault = f"{OUTLINE}: settings of a stage that costs joints, and that the mesh stage replaces"
            raise InputError(f"{fault}; expected --keypoints, --parts and --model none with it")
        return options
