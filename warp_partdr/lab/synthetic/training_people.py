"""People made on the fly, on any device: Anny bodies in many poses and views, and what networks would see of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from ...body.labels import IGNORE
from ...body.landmarks import annotated
from ...body.lens import rotations_to
from ...body.posing import Posed
from ...body.rotations import rotation_from_axis_angle
from ...body.template import BONE_STARTS, JOINT_NAMES, LENGTH_NAMES, MEAN_STATURE, SHAPE_INDICES
from ...cameras import ScreenCamera
from ...inputs.observation import CROP_MARGIN
from ...models.anny import anny
from ...models.measuring import heights
from ...models.model import Detailed
from ...models.point_sums import sum_points
from ...models.pose import pose_from_ellipbody
from ...networks.regression.heads import cell_centres
from ...networks.regression.label_network import KNOWN_LENS, USUAL_LENS
from ...networks.regression.landmarks import LANDMARKS
from ...render.mesh import PartImage, draw_mesh
from ...render.part_mesh import PartMesh
from . import people
from .cut_masks import cut_mask
from .detector_errors import BEYOND, DetectorErrors, move_joints
from .keypoint_noise import KeypointNoise
from .label_noise import TRAINING_LABEL_SETS, LabelNoise, draw_absent, draw_strengths
from .occluders import draw_occluders
from .partbench_people import NUM_PEOPLE, draw_quantiles
from .population import QUANTILES, population
from .pose_sampler import PoseBank, PoseSampler
from .poses import mean_body
from .rng import TorchRng, exact_float32
from .wardrobe import wardrobe

# Training leaves to PartBench the bodies in a cell with one of its people, of a grid over the first ``QUANTILES``: sex,
# age, muscle, proportions, stature and waist.
CELL_LEVELS, _CELL_QUANTILES = 4, 6
NUM_CELLS = CELL_LEVELS**_CELL_QUANTILES
_FAR = 0.15  # share of cameras so far away that 1/z is as good as linear: weak perspective
_FAR_AWAY = 100.0  # [m]
_DISTANCE = (1.4, 12.0)  # [m], of the other cameras; small ones as often as large ones, as logarithms
# Shares of people whose camera's lens the network knows, and for whom a usual one is assumed. A usual lens is off by a
# factor whose logarithm has this standard deviation: focal lengths of phones and cameras are 0.65 to 1.6 of a picture's
# longer side. Of a camera far away it tells some distance of a near one.
_KNOWN, _ASSUMED, _ASSUMED_OFF = 0.35, 0.5, 0.25
_STATURE_KNOWN = 0.25  # share of people whose stature the network knows,
_STATURE_OFF = 0.01  # [m], with an error of this standard deviation
# A person is off the optical axis by tangents of this standard deviation, or of a wide picture evenly up to this.
_ASIDE, _WIDE_ASIDE, _WIDE = 0.08, 0.5, 0.35
# Mean and standard deviation of pitch and roll [degrees], of most cameras and of the others; one above looks down.
_TILTS = ((7.0, 12.0), (0.0, 5.0)), ((8.0, 32.0), (0.0, 18.0))
_TILTED = 0.3
_CROP_JITTER = 0.06  # of the crop's half side
_CUT = 0.25  # share of people of whom the picture's border cuts off
_CUT_SHARE = (0.03, 0.55)  # of their height or width
_CUT_SIDES = (0.22, 0.16, 0.22, 0.4)  # left, top, right, bottom
_BORDER = 0.7  # chance of each other side of the picture to be near, at most:
_NEAR = 0.35  # of the person's longer extent
_OPEN = 100.0  # [m], where a side isn't near

_DRESSED = 0.5  # share of people who wear clothes, which labels show
_COCO = 0.5  # share of people whose keypoints are as COCO's annotators place them
# Share of people as a photo's are, whom the packaged detector finds, and how many of them are dressed. First come those
# with a mask cut by bones, of most of whom overlapping limbs are unknown, then those with a whole mask, as `fit_photo`
# takes it, and those with labels of a part network.
_PHOTOS, _PHOTOS_DRESSED = 0.2, 0.6
_CUT_MASKS, _WHOLE_MASKS = 0.05, 0.1
_UNSURE = 0.7
_EVERY_PART, _ONE_PART = (list(TRAINING_LABEL_SETS).index(name) for name in ("ellipbody20", "full1"))


@dataclass(frozen=True)
class PeopleBatch:
    """B people: what a network sees, and the truth; crops have side 2, coordinates -1 to 1, and S pixels a side."""

    groups: torch.Tensor  # group ids, 0 = background, 255 = unknown or beyond the picture, shape (B, S, S), uint8
    label_sets: torch.Tensor  # index into ``TRAINING_LABEL_SETS`` of the groups' label set, shape (B,), int64
    keypoints: torch.Tensor  # ``LANDMARKS`` as seen: crop coordinates, confidence; 0 where missing, shape (B, 24, 3)
    parts: torch.Tensor  # true part labels 0 to 20, 255 beyond the picture, shape (B, S, S), uint8
    points: torch.Tensor  # true ``LANDMARKS`` of the bones, not of COCO's annotators, shape (B, 24, 2)
    joints: torch.Tensor  # true ``JOINT_NAMES`` of Anny, pelvis at 0 [m], seen along its ray, shape (B, 21, 3)
    orientation: torch.Tensor  # EllipBody's global orientation, seen along the ray to its pelvis, shape (B, 3, 3)
    rotations: torch.Tensor  # EllipBody's local rotations, its bones along Anny's, shape (B, 20, 3, 3)
    lengths: torch.Tensor  # ``LENGTH_NAMES`` between Anny's joints, both sides' mean [m], shape (B, 12)
    lenses: torch.Tensor  # focal length and principal point that the network is told, shape (B, 3)
    lens_certainty: torch.Tensor  # of these: ``KNOWN_LENS`` for the true ones, ``USUAL_LENS``, or 0, shape (B,)
    statures: torch.Tensor  # that the network is told [m], 0 where it is not, shape (B,)
    turns: torch.Tensor  # from the frame along the ray to the camera's, shape (B, 3, 3)
    distances: torch.Tensor  # of the pelvis from the camera, along its axis [m], shape (B,)

    def select(self, index: torch.Tensor) -> PeopleBatch:
        """Some of the people."""
        return PeopleBatch(**{name: value[index] for name, value in vars(self).items()})


@dataclass(frozen=True)
class DressedPeople:
    """People who all wear clothes, each before a camera.

    Attributes:
        vertices: Vertices of the wardrobe's mesh, in a frame that has the camera's axes [m], shape (B, V, 3).
        seen: Vertices as the camera sees them: places at the pelvis' depth, the pelvis at 0, and depth [m], (B, V, 3).
        joints: Places of ``JOINT_NAMES`` as the camera sees them, at the pelvis' depth [m], shape (B, 21, 2).
        worn: Index of each person's outfit in the wardrobe, shape (B,), int64.
    """

    vertices: torch.Tensor
    seen: torch.Tensor
    joints: torch.Tensor
    worn: torch.Tensor


@dataclass(frozen=True)
class _Bodies:
    """Bare people in poses, in a frame that has the camera's axes [m]."""

    orientation: torch.Tensor  # of the pelvis, shape (B, 3, 3)
    posed: Posed  # EllipBodies in the same poses
    rest: Detailed
    stance: tuple[torch.Tensor, torch.Tensor]  # Anny's rotations and translation
    body: Detailed
    landmarks: torch.Tensor  # ``LANDMARKS`` of the bones, shape (B, 24, 3)
    annotated: torch.Tensor  # ``LANDMARKS`` as COCO's annotators place them, shape (B, 24, 3)
    joints: torch.Tensor  # ``JOINT_NAMES``, shape (B, 21, 3)


