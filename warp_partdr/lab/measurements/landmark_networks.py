"""Errors of keypoints and bodies from photos and films with each landmark network.

By default, pictures are shaded ones of PartBench's people. JOINTS.npz and VIDEOS give a film of a real man by four
cameras, of which some frames are taken as photos; with `--cameras`, the whole films of these cameras (1 to 4) are
taken, each by itself. JOINTS.npz has his true joints: `joint_names`, `sampled_frames`, `joints_world` (F, J, 3) [m],
`rotation` and `translation` of each camera, and `keypoints` (C, F, J, 2), the joints projected [px]. VIDEOS is the
folder `Pose2Sim/Demo_SinglePerson/videos` of the wheel `pose2sim==0.10.49`. The third camera's projections are off by
25 to 30 px, so that keypoints are compared in the others alone.

Only the twelve joints of the limbs count: errors of keypoints in percent of the person's height, then PA-MPJPE, and
MPJPE about the middle of the hips, of the meshes of ``fit_photo`` or ``fit_film`` [mm]. Intervals of 95 % are over
people, or over moments of the film, of which all cameras' views count as one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from ...body.skeletons import skeleton
from ...errors import InputError
from ...inputs.films import read_frames
from ...inputs.keypoints import person_heights
from ...metrics import mpjpe, pa_mpjpe
from ...networks.detection import LandmarkNetwork
from ...networks.detection.asset import load_heavy_landmarks
from ...networks.detection.crops import Pyramid
from ...networks.detection.film_people import find_film_people
from ...networks.detection.heavy import see_landmarks
from ...networks.detection.look import place_landmarks
from ...networks.detection.people import find_people
from ...networks.detection.person import SKELETON, FoundPerson
from ...pipelines.film import fit_film
from ...pipelines.observed_film import ObservedFilm
from ...pipelines.photo import fit_photo
from ...solve.ellipsoids.options import FitOptions
from ..evaluation.partbench.photos import shade_person
from ..options import Counts, People, tracked
from ..synthetic.partbench_people import COCO, make_person
from ..tables import Estimate, FigureTable, estimate_mean

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_JOINTS = [f"{side}_{name}" for name in _LIMBS for side in ("left", "right")]
_HIPS = [_JOINTS.index("left_hip"), _JOINTS.index("right_hip")]
_LSP = list(skeleton("lsp14").landmarks)
_PLACES = [skeleton(SKELETON).landmarks.index(name) for name in _JOINTS]
_LAG = 0.75  # frames by which the film is late
_MISPLACED = 2  # the camera whose projections are
_FAR = 30  # [%] of the height: hips farther off are somebody else's
_WRONG = 10  # [%] of the height, off by which a joint is somewhere else


def measure_landmark_networks(
    joints: Path | None = None,
    videos: Path | None = None,
    /,
    *,
    people: People = range(30),
    cameras: Counts = (),
) -> Iterator[FigureTable | str]:
    """Find people with each network, and fit their bodies.

    Args:
        joints: File of a film's true joints.
        videos: Folder of its videos.
        people: PartBench's people, without these files.
        cameras: Cameras whose whole films are fitted, from 1.

    Raises:
        InputError: If one of the two files is missing.
    """
    if (joints is None) != (videos is None) or (cameras and joints is None):
        raise InputError("JOINTS.npz and VIDEOS: expected both, or neither and no --cameras")
    if joints is None or videos is None:
        yield from _measure_views(_partbench_views(people))
    elif cameras:
        yield from _measure_films(_FilmTruth.read(joints), videos, cameras)
    else:
        yield from _measure_views(_pose2sim_views(joints, videos))


@dataclass(frozen=True)
class _View:
    """Picture of a person and the truth about their twelve joints.

    Attributes:
        picture: RGB, shape (H, W, 3), uint8.
        moment: Number of the person, or of the moment. Views with the same number are no independent samples.
        joints: Joints in the camera's frame [m], shape (12, 3).
        points: Joints in the picture [px], shape (12, 2).
        height: Height of the person in the picture [px].
        compared: True if ``points`` are near enough to the truth to compare keypoints with them.
    """

    picture: np.ndarray
    moment: int
    joints: np.ndarray
    points: np.ndarray
    height: float
    compared: bool = True

    def errors(self, person: FoundPerson) -> np.ndarray:
        """Errors of keypoints [% of the height], shape (12,)."""
        return 100 * np.linalg.norm(person.keypoints.points[_PLACES] - self.points, axis=1) / self.height


def _partbench_views(people: range) -> Iterator[_View]:
    for index in tracked(people):
        person = make_person(index)
        points = person.keypoints()[[COCO.landmarks.index(name) for name in _JOINTS]]
        joints = person.joints[[_LSP.index(name) for name in _JOINTS]]
        yield _View(shade_person(index), index, joints, points, person.height)


@dataclass(frozen=True)
class _FilmTruth:
    """Truth about the twelve joints in a film by C cameras.

    Attributes:
        frames: Frames that are taken as photos, shape (T,).
        points: Joints in the pictures, as they show them [px], shape (C, F, 12, 2).
        joints: Joints in the cameras' frames [m], shape (C, F, 12, 3).
    """

    frames: np.ndarray
    points: np.ndarray
    joints: np.ndarray

    @classmethod
    def read(cls, path: Path) -> _FilmTruth:
        with np.load(path, allow_pickle=False) as file:
            order = [file["joint_names"].tolist().index(name) for name in _JOINTS]
            joints = np.einsum("cij,fkj->cfki", file["rotation"], file["joints_world"][:, order])
            joints = joints + file["translation"][:, None, None]
            late = []
            for values in (file["keypoints"][:, :, order], joints):
                before = np.concatenate([values[:, :1], values[:, :-1]], axis=1)
                late.append(_LAG * before + (1 - _LAG) * values)
            return cls(file["sampled_frames"], *late)


def _film_of(videos: Path, camera: int) -> Path:
    """Film of a camera, from 0."""
    return videos / f"cam{camera + 1:02d}.mp4"


def _pose2sim_views(path: Path, videos: Path) -> Iterator[_View]:
    film = _FilmTruth.read(path)
    frames, points, joints = film.frames, film.points[:, film.frames], film.joints[:, film.frames]
    for camera in range(len(points)):
        heights = _truth_heights(points[camera])
        for frame in read_frames(_film_of(videos, camera)):
            for moment in np.flatnonzero(frames == frame.index).tolist():
                truth = joints[camera, moment], points[camera, moment], heights[moment]
                yield _View(frame.picture, moment, *truth, compared=camera != _MISPLACED)


def _truth_heights(points: np.ndarray) -> np.ndarray:
    """Heights of the person [px] for joints (T, 12, 2), as in ``person_height``, shape (T,)."""
    everywhere = np.zeros((len(points), len(skeleton(SKELETON)), 2), np.float32)
    confidence = np.zeros(everywhere.shape[:2], np.float32)
    everywhere[:, _PLACES], confidence[:, _PLACES] = points, 1
    return person_heights(SKELETON, everywhere, confidence)


_COLUMNS = {
    "keypoints of": "",
    "mean [%]": ".2f",
    "median [%]": ".2f",
    f"off by over {_WRONG} % [%]": ".1f",
    "against full [%]": "+.2f",
}


def _measure_views(views: Iterator[_View]) -> Iterator[FigureTable | str]:
    network = load_heavy_landmarks()
    keypoints: dict[str, list[np.ndarray]] = {"full": [], "heavy, without the mirror image": [], "heavy": []}
    bodies: dict[str, list[np.ndarray]] = {name: [] for name in get_args(LandmarkNetwork)}
    moments: list[int] = []
    compared: list[int] = []
    missed = 0
    for view in views:
        pyramid = Pyramid(view.picture, "cpu")
        people = find_people(pyramid)
        far = [view.errors(person)[_HIPS].mean() for person in people]
        if min(far, default=np.inf) > _FAR:
            missed += 1
            continue
        index = int(np.argmin(far))
        person, heavy = people[index], find_people(pyramid, landmarks="heavy")[index]
        crop = replace(person.crop, pictures=np.zeros(1, np.int64))
        points = place_landmarks(see_landmarks(network, [pyramid], crop, mirror=False), crop)[0][0]
        alone = replace(person, keypoints=replace(person.keypoints, points=points.astype(np.float32)))
        compared += [view.moment] * view.compared
        for name, each in zip(keypoints, (person, alone, heavy), strict=True):
            keypoints[name] += [view.errors(each)] * view.compared
        for landmarks in get_args(LandmarkNetwork):
            options = replace(FitOptions.at("balanced"), landmarks=landmarks)
            bodies[landmarks].append(_body_errors(view, index, options))
        moments.append(view.moment)
    yield f"{len(moments)} views; the person was not found in {missed} more"
    table, first = FigureTable("Keypoints", _COLUMNS), np.array(keypoints["full"])
    for name, found in keypoints.items():
        values = np.array(found)
        wrong = 100 * float((values > _WRONG).mean())
        change = _estimate_over_moments(values - first, compared)
        table.add(name, float(values.mean()), float(np.median(values)), wrong, change)
    yield table
    table = FigureTable("Bodies", {"bodies with": "", "figure": "", "mean [mm]": ".1f", "against full [mm]": "+.2f"})
    for name, found in bodies.items():
        for column, metric in enumerate(("PA-MPJPE", "MPJPE")):
            values, others = np.array(found)[:, [column]], np.array(bodies["full"])[:, [column]]
            table.add(name, metric, float(values.mean()), _estimate_over_moments(values - others, moments))
    yield table


def _body_errors(view: _View, index: int, options: FitOptions) -> np.ndarray:
    """PA-MPJPE and MPJPE [mm] of the mesh of the person at this place, shape (2,)."""
    body = fit_photo(view.picture, person=index, options=options).fits[index]
    return _errors_of_joints(body.landmarks(_JOINTS), view.joints)


def _errors_of_joints(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """PA-MPJPE and MPJPE [mm] of joints (..., 12, 3) [m], shape (..., 2)."""
    both = pa_mpjpe(joints, truth), mpjpe(joints, truth, centre_on=_HIPS)
    return 1000 * np.stack([each.numpy() for each in both], axis=-1)


def _measure_films(truth: _FilmTruth, videos: Path, cameras: Sequence[int]) -> Iterator[FigureTable]:
    columns = {"camera": "d", "landmarks": "", "PA-MPJPE [mm]": ".1f", "MPJPE [mm]": ".1f", "frames": "d"}
    table = FigureTable("Films", columns)
    for camera in cameras:
        for name in get_args(LandmarkNetwork):
            film = ObservedFilm.of(find_film_people(_film_of(videos, camera - 1), landmarks=name))
            motion = fit_film([film], person=0).motions[0]
            joints = motion.model.landmarks(motion.bodies().detailed, _JOINTS).numpy()
            aligned, centred = _errors_of_joints(joints, truth.joints[camera - 1, motion.frames]).mean(axis=0).tolist()
            table.add(camera, name, aligned, centred, len(joints))
    yield table


def _estimate_over_moments(values: np.ndarray, moments: Sequence[int]) -> Estimate:
    """Mean of values (N, K) of views, with its interval over the moments (N,)."""
    return estimate_mean([values[np.array(moments) == moment].mean() for moment in np.unique(moments)])
