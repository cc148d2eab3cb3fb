"""Learn how the packaged detector errs, for ``lab/synthetic/detector_errors.py``, and print it.

    python scripts/learn_detector_errors.py MOCAP [--people 3328] [--out FILE.npz] [--pictures FOLDER]

Shaded people are shown to it: bodies that no person of PartBench has, poses that networks learn from and some who lie,
seen from all round, half of them dressed, some cut off by the border or behind something. Of each whom it finds,
true places of ``LANDMARKS`` about their mean, its errors [statures] and its confidences are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import warp as wp
from PIL import Image, ImageDraw

from warp_partdr.body.landmarks import mirror_order, without_side
from warp_partdr.body.rotations import rotation_from_axis_angle
from warp_partdr.body.skeletons import skeleton
from warp_partdr.body.template import MEAN_STATURE
from warp_partdr.cameras import Perspective
from warp_partdr.lab.harness import run_script
from warp_partdr.lab.synthetic import people
from warp_partdr.lab.synthetic.detector_errors import BEYOND, HIDDEN, SEEN
from warp_partdr.lab.synthetic.pose_sampler import PoseBank, PoseSampler
from warp_partdr.lab.synthetic.poses import mean_body
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.lab.synthetic.shading import SAMPLES, shade_people
from warp_partdr.lab.synthetic.training_people import PeopleMaker
from warp_partdr.lab.synthetic.wardrobe import wardrobe
from warp_partdr.models.anny import anny
from warp_partdr.models.measuring import statures
from warp_partdr.models.pose import pose_from_ellipbody
from warp_partdr.networks.detection.masks import instance_map
from warp_partdr.networks.detection.people import find_people_in
from warp_partdr.networks.detection.person import SKELETON, FoundPerson
from warp_partdr.networks.regression.landmarks import LANDMARKS, network_keypoints

DEFAULT = Path(__file__).parents[1] / "warp_partdr" / "assets" / "detector_errors.npz"
SEED = 5_407
BATCH = 32
SIZES = ((400, 320), (320, 400), (320, 320))  # (H, W) [px] of the pictures
LYING = 0.1  # share of people who lie
DISTANCE = (1.6, 16.0)  # [m]; small ones as often as large ones, as logarithms
FILL = (0.45, 0.95)  # share of the picture's width or height that the person takes
CUT, CUT_SHARE = 0.25, (0.03, 0.5)  # share of people of whom a side of the picture cuts off, and how much
BEHIND, BOX = 0.2, (0.1, 0.25)  # share of people behind a box, and its half sides, of the person's extent
SANE = 0.25  # [statures] of the mean landmark from its true place, up to which the person was found at all
LEAST = 1e-7  # confidence of what is known, in float16
SHOWN = 32


@dataclass(frozen=True)
class Shown:
    """People in pictures of their own, and what is true of them."""

    pictures: np.ndarray  # (B, H, W, 3), uint8
    points: np.ndarray  # true ``LANDMARKS`` [px], shape (B, 24, 2)
    states: np.ndarray  # ``SEEN``, ``HIDDEN`` or ``BEYOND``, shape (B, 24), uint8
    stature: np.ndarray  # [px], shape (B,)
    masks: np.ndarray  # pixels that show them, shape (B, H, W), bool
    away: np.ndarray  # who looks away from the camera, shape (B,), bool


class Photographer:
    """Source of such people."""

    def __init__(self, mocap: Path) -> None:
        bank = PoseBank.read(mocap)
        self.rng, self.poses = TorchRng(SEED, "cpu"), PoseSampler(bank, seed=SEED, pool=1024)
        self.maker = PeopleMaker(bank, size=32, device="cpu", seed=SEED, held_out=False, pool=8)

    @torch.no_grad()
    def __call__(self, size: tuple[int, int], *, dressed: bool) -> Shown:
        rng, model = self.rng, anny()
        vectors, ups = self.poses.draw(BATCH)
        level = torch.nn.functional.normalize(rng.normal(BATCH, 3) * torch.tensor([1.0, 0.2, 1.0]), dim=1)
        ups = torch.where(rng.chance(LYING, BATCH, 1), level, ups)
        shape = self.maker.shapes(BATCH)
        orientation = self.maker.orientations(ups)
        posed = mean_body(rotation_from_axis_angle(vectors), orientation)
        stance = pose_from_ellipbody(model, posed, shape)
        body = model.pose(shape, *stance)
        near, far = np.log(DISTANCE)
        distance = rng.uniform(BATCH, 1, low=near, high=far).exp()  # of the pelvis
        away = distance[..., None] * torch.tensor([0.0, 0.0, 1.0]) - model.landmarks(body, ("pelvis",))
        vertices, mesh = body.vertices, people.anny_mesh()
        if dressed:
            clothes = wardrobe(rng.device)
            worn = rng.integers(clothes.size, BATCH)
            vertices = clothes.vertices(model.pose(shape, *stance, offsets=clothes.offsets(worn)), worn)
            mesh = clothes.mesh
        vertices = vertices + away
        camera = self._look(vertices, size)
        pictures, drawn = shade_people(vertices, mesh, camera, size, rng)
        masks, depth = (each[:, ::SAMPLES, ::SAMPLES] for each in (drawn.labels > 0, drawn.depth))
        boxes = self._boxes(masks)
        pictures[boxes.numpy()] = (255 * rng.uniform(BATCH, 1, 1, 3)).byte().expand(*boxes.shape, 3)[boxes].numpy()

        marks = model.landmarks(body, LANDMARKS) + away
        points, stature = camera.project(marks)[..., :2], statures(model, shape)
        pixels = people.pixel_indices(points, size)
        cover = torch.from_numpy(people.cover_of(LANDMARKS)).float() * (stature / MEAN_STATURE)[:, None]
        hidden = people.behind_something(marks[..., 2], pixels, depth, cover) | boxes.flatten(1).gather(1, pixels)
        inside = ((points > 0) & (points < torch.tensor(size[::-1]))).all(-1)
        states = torch.where(inside, torch.where(hidden, HIDDEN, SEEN), BEYOND)
        return Shown(
            pictures,
            points.numpy(),
            states.byte().numpy(),
            (stature * camera.focal[:, 0] / distance[:, 0]).numpy(),
            (masks & ~boxes).numpy(),
            (orientation[:, 2, 2] > 0.3).numpy(),
        )

    def _look(self, vertices: torch.Tensor, size: tuple[int, int]) -> Perspective:
        """Cameras that see the people somewhere in the picture, or a part of them."""
        rng, sides = self.rng, torch.tensor(size[::-1], dtype=torch.float32)
        flat = vertices[..., :2] / vertices[..., 2:]
        low, high = flat.amin(1), flat.amax(1)
        focal = rng.uniform(BATCH, 1, low=FILL[0], high=FILL[1]) * (sides / (high - low)).amin(1, keepdim=True)
        free = sides - focal * (high - low)
        start = free * rng.uniform(BATCH, 2)
        beyond = rng.uniform(BATCH, 1, low=CUT_SHARE[0], high=CUT_SHARE[1]) * focal * (high - low)
        last = rng.chance(0.65, BATCH, 1)  # the right or the bottom side more often than the others
        chosen = torch.arange(2) == rng.integers(2, BATCH, 1)
        cut = chosen & rng.chance(CUT, BATCH, 1)
        start = torch.where(cut, torch.where(last, free + beyond, -beyond), start)
        return Perspective(focal.expand(-1, 2), start - focal * low)

    def _boxes(self, masks: torch.Tensor) -> torch.Tensor:
        """Pixels of a box before some of the people, shape (B, H, W), bool."""
        rng, sides = self.rng, masks.shape[1:]
        inside = torch.ones(len(masks), *sides, dtype=torch.bool)
        for axis, side in enumerate(sides):
            there = masks.any(2 - axis)  # (B, side)
            first, last = there.byte().argmax(1), side - there.flip(1).byte().argmax(1)
            middle = torch.lerp(first.float(), last.float(), rng.uniform(len(masks)))
            half = (last - first) * rng.uniform(len(masks), low=BOX[0], high=BOX[1])
            within = (torch.arange(side) - middle[:, None]).abs() < half[:, None]
            inside &= within[:, :, None] if axis == 0 else within[:, None]
        return inside & rng.chance(BEHIND, len(masks), 1, 1)


def seen_landmarks(person: FoundPerson) -> np.ndarray:
    """``LANDMARKS`` as the label network gets them, but in pixels, shape (24, 3)."""
    known = person.keypoints
    names = skeleton(SKELETON).landmarks
    return network_keypoints(names, torch.from_numpy(known.points), torch.from_numpy(known.confidence)).numpy()


def nearest(found: Sequence[FoundPerson], points: np.ndarray, stature: float) -> tuple[FoundPerson | None, np.ndarray]:
    """The found person who is the true one, and their landmarks; sides may be swapped."""
    best, least = None, SANE
    landmarks, mirror = np.zeros((len(LANDMARKS), 3), dtype=np.float32), mirror_order(LANDMARKS)
    for person in found:
        seen = seen_landmarks(person)
        known = seen[:, 2] > 0
        off = min(np.linalg.norm(seen[:, :2] - each, axis=1)[known].mean() for each in (points, points[mirror]))
        if off / stature < least:
            best, least, landmarks = person, off / stature, seen
    return best, landmarks


def draw(picture: np.ndarray, seen: np.ndarray, true: np.ndarray) -> Image.Image:
    """Found landmarks as discs, left ones red, right ones green, full where sure, and lines to their true places."""
    image = Image.fromarray(picture)
    brush = ImageDraw.Draw(image)
    for name, (x, y, sure), place in zip(LANDMARKS, seen.tolist(), true.tolist(), strict=True):
        colour = "red" if name.startswith("left") else "lime" if name.startswith("right") else "yellow"
        if sure > 0:
            brush.line([x, y, *place], fill="white")
            brush.ellipse([x - 3, y - 3, x + 3, y + 3], fill=colour if sure > 0.5 else None, outline=colour)
    return image


def report(rows: dict[str, np.ndarray], away: np.ndarray, overlaps: np.ndarray) -> None:
    """Print what the detector's errors are."""
    off = np.linalg.norm(rows["errors"].astype(np.float32), axis=2)
    known, states = rows["confidence"] > 0, rows["states"]
    for state, name in ((SEEN, "seen"), (HIDDEN, "hidden"), (BEYOND, "beyond the picture")):
        chosen = known & (states == state)
        sure = rows["confidence"][chosen].astype(np.float32)
        middle, most = 100 * np.quantile(off[chosen], [0.5, 0.9])
        print(
            f"{name}: {100 * chosen.sum() / known.sum():.0f} %, off by {middle:.1f}, 90 % {most:.1f} % of the stature"
        )
        print(f"  confidence {np.quantile(sure, [0.1, 0.5, 0.9]).round(2).tolist()} (10, 50, 90 %)")
    for kind in dict.fromkeys(map(without_side, LANDMARKS)):
        columns = [place for place, name in enumerate(LANDMARKS) if without_side(name) == kind]
        texts = []
        for state, name in ((SEEN, "seen"), (HIDDEN, "hidden")):
            chosen = (known & (states == state))[:, columns]
            if chosen.any():
                middle, most = 100 * np.quantile(off[:, columns][chosen], [0.5, 0.9])
                texts.append(f"{name} {middle:.1f}, {most:.1f}")
        if texts:
            print(f"  {kind}: {'; '.join(texts)} % (median, 90 %)")
    points = rows["points"].astype(np.float32)
    mirror = mirror_order(LANDMARKS)
    found = points + rows["errors"].astype(np.float32)
    straight, crossed = (np.linalg.norm(found - each, axis=2) * known for each in (points, points[:, mirror]))
    for kind in ("", "shoulder", "hip", "knee", "wrist"):
        columns = [place for place, name in enumerate(LANDMARKS) if kind in name and name != "mid_hip"]
        swapped = crossed[:, columns].sum(1) < straight[:, columns].sum(1) - 0.02 * len(columns)
        shares = [100 * swapped[which].mean() for which in (away, ~away)]
        print(f"sides of {kind or 'all'} swapped: {shares[0]:.1f} % from behind, {shares[1]:.1f} % of the others")
    print(f"masks: overlap {np.quantile(overlaps, [0.1, 0.5, 0.9]).round(3).tolist()} (10, 50, 90 %)")


