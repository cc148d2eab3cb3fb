"""Bodies that the label network says at once of people in photos, in films, and of samples, written as files.

People are found, cut out and worked on by ``batches``, as those of a data set are; nothing is refined.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..cameras import Perspective, UsualLens
from ..errors import InputError
from ..inputs.cut_out import cut_out_people
from ..inputs.cut_people import CutPeople, CutPerson, batch_people
from ..inputs.cuts import cuts_sentence
from ..inputs.evidence import PicturePerson
from ..inputs.films import film_facts
from ..inputs.frame_times import time_warnings, usual_rate
from ..inputs.part_labels import photo_warnings, read_photo
from ..inputs.sample import Sample
from ..networks.detection.film_people import areas, follow_people, lasting, shots_between
from ..networks.detection.masks import instance_maps
from ..networks.regression.label_network import LabelNetwork
from ..results.body_file import BodyFile
from ..results.predictions import ROW, FilmBodies, predict_arrays
from ..results.save import image_size
from .batches import (
    FindRule,
    group_rows,
    known_person,
    made_by,
    people_pool,
    people_threads,
    pictures_at_a_time,
    with_found_people,
)
from .cutting import Cut, Cutter, Held
from .named_files import NamedFile
from .rows import FILE_WARNINGS, PeopleRows, Row, RowPart, Values
from .sources import SourcePicture

PictureCamera = Callable[[tuple[int, int], Path | None], Perspective | None]
SECONDS = "seconds"  # column of a person's share of the time that the network took

_BODY = ("global_orient", "translation", "rotations", "lengths", "thicknesses", "camera_scale", "camera_translation")


@dataclass(frozen=True)
class PeoplePredictor:
    """Predictor of everyone in pictures: it finds people, and asks the label network about them.

    Attributes:
        network: Label network on the device, in evaluation mode.
        device: Device, "cpu" or a CUDA device.
        batch: Number of people whom the network is asked about at a time.
        rule: Rule by which people are found.
        cutter: Cuts people out of pictures.
    """

    network: LabelNetwork
    device: str = "cpu"
    batch: int = 16
    rule: FindRule = field(default_factory=FindRule)
    cutter: Cutter = field(default_factory=Cutter)

    @property
    def workers(self) -> int:
        """Threads that find people and ask the network."""
        return people_threads(self.device)

    def find(self, pictures: Sequence[SourcePicture]) -> list[SourcePicture]:
        """Pictures with their people, found in one batch."""
        return with_found_people(pictures, self.rule, self.device)

    def bodies(self, people: CutPeople) -> list[RowPart]:
        """Bodies of people, in one batch: columns as in ``body.npz``, warnings, and ``SECONDS``."""
        began = time.perf_counter()
        arrays = predict_arrays(people, self.network)
        seconds = np.full(len(people), (time.perf_counter() - began) / len(people))
        columns: dict[str, Values] = {**arrays, "warnings": people.warnings, SECONDS: seconds}
        return [RowPart(np.arange(len(people)), columns)]


@dataclass
class Predictions:
    """Bodies of people in photos and films.

    Attributes:
        people: A file of a body each: its name, and facts about the person.
        nobody_in: Names of files in which nobody was found, or not the person who was asked for.
        unreadable: Names of files that can't be read, or only in part.
        cuts: First frames of all shots but the first, of films that have any.
        photos: Number of photos that were looked at.
        frames: Number of frames of films.
    """

    people: list[dict[str, Any]] = field(default_factory=list)
    nobody_in: list[str] = field(default_factory=list)
    unreadable: list[str] = field(default_factory=list)
    cuts: dict[str, list[int]] = field(default_factory=dict)
    photos: int = 0
    frames: int = 0

    def report(self) -> dict[str, Any]:
        """Entries of ``predictions.json``."""
        names = ("people", "nobody_in", "unreadable", "cuts")
        return {name: getattr(self, name) for name in names}


def predict_files(
    files: Sequence[NamedFile],
    predictor: PeoplePredictor,
    camera: PictureCamera,
    folder: Path,
    *,
    passed: Callable[[str], None],
    say: Callable[[str], None],
) -> Predictions:
    """Find people in photos and films, predict their bodies, and write a file of each person.

    Args:
        files: Photos and films; the photos come first.
        predictor: Fitter with a ``cutter`` that says who alone is wanted.
        camera: Camera of a picture by its (H, W) and, of a photo, its file.
        folder: Folder for the files.
        passed: Called with the file's name for each photo and frame.
        say: Called with a line for each warning and fault.

    Raises:
        InputError: If nobody is found in any of the files.
    """
    with people_pool(predictor) as pool:
        run = _Run(predictor, camera, folder, pool, passed, say, alone=len(files) == 1)
        run.photos([file for file in files if not file.is_film])
        for file in files:
            if file.is_film:
                run.film(file)
    if not run.found.people:
        raise InputError(run.complaint or f"nobody found in any of {len(files)} files; expected people")
    if run.complaint:
        say(run.complaint)
    return run.found


@dataclass
class _Run:
    """Predictions as they come; of a file that is alone, the first fault may be the whole run's."""

    predictor: PeoplePredictor
    camera: PictureCamera
    folder: Path
    pool: ThreadPoolExecutor
    passed: Callable[[str], None]
    say: Callable[[str], None]
    alone: bool
    found: Predictions = field(default_factory=Predictions)
    complaint: str = ""

    def photos(self, photos: Sequence[NamedFile]) -> None:
        """Take photos, some at a time."""
        paths = {photo.name: photo.path for photo in photos}
        work = self._with_camera(lambda name, size: self.camera(size, paths[name]))
        size = pictures_at_a_time(self.predictor.device)
        groups = [photos[start : start + size] for start in range(0, len(photos), size)]
        read = (map(_read, group) for group in groups)
        for group, rows in zip(
            groups, group_rows(work, self.pool, read, lambda name: self.passed(paths[name].name)), strict=True
        ):
            by_name = groupby(rows.each(), key=lambda row: row["picture"])
            for photo, (_, theirs) in zip(group, by_name, strict=True):
                self._take_photo(photo, list(theirs))

    def _take_photo(self, photo: NamedFile, rows: Sequence[Row]) -> None:
        first = rows[0]
        for warning in first.get(FILE_WARNINGS, ()):
            self.say(f"warning: {photo.path}: {warning}")
        if "height" in first:  # it could be read
            self.found.photos += 1
        if first.get("people") == 0:
            self._nobody(photo, "nobody found in it")
            return
        if "person" in first and self._lacks(photo, len(rows)):
            return
        errors = [row["error"] for row in rows if "error" in row]
        if errors:
            self._fail(photo, errors[0])
        for row in rows:
            if "camera_scale" in row:
                file = f"{photo.name}.person{row['person']}.npz"
                _body_of(row).save(self.folder / file)
                box = [round(edge, 1) for edge in np.asarray(row["box"], np.float32).tolist()]
                score = round(float(np.float32(row["score"])), 3)
                self.found.people.append(
                    {"file": file, "picture": photo.shown, "person": row["person"], "score": score, "box": box}
                )

    def film(self, film: NamedFile) -> None:
        """Take a film, frame by frame."""
        work = self._with_camera(lambda name, size: self.camera(size, None))
        followed = _FollowedFilm(film, replace(work, cutter=replace(work.cutter, person=None)))
        frames = made_by(self.pool, followed.frames())
        (rows,) = group_rows(work, self.pool, [frames], lambda name: self.passed(film.path.name))
        times, cuts = [frame.time for frame in followed.passed], followed.cuts
        self.found.frames += len(times)
        everyone = rows.each()
        errors = [followed.fault] if followed.fault else [row["error"] for row in everyone if "error" in row]
        if errors:
            self._fail(film, errors[0])
        for warning in time_warnings(str(film.path), times, followed.guessed, usual_rate(times, followed.rate)):
            self.say(f"warning: {warning}")
        if cuts:
            self.found.cuts[film.path.name] = cuts
            told = cuts_sentence(cuts, [times[cut] for cut in cuts])
            self.say(f"warning: {film.path}: {told}, people numbered anew")
        shots = shots_between(cuts, len(times))
        tracks = [track for track in followed.tracks(everyone) if lasting(track["frames"], shots)]
        if tracks:
            perspective = any(bool(row.get("camera_perspective")) for row in everyone)
            self._save_film(film, tracks, followed.image_size, perspective=perspective)
        elif times:
            self._nobody(film, f"nobody found in {len(times)} frames")

    def _save_film(
        self, film: NamedFile, tracks: list[np.ndarray], size: tuple[int, int], *, perspective: bool
    ) -> None:
        """Write a film's people, the most and largest seen first."""
        tracks.sort(key=lambda rows: -areas(rows["boxes"]).sum())
        wanted = self.predictor.cutter.person
        self._lacks(film, len(tracks))
        for number, rows in enumerate(tracks):
            if wanted in (None, number):
                file = f"{film.name}.person{number}.npz"
                FilmBodies(rows, size, perspective).save(self.folder / file)
                self.found.people.append(
                    {
                        "file": file,
                        "film": film.shown,
                        "track": number,
                        "score": round(float(rows["scores"].mean()), 3),
                        "frames": len(rows),
                        "first_frame": int(rows["frames"][0]),
                        "last_frame": int(rows["frames"][-1]),
                        "first_time": round(float(rows["times"][0]), 6),
                        "last_time": round(float(rows["times"][-1]), 6),
                    }
                )

    def _with_camera(self, camera: Callable[[str, tuple[int, int]], Perspective | None]) -> PeoplePredictor:
        return replace(self.predictor, cutter=replace(self.predictor.cutter, camera=camera))

    def _lacks(self, file: NamedFile, count: int) -> bool:
        """Say so if the person who was asked for is not among so many people of a file."""
        wanted = self.predictor.cutter.person
        if wanted is None or wanted < count:
            return False
        people = "1 person" if count == 1 else f"{count} people"
        self._nobody(file, f"no person {wanted}, but {people} in it")
        return True

    def _nobody(self, file: NamedFile, told: str) -> None:
        self.found.nobody_in.append(file.shown)
        self._tell(f"{file.path}: {told}")

    def _fail(self, file: NamedFile, error: str) -> None:
        self.found.unreadable.append(file.shown)
        self._tell(error if error.startswith(str(file.path)) else f"{file.path}: {error}")

    def _tell(self, line: str) -> None:
        line = " ".join(line.split())
        if self.alone:
            self.complaint = self.complaint or line
        else:
            self.say(line)


