"""Pictures that a disk did not give are read again by the next run; a damaged one is done. Exit code of many errors."""

from __future__ import annotations

import errno
import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from helpers import commands
from helpers.commands import Run
from helpers.datasets import photo, rows, write_coco
from helpers.shards import members, write_beside, write_tar
from PIL import Image

from warp_partdr.bulk import containers, people, picture_files
from warp_partdr.bulk import run as bulk_run
from warp_partdr.bulk.cutting import read_picture
from warp_partdr.bulk.opening import open_source
from warp_partdr.bulk.outages import PassingError, is_passing
from warp_partdr.bulk.run import Readers
from warp_partdr.bulk.shards import Shards, Tally, read_about
from warp_partdr.errors import InputError
from warp_partdr.inputs import part_labels

pa = pytest.importorskip("pyarrow", reason="needs pyarrow, the extra dataset")
pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
COCO = "dataset coco/people.json --quality network --device cpu"
AGAIN = "could not be read; the same command tries again"


def fails_with(number: int) -> Callable[..., Any]:
    def fails(*given: Any, **how: Any) -> Any:
        raise OSError(number, os.strerror(number))

    return fails


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of people in the batches that were fitted."""
    counts: list[int] = []
    bodies = people.PeopleFitter.bodies

    def counted(self: people.PeopleFitter, some: Any) -> Any:
        counts.append(len(some))
        return bodies(self, some)

    monkeypatch.setattr(people.PeopleFitter, "bodies", counted)
    return counts


def test_missing_pictures_are_read_when_they_are_there(run: Run, fitted: list[int]) -> None:
    """Only these; the other rows stay, and the set is in the end as if nothing had been missing."""
    write_coco(Path("coco"), count=6)
    assert run(f"{COCO} --shard 4 --out whole")[0] == 0
    for name in ("001", "002"):
        Path(f"coco/{name}.jpg").rename(f"{name}.away")
    code, said, complaint = run(f"{COCO} --shard 4 --out out")
    assert code == 0  # of six rows two
    assert "out has 2 of 2 shards" in said
    assert "warning: 2 rows with an error, first 001.jpg: No such file or directory; expected a picture" in complaint
    assert f"partdr: warning: 2 pictures {AGAIN}\n" in complaint
    fitted.clear()

    code, _, complaint = run(f"{COCO} --shard 4 --out out")
    assert code == 0  # of the two that were tried both failed, but the set is as it was
    assert "warning: 2 rows with an error" in complaint
    assert fitted == []

    Path("001.away").rename("coco/001.jpg")
    code, said, complaint = run(f"{COCO} --shard 4 --out out")
    assert code == 0
    assert "1 of 2 shards are there; going on" in complaint
    assert "1 person in 2 pictures; " in said
    assert f"partdr: warning: 1 picture {AGAIN}\n" in complaint
    assert fitted == [1]
    assert [row["error"] is None for row in rows("out")] == [True, True, False, True, True, True]

    Path("002.away").rename("coco/002.jpg")
    assert run(f"{COCO} --shard 4 --out out")[0] == 0
    assert fitted == [1, 1]
    assert run(f"{COCO} --shard 4 --out out")[1] == "out has 2 of 2 shards; nothing to do\n"
    found, expected = pq.read_table("out"), pq.read_table("whole")
    assert found.schema.equals(expected.schema)
    for name in ("picture", "person", "error", "keypoints", "annotation", "warnings"):
        assert found[name] == expected[name]
    for one, other in zip(found["joints"], expected["joints"], strict=True):
        assert one.as_py() == pytest.approx(other.as_py(), abs=1e-4)
    about = read_about(Path("out/part-00000-of-00002.parquet"))
    assert "unread" not in about
    assert about["seconds"] > read_about(Path("out/part-00001-of-00002.parquet"))["seconds"] > 0
    assert run("report out --out page.html")[0] == 0


def test_an_empty_picture_is_read_again(run: Run) -> None:
    """A picture looks empty while it is copied. A damaged one stays an error of its row."""
    write_coco(Path("coco"), count=3)
    whole = Path("coco/001.jpg").read_bytes()
    Path("coco/001.jpg").write_bytes(b"")
    Path("coco/002.jpg").write_bytes(b"no picture")
    assert AGAIN in run(f"{COCO} --out out")[2]
    Path("coco/001.jpg").write_bytes(whole)
    assert run(f"{COCO} --out out")[0] == 0
    assert [row["picture"] for row in rows("out") if row["error"] is not None] == ["002.jpg"]


def test_a_whole_outage_is_another_exit_code(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    write_coco(Path("coco"), count=3)
    with monkeypatch.context() as patch:
        patch.setattr(Image, "open", fails_with(errno.EIO))
        code, said, complaint = run(f"{COCO} --out out")
        assert code == 1
        assert "out has 1 of 1 shards" in said
        assert "first 000.jpg: Input/output error; expected a picture" in complaint
        assert complaint.splitlines()[-2:] == [
            f"partdr: warning: 3 pictures {AGAIN}",
            "partdr: 3 of 3 rows have an error",
        ]
        assert run(f"{COCO} --out out")[0] == 1  # nothing is done yet
    assert run(f"{COCO} --out out")[0] == 0
    assert [row["error"] for row in rows("out")] == [None] * 3


@pytest.mark.parametrize(("broken", "code"), [(2, 0), (3, 1)])
def test_more_than_half_of_the_rows_have_to_fail(broken: int, code: int, run: Run) -> None:
    """Damaged pictures stay what they are: another run has nothing to do."""
    write_coco(Path("coco"), count=4)
    for index in range(broken):
        Path(f"coco/{index:03}.jpg").write_bytes(b"broken")
    found, _, complaint = run(f"{COCO} --out out")
    assert found == code
    assert (f"partdr: {broken} of 4 rows have an error" in complaint) == bool(code)
    assert AGAIN not in complaint
    assert run(f"{COCO} --out out")[:2] == (0, "out has 1 of 1 shards; nothing to do\n")


def test_rows_of_pictures_stay_in_their_order(run: Run) -> None:
    """Several people in one, nobody in another, one damaged; the picture that was missing comes between them."""
    one = photo(240)
    two = Image.new("RGB", (one.width * 2, one.height))
    two.paste(one, (0, 0))
    two.paste(one, (one.width, 0))
    two.save("a.png")
    two.save("c.png")
    one.point(lambda value: 90).save("d.png")
    Path("e.png").write_bytes(b"broken")
    Path("list.txt").write_text("d.png\nc.png\nb.png\na.png\ne.png\n")
    line = "dataset list.txt --quality network --device cpu --out out"
    assert run(line)[0] == 0
    before = rows("out")
    two.save("b.png")
    code, _, complaint = run(line)
    assert (code, "error" in complaint) == (0, False)
    after = rows("out")
    names = ["d.png", "c.png", "c.png", "b.png", "b.png", "a.png", "a.png", "e.png"]
    assert [row["picture"] for row in after] == names
    assert [row["person"] for row in after] == [None, 0, 1, 0, 1, 0, 1, None]
    assert [row for row in after if row["picture"] != "b.png"] == [row for row in before if row["picture"] != "b.png"]
    assert all(row["error"] is None for row in after[:-1])


def test_processes_tell_what_may_pass(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    write_beside(Path("s"), members("a", parts=False))
    write_beside(Path("s"), members("b", parts=False, keypoints=False))
    Path("s/c.jpg").symlink_to("away.jpg")
    Path("s/c.keypoints.json").write_bytes(Path("s/a.keypoints.json").read_bytes())
    monkeypatch.setattr(bulk_run, "source_readers", lambda *given: Readers(1, 1))
    line = "dataset s --quality network --device cpu --out out"
    code, _, complaint = run(line)
    assert code == 0
    assert f"1 picture {AGAIN}" in complaint
    Path("s/away.jpg").write_bytes(Path("s/a.jpg").read_bytes())
    Path("s/away.jpg").rename("away.jpg")
    Path("s/c.jpg").unlink()
    Path("s/c.jpg").symlink_to(Path("away.jpg").resolve())
    assert run(line)[0] == 0
    found = {row["picture"]: row["error"] for row in rows("out")}
    assert found == {"a.jpg": None, "b.jpg": None, "c.jpg": None}


def test_keypoints_that_are_a_link_to_nothing_are_told(run: Run) -> None:
    """Otherwise, people would be found instead, without a word."""
    write_beside(Path("s"), members("a", parts=False))
    Path("s/a.keypoints.json").rename("away.json")
    Path("s/a.keypoints.json").symlink_to(Path("away.json").resolve())
    source = open_source(Path("s"))
    assert source.read("a.jpg").people is not None
    Path("away.json").unlink()
    with pytest.raises(InputError, match=r"^a\.keypoints\.json: No such file or directory; expected") as caught:
        open_source(Path("s")).read("a.jpg")
    assert is_passing(caught.value)


def test_an_outage_of_files_beside_photos_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    write_beside(Path("s"), members("a", parts=False))
    source = open_source(Path("s"))
    monkeypatch.setattr(picture_files.Path, "stat", fails_with(errno.ESTALE))
    with pytest.raises(InputError, match=r"a\.keypoints\.json: Stale file handle; expected a file that can be read"):
        source.beside("a.jpg", "keypoints.json")


def test_an_outage_of_a_tar_file_stops_the_run(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """A row of the file itself would say that its pictures are done; a link to nothing is a row all the same."""
    write_tar(Path("s/a.tar"), members("0", parts=False))
    Path("s/gone.tar").symlink_to("nowhere.tar")
    line = "dataset s --quality network --device cpu --out out"
    with monkeypatch.context() as patch:
        patch.setattr(containers.tarfile, "open", fails_with(errno.EIO))
        assert run(line) == (2, "", "partdr: s/a.tar: Input/output error; expected a tar file\n")
    assert not Path("out").exists()
    code, _, complaint = run(line)
    assert code == 0
    assert f"1 picture {AGAIN}" in complaint
    told = "gone.tar: No such file or directory; expected a tar file"
    assert [(row["picture"], row["error"]) for row in rows("out")] == [("a.tar#0.jpg", None), ("gone.tar", told)]


def test_too_little_memory_may_pass(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    write_coco(Path("coco"), count=2)

    def fails(*given: Any) -> Any:
        raise torch.OutOfMemoryError("CUDA out of memory")

    with monkeypatch.context() as patch:
        patch.setattr(people, "fit_people", fails)
        code, _, complaint = run(f"{COCO} --out out")
    assert code == 1
    assert "first 000.jpg: OutOfMemoryError: CUDA out of memory" in complaint
    assert f"2 pictures {AGAIN}" in complaint
    assert run(f"{COCO} --out out")[0] == 0
    assert [row["error"] for row in rows("out")] == [None, None]


def test_a_library_may_be_installed_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part_labels, "find_spec", lambda name: None)
    Path("s").mkdir()
    Path("s/a.heic").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic")
    Path("s/b.jpg").write_bytes(b"broken")
    source = open_source(Path("s"))
    first, second = (read_picture(source, name) for name in source.names)
    assert isinstance(first, PassingError)
    assert isinstance(second, InputError)
    assert not is_passing(second)


def chained(error: BaseException) -> InputError:
    try:
        try:
            raise error
        except BaseException as first:
            raise InputError("a.jpg: no") from first
    except InputError as found:
        return found


@pytest.mark.parametrize("number", "ENOENT EACCES EPERM EIO ESTALE EMFILE ENFILE ETIMEDOUT ENOTCONN EBUSY".split())
def test_errors_of_the_disk_pass(number: str) -> None:
    error = OSError(getattr(errno, number), "told")
    assert is_passing(error)
    assert is_passing(chained(error))
    assert is_passing(chained(chained(error)))


@pytest.mark.parametrize(
    "error",
    [
        InputError("a.jpg: damaged"),
        OSError("image file is truncated"),  # Pillow's own
        OSError(-2),
        OSError(errno.EINVAL, "Invalid argument"),  # of places in a damaged file
        OSError(errno.EISDIR, "Is a directory"),
        OSError(errno.ELOOP, "Too many levels of symbolic links"),
        OSError(1094995529, "Invalid data found when processing input"),  # libav's
        ValueError("bad"),
        RuntimeError("of a kernel"),
    ],
)
def test_errors_of_content_stay(error: Exception) -> None:
    assert not is_passing(error)
    assert not is_passing(chained(error))


def test_what_may_pass_is_known_beyond_a_process() -> None:
    """A pickled error loses what it came from."""
    lost = pickle.loads(pickle.dumps(chained(OSError(errno.EIO, "told"))))
    assert not is_passing(lost)
    assert is_passing(pickle.loads(pickle.dumps(PassingError("a.jpg: told"))))
    assert is_passing(MemoryError())


def test_shards_know_what_is_left() -> None:
    names = [f"{index}.jpg" for index in range(5)]
    shards = Shards(Path("out"), names, 3, {"a": 1})
    assert [shards.left(index) for index in range(2)] == [names[:3], names[3:]]
    table = pa.table(
        {
            "picture": names[:3],
            "error": [None, "no", None],
            "warnings": [[], None, ["no"]],
            "camera_scale": [1.0, None, 2.0],
        }
    )
    about = {"warp-partdr": json.dumps(shards.describe(0) | {"unread": [1], "seconds": 2.5})}
    shards.write(0, table.replace_schema_metadata(about))
    assert shards.left(0) == ["1.jpg"]
    assert (shards.there(), shards.done()) == ({0: 1}, set())
    assert (shards.seconds(0), shards.seconds(1)) == (2.5, 0.0)
    assert shards.count_rows(0) == Tally(1, 3, 2, 1, 1, 3, 1, "1.jpg: no")
    read = pa.table({"picture": ["1.jpg"] * 2, "error": [None] * 2, "warnings": [None] * 2, "camera_scale": [3.0, 4.0]})
    read = read.cast(table.schema)
    assert shards.completed(0, read, ["1.jpg"]).to_pydict() == {
        "picture": ["0.jpg", "1.jpg", "1.jpg", "2.jpg"],
        "error": [None] * 4,
        "warnings": [[], None, None, ["no"]],
        "camera_scale": [1.0, 3.0, 4.0, 2.0],
    }
    assert shards.completed(1, read, names[3:]) is read  # the whole shard
    other = Shards(Path("out"), names, 3, {"a": 2})
    with pytest.raises(InputError, match="made with a 1, not 2"):
        other.left(0)


def test_an_actor_makes_what_is_left() -> None:
    """A shard with unread pictures is not one that an actor wrote before it died."""
    cluster = pytest.importorskip("warp_partdr.bulk.cluster")
    names = ["a.jpg", "b.jpg"]
    shards = Shards(Path("out"), names, 1, {})
    made: list[int] = []

    class Done(cluster._Maker):
        def __init__(self) -> None:
            self.source, self.shards, self.columns, self.fitter, self.readers = None, shards, (), None, Readers(1, 0)

    def make(source: Any, given: Shards, fitter: Any, columns: Any, *, todo: list[int], **readers: int) -> Tally:
        made.extend(todo)
        return Tally(shards=1, unread=1)

    for index, unread in enumerate(([], [0])):
        about = {"warp-partdr": json.dumps(shards.describe(index) | {"unread": unread})}
        nothing = pa.array([None], pa.float32())
        table = pa.table({"picture": [names[index]], "error": ["no"], "warnings": [[]], "camera_scale": nothing})
        shards.write(index, table.replace_schema_metadata(about))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cluster, "make_dataset", make)
        told = [Done()({"shard": [index]}) for index in range(2)]
    assert made == [1]
    assert [each["errors"] for each in told] == [[1], [0]]
    assert [each["unread"] for each in told] == [[0], [1]]
