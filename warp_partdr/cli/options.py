"""Options that commands share, and dataclasses of options as parameters of a command."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args, get_type_hints

from typer import Option, echo

from ..errors import InputError, shown
from ..files.sections import read_toml, set_value
from ..inputs.films import is_photo
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
from ..networks.detection import MIN_SCORE, PackagedParts

if TYPE_CHECKING:
    import numpy as np

    from ..cameras import Perspective
    from ..networks.predictors.networks import KeypointNetwork, PartNetwork

EXIF, NO_CAMERA = "exif", "none"  # values of --focal beside numbers

DeviceOption = Annotated[
    str, Option("--device", help="Device: cpu, cuda, or auto (CUDA if there is some).", metavar="NAME")
]
OutOption = Annotated[Path, Option("--out", help="Folder for the results.", metavar="FOLDER")]
LabelsOption = Annotated[
    str | None,
    Option(
        "--labels", help="Label set, or its JSON file; default: labels.json beside the part labels.", metavar="NAME"
    ),
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
    Option(help="Network that finds joints: full (default), or heavy (slower, nearer to the truth).", metavar="NAME"),
]
BareOption = Annotated[
    bool,
    Option("--bare", help="Show skin. By default bodies wear a plain T-shirt and shorts, in pictures and mesh files."),
]
SetOption = Annotated[
    list[str] | None, Option("--set", help="Change a setting. May be given several times.", metavar="KEY=VALUE")
]


@dataclass(frozen=True)
class SettingOptions:
    """Options --config and --set."""

    config: Annotated[Path | None, Option(help="TOML file of settings; --set overrides them.", metavar="FILE")] = None
    overrides: SetOption = None

    def read(self) -> dict[str, Any]:
        """Read the given settings as nested tables."""
        values = {} if self.config is None else read_toml(self.config, str(self.config), "a .toml file")
        for override in self.overrides or ():
            set_value(values, override)
        return values

    def read_run(self) -> RunSettings:
        """Read the settings of a run, and check those that are not of the fit.

        Raises:
            InputError: If one is wrong, or is an option instead of a setting.
        """
        values = self.read()
        if "min_score" in values:
            raise InputError(f"min_score: {shown(values['min_score'])}, as a setting; expected the option --min-score")
        return RunSettings(take_whole(values, "threads"), take_formats(values), values)


@dataclass(frozen=True)
class RunSettings:
    """Settings of a run of ``partdr fit`` or ``partdr scene``.

    Attributes:
        threads: Number of CPU threads; 0: one a core.
        formats: Formats of further files of detailed bodies.
        fit: Settings of the fit's options, in nested tables.
    """

    threads: int
    formats: tuple[str, ...]
    fit: Mapping[str, Any]


# The same names as in ``results.further_files.FURTHER``, which is not loaded for --help.
BodyFormat = StrEnum("BodyFormat", ["usda", "usdz", "fbx"])
_ALSO = "also"


def take_formats(values: dict[str, Any]) -> tuple[str, ...]:
    """Take the formats of further files of detailed bodies out of settings: ``also=usdz,fbx``, or a list."""
    given = values.pop(_ALSO, ())
    names = given.split(",") if isinstance(given, str) else given
    if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{_ALSO}: {shown(given)}; expected of {', '.join(BodyFormat)}")
    return check_further([name.strip() for name in names], _ALSO)


def check_further(given: Sequence[str] | None, option: str = "--to") -> tuple[str, ...]:
    """Formats of further files of detailed bodies, each once; raises InputError if one can't be written here."""
    formats = tuple(dict.fromkeys(str(name) for name in given or ()))
    if formats:
        from ..results.further_files import check_formats

        check_formats(option, formats)
    return formats


def take_whole(values: dict[str, Any], name: str) -> int:
    """Take a whole number of 0 or more out of settings; 0 if it is missing."""
    value = values.pop(name, 0)
    if type(value) is not int or value < 0:
        raise InputError(f"{name}: {shown(value)}; expected 0 or more")
    return value


def check_score(name: str, value: Any) -> float:
    """Check the least confidence that there is a person, which the option ``name`` gave."""
    if type(value) not in (int, float) or not 0 <= value < 1:
        raise InputError(f"{name}: {shown(value)}; expected 0 to below 1")
    return float(value)


def check_person(person: int | None) -> None:
    """Raise an InputError if --person is negative."""
    if person is not None and person < 0:
        raise InputError(f"--person: {person}; expected 0 or more")


def people_at_a_time(batch: int | None, device: str) -> int:
    """Option --batch of networks, with its default. It is smaller on a CPU, whose caches hold less."""
    return batch or (16 if device == "cpu" else 64)


def count_people(count: int) -> str:
    """Count people in words."""
    return "1 person" if count == 1 else f"{count} people"


