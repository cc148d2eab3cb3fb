"""A fitted film of known motions: one person walks to the right, another stands farther away for a part of it."""

from __future__ import annotations

import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from helpers.films import write_film
from warp_partdr.cameras import Perspective
from warp_partdr.inputs.scene import PersonShape
from warp_partdr.models.anny import anny
from warp_partdr.networks.detection.film_people import SEEN, FilmPeople, kept_size
from warp_partdr.pipelines.film import FilmFit, Motion
from warp_partdr.pipelines.observed_film import ObservedFilm
from warp_partdr.results.save_film import save_film_fit
from warp_partdr.solve.confidence.limbs import LIMBS
from warp_partdr.solve.confidence.motions import MotionConfidence
from warp_partdr.solve.confidence.sights import NO_SIGHT, SIGHTS

COUNT, RATE, SIZE = 20, 10, (200, 320)  # frames, frames a second, (H, W) [px]
LATE = 6  # frame in which the second person comes
_FILES: list[tuple[str, bytes]] = []


def made_fit() -> FilmFit:
    model, rows = anny(), []
    starts, steps, firsts = ((-1.2, 0.1, 4.5), (1.3, 0.2, 6.0)), ((0.1, 0.0, 0.0), (0.0, 0.0, 0.0)), (0, LATE)
    motions = {}
    for person, (start, step, first) in enumerate(zip(starts, steps, firsts, strict=True)):
        frames = np.arange(first, COUNT)
        rotations = torch.eye(3).repeat(len(frames), model.num_joints, 1, 1)
        rotations[:, 0] = torch.diag(torch.tensor([1.0, -1.0, -1.0]))  # upright, facing the camera
        translation = torch.tensor(start) + torch.from_numpy(frames)[:, None] * torch.tensor(step)
        shape = PersonShape(torch.zeros(model.num_shapes), torch.zeros(8))
        motions[person] = Motion(model, frames, shape, rotations, translation.float())
        rows += [(person, frame) for frame in frames]
    seen = np.zeros(len(rows), [(name, *kind) for name, kind in SEEN.items()] + [("tracks", int), ("places", int)])
    seen["tracks"], seen["frames"] = np.array(rows).T
    seen["times"], seen["scores"] = seen["frames"] / RATE, 0.9
    owners = zlib.compress(np.zeros(kept_size(SIZE), np.uint8).tobytes())
    people = FilmPeople(SIZE, RATE, np.arange(COUNT) / RATE, seen, (owners,) * COUNT)
    seen = ObservedFilm.of(people, Perspective.of_picture(SIZE, focal=300))
    return FilmFit((seen,), {person: ((0, person),) for person in motions}, motions)


def with_confidence(fit: FilmFit) -> FilmFit:
    """The fit with confidence: the first person's left arm is hidden up to frame 9, and nobody is found in frame 12.

    The confidence of the first person is 0.9, and 0.1 in frames 3 to 5; that of the second person is 0.6.
    """
    motions = {}
    for person, (motion, usual) in enumerate(zip(fit.motions.values(), (0.9, 0.6), strict=True)):
        bodies = np.full(len(motion.frames), usual)
        sights = np.full((len(motion.frames), len(LIMBS)), SIGHTS.index("seen"), dtype=np.uint8)
        if person == 0:
            bodies[3:6] = 0.1
            sights[:10, [limb.name for limb in LIMBS].index("left arm")] = SIGHTS.index("hidden")
        bodies[motion.frames == 12] = np.nan
        sights[motion.frames == 12] = NO_SIGHT
        confidence = MotionConfidence(bodies, np.repeat(bodies[:, None], len(LIMBS), 1), sights)
        motions[person] = replace(motion, confidence=confidence)
    return replace(fit, motions=motions)


def shade(frame: int) -> int:
    """Gray of the film's frame."""
    return 40 + 8 * frame


def write_fitted(folder: Path) -> FilmFit:
    """Write the film, walk.mp4, and the fit's files, in out; they are made once."""
    fit = made_fit()
    film, out = folder / "walk.mp4", folder / "out"
    if not _FILES:
        write_film(film, [np.full((*SIZE, 3), shade(frame), np.uint8) for frame in range(COUNT)], rate=RATE)
        save_film_fit(fit, out, films=[film])
        made = (film, *(path for path in out.iterdir() if path.suffix in (".json", ".npz")))
        _FILES.extend((path.relative_to(folder).as_posix(), path.read_bytes()) for path in made)
    out.mkdir(exist_ok=True)
    for name, content in _FILES:
        (folder / name).write_bytes(content)
    return fit
