"""Films: frames in order, upright, with their times; what is no film is one line."""

from __future__ import annotations

import struct
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from helpers.films import av, write_film
from PIL import ExifTags, Image

from warp_partdr.errors import InputError
from warp_partdr.inputs import films
from warp_partdr.inputs.film_reader import FilmReader
from warp_partdr.inputs.films import film_facts, is_film, read_frames, scaled
from warp_partdr.inputs.part_labels import read_photo


def shades(count: int, height: int = 32, width: int = 64) -> list[np.ndarray]:
    """Pictures that grow brighter; their left half is red."""
    pictures = []
    for index in range(count):
        picture = np.full((height, width, 3), 20 + 10 * index, np.uint8)
        picture[:, : width // 2] = [250, 0, 0]
        pictures.append(picture)
    return pictures


def test_frames_come_in_order_with_their_times(tmp_path: Path) -> None:
    path = write_film(tmp_path / "film.mp4", shades(12), rate=10)
    frames = list(read_frames(path))
    assert [frame.index for frame in frames] == list(range(12))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(12) / 10, atol=1e-6)
    for frame, picture in zip(frames, shades(12), strict=True):
        assert frame.picture.dtype == np.uint8
        assert frame.picture.flags.c_contiguous
        np.testing.assert_allclose(frame.picture[:, 40:].mean(), picture[:, 40:].mean(), atol=3)
    assert frames[0].picture[:, :20, 0].mean() > 220 > 60 > frames[0].picture[:, :20, 2].mean()  # RGB, not BGR
    facts = film_facts(path)
    assert (facts.rate, facts.frames) == (10.0, 12)


@pytest.mark.parametrize("ending", ["mp4", "avi", "mkv"])
def test_frames_are_read_in_any_order(tmp_path: Path, ending: str) -> None:
    """A reader that seeks gives the frames that come in order, and has few of them in memory."""
    count = 150
    pictures = [np.full((32, 64, 3), 20 + index, np.uint8) for index in range(count)]
    path = write_film(tmp_path / f"film.{ending}", pictures, rate=25)
    frames = list(read_frames(path))
    reader = FilmReader(path, lambda picture: picture[::2])
    for index in (0, 1, 149, 148, 147, 30, 31, 100, 5, 75, *range(74, 50, -1), 149, 0):
        np.testing.assert_array_equal(reader.picture(index), frames[index].picture[::2])
        assert len(reader._kept) <= 48
    for before in (145, 0):  # which is in memory, or behind
        reader.picture(before)
        with pytest.raises(InputError, match="frame 150; expected 0 to 149"):
            reader.picture(150)
    np.testing.assert_array_equal(reader.picture(3), frames[3].picture[::2])  # it goes on


def test_times_are_the_film_s_and_begin_at_0(tmp_path: Path) -> None:
    path = write_film(tmp_path / "film.mkv", shades(4), rate=10, times=[20, 21, 25, 40])
    np.testing.assert_allclose([frame.time for frame in read_frames(path)], [0, 0.1, 0.5, 2.0], atol=2e-3)


@pytest.mark.parametrize("turned", [0, 90])
def test_pictures_have_the_size_that_is_asked_for(tmp_path: Path, turned: int) -> None:
    """Upright, whichever way the film was taken, and in the places where the whole picture's are."""
    path = write_film(tmp_path / "film.mp4", shades(3), turned=turned)
    for whole, small in zip(read_frames(path), read_frames(path, size=(24, 40)), strict=True):
        assert small.picture.shape == (24, 40, 3)
        expected = scaled(whole.picture, (24, 40)).astype(float)
        assert np.abs(small.picture - expected).mean() < 3
    Image.fromarray(shades(1)[0]).save(tmp_path / "photo.png")
    (photo,) = read_frames(tmp_path / "photo.png", size=(24, 40))
    assert photo.picture.shape == (24, 40, 3)


@pytest.mark.parametrize(("turned", "red"), [(90, "bottom"), (-90, "top"), (180, "right")])
def test_films_stand_upright(tmp_path: Path, turned: int, red: str) -> None:
    path = write_film(tmp_path / "film.mp4", shades(2), turned=turned)
    picture = next(iter(read_frames(path))).picture[..., 0].astype(float)
    halves = {"top": np.s_[:24], "bottom": np.s_[-24:], "right": np.s_[:, -24:]}
    assert picture.shape == ((32, 64) if turned == 180 else (64, 32))
    assert picture[halves.pop(red)].mean() > 220
    assert picture.mean() < 150


def test_a_phone_s_matrix_is_read_as_players_do(tmp_path: Path) -> None:
    """A phone held upright writes that its film is to be turned clockwise: what was left becomes the top."""
    path = write_film(tmp_path / "film.mp4", shades(2), turned=90)
    data = path.read_bytes()
    place = data.index(b"tkhd") + 4 + 4 + 20 + 16
    path.write_bytes(data[:place] + struct.pack(">9i", 0, 65536, 0, -65536, 0, 0, 0, 0, 1 << 30) + data[place + 36 :])
    picture = next(iter(read_frames(path))).picture
    assert picture.shape == (64, 32, 3)
    assert picture[:24, :, 0].mean() > 220
    assert picture[40:, :, 0].mean() < 60


