"""Options that commands share, and dataclasses of options as parameters of a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from typer import Option, echo

from ..errors import InputError, shown
from ..files.sections import read_toml, set_value
from ..inputs.keypoint_files import keypoint_file, read_keypoints
from ..inputs.keypoints import choose_person
from ..inputs.part_labels import (
    PhotoFile,
    check_sizes,
    exif_focal_length,
    photo_warnings,
    read_focal,
    read_labelled_parts,
    read_photo,
)
from ..inputs.person import PersonInputs, check_inside
from ..networks.detection import MIN_SCORE

if TYPE_CHECKING:
    import numpy as np

    from ..cameras import Perspective
    from ..networks.predictors.networks import KeypointNetwork, PartNetwork

EXIF, NO_CAMERA = "exif", "none"  # values of --focal beside numbers

DeviceOption = Annotated[str, Option("--device", help="cpu or cuda; auto: CUDA where there is some.", metavar="NAME")]
OutOption = Annotated[Path, Option("--out", help="Folder for the results.", metavar="FOLDER")]
LabelsOption = Annotated[
    str | None, Option("--labels", help="Label set, or its JSON file; default: labels.json there.", metavar="NAME")
]
MinScoreOption = Annotated[
    float | None,
    Option(help=f"Least confidence that there is a person, 0 to 1; default: {MIN_SCORE}.", metavar="SHARE"),
]


class LandmarksName(StrEnum):
    """Names of ``LandmarkNetwork``, for the command line."""

    FULL = "full"
    HEAVY = "heavy"


LandmarksOption = Annotated[
    LandmarksName | None,
    Option(
        help="Network that finds the joints: full (default), or heavy, slower and nearer to the truth.", metavar="NAME"
    ),
]
SetOption = Annotated[
    list[str] | None, Option("--set", help="Change one setting; may be given again.", metavar="KEY=VALUE")
]


@dataclass(frozen=True)
class SettingOptions:
    """The options --config and --set."""

    config: Annotated[Path | None, Option(help="Settings as TOML; --set goes before them.", metavar="FILE")] = None
    overrides: SetOption = None

    def read(self) -> dict[str, Any]:
        """Nested tables of what was given."""
        values = {} if self.config is None else read_toml(self.config, str(self.config), "a .toml file")
        for override in self.overrides or ():
            set_value(values, override)
        return values

    def read_run(self) -> RunSettings:
        """Settings of a run, checked as far as they are of no fit; an InputError for what is an option instead."""
        values = self.read()
        if "min_score" in values:
            raise InputError(f"min_score: {shown(values['min_score'])}, as a setting; expected the option --min-score")
        return RunSettings(take_whole(values, "threads"), take_formats(values), values)


@dataclass(frozen=True)
class RunSettings:
    """Settings of a run of ``partdr fit`` or ``partdr scene``.

    Attributes:
        threads: Number of CPU threads; 0: one a core.
        formats: Formats of more files of detailed bodies.
        fit: Settings of the fit's options, in nested tables.
    """

    threads: int
    formats: tuple[str, ...]
    fit: Mapping[str, Any]


# As ``results.further_files.FURTHER``, which is not loaded for --help.
BodyFormat = StrEnum("BodyFormat", ["usda", "usdz", "fbx"])
_ALSO = "also"


def take_formats(values: dict[str, Any]) -> tuple[str, ...]:
    """Take the formats of more files of detailed bodies out of settings: ``also=usdz,fbx``, or a list."""
    given = values.pop(_ALSO, ())
    names = given.split(",") if isinstance(given, str) else given
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{_ALSO}: {shown(given)}; expected of {', '.join(BodyFormat)}")
    return check_further([name.strip() for name in names], _ALSO)


def check_further(given: Sequence[str] | None, option: str = "--to") -> tuple[str, ...]:
    """Formats of more files of detailed bodies, each once; an InputError if one can't be written here."""
    formats = tuple(dict.fromkeys(str(name) for name in given or ()))
    if formats:
        from ..results.further_files import check_formats

        check_formats(option, formats)
    return formats