def read_photo_with_warnings(photo: Path) -> np.ndarray:
    """Read a photo by ``read_photo``, and print warnings about its file on stderr."""
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
            help="Joints of the person in the picture, found by a network or by you: JSON, or OpenPose's folder.",
            metavar="FILE",
        ),
    ] = None
    keypoint_format: Annotated[
        str | None,
        Option(
            "--format",
            help="Format of the keypoints, such as coco17, if the file does not name it; or its JSON file.",
            metavar="NAME",
        ),
    ] = None
    parts: Annotated[
        Path | None, Option(help="Part labels, .png or .npy: ids, masks or probabilities.", metavar="FILE")
    ] = None
    labels: LabelsOption = None
    person: Annotated[
        int | None, Option(help="Index of the person to take, 0 = first; default: the largest.", metavar="N")
    ] = None

    def keypoint_file(self, photo: Path | None) -> Path:
        """File of keypoints; from a folder, the photo's file."""
        if self.keypoints is None:
            raise InputError("--keypoints: missing; expected the person's 2D keypoints, FILE.json")
        return keypoint_file(self.keypoints, photo)

    def read(self, photo: Path | None) -> PersonInputs:
        """Read the person, and the picture if there is one; raise InputError if the files don't fit each other."""
        keypoints = self.keypoint_file(photo)
        picture = None if photo is None else read_photo_with_warnings(photo)
        parts = read_labelled_parts(self.parts, self.labels)
        groups = None if parts is None else parts.groups
        sizes = [None if image is None else image.shape[:2] for image in (picture, groups)]
        check_sizes(photo=sizes[0], parts=sizes[1])
        people = read_keypoints(keypoints, self.keypoint_format, photo=photo, size=sizes[0] or sizes[1])
        chosen = choose_person(people, groups, self.person)
        check_inside(chosen, sizes[0] or sizes[1])
        others = tuple(other for other in people if other is not chosen)
        chosen = replace(chosen, image_size=sizes[0] or sizes[1])
        return PersonInputs(chosen, others, parts, picture)


PartsFromOption = Annotated[
    str | None,
    Option(
        help="Source of part labels: packaged (the default for photos), mask (the whole body), none (keypoints "
        "alone), or a network: a folder, or hf:ORG/NAME.",
        metavar="NAME",
    ),
]
KeypointsFromOption = Annotated[
    str | None,
    Option(
        help="Network that finds keypoints: a folder or hf:ORG/NAME; or POSE+BOXES, with a network that finds people.",
        metavar="NAME",
    ),
]


@dataclass(frozen=True)
class LoadedNetworks:
    """Networks that were asked for, or the name of the packaged one; None for one that was not asked for."""

    parts_from: PartNetwork | PackagedParts | None
    keypoints_from: KeypointNetwork | None


@dataclass(frozen=True)
class NetworkOptions:
    """Options for networks from other projects, and the meaning of their results."""

    parts_from: PartsFromOption = None
    keypoints_from: KeypointsFromOption = None
    labels: Annotated[
        str | None,
        Option(help="Label set of the network for part labels, if its classes don't name it.", metavar="NAME"),
    ] = None
    keypoint_format: Annotated[
        str | None,
        Option("--format", help="Format of the network for keypoints, if it doesn't name it.", metavar="NAME"),
    ] = None

    @property
    def given(self) -> bool:
        """True if there is a network."""
        return (self.parts_from, self.keypoints_from) != (None, None)

    @property
    def _part_network(self) -> str | None:
        """Network for parts that is not the packaged one."""
        return None if self.parts_from in get_args(PackagedParts) else self.parts_from

    @property
    def files(self) -> list[Path]:
        """Files in the user's own folders of networks; their times show if a network has changed."""
        from ..networks.predictors.checkpoints import split_names

        given = (self._part_network, *((None,) if self.keypoints_from is None else split_names(self.keypoints_from)))
        folders = [Path(name).expanduser() for name in given if name is not None]
        return [path for folder in folders if folder.is_dir() for path in sorted(folder.glob("*.*")) if path.is_file()]

    def check(self, instead: str = "") -> None:
        """Raise an InputError if there is an option for a network, but no network.

        ``instead`` names another option that would also take the option.
        """
        for name, given, other, network in (
            ("--format", self.keypoint_format, "--keypoints-from", self.keypoints_from),
            ("--labels", self.labels, "--parts-from", self._part_network),
        ):
            if given is not None and network is None:
                wanted = f"{instead} or {other}; expected one of them with it" if instead else f"{other}; expected both"
                raise InputError(f"{name}: {given}, without {wanted}")

    def check_film(self) -> None:
        """Raise an InputError if a network is given that films do not take, such as one that finds people."""
        from ..networks.predictors.checkpoints import split_names

        if self.keypoints_from is not None and split_names(self.keypoints_from)[1] is not None:
            raise InputError(
                f"--keypoints-from: {self.keypoints_from}, for a film, whose people the packaged detector follows; "
                "expected keypoints alone"
            )
        if self.parts_from in ("packaged", "none"):
            raise InputError(
                f"--parts-from: {self.parts_from}, for a film, which has masks so far; expected mask or a network"
            )

    def load(self, device: str) -> LoadedNetworks:
        """Load the networks that were asked for."""
        from ..networks.predictors.checkpoints import load_keypoint_network, load_part_network

        parts_from: PartNetwork | PackagedParts | None = cast("PackagedParts | None", self.parts_from)
        keypoints_from = None
        if self._part_network is not None:
            parts_from = load_part_network(self._part_network, self.labels, device=device, say=echo)
        if self.keypoints_from is not None:
            form = self.keypoint_format
            keypoints_from = load_keypoint_network(self.keypoints_from, form, device=device, say=echo)
        return LoadedNetworks(parts_from, keypoints_from)


