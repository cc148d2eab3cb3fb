"""Sources of ``partdr dataset``: tar files of WebDataset, keypoints and labels beside photos, films, run lengths."""

from __future__ import annotations

import json
import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import commands
from helpers.commands import Run
from helpers.datasets import photo, rows, write_coco
from helpers.shards import members, write_beside, write_tar

from warp_partdr.bulk import picture_files
from warp_partdr.bulk.coco import decode_runs
from warp_partdr.bulk.containers import Latest
from warp_partdr.bulk.opening import open_source
from warp_partdr.errors import InputError
from warp_partdr.inputs.films import FilmFrames, read_frames

pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytest.importorskip("webdataset", reason="needs webdataset, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
HOW = "--labels cdcl14 --quality network --device cpu"
# Of pycocotools 2.0.11: rows 5 to 30, columns 7 to 43 of 40x50, but rows 12 to 19 of columns 20 to 29.
PACKED = "m8j0>000000000000000000000000]OJ46LJ46LJ46LJ46LJ46LJ46LJ46LJ46LJ46LJ46?00000000000000000000000000[7"


def test_shards_are_as_the_same_files_in_a_folder(run: Run) -> None:
    """Bodies by keypoints and labels, by keypoints, and of people who are found; one sample is no picture."""
    samples = [
        members("000"),
        members("001", parts=False, ending="webp"),
        members("002", keypoints=False, parts=False, ending="png"),
        members("003", keypoints=False),
    ]
    write_tar(Path("shards/000.tar"), {**samples[0], **samples[1], "notes.json": b"{}"})
    write_tar(Path("shards/001.tar"), {**samples[2], **samples[3]})
    for files in samples:
        write_beside(Path("folder"), files)
    assert run(f"dataset shards --out out {HOW}")[0] == 0
    assert run(f"dataset folder --out beside {HOW}")[0] == 0
    found, same = rows("out"), rows("beside")
    names = ["000.tar#000.jpg", "000.tar#001.webp", "001.tar#002.png", "001.tar#003.jpg"]
    assert [row["picture"] for row in found] == names
    assert [row["picture"] for row in same] == ["000.jpg", "001.webp", "002.png", "003.jpg"]
    assert [row["error"] for row in found] == [None] * 4
    for row, other in zip(found, same, strict=True):
        assert {**row, "picture": None} == {**other, "picture": None}
    keypoints = np.array([row["keypoints"] for row in found]).reshape(4, -1, 3)
    assert keypoints.shape[1] == 17  # also of those who were found
    np.testing.assert_allclose(keypoints[0], keypoints[1])
    assert 0 < np.abs(keypoints[2, 5:, :2] - keypoints[0, 5:, :2]).max() < 16
    joints = [np.array(row["joints"]) for row in found]
    assert all(np.abs(joints[a] - joints[b]).max() > 1e-3 for a, b in ((0, 1), (1, 2), (2, 3)))
    assert [row["picture"] for row in rows("out")] == names

    assert run(f"dataset shards/{{000..001}}.tar --out pattern {HOW}")[0] == 0
    assert rows("pattern") == found
    assert run("dataset shards/001.tar --out one --quality network --device cpu --labels cdcl14")[0] == 0
    assert [row["picture"] for row in rows("one")] == names[2:]


def test_parts_say_what_their_ids_mean(run: Run) -> None:
    write_beside(Path("folder"), members("000"))
    line = "dataset folder --quality network --device cpu --out out"
    assert "--labels: missing; expected what the ids of *.parts.png mean" in run(line)[2]
    assert run(f"{line} --labels cdcl14")[0] == 0
    assert "made with people " in run(f"{line} --labels lip20")[2]  # another label set: other rows
    data = json.loads(Path("folder/000.keypoints.json").read_text())
    Path("folder/000.keypoints.json").write_text(json.dumps(data, indent=1))
    assert "made with people " in run(f"{line} --labels cdcl14")[2]
    shutil.rmtree("folder")
    write_beside(Path("folder"), members("000", parts=False))
    assert "--labels: cdcl14, without part labels" in run(f"{line} --labels cdcl14")[2]


def test_broken_members_are_rows(run: Run) -> None:
    """A photo, keypoints, labels of another size, and a file that was cut off are broken, and one is no tar file."""
    broken = members("001", parts=False)
    broken["001.jpg"] = broken["001.jpg"][:200]
    strange = members("002", parts=False)
    strange["002.keypoints.json"] = b'{"keypoints": "none"}'
    sized = members("003")
    sized["003.parts.png"] = members("x", ending="png")["x.png"]
    write_tar(Path("s/a.tar"), {**members("000"), **broken, **strange, **sized, **members("004")})
    whole = write_tar(Path("s/b.tar"), {**members("000", parts=False), **members("001", parts=False)}).read_bytes()
    Path("s/b.tar").write_bytes(whole[: whole.index(b"001.jpg") + 900])
    Path("s/c.tar").write_bytes(b"no tar file" * 100)
    code, _, complaint = run(f"dataset s --out out {HOW}")
    assert code == 1  # of nine rows, more than half
    assert complaint.endswith("partdr: 6 of 9 rows have an error\n")
    assert "warning: 6 rows with an error, first a.tar#001.jpg: " in complaint
    found = {row["picture"]: row["error"] for row in rows("out")}
    fine = ["a.tar#000.jpg", "a.tar#004.jpg", "b.tar#000.jpg"]
    assert [name for name, error in found.items() if error is None] == fine
    assert "RGB picture; expected one channel" in found["a.tar#003.jpg"]
    assert found["a.tar#002.jpg"].startswith("a.tar#002.jpg: keypoints.json: no list of keypoints")
    assert "bytes; expected a whole tar file" in found["b.tar#001.jpg"]
    assert found["b.tar"] == "b.tar: unexpected end of data; expected a whole tar file"
    assert found["c.tar"].startswith("c.tar: ")
    assert not any(" at 0x" in error for error in found.values() if error)  # it would differ from run to run


def test_a_damaged_header_is_told() -> None:
    """Python's tarfile takes it for the end."""
    path = write_tar(Path("a.tar"), {**members("0"), **members("1")})
    data = bytearray(path.read_bytes())
    place = data.index(b"1.jpg")
    data[place : place + 4] = b"\xff\xfe\xfd\xfc"
    path.write_bytes(data)
    source = open_source(path, labels="cdcl14")
    assert source.names == ("a.tar#0.jpg", "a.tar")
    with pytest.raises(InputError, match=r"^a\.tar: no end after \d+ bytes; expected a whole tar file"):
        source.read("a.tar")


def test_frames_of_a_film_are_pictures(run: Run) -> None:
    from helpers.films import write_film

    frame = np.zeros((256, 256, 3), np.uint8)
    picture = np.asarray(photo(256))[:, :256]
    frame[:, : picture.shape[1]] = picture
    Path("photos").mkdir()
    write_film(Path("photos/film.mp4"), [np.roll(frame, 4 * index, 1) for index in range(4)])
    photo(160).save("photos/zed.png")
    Path("photos/broken.mp4").write_bytes(b"no film")
    assert run("dataset photos --out out --quality network --device cpu --shard 2")[0] == 0
    found = rows("out")
    names = ["broken.mp4", *(f"film.mp4#{index}" for index in range(4)), "zed.png"]
    assert [row["picture"] for row in found] == names
    assert found[0]["error"].startswith("broken.mp4: ")
    lefts = [row["box"][0] for row in found[1:5]]
    np.testing.assert_allclose(np.diff(lefts), 4, atol=2.5)
    assert "expected --focal PX or --fov" in _error("photos/film.mp4", run)


def _error(film: str, run: Run) -> str:
    assert run(f"dataset {film} --focal exif --out exif --quality network --device cpu")[0] == 1
    return rows("exif")[0]["error"]


def test_frames_come_in_any_order(tmp_path: Path) -> None:
    from helpers.films import write_film

    pictures = [np.full((48, 64, 3), 10 + 4 * index, np.uint8) for index in range(50)]
    for name in ("a.mp4", "a.mkv", "a.avi"):
        path = write_film(tmp_path / name, pictures)
        expected = [frame.picture for frame in read_frames(path)]
        frames = FilmFrames(path)
        assert (len(frames), frames.fault) == (50, None)
        for index in (*range(50), 40, 3, 4, 2, 49, 0, 48, 13):
            np.testing.assert_array_equal(frames.read(index), expected[index])
    with pytest.raises(InputError, match="frame 50; expected 0 to 49"):
        frames.read(50)


def test_damaged_frames_leave_the_others(tmp_path: Path) -> None:
    from helpers.films import write_film

    pictures = [np.full((64, 96, 3), 10 + 4 * index, np.uint8) for index in range(50)]
    path = write_film(tmp_path / "a.mp4", pictures)
    expected = [frame.picture for frame in read_frames(path)]
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 600] = bytes((value * 7 + 13) % 256 for value in data[middle : middle + 600])
    path.write_bytes(data)
    frames, wrong = FilmFrames(path), []
    for index in range(50):
        try:
            if np.abs(frames.read(index).astype(int) - expected[index]).max() > 8:
                wrong.append(index)
        except InputError:
            wrong.append(index)
    assert len(frames) == 50
    assert 0 < len(wrong) < 20


