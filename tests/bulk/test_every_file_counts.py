"""Every file of a folder or tar file is a picture's row, lies beside one, or is counted with the reason."""

from __future__ import annotations

import errno
import gzip
import json
import os
import tarfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import commands
from helpers.commands import Run
from helpers.datasets import photo, rows
from helpers.shards import members, write_beside, write_tar

from warp_partdr.bulk import opening
from warp_partdr.bulk.containers import Member, group_members
from warp_partdr.bulk.opening import open_source
from warp_partdr.bulk.picture_files import PictureFiles
from warp_partdr.errors import InputError, printable
from warp_partdr.inputs.photo_files import LeftOut

pq = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, the extra dataset")
pytestmark = pytest.mark.usefixtures("here")

run = commands.run  # fixture
HOW = "--quality network --device cpu"
LATIN = os.fsdecode(b"caf\xe9.png")  # not UTF-8


def save(*names: str, side: int = 32) -> None:
    for name in names:
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        photo(side).save(name, "png")


def grouped(*names: str) -> tuple[dict[str, list[str]], str]:
    """Names of the files beside each photo, and what is left out."""
    left_out = LeftOut()
    found = group_members([Member(name, place, 1) for place, name in enumerate(names)], left_out)
    return {name: [member.name for ending, member in files.items() if ending] for name, files in found.items()}, str(
        left_out
    )


def files_of(folder: str, labels: str | None = None) -> PictureFiles:
    source = open_source(Path(folder), labels=labels)
    assert isinstance(source, PictureFiles)
    return source


def test_a_folder_s_files_are_rows_or_counted(run: Run) -> None:
    save("s/a.png", "s/more/B.GIF", "s/c 1.5.png")
    photo(32).save("s/d.mpo", "MPO")
    for name in ("s/a.txt", "s/more/x.psd", "s/x.cr2", "s/lost.keypoints.json"):
        Path(name).write_text("x")
    code, said, complaint = run(f"dataset s --out out {HOW}")
    assert code == 0
    assert "in 4 pictures" in said
    assert complaint.splitlines()[0] == (
        "partdr: 4 files left out: 1 .keypoints.json (no photo of that name beside it); "
        "1 .psd, 1 .txt (no picture format); 1 .cr2 (raw photos: develop them first)"
    )
    assert [row["picture"] for row in rows("out")] == ["a.png", "c 1.5.png", "d.mpo", "more/B.GIF"]


def test_a_folder_without_pictures_says_what_is_in_it(run: Run) -> None:
    Path("s").mkdir()
    Path("s/IMG_1.NEF").write_bytes(b"raw")
    assert (
        "s: no pictures in it (1 file left out: 1 .nef (raw photos: develop them first)); expected some: .jpg"
        in (run(f"dataset s --out out {HOW}")[2])
    )


def test_hidden_files_and_folders_are_not_searched() -> None:
    save("s/.hidden/a.png", "s/.b.png", "s/more/.c.png", "s/more/.d/e.png", "s/f.png", "s/@eaDir/f.png")
    Path("s/Thumbs.db").write_bytes(b"")
    source = files_of("s")
    assert (source.names, source.left_out) == (("f.png",), "")


def test_linked_folders_are_searched_once() -> None:
    save("elsewhere/a.png", "s/real/b.png")
    Path("s/linked").symlink_to(Path("elsewhere").resolve())
    Path("s/again").symlink_to(Path("s/real").resolve())  # its pictures are there already
    Path("elsewhere/loop").symlink_to(Path("s").resolve())
    assert files_of("s").names == ("linked/a.png", "real/b.png")


