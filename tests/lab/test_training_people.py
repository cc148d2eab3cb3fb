"""People made on the fly: labels, keypoints and 3D truth agree, and PartBench's people are not among them."""

from __future__ import annotations

from dataclasses import fields
from functools import cache

import numpy as np
import pytest
import torch
from helpers.bodies import bank, drawn_labels, walker

from warp_partdr.body.labels import label_set
from warp_partdr.body.landmarks import mirror_name
from warp_partdr.body.posing import pose
from warp_partdr.body.template import JOINT_NAMES, LENGTH_NAMES, MEAN_STATURE, NUM_PARTS, PART_NAMES, template
from warp_partdr.interop.checks import rotation_error
from warp_partdr.lab.synthetic import training_people
from warp_partdr.lab.synthetic.cut_masks import cut_mask
from warp_partdr.lab.synthetic.label_noise import TRAINING_LABEL_SETS
from warp_partdr.lab.synthetic.population import QUANTILES
from warp_partdr.lab.synthetic.training_people import NUM_CELLS, PeopleBatch, PeopleMaker, cell_of, held_out_cells
from warp_partdr.models.anny import anny
from warp_partdr.models.pose import pose_from_ellipbody
from warp_partdr.models.registration import shape_from_lengths
from warp_partdr.networks.regression.label_network import KNOWN_LENS, USUAL_LENS
from warp_partdr.networks.regression.landmarks import LANDMARKS

COUNT, SIZE, POOL = 48, 96, 256
PHOTOS, CUT, WHOLE = slice(18, 28), slice(18, 20), slice(20, 25)  # of COUNT people, the first 24 being dressed


def maker(device: str, **options: object) -> PeopleMaker:
    arguments: dict[str, object] = {"size": SIZE, "seed": 0, "pool": POOL, "held_out": False, **options}
    return PeopleMaker(bank(), device=device, **arguments)  # type: ignore[arg-type]


@cache
def people(device: str) -> PeopleBatch:
    return maker(device)(COUNT)


@pytest.mark.parametrize("held_out", [False, True])
def test_bodies_are_of_their_side_of_the_split(held_out: bool, device: str) -> None:
    values = maker(device, held_out=held_out).quantiles(4000).cpu().numpy()
    assert (np.isin(cell_of(values), held_out_cells()) == held_out).all()
    if not held_out:
        assert (values.min(0) < 0.01).all()
        assert (values.max(0) > 0.99).all()
        np.testing.assert_allclose(values.mean(0), 0.5, atol=0.03)
        assert len(np.unique(cell_of(values))) > 2000


def test_cells_are_a_grid() -> None:
    assert cell_of(np.array([[0.0] * len(QUANTILES), [1.0] * len(QUANTILES)])).tolist() == [0, NUM_CELLS - 1]
    corners = np.stack(np.meshgrid(*[(np.arange(4) + 0.5) / 4] * 6, indexing="ij"), axis=-1).reshape(-1, 6)
    corners = np.pad(corners, ((0, 0), (0, len(QUANTILES) - 6)), constant_values=0.7)  # others make no cells
    assert np.array_equal(cell_of(corners), np.arange(NUM_CELLS))
    # Those held out are what the packaged network has not seen.
    cells = held_out_cells()
    assert (len(cells), cells.sum(), cells @ np.arange(1, len(cells) + 1)) == (197, 386716, 51780208)


def test_people_are_complete_and_finite(device: str) -> None:
    made = people(device)
    shapes = {
        "groups": (COUNT, SIZE, SIZE),
        "label_sets": (COUNT,),
        "keypoints": (COUNT, len(LANDMARKS), 3),
        "parts": (COUNT, SIZE, SIZE),
        "points": (COUNT, len(LANDMARKS), 2),
        "joints": (COUNT, len(JOINT_NAMES), 3),
        "orientation": (COUNT, 3, 3),
        "rotations": (COUNT, NUM_PARTS, 3, 3),
        "lengths": (COUNT, len(LENGTH_NAMES)),
        "lenses": (COUNT, 3),
        "lens_certainty": (COUNT,),
        "statures": (COUNT,),
        "turns": (COUNT, 3, 3),
        "distances": (COUNT,),
    }
    assert {field.name: tuple(getattr(made, field.name).shape) for field in fields(made)} == shapes
    assert made.groups.dtype == made.parts.dtype == torch.uint8
    assert all(getattr(made, name).float().isfinite().all() for name in shapes)
    assert set(made.parts.unique().tolist()) <= {*range(NUM_PARTS + 1), 255}
    assert made.label_sets.max() < len(TRAINING_LABEL_SETS)
    shown = ((made.parts > 0) & (made.parts <= NUM_PARTS)).float().mean((1, 2))
    assert shown.min() > 0.01
    assert 0.08 < shown.mean() < 0.3
    confidence = made.keypoints[..., 2]
    assert ((confidence >= 0) & (confidence <= 1)).all()
    assert (made.keypoints[confidence == 0] == 0).all()
    assert maker(device)(0).groups.shape == (0, SIZE, SIZE)