def _read(photo: NamedFile) -> Held:
    """Read a photo; of one that can't be read, why."""
    try:
        return photo.name, SourcePicture(read_photo(photo.path), warnings=tuple(photo_warnings(photo.path)))
    except InputError as error:
        return photo.name, error


def _body_of(row: Row) -> BodyFile:
    """Body of a row, as ``body.npz`` holds it."""
    arrays = {name: np.asarray(row[name]) for name in _BODY}
    size = np.array((row["height"], row["width"]))
    return BodyFile(**arrays, image_size=size, camera_perspective=np.asarray(row["camera_perspective"]))


class _Frame(NamedTuple):
    """Frame of a film that has passed: its number and time [s], and the numbers of the people in it."""

    number: int
    time: float
    numbers: tuple[int, ...]


@dataclass
class _FollowedFilm:
    """Film whose people are followed; it is known as far as its frames have passed."""

    film: NamedFile
    predictor: PeoplePredictor
    rate: float = 0.0
    image_size: tuple[int, int] = (0, 0)
    passed: list[_Frame] = field(default_factory=list)
    guessed: list[bool] = field(default_factory=list)
    cuts: list[int] = field(default_factory=list)
    fault: str = ""

    def frames(self) -> Iterator[Cut]:
        """People of each frame, cut out; a fault of the file ends it."""
        rule, device = self.predictor.rule, self.predictor.device
        try:
            self.rate = film_facts(self.film.path).rate
            for followed in follow_people(
                self.film.path, self.rate, min_score=rule.min_score, device=device, landmarks=rule.landmarks
            ):
                frame, people = followed.frame, followed.people
                self.image_size = (frame.picture.shape[0], frame.picture.shape[1])
                self.guessed.append(frame.guessed)
                if followed.cut:
                    self.cuts.append(frame.index)
                name = str(len(self.passed))
                self.passed.append(_Frame(frame.index, frame.time, tuple(people)))
                found = list(people.values())
                owners = instance_maps([found], [self.image_size])[0] if found else None
                picture = SourcePicture(frame.picture, tuple(map(known_person, found)), owners)
                yield self.predictor.cutter.cut([(name, picture)], {0: picture})
        except InputError as error:
            self.fault = str(error)

    def tracks(self, rows: Sequence[Row]) -> list[np.ndarray]:
        """Arrays of dtype ``ROW`` of each person, in the order in which they came."""
        found: dict[int, list[np.ndarray]] = {}
        for row in rows:
            if "camera_scale" not in row:
                continue
            frame, own = self.passed[int(row["picture"])], np.zeros(1, ROW)
            seen = {"frames": frame.number, "times": frame.time, "scores": row["score"], "boxes": row["box"]}
            for name, value in (seen | {name: row[name] for name in ("keypoints", *_BODY)}).items():
                own[name] = value
            found.setdefault(frame.numbers[row["person"]], []).append(own)
        return [np.concatenate(each) for each in found.values()]