def test_a_folder_that_may_not_be_listed_is_counted_and_an_outage_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise, the next run would find other pictures."""
    save("s/a.png", "s/lost+found/b.png")
    scandir, code = os.scandir, [errno.EACCES]

    def refuses(path: Path) -> Any:
        if str(path).endswith("lost+found"):
            raise OSError(code[0], os.strerror(code[0]), str(path))
        return scandir(path)

    monkeypatch.setattr(opening.os, "scandir", refuses)
    source = files_of("s")
    assert source.names == ("a.png",)
    assert source.left_out == "1 file left out: 1 whole folder (Permission denied)"
    code[0] = errno.EIO
    with pytest.raises(InputError, match=r"lost\+found: Input/output error; expected a folder that can be read"):
        open_source(Path("s"))


def test_names_of_members_may_have_points(run: Run) -> None:
    """Names of their folders may, too. The files beside a member have its name without the last ending."""
    names = ["shoot 2.0 take 3", "0002.v2", "run.1/a", "./b"]
    given: dict[str, bytes] = {}
    for place, name in enumerate(names):
        given |= members(name, parts=place % 2 == 0, ending=("jpg", "png")[place % 2])
    write_tar(Path("s.tar"), given)
    write_beside(Path("s"), given)
    assert run(f"dataset s.tar --labels cdcl14 --out tar {HOW}")[0] == 0
    assert run(f"dataset s --labels cdcl14 --out folder {HOW}")[0] == 0
    packed = {row.pop("picture").removeprefix("s.tar#").removeprefix("./"): row for row in rows("tar")}
    plain = {row.pop("picture"): row for row in rows("folder")}
    assert packed == plain
    assert sorted(plain) == ["0002.v2.png", "b.png", "run.1/a.jpg", "shoot 2.0 take 3.jpg"]
    assert [row["error"] for row in plain.values()] == [None] * 4


def test_members_go_together_by_the_longest_name() -> None:
    assert grouped("a.jpg", "a.keypoints.json", "a.parts.png") == (
        {"a.jpg": ["a.keypoints.json", "a.parts.png"]},
        "",
    )
    assert grouped("a.1.jpg", "a.2.jpg", "a.1.keypoints.json", "a.2.parts.png")[0] == {
        "a.1.jpg": ["a.1.keypoints.json"],
        "a.2.jpg": ["a.2.parts.png"],
    }
    assert grouped("d.1/a.jpg", "d.2/a.jpg", "d.2/a.keypoints.json")[0] == {
        "d.1/a.jpg": [],
        "d.2/a.jpg": ["d.2/a.keypoints.json"],
    }
    assert grouped("A.JPG", "A.KEYPOINTS.JSON") == ({"A.JPG": ["A.KEYPOINTS.JSON"]}, "")
    assert grouped("a.jpg", "a.png", "a.keypoints.json")[0] == {
        "a.jpg": ["a.keypoints.json"],
        "a.png": ["a.keypoints.json"],
    }


def test_members_go_together_as_webdataset_has_them_where_nothing_else_fits() -> None:
    assert grouped("7.image.jpg", "7.keypoints.json")[0] == {"7.image.jpg": ["7.keypoints.json"]}
    assert grouped("d.x/7.image.jpg", "d.x/7.parts.png")[0] == {"d.x/7.image.jpg": ["d.x/7.parts.png"]}
    two = {"7.left.jpg": [], "7.right.jpg": []}
    alone = "1 file left out: 1 .keypoints.json (no photo of that name beside it)"
    assert grouped("7.left.jpg", "7.right.jpg", "7.keypoints.json") == (two, alone)
    assert grouped("7.jpg", "7.image.jpg", "7.keypoints.json") == (
        {"7.jpg": ["7.keypoints.json"], "7.image.jpg": []},
        "",
    )


def test_other_members_are_counted() -> None:
    write_tar(
        Path("a.tar"),
        {
            **members("0", keypoints=False, parts=False),
            **dict.fromkeys(("0.txt", "0.json", "b/1.cls", "._0.jpg", "__MACOSX/._0.jpg", ".git/x.png"), b"x"),
            "9.keypoints.json": b"{}",
        },
    )
    source = files_of("a.tar")
    assert source.names == ("a.tar#0.jpg",)
    assert source.left_out == (
        "4 files left out: 1 .keypoints.json (no photo of that name beside it); "
        "1 .cls, 1 .json, 1 .txt (no picture format)"
    )


def add(tar: tarfile.TarFile, name: str, data: bytes = b"", **changes: Any) -> None:
    info = tarfile.TarInfo(name)
    info.size = len(data)
    for key, value in changes.items():
        setattr(info, key, value)
    tar.addfile(info, BytesIO(data))


def png(shade: int) -> bytes:
    from PIL import Image

    buffer = BytesIO()
    Image.new("RGB", (8, 8), (shade, shade, shade)).save(buffer, "png")
    return buffer.getvalue()


def test_links_in_a_tar_file_are_files() -> None:
    with tarfile.open("a.tar", "w") as tar:
        add(tar, "d/first.png", png(10))
        add(tar, "hard.png", type=tarfile.LNKTYPE, linkname="d/first.png")
        add(tar, "d/soft.png", type=tarfile.SYMTYPE, linkname="../later.png")
        add(tar, "d/twice.png", type=tarfile.SYMTYPE, linkname="soft.png")
        add(tar, "lost.png", type=tarfile.SYMTYPE, linkname="/data/lost.png")
        add(tar, "ring.png", type=tarfile.SYMTYPE, linkname="ring.png")
        add(tar, "later.png", png(90))
        add(tar, "folder.png", type=tarfile.DIRTYPE)
    source = files_of("a.tar")
    shades = {name.removeprefix("a.tar#"): int(source.read(name).pixels[0, 0, 0]) for name in source.names}
    assert shades == {"d/first.png": 10, "later.png": 90, "hard.png": 10, "d/soft.png": 90, "d/twice.png": 90}
    assert source.left_out == "2 files left out: 2 .png (links to what is not in the tar file)"


def test_of_members_of_one_name_the_last_counts() -> None:
    """Unpacking does the same: ``tar -r`` adds a newer file."""
    with tarfile.open("a.tar", "w") as tar:
        add(tar, "a.png", png(10))
        add(tar, "A.png", png(50))
        add(tar, "a.png", png(90))
    source = files_of("a.tar")
    assert {name: int(source.read(name).pixels[0, 0, 0]) for name in source.names} == {
        "a.tar#A.png": 50,
        "a.tar#a.png": 90,
    }
    assert source.left_out == "1 file left out: 1 .png (a later one of that name is in the tar file)"


def test_long_and_strange_names_of_members_become_rows(run: Run) -> None:
    """They stand in headers of their own (PAX, GNU), with bytes that are not UTF-8, or with a new line."""
    long = "/".join(["folder " + "x" * 60] * 4) + "/a.b.png"
    with tarfile.open("a.tar", "w", format=tarfile.PAX_FORMAT) as tar:
        add(tar, long, png(10))
        add(tar, "写真 1.png", png(20))
        add(tar, "two\nlines.png", png(30))
    with tarfile.open("b.tar", "w", format=tarfile.GNU_FORMAT) as tar:
        add(tar, long, png(10))
        add(tar, LATIN, png(40))
    Path("list.txt").write_text("a.tar\nb.tar\n")
    code, said, _ = run(f"dataset list.txt --out out {HOW}")
    assert code == 0
    assert "in 5 pictures" in said
    assert [row["picture"] for row in rows("out")] == [
        f"a.tar#{long}",
        "a.tar#写真 1.png",
        "a.tar#two\\x0alines.png",
        f"b.tar#{long}",
        "b.tar#caf\\xe9.png",
    ]


def test_sparse_members_are_counted() -> None:
    """The bytes of a sparse member are not in one piece."""
    with tarfile.open("a.tar", "w", format=tarfile.PAX_FORMAT) as tar:
        add(tar, "a.png", png(10))
        data = b"1\n0\n5\n".ljust(512, b"\0") + b"bytes"
        keys = {"GNU.sparse.major": "1", "GNU.sparse.minor": "0", "GNU.sparse.name": "b.png"}
        add(tar, "GNUSparseFile.0/b.png", data, pax_headers=keys | {"GNU.sparse.realsize": "9000"})
    source = files_of("a.tar")
    assert source.names == ("a.tar#a.png",)
    assert source.left_out == "1 file left out: 1 .png (sparse members of a tar file: pack them without -S)"


def test_archives_are_one_line(run: Run) -> None:
    data = write_tar(Path("a.tar"), members("0", keypoints=False, parts=False)).read_bytes()
    Path("a.tar.gz").write_bytes(gzip.compress(data))
    Path("a.zip").write_bytes(b"PK\x03\x04")
    for name in ("a.tar.gz", "a.zip"):
        code, _, complaint = run(f"dataset {name} --out out {HOW}")
        told = f"partdr: {name}: an archive; expected it unpacked, or a .tar without compression\n"
        assert (code, complaint) == (2, told)
    Path("s").mkdir()
    Path("a.tar.gz").rename("s/b.tar")
    save("s/a.png", "s/c.png")
    Path("a.zip").rename("s/a.zip")
    code, _, complaint = run(f"dataset s --out out {HOW}")
    assert code == 0
    assert "partdr: 1 file left out: 1 .zip (archives: unpack them first)\n" in complaint
    assert (
        rows("out")[1]["error"] == "b.tar: compressed; expected it without compression: members are read by their place"
    )


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_lists_of_files_are_read_from_all_systems(end: str, encoding: str) -> None:
    names = ["b.heic", "a\x85b.png", "écran\u2028.png", "c.unknown", "no ending"]
    Path("list.txt").write_bytes(end.join([*names, "", ""]).encode(encoding))
    assert files_of("list.txt").names == tuple(names)


def test_a_list_s_names_need_not_be_text(run: Run) -> None:
    save(LATIN, "two.png")
    Path("list.txt").write_bytes(b"caf\xe9.png\ntwo.png\n")
    assert run(f"dataset list.txt --out out {HOW}")[0] == 0
    assert [(row["picture"], row["error"]) for row in rows("out")] == [("caf\\xe9.png", None), ("two.png", None)]


def test_strange_names_of_files_are_rows(run: Run) -> None:
    """A picture, one that can't be read, one with keypoints, and one beyond the end of a line; also in the report."""
    save("s/two\nlines.png", "s/[red]x[.png")
    Path("s", LATIN).write_bytes(b"broken")
    for name, data in members("k").items():
        if not name.endswith("parts.png"):
            Path("s", name.replace("k", os.fsdecode(b"k\xff"))).write_bytes(data)
    code, said, complaint = run(f"dataset s --out out {HOW}")
    assert code == 0
    assert "in 4 pictures" in said
    assert "warning: 1 row with an error, first caf\\xe9.png: cannot identify" in complaint
    found = rows("out")
    assert [row["picture"] for row in found] == ["[red]x[.png", "caf\\xe9.png", "k\\xff.jpg", "two\\x0alines.png"]
    assert found[2]["joints"] is not None
    assert run(f"dataset s --out out {HOW}")[1] == "out has 1 of 1 shards; nothing to do\n"
    code, said, _ = run("report out --pictures s --out page.html")
    assert code == 0
    assert "3 of 3 photos could be read" in Path("page.html").read_text()


