"""Clothes lie outside of the body, on both sides alike, and skirts close the gap between the legs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from warp_partdr.body.template import PART_NAMES
from warp_partdr.cameras import WeakPerspective
from warp_partdr.lab.synthetic.garments import GARMENTS, Worn, draw_outfit, dress, offsets
from warp_partdr.lab.synthetic.partbench_people import make_person
from warp_partdr.lab.synthetic.skin import anny_skin, normals
from warp_partdr.models.anny import anny
from warp_partdr.models.model import Detailed
from warp_partdr.render.mesh import draw_mesh

SHAPE = torch.zeros(1, 20)
SIZE = (300, 200)


def worn(name: str, **values: float) -> Worn:
    drawn = next(
        each for index in range(100) for each in draw_outfit(np.random.default_rng(index)) if each.name == name
    )
    return replace(drawn, **values)


def from_the_front(vertices: np.ndarray) -> np.ndarray:
    """Points are in the frame of a camera that a person at rest looks at; x stays the person's left."""
    return vertices * np.array([1.0, -1.0, -1.0], dtype=np.float32)


def draw_front(outfit: tuple[Worn, ...], body: Detailed | None = None) -> np.ndarray:
    vertices, mesh = dress(body or anny().rest(SHAPE), SHAPE, outfit)
    camera = WeakPerspective(torch.tensor([150.0]), torch.tensor([[100.0, 150.0]]))
    return draw_mesh(torch.from_numpy(from_the_front(vertices))[None], mesh, camera, SIZE).labels[0].numpy()


def seated() -> Detailed:
    """Anny with both thighs forward and shins down."""
    model = anny()
    turns = torch.eye(3).repeat(1, len(model.joint_names), 1, 1)
    forward = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    for side in "LR":
        turns[:, model.joint_names.index(f"upperleg01.{side}")] = forward
        turns[:, model.joint_names.index(f"lowerleg01.{side}")] = forward.T
    return model.pose(SHAPE, turns, torch.zeros(1, 3))


def test_outfits_are_drawn_from_the_table_the_same_every_time():
    outfits = [draw_outfit(np.random.default_rng(index)) for index in range(400)]
    for outfit in outfits:
        slots = [GARMENTS[each.name].slot for each in outfit]
        assert len(set(slots)) == len(slots)
        for each in outfit:
            garment = GARMENTS[each.name]
            for name in ("thickness", "sleeve", "hem", "flare"):
                low, high = getattr(garment, name) or (0.0, 0.0)
                assert low <= getattr(each, name) <= high
    for name, garment in GARMENTS.items():
        share = np.mean([name in [each.name for each in outfit] for outfit in outfits])
        assert abs(share - garment.chance) < 0.08, name
    again = draw_outfit(np.random.default_rng(3))
    assert [each.name for each in again] == [each.name for each in outfits[3]]
    np.testing.assert_array_equal(offsets(again), offsets(outfits[3]))


@pytest.mark.parametrize("name", GARMENTS)
def test_each_garment_is_no_thicker_than_it_says_and_leaves_other_parts_bare(name: str):
    one = worn(name)
    away, shares = offsets((one,)), anny_skin().shares
    assert away.min() >= 0.0
    assert 0.5 * one.thickness < away.max() <= one.thickness
    _, height, depth = anny_skin().points.T
    face = (shares["head"] == 1.0) & (height < 0.62) & (depth > 0.1)  # a mean Anny's ends at 0.73 m and 0.13 m
    covered, bare = {
        "upper": (shares["chest"] == 1.0, shares["foot"] == 1.0),
        "lower": (shares["hip"] == 1.0, shares["chest"] == 1.0),
        "hair": (height > 0.7, face),
        "feet": (shares["foot"] == 1.0, face),
    }[GARMENTS[name].slot]
    assert np.median(away[covered]) > 0.3 * one.thickness
    assert away[bare].max() < 0.5 * one.thickness
    assert np.median(away[bare]) < 1e-6
    assert away[shares["hand"] == 1.0].mean() < 0.1 * one.thickness


def test_sleeves_and_hems_end_where_they_say():
    skin = anny_skin()
    for limb, values in ((("upper_arm", "forearm"), {"sleeve": 1.0}), (("upper_leg", "lower_leg"), {"hem": 1.0})):
        one = worn("top" if "sleeve" in values else "trousers", **values)
        away, place = offsets((one,)), skin.places[limb]
        on_limb = skin.shares[limb[0]] + skin.shares[limb[1]] == 1.0
        assert (away[on_limb & (place < 0.7)] > 0.3 * one.thickness).all()
        assert (away[on_limb & (place > 1.4)] < 0.1 * one.thickness).all()


