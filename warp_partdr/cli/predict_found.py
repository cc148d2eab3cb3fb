"""``partdr predict`` of photos and films alone: people are found by the packaged networks."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from ..errors import InputError, printable
from ..inputs.cuts import cuts_sentence
from ..inputs.films import FILM_SUFFIXES, check_pyav, film_facts, is_film
from ..inputs.frame_times import time_warnings, usual_rate
from ..inputs.part_labels import photo_warnings, read_photo
from ..inputs.photo_files import PHOTO_SUFFIXES, LeftOut, is_hidden_name, photos_among
from ..networks.detection import LandmarkNetwork
from .options import EXIF, CameraOptions, check_person, check_score, people_at_a_time, say_people

if TYPE_CHECKING:
    from ..cameras import Crop
    from ..inputs.observation import Observation
    from ..networks.detection.person import FoundPerson
    from ..networks.regression.label_network import LabelNetwork
    from .progress import PictureProgress

_PIXELS = 2**24  # of photos that are in memory at a time


@dataclass(frozen=True)
class Taken:
    """Options of whom to take.

    Attributes:
        person: The one of each photo or film, 0 = first; None: all.
        min_score: Least confidence that there is a person.
        batch: People in one pass of the network; None: as the device likes.
        landmarks: Network whose keypoints are taken.
    """

    person: int | None
    min_score: float
    batch: int | None
    landmarks: LandmarkNetwork = "full"

    def __post_init__(self) -> None:
        check_score("--min-score", self.min_score)
        check_person(self.person)


@dataclass(frozen=True)
class _Source:
    """A photo or film, and how its results are named."""

    path: Path
    name: str

    @property
    def film(self) -> bool:
        return is_film(self.path)

    @property
    def file(self) -> str:
        """The file's name as reports have it."""
        return printable(self.path.name)


@dataclass
class _Seen:
    """A person in a picture, before the network has looked; ``row`` is a film's, as far as it is known."""

    source: _Source
    number: int
    row: np.ndarray
    size: tuple[int, int]
    cut: tuple[Observation, Crop]


def predict_found(
    paths: Sequence[Path], out: Path, network: Path | None, device: str, view: CameraOptions, choice: Taken
) -> None:
    """Find people in photos and films, and predict their bodies.

    Args:
        paths: Photos, films, or folders of them.
        out: Folder for the results.
        network: File of a label network; None: the packaged one.
        device: As the option says.
        view: The camera.
        choice: Whom to take.
    """
    left_out = LeftOut()
    sources = _sources(paths, left_out)
    if left_out:
        typer.echo(f"partdr: {left_out}", err=True)
    total = _count(sources)
    _check_view(view, sources)

    from ..body.template import JOINT_NAMES
    from ..interop.devices import choose_device
    from ..networks.detection.person import SKELETON
    from ..networks.regression.checkpoint import load_label_network
    from ..results.result_sets import PREDICTIONS_REPORT, check_folder, replacing
    from .progress import PictureProgress

    where = choose_device(device)
    check_folder(out)
    report: dict[str, Any] = {"network": None if network is None else str(network)}
    report |= {"joints": list(JOINT_NAMES), "keypoints": SKELETON, "people": []}
    with PictureProgress(total) as progress, replacing(out, PREDICTIONS_REPORT, report) as temporary:
        model = load_label_network(network, device=where)
        run = _Run(temporary, model, view, choice, progress, where, alone=len(sources) == 1)
        started = time.perf_counter()
        for films, some in _grouped(sources):
            if films:
                for source in some:
                    run.film(source)
            else:
                run.photos(some)
        seconds = time.perf_counter() - started
        report |= {"people": run.people, "nobody_in": run.empty, "unreadable": run.failed, "cuts": run.cuts}
        if not run.people:
            raise InputError(run.complaint or f"nobody found in any of {len(sources)} files; expected people")
        if run.complaint:
            progress.say(f"partdr: {run.complaint}")
    passed = [f"{count} {kind}{'s' * (count > 1)}" for kind, count in run.passed.items() if count]
    speed = f"{sum(run.passed.values()) / seconds:.1f} a second"
    typer.echo(f"{say_people(len(run.people))} in {' and '.join(passed)}; {speed}, {where}")
    typer.echo(f"{out / PREDICTIONS_REPORT} names the files of their bodies")
    if run.failed:
        raise typer.Exit(1)