class SampleSpeeds(NamedTuple):
    """People a second, through the network alone and with all that comes before it."""

    network: float
    whole: float


def predict_samples(
    samples: Sequence[Sample],
    cameras: Sequence[Perspective | None] | None,
    predictor: PeoplePredictor,
    folder: Path,
    *,
    passed: Callable[[str], None],
    say: Callable[[str], None],
) -> SampleSpeeds:
    """Predict the body of each sample, whose keypoints are known, and write its file.

    Args:
        samples: One or more.
        cameras: Cameras of the samples' pictures; None: a usual lens is assumed for each.
        predictor: Asks the network.
        folder: Folder for the files.
        passed: Called with the name of each sample's picture.
        say: Called with a line for each warning.

    Raises:
        InputError: If the keypoints of a sample can't be used, or it has no body.
    """
    size, network = pictures_at_a_time(predictor.device), 0.0
    cuts = (
        _cut_samples(samples[start : start + size], None if cameras is None else cameras[start : start + size])
        for start in range(0, len(samples), size)
    )
    with people_pool(predictor) as pool:
        first = _cut_samples(samples[:1], None if cameras is None else cameras[:1]).people[0][1]
        pool.submit(predictor.bodies, first.to(predictor.device)).result()  # what is set up once counts for no speed
        began = time.perf_counter()
        for rows in group_rows(predictor, pool, ([cut] for cut in cuts), passed):
            for row in rows.each():
                if "error" in row:
                    raise InputError(f"{row['picture']}: {row['error']}")
                _body_of(row).save(folder / f"{row['picture']}.npz")
                network += row[SECONDS] / predictor.workers
                for warning in row["warnings"]:
                    say(f"warning: {row['picture']}: {warning}")
        seconds = time.perf_counter() - began
    return SampleSpeeds(len(samples) / network, len(samples) / seconds)