def test_truth_poses_ellipbody_along_annys_bones(device: str) -> None:
    made = people(device)
    for matrices in (made.orientation, made.rotations):
        assert rotation_error(matrices).max() < 1e-5
    thicknesses = torch.from_numpy(template().mean_thicknesses).float().to(device).expand(COUNT, -1)
    pelvis = torch.zeros(COUNT, 3, device=device)
    posed = pose(made.orientation, pelvis, made.rotations, made.lengths, thicknesses)
    apart = (posed.joints - made.joints).norm(dim=-1)
    assert apart.mean() < 0.006
    assert apart.max() < 0.03  # the pelvis' own shape; its two parts have no rotation of their own


def test_truth_poses_anny_back_where_the_trunk_lies_along_its_bones(device: str) -> None:
    made = people(device)
    thicknesses = torch.from_numpy(template().mean_thicknesses).float().to(device).expand(COUNT, -1)
    pelvis = torch.zeros(COUNT, 3, device=device)
    posed = pose(made.orientation, pelvis, made.rotations, made.lengths, thicknesses)
    model = anny(device)
    shape = shape_from_lengths(model, posed)
    apart = []
    for along in (True, False):
        body = model.pose(shape, *pose_from_ellipbody(model, posed, shape, trunk_along=along))
        apart.append((model.landmarks(body, JOINT_NAMES) - posed.joints).norm(dim=-1).mean())
    assert apart[0] < 0.015
    assert apart[0] < 0.8 * apart[1]


def test_points_are_the_joints_seen_by_the_lens(device: str) -> None:
    made = people(device)
    names = [name for name in LANDMARKS if name in JOINT_NAMES]
    ray = made.turns[..., 2] / made.turns[:, 2:, 2]
    joints = made.joints @ made.turns.mT + (ray * made.distances[:, None])[:, None]
    seen = joints[..., :2] / joints[..., 2:] * made.lenses[:, None, :1] + made.lenses[:, None, 1:]
    points = made.points[:, [LANDMARKS.index(name) for name in names]]
    told = made.lens_certainty == KNOWN_LENS
    seen = seen[:, [JOINT_NAMES.index(name) for name in names]]
    torch.testing.assert_close(seen[told], points[told], atol=1e-4, rtol=0)


def test_lenses_are_known_or_assumed_or_neither_and_assumed_ones_are_off(device: str) -> None:
    certainty, factors = maker(device)._told_lenses(torch.full((4000, 1), 3.0, device=device))
    shares = [float((certainty == each).float().mean()) for each in (KNOWN_LENS, USUAL_LENS, 0.0)]
    assert sum(shares) == pytest.approx(1.0)
    assert np.allclose(shares, [0.35, 0.5, 0.15], atol=0.04)
    assert (factors[certainty != USUAL_LENS] == 1.0).all()
    assert float(factors[certainty == USUAL_LENS].log().std()) == pytest.approx(0.25, abs=0.03)
    made = people(device)
    # A joint off the lens's axis tells how many times too long the focal length is.
    near = made.distances < 50
    ray = made.turns[..., 2] / made.turns[:, 2:, 2]
    joints = made.joints @ made.turns.mT + (ray * made.distances[:, None])[:, None]
    point = made.points[:, LANDMARKS.index("neck")] - made.lenses[:, 1:]
    neck = joints[:, JOINT_NAMES.index("neck")]
    aside = neck[:, :2] / neck[:, 2:] * made.lenses[:, :1]
    factors = (aside * point).sum(1) / point.square().sum(1)
    off = factors.log()[near & (made.lens_certainty == USUAL_LENS)]
    assert 0.12 < off.std() < 0.4
    assert abs(off.mean()) < 0.2


