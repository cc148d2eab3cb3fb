"""Turned crops: cut, and back into the picture; masks that overlap; landmarks by heat."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from warp_partdr.inputs.keypoints import Keypoints2D
from warp_partdr.networks.detection import crops as crops_module
from warp_partdr.networks.detection.crops import Pyramid, TurnedCrops, crops_of_people, cut_crops
from warp_partdr.networks.detection.heat import refine_landmarks
from warp_partdr.networks.detection.masks import draw_mask, instance_map, instance_maps
from warp_partdr.networks.detection.person import FoundPerson


def one_crop(x: float, y: float, side: float, angle: float = 0.0) -> TurnedCrops:
    return TurnedCrops(np.array([[x, y]]), np.array([side]), np.array([angle]), np.zeros(1, dtype=np.int64))


def ramps(height: int, width: int) -> np.ndarray:
    """Red grows along x, green along y, a level a pixel."""
    y, x = np.mgrid[:height, :width]
    return np.stack([x, y, 0 * x], axis=-1).astype(np.uint8)


def test_crops_invert(rng):
    crops = TurnedCrops(
        rng.uniform(-100, 900, (5, 2)), rng.uniform(1, 900, 5), rng.uniform(-4, 4, 5), np.zeros(5, dtype=np.int64)
    )
    places = rng.uniform(-1, 2, (5, 7, 2))
    np.testing.assert_allclose(crops.from_picture(crops.to_picture(places)), places, atol=1e-9)


def test_a_person_stands_upright_in_the_crop(rng):
    centres, tops = rng.uniform(0, 500, (2, 6, 2))
    crops = crops_of_people(centres, tops, np.zeros(6, dtype=np.int64))
    hips, heads = crops.from_picture(np.stack([centres, tops], axis=1)).swapaxes(0, 1)
    np.testing.assert_allclose(hips, 0.5, atol=1e-9)
    np.testing.assert_allclose(heads, [[0.5, 0.5 - 1 / 2.5]] * 6, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 0.7, -2.5])
@pytest.mark.parametrize("side", [16.0, 40.0, 100.0])
def test_a_pixel_of_a_crop_is_the_picture_there(device, angle, side):
    """It holds where the picture was halved before, and for an odd size."""
    crop = one_crop(101.3, 80.2, side, angle)
    cut = cut_crops([Pyramid(ramps(161, 203), device)], crop, 16)[0].cpu().numpy() * 255
    y, x = np.mgrid[:16, :16]
    places = crop.to_picture(((np.stack([x, y], axis=-1) + 0.5) / 16).reshape(1, -1, 2))[0].reshape(16, 16, 2)
    np.testing.assert_allclose(cut[:2].transpose(1, 2, 0), places - 0.5, atol=0.02)


def test_what_a_picture_does_not_show_is_black_or_the_border(device):
    white = [Pyramid(np.full((20, 30, 3), 255, dtype=np.uint8), device)]
    black = cut_crops(white, one_crop(0, 10, 20), 8)
    assert (black[0, 0, :, :3] == 0).all()
    torch.testing.assert_close(black[0, 0, :, 5:], torch.ones(8, 3, device=device))
    torch.testing.assert_close(cut_crops(white, one_crop(0, 10, 20), 8, beyond="border"), torch.ones_like(black))


def test_shrunk_crops_do_not_alias(device, rng):
    board = np.indices((512, 512)).sum(axis=0) % 2 * 255
    picture = np.repeat(board[..., None], 3, axis=-1).astype(np.uint8)
    cut = cut_crops([Pyramid(picture, device)], one_crop(256, 256, 512), 128)
    torch.testing.assert_close(cut, torch.full_like(cut, 0.5), atol=0.01, rtol=0)
    noise = rng.integers(0, 256, (512, 512, 3), dtype=np.uint8)
    cut = cut_crops([Pyramid(noise, device)], one_crop(256, 256, 512), 128)  # each pixel is the mean of 16
    assert float(cut.std()) == pytest.approx(noise.std() / 255 / 4, rel=0.05)


def test_huge_pictures_are_halved_first():
    picture = np.zeros((70, 9000, 3), dtype=np.uint8)
    picture[:, 4500:] = 200
    pyramid = Pyramid(picture, "cpu")
    values, level = pyramid.level(0)
    assert level == 2
    assert values.shape == (1, 3, 18, 2250)
    cut = cut_crops([pyramid], one_crop(4500, 35, 64), 16)[0, 0] * 255
    np.testing.assert_allclose(cut[4:12, [0, 5, 10, 15]], [[0, 0, 200, 200]] * 8, atol=1e-3)


def test_crops_of_several_pictures_keep_their_order(device, rng):
    pictures = [rng.integers(0, 255, (60 + 20 * i, 90, 3), dtype=np.uint8) for i in range(2)]
    pyramids = [Pyramid(picture, device) for picture in pictures]
    crops = TurnedCrops(
        rng.uniform(20, 60, (6, 2)), rng.uniform(10, 90, 6), rng.uniform(-1, 1, 6), np.array([1, 0, 0, 1, 1, 0])
    )
    together = cut_crops(pyramids, crops, 12)
    for row in range(6):
        torch.testing.assert_close(together[row : row + 1], cut_crops(pyramids, crops[row : row + 1], 12))


def test_pyramids_made_together_are_those_of_each_picture(rng, monkeypatch, device):
    """On CUDA those of one size go there together; here they only seem to."""
    if device == "cpu":
        monkeypatch.setattr(crops_module, "_uploaded", lambda pictures, device: torch.from_numpy(np.stack(pictures)))
    monkeypatch.setattr(crops_module, "_UPLOAD", 3 * 50 * 40 * 3)
    shapes = [(50, 40), (33, 60), (50, 40), (50, 40), (50, 40), (33, 60)]
    pictures = [rng.integers(0, 255, (*shape, 3), dtype=np.uint8) for shape in shapes]
    for pyramid, picture in zip(Pyramid.each(pictures, "cuda"), pictures, strict=True):
        assert pyramid.size == picture.shape[:2]
        for wanted in (0, 2):
            values, level = pyramid.level(wanted)
            assert level == wanted
            torch.testing.assert_close(values, Pyramid(picture, device).level(wanted)[0], rtol=0, atol=1e-6)


@pytest.mark.parametrize("beyond", ["zeros", "border"])
def test_crops_are_read_as_torch_reads_them(device, rng, beyond):
    """A pixel is read between the four nearest, also where some of them lie beyond the picture, and far outside."""
    picture = rng.integers(0, 255, (41, 30, 3), dtype=np.uint8)
    crops = TurnedCrops(
        rng.uniform(-20, 60, (30, 2)), rng.uniform(2, 22, 30), rng.uniform(-4, 4, 30), np.zeros(30, dtype=np.int64)
    )
    cut = cut_crops([Pyramid(picture, device)], crops, (16, 20), beyond=beyond)
    y, x = np.mgrid[:16, :20]
    places = np.stack([(x + 0.5) / 20, (y + 0.5) / 16], axis=-1).reshape(1, -1, 2)
    grid = torch.tensor(crops.to_picture(places.repeat(30, axis=0)) / (30, 41) * 2 - 1).reshape(30, 16, 20, 2)
    values = torch.tensor(picture / 255).permute(2, 0, 1).expand(30, -1, -1, -1)
    expected = torch.nn.functional.grid_sample(values, grid, padding_mode=beyond, align_corners=False)
    torch.testing.assert_close(cut.cpu().double(), expected, rtol=0, atol=2e-5)


def person(crop: TurnedCrops, mask: np.ndarray, device: str = "cpu") -> FoundPerson:
    keypoints = Keypoints2D("blazepose33", np.zeros((33, 2), np.float32), np.ones(33, np.float32))
    return FoundPerson(
        keypoints, 1.0, (0.0, 0.0, 1.0, 1.0), crop, torch.tensor(mask, dtype=torch.float32, device=device), crop
    )


def test_masks_come_back_where_they_were_cut():
    """A half of the crop, in a quarter turn: the crop's left is the picture's top."""
    mask = np.zeros((256, 256))
    mask[:, :128] = 0.9
    drawn = draw_mask(person(one_crop(30, 20, 20, np.pi / 2), mask), (50, 60))
    expected = np.zeros((50, 60))
    expected[10:20, 20:40] = 0.9
    np.testing.assert_allclose(drawn, expected, atol=1e-6)
    assert draw_mask(person(one_crop(-90, 20, 20), mask), (50, 60)).max() == 0


def test_masks_are_read_at_the_centres_of_pixels_and_end_with_their_crop():
    """A mask that grows from row to row, in a crop of many rows; then one in a turned crop."""
    rows = np.broadcast_to((np.arange(256)[:, None] + 0.5) / 256, (256, 256))
    drawn = draw_mask(person(one_crop(310, 320, 600), rows), (640, 620))
    expected = (np.arange(640) + 0.5 - 20) / 600
    inner = slice(25, 615)
    np.testing.assert_allclose(drawn[inner, 300], expected[inner], atol=5e-4)
    turned = draw_mask(person(one_crop(30, 30, 20, np.pi / 4), np.ones((256, 256))), (60, 60))
    assert turned[30, 30] == pytest.approx(1)
    assert turned[20, 20] == turned[20, 39] == turned[39, 20] == turned[39, 39] == 0
    assert turned.sum() == pytest.approx(400, rel=0.06)


def test_a_pixel_belongs_to_the_strongest_mask():
    people = [
        person(one_crop(20, 20, 20), np.full((256, 256), 0.7)),
        person(one_crop(30, 20, 20), np.full((256, 256), 0.9)),
        person(one_crop(40, 40, 20), np.full((256, 256), 0.4)),
    ]
    owners = instance_map(people, (50, 60))
    expected = np.zeros((50, 60))
    expected[10:30, 10:30] = 1
    expected[10:30, 20:40] = 2
    np.testing.assert_array_equal(owners, expected)
    assert instance_map([], (3, 4)).shape == (3, 4)
    with pytest.raises(TypeError, match=r"people\[0\]: str; expected FoundPerson"):
        instance_map(["nobody"], (3, 4))


def test_owners_of_many_pictures_are_those_that_their_masks_drawn_say(device, rng):
    """Pictures of several sizes, some empty, crops that reach beyond: as ``draw_mask``, up to ties within rounding."""
    sizes = [(70, 50), (3, 90), (64, 64), (40, 200)]
    masks = rng.uniform(0, 1, (13, 256, 256))
    masks[:, [0, 1, -2, -1]] = masks[:, :, [0, 1, -2, -1]] = 0.0  # the crops' edges are ties, too
    crops = [one_crop(*rng.uniform(-20, 120, 2), rng.uniform(5, 120), rng.uniform(-4, 4)) for _ in masks]
    everyone = [person(crop, mask, device) for crop, mask in zip(crops, masks, strict=True)]
    people = [everyone[:3], [], everyone[3:9], everyone[9:]]
    for some, size, owners in zip(people, sizes, instance_maps(people, sizes), strict=True):
        assert owners.device == torch.device(device, 0 if device == "cuda" else None)
        drawn = np.stack([np.full(size, 0.5, np.float32), *(draw_mask(each, size) for each in some)])
        first, second = np.sort(drawn, axis=0)[::-1][:2] if some else (drawn[0], drawn[0] - 1)
        clear = first - second > 1e-4  # of white noise
        assert clear.mean() > 0.99
        np.testing.assert_array_equal(owners.cpu().numpy()[clear], drawn.argmax(axis=0)[clear])
    assert (owners > 0).any()


def test_landmarks_follow_the_heat_near_them(device):
    places = torch.tensor([[[0.5, 0.5], [0.5, 0.5], [0.02, 0.5], [1.7, 0.5], [0.25, 0.25]]], device=device)
    heat = torch.full((1, 5, 64, 64), -20.0, device=device)
    heat[0, 0, 34, 31] = 5.0  # within reach
    heat[0, 1, 36, 32] = 5.0  # beyond it
    heat[0, 2, 32, 0] = heat[0, 2, 32, 2] = 3.0  # at the border
    heat[0, 3] = 5.0  # about a landmark outside the crop
    heat[0, 4, 16, 17] = -0.1  # not hot enough
    expected = torch.tensor([[31 / 64, 34 / 64], [0.5, 0.5], [1 / 64, 0.5], [1.7, 0.5], [0.25, 0.25]], device=device)
    torch.testing.assert_close(refine_landmarks(places, heat)[0], expected, atol=1e-4, rtol=0)