def _usual_camera(sample: Sample) -> UsualLens | None:
    """A usual lens for a sample's picture, whose size its labels or its keypoints' file may tell."""
    size = sample.keypoints.image_size if sample.parts is None else sample.parts.groups.shape
    return None if size is None else UsualLens.of_size((size[0], size[1]))


def _cut_samples(samples: Sequence[Sample], cameras: Sequence[Perspective | None] | None) -> Cut:
    """The people of samples, cut out before their cameras, or before usual lenses."""
    rows: list[Row] = []
    people: list[PicturePerson] = []
    names: list[str] = []
    for index, sample in enumerate(samples):
        height, width = image_size(sample.keypoints, sample.parts, None)
        camera = _usual_camera(sample) if cameras is None else cameras[index]
        people.append(PicturePerson(sample.keypoints, sample.parts, sample.others, camera))
        rows.append({"picture": sample.name, "person": 0, "height": height, "width": width})
        names.append(sample.picture.name if isinstance(sample.picture, Path) else sample.name)
    cut: list[CutPerson] = []
    for sample, found in zip(samples, cut_out_people(people, "cpu", probabilities=True), strict=True):
        if isinstance(found, InputError):
            raise InputError(f"{sample.name}: {found}")
        cut.append(found)
    return Cut(tuple(names), PeopleRows.of(rows), [(np.array(own), some) for own, some in batch_people(cut)])