def test_a_film_cut_off_is_told(tmp_path: Path) -> None:
    from helpers.films import write_film

    path = write_film(tmp_path / "a.avi", [np.full((64, 96, 3), 10 + 4 * index, np.uint8) for index in range(50)])
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    names = open_source(path).names
    assert 10 < len(names) < 50
    assert names[-1] == "a.avi"
    with pytest.raises(InputError, match=rf"^a.avi: {len(names) - 1} of 50 frames in it; expected a whole film"):
        open_source(path).read("a.avi")


@pytest.mark.parametrize("packed", [True, False])
def test_run_lengths_are_masks(packed: bool) -> None:
    mask = np.zeros((40, 50), dtype=bool)
    mask[5:31, 7:44] = True
    mask[12:20, 20:30] = False
    edges = np.flatnonzero(np.diff(mask.T.ravel().astype(int))) + 1
    counts = np.diff([0, *edges, mask.size]).tolist()
    given = {"size": [40, 50], "counts": PACKED if packed else counts}
    np.testing.assert_array_equal(decode_runs(given, (40, 50), "here"), mask)


@pytest.mark.parametrize("counts", [None, "", "m8", PACKED[:-1], PACKED + "1", "\u20ac", [-5, 2005], [1999], [2000.0]])
def test_other_run_lengths_are_refused(counts: Any) -> None:
    with pytest.raises(InputError, match=r"here: counts: .*; expected run lengths of 2000 pixels in all"):
        decode_runs({"size": [40, 50], "counts": counts}, (40, 50), "here")