@dataclass(frozen=True)
class _View:
    """Cameras of people whose pelvises are at ``pelvis`` (B, 3) in the frame that they were posed in [m]."""

    pelvis: torch.Tensor
    distance: torch.Tensor  # of the pelvis, along the camera's axis [m], shape (B, 1)
    aside: torch.Tensor  # tangents of the ray to the pelvis, shape (B, 2)

    def __call__(self, points: torch.Tensor) -> torch.Tensor:
        """Points as the camera sees them: places at the pelvis' depth, the pelvis at 0, and depth [m], (B, N, 3)."""
        aside = self.aside * self.distance  # 0 for those far away, so that no digits are lost
        camera = self.pelvis - torch.cat([aside, self.distance], dim=1)
        scale = torch.nn.functional.pad(self.distance.expand(-1, 2), (0, 1), value=1.0)
        # Two passes, for these may be all vertices of many people.
        seen = torch.addcmul((-scale * camera)[:, None], points, scale[:, None])
        flat = seen[..., :2]
        torch.addcdiv(-aside[:, None], flat, seen[..., 2:], out=flat)
        return seen

    def select(self, index: slice) -> _View:
        """Some of the cameras."""
        return _View(self.pelvis[index], self.distance[index], self.aside[index])

    def turns(self) -> torch.Tensor:
        """Shortest rotations from the camera's axis to the rays to the pelvises, shape (B, 3, 3)."""
        return rotations_to(torch.nn.functional.pad(self.aside, (0, 1), value=1.0))

    def lenses(self, crop: _Crop, factors: torch.Tensor) -> torch.Tensor:
        """Focal lengths, times ``factors`` (B, 1), and principal points in crop coordinates, shape (B, 3)."""
        centre = crop((-self.aside * self.distance)[:, None])[:, 0]
        return torch.cat([factors * self.distance / crop.half[:, None], centre], dim=1)


