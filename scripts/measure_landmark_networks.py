"""Measure and print how near keypoints and bodies of photos are to the truth with each landmark network.

    python scripts/measure_landmark_networks.py partbench FIRST LAST
    python scripts/measure_landmark_networks.py pose2sim JOINTS.npz VIDEOS
    python scripts/measure_landmark_networks.py films JOINTS.npz VIDEOS CAMERA [CAMERA ...]

"partbench": shaded pictures of PartBench's people FIRST to LAST. "pose2sim": a film of a real man by four cameras, of
which some frames are taken as photos; "films": the whole films of some of the cameras (1 to 4), each by itself.
JOINTS.npz has his true joints: ``joint_names``, ``sampled_frames``, ``joints_world`` (F, J, 3) [m], ``rotation`` and
``translation`` of each camera, and ``keypoints`` (C, F, J, 2), the joints projected [px]. VIDEOS is the folder
``Pose2Sim/Demo_SinglePerson/videos`` of the wheel ``pose2sim==0.10.49``. The third camera's projections are off by 25
to 30 px, so that keypoints are compared in the others alone.

Of the twelve joints of the limbs: errors of keypoints, in percent of the person's height, then PA-MPJPE, and MPJPE
about the middle of the hips, of the meshes of ``fit_photo`` or ``fit_film`` [mm]. Intervals of 95 % are over people, or
over moments of the film, of which all cameras' views count as one.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
import warp as wp

from warp_partdr import metrics
from warp_partdr.body.skeletons import skeleton
from warp_partdr.inputs.films import read_frames
from warp_partdr.inputs.keypoints import person_heights
from warp_partdr.lab.evaluation.partbench.photos import shade_person
from warp_partdr.lab.synthetic.partbench_people import COCO, make_person
from warp_partdr.networks.detection import LandmarkNetwork
from warp_partdr.networks.detection.asset import load_heavy_landmarks
from warp_partdr.networks.detection.crops import Pyramid
from warp_partdr.networks.detection.film_people import find_film_people
from warp_partdr.networks.detection.heavy import see_landmarks
from warp_partdr.networks.detection.look import place_landmarks
from warp_partdr.networks.detection.people import find_people
from warp_partdr.networks.detection.person import SKELETON, FoundPerson
from warp_partdr.pipelines.film import fit_film
from warp_partdr.pipelines.photo import fit_photo
from warp_partdr.pipelines.seen_film import SeenFilm
from warp_partdr.solve.ellipsoids.options import FitOptions

LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
JOINTS = [f"{side}_{name}" for name in LIMBS for side in ("left", "right")]
HIPS = [JOINTS.index("left_hip"), JOINTS.index("right_hip")]
LSP = list(skeleton("lsp14").landmarks)
PLACES = [skeleton(SKELETON).landmarks.index(name) for name in JOINTS]
LAG = 0.75  # frames by which the film is late
MISPLACED = 2  # the camera whose projections are
FAR = 30  # [%] of the height: hips farther off are somebody else's
WRONG = 10  # [%] of the height, off by which a joint is somewhere else


@dataclass(frozen=True)
class View:
    """Picture of a person and the truth about their twelve joints.

    Attributes:
        picture: RGB, shape (H, W, 3), uint8.
        moment: Number of the person, or of the moment; views of one are no independent samples.
        joints: In the camera's frame [m], shape (12, 3).
        points: In the picture [px], shape (12, 2).
        height: The person's in the picture [px].
        compared: Whether ``points`` are near enough to the truth to compare keypoints with them.
    """

    picture: np.ndarray
    moment: int
    joints: np.ndarray
    points: np.ndarray
    height: float
    compared: bool = True

    def errors(self, person: FoundPerson) -> np.ndarray:
        """Errors of keypoints [% of the height], shape (12,)."""
        return 100 * np.linalg.norm(person.keypoints.points[PLACES] - self.points, axis=1) / self.height


def partbench_views(first: int, last: int) -> Iterator[View]:
    for index in range(first, last + 1):
        person = make_person(index)
        points = person.keypoints()[[COCO.landmarks.index(name) for name in JOINTS]]
        joints = person.joints[[LSP.index(name) for name in JOINTS]]
        yield View(shade_person(index), index, joints, points, person.height)


@dataclass(frozen=True)
class FilmTruth:
    """Truth about the twelve joints in a film by C cameras.

    Attributes:
        frames: Those that are taken as photos, shape (T,).
        points: In the pictures, as they show them [px], shape (C, F, 12, 2).
        joints: Likewise, in the cameras' frames [m], shape (C, F, 12, 3).
    """

    frames: np.ndarray
    points: np.ndarray
    joints: np.ndarray

    @classmethod
    def read(cls, path: Path) -> FilmTruth:
        with np.load(path, allow_pickle=False) as file:
            order = [file["joint_names"].tolist().index(name) for name in JOINTS]
            joints = np.einsum("cij,fkj->cfki", file["rotation"], file["joints_world"][:, order])
            joints = joints + file["translation"][:, None, None]
            late = []
            for values in (file["keypoints"][:, :, order], joints):
                before = np.concatenate([values[:, :1], values[:, :-1]], axis=1)
                late.append(LAG * before + (1 - LAG) * values)
            return cls(file["sampled_frames"], *late)


def film_of(videos: Path, camera: int) -> Path:
    """Film of a camera, from 0."""
    return videos / f"cam{camera + 1:02d}.mp4"


def pose2sim_views(path: Path, videos: Path) -> Iterator[View]:
    film = FilmTruth.read(path)
    frames, points, joints = film.frames, film.points[:, film.frames], film.joints[:, film.frames]
    for camera in range(len(points)):
        heights = truth_heights(points[camera])
        for frame in read_frames(film_of(videos, camera)):
            for moment in np.flatnonzero(frames == frame.index).tolist():
                truth = joints[camera, moment], points[camera, moment], heights[moment]
                yield View(frame.picture, moment, *truth, compared=camera != MISPLACED)


def truth_heights(points: np.ndarray) -> np.ndarray:
    """Heights of the person [px], as of ``person_height``, of joints (T, 12, 2), shape (T,)."""
    everywhere = np.zeros((len(points), len(skeleton(SKELETON)), 2), np.float32)
    sure = np.zeros(everywhere.shape[:2], np.float32)
    everywhere[:, PLACES], sure[:, PLACES] = points, 1
    return person_heights(SKELETON, everywhere, sure)


def measure(views: Iterator[View]) -> None:
    network = load_heavy_landmarks()
    keypoints: dict[str, list[np.ndarray]] = {"full": [], "heavy, without the mirror image": [], "heavy": []}
    bodies: dict[str, list[np.ndarray]] = {name: [] for name in get_args(LandmarkNetwork)}
    moments, compared, missed = [], [], 0
    for view in views:
        pyramid = Pyramid(view.picture, "cpu")
        people = find_people(pyramid)
        far = [view.errors(person)[HIPS].mean() for person in people]
        if min(far, default=np.inf) > FAR:
            missed += 1
            continue
        place = int(np.argmin(far))
        person, heavy = people[place], find_people(pyramid, landmarks="heavy")[place]
        crop = replace(person.crop, pictures=np.zeros(1, np.int64))
        points = place_landmarks(see_landmarks(network, [pyramid], crop, mirror=False), crop)[0][0]
        alone = replace(person, keypoints=replace(person.keypoints, points=points.astype(np.float32)))
        compared += [view.moment] * view.compared
        for name, each in zip(keypoints, (person, alone, heavy), strict=True):
            keypoints[name] += [view.errors(each)] * view.compared
        for name, errors in bodies.items():
            options = replace(FitOptions.at("balanced"), landmarks=name)
            errors.append(body_errors(view, place, options))
        moments.append(view.moment)
    print(f"{len(moments)} views; the person was not found in {missed} more")
    first = np.array(keypoints["full"])
    for name, found in keypoints.items():
        values = np.array(found)
        wrong = f"{100 * (values > WRONG).mean():.1f} % off by over {WRONG} %"
        off = f"mean {values.mean():.2f} %, median {np.median(values):.2f} %, {wrong}"
        print(f"keypoints of {name}: {off}; against full {difference(values - first, compared)} %")
    for name, found in bodies.items():
        for column, metric in enumerate(("PA-MPJPE", "MPJPE")):
            values, others = np.array(found)[:, [column]], np.array(bodies["full"])[:, [column]]
            change = difference(values - others, moments)
            print(f"bodies with {name}: {metric} {values.mean():.1f} mm; against full {change} mm")


def body_errors(view: View, place: int, options: FitOptions) -> np.ndarray:
    """PA-MPJPE and MPJPE [mm] of the mesh of the person at this place, shape (2,)."""
    body = fit_photo(view.picture, person=place, options=options).fits[place]
    return joint_errors(body.landmarks(JOINTS), view.joints)


def joint_errors(joints: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """PA-MPJPE and MPJPE [mm] of joints (..., 12, 3) [m], shape (..., 2)."""
    both = metrics.pa_mpjpe(joints, truth), metrics.mpjpe(joints, truth, centre_on=HIPS)
    return 1000 * np.stack([each.numpy() for each in both], axis=-1)


def measure_films(truth: FilmTruth, videos: Path, cameras: Sequence[int]) -> None:
    for camera in cameras:
        for name in get_args(LandmarkNetwork):
            seen = SeenFilm.of(find_film_people(film_of(videos, camera), landmarks=name))
            motion = fit_film([seen], person=0).motions[0]
            joints = motion.model.landmarks(motion.bodies().detailed, JOINTS).numpy()
            aligned, centred = joint_errors(joints, truth.joints[camera, motion.frames]).mean(axis=0)
            about = f"PA-MPJPE {aligned:.1f} mm, MPJPE {centred:.1f} mm in {len(joints)} frames"
            print(f"film of camera {camera + 1} with {name}: {about}", flush=True)


def difference(values: np.ndarray, moments: Sequence[int]) -> str:
    """Mean of values (N, K) of views and its interval over the moments, shape (N,)."""
    means = np.array([values[np.array(moments) == moment].mean() for moment in np.unique(moments)])
    half = 1.96 * means.std(ddof=1) / len(means) ** 0.5
    return f"{means.mean():+.2f} ({means.mean() - half:+.2f} to {means.mean() + half:+.2f})"


def main(source: str, *given: str) -> None:
    wp.config.log_level = wp.LOG_WARNING
    if source == "partbench":
        measure(partbench_views(int(given[0]), int(given[1])))
    elif source == "films":
        measure_films(FilmTruth.read(Path(given[0])), Path(given[1]), [int(each) - 1 for each in given[2:]])
    else:
        measure(pose2sim_views(Path(given[0]), Path(given[1])))


if __name__ == "__main__":
    main(*sys.argv[1:])