def test_some_statures_are_known_within_a_few_centimetres(device: str) -> None:
    made = people(device)
    known = made.statures > 0
    assert 0.02 < known.float().mean() < 0.5  # a quarter of few people
    assert made.statures[known].min() > 0.7
    assert made.statures[known].max() < 2.3


def test_cameras_are_near_and_far(device: str) -> None:
    made = people(device)
    far = made.distances > 50
    assert 0.05 < far.float().mean() < 0.3
    assert made.distances[~far].min() < 2.5
    assert made.distances[~far].max() > 5
    aside = (made.turns[:, 2, 2]).acos()
    assert aside[far].max() < 1e-3
    assert aside.max() > 0.2
    tilted = made.orientation[:, 1, 1] > -0.7
    assert 0.05 < tilted.float().mean() < 0.5


def test_labels_lie_where_the_points_are_left_and_right(device: str) -> None:
    made = people(device)
    places = (torch.arange(SIZE, device=device) + 0.5) * 2 / SIZE - 1
    grid = torch.stack(torch.meshgrid(places, places, indexing="xy"), dim=-1)
    for side in ("left", "right"):
        for part, joint in (("hand", "wrist"), ("foot", "ankle"), ("forearm", "elbow")):
            mask = (made.parts == PART_NAMES.index(f"{side}_{part}") + 1)[..., None].float()
            seen = mask.sum((1, 2))[:, 0] > 12
            centre = (grid * mask).sum((1, 2)) / mask.sum((1, 2)).clamp(min=1)
            own = (centre - made.points[:, LANDMARKS.index(f"{side}_{joint}")]).norm(dim=1)[seen]
            other = (centre - made.points[:, LANDMARKS.index(mirror_name(f"{side}_{joint}"))]).norm(dim=1)[seen]
            assert seen.sum() > COUNT / 4
            assert own.median() < 0.2
            assert (own < other).float().mean() > 0.8


def test_beyond_the_border_nothing_is_seen(device: str) -> None:
    made = people(device)
    beyond = made.parts == 255
    assert (made.groups[beyond] == 255).all()
    assert 0.05 < beyond.float().mean() < 0.6
    straight = beyond.all(1)[:, None, :] | beyond.all(2)[:, :, None]
    assert torch.equal(beyond, straight)
    found = made.keypoints[..., 2] > 0
    found[PHOTOS] = False  # the packaged detector guesses there, too
    pixels = ((made.keypoints[..., :2] + 1) * SIZE / 2).floor().long()
    inside = found & ((pixels >= 0) & (pixels < SIZE)).all(-1)
    where = (pixels[..., 1] * SIZE + pixels[..., 0]).clamp(0, SIZE**2 - 1)
    # A border between two pixels' centres leaves half a pixel.
    grown = torch.nn.functional.max_pool2d((~beyond).float(), 3, 1, 1).flatten(1)
    assert (grown.gather(1, where)[inside] > 0).all()


def test_standing_people_are_upright_and_look_anywhere(device: str) -> None:
    ups = torch.tensor([0.0, 1.0, 0.0], device=device).expand(2000, 3)
    orientation = maker(device).orientations(ups)
    up = -orientation[:, 1, 1]  # the camera's y is down
    tilts = torch.rad2deg(up.clamp(-1, 1).acos())
    assert tilts.median() < 20
    assert 35 < tilts.quantile(0.95) < 65  # of tilted cameras
    forward = torch.atan2(orientation[:, 0, 2], -orientation[:, 2, 2])
    quarters = torch.histc(forward.cpu(), bins=4, min=-np.pi, max=np.pi) / 2000
    assert (quarters > 0.2).all()


def test_same_seed_same_people_and_states_go_on(device: str) -> None:
    first, second, fresh = (maker(device, pool=40) for _ in range(3))
    for _ in range(2):  # into a second pool
        assert same(first(25), second(25))
    fresh.load_state_dict(first.state_dict())
    later = first(25)
    assert same(fresh(25), later)
    assert not torch.equal(maker(device, pool=40, seed=1)(25).keypoints, later.keypoints)


def same(first: PeopleBatch, second: PeopleBatch) -> bool:
    return all(torch.equal(getattr(first, field.name), getattr(second, field.name)) for field in fields(first))