def take_whole(values: dict[str, Any], name: str) -> int:
    """Take a whole number of 0 or more out of settings, 0 where it is missing."""
    value = values.pop(name, 0)
    if type(value) is not int or value < 0:
        raise InputError(f"{name}: {shown(value)}; expected 0 or more")
    return value


def check_score(name: str, value: Any) -> float:
    """A least confidence that there is a person, as the option of this name gave it."""
    if type(value) not in (int, float) or not 0 <= value < 1:
        raise InputError(f"{name}: {shown(value)}; expected 0 to below 1")
    return float(value)


def check_person(person: int | None) -> None:
    """Raise an InputError for a --person whom no picture has."""
    if person is not None and person < 0:
        raise InputError(f"--person: {person}; expected 0 or more")


def people_at_a_time(batch: int | None, device: str) -> int:
    """The option --batch of networks; a CPU's caches hold less."""
    return batch or (16 if device == "cpu" else 64)


def say_people(count: int) -> str:
    """Count people in words."""
    return "1 person" if count == 1 else f"{count} people"


def read_shown_photo(photo: Path) -> np.ndarray:
    """A photo's picture, as of ``read_photo``; warnings about its file go to stderr."""
    picture = read_photo(photo)
    for warning in photo_warnings(photo):
        echo(f"partdr: warning: {photo}: {warning}", err=True)
    return picture


@dataclass(frozen=True)
class PersonFiles:
    """Options for the files of one person."""

    keypoints: Annotated[
        Path | None,
        Option(
            help="The person's joints in the picture, as a network or you found them: JSON, or OpenPose's folder.",
            metavar="FILE",
        ),
    ] = None
    keypoint_format: Annotated[
        str | None,
        Option(
            "--format",
            help="Which joints the keypoints are, such as coco17, if the file does not say; or a JSON file.",
            metavar="NAME",
        ),
    ] = None
    parts: Annotated[
        Path | None, Option(help="Part labels, .png or .npy: ids, masks, probabilities.", metavar="FILE")
    ] = None
    labels: LabelsOption = None
    person: Annotated[int | None, Option(help="Whom to take, 0 = first; default: the largest.", metavar="N")] = None

    def keypoint_file(self, photo: Path | None) -> Path:
        """The file of keypoints, a photo's one of a folder."""
        if self.keypoints is None:
            raise InputError("--keypoints: missing; expected the person's 2D keypoints, FILE.json")
        return keypoint_file(self.keypoints, photo)

    def read(self, photo: Path | None) -> PersonInputs:
        """The person, and the picture if there is one; an InputError if the files don't fit each other."""
        keypoints = self.keypoint_file(photo)
        picture = None if photo is None else read_shown_photo(photo)
        parts = read_labelled_parts(self.parts, self.labels)
        groups = None if parts is None else parts.groups
        sizes = [None if seen is None else seen.shape[:2] for seen in (picture, groups)]
        check_sizes(photo=sizes[0], parts=sizes[1])
        people = read_keypoints(keypoints, self.keypoint_format, photo=photo, size=sizes[0] or sizes[1])
        chosen = choose_person(people, groups, self.person)
        check_inside(chosen, sizes[0] or sizes[1])
        others = tuple(other for other in people if other is not chosen)
        chosen = replace(chosen, image_size=sizes[0] or sizes[1])
        return PersonInputs(chosen, others, parts, picture)


PartsFromOption = Annotated[str | None, Option(help="Network for part labels: folder or hf:ORG/NAME.", metavar="NAME")]
KeypointsFromOption = Annotated[
    str | None, Option(help="Network for keypoints, likewise; or POSE+BOXES.", metavar="NAME")
]


@dataclass(frozen=True)
class LoadedNetworks:
    """Networks of others; None where none was asked for."""

    parts_from: PartNetwork | None
    keypoints_from: KeypointNetwork | None