@dataclass(frozen=True)
class PhotoFiles(PersonFiles):
    """Options for the files of one person, or for networks that find the people of a photo."""

    person: Annotated[
        int | None,
        Option(
            help="Index of the person to fit, 0 = first; default: all people, or with --keypoints the largest.",
            metavar="N",
        ),
    ] = None
    parts_from: PartsFromOption = None
    keypoints_from: KeypointsFromOption = None

    @property
    def networks(self) -> NetworkOptions:
        """Options of the networks."""
        return NetworkOptions(self.parts_from, self.keypoints_from, self.labels, self.keypoint_format)

    def read(self, photo: Path | None) -> PersonInputs:
        """Read the person's files; raise InputError if a network is given, too."""
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
            help="Focal length of the lens [px]; exif: read it from the photo's file; none: no perspective. Default: "
            "exif in `partdr fit` and `scene`, if the photo has it; else a usual lens, as long as the longer side of "
            "the picture.",
            metavar="PX",
        ),
    ] = None
    fov: Annotated[
        float | None,
        Option(help="Field of view from left to right, instead of --focal.", metavar="DEGREES"),
    ] = None
    principal: Annotated[
        str | None, Option(help="Pixel on the axis of the lens; default: the middle.", metavar="U,V")
    ] = None

    @property
    def given(self) -> bool:
        """True if any of the options was given."""
        return (self.focal, self.fov, self.principal) != (None, None, None)

    @property
    def refused(self) -> bool:
        """True if there must be no camera, not even a usual lens."""
        return self.focal == NO_CAMERA

    def check(self) -> None:
        """Raise an InputError, before any picture is read, if the options are wrong for any size of the picture."""
        if self.given and self.focal not in (EXIF, NO_CAMERA):
            alone = self.focal is None and self.fov is None
            replace(self, principal=self.principal if alone else None).read((480, 640), None)

    def check_films(self, films: Sequence[Path]) -> None:
        """Raise an InputError if the options don't fit films, or photos among them."""
        if self.focal == EXIF and not all(map(is_photo, films)):
            raise InputError("--focal: exif, with a film; expected pixels, or --fov")
        self.check()

    def read(self, size: tuple[int, int], photo: PhotoFile | None) -> Perspective | None:
        """Make the camera of a picture of (H, W) pixels, which may be a photo; None if no option was given."""
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
        """Make the camera as ``read`` does. Without options, the photo's EXIF data give it, and a line says so."""
        if self.given or photo is None or (focal := exif_focal_length(photo)) is None:
            return self.read(size, photo)
        echo(f"partdr: focal length {focal:.0f} px, of the photo's EXIF data; --focal none to do without", err=True)
        from ..cameras import Perspective  # loads torch

        return Perspective.of_picture(size, focal=focal)

    def _focal(self, photo: PhotoFile | None) -> float | None:
        """Return the focal length [px] that was given."""
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


def distance_words(metres: float, *, exact: bool, assumed: bool) -> str:
    """Words about a person's distance.

    Args:
        metres: Distance from the camera [m].
        exact: False: the words say "about".
        assumed: True: the words say that a usual lens is assumed, because no focal length is known.
    """
    lens = " (the lens is assumed)" if assumed else ""
    return f"{'' if exact else 'about '}{metres:.1f} m away{lens}"


def confidence_words(report: Mapping[str, Any]) -> str:
    """Words about the confidence in a body, and the limbs that are guessed, from ``confidence_record``'s entries."""
    words = f"confidence {report['confidence']:.2f}"
    return f"{words}, guessed: {' and '.join(report['guessed'])}" if report["guessed"] else words


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Make a command for Typer from a function that takes dataclasses: each of their fields becomes an option.

    Args:
        command: Function to call. Fields may be dataclasses of options, too. The annotation and the default of any
            other field are those of an option.
    """

    def run(**given: Any) -> None:
        _call_with(command, given)

    run.__signature__ = inspect.Signature(list(_options_of(command)))  # type: ignore[attr-defined]
    run.__annotations__ = {}
    run.__name__, run.__doc__ = command.__name__, command.__doc__
    return run


def _options_of(function: Callable[..., Any]) -> Iterator[inspect.Parameter]:
    """Parameters of a function or a dataclass. A parameter that is a dataclass is replaced by that one's parameters."""
    kinds = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        if is_dataclass(kinds[name]):
            yield from _options_of(kinds[name])
        else:
            yield parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=kinds[name])


def _call_with(function: Callable[..., Any], given: Mapping[str, Any]) -> Any:
    """Call a function with options by their names; its dataclasses are made from them."""
    kinds = get_type_hints(function)
    arguments = {
        name: _call_with(kinds[name], given) if is_dataclass(kinds[name]) else given[name]
        for name in inspect.signature(function).parameters
    }
    return function(**arguments)
