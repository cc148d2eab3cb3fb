"""Cuts of films: found where the picture changes for good, and not where it moves, flashes, fades or is late."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pytest
from PIL import Image

from warp_partdr.errors import InputError
from warp_partdr.inputs.cuts import Change, cuts_sentence, unlikeness, with_changes
from warp_partdr.inputs.films import Frame

HEIGHT, WIDTH = 96, 160


def place(seed: int, width: int = WIDTH) -> np.ndarray:
    """A picture of somewhere: smooth random colours, shape (96, width, 3), uint8."""
    rough = np.random.default_rng(seed).integers(0, 255, (12, width // 8, 3)).astype(np.uint8)
    return np.asarray(Image.fromarray(rough).resize((width, HEIGHT), Image.Resampling.BICUBIC))


def pan(seed: int, lefts: Sequence[int]) -> list[np.ndarray]:
    """Windows of a wide place, from these columns on."""
    wide = place(seed, WIDTH + max(lefts) // 8 * 8 + 8)
    return [wide[:, left : left + WIDTH] for left in lefts]


def still(seed: int, count: int) -> list[np.ndarray]:
    return [place(seed)] * count


def lit(pictures: Sequence[np.ndarray], gains: Sequence[float], offset: float = 0.0) -> list[np.ndarray]:
    """Pictures in another light."""
    pairs = zip(pictures, gains, strict=True)
    return [np.clip(picture * gain + offset, 0, 255).round().astype(np.uint8) for picture, gain in pairs]


def frames(pictures: Sequence[np.ndarray], times: Sequence[float] = ()) -> Iterator[Frame]:
    for index, picture in enumerate(pictures):
        yield Frame(index, times[index] if len(times) else index / 30, np.ascontiguousarray(picture))


def changes(pictures: Sequence[np.ndarray], times: Sequence[float] = ()) -> dict[int, Change]:
    """Changes by frame, where there is any; all frames come in order."""
    found = list(with_changes(frames(pictures, times)))
    assert [frame.index for frame, _ in found] == list(range(len(pictures)))
    return {frame.index: change for frame, change in found if change is not Change.NONE}


@pytest.mark.parametrize("lengths", [(9, 7), (4, 4, 5), (1, 6), (6, 1), (20, 30)])
def test_cuts_between_places_are_found(lengths: tuple[int, ...]) -> None:
    pictures = [picture for seed, length in enumerate(lengths) for picture in pan(seed, range(0, 3 * length, 3))]
    assert changes(pictures) == dict.fromkeys(np.cumsum(lengths)[:-1].tolist(), Change.CUT)


def test_one_picture_has_no_cut() -> None:
    assert changes([]) == {}
    assert changes(still(0, 1)) == {}
    assert changes(still(0, 12)) == {}


@pytest.mark.parametrize("step", [2, 5, 9, 30, 80])
def test_a_pan_has_no_cut_however_fast(step: int) -> None:
    assert Change.CUT not in changes(pan(1, range(0, 20 * step, step))).values()


@pytest.mark.parametrize("step", [2, 9])
def test_a_cut_within_a_pan_is_found(step: int) -> None:
    lefts = range(0, 10 * step, step)
    assert changes(pan(1, lefts) + pan(2, lefts)) == {10: Change.CUT}


@pytest.mark.parametrize("rate", [1.0, 30.0])
def test_a_film_of_which_every_frame_is_another_place_has_no_cut(rate: float) -> None:
    """A hand-held camera that takes one frame a minute makes such films."""
    pictures = [place(seed) for seed in range(14)]
    assert Change.CUT not in changes(pictures, np.arange(14) / rate).values()


@pytest.mark.parametrize("seconds", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("order", [(0, 1), (0, 1, 0), (0, 1, 2, 3, 4), (0, 1, 0, 1), (0, 1, 2, 0, 1)])
def test_every_picture_of_a_slideshow_is_for_others_to_judge(order: tuple[int, ...], seconds: float) -> None:
    found = changes([place(seed) for seed in order], np.arange(len(order)) * seconds)
    assert list(found) == list(range(1, len(order)))
    assert set(found.values()) <= {Change.NEW, Change.CUT}


def test_a_fast_pan_and_frames_that_are_missing_in_one_are_apart() -> None:
    """A step where all is new is told, but not where times tell why it is new."""
    lefts = [*range(0, 800, 80), *range(1200, 2000, 80)]
    times = np.array(lefts) / 80 / 30
    found = changes(pan(3, lefts), times)
    assert 10 not in found
    assert set(found.values()) == {Change.NEW}


@pytest.mark.parametrize("value", [0, 255])
@pytest.mark.parametrize("count", [1, 4, 20])
def test_the_end_of_a_blank_start_is_a_jump(value: int, count: int) -> None:
    film = pan(1, range(8))
    assert changes([np.full_like(film[0], value)] * count + film) == {count: Change.JUMP}
    assert changes([np.full_like(film[0], value)] * count) == {}


def test_a_flash_is_no_cut() -> None:
    film = pan(1, range(0, 32, 2))
    for first, flash in (
        (6, lit(film[6:7], [1.8], 60.0)),
        (6, [place(8)]),
        (6, [place(8), place(9)]),
        (5, [np.full_like(film[0], 255)] * 3),
        (7, [np.zeros_like(film[0])] * 2),
    ):
        pictures = [*film[:first], *flash, *film[first + len(flash) :]]
        flashing = set(range(first, first + len(flash)))
        found = changes(pictures)
        assert found.keys() <= flashing, found
        assert set(found.values()) <= {Change.FLASH}
    assert changes([*film[:6], place(8), *film[7:]]) == {6: Change.FLASH}


def test_a_short_shot_is_no_flash() -> None:
    film = pan(1, range(20))
    assert changes(film[:8] + still(2, 6) + film[14:]) == {8: Change.CUT, 14: Change.CUT}


def test_a_flash_of_a_slow_film_is_no_cut() -> None:
    film = still(1, 12)
    assert changes([*film[:5], place(8), *film[6:]], np.arange(12) / 2) == {5: Change.FLASH}


def test_light_that_goes_off_is_no_cut() -> None:
    film = pan(1, range(0, 40, 2))
    assert Change.CUT not in changes(lit(film, [1.0] * 10 + [0.4] * 10)).values()
    assert Change.CUT not in changes(lit(film, [0.5] * 10 + [1.0] * 10)).values()


def test_a_fade_is_a_cut_if_another_place_follows() -> None:
    out = [*np.linspace(1, 0, 8), 0, 0, 0]
    into = [*np.linspace(0, 1, 8), 1, 1]
    gains = [1.0, 1.0, 1.0, *out, *into]
    same = lit(still(1, len(gains)), gains)
    assert set(changes(same).values()) == {Change.FLASH}
    other = same[:14] + lit(still(2, 10), into)
    found = changes(other)
    assert [change for change in found.values() if change is not Change.FLASH] == [Change.CUT]
    (cut,) = (frame for frame, change in found.items() if change is Change.CUT)
    assert 14 < cut <= 16


def test_frames_that_are_missing_are_no_cut_if_times_tell() -> None:
    """A pan of 9 pixels a frame that loses 14 of them; what lies before and after is known from its neighbours."""
    lefts = [*range(0, 135, 9), *range(261, 396, 9)]
    times = np.array(lefts) / 9 / 30
    assert changes(pan(3, lefts), times) == {}
    assert changes(pan(3, lefts)) == {15: Change.CUT}


def test_a_pause_of_the_camera_is_a_cut() -> None:
    times = np.r_[np.arange(10), np.arange(60, 70)] / 30
    assert changes(still(1, 10) + still(2, 10), times) == {10: Change.CUT}


def test_a_jump_within_a_place_is_for_others_to_judge() -> None:
    """A part of the picture changes from one frame to the next, after which it moves as before."""
    film = []
    for left in [*range(10, 22, 2), *range(90, 102, 2)]:
        picture = place(1).copy()
        picture[20:84, left : left + 40] = place(2)[20:84, 0:40]
        film.append(picture)
    assert changes(film) == {6: Change.JUMP}


def test_few_frames_are_read_ahead() -> None:
    for rate, most in ((240.0, 9), (30.0, 5), (5.0, 4)):
        read = []

        def film(rate: float = rate, read: list[int] = read) -> Iterator[Frame]:
            for frame in frames(still(1, 40), np.arange(40) / rate):
                read.append(frame.index)
                yield frame

        ahead = [len(read) - frame.index for frame, _ in with_changes(film())]
        assert max(ahead) == most


def test_frames_before_a_fault_are_given() -> None:
    def broken() -> Iterator[Frame]:
        yield from frames(still(1, 6) + still(2, 2))
        raise InputError("film: damaged; expected a whole film")

    found: list[tuple[int, Change]] = []
    with pytest.raises(InputError, match="film: damaged"):
        found.extend((frame.index, change) for frame, change in with_changes(broken()))
    assert [index for index, _ in found] == list(range(8))
    assert [index for index, change in found if change is Change.CUT] == [6]


def test_unlikeness_is_its_formula() -> None:
    """The formula is written as loops over blocks, places and colours."""
    rng = np.random.default_rng(5)
    one, other = (rng.normal(size=(16, 24, 3)).astype(np.float32) for _ in range(2))
    other[:8, :8] = one[3:11, 2:10]  # found 3 rows below, 2 columns to the right
    wide = np.pad(one.astype(float), ((4, 4), (4, 4), (0, 0)), mode="edge")
    shares = []
    for row in range(0, 16, 8):
        for column in range(0, 24, 8):
            block = other[row : row + 8, column : column + 8].astype(float)
            found = []
            for down in range(9):
                for right in range(9):
                    near = wide[row + down : row + down + 8, column + right : column + right + 8]
                    varied = [sum(each[..., k].var() for k in range(3)) for each in (near, block)]
                    both = sum(
                        ((near[..., k] - near[..., k].mean()) * (block[..., k] - block[..., k].mean())).mean()
                        for k in range(3)
                    )
                    apart = ((near.mean((0, 1)) - block.mean((0, 1))) ** 2).sum()
                    found.append((sum(varied) - 2 * both + 0.1 * apart) / (max(varied) + 3 * 0.1**2))
            shares.append(min(1.0, *found))
    assert unlikeness(one, other) == pytest.approx(np.mean(shares), abs=1e-5)
    assert shares[0] == pytest.approx(0, abs=1e-6)
    assert min(shares[1:]) > 0.5


def test_unlikeness_ends_at_0_and_1() -> None:
    one = np.random.default_rng(6).normal(size=(32, 64, 3)).astype(np.float32)
    assert unlikeness(one, one) == pytest.approx(0, abs=1e-6)
    assert 0.9 < unlikeness(one, -one) <= 1
    flat = np.zeros_like(one)
    assert unlikeness(flat, flat) == 0
    assert unlikeness(flat, flat + 2) == pytest.approx(1)


def test_cuts_are_told_in_words() -> None:
    assert cuts_sentence([10], [1 / 3]) == "a cut at frame 10 (0.33 s): 2 shots"
    assert cuts_sentence([3, 9], [0.1, 0.3]) == "cuts at frames 3, 9 (0.10, 0.30 s): 3 shots"
    many = cuts_sentence(list(range(10, 80, 10)), np.arange(1, 8) / 2)
    assert many == "cuts at frames 10, 20, 30, 40, 50 (0.50, 1.00, 1.50, 2.00, 2.50 s) and 2 more: 8 shots"