def test_cloth_is_smooth_and_the_same_on_both_sides():
    away = offsets(tuple(worn(name) for name in ("coat", "trousers", "long hair", "shoes")))
    points, faces = anny().rest(SHAPE).vertices[0], anny().faces.numpy()
    corners = away[faces]
    edges = np.linalg.norm(points.numpy()[faces] - points.numpy()[np.roll(faces, 1, 1)], axis=2).max(1)
    assert (np.ptp(corners, axis=1) / (edges + 1e-3) < 2.5).all()
    chosen = np.arange(0, len(points), 7)
    mirrored = torch.cdist(points[chosen] * torch.tensor([-1.0, 1.0, 1.0]), points).argmin(1).numpy()
    assert np.abs(away[mirrored] - away[chosen]).max() < 2e-3


def test_cloth_lies_outward():
    points, faces = anny().rest(SHAPE).vertices[0].numpy(), anny().faces.numpy()
    outward = normals(points)
    np.testing.assert_allclose(np.linalg.norm(outward, axis=1), 1.0)
    first, second, third = (points[faces[:, corner]] for corner in range(3))
    plain = np.cross(second - first, third - first)
    agree = (plain * outward[faces[:, 0]]).sum(1) > 0
    assert np.average(agree, weights=np.linalg.norm(plain, axis=1)) > 0.95
    chest = anny_skin().shares["chest"] == 1.0
    front = chest & (points[:, 2] > 0.08)
    assert outward[front, 2].mean() > 0.7


def test_a_skirt_closes_the_gap_between_the_legs_with_a_leg_on_either_side():
    skirt = worn("skirt", hem=0.9, flare=0.05)
    bare, dressed = draw_front(()), draw_front((skirt,))
    assert np.array_equal(bare > 0, (bare > 0) & (dressed > 0))
    middle, between = SIZE[1] // 2, slice(185, 198)  # rows from below the crotch to above the knees
    assert not bare[between, middle].any()
    assert dressed[between, middle].all()
    left, right = ((dressed == PART_NAMES.index(f"{side}_upper_leg") + 1) for side in ("left", "right"))
    assert not left[:, : middle - 2].any()
    assert not right[:, middle + 2 :].any()
    assert left.sum() == pytest.approx(right.sum(), rel=0.03)
    assert (left | right).sum() > 1.4 * np.isin(
        bare, [PART_NAMES.index(f"{s}_upper_leg") + 1 for s in ("left", "right")]
    ).sum()


def test_skirts_reach_below_straight_knees_and_end_at_bent_ones():
    long, knee = worn("skirt", hem=1.6), worn("skirt", hem=1.0)
    knee = replace(long, hem=1.0)
    below = [np.nonzero(draw_front((each,))[:, SIZE[1] // 2])[0].max() for each in (long, knee)]
    assert below[0] > below[1] + 20
    heights = [dress(seated(), SHAPE, (each,))[0][2 * anny().num_vertices :, 1].min() for each in (long, knee)]
    assert heights[0] == pytest.approx(heights[1], abs=0.02)


def test_no_garment_leaves_the_picture_as_it_is():
    body = anny().rest(SHAPE)
    vertices, mesh = dress(body, SHAPE, ())
    np.testing.assert_array_equal(vertices[: anny().num_vertices], body.vertices[0].numpy())
    np.testing.assert_array_equal(*np.split(vertices[: 2 * anny().num_vertices], 2))
    assert mesh.num_vertices <= len(vertices)
    assert not (draw_front(()) != draw_front((worn("skirt", hem=0.0, thickness=0.0, flare=0.0),))).mean() > 1e-3


def test_clothed_people_have_the_truth_of_the_body_beneath_and_cover_more():
    grown = []
    for index in range(6):
        nude, clothed = make_person(index), make_person(index, "clothed")
        for name in ("marks", "covered", "stature", "joints", "vertices", "height", "kind"):
            np.testing.assert_array_equal(getattr(nude, name), getattr(clothed, name))
        assert (clothed.parts[nude.parts > 0] > 0).mean() > 0.999
        grown.append((clothed.parts > 0).sum() / (nude.parts > 0).sum())
        again = make_person.__wrapped__(index, "clothed")
        np.testing.assert_array_equal(clothed.parts, again.parts)
    assert min(grown) > 1.0
    assert 1.05 < np.mean(grown) < 1.6