@dataclass(frozen=True)
class _Crop:
    """Crops of a plane that is seen at the pelvis' depth [m], and the part of them that lies in the picture."""

    centre: torch.Tensor  # (B, 2)
    half: torch.Tensor  # (B,)
    low: torch.Tensor  # (B, 2), of the picture, crop coordinates
    high: torch.Tensor  # (B, 2)

    def __call__(self, flat: torch.Tensor) -> torch.Tensor:
        """Crop coordinates of points (B, N, 2)."""
        return (flat - self.centre[:, None]) / self.half[:, None, None]

    def to_pixels(self, points: torch.Tensor, size: int) -> None:
        """Turn places of points (b, N, 3) of the first b people into pixels of crops so many wide; depth stays."""
        scale, flat = size / 2 / self.half[: len(points), None], points[..., :2]
        shift = size / 2 - scale * self.centre[: len(points)]
        torch.addcmul(shift[:, None], flat, scale[:, None], out=flat)

    def unseen(self, size: int) -> torch.Tensor:
        """True for pixels beyond the picture's border, shape (B, size, size), bool."""
        centres = cell_centres(size, self.half.device)
        beyond = (centres < self.low[..., None]) | (centres > self.high[..., None])  # (B, 2, size)
        return beyond[:, 1, :, None] | beyond[:, 0, None, :]


def _inside(points: torch.Tensor, low: torch.Tensor, high: torch.Tensor) -> torch.Tensor:
    """True for points (B, N, 2) between corners (B, 2), shape (B, N), bool."""
    return ((points > low[:, None]) & (points < high[:, None])).all(-1)