def test_names_that_rows_would_not_tell_apart_are_refused() -> None:
    save("s/caf\\xe9.png", f"s/{LATIN}")
    with pytest.raises(InputError, match=r"caf\\xe9.png twice; expected each picture once"):
        open_source(Path("s"))
    assert printable(LATIN) == "caf\\xe9.png"


@pytest.mark.skipif(os.name != "posix", reason="needs pipes with names")
def test_pipes_are_rows_with_errors(run: Run) -> None:
    save("s/fine.png", "s/good.png", "s/k.png", "s/well.png")
    for name in ("x.png", "k.keypoints.json", "a.tar"):
        os.mkfifo(f"s/{name}")
    code, _, _ = run(f"dataset s --out out {HOW}")
    assert code == 0
    assert {row["picture"]: row["error"] for row in rows("out") if row["error"]} == {
        "a.tar": "a.tar: a pipe, no regular file; expected a tar file",
        "k.png": "k.keypoints.json: a pipe, no regular file; expected keypoints in JSON",
        "x.png": "x.png: a pipe, no regular file; expected a picture",
    }
    assert run(f"dataset s --out out {HOW}")[1] == "out has 1 of 1 shards; nothing to do\n"


def test_labels_of_another_size_than_their_photo_are_told() -> None:
    """The size is the photo's own, also where it is only looked through."""
    for keypoints in (True, False):
        given = members("a", keypoints=keypoints)
        given["a.parts.png"] = members("b", ending="png")["b.parts.png"]
        write_beside(Path("s"), given)
        assert files_of("s", "cdcl14").read("a.jpg").parts is not None
        width, height = photo(160).size
        from PIL import Image

        with Image.open("s/a.parts.png") as labels:
            labels.resize((width - 1, height), Image.Resampling.NEAREST).save("s/a.parts.png")
        with pytest.raises(
            InputError, match=rf"photo: {width}x{height}; parts: {width - 1}x{height}; expected one size"
        ):
            files_of("s", "cdcl14").read("a.jpg")
        Path("s/a.keypoints.json").unlink(missing_ok=True)