def test_precision_of_training_stays_out_and_comes_back(device: str) -> None:
    before = torch.get_float32_matmul_precision()
    exact = maker(device)(COUNT)
    torch.set_float32_matmul_precision("medium")
    try:
        with torch.autocast(torch.device(device).type, dtype=torch.bfloat16):
            made = maker(device)(COUNT)
        assert torch.get_float32_matmul_precision() == "medium"
    finally:
        torch.set_float32_matmul_precision(before)
    torch.testing.assert_close(made.joints, exact.joints, atol=1e-6, rtol=0)


def test_a_mask_is_cut_by_its_own_bones_about_where_parts_end(device: str) -> None:
    body = walker(device)
    picture = drawn_labels(body, label_set("ellipbody20"), SIZE)
    joints = body.camera(2).project(body.posed().joints)[..., :2] - 1
    stature = MEAN_STATURE * body.log_scale.exp()
    sure, unsure = (
        cut_mask(picture > 0, joints, stature, torch.tensor([said], device=device)) for said in (False, True)
    )
    assert torch.equal(sure > 0, picture > 0)
    assert (sure == picture)[picture > 0].float().mean() > 0.75
    assert set(sure.unique().tolist()) == set(range(NUM_PARTS + 1))
    unknown = unsure == 255
    assert torch.equal(unsure[~unknown], sure[~unknown])
    assert 0 < unknown.float().sum() < 0.2 * (picture > 0).sum()


def test_only_parts_that_are_no_neighbours_hide_each_other(device: str) -> None:
    """A hand before the chest makes its surroundings unknown, the elbow of a stretched arm does not."""
    joints = torch.zeros(1, len(JOINT_NAMES), 2, device=device)
    joints[0, :, 0] = 5.0  # out of sight
    places = {"spine": (0.0, 0.3), "neck": (0.0, -0.3), "left_shoulder": (0.3, -0.3), "left_elbow": (0.3, 0.1)}
    places |= {"left_wrist": (0.05, 0.0), "left_fingertip": (-0.1, 0.0)}
    for name, place in places.items():
        joints[0, JOINT_NAMES.index(name)] = torch.tensor(place, device=device)
    mask, yes = torch.ones(1, 64, 64, dtype=torch.bool, device=device), torch.ones(1, dtype=torch.bool, device=device)
    found = cut_mask(mask, joints, torch.full((1,), 1.5, device=device), yes)[0]

    def at(x: float, y: float) -> int:
        return int(found[round(32 * (y + 1)), round(32 * (x + 1))])

    assert at(-0.05, 0.0) == 255  # hand and chest
    assert at(0.3, 0.08) != 255  # upper arm and forearm
    assert at(0.3, -0.1) == PART_NAMES.index("left_upper_arm") + 1
    assert at(-0.1, -0.25) == PART_NAMES.index("chest") + 1


def test_photos_people_have_the_detectors_landmarks_and_masks(device: str) -> None:
    made = people(device)
    names = list(TRAINING_LABEL_SETS)
    assert [names[index] for index in made.label_sets[CUT].tolist()] == ["ellipbody20"] * 2
    assert [names[index] for index in made.label_sets[WHOLE].tolist()] == ["full1"] * 5
    assert (made.label_sets != names.index("full1")).float().mean() > 0.8
    confidence = made.keypoints[PHOTOS, :, 2]
    missing = [LANDMARKS.index(name) for name in ("neck", "head_top", "mid_hip")]
    assert (confidence[:, missing] == 0).all()
    rest = [place for place in range(len(LANDMARKS)) if place not in missing]
    assert (confidence[:, rest] > 0).all()  # nothing is left out
    off = (made.keypoints[PHOTOS, :, :2] - made.points[PHOTOS]).norm(dim=-1)[:, rest]
    assert 0.01 < off[confidence[:, rest] > 0.9].median() < 0.08  # crops are about 2.4 bodies wide


def test_masks_are_cut_at_the_joints_as_the_detector_places_them(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[torch.Tensor] = []

    def watch(mask: torch.Tensor, joints: torch.Tensor, *rest: torch.Tensor) -> torch.Tensor:
        given.append(joints)
        return cut_mask(mask, joints, *rest)

    monkeypatch.setattr(training_people, "cut_mask", watch)
    made = maker(device)(COUNT)
    (joints,) = given
    for name in ("left_knee", "right_elbow", "left_hip"):
        seen = made.keypoints[CUT, LANDMARKS.index(name), :2]
        torch.testing.assert_close(joints[:, JOINT_NAMES.index(name)], seen, atol=1e-4, rtol=0)