@dataclass(frozen=True)
class NetworkOptions:
    """Options for networks of others, and what their results mean."""

    parts_from: PartsFromOption = None
    keypoints_from: KeypointsFromOption = None
    labels: Annotated[
        str | None, Option(help="Label set of the part network, where its classes do not tell.", metavar="NAME")
    ] = None
    keypoint_format: Annotated[
        str | None, Option("--format", help="Of the other's keypoints, likewise.", metavar="NAME")
    ] = None

    @property
    def given(self) -> bool:
        """True if there is a network."""
        return (self.parts_from, self.keypoints_from) != (None, None)

    @property
    def files(self) -> list[Path]:
        """Files in the user's own folders of networks, by whose times it is seen that they are the same."""
        from ..networks.predictors.checkpoints import split_names

        given = (self.parts_from, *((None,) if self.keypoints_from is None else split_names(self.keypoints_from)))
        folders = [Path(name).expanduser() for name in given if name is not None]
        return [path for folder in folders if folder.is_dir() for path in sorted(folder.glob("*.*")) if path.is_file()]

    def check(self, instead: str = "") -> None:
        """Raise an InputError if something was said of a network that is not there; ``instead`` would also take it."""
        for name, given, other, network in (
            ("--format", self.keypoint_format, "--keypoints-from", self.keypoints_from),
            ("--labels", self.labels, "--parts-from", self.parts_from),
        ):
            if given is not None and network is None:
                wanted = f"{instead} or {other}; expected one of them with it" if instead else f"{other}; expected both"
                raise InputError(f"{name}: {given}, without {wanted}")

    def check_film(self) -> None:
        """Raise an InputError if a network is to find the people, which films have none for."""
        from ..networks.predictors.checkpoints import split_names

        if self.keypoints_from is not None and split_names(self.keypoints_from)[1] is not None:
            raise InputError(
                f"--keypoints-from: {self.keypoints_from}, for a film, whose people the packaged detector follows; "
                "expected keypoints alone"
            )

    def load(self, device: str) -> LoadedNetworks:
        """Load the networks that were asked for."""
        from ..networks.predictors.checkpoints import load_keypoint_network, load_part_network

        parts_from, keypoints_from = None, None
        if self.parts_from is not None:
            parts_from = load_part_network(self.parts_from, self.labels, device=device, say=echo)
        if self.keypoints_from is not None:
            form = self.keypoint_format
            keypoints_from = load_keypoint_network(self.keypoints_from, form, device=device, say=echo)
        return LoadedNetworks(parts_from, keypoints_from)


@dataclass(frozen=True)
class PhotoFiles(PersonFiles):
    """Options for the files of one person, or for networks that see the people of a photo."""

    person: Annotated[
        int | None, Option(help="Whom, 0 = first; default: all, of keypoints the largest.", metavar="N")
    ] = None
    parts_from: PartsFromOption = None
    keypoints_from: KeypointsFromOption = None

    @property
    def networks(self) -> NetworkOptions:
        """The networks alone."""
        return NetworkOptions(self.parts_from, self.keypoints_from, self.labels, self.keypoint_format)

    def read(self, photo: Path | None) -> PersonInputs:
        """The person of the files, of whom no network is asked."""
        for name, given in (("--parts-from", self.parts_from), ("--keypoints-from", self.keypoints_from)):
            if given is not None:
                raise InputError(f"{name}: {given}, with --keypoints; expected a photo alone")
        return super().read(photo)