def test_files_that_hold_several_pictures_are_marked(run: Run) -> None:
    frames = [photo(256) for _ in range(3)]
    Path("s").mkdir()
    frames[0].save("s/a.gif", save_all=True, append_images=[frames[0].rotate(5), frames[0].rotate(10)])
    frames[0].convert("L").point(lambda value: 90).save(
        "s/b.gif", save_all=True, append_images=[frames[0].convert("L")]
    )
    assert run(f"dataset s --out out {HOW}")[0] == 0
    body, nobody = rows("out")
    assert body["joints"] is not None
    assert body["warnings"][0] == "3 pictures in the file; the first is taken"
    assert nobody["person"] is None
    assert nobody["warnings"] == ["2 pictures in the file; the first is taken"]
    code, said, _ = run("report out --out page.html")
    assert code == 0
    assert "2 warned" in said


def test_keypoints_are_of_the_photo_of_their_whole_name() -> None:
    files = members("7.new", parts=False)
    write_beside(Path("s"), {**files, **members("7", keypoints=False, parts=False)})
    source = files_of("s")
    assert [source.read(name).people is None for name in source.names] == [True, False]
    assert json.loads(files["7.new.keypoints.json"])["keypoints"][0][0] == pytest.approx(
        float(source.read("7.new.jpg").people[0].keypoints.points[0, 0])
    )
    np.testing.assert_array_equal(source.read("7.new.jpg").pixels, source.read("7.jpg").pixels)