def main(mocap: Path, /, *, people: int = 3328, out: Path = DEFAULT, pictures: Path | None = None) -> None:
    """Learn, write and print.

    Args:
        mocap: Folder of motion capture, or a pose bank (.npz).
        people: Number of people to show.
        out: File to write; by default the package's own.
        pictures: Folder for some of the pictures, with what was found.
    """
    wp.config.log_level = wp.LOG_WARNING
    source, kept, away, overlaps = Photographer(mocap), [], [], []
    shown = several = 0
    for batch in range(-(-people // BATCH)):
        seen = source(SIZES[batch // 2 % len(SIZES)], dressed=batch % 2 == 0)
        for k, found in enumerate(find_people_in(list(seen.pictures), landmarks="heavy")):
            shown += 1
            several += len(found) > 1
            true, stature = seen.points[k], float(seen.stature[k])
            person, landmarks = nearest(found, true, stature)
            if pictures is not None and shown <= SHOWN:
                pictures.mkdir(parents=True, exist_ok=True)
                draw(seen.pictures[k], landmarks, true).save(pictures / f"{shown:03d}.png")
            if person is None:
                continue
            known = landmarks[:, 2:] > 0
            errors = np.where(known, landmarks[:, :2] - true, 0.0) / stature
            confidence = np.where(known[:, 0], np.maximum(landmarks[:, 2], LEAST), 0.0)
            kept.append(((true - true.mean(0)) / stature, errors, confidence, seen.states[k]))
            mask = instance_map([person], seen.masks.shape[1:]) > 0
            overlaps.append((mask & seen.masks[k]).sum() / max((mask | seen.masks[k]).sum(), 1))
            away.append(seen.away[k])
    points, errors, confidence, states = (np.stack(each) for each in zip(*kept, strict=True))
    halves = {"points": points, "errors": errors, "confidence": confidence}
    rows = {name: values.astype(np.float16) for name, values in halves.items()} | {"states": states}
    np.savez_compressed(out, allow_pickle=False, **rows)
    size = out.stat().st_size / 1024
    print(f"{out}: {len(kept)} of {shown} people found, {several} pictures with several; {size:.0f} KiB")
    report(rows, np.array(away), np.array(overlaps))


if __name__ == "__main__":
    run_script(main)