@dataclass(frozen=True)
class CameraOptions:
    """Options for the picture's camera."""

    focal: Annotated[
        str | None,
        Option(
            help="Focal length of the lens [px]; exif: as the photo's file says; none: no perspective. Default: exif "
            "in `partdr fit` and `scene` if the photo has it; else a usual lens, as long as the picture's longer side.",
            metavar="PX",
        ),
    ] = None
    fov: Annotated[
        float | None,
        Option(help="Instead of --focal: how wide the picture looks, from left to right.", metavar="DEGREES"),
    ] = None
    principal: Annotated[
        str | None, Option(help="Pixel that the lens's axis goes through; default: the middle.", metavar="U,V")
    ] = None

    @property
    def given(self) -> bool:
        """True if anything was said."""
        return (self.focal, self.fov, self.principal) != (None, None, None)

    @property
    def refused(self) -> bool:
        """True if there is to be no camera, not even a usual lens."""
        return self.focal == NO_CAMERA

    def check(self) -> None:
        """Raise an InputError for what is at fault whatever the picture's size, before any picture is read."""
        if self.given and self.focal not in (EXIF, NO_CAMERA):
            alone = self.focal is None and self.fov is None
            replace(self, principal=self.principal if alone else None).read((480, 640), None)

    def read(self, size: tuple[int, int], photo: PhotoFile | None) -> Perspective | None:
        """The camera of a picture of (H, W) pixels, which may be a photo; None if nothing was said."""
        if self.focal is None and self.fov is None:
            if self.principal is not None:
                raise InputError("--principal: alone; expected --focal or --fov, too")
            return None
        if self.focal == NO_CAMERA:
            if (self.fov, self.principal) != (None, None):
                raise InputError("--focal: none, with --fov or --principal; expected it alone")
            return None
        from ..cameras import Perspective  # loads torch

        principal = None
        if self.principal is not None:
            try:
                u, v = map(float, self.principal.split(","))
            except ValueError:
                raise InputError(f"--principal: {shown(self.principal)}; expected two numbers, U,V") from None
            principal = (u, v)
        focal = self._focal(photo)
        try:
            return Perspective.of_picture(size, focal=focal, fov=self.fov, principal=principal)
        except ValueError as error:
            raise InputError(f"--{error}") from None

    def of_photo(self, size: tuple[int, int], photo: PhotoFile | None) -> Perspective | None:
        """The camera as ``read`` has it or, where nothing was said, as the photo's EXIF data tell it, which is said."""
        if self.given or photo is None or (focal := exif_focal_length(photo)) is None:
            return self.read(size, photo)
        echo(f"partdr: focal length {focal:.0f} px, of the photo's EXIF data; --focal none to do without", err=True)
        from ..cameras import Perspective  # loads torch

        return Perspective.of_picture(size, focal=focal)

    def _focal(self, photo: PhotoFile | None) -> float | None:
        """The focal length [px] that was given."""
        if self.focal is None:
            return None
        if self.focal == EXIF:
            if photo is None:
                raise InputError("--focal: exif, without a photo; expected one")
            return read_focal(photo)
        try:
            return float(self.focal)
        except ValueError:
            raise InputError(f"--focal: {shown(self.focal)}; expected pixels, exif or none") from None


def say_distance(metres: float, *, sure: bool, assumed: bool) -> str:
    """Words on how far away somebody is; ``assumed``: for a usual lens, as no focal length is known."""
    lens = " (the lens is assumed)" if assumed else ""
    return f"{'' if sure else 'about '}{metres:.1f} m away{lens}"


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Make a command for Typer of a function that takes dataclasses: each of their fields becomes an option.

    Args:
        command: The function. Fields may be dataclasses of options, too. The annotation and the default of any other
            field are those of an option.
    """

    def run(**given: Any) -> None:
        _call_with(command, given)

    run.__signature__ = inspect.Signature(list(_options_of(command)))  # type: ignore[attr-defined]
    run.__annotations__ = {}
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    return run


def _options_of(function: Callable[..., Any]) -> Iterator[inspect.Parameter]:
    """Parameters of a function or a dataclass; those of a dataclass stand in its parameter's place."""
    kinds = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        if is_dataclass(kinds[name]):
            yield from _options_of(kinds[name])
        else:
            yield parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kinds[name])


def _call_with(function: Callable[..., Any], given: Mapping[str, Any]) -> Any:
    """Call a function with options by their names, of which those of dataclasses are made."""
    kinds = get_type_hints(function)
    arguments = {
        name: _call_with(kinds[name], given) if is_dataclass(kinds[name]) else given[name]
        for name in inspect.signature(function).parameters
    }
    return function(**arguments)