def _corners(points: torch.Tensor, counted: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Least and largest coordinates of the points (B, N, 2) that count, (B, 2) each; infinite where none does."""
    counted = counted[..., None]
    least = torch.where(counted, points, torch.inf).amin(1)
    return least, torch.where(counted, points, -torch.inf).amax(1)


def _photos(count: int, dressed: int) -> tuple[slice, slice, slice]:
    """Slices of ``count`` people: those who are as a photo's, and among them those with cut and with whole masks.

    The first ``dressed`` people wear clothes.
    """
    first = dressed - round(_PHOTOS_DRESSED * _PHOTOS * count)
    cut, whole = (first + round(share * count) for share in (_CUT_MASKS, _CUT_MASKS + _WHOLE_MASKS))
    return slice(first, first + round(_PHOTOS * count)), slice(first, cut), slice(cut, whole)


def cell_of(quantiles: np.ndarray) -> np.ndarray:
    """Cells of people with quantiles (..., 15), 0 to 1, shape (...)."""
    levels = (quantiles[..., :_CELL_QUANTILES] * CELL_LEVELS).astype(np.int64).clip(0, CELL_LEVELS - 1)
    return np.ravel_multi_index(np.moveaxis(levels, -1, 0), (CELL_LEVELS,) * _CELL_QUANTILES)


@lru_cache(maxsize=1)
def held_out_cells() -> np.ndarray:
    """Cells that training leaves to PartBench, ascending, int64."""
    return np.unique(cell_of(np.array([draw_quantiles(index)[0] for index in range(NUM_PEOPLE)])))


class PeopleMaker:
    """Makes people, the same for a seed and a device, in crops of ``size`` pixels a side.

    Bodies are of cells to train on or, with ``held_out``, of the others; ``poses`` are to be of the same side of the
    split, and ``pool`` of them are made at once.
    """

    def __init__(
        self, poses: PoseBank, *, size: int, device: torch.device | str, seed: int, held_out: bool, pool: int = 8192
    ) -> None:
        self.size, self.device = size, torch.device(device)
        self.model, self.mesh = anny(self.device), people.anny_mesh(self.device)
        self._wardrobe = wardrobe(self.device)
        # Seeds lie so far apart because each pool of poses takes one of its own, from this one upward.
        self._poses = PoseSampler(poses, device=device, seed=seed << 20, pool=pool)
        self._rng = TorchRng(seed << 20, self.device)
        self._labels, self._detectors = LabelNoise(self._rng), KeypointNoise(self._rng)
        self._errors = DetectorErrors(self._rng)
        cells = held_out_cells() if held_out else np.setdiff1d(np.arange(NUM_CELLS), held_out_cells())
        self._cells = self._numbers(np.stack(np.unravel_index(cells, (CELL_LEVELS,) * _CELL_QUANTILES), axis=1))
        self._population = population(self.device)
        groups = (LANDMARKS, annotated(LANDMARKS, self.model.landmark_names), JOINT_NAMES)
        self._landmark_weights = self.model.weights_of([name for group in groups for name in group])
        self._landmark_counts = [len(group) for group in groups]
        self._cover = self._numbers(people.cover_of(LANDMARKS))
        self._cut_odds = self._numbers(np.array(_CUT_SIDES))
        of_length = np.array([[row[0] == length for row in SHAPE_INDICES] for length in range(len(LENGTH_NAMES))])
        self._bone_starts = torch.tensor(BONE_STARTS, device=self.device)
        self._length_weights = self._numbers(of_length / of_length.sum(1, keepdims=True))

    def _numbers(self, values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(values).to(self.device, torch.float32)

    def state_dict(self) -> dict[str, Any]:
        """State of the generators, which makes the next people what they are."""
        return {"generator": self._rng.generator.get_state(), "poses": self._poses.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Go on from such a state of a maker with the same arguments."""
        self._rng.generator.set_state(state["generator"].cpu())
        self._poses.load_state_dict(state["poses"])

    @torch.no_grad()
    def __call__(self, count: int) -> PeopleBatch:
        """``count`` people."""
        with exact_float32(self.device):
            return self._make(count)

    def quantiles(self, count: int) -> torch.Tensor:
        """``QUANTILES`` of random people, shape (count, 15)."""
        drawn = self._rng.uniform(count, len(QUANTILES))
        cells = self._cells[self._rng.integers(len(self._cells), count)]
        drawn[:, :_CELL_QUANTILES] = (cells + drawn[:, :_CELL_QUANTILES]) / CELL_LEVELS
        return drawn

    def shapes(self, count: int) -> torch.Tensor:
        """Shape values of random people, as ``anny().pose`` takes them, shape (count, 20)."""
        return self._population.shapes(self.quantiles(count))

    @torch.no_grad()
    def dressed(self, count: int) -> DressedPeople:
        """``count`` people who all wear clothes."""
        with exact_float32(self.device):
            bodies = self._bodies(count)
            view = self._view(bodies.joints[:, :1])
            vertices, worn = self._cloth(bodies.rest, *bodies.stance)
            return DressedPeople(vertices, view(vertices), view(bodies.joints)[..., :2], worn)

    def _bodies(self, count: int) -> _Bodies:
        vectors, ups = self._poses.draw(count)
        orientation = self.orientations(ups)
        shape = self.shapes(count)
        posed = mean_body(rotation_from_axis_angle(vectors), orientation)
        rest, stance = self.model.rest(shape), pose_from_ellipbody(self.model, posed, shape)
        body = self.model.carry(rest.vertices, rest.joints, *stance)
        known = sum_points(self._landmark_weights, body.vertices, body.joints)
        return _Bodies(orientation, posed, rest, stance, body, *known.split(self._landmark_counts, dim=1))

    def _make(self, count: int) -> PeopleBatch:
        rng, size = self._rng, (self.size, self.size)
        bodies = self._bodies(count)
        rest, stance, stature = bodies.rest, bodies.stance, heights(bodies.rest)
        plain, joints = bodies.landmarks, bodies.joints
        noted = torch.where(rng.chance(_COCO, count, 1, 1), bodies.annotated, plain)
        dressed = round(_DRESSED * count)  # as many in every batch, as are photos' people: nothing waits
        photos, cut, whole = _photos(count, dressed)
        noted[photos] = plain[photos]

        view = self._view(joints[:, :1])
        cloth, _ = self._cloth(rest.select(slice(dressed)), *(each[:dressed] for each in stance))
        vertices, noted, plain = (view(points) for points in (bodies.body.vertices, noted, plain))
        cloth = view.select(slice(dressed))(cloth)
        strength, label_sets = draw_strengths(count, rng), self._labels.label_sets(count)
        label_sets[cut], label_sets[whole] = _EVERY_PART, _ONE_PART
        no_labels, no_keypoints = draw_absent(count, rng)
        detected = self._detectors.detected(count) & ~no_keypoints[:, None]
        detected[photos] = self._errors.known
        outlines = cloth[..., :2], vertices[dressed:, :, :2]
        crop = self._crop(outlines, noted[..., :2], detected, ~no_labels)

        def draw(points: torch.Tensor, mesh: PartMesh) -> PartImage:
            return draw_mesh(points, mesh, ScreenCamera(perspective=True), size, validate=False)

        for each in (vertices, cloth):
            crop.to_pixels(each, self.size)
        picture = draw(vertices, self.mesh)
        shown = torch.cat([draw(cloth, self._wardrobe.mesh).labels, picture.labels[dressed:]])
        unseen = crop.unseen(self.size)
        parts = picture.labels.masked_fill(unseen, IGNORE)

        some = rng.integers(vertices.shape[1], count, 6)
        positions = vertices[..., :2].gather(1, some[..., None].expand(-1, -1, 2)) * (2 / self.size) - 1
        occluders = draw_occluders(rng, parts, self._labels.tables(label_sets), positions, strength)
        points = crop(noted[..., :2])
        pixels = people.pixel_indices((points + 1) * (self.size / 2), size)
        cover = self._cover * (stature / MEAN_STATURE)[:, None]
        hidden = people.behind_something(noted[..., 2], pixels, picture.depth, cover)
        hidden |= occluders.hiding.flatten(1).gather(1, pixels)
        height = stature / crop.half  # standing, in the crop
        keypoints = self._detectors.keypoints(points, hidden, detected, height, strength)
        keypoints = keypoints * _inside(keypoints[..., :2], crop.low, crop.high)[..., None]
        states = torch.where(_inside(points, crop.low, crop.high), hidden.long(), BEYOND)
        keypoints[photos], errors = self._errors.keypoints(points[photos], states[photos], height[photos])
        found = move_joints(crop(view(joints)[..., :2])[cut], errors[: cut.stop - cut.start])
        shown[cut] = cut_mask(shown[cut] > 0, found, height[cut], rng.chance(_UNSURE, len(found)))
        groups = self._labels.groups(shown, label_sets, strength)
        groups = torch.where(occluders.mask, occluders.groups, groups)
        certainty, factors = self._told_lenses(view.distance)
        along = view.turns().mT
        joints = (joints - joints[:, :1]) @ along.mT
        bones = joints[:, 1:] - joints[:, self._bone_starts]
        lengths = bones.norm(dim=-1)
        orientation, world = along @ bodies.orientation, along[:, None] @ bodies.posed.rotations
        return PeopleBatch(
            groups=groups.masked_fill(unseen | no_labels[:, None, None], IGNORE),
            label_sets=label_sets,
            keypoints=keypoints,
            parts=parts,
            points=crop(plain[..., :2]),
            joints=joints,
            orientation=orientation,
            rotations=people.rotations_along(bones / lengths[..., None], orientation, world),
            lengths=lengths @ self._length_weights.T,
            lenses=view.lenses(crop, factors),
            lens_certainty=certainty[:, 0],
            statures=torch.where(rng.chance(_STATURE_KNOWN, count), stature + _STATURE_OFF * rng.normal(count), 0.0),
            turns=along.mT,
            distances=view.distance[:, 0],
        )

    def _cloth(
        self, rest: Detailed, rotations: torch.Tensor, translation: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Vertices of the wardrobe's mesh, of bodies at rest that are dressed and posed; and indices of the outfits."""
        worn = self._rng.integers(self._wardrobe.size, len(rotations))
        vertices = self._wardrobe.offsets(worn).add_(rest.vertices)
        return self._wardrobe.vertices(self.model.carry(vertices, rest.joints, rotations, translation), worn), worn

    def orientations(self, ups: torch.Tensor) -> torch.Tensor:
        """The pelvis in the camera frame, (B, 3, 3): upright as ``ups`` (B, 3) says, looking anywhere, and tilted."""
        count, rng = len(ups), self._rng
        yaw = rng.uniform(count, low=-np.pi, high=np.pi)
        usual, others = torch.tensor(_TILTS, device=self.device)  # (2, 2) each
        angles = torch.where(rng.chance(_TILTED, count, 1, 1), others, usual)
        pitch, roll = torch.deg2rad(angles[..., 0] + angles[..., 1] * rng.normal(count, 2)).unbind(1)
        return people.seen_by_camera(people.upright(ups, yaw), pitch, roll)

    def _view(self, pelvises: torch.Tensor) -> _View:
        """Random cameras of people with pelvises (B, 1, 3) [m]."""
        count, rng = len(pelvises), self._rng
        near, far = np.log(_DISTANCE)
        distance = rng.uniform(count, 1, low=near, high=far).exp()
        distance = torch.where(rng.chance(_FAR, count, 1), _FAR_AWAY, distance)
        wide = rng.uniform(count, 2, low=-_WIDE_ASIDE, high=_WIDE_ASIDE)
        aside = torch.where(rng.chance(_WIDE, count, 1), wide, _ASIDE * rng.normal(count, 2))
        aside = torch.where(distance < _FAR_AWAY, aside, 0.0)
        return _View(pelvises[:, 0], distance, aside)

    def _told_lenses(self, distance: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Certainty of the lenses that the network is told, and what their focal lengths are times too long, (B, 1).

        ``distance`` (B, 1) is that of the true cameras [m].
        """
        count, rng = len(distance), self._rng
        kind, near, far = rng.uniform(count, 1), *np.log(_DISTANCE)
        assumed = (kind >= _KNOWN) & (kind < _KNOWN + _ASSUMED)
        certainty = torch.where(kind < _KNOWN, KNOWN_LENS, torch.where(assumed, USUAL_LENS, 0.0))
        off = (_ASSUMED_OFF * rng.normal(count, 1)).exp()
        as_if_near = rng.uniform(count, 1, low=near, high=far).exp() / _FAR_AWAY
        off = torch.where(distance < _FAR_AWAY, off, as_if_near)
        return certainty, torch.where(assumed, off, 1.0)

    def _crop(
        self, outlines: Sequence[torch.Tensor], points: torch.Tensor, detected: torch.Tensor, labelled: torch.Tensor
    ) -> _Crop:
        """The picture's border, and the square that ``observe`` cuts out, about.

        Of vertices of some people after others, (b, V, 2) each, keypoints (B, 24, 2) [m], which of these are
        ``detected``, and who is ``labelled``.
        """
        count, rng, sizes = len(points), self._rng, [len(each) for each in outlines]
        low, high = map(torch.cat, zip(*(each.aminmax(dim=1) for each in outlines), strict=True))
        longest = (high - low).amax(1, keepdim=True)
        near = rng.chance(_BORDER, count, 4)
        beyond = torch.where(near, _NEAR * longest * rng.uniform(count, 4), _OPEN)  # left, top, right, bottom
        share = rng.uniform(count, 1, low=_CUT_SHARE[0], high=_CUT_SHARE[1])
        side = torch.arange(4, device=self.device) == rng.choice(self._cut_odds, count)[:, None]
        cut = side & rng.chance(_CUT, count, 1)
        beyond = torch.where(cut, -share * (high - low).repeat(1, 2), beyond)
        first, last = low - beyond[:, :2], high + beyond[:, 2:]

        some = zip(outlines, *(each.split(sizes) for each in (labelled[:, None], first, last)), strict=True)
        corners = [_corners(positions, shown & _inside(positions, *border)) for positions, shown, *border in some]
        least, most = _corners(points, detected & _inside(points, first, last))
        starts, ends = map(torch.cat, zip(*corners, strict=True))
        start, end = torch.minimum(starts, least), torch.maximum(ends, most)
        empty = ~(end - start).isfinite()
        start, end = torch.where(empty, low, start), torch.where(empty, high, end)
        extent = (end - start).amax(1).clamp(min=0.1)
        jitter = rng.uniform(count, 3, low=-_CROP_JITTER, high=_CROP_JITTER)
        half = extent * (0.5 + CROP_MARGIN) * (1 + jitter[:, 0])
        centre = (start + end) / 2 + half[:, None] * jitter[:, 1:]
        return _Crop(centre, half, (first - centre) / half[:, None], (last - centre) / half[:, None])