@pytest.mark.parametrize("ending", ["png", "webp"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_photos_stand_as_their_exif_data_say_mirrored_or_not(tmp_path: Path, orientation: int, ending: str) -> None:
    path, exif = tmp_path / f"photo.{ending}", Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    (picture,) = shades(1)
    picture[:8, :, 1] = 200
    Image.fromarray(picture).save(path, exif=exif, lossless=True)
    (frame,) = read_frames(path)
    np.testing.assert_array_equal(frame.picture, read_photo(path))
    np.testing.assert_array_equal(films.FilmFrames(path).read(0), read_photo(path))


def test_wide_pixels_become_square(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "wide.mkv"), "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 32, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(3, 2)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(shades(1)[0], format="rgb24")))
        container.mux(stream.encode())
    (frame,) = read_frames(tmp_path / "wide.mkv")
    assert frame.picture.shape == (32, 96, 3)


def test_a_frame_at_a_time_is_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_film(tmp_path / "film.mp4", shades(12))
    made = []
    turn = np.rot90
    monkeypatch.setattr(films.np, "rot90", lambda *values: made.append(1) or turn(*values))
    frames = read_frames(path)
    next(frames), next(frames)
    assert len(made) == 2


def test_names_tell_films() -> None:
    assert all(map(is_film, ("a.mp4", "b/C.MOV", Path("d.webm"))))
    assert not any(map(is_film, ("a.jpg", "mp4", "a.mp4.png")))


def test_what_is_no_film_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "text.mp4").write_text("not a film")
    with av.open(str(tmp_path / "sound.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode())
    for name, words in {
        "none.mp4": "No such file or directory; expected a film",
        "text.mp4": "Invalid data found when processing input; expected a film",
        "sound.mp4": "no pictures in it; expected a film",
        "": "Is a directory; expected a film",
    }.items():
        with pytest.raises(InputError, match=words) as refused:
            next(read_frames(tmp_path / name))
        assert str(refused.value).startswith(str(tmp_path / name))
        with pytest.raises(InputError, match=words):
            film_facts(tmp_path / name)


def test_frames_before_a_fault_are_given(tmp_path: Path, rng: np.random.Generator) -> None:
    pictures = [rng.integers(0, 255, (32, 64, 3), dtype=np.uint8) for _ in range(40)]
    path = write_film(tmp_path / "film.mp4", pictures)
    data = bytearray(path.read_bytes())
    third = len(data) // 3
    data[third : 2 * third] = b"\xff" * third
    path.write_bytes(data)
    given: list[int] = []
    with pytest.raises(InputError, match=r"film\.mp4: Invalid data .*; expected a film"):
        given.extend(frame.index for frame in read_frames(path))
    assert 3 < len(given) < 30


def test_a_film_that_was_cut_off_gives_its_frames_and_says_so(tmp_path: Path, rng: np.random.Generator) -> None:
    pictures = [rng.integers(0, 255, (32, 64, 3), dtype=np.uint8) for _ in range(40)]
    path = write_film(tmp_path / "film.mp4", pictures, movflags="faststart")  # its table of frames comes first
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    given: list[int] = []
    with pytest.raises(InputError, match=r"film\.mp4: (\d+) of 40 frames in it; expected a whole film"):
        given.extend(frame.index for frame in read_frames(path))
    assert 10 < len(given) < 30


def grays(path: Path) -> list[int]:
    """Gray of each frame of a film, which ``stripes`` made."""
    return [round(frame.picture.mean() / 4) for frame in read_frames(path)]


def stripes(count: int) -> list[np.ndarray]:
    """Pictures of one gray each, 4 brighter than the one before."""
    return [np.full((32, 64, 3), 4 * index, np.uint8) for index in range(count)]


def noise(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    return [rng.integers(0, 255, (32, 64, 3), dtype=np.uint8) for _ in range(count)]


@pytest.mark.parametrize(("ending", "between"), [("mp4", 0), ("mp4", 2), ("mov", 2)])
def test_frames_that_an_edit_list_leaves_out_are_none(tmp_path: Path, ending: str, between: int) -> None:
    """Phones trim films so: frames before the cut stay in the file, and players never show them."""
    path = write_film(tmp_path / f"trimmed.{ending}", stripes(30), rate=30, times=range(-4, 26), between=between)
    with av.open(str(path)) as container:
        left_out = sum(packet.is_discard for packet in container.demux(video=0))
        assert container.streams.video[0].frames == 30
    assert (left_out > 0) == (between > 0)  # else the container itself leaves them out
    frames = list(read_frames(path))
    assert grays(path) == list(range(4, 30))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(26) / 30, atol=1e-6)
    reader = films.FilmFrames(path)
    assert (len(reader), reader.fault) == (26, None)
    for index in (0, 25, 3, 11):
        np.testing.assert_array_equal(reader.read(index), frames[index].picture)


def test_frames_that_a_recorder_dropped_are_not_missing_from_a_whole_avi(tmp_path: Path) -> None:
    times = [0, 1, 2, 3, 7, 8, 9, 12]
    path = write_film(tmp_path / "dropped.avi", stripes(8), rate=20, times=times)
    assert film_facts(path).frames == 13  # as its header says
    np.testing.assert_allclose([frame.time for frame in read_frames(path)], np.array(times) / 20)
    assert grays(path) == list(range(8))
    assert films.FilmFrames(path).fault is None
    data = path.read_bytes()
    data = data[: data.index(b"idx1")]  # what some recorders leave out
    path.write_bytes(data[:4] + struct.pack("<I", len(data) - 8) + data[8:])
    assert grays(path) == list(range(8))


@pytest.mark.parametrize("dropped", [False, True])
@pytest.mark.parametrize("ending", ["avi", "mkv"])
def test_a_film_that_was_cut_off_is_told_in_other_containers(
    tmp_path: Path, rng: np.random.Generator, ending: str, dropped: bool
) -> None:
    times = [index + 3 * (index > 20) for index in range(40)] if dropped else range(40)
    path = write_film(tmp_path / f"film.{ending}", noise(rng, 40), times=times)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    told = rf"\d+ of {max(times) + 1} frames" if ending == "avi" else rf"\d+ of {len(data)} bytes"
    given: list[int] = []
    with pytest.raises(InputError, match=rf"film\.{ending}: {told} in it; expected a whole film"):
        given.extend(frame.index for frame in read_frames(path))
    assert 0 < len(given) < 40
    assert films.FilmFrames(path).fault


def test_an_avi_whose_frames_are_decoded_in_another_order_is_read_in_order(tmp_path: Path) -> None:
    """An AVI file states the times at which frames are decoded, and no times at which they are shown."""
    path = write_film(tmp_path / "order.avi", stripes(20), rate=10, between=2)
    frames = list(read_frames(path))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(20) / 10)
    assert not any(frame.guessed for frame in frames)
    assert grays(path) == list(range(20))
    reader = films.FilmFrames(path)
    for index in (19, 1, 2, 7):
        np.testing.assert_array_equal(reader.read(index), frames[index].picture)


def test_times_go_on_in_a_film_that_was_joined_from_two(tmp_path: Path) -> None:
    """Two files one after the other, as they often are: times begin anew, and frames keep their order."""
    path = write_film(tmp_path / "film.mts", stripes(12), rate=25)
    path.write_bytes(2 * path.read_bytes())
    frames = list(read_frames(path))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(24) / 25, atol=1e-6)
    assert [frame.index for frame in frames if frame.guessed] == [12]
    reader = films.FilmFrames(path)
    for index in (0, 14, 23, 5):
        np.testing.assert_array_equal(reader.read(index), frames[index].picture)


def test_a_unit_of_time_is_not_taken_for_the_rate(tmp_path: Path) -> None:
    path = write_film(tmp_path / "screen.mkv", stripes(9), rate=1000, times=[0, 33, 67, 100, 133, 167, 200, 233, 700])
    assert film_facts(path).rate == pytest.approx(30, rel=0.01)
    np.testing.assert_allclose([frame.time for frame in read_frames(path)][-2:], [0.233, 0.7])
    one = write_film(tmp_path / "one.mkv", stripes(1), rate=1000)
    assert film_facts(one).rate == 0
    (frame,) = read_frames(one)
    assert (frame.time, frame.guessed) == (0.0, False)


def test_a_turned_film_of_a_variable_rate_is_upright_and_keeps_its_times(tmp_path: Path) -> None:
    path = write_film(tmp_path / "phone.mp4", shades(4), rate=30, times=[0, 1, 4, 5], turned=90)
    frames = list(read_frames(path))
    np.testing.assert_allclose([frame.time for frame in frames], np.array([0, 1, 4, 5]) / 30, atol=1e-6)
    assert {frame.picture.shape for frame in frames} == {(64, 32, 3)}


def test_a_film_without_frames_is_refused(tmp_path: Path) -> None:
    path = write_film(tmp_path / "film.mkv", shades(3))
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"\x1f\x43\xb6\x75")])  # Matroska's first cluster
    with pytest.raises(InputError, match=r"film\.mkv: no frames; expected a film"):
        list(read_frames(path))


def test_without_pyav_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_film(tmp_path / "film.mp4", shades(2))
    monkeypatch.setattr(films, "find_spec", lambda name: None)
    for read in (film_facts, lambda path: next(read_frames(path))):
        with pytest.raises(InputError, match=r"without PyAV; expected it: pip install 'av>=18'"):
            read(path)


def test_larger_frames_than_photos_may_be_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_film(tmp_path / "film.mp4", shades(2))
    monkeypatch.setattr(films, "LARGEST_PICTURE", 1000)
    with pytest.raises(InputError, match="frames of 64x32; expected smaller ones"):
        next(read_frames(path))