def test_masks_of_run_lengths_are_used_as_polygons(run: Run) -> None:
    """A box as a polygon, and as run lengths."""
    path = write_coco(Path("coco"), count=1, bbox=[20, 10, 60, 100], segmentation=[[20, 10, 79, 10, 79, 109, 20, 109]])
    line = "dataset coco/people.json --quality fast --device cpu"
    assert run(f"{line} --out polygon")[0] == 0
    data = json.loads(path.read_text())
    height, width = rows("polygon")[0]["height"], rows("polygon")[0]["width"]
    mask = np.zeros((height, width), dtype=bool)
    mask[10:110, 20:80] = True
    edges = np.flatnonzero(np.diff(mask.T.ravel().astype(int))) + 1
    counts = np.diff([0, *edges, mask.size]).tolist()
    data["annotations"][0]["segmentation"] = {"size": [height, width], "counts": counts}
    path.write_text(json.dumps(data))
    assert run(f"{line} --out runs")[0] == 0
    data["annotations"][0]["segmentation"] = None
    path.write_text(json.dumps(data))
    assert run(f"{line} --out without")[0] == 0
    one, same, other = (np.array(rows(name)[0]["joints"]) for name in ("polygon", "runs", "without"))
    np.testing.assert_allclose(one, same, atol=1e-5)
    assert np.abs(one - other).max() > 1e-2


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("s/{000..002}.tar", "s/002.tar: no such tar file; expected those of the pattern"),
        ("s/000.txt", "No such file"),
        ("s/none.tar", "s/none.tar: No such file or folder; expected a folder of photos"),
        ("coco/people.json --labels cdcl14", "--labels: cdcl14, with coco/people.json"),
    ],
)
def test_faults_of_sources_are_one_line(line: str, says: str, run: Run) -> None:
    write_coco(Path("coco"), count=1)
    for name in ("000", "001"):
        write_tar(Path(f"s/{name}.tar"), members(name, parts=False))
    code, said, complaint = run(f"dataset {line} --device cpu --out out")
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert says in complaint


def test_without_webdataset_it_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("warp_partdr.bulk.containers.find_spec", lambda name: None)
    assert run("dataset {0..1}.tar")[2] == (
        "partdr: {0..1}.tar: a pattern, without webdataset; "
        "expected it: pip install 'pyarrow>=20' 'webdataset>=1.0.2'\n"
    )
    write_tar(Path("a.tar"), members("0", parts=False))
    assert open_source(Path("a.tar")).names == ("a.tar#0.jpg",)


def test_sources_go_to_other_processes() -> None:
    write_tar(Path("a.tar"), members("0", parts=False))
    source = open_source(Path("a.tar"))
    first = source.read("a.tar#0.jpg")
    copy = pickle.loads(pickle.dumps(source))
    assert copy == source
    np.testing.assert_array_equal(copy.read("a.tar#0.jpg").pixels, first.pixels)


def test_files_are_opened_once_and_few_stay_open() -> None:
    opened: list[str] = []
    latest = Latest(lambda path: opened.append(path.name) or path.name, most=2)
    for name in "aabacab":
        assert latest.open(Path(name)) == name
    assert opened == ["a", "b", "c", "b"]


def test_headers_of_tar_files_are_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are read when the source is opened: a copy in another process knows where all files are."""
    write_tar(Path("s/a.tar"), {**members("000"), **members("001", parts=False)})
    write_tar(Path("s/b.tar"), members("002", keypoints=False))
    given = open_source(Path("s"), labels="cdcl14")
    monkeypatch.setattr(picture_files, "index_tar", None)
    source = pickle.loads(pickle.dumps(given))
    pictures = [source.read(name) for name in given.names]
    assert [(each.people is None, each.parts is None) for each in pictures] == [
        (False, False),
        (False, True),
        (True, False),
    ]
    assert source.beside("a.tar#001.jpg", "parts.png") is None
    with pytest.raises(InputError, match=r"a.tar#9.jpg: not there; expected it in s.a.tar"):
        source.photo("a.tar#9.jpg")