@dataclass
class _Run:
    """Bodies of the people that were seen so far; those of a batch wait for the network."""

    folder: Path
    model: LabelNetwork
    view: CameraOptions
    choice: Taken
    progress: PictureProgress
    device: str
    alone: bool  # whether there is one file only: then its fault is the command's
    people: list[dict[str, Any]] = field(default_factory=list)
    empty: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    complaint: str = ""
    cuts: dict[str, list[int]] = field(default_factory=dict)
    passed: Counter[str] = field(default_factory=Counter)
    _waiting: list[_Seen] = field(default_factory=list)
    _rows: dict[int, list[np.ndarray]] = field(default_factory=dict)  # of the present film, by track

    def photos(self, sources: Iterable[_Source]) -> None:
        """Take photos, as many at a time as memory should hold."""
        held: list[tuple[_Source, np.ndarray]] = []
        for source in sources:
            try:
                held.append((source, read_photo(source.path)))
                for warning in photo_warnings(source.path):
                    self.progress.say(f"partdr: warning: {source.path}: {warning}")
            except InputError as error:
                self._fail(source, error)
                self.progress(source.path.name)
            if sum(picture.size for _, picture in held) >= 3 * _PIXELS:
                self._take_photos(held)
                held = []
        self._take_photos(held)
        self._predict()

    def _take_photos(self, held: list[tuple[_Source, np.ndarray]]) -> None:
        from ..networks.detection.people import find_people_in

        pictures = [picture for _, picture in held]
        choice = self.choice
        everyone = find_people_in(pictures, device=self.device, min_score=choice.min_score, landmarks=choice.landmarks)
        for (source, picture), people in zip(held, everyone, strict=True):
            chosen = dict(enumerate(people))
            if not people:
                self._nobody(source, "nobody found in it")
            elif (wanted := self.choice.person) is not None:
                if wanted >= len(people):
                    self._nobody(source, f"no person {wanted}, but {say_people(len(people))} in it")
                chosen = {number: each for number, each in chosen.items() if number == wanted}
            self.passed["photo"] += 1
            try:
                self._add(source, picture, dict(enumerate(people)), set(chosen), 0, 0.0)
            except InputError as error:
                self._fail(source, error)
            self.progress(source.path.name)

    def film(self, source: _Source) -> None:
        """Take a film, frame by frame."""
        from ..networks.detection.film_people import follow_people, lasting, shots_between

        size, rate = (0, 0), 0.0
        times: list[float] = []
        guessed: list[bool] = []
        cuts: list[int] = []
        try:
            rate = film_facts(source.path).rate
            found_people = follow_people(
                source.path,
                rate,
                min_score=self.choice.min_score,
                device=self.device,
                landmarks=self.choice.landmarks,
            )
            for followed in found_people:
                frame, found = followed.frame, followed.people
                size = frame.picture.shape[:2]
                times.append(frame.time)
                guessed.append(frame.guessed)
                if followed.cut:
                    cuts.append(frame.index)
                self._add(source, frame.picture, found, set(found), frame.index, frame.time)
                self.passed["frame"] += 1
                self.progress(source.path.name)
        except InputError as error:
            self._fail(source, error)
        for warning in time_warnings(str(source.path), times, guessed, usual_rate(times, rate)):
            self.progress.say(f"partdr: warning: {warning}")
        self._predict()
        tracks, self._rows = [np.concatenate(rows) for rows in self._rows.values()], {}
        tracks = [rows for rows in tracks if lasting(rows["frames"], shots_between(cuts, len(times)))]
        if cuts:
            self.cuts[source.path.name] = cuts
            told = cuts_sentence(cuts, [times[cut] for cut in cuts])
            self.progress.say(f"partdr: warning: {source.path}: {told}, people numbered anew")
        if tracks:
            self._save_film(source, tracks, (size[0], size[1]))
        elif times:
            self._nobody(source, f"nobody found in {len(times)} frames")

    def _save_film(self, source: _Source, tracks: list[np.ndarray], size: tuple[int, int]) -> None:
        """Write a film's people, the most and largest seen first."""
        from ..networks.detection.film_people import areas
        from ..results.predictions import FilmBodies

        tracks.sort(key=lambda rows: -areas(rows["boxes"]).sum())
        wanted = self.choice.person
        if wanted is not None and wanted >= len(tracks):
            self._nobody(source, f"no person {wanted}, but {say_people(len(tracks))} in it")
        for number, rows in enumerate(tracks):
            if wanted in (None, number):
                file = f"{source.name}.person{number}.npz"
                FilmBodies(rows, size, self.view.given).save(self.folder / file)
                self.people.append(
                    {
                        "file": file,
                        "film": source.file,
                        "track": number,
                        "score": round(float(rows["scores"].mean()), 3),
                        "frames": len(rows),
                        "first_frame": int(rows["frames"][0]),
                        "last_frame": int(rows["frames"][-1]),
                        "first_time": round(float(rows["times"][0]), 6),
                        "last_time": round(float(rows["times"][-1]), 6),
                    }
                )

    def _add(
        self,
        source: _Source,
        picture: np.ndarray,
        found: Mapping[int, FoundPerson],
        chosen: set[int],
        frame: int,
        at: float,
    ) -> None:
        """Cut people out of a picture, who then wait for the network."""
        from ..inputs.cut_out import cut_out_people
        from ..inputs.evidence import PicturePerson
        from ..inputs.own_pixels import Mask
        from ..networks.detection.film_people import SEEN, seen_values
        from ..networks.detection.masks import instance_maps
        from ..results.predictions import ROW

        if not chosen:
            return
        size = (picture.shape[0], picture.shape[1])
        camera = self.view.read(size, None if source.film else source.path)
        (owners,) = instance_maps([list(found.values())], [size])
        masked = {
            number: PicturePerson(person.keypoints, Mask(owners, place), camera=camera)
            for place, (number, person) in enumerate(found.items(), start=1)
            if number in chosen
        }
        for number, cut in zip(masked, cut_out_people(list(masked.values()), self.device), strict=True):
            if isinstance(cut, InputError):
                raise cut
            row = np.zeros(1, ROW)
            for name, value in zip(SEEN, seen_values(found[number], frame, at), strict=True):
                row[name] = value
            self._waiting.append(_Seen(source, number, row, size, (cut.observation, cut.crop)))
            if len(self._waiting) >= people_at_a_time(self.choice.batch, self.device):
                self._predict()

    def _predict(self) -> None:
        """Ask the network about those who wait."""
        from ..results.predictions import predict_files

        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        files = predict_files([seen.cut for seen in waiting], [seen.size for seen in waiting], self.model)
        for seen, body in zip(waiting, files, strict=True):
            if seen.source.film:
                for name in set(seen.row.dtype.names or ()) & set(vars(body)):
                    seen.row[name] = getattr(body, name)
                self._rows.setdefault(seen.number, []).append(seen.row)
                continue
            file = f"{seen.source.name}.person{seen.number}.npz"
            body.save(self.folder / file)
            box = [round(float(edge), 1) for edge in seen.row["boxes"][0]]
            score = round(float(seen.row["scores"][0]), 3)
            self.people.append(
                {"file": file, "picture": seen.source.file, "person": seen.number, "score": score, "box": box}
            )

    def _nobody(self, source: _Source, told: str) -> None:
        self.empty.append(source.file)
        self._tell(f"{source.path}: {told}")

    def _fail(self, source: _Source, error: InputError) -> None:
        self.failed.append(source.file)
        self._tell(str(error) if str(error).startswith(str(source.path)) else f"{source.path}: {error}")

    def _tell(self, line: str) -> None:
        line = " ".join(line.split())
        if self.alone:
            self.complaint = self.complaint or line
        else:
            self.progress.say(f"partdr: {line}")


def _sources(paths: Sequence[Path], left_out: LeftOut) -> list[_Source]:
    """Photos and films, those of folders by name; two of one name are told apart by their endings."""
    files: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            there = _pictures(path, left_out)
            if not there:
                told = f"no photos or films in it{f' ({left_out})' if left_out else ''}"
                raise InputError(f"{path}: {told}; expected some: {', '.join(PHOTO_SUFFIXES)}, .mp4 ...")
            files |= dict.fromkeys(there)
        elif os.path.lexists(path):  # a pipe, too, which reading it tells
            files[path] = None
        else:
            raise InputError(f"{path}: No such file or folder; expected a photo, a film, or a folder of them")
    stems = Counter(path.stem for path in files)
    sources = [_Source(path, printable(path.stem if stems[path.stem] == 1 else path.name)) for path in files]
    for name, count in Counter(source.name for source in sources).items():
        if count > 1:
            raise InputError(f"{name}: in two of the folders; expected different names, or one folder at a time")
    return sources


def _pictures(folder: Path, left_out: LeftOut) -> list[Path]:
    """Photos and films in a folder, but not in folders in it."""
    names: list[str] = []
    for each in sorted(folder.iterdir()):
        if not each.is_dir():
            names.append(each.name)
        elif not is_hidden_name(each.name):
            left_out.count("folder", "folders are not searched")
    return [folder / name for name in photos_among(names, left_out, FILM_SUFFIXES)]


def _count(sources: Iterable[_Source]) -> int | None:
    """Photos and frames in all; None where a film does not tell."""
    total = 0
    for source in sources:
        if not source.film:
            total += 1
            continue
        check_pyav(source.path)
        try:
            frames = film_facts(source.path).frames
        except InputError:
            continue  # told when its turn comes
        if not frames:
            return None
        total += frames
    return total


def _check_view(view: CameraOptions, sources: Sequence[_Source]) -> None:
    """Find faults of the options before people are looked for."""
    if view.focal == EXIF and (films := [source.path for source in sources if source.film]):
        raise InputError(f"--focal: exif, with {films[0]}, a film; expected pixels, or --fov")
    view.check()


def _grouped(sources: Iterable[_Source]) -> Iterator[tuple[bool, list[_Source]]]:
    """Photos together first, then films."""
    ordered = {film: [source for source in sources if source.film == film] for film in (False, True)}
    yield from ((film, some) for film, some in ordered.items() if some)
